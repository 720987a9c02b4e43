"""Sidecars: what stands beside a picture whose header, if any, tells no time, as JSON, YAML or CSV; and raw files' layout.

A sidecar has the picture's name (``a.png`` and ``a.json``, ``.yaml``, ``.yml`` or ``.csv``; ``a.png.json`` too), or names
the picture: ``file: a.raw``. Its words of the list below say what every mission knows and are put under the mission's own
keywords; all others are header keywords as they stand. A CSV file has a word and its value in each row, or a row of words
and a row for each picture, told by ``file``.

``utc``, ``et``
    The middle of the exposure.
``exposure_s``
    Seconds.
``attitude``
    Quaternion, scalar first, of ``camera_from_j2000`` (SPICE's ``m2q`` of that matrix).
``position_km``, ``velocity_km_s``
    Of the spacecraft with respect to the Sun, J2000.
``sclk``, ``target``, ``instrument``
    Texts.
``lines``, ``samples``, ``sample_type``, ``byte_order``, ``offset_bytes``, ``line_prefix_bytes``, ``line_suffix_bytes``
    The layout of a raw file; of several ``channels`` also how they are interleaved (``interleave``: BSQ, BIL, BIP). Types
    ``uint10``, ``uint12`` and ``uint14`` are packed, bit after bit, lowest first where the byte order is little (GenICam's
    Mono12p), else highest first; each line begins with a byte. Such numbers in two bytes each are ``uint16``.

Image support data of a Community Sensor Model (ALE's JSON) are a sidecar, too, and tell the time here; what they tell of
attitude, states and body the session takes from them (`opnav_workbench.session.beside`).
"""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from opnav_workbench.files import decoded, json_value
from opnav_workbench.geometry.times import et_from_text, text_from_et
from opnav_workbench.image.file_bytes import file_bytes, image_error
from opnav_workbench.image.formats.stored import (
    FORMATS,
    BandOrder,
    Raster,
    StoredPicture,
    full_scale,
    read_raster,
)
from opnav_workbench.image.header import Header, HeaderValue, KeywordMap, bare_word
from opnav_workbench.paths import is_file
from opnav_workbench.yaml_nodes import LARGEST_BYTES, LONGEST_NUMBER, compose, plain_value

__all__ = [
    "Sidecar",
    "find_sidecar",
    "holds_support_data",
    "is_sidecar",
    "read_raw",
    "read_sidecar",
    "with_sidecar",
]

SUFFIXES = (".json", ".yaml", ".yml", ".csv")
MOST_WORDS = 10_000
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
SAMPLE_TYPES = {
    "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
PACKED_BITS = {"uint10": 10, "uint12": 12, "uint14": 14}
DECIMALS = 6  # of a second, of times that are shifted
# Other names of the layout's words; they can mean nothing else.
LAYOUT_WORDS = {
    **dict.fromkeys(("rows", "height", "nl", "n_line", "n_lines"), "lines"),
    **dict.fromkeys(("columns", "cols", "width", "ns", "n_pixel", "n_samples"), "samples"),
    **dict.fromkeys(("dtype", "data_type"), "sample_type"),
    **dict.fromkeys(("byteorder", "endian", "endianness"), "byte_order"),
    **dict.fromkeys(("offset", "header_bytes", "skip_bytes"), "offset_bytes"),
}
# What others call the words above. Their unit, order or sense may be another: they are not taken, but named.
LIKELY_WORDS = {
    **dict.fromkeys(("time", "date", "datetime", "timestamp", "date_obs", "date-obs", "epoch", "utc_time"), "utc"),
    **dict.fromkeys(("start_time", "mid_time"), "utc"),
    **dict.fromkeys(("exposure", "exptime", "exp_time", "exposure_time", "exposure_ms"), "exposure_s"),
    **dict.fromkeys(("exposure_duration", "integration_time"), "exposure_s"),
    **dict.fromkeys(("quaternion", "quat", "q", "camera_from_j2000", "orientation", "pointing"), "attitude"),
    **dict.fromkeys(("position", "spacecraft_position", "position_m", "pos_km"), "position_km"),
    **dict.fromkeys(("velocity", "spacecraft_velocity", "velocity_m_s", "vel_km_s"), "velocity_km_s"),
}  # fmt: skip
MEANINGS = {
    "utc": "the middle of the exposure",
    "exposure_s": "seconds",
    "attitude": "a quaternion of camera_from_j2000, scalar first",
    "position_km": "of the spacecraft from the Sun, J2000",
    "velocity_km_s": "of the spacecraft with respect to the Sun, J2000",
}
BYTE_ORDERS = {
    **dict.fromkeys(("<", "lsb", "le", "little-endian", "little_endian", "intel", "pc"), "little"),
    **dict.fromkeys((">", "msb", "be", "big-endian", "big_endian", "motorola", "network"), "big"),
}


def _numbers(value: Any) -> Any:
    """Return the numbers of a text, as a cell of a table has them, as a list."""
    return (
        value.replace(",", " ").replace(";", " ").strip("[]() ").split() if isinstance(value, str) else value
    )


def _sample_type(value: Any) -> Any:
    """Return a sample type by its name here, as NumPy writes it (``<u2``), or in capitals."""
    name = str(value).strip().lower().lstrip("<>=|")
    name = {"byte": "uint8", "mono10p": "uint10", "mono12p": "uint12", "mono14p": "uint14"}.get(name, name)
    if name in PACKED_BITS:
        return name
    return next((known for known, code in SAMPLE_TYPES.items() if name in (known, code)), value)


def _byte_order(value: Any) -> Any:
    name = str(value).strip().lower()
    return BYTE_ORDERS.get(name, name)


Vector = Annotated[tuple[float, float, float], BeforeValidator(_numbers)]
Quaternion = Annotated[tuple[float, float, float, float], BeforeValidator(_numbers)]
Positive = Annotated[int, Field(ge=1, le=1 << 20)]
Bytes = Annotated[int, Field(ge=0, le=1 << 30)]


class Sidecar(BaseModel):
    """What a sidecar says: words that every mission knows, the layout of a raw file, and header keywords."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False, defer_build=True)

    file: str | None = None
    utc: str | None = None
    et: float | None = None
    exposure_s: Annotated[float, Field(gt=0.0)] | None = None
    attitude: Quaternion | None = None
    position_km: Vector | None = None
    velocity_km_s: Vector | None = None
    sclk: str | None = None
    target: str | None = None
    instrument: str | None = None
    lines: Positive | None = None
    samples: Positive | None = None
    sample_type: Annotated[
        Literal[
            "uint8",
            "int8",
            "uint16",
            "int16",
            "uint32",
            "int32",
            "float32",
            "float64",
            "uint10",
            "uint12",
            "uint14",
        ],
        BeforeValidator(_sample_type),
    ] = "uint16"
    byte_order: Annotated[Literal["little", "big"], BeforeValidator(_byte_order)] = "little"
    offset_bytes: Bytes = 0
    line_prefix_bytes: Bytes = 0
    line_suffix_bytes: Bytes = 0
    channels: Annotated[int, Field(ge=1, le=64)] = 1
    interleave: BandOrder = "BIP"


# ---- The file.


def is_sidecar(file: Path) -> bool:
    """Tell by its name whether a file is a sidecar."""
    return file.suffix.lower() in SUFFIXES


def find_sidecar(picture: Path) -> Path | None:
    """Return the sidecar of a picture: of its name with another ending, or with one more; None where there is none."""
    for suffix in SUFFIXES:
        for candidate in (picture.with_suffix(suffix), picture.with_name(picture.name + suffix)):
            if candidate != picture and is_file(candidate):
                return candidate
    return None


def read_sidecar(sidecar: Path, picture: str | None = None) -> Sidecar:
    """Read a sidecar.

    Parameters
    ----------
    picture
        Name of the picture, for tables of several.

    Raises
    ------
    ImageError
        It cannot be read, or a word has a value that it cannot have.
    """
    data = file_bytes(sidecar)
    if len(data) > LARGEST_BYTES:
        raise image_error(sidecar.name, f"has {len(data)} bytes, more than a sidecar of {LARGEST_BYTES} has.")
    try:
        words = _words(sidecar, data, picture)
    except (ValueError, RecursionError, csv.Error) as error:  # JSON's and YAML's errors are ValueErrors
        raise image_error(
            sidecar.name, f"no readable sidecar ({error}); see that it is JSON, YAML or CSV."
        ) from error
    if (
        not isinstance(words, dict)
        or len(words) > MOST_WORDS
        or not all(isinstance(word, str) for word in words)
    ):
        raise image_error(
            sidecar.name, "a sidecar has words and their values: utc: 2030-01-01T00:00:00; write it so."
        )
    if holds_support_data(words):
        words = {"et": words.get("center_ephemeris_time")}
    try:
        return Sidecar.model_validate(_own_words(words))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise image_error(sidecar.name, f"{where}: {first['msg']}; correct the sidecar.") from error


def holds_support_data(words: Any) -> bool:
    """Tell whether a JSON file has image support data of a Community Sensor Model, as ALE writes them."""
    return isinstance(words, Mapping) and str(words.get("name_model", "")).startswith("USGS_ASTRO_")


def _own_words(words: Mapping[str, Any]) -> dict[str, Any]:
    """Return words by the names that the list has, in its case; others as they stand."""
    own: dict[str, Any] = {}
    for word, value in words.items():
        name = word.strip().lower()
        name = LAYOUT_WORDS.get(name, name)
        own[name if name in Sidecar.model_fields else word] = value
    code = str(own.get("sample_type", ""))[:1]
    if code in BYTE_ORDERS and "byte_order" not in own:  # "<u2" tells both
        own["byte_order"] = code
    return own


def _words(sidecar: Path, data: bytes, picture: str | None) -> Any:
    suffix = sidecar.suffix.lower()
    if suffix == ".json":
        return json_value(decoded(data))
    if suffix == ".csv":
        return _table_words(_rows(decoded(data)), picture)
    node = compose(decoded(data))
    return {} if node is None else plain_value(node)


def _rows(text: str) -> list[list[str]]:
    """Return the rows of a table, whatever parts its cells; with semicolons a number may have a comma."""
    first = text.partition("\n")[0]
    parted = max(",;\t", key=first.count)
    rows = list(csv.reader(io.StringIO(text), delimiter=parted))
    if parted != ";":
        return rows
    return [
        [cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell.strip()) else cell for cell in row]
        for row in rows
    ]


def _table_words(rows: Sequence[Sequence[str]], picture: str | None) -> dict[str, Any]:
    """Return the words of a table: one a row, or one a column with a row for each picture."""
    rows = [[cell.strip() for cell in row] for row in rows if any(cell.strip() for cell in row)]
    if not rows:
        raise ValueError("a table without rows")
    are_words = all(cell.lower() in Sidecar.model_fields for cell in rows[0])
    if all(len(row) == 2 for row in rows) and not are_words:
        return {word: _cell(value) for word, value in rows if value}
    head, *body = rows
    words = [word.lower() for word in head]
    files = words.index("file") if "file" in words else None
    mine = body if files is None else [row for row in body if len(row) > files and row[files] == picture]
    if len(mine) != 1:
        raise ValueError(f"{len(mine)} rows for {picture}, expected one; a column named file tells them")
    return {word: _cell(value) for word, value in zip(head, mine[0], strict=False) if value}


def _cell(text: str) -> str | int | float:
    """Return a cell as a number, where it is one that a double can be."""
    if len(text) > LONGEST_NUMBER:
        return text
    for number in (int, float):
        try:
            value = number(text)
        except ValueError:
            continue
        if math.isfinite(value):
            return value
    return text


# ---- Its words, under the mission's keywords.


def with_sidecar(source: StoredPicture, sidecar: Sidecar, name: str, keywords: KeywordMap) -> StoredPicture:
    """Return a picture whose header has a sidecar's words too, and the keywords under which they are found.

    Raises
    ------
    ImageError
        A time of it is none, or time or exposure are missing where the mission asks for them.
    """
    header, completed = _header(sidecar, name, keywords)
    header = {**source.header, **header}
    for word, fields in (("utc", ("utc", "et", "sclk")), ("exposure_s", ("exposure_s",))):
        asked = [keyword for field in fields if (keyword := getattr(completed, field))]
        if asked and all(completed.value(Header(header), field) is None for field in fields):
            # In the sidecar's words: nobody has seen the mission's keywords.
            likely = [other for other in sidecar.model_extra or {} if _likely(other) == word]
            instead = f" as {word} ({MEANINGS[word]}) instead of {', '.join(likely)}" if likely else ""
            raise image_error(name, f"no {word}; state it there{instead} (or {' or '.join(asked)}).")
    remarks = _left_aside(sidecar, completed)
    return replace(source, header=header, keywords=completed, messages=(*source.messages, *remarks))


def _likely(word: str) -> str:
    """Return the word of the list that another one may stand for, empty where none."""
    return LIKELY_WORDS.get(word.strip().lower(), "")


def _left_aside(sidecar: Sidecar, keywords: KeywordMap) -> tuple[str, ...]:
    """Return remarks on words that look like those of the list, and that neither it nor the mission's keywords have."""
    asked = str(keywords)
    return tuple(
        f"its word {word} is not read: {_likely(word)} is the word ({MEANINGS[_likely(word)]})"
        for word in sidecar.model_extra or {}
        if _likely(word) and repr(word) not in asked and getattr(sidecar, _likely(word)) is None
    )


def _header(sidecar: Sidecar, name: str, keywords: KeywordMap) -> tuple[dict[str, HeaderValue], KeywordMap]:
    """Return a sidecar's words under the mission's keywords, and these with words of our own where it names none."""
    header = _plain_words(sidecar.model_extra or {})
    own: dict[str, str | tuple[str, ...]] = {}
    for word, values in _stated(sidecar, name, keywords).items():
        field = KEYWORDS_OF[word]
        named = getattr(keywords, field)
        names = (named,) if isinstance(named, str) else tuple(named or ())
        if len(names) != len(values):
            names = tuple(f"SIDECAR.{word}.{number}" for number in range(len(values)))
            own[field] = names if len(names) > 1 else names[0]
        for named_so, value in zip(names, values, strict=True):
            word_there, sign = bare_word(named_so)
            header[word_there] = value if isinstance(value, str) or sign > 0.0 else -value
    return header, replace(keywords, **own)  # type: ignore[arg-type]  # a field of each name


def _plain_words(words: Mapping[str, Any]) -> dict[str, HeaderValue]:
    """Return header keywords of nested values: ``a: {b: 1}`` is ``A.B``."""
    header: dict[str, HeaderValue] = {}
    for word, value in words.items():
        if isinstance(value, Mapping):
            inner = _plain_words({str(key): part for key, part in value.items()})
            header |= {f"{word}.{key}": part for key, part in inner.items()}
        elif isinstance(value, str | int | float):
            header[word] = value
        elif isinstance(value, Sequence):
            header[word] = ", ".join(str(part) for part in value)
    return header


KEYWORDS_OF = {
    "utc": "utc", "et": "et", "exposure_s": "exposure_s", "attitude": "quaternion", "position_km": "sun_position",
    "velocity_km_s": "sun_velocity", "sclk": "sclk", "target": "target", "instrument": "instrument",
}  # fmt: skip


def _stated(sidecar: Sidecar, name: str, keywords: KeywordMap) -> dict[str, tuple[HeaderValue, ...]]:
    """Return what a sidecar states in words of the list, as the mission's keywords mean it."""
    early_s = keywords.to_middle_s(sidecar.exposure_s or 0.0)
    stated: dict[str, tuple[HeaderValue, ...] | None] = {
        "utc": None if sidecar.utc is None else (_earlier(name, sidecar.utc, early_s),),
        "et": None if sidecar.et is None else (sidecar.et - early_s,),
        "exposure_s": None if sidecar.exposure_s is None else (sidecar.exposure_s / keywords.exposure_scale,),
        "attitude": None if sidecar.attitude is None else _in_sense(sidecar.attitude, keywords),
        "position_km": None if sidecar.position_km is None else tuple(-x for x in sidecar.position_km),
        "velocity_km_s": None if sidecar.velocity_km_s is None else tuple(-v for v in sidecar.velocity_km_s),
    }
    texts = {word: getattr(sidecar, word) for word in ("sclk", "target", "instrument")}
    stated |= {word: (text,) for word, text in texts.items() if text is not None}
    return {word: values for word, values in stated.items() if values is not None}


def _earlier(name: str, utc: str, seconds: float) -> str:
    try:
        et = et_from_text(utc)
        return utc if seconds == 0.0 else text_from_et(et - seconds, DECIMALS)
    except ValueError as error:
        raise image_error(name, f"utc = {utc!r} is no UTC ({error}); correct the sidecar.") from error


def _in_sense(quaternion: Quaternion, keywords: KeywordMap) -> tuple[float, ...]:
    """Return a quaternion of ``camera_from_j2000`` in the sense that the mission's keywords have."""
    w, *vector = quaternion
    sign = 1.0 if keywords.quaternion_sense == "j2000_to_camera" else -1.0
    return (w, *(sign * part for part in vector))


# ---- Raw files.


def read_raw(name: str, data: bytes, sidecar: Sidecar, sidecar_name: str) -> StoredPicture:
    """Read a raw file as its sidecar describes it.

    Raises
    ------
    ImageError
        The sidecar does not say how many lines and samples it has, or the file ends too early.
    """
    layout = _layout(sidecar)
    if layout is None:
        raise image_error(
            name,
            f"is not a {FORMATS} file, and {sidecar_name} does not say its lines and samples, as for a raw one; convert it, "
            "or state lines, samples, sample_type and byte_order there.",
        )
    image = read_raster(name, data, layout)
    bits = PACKED_BITS.get(sidecar.sample_type)
    if bits is not None:
        if sidecar.channels > 1:
            raise image_error(
                name, f"{sidecar.sample_type} of {sidecar.channels} channels is not read; unpack it."
            )
        if len(data) - layout.offset == 2 * layout.lines * int(sidecar.samples or 0):
            raise image_error(name, f"has two bytes a sample; write sample_type: uint16 into {sidecar_name}.")
        image = _unpacked(image, int(sidecar.samples or 0), bits, lowest_first=sidecar.byte_order == "little")
    behind = len(data) - layout.offset - layout.records * (layout.prefix + layout.line_bytes + layout.suffix)
    remarks = (
        (f"{behind} bytes behind the samples that {sidecar_name} tells are left aside",) if behind else ()
    )
    names = ("red", "green", "blue") if layout.bands == 3 else ()
    if bits is not None:
        saturated = image == (1 << bits) - 1
    else:
        saturated = full_scale(image) if image.ndim == 2 else None
    return StoredPicture(image, {}, saturated=saturated, channels=names, messages=remarks)


def _layout(sidecar: Sidecar) -> Raster | None:
    if sidecar.lines is None or sidecar.samples is None:
        return None
    order = "<" if sidecar.byte_order == "little" else ">"
    bits = PACKED_BITS.get(sidecar.sample_type)
    return Raster(
        sidecar.lines,
        sidecar.samples if bits is None else -(-sidecar.samples * bits // 8),  # as bytes, unpacked later
        np.dtype(order + SAMPLE_TYPES.get(sidecar.sample_type, "u1")),
        sidecar.channels,
        sidecar.interleave,
        sidecar.offset_bytes,
        sidecar.line_prefix_bytes,
        sidecar.line_suffix_bytes,
    )


def _unpacked(
    packed: NDArray[np.uint8], samples: int, bits: int, *, lowest_first: bool
) -> NDArray[np.uint16]:
    """Return samples (n_line, n_pixel) of lines of bytes (n_line, n) that hold them bit after bit."""
    first = np.arange(samples) * bits
    at, shift = first // 8, (first % 8).astype(np.uint32)
    bytes_ = np.pad(packed, ((0, 0), (0, 2))).astype(np.uint32)  # a sample lies in three at most
    one, two, three = bytes_[:, at], bytes_[:, at + 1], bytes_[:, at + 2]
    if lowest_first:
        run = (one | two << 8 | three << 16) >> shift
    else:
        run = (one << 16 | two << 8 | three) >> (np.uint32(24 - bits) - shift)
    return (run & np.uint32((1 << bits) - 1)).astype(np.uint16)
