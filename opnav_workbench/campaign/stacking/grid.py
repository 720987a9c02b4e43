"""The grid of a stack: pixels of a reference camera, and where each of them lies in every picture.

    grid pixel -> reference camera -> J2000 -> aberration, or the target's motion -> picture's attitude -> its camera

Both cameras' distortions are in it, so pictures of any pointing and twist fall on each other. A grid that follows the
target turns with the direction in which ephemeris expects it: what it holds still is the target's O-C.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, geometric_direction, rotation_from_vector

__all__ = ["Follow", "Grid", "target_direction"]

Follow = Literal["stars", "target"]


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Pixels of a stack; arrays are read-only.

    Attributes
    ----------
    camera : Camera
    camera_from_j2000 : (3, 3) array
    observer_velocity_km_s : (3,) array
    follow : {"stars", "target"}
    target : (3,) array or None
        Apparent direction of the target at the stack's epoch, J2000.
    first : (2,) array of int
        (pixel, line) of the grid's first pixel in the reference camera.
    shape : (int, int)
        (n_line, n_pixel) of the grid.
    """

    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    follow: Follow
    target: FloatArray | None
    first: FloatArray
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if self.follow == "target" and self.target is None:
            raise CenterfindingError("a grid that follows the target needs its direction.")
        freeze_arrays(self)

    def centers(self) -> FloatArray:
        """Return the pixels' places in the reference camera (n, 2), line by line."""
        line, pixel = np.indices(self.shape)
        return np.asarray(np.stack([pixel.ravel(), line.ravel()], axis=1) + self.first, dtype=np.float64)

    def index(self, pixel_line: FloatArray) -> FloatArray:
        """Return places (..., 2) of the reference camera as (pixel, line) of the grid's own arrays."""
        return np.asarray(pixel_line - self.first)

    def to_frame(self, pixel_line: FloatArray, frame: StackFrame) -> FloatArray:
        """Return where places (n, 2) of the reference camera lie in a picture (n, 2); nan out of sight."""
        apparent = self.camera.unproject(pixel_line) @ self.camera_from_j2000
        there = self._seen(apparent, frame)
        return np.asarray(frame.camera.project(there @ frame.camera_from_j2000.T))

    def from_frame(self, pixel_line: FloatArray, frame: StackFrame) -> FloatArray:
        """Return where places (n, 2) of a picture lie in the reference camera (n, 2); nan out of sight."""
        there = frame.camera.unproject(pixel_line) @ frame.camera_from_j2000
        if self.follow == "target":
            here = there @ self._turn(frame)
        else:
            geometric = geometric_direction(there, frame.observer_velocity_km_s)
            here = apparent_direction(geometric, self.observer_velocity_km_s)
        return np.asarray(self.camera.project(here @ self.camera_from_j2000.T))

    def jacobian(self, pixel_line: FloatArray, frame: StackFrame) -> FloatArray:
        """Return d(place in the picture)/d(place in the reference camera), (n, 2, 2).

        Aberration changes by 1e-4 over the sky; over a pixel it does not count.
        """
        apparent = self.camera.unproject(pixel_line) @ self.camera_from_j2000
        turned = frame.camera_from_j2000 @ (self._turn(frame) if self.follow == "target" else np.eye(3))
        there = self._seen(apparent, frame) @ frame.camera_from_j2000.T
        inward = self.camera.unproject_jacobian(pixel_line)
        return np.asarray(frame.camera.project_jacobian(there) @ turned @ self.camera_from_j2000.T @ inward)

    def _seen(self, apparent: FloatArray, frame: StackFrame) -> FloatArray:
        """Directions (n, 3) as the other picture's spacecraft sees what is there at the stack's epoch."""
        if self.follow == "target":
            return np.asarray(apparent @ self._turn(frame).T)
        geometric = geometric_direction(apparent, self.observer_velocity_km_s)
        return apparent_direction(geometric, frame.observer_velocity_km_s)

    def _turn(self, frame: StackFrame) -> FloatArray:
        """Smallest rotation that carries the target's direction at the stack's epoch to that in the picture."""
        assert self.target is not None
        there = target_direction(frame)
        axis = np.cross(self.target, there)
        sine = float(np.linalg.norm(axis))
        if sine == 0.0:
            return np.eye(3)
        return rotation_from_vector(axis / sine * np.arctan2(sine, float(self.target @ there)))


def target_direction(frame: StackFrame) -> FloatArray:
    """Return the apparent direction (3,), J2000, in which a picture's target is expected."""
    assert frame.target is not None
    return apparent_direction(frame.target.direction, frame.observer_velocity_km_s)
