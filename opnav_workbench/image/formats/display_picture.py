"""PNG, TIFF and JPEG: pictures as cameras of other trades and displays have them, with a sidecar for time and attitude.

Pillow decodes them, first in a supervised process. Whole numbers stay what they are; the highest that a file can hold
counts as saturated. Colors are channels: one is chosen in the mission file, or all of them are equal. Colors of more than
8 bits are refused, as Pillow would cut them to 8. Pixels are told as stored: what a tag says of showing them turned or
mirrored is left aside, as how the detector lies is the camera file's matter.
"""

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.errors import ImageError
from opnav_workbench.image.file_bytes import check_size, image_error
from opnav_workbench.image.formats.stored import StoredPicture, full_scale
from opnav_workbench.image.header import HeaderValue
from opnav_workbench.supervised import tried

__all__ = ["display_format", "read_display_picture"]

STARTS = {
    b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8\xff": "JPEG", b"II*\0": "TIFF", b"MM\0*": "TIFF",
    b"II+\0": "TIFF", b"MM\0+": "TIFF",  # of more than 4 GB
}  # fmt: skip
GRAY = {"L", "I", "F", "I;16", "I;16B", "I;16L", "1"}
COLORS = {
    "RGB": ("red", "green", "blue"), "RGBA": ("red", "green", "blue"), "LA": ("gray",), "YCbCr": ("red", "green", "blue"),
}  # fmt: skip
PNG_BIT_DEPTH, PNG_COLOR = 24, 25  # bytes of the first chunk
TIFF_BITS_PER_SAMPLE, TIFF_PHOTOMETRIC, TIFF_ORIENTATION, TIFF_SAMPLE_FORMAT = 258, 262, 274, 339
WHITE_IS_ZERO = 0
WHITE_ZERO = "its zero is white: values are counted from the highest down"
UNSIGNED, SIGNED = 1, 2  # sample formats
AS_STORED = {  # what undoes the turn that Pillow makes of a tag
    2: "FLIP_LEFT_RIGHT", 3: "ROTATE_180", 4: "FLIP_TOP_BOTTOM", 5: "TRANSPOSE", 6: "ROTATE_90", 7: "TRANSVERSE",
    8: "ROTATE_270",
}  # fmt: skip
LONGEST_TEXT = 2000  # characters of a file's own words
WORDS_KEPT = 200


def display_format(data: bytes) -> str | None:
    """Tell from the first bytes whether this is a PNG, TIFF or JPEG file."""
    return next((kind for start, kind in STARTS.items() if data.startswith(start)), None)


def read_display_picture(file: Path, data: bytes) -> StoredPicture:
    """Read a PNG, TIFF or JPEG file.

    Raises
    ------
    ImageError
        It is damaged, too large, or of a kind whose values would be changed by reading.
    """
    # A tenth of a second that pictures of other formats shall not wait for.
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415

    name, kind = file.name, display_format(data)
    damaged = f"damaged {kind} file ({{}}); copy or download it again."
    try:
        with Image.open(io.BytesIO(data), formats=(str(kind),)) as picture:
            check_size(name, picture.width * picture.height)
            _refuse_changed(name, picture, data)
            tried("image/picture_trial.py:try_display", str(file))
            messages, orientation, is_negative = _tags(picture)
            stored, header = _as_stored(_plain(picture), orientation, is_negative), _words(picture)
            mode, frames = picture.mode, getattr(picture, "n_frames", 1)
    except (ImageError, MemoryError):
        raise
    except UnidentifiedImageError as error:
        if kind == "TIFF" and (source := _reals_and_large(name, data)) is not None:
            return source
        raise image_error(
            name,
            f"damaged {kind} file, or of a kind that is not read; save it with 16-bit integers or 32-bit reals, or as FITS.",
        ) from error
    except Exception as error:  # whatever the library says of a damaged file
        raise image_error(name, damaged.format(str(error) or type(error).__name__)) from error
    if frames > 1:
        messages.append(f"the first of {frames} pictures in the file")
    if kind == "JPEG":
        messages.append(
            "JPEG keeps no faint detail: centers of faint stars may be off by more than their sigmas"
        )
    return _stored(stored, mode, header, messages)


def _reals_and_large(name: str, data: bytes) -> StoredPicture | None:
    """Read a gray TIFF of a kind that Pillow has not: reals of 16 and 64 bits, of more than 4 GB high byte first.

    None where it is none of these, or packed in a way that takes a library which does not come along.
    """
    import tifffile  # noqa: PLC0415

    try:
        with _silent("tifffile"), tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            if (
                len(page.shape) != 2
                or page.samplesperpixel != 1
                or page.dtype is None
                or page.dtype.kind not in "uif"
            ):
                return None
            check_size(name, page.size)
            values, frames = np.asarray(page.asarray()), len(file.pages)
            is_negative = int(page.photometric) == WHITE_IS_ZERO
            if values.ndim != 2:  # damaged: its words for lines and pixels are not those of its data
                return None
    except (ImageError, MemoryError):
        raise
    except Exception:  # whatever the library says of what it cannot read: Pillow's answer stands
        return None
    messages = [f"the first of {frames} pictures in the file"] if frames > 1 else []
    if is_negative:
        messages.append(WHITE_ZERO)
        values = _counted_down(values)
    return _stored(values, "F", {}, messages)


@contextmanager
def _silent(library: str) -> Iterator[None]:
    """Keep what a library logs of a damaged file from the terminal: the error says it in one line."""
    logger = logging.getLogger(library)
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


def _counted_down(values: NDArray[Any]) -> NDArray[Any]:
    """Return values of which the highest was dark."""
    highest = values.max() if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    return np.asarray(highest - values)


def _refuse_changed(name: str, picture: Any, data: bytes) -> None:
    """Refuse what the library would change: colors of more than 8 bits, palettes that are not gray, inks."""
    deep = False
    if picture.format == "PNG":
        deep = data[PNG_BIT_DEPTH] == 16 and data[PNG_COLOR] in (2, 6)
    elif picture.format == "TIFF":
        bits = picture.tag_v2.get(TIFF_BITS_PER_SAMPLE, (8,))
        deep = len(bits) > 1 and max(bits) > 8
    if deep:
        raise image_error(
            name, "has colors of more than 8 bits; save the channel to be measured as a gray file of 16 bits."
        )
    if picture.mode not in GRAY and picture.mode not in COLORS and picture.mode != "P":
        raise image_error(name, f"has colors of kind {picture.mode}; save it in gray, or as RGB.")


def _tags(picture: Any) -> tuple[list[str], int, bool]:
    """Return what a file's tags say of showing it: remarks, the way that Pillow turns it, whether its zero is white."""
    tags = picture.tag_v2 if picture.format == "TIFF" else {}
    told = int((tags or picture.getexif()).get(TIFF_ORIENTATION, 1))
    messages = (
        [] if told not in AS_STORED else [f"its orientation tag ({told}) is left aside: pixels as stored"]
    )
    is_negative = tags.get(TIFF_PHOTOMETRIC) == WHITE_IS_ZERO
    if is_negative:
        messages.append(WHITE_ZERO)
    return messages, told if tags else 1, is_negative


def _as_stored(picture: Any, orientation: int, is_negative: bool) -> NDArray[Any]:
    """Return a picture's values: of TIFF with the sign that its tags tell, not turned, and light high."""
    from PIL import Image  # noqa: PLC0415

    tags = dict(picture.tag_v2) if getattr(picture, "format", None) == "TIFF" else {}
    picture.load()
    if orientation in AS_STORED:
        picture = picture.transpose(Image.Transpose[AS_STORED[orientation]])
    values = np.asarray(picture)
    kind, bits = (
        tags.get(tag, (default,))
        for tag, default in ((TIFF_SAMPLE_FORMAT, UNSIGNED), (TIFF_BITS_PER_SAMPLE, 8))
    )
    if values.dtype == np.int32 and kind[0] == UNSIGNED and bits[0] == 32:
        values = values.view(np.uint32)
    if values.dtype == np.uint8 and kind[0] == SIGNED:
        values = values.view(np.int8)
    if is_negative and picture.mode not in ("1", "L"):  # those Pillow has counted so itself
        values = _counted_down(values)
    return values


def _plain(picture: Any) -> Any:
    """Return a picture whose values are light: palettes and luminance with differences of color as RGB."""
    return picture.convert("RGB") if picture.mode in ("P", "YCbCr") else picture


def _words(picture: Any) -> dict[str, HeaderValue]:
    """Return what a file says of itself in words: text chunks of PNG."""
    texts = getattr(picture, "text", {}) or {}
    return {
        str(key): str(value)
        for key, value in list(texts.items())[:WORDS_KEPT]
        if len(str(key)) <= LONGEST_TEXT and len(str(value)) <= LONGEST_TEXT
    }


def _stored(
    values: NDArray[Any], mode: str, header: dict[str, HeaderValue], messages: list[str]
) -> StoredPicture:
    if values.dtype == bool:
        values = values.astype(np.uint8)
    if values.ndim == 2:
        return StoredPicture(values, header, messages=tuple(messages), saturated=full_scale(values))
    names = COLORS.get(mode, ("red", "green", "blue"))
    channels = np.moveaxis(values, 2, 0)
    image = channels[: len(names)]
    saturated = np.asarray(full_scale(image))
    if len(channels) > len(names):  # the last channel says where the picture is transparent
        image = np.where(channels[-1] == 0, np.nan, image.astype(np.float64))
    if np.array_equal(image, np.broadcast_to(image[0], image.shape), equal_nan=image.dtype.kind == "f"):
        said = [*messages, "its channels are equal; one is taken"] if len(names) > 1 else messages
        return StoredPicture(image[0], header, messages=tuple(said), saturated=saturated[0])
    return StoredPicture(image, header, messages=tuple(messages), saturated=saturated, channels=names)
