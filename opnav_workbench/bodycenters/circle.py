"""Where a body is expected in the picture, and how large: an analyst's circle or the a priori one."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError

__all__ = ["Circle"]


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle on the detector.

    Attributes
    ----------
    center_px : (2,) array
        (pixel, line); it may lie off the detector.
    radius_px : float

    Raises
    ------
    CenterfindingError
        A center that is not two finite numbers, or a radius that is not positive.

    Examples
    --------
    >>> Circle([511.5, 480.0], 95.0).diameter_px
    190.0
    """

    center_px: FloatArray
    radius_px: float

    def __post_init__(self) -> None:
        center = np.array(self.center_px, dtype=np.float64)
        if center.shape != (2,) or not np.isfinite(center).all():
            raise CenterfindingError(f"circle center is {center.tolist()}; give (pixel, line), finite.")
        if not 0.0 < self.radius_px < np.inf:
            raise CenterfindingError(f"circle radius is {self.radius_px} px; give a positive number.")
        object.__setattr__(self, "center_px", center)
        object.__setattr__(self, "radius_px", float(self.radius_px))
        freeze_arrays(self)

    @property
    def diameter_px(self) -> float:
        """Twice the radius."""
        return 2.0 * self.radius_px
