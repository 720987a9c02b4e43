"""ISIS cubes: samples in tiles or bands, with special values for what is missing or saturated.

A cube of several bands is one picture only where a channel is chosen. A map projection is no picture of a camera.
ISIS has words of its own for what archives' labels say; they stand under the mission's words too (`in_words_of`), so that a
mission's cubes are read as its archive's files are.

Source: the cube format of ISIS (Integrated Software for Imagers and Spectrometers, USGS), and its table of special pixels.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.geometry.times import et_from_text, text_from_et
from opnav_workbench.image.file_bytes import check_size, image_error
from opnav_workbench.image.formats.stored import Raster, StoredPicture, linear, read_raster
from opnav_workbench.image.header import HeaderValue, KeywordMap
from opnav_workbench.image.pds_label import label_integer, label_items, label_value

__all__ = ["IsisLabel", "detached_core", "in_words_of", "is_isis_cube", "isis_label", "read_isis_cube"]

CORE = ("ISISCUBE", "CORE")
MAP = ("ISISCUBE", "MAPPING")
ORDERS = {"LSB": "<", "MSB": ">"}


class _SpecialPixels(NamedTuple):
    """Type of the samples; up to the first value they are missing or too low, from the second on saturated."""

    dtype: str
    highest_missing: float
    lowest_saturated: float


# Of bytes 0 is no value and 255 saturated; of words five values at the lower end, or three and two at both.
PIXEL_TYPES = {
    "UNSIGNEDBYTE": _SpecialPixels("u1", 0.0, 255.0),
    "SIGNEDWORD": _SpecialPixels("i2", -32753.0, np.inf),
    "UNSIGNEDWORD": _SpecialPixels("u2", 2.0, 65534.0),
    "REAL": _SpecialPixels("f4", -3.4e38, np.inf),
    "DOUBLE": _SpecialPixels("f8", -1.7e308, np.inf),
}
# Of signed words the saturated values stand next to the missing ones: NULL, LRS, LIS, HIS, HRS, from the lowest on.
SATURATED = {"SIGNEDWORD": (-32765, -32764)}
# Of floats they differ in the last bits of the lowest number: NULL ends on FB, LRS FC, LIS FD, HIS FE, HRS FF.
SATURATED_BITS = {"REAL": (np.uint32, 0xFF7FFFFE), "DOUBLE": (np.uint64, 0xFFEFFFFFFFFFFFFE)}


class IsisLabel(NamedTuple):
    """What a cube's label says: values by name (the first of equals), its core's, whether it is a map, its exposure."""

    values: dict[str, HeaderValue]
    core: dict[str, HeaderValue]
    is_map: bool
    exposure_s: float | None = None


def is_isis_cube(data: bytes) -> bool:
    """Tell from the first bytes whether this is an ISIS cube or its label."""
    words = data[:200].split(maxsplit=3)
    return [word.lower() for word in words[:3]] == [b"object", b"=", b"isiscube"]


def isis_label(data: bytes) -> IsisLabel:
    """Return what the label at the begin of a cube says."""
    values: dict[str, HeaderValue] = {}
    core: dict[str, HeaderValue] = {}
    is_map, exposure_s = False, None
    for item in label_items(data):
        is_map = is_map or item.inside[:2] == MAP
        inside = core if item.inside[:2] == CORE else values
        inside.setdefault(item.name, label_value(item.text))
        if item.name == "EXPOSUREDURATION" and exposure_s is None:
            exposure_s = _seconds(item.text)
    return IsisLabel(values, core, is_map, exposure_s)


def _seconds(text: str) -> float | None:
    """Return a duration with its unit, seconds unless it has one, in seconds; None of what is none."""
    told = DURATION.match(text)
    if told is None:
        return None
    return float(told["number"]) * (1e-3 if (told["unit"] or "").lower().startswith("m") else 1.0)


# ---- ISIS' words under those of the archives.

DURATION = re.compile(
    r"\s*(?P<number>[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)\s*(<\s*(?P<unit>\w+)\s*>)?", re.IGNORECASE
)
ARCHIVE_WORDS = {
    "SPACECRAFTNAME": ("SPACECRAFT_NAME", "INSTRUMENT_HOST_NAME", "TELESCOP"),
    "INSTRUMENTID": ("INSTRUMENT_ID", "INSTRUMENT_NAME"),
    "TARGETNAME": ("TARGET_NAME",),
    "FILTERNAME": ("FILTER_NAME",),
    "NAIFFRAMECODE": ("NAIFID",),
    "FPUBINNINGMODE": ("MESS:FPU_BIN",),
    "SPACECRAFTCLOCKSTARTCOUNT": ("SPACECRAFT_CLOCK_START_COUNT",),
    "SPACECRAFTCLOCKSTOPCOUNT": ("SPACECRAFT_CLOCK_STOP_COUNT",),
}


def in_words_of(label: IsisLabel, keywords: KeywordMap) -> dict[str, HeaderValue]:
    """Return what a cube's label says, besides its own words in those of the archives and of a mission, where it has none.

    ``StartTime`` is what the archive's label has for the picture's time: the middle or the start, as the mission says, and
    where that is the middle, the one between it and ``StopTime``.
    """
    values = label.values
    said = {name: values[word] for word, names in ARCHIVE_WORDS.items() if word in values for name in names}
    if keywords.exposure_s and label.exposure_s is not None:
        said[keywords.exposure_s] = label.exposure_s / keywords.exposure_scale
    if keywords.utc and "STARTTIME" in values:
        said[keywords.utc] = _picture_time(values, keywords)
    if keywords.target and "TARGETNAME" in values:
        said[keywords.target] = values["TARGETNAME"]
    return said | values


def _picture_time(values: Mapping[str, HeaderValue], keywords: KeywordMap) -> HeaderValue:
    start, stop = values["STARTTIME"], values.get("STOPTIME")
    if keywords.time_reference != "middle" or stop is None:
        return start
    try:
        return text_from_et(0.5 * (et_from_text(str(start)) + et_from_text(str(stop))))
    except ValueError:  # told where the picture's time is read
        return start


def read_isis_cube(name: str, label: IsisLabel, data: bytes) -> StoredPicture:
    """Read the picture of a cube.

    Parameters
    ----------
    data
        Of the file that holds the samples: the cube's own, or the one that a detached label names.

    Raises
    ------
    ImageError
        It is a map, its label lacks what is needed, or the file is truncated.
    """
    if label.is_map:
        raise image_error(
            name, "is a map projection, no picture as the camera saw it; give the cube before cam2map."
        )
    core = label.core
    kind = str(core.get("TYPE", "")).upper()
    order = ORDERS.get(str(core.get("BYTEORDER", "Lsb")).upper())
    if kind not in PIXEL_TYPES or order is None:
        raise image_error(
            name,
            f"ISIS cube of Type {core.get('TYPE')!r} in ByteOrder {core.get('BYTEORDER')!r} is not read; "
            "convert it to bit type real, or to FITS.",
        )
    dtype = np.dtype(order + PIXEL_TYPES[kind].dtype)
    lines, samples = (label_integer(name, core, key, least=1) for key in ("LINES", "SAMPLES"))
    bands = label_integer(name, core, "BANDS", 1, 1)
    start = label_integer(name, core, "STARTBYTE", 1, 1) - 1
    if len(data) <= start:
        raise image_error(name, "is the label of an ISIS cube without its samples; give the cube.")
    raster = Raster(lines, samples, dtype, bands, offset=start)
    check_size(name, lines * samples * bands)
    tiled = str(core.get("FORMAT", "BandSequential")).upper() == "TILE"
    stored = _tiles(name, core, data, raster) if tiled else read_raster(name, data, raster)
    missing, saturated = _special(stored, kind)
    base, multiplier = core.get("BASE"), core.get("MULTIPLIER")
    image = linear(name, stored, multiplier, base, "ISIS cube whose Base or Multiplier")
    _mark(image, missing, saturated)
    return StoredPicture(image, label.values, saturated=saturated, channels=_band_names(label.values, bands))


def detached_core(label: IsisLabel) -> str | None:
    """Return the name of the file that holds the samples of a detached label; None where they follow in the same file."""
    name = label.core.get("^CORE")
    return None if name is None else str(name)


def _tiles(name: str, core: Mapping[str, HeaderValue], data: bytes, raster: Raster) -> NDArray[Any]:
    """Return the samples of tiles, which are whole at the right and lower end too."""
    tile_lines, tile_samples = (
        label_integer(name, core, key, least=1) for key in ("TILELINES", "TILESAMPLES")
    )
    check_size(name, tile_lines * tile_samples)
    down, across = -(-raster.lines // tile_lines), -(-raster.samples // tile_samples)
    whole = replace(raster, lines=raster.bands * down * across * tile_lines, samples=tile_samples, bands=1)
    tiles = read_raster(name, data, whole).reshape(raster.bands, down, across, tile_lines, tile_samples)
    full = tiles.swapaxes(2, 3).reshape(raster.bands, down * tile_lines, across * tile_samples)
    image = full[:, : raster.lines, : raster.samples]
    return image[0] if raster.bands == 1 else image


def _special(stored: NDArray[Any], kind: str) -> tuple[BoolArray, BoolArray]:
    """Return which samples have no value, and which are saturated."""
    special = PIXEL_TYPES[kind]
    low = stored <= stored.dtype.type(special.highest_missing)
    if kind in SATURATED:
        saturated = np.isin(stored, SATURATED[kind])
    elif kind in SATURATED_BITS:
        unsigned, lowest = SATURATED_BITS[kind]
        native = np.ascontiguousarray(stored, stored.dtype.newbyteorder("="))
        saturated = low & (native.view(unsigned) >= unsigned(lowest))
    else:
        saturated = stored >= special.lowest_saturated
    return np.asarray(low & ~saturated), np.asarray(saturated)


def _mark(image: FloatArray, missing: BoolArray, saturated: BoolArray) -> None:
    """Put nan where there is no value, and the highest of all where they are saturated."""
    image[missing] = np.nan
    if saturated.any():
        valid = image[~(missing | saturated)]
        image[saturated] = valid.max() if valid.size else np.nan


def _band_names(values: Mapping[str, HeaderValue], bands: int) -> tuple[str, ...]:
    """Return the filters of the bands, where the label names as many."""
    named = tuple(part.strip() for part in str(values.get("FILTERNAME", values.get("NAME", ""))).split(","))
    return named if bands > 1 and len(named) == bands else ()
