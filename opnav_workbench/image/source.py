"""What every reader hands over: planes and header of one file, before masks and time are made of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import ImageError
from opnav_workbench.image.frame import HeaderValue

__all__ = ["Source", "image_error", "plain", "single_plane", "truncated"]

# DN: special pixels of ISIS and of PDS products (-1E+32, -3.4E+38) lie below this, detectors never do.
LOWEST_VALUE_DN = -1e30


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Planes of one file: picture, error and quality (n_line, n_pixel), header values, and remarks."""

    image: FloatArray
    header: dict[str, HeaderValue]
    error: FloatArray | None = None
    quality: NDArray[np.int64] | None = None
    messages: tuple[str, ...] = ()


def image_error(name: str, text: str) -> ImageError:
    """Return an `ImageError` of one line that begins with the file's name."""
    return ImageError(" ".join(f"{name}: {text}".split()))


def truncated(name: str, what: str, present: int, needed: int) -> ImageError:
    """Return the error of a file that ends too early."""
    return image_error(
        name, f"truncated: {what} has {present} of {needed} bytes; copy or download the file again."
    )


def single_plane(name: str, data: Any) -> FloatArray:
    """Return a picture as native float64 (n_line, n_pixel) with nan for special values; a cube of one plane is squeezed.

    Raises
    ------
    ImageError
        A cube of several planes, or something that is no picture.
    """
    values = np.array(data, dtype=np.float64)
    while values.ndim > 2 and values.shape[0] == 1:
        values = values[0]
    if values.ndim > 2:
        raise image_error(
            name,
            f"holds a cube of shape {values.shape}, not one picture; save the plane to be measured as a file of its own.",
        )
    if values.ndim < 2 or values.size == 0:
        raise image_error(name, f"holds data of shape {values.shape}, no two-dimensional picture; choose an image file.")
    values[~(values > LOWEST_VALUE_DN) | np.isinf(values)] = np.nan
    return values


def plain(value: Any) -> HeaderValue | None:
    """Return a header value as a plain Python value; lists become text, what has no value becomes None."""
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, list | tuple):
        return ", ".join(str(v) for v in value)
    return None if value is None else str(value)
