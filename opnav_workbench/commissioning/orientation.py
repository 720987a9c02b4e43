"""How a detector lies in its camera's frame: the eight ways, told by the stars or by the limb of a picture.

The boresight is taken as known; pixel and line then run along two of four directions, in eight ways, four of which show the
sky mirrored. Stars identified without any attitude tell the whole at once, where header or kernels say how the camera's
frame stood; without that they tell only whether the picture is mirrored. Where there are no stars enough, a body of known
place and lighting is drawn in each of the eight ways and compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import Catalog
from opnav_workbench.kernels import camera_attitude
from opnav_workbench.scene import Observer, predict_body
from opnav_workbench.session.context import Context
from opnav_workbench.session.star_field import star_detections
from opnav_workbench.stars.lost_in_space import index_of_catalog, solve_lost
from opnav_workbench.targets import TargetState

__all__ = ["Orientation", "eight_cameras", "orientation_by_limb", "orientation_by_stars", "scanning_cameras"]

NEAR_DEG = 10.0  # a header's or a kernel's attitude is better than this where it is one
CLEARLY = 0.05  # by how much the best of eight drawings must be more alike the picture than the second
ALIKE = 0.6  # and how alike at least
NEAR_PX = 3.0  # a priori sigmas that a body may lie off
LEAST_DIAMETER_PX, DRAWN_ACROSS_PX = 12.0, 160
AMBIENT = 0.02  # of full light on what the Sun does not reach, so that a drawing is never empty


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """How the detector lies, and what told it.

    Attributes
    ----------
    camera
        The camera with these axes.
    changed
        Whether they are not the ones that were assumed.
    mirrored
        Whether the picture is the mirror image of what was assumed.
    sure
        Whether all was told: against the camera's frame, too.
    inverse_quaternion
        Whether the header's quaternion turns the other way than was assumed.
    text
        For a person.
    """

    camera: Camera
    changed: bool
    mirrored: bool
    sure: bool
    text: str
    inverse_quaternion: bool = False


def eight_cameras(camera: Camera) -> list[Camera]:
    """Return the camera with its detector in each of eight ways about the boresight, the given one first."""
    pixel, line, boresight = camera.focal_from_camera
    ways = [(a * p, b * q) for p, q in ((pixel, line), (line, pixel)) for a in (1, -1) for b in (1, -1)]
    return [replace(camera, focal_from_camera=np.stack([p, q, boresight])) for p, q in ways]


# ---- By the stars.


def orientation_by_stars(
    context: Context, catalog: Catalog, frames: Sequence[FloatArray]
) -> Orientation | None:
    """Return how the detector lies by the stars of a picture; None where these are not identified.

    Parameters
    ----------
    context
        The picture, opened with a camera of any of the eight orientations.
    catalog
        Of the whole sky.
    frames : sequence of (3, 3) arrays
        What header or kernels say how the camera's frame stands (frame from J2000), the first the likeliest.
    """
    camera = context.camera
    answer = solve_lost(index_of_catalog(catalog), star_detections(context), camera)
    solved = answer.camera_from_j2000 if answer.mirrored is None else answer.mirrored
    if solved is None:
        return None
    mirrored = answer.mirrored is not None
    axes = camera.focal_from_camera * (np.array([[1.0], [-1.0], [1.0]]) if mirrored else 1.0)
    detector_from_j2000 = axes @ solved
    for number, frame in enumerate(frames):
        found = _nearest(camera, detector_from_j2000 @ frame.T)
        if found is not None:
            changed = not np.allclose(found.focal_from_camera, camera.focal_from_camera)
            return Orientation(found, changed, mirrored, True, answer.message, number == 1)
    handed = replace(camera, focal_from_camera=axes)
    why = (
        "no attitude to compare with"
        if not len(frames)
        else "the attitude told is none of this camera's frame"
    )
    return Orientation(
        handed, mirrored, mirrored, False, f"{answer.message}; {why}: only whether it is mirrored is told"
    )


def _nearest(camera: Camera, focal_from_frame: FloatArray) -> Camera | None:
    """The one of the eight cameras whose axes are these, within the error of an attitude."""
    for other in eight_cameras(camera):
        between = focal_from_frame @ other.focal_from_camera.T
        if float(np.trace(between)) > 1.0 + 2.0 * np.cos(np.radians(NEAR_DEG)):
            return other
    return None


# ---- Of a line scan.


def scanning_cameras(camera: Camera, et: float) -> list[Camera]:
    """Return those of the eight ways in which the camera's motion, by the loaded kernels, makes the lines of a scan.

    The sky moves along the lines' axis then. Which sign that axis has no picture tells, as all lines are one line of the
    detector: it is the one by which a later line is further on, as on a detector at rest.
    """
    rows = camera.rows
    assert rows is not None
    half_s = 0.5 * rows.line_time_s
    before, after = (camera_attitude(camera.frame, et + time_s) for time_s in (-half_s, half_s))
    moved = after @ before.T @ camera.boresight - camera.boresight
    ways = []
    for way in eight_cameras(camera):
        pixel, line, _ = way.focal_from_camera @ moved
        if -line > abs(pixel):
            ways.append(way)
    return ways


# ---- By the limb.


def orientation_by_limb(
    context: Context, target: TargetState, observer: Observer, camera_from_j2000: FloatArray
) -> Orientation | None:
    """Return how the detector lies by the lit disk of a body; None where the eight drawings are too much alike.

    Parameters
    ----------
    camera_from_j2000 : (3, 3) array
        The camera's frame, as header or kernels have it.
    """
    cameras = eight_cameras(context.camera)
    likeness = [_likeness(context, c, target, observer, camera_from_j2000) for c in cameras]
    order = np.argsort(likeness)[::-1]
    best, second = float(likeness[order[0]]), float(likeness[order[1]])
    if not (best > ALIKE and best - second > CLEARLY):
        return None
    camera = cameras[order[0]]
    hands = [np.sign(np.linalg.det(c.focal_from_camera)) for c in (camera, context.camera)]
    text = f"{target.name} as drawn is alike the picture to {best:.2f}, in the second of eight ways to {second:.2f}"
    return Orientation(camera, bool(order[0] != 0), hands[0] != hands[1], True, text)


def _likeness(
    context: Context, camera: Camera, target: TargetState, observer: Observer, attitude: FloatArray
) -> float:
    """The highest correlation of the picture with a drawing of the body, near where it is expected."""
    body = predict_body(target, observer, camera, attitude)
    if (
        not (body.diameter_px > LEAST_DIAMETER_PX and np.isfinite(body.pixel_line).all())
        or target.sun_position_km is None
    ):
        return 0.0
    step = max(1, int(np.ceil(body.diameter_px / DRAWN_ACROSS_PX)))
    image = np.clip(context.signal_dn, 0.0, None)[::step, ::step]
    disk = _lit_disk(camera, attitude, target, 0.5 * body.diameter_px / step)
    alike = _correlation(image, disk)
    line, pixel = np.indices(alike.shape)
    off = np.hypot(pixel - body.pixel_line[0] / step, line - body.pixel_line[1] / step) * step
    reach = NEAR_PX * camera.attitude_sigma.cross_px + 0.1 * body.diameter_px
    return float(np.max(alike * np.exp(-0.5 * (off / reach) ** 2), initial=0.0))


def _lit_disk(camera: Camera, attitude: FloatArray, target: TargetState, radius_px: float) -> FloatArray:
    """A Lambert sphere as the detector sees it, with a rim of sky."""
    toward = np.asarray(target.sun_position_km)
    sun = camera.focal_from_camera @ attitude @ (toward / np.linalg.norm(toward))
    half = int(np.ceil(1.3 * radius_px))
    line, pixel = np.mgrid[-half : half + 1, -half : half + 1] / radius_px
    inside = pixel**2 + line**2 < 1.0
    depth = -np.sqrt(np.where(inside, 1.0 - pixel**2 - line**2, 0.0))  # normals point back to the camera
    light = np.clip(pixel * sun[0] + line * sun[1] + depth * sun[2], 0.0, None) + AMBIENT
    return np.where(inside, light, 0.0)


def _correlation(image: FloatArray, drawing: FloatArray) -> FloatArray:
    """The normalized correlation of a drawing with the picture around each pixel."""
    pattern = drawing - drawing.mean()
    count, norm = pattern.size, float(np.sqrt((pattern**2).sum()))
    box = np.ones_like(pattern)
    total, square = (fftconvolve(values, box, mode="same") for values in (image, image**2))
    spread = np.sqrt(np.clip(square - total**2 / count, 0.0, None))
    product = fftconvolve(image, pattern[::-1, ::-1], mode="same")
    floor = 1e-6 * float(spread.max(initial=0.0)) + np.finfo(float).tiny
    return np.asarray(product / (norm * np.maximum(spread, floor)))
