"""A picture in memory: pixels, masks and what the header says of time and pointing."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import ImageError

__all__ = ["Frame", "Header", "HeaderGeometry", "HeaderValue"]

HeaderValue: TypeAlias = str | float | int | bool


class Header(Mapping[str, HeaderValue]):
    """The header as read-only plain Python values; keywords in capitals, found in any case.

    Examples
    --------
    >>> Header({"EXPTIME": 0.5})["exptime"]
    0.5
    """

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, HeaderValue]) -> None:
        self._values = {keyword.upper(): value for keyword, value in values.items()}

    def __getitem__(self, keyword: str) -> HeaderValue:
        return self._values[keyword.upper()]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"Header({self._values!r})"


@dataclass(frozen=True, slots=True, eq=False)
class HeaderGeometry:
    """Pointing and trajectory as the header states them; arrays are read-only.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
        Attitude, so that ``v_camera = camera_from_j2000 @ v_j2000``.
    spacecraft_from_sun_km, spacecraft_velocity_km_s : (3,) array or None
        Spacecraft with respect to the Sun, J2000.
    quality : str
        What the header says of its own geometry ("PREDICT", "RECONSTRUCTED"), or "".
    """

    camera_from_j2000: FloatArray
    spacecraft_from_sun_km: FloatArray | None
    spacecraft_velocity_km_s: FloatArray | None
    quality: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture with its masks, time and header; arrays are read-only and indexed ``[line, pixel]``.

    Attributes
    ----------
    path : Path
    sha256 : str
        Of the file that holds the pixels.
    image_dn : (n_line, n_pixel) array
        Native float64; 0 in pixels without a value, which are `bad` too.
    error_dn : (n_line, n_pixel) array or None
        One-sigma error, positive everywhere.
    bad, saturated : (n_line, n_pixel) bool arrays
        Pixels not to use, and pixels whose value is only a lower bound. A saturated pixel need not be bad.
    header : Header
    exposure_s : float
        nan where no keyword for it is known.
    et : float or None
        Mid-exposure, TDB seconds past J2000.
    utc : str or None
        Mid-exposure, ISO calendar.
    sclk : str or None
        Spacecraft clock as the header has it, never shifted to mid-exposure.
    header_geometry : HeaderGeometry or None
    messages : tuple of str
        What a navigator should know about the file: masked pixels, departures from the standard, doubts.
    """

    path: Path
    sha256: str
    image_dn: FloatArray
    error_dn: FloatArray | None
    bad: BoolArray
    saturated: BoolArray
    header: Header
    exposure_s: float
    et: float | None
    utc: str | None
    sclk: str | None
    header_geometry: HeaderGeometry | None
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def with_saturated(self, saturated: ArrayLike) -> "Frame":
        """Return the same frame with another saturation mask.

        Raises
        ------
        ImageError
            The mask has another shape than the picture.
        """
        mask = np.array(saturated, dtype=bool)
        if mask.shape != self.image_dn.shape:
            raise ImageError(
                f"{self.path.name}: a saturation mask of shape {mask.shape} does not fit a picture of shape "
                f"{self.image_dn.shape}; give one flag a pixel."
            )
        return replace(self, saturated=mask)
