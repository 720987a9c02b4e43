"""Two characterizations of a step between attitudes (AAS 13-443, "Spacecraft Repointing Solution").

euler        three successive rotations about the camera's pixel, line and boresight axes, applied to the current
             attitude: the Euler angles of the camera-to-inertial rotation, taken where no pole of theirs is near
image_plane  a shift of the picture, and a rotation of it about the boresight's pixel:
             (dS, dL) = t + theta [-(L - L0), S - S0]

Each gives a design matrix (n, 2, 3), d(pixel, line) / d(parameters), a rotation that carries out a step, and `tangent`
(3, 3), d(rotation vector about the camera axes) / d(parameters) at zero.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import least_turn, rotation_from_vector

__all__ = ["POINTING_MODELS", "EulerAngles", "ImagePlane", "PointingModel", "StepModel"]

CURVATURE = (
    30.0  # in units of a pixel's angle: gnomonic planes bend by 1 to 3, strong distortion by some more
)

PointingModel = Literal["euler", "image_plane"]


class StepModel(Protocol):
    """What the least squares needs of a characterization."""

    @property
    def tangent(self) -> FloatArray:
        """Rotation vector per parameter, (3, 3)."""

    def left_px(self, step_px: float) -> float:
        """Return how far, at most, stars may still be off after a step that moved one of them by `step_px`."""

    def design(self, jacobian: FloatArray, predicted_px: FloatArray) -> FloatArray:
        """Return d(pixel, line) / d(parameters), (n, 2, 3), where d(pixel, line) / d(rotation vector) is `jacobian`."""

    def rotation(self, step: FloatArray) -> FloatArray:
        """Return the rotation (3, 3) that carries out `step` (3,): new attitude = rotation @ old."""


@dataclass(frozen=True, slots=True, eq=False)
class EulerAngles:
    """Three successive rotations about the camera's pixel, line and boresight axes."""

    camera: Camera

    @property
    def tangent(self) -> FloatArray:
        """Rotation vector per angle: the axes themselves."""
        return np.asarray(self.camera.focal_from_camera.T)

    def left_px(self, step_px: float) -> float:
        """See `StepModel`; exact derivatives leave the square of the step, in the curvature of the widest field."""
        return CURVATURE * step_px**2 * self.camera.pixel_scale_rad

    def design(self, jacobian: FloatArray, predicted_px: FloatArray) -> FloatArray:  # noqa: ARG002
        """See `StepModel`; exact at zero angles, distortion included."""
        return jacobian @ self.tangent

    def rotation(self, step: FloatArray) -> FloatArray:
        """See `StepModel`; about pixel first, about boresight last."""
        about_pixel, about_line, about_boresight = rotation_from_vector(
            step[:, None] * self.camera.focal_from_camera
        )
        return np.asarray(about_boresight @ about_line @ about_pixel)


@dataclass(frozen=True, slots=True, eq=False)
class ImagePlane:
    """A shift of the picture and a rotation of it about the boresight's pixel."""

    camera: Camera

    @property
    def center_px(self) -> FloatArray:
        """Where the boresight falls, (2,)."""
        return np.asarray(self.camera.project(self.camera.boresight[None])[0])

    @property
    def handedness(self) -> float:
        """+1, or -1 where turning the picture from pixel to line is a negative turn about the boresight."""
        focal, plane = self.camera.focal_from_camera, self.camera.pixel_from_mm
        return float(np.sign(np.linalg.det(focal) * np.linalg.det(plane)))

    @property
    def tangent(self) -> FloatArray:
        """Rotation vector per px of shift along pixel and line, and per rad of rotation."""
        boresight = self.camera.boresight
        moved = self.camera.unproject_jacobian(self.center_px[None])[0]
        shift = np.cross(boresight, moved.T)
        return np.column_stack([shift[0], shift[1], self.handedness * boresight])

    def left_px(self, step_px: float) -> float:
        """See `StepModel`; a design without distortion leaves a part of the step itself."""
        return step_px

    def design(self, jacobian: FloatArray, predicted_px: FloatArray) -> FloatArray:
        """See `StepModel`; holds for an undistorted plane, and by iteration for a distorted one."""
        if self.camera.sweep is not None:  # its picture is no plane that turns as a whole
            return jacobian @ self.tangent
        design = np.zeros((len(predicted_px), 2, 3))
        design[:, 0, 0] = design[:, 1, 1] = 1.0
        offset = predicted_px - self.center_px
        design[:, 0, 2], design[:, 1, 2] = -offset[:, 1], offset[:, 0]
        return design

    def rotation(self, step: FloatArray) -> FloatArray:
        """See `StepModel`; the picture is turned, then the boresight carried to its shifted pixel."""
        boresight = self.camera.boresight
        turned = rotation_from_vector(self.handedness * step[2] * boresight)
        target = self.camera.unproject((self.center_px + step[:2])[None])[0]
        return np.asarray(rotation_from_vector(least_turn(boresight, target)) @ turned)


POINTING_MODELS: dict[str, type[EulerAngles] | type[ImagePlane]] = {
    "euler": EulerAngles,
    "image_plane": ImagePlane,
}
