"""Reseau marks: dots on the faceplate of a vidicon, whose places in a raw picture tell how its tube bends it."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError

__all__ = ["FEWEST_MARKS", "Reseau"]

FEWEST_MARKS = 40  # for polynomials of ten terms each way


@dataclass(frozen=True, slots=True, eq=False)
class Reseau:
    """Marks of a camera's faceplate.

    Attributes
    ----------
    marks_px : (n, 2) array
        About where they stand in a raw picture, (pixel, line).
    ideal_mm : (n, 2) array
        Where they stand on the focal plane, without distortion, from the boresight along pixel and line.

    Raises
    ------
    CameraError
        Not as many of the one as of the other, or too few.
    """

    marks_px: FloatArray
    ideal_mm: FloatArray

    def __post_init__(self) -> None:
        for name in ("marks_px", "ideal_mm"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64).reshape(-1, 2))
        if len(self.marks_px) != len(self.ideal_mm) or len(self.marks_px) < FEWEST_MARKS:
            raise CameraError(
                f"reseau: {len(self.marks_px)} places and {len(self.ideal_mm)} ideal ones; give as many of both, "
                f"{FEWEST_MARKS} at least."
            )
        freeze_arrays(self)
