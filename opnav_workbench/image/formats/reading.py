"""From a file to a `StoredPicture`: which format it is, by its content, and what lies beside it.

A label or a sidecar may be given in the place of the file with the pixels; a file that has no header of its own is read with
the label or sidecar of its name, and so is one whose header tells neither a time nor the exposure.
"""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from opnav_workbench.image.file_bytes import GZIP_START, file_bytes, image_error, unpacked
from opnav_workbench.image.formats.fits_picture import is_fits, read_fits
from opnav_workbench.image.formats.stored import FORMATS, StoredPicture
from opnav_workbench.image.header import Header, KeywordMap
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import is_file

if TYPE_CHECKING:
    from opnav_workbench.image import pds_label
    from opnav_workbench.image.formats import display_picture, isis_cube, pds3, pds4, sidecar, vicar
else:  # most pictures are FITS files
    pds_label = module_on_demand("opnav_workbench.image.pds_label")
    display_picture, isis_cube, pds3, pds4, sidecar, vicar = (
        module_on_demand(f"opnav_workbench.image.formats.{name}")
        for name in ("display_picture", "isis_cube", "pds3", "pds4", "sidecar", "vicar")
    )

__all__ = ["read_stored"]

SHOWN_BYTES = 24
PACKED = {
    b"PK\x03\x04": "ZIP",
    b"BZh": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf": "7-Zip",
    b"\x1f\x9d": "compress",
    b"Rar!": "RAR",
}
LABELS = (".lbl", ".LBL", ".xml", ".XML", ".lblx", ".LBLX")


def read_stored(file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    """Return the file that holds the pixels, and its planes.

    Parameters
    ----------
    file
        A picture, or the label or sidecar that describes one.
    data
        Its bytes.

    Raises
    ------
    ImageError
        One line: it is no picture, damaged, truncated, too large, or what it names is not there.
    """
    pixels, source = _read_stored(file, data, keywords)
    return pixels, _with_words_beside(pixels, source, keywords)


def _with_words_beside(file: Path, source: StoredPicture, keywords: KeywordMap) -> StoredPicture:
    """Add a sidecar's words to a picture whose own header lacks time or exposure, as conversions lose them."""
    header = Header(source.header)
    told = (_tells(header, keywords, fields) for fields in (("exposure_s",), ("utc", "et", "sclk")))
    if source.keywords is not None or all(told):
        return source
    beside = sidecar.find_sidecar(file)
    if beside is None:
        return source
    return sidecar.with_sidecar(source, sidecar.read_sidecar(beside, file.name), beside.name, keywords)


def _tells(header: Header, keywords: KeywordMap, fields: tuple[str, ...]) -> bool:
    """Whether a header has one of these facts, or the mission asks for none of them."""
    asked = [field for field in fields if getattr(keywords, field) is not None]
    return not asked or any(keywords.value(header, field) is not None for field in asked)


def _read_stored(file: Path, packed: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    data = _plain(file, packed)
    if is_fits(data):
        return file, read_fits(file, data, keywords)
    if pds_label.is_pds3(data):
        return _read_pds3(file, data, keywords)
    if isis_cube.is_isis_cube(data):
        return _read_isis(file, data, keywords)
    if pds4.is_pds4(data):
        label = pds4.pds4_label(file.name, data)
        pixels = _file_beside(file, label.file)
        return pixels, pds4.read_pds4(pixels.name, label, _content(pixels))
    if sidecar.is_sidecar(file):
        return _read_named_by_sidecar(file, keywords)
    return file, _read_pixels(file, data, keywords)


def _file_beside(label_file: Path, named: str) -> Path:
    """Return the file that a label or sidecar names, in its own folder only; gzipped where it is there so alone.

    Case does not count: labels are in capitals, archives often not.
    """
    name = Path(named).name
    with contextlib.suppress(OSError):  # a folder that cannot be listed
        beside = sorted(label_file.parent.iterdir())
        for wanted in (name.lower(), f"{name.lower()}.gz"):
            for candidate in beside:
                if candidate.name.lower() == wanted:
                    return candidate
    raise image_error(
        label_file.name, f"the label names {name}, which is not beside it; put both into one folder."
    )


def _plain(file: Path, data: bytes) -> bytes:
    """Return the bytes of a file, unpacked where they are gzipped."""
    return unpacked(file.name, data) if data.startswith(GZIP_START) else data


def _content(file: Path) -> bytes:
    """Return the bytes of a file, unpacked."""
    return _plain(file, file_bytes(file))


def _read_pixels(file: Path, plain: bytes, keywords: KeywordMap) -> StoredPicture:
    """Read a file that holds pixels, and has a header or a sidecar."""
    if is_fits(plain):
        return read_fits(file, plain, keywords)
    if vicar.is_vicar(plain):
        return vicar.read_vicar(file.name, plain)
    if pds3.is_variable_length(plain):
        label = pds_label.parse_pds_label(pds3.variable_length_label(plain))
        return pds3.read_variable_length(file.name, plain, label)
    return _read_with_sidecar(file, plain, keywords, sidecar.find_sidecar(file))


def _read_with_sidecar(
    file: Path, data: bytes, keywords: KeywordMap, sidecar_file: Path | None
) -> StoredPicture:
    is_display = display_picture.display_format(data) is not None
    if sidecar_file is None:
        if not is_display:
            raise _unknown(file, data)
        source = display_picture.read_display_picture(file, data)
        _refuse_without_words(file, source, keywords)
        return source
    told = sidecar.read_sidecar(sidecar_file, file.name)
    if is_display:
        source = display_picture.read_display_picture(file, data)
    else:
        source = sidecar.read_raw(file.name, data, told, sidecar_file.name)
    return sidecar.with_sidecar(source, told, sidecar_file.name, keywords)


def _refuse_without_words(file: Path, source: StoredPicture, keywords: KeywordMap) -> None:
    """Refuse a picture that says nothing of itself, where the mission asks it for time, exposure or its own name."""
    asked = (keywords.exposure_s, keywords.utc, keywords.et, keywords.sclk, *keywords.required)
    if not source.header and any(asked):
        raise image_error(
            file.name,
            f"has no header of its own; put a sidecar {file.stem}.json beside it, such as "
            '{"utc": "2030-01-01T00:00:00", "exposure_s": 0.5, "attitude": [1, 0, 0, 0]}.',
        )


def _unknown(file: Path, data: bytes) -> Exception:
    # China's archives have a.2C and a.2CL.
    beside = (*(file.with_suffix(s) for s in LABELS), file.with_name(f"{file.name}L"))
    label = next((path for path in beside if path != file and is_file(path)), None)
    if label is not None:
        return image_error(file.name, f"has no header of its own; give its label {label.name}.")
    packed = next((kind for start, kind in PACKED.items() if data.startswith(start)), None)
    if packed is not None:
        return image_error(file.name, f"is packed ({packed}); unpack it, and give the picture.")
    if vicar.lacks_label_size(data):
        return image_error(
            file.name,
            "has words of a VICAR label, but does not begin with LBLSIZE=..., the label's size; give the original, or put a "
            f"sidecar {file.stem}.json beside it (lines, samples, sample_type, offset_bytes, utc, exposure_s).",
        )
    return image_error(
        file.name,
        f"is not a {FORMATS} file: it begins with {data[:SHOWN_BYTES]!r}; give an image file, or put a sidecar "
        f"{file.stem}.json beside it (lines, samples, sample_type, utc, exposure_s).",
    )


def _read_pds3(label_file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    label = pds_label.parse_pds_label(data)
    pointer = pds_label.image_pointer(label_file.name, label)
    if pointer.file is None:
        return label_file, pds3.read_pds_raw(label_file.name, data, pointer.offset_bytes, label, keywords)
    pixels = _file_beside(label_file, pointer.file)
    content = _content(pixels)
    if is_fits(content) or vicar.is_vicar(content):
        source = _read_pixels(pixels, content, keywords)
        return pixels, replace(source, header=label.values | source.header)
    return pixels, pds3.read_pds_raw(pixels.name, content, pointer.offset_bytes, label, keywords)


def _read_isis(file: Path, data: bytes, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    label = isis_cube.isis_label(data)
    core = isis_cube.detached_core(label)
    pixels = file if core is None else _file_beside(file, core)
    source = isis_cube.read_isis_cube(pixels.name, label, data if core is None else _content(pixels))
    return pixels, replace(source, header=isis_cube.in_words_of(label, keywords))


def _read_named_by_sidecar(file: Path, keywords: KeywordMap) -> tuple[Path, StoredPicture]:
    named = sidecar.read_sidecar(file).file
    if named is None:
        raise image_error(
            file.name, "is a sidecar that names no picture; give the picture, or add file: NAME."
        )
    pixels = _file_beside(file, named)
    plain = _content(pixels)
    if sidecar.is_sidecar(pixels) or is_fits(plain) or vicar.is_vicar(plain):
        raise image_error(file.name, f"names {pixels.name}, which needs no sidecar; give that file.")
    return pixels, _read_with_sidecar(pixels, plain, keywords, file)
