"""The stars of many frames of one camera, as arrays."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CameraError

__all__ = ["MIN_STARS", "StarFrames"]

MIN_STARS = 2  # of a frame: with fewer its own three angles are not determined


@dataclass(frozen=True, slots=True, eq=False)
class StarFrames:
    """Measured centers of n identified stars on m frames; arrays are read-only.

    Attributes
    ----------
    names : tuple of str
        The frames, m.
    frame : (n,) array of int
        Which frame a star is on.
    observed_px : (n, 2) array
        Measured centers (pixel, line).
    covariance_px2 : (n, 2, 2) array
        Of the center and of the catalog place together.
    directions : (n, 3) array
        Apparent directions, J2000.
    attitudes : (m, 3, 3) array
        Solved camera_from_j2000, to start from.
    a_priori : (m, 3, 3) array
        The same before any star was seen, from the kernels or the header.

    Raises
    ------
    CameraError
        Arrays that do not fit together, or values that are not finite.
    """

    names: tuple[str, ...]
    frame: IntArray
    observed_px: FloatArray
    covariance_px2: FloatArray
    directions: FloatArray
    attitudes: FloatArray
    a_priori: FloatArray

    def __post_init__(self) -> None:
        n, m = len(self.frame), len(self.names)
        shapes = {
            "observed_px": (n, 2),
            "covariance_px2": (n, 2, 2),
            "directions": (n, 3),
            "attitudes": (m, 3, 3),
            "a_priori": (m, 3, 3),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise CameraError(
                    f"star frames: {name} must be finite of shape {shape}, it is {array.shape}."
                )
        if n and not (self.frame.min() >= 0 and self.frame.max() < m):
            raise CameraError(f"star frames: frame numbers must be 0..{m - 1}.")
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.names)
