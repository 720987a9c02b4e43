"""How the camera points while it exposes: attitudes at a few times, as many as its motion asks for.

Flow    attitude as a function of time (CK, or a fixed attitude that drifts and shakes) -> samples `AttitudePath`
        -> places of stars along it (`places`) -> trails
Frame   ``camera_from_j2000``; offsets in px as (pixel, line)
Units   TDB s past J2000, s, px, rad

The samples stand in the middle of equal parts of the exposure; their number is odd, so that one is at mid-exposure.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.kernels import camera_attitude
from opnav_workbench.simulation.randomness import picture_random

__all__ = ["AttitudePath", "CameraMotion", "kernel_path", "moving_path", "sample_path", "sky_turn"]

STILL_PX = 0.02  # less motion than this is no trail: a star's width grows by 1e-4 of it
STEP_PX = 0.25  # longest step: the steps then widen a trail's end by less than 0.01 px
FEWEST, MOST = 9, 4001  # samples; the fewest that show a motion at all, and a limit for runaway rates
JITTER_TERMS = 24  # sinusoids that make up a random shake
LOWEST_BAND = 0.1  # of jitter_hz: the shake's power lies between this part of it and the whole


@dataclass(frozen=True, slots=True, eq=False)
class AttitudePath:
    """Attitudes over an exposure; arrays are read-only.

    Attributes
    ----------
    et : (k,) array
        Times of the samples, k odd.
    camera_from_j2000 : (k, 3, 3) array
    weights : (k,) array
        Share of the exposure that each stands for; they sum to 1.
    """

    et: FloatArray
    camera_from_j2000: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.et)

    @property
    def middle(self) -> FloatArray:
        """The attitude (3, 3) at mid-exposure."""
        return np.asarray(self.camera_from_j2000[len(self) // 2])

    @property
    def is_still(self) -> bool:
        """Whether the camera does not move."""
        return len(self) == 1

    def places(self, camera: Camera, directions: ArrayLike) -> FloatArray:
        """Return where directions fall (n, k, 2), px, at every sample.

        Parameters
        ----------
        directions : (n, 3) or (n, k, 3) array_like
            J2000 vectors, the same at every sample or not.
        """
        vectors = np.asarray(directions, dtype=np.float64)
        if vectors.ndim == 2:
            in_camera = np.einsum("kij,nj->nki", self.camera_from_j2000, vectors)
        else:
            in_camera = np.einsum("kij,nkj->nki", self.camera_from_j2000, vectors)
        return np.asarray(camera.project(in_camera))

    def offsets_px(self, camera: Camera) -> FloatArray:
        """Return how the boresight's sky moves on the detector (k, 2), px, from mid-exposure."""
        track = self.places(camera, [self.middle.T @ camera.boresight])[0]
        return np.asarray(track - track[len(self) // 2])

    def turned(self, camera_from_camera: ArrayLike) -> "AttitudePath":
        """Return the path of a camera that is misaligned by a rotation (3, 3), the same at all times."""
        return AttitudePath(self.et, np.asarray(camera_from_camera) @ self.camera_from_j2000, self.weights)


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """Drift and shake during the exposure, as the sky shows them on the detector.

    Attributes
    ----------
    rate_px_s : (float, float)
        Of the boresight's sky along pixel and line.
    twist_rate_deg_s
        Of the sky about the boresight, from +pixel toward +line.
    jitter_px
        1 sigma of each axis.
    jitter_hz
        The shake's power lies between a tenth of this frequency and this one.
    """

    rate_px_s: tuple[float, float] = (0.0, 0.0)
    twist_rate_deg_s: float = 0.0
    jitter_px: float = 0.0
    jitter_hz: float = 5.0

    def offsets(self, time_s: ArrayLike, seed: int) -> FloatArray:
        """Return pixel, line (px) and twist (rad) offsets (..., 3) at times (...,) from mid-exposure."""
        t = np.asarray(time_s, dtype=np.float64)[..., None]
        drift = t * np.array([*self.rate_px_s, np.radians(self.twist_rate_deg_s)])
        return np.asarray(drift if self.jitter_px == 0.0 else drift + self._shake(t, seed))

    def _shake(self, t: FloatArray, seed: int) -> FloatArray:
        rng = picture_random(seed, "jitter")
        hz = self.jitter_hz * rng.uniform(LOWEST_BAND, 1.0, (2, JITTER_TERMS))
        phase = rng.uniform(0.0, 2.0 * np.pi, (2, JITTER_TERMS))
        amplitude = self.jitter_px * np.sqrt(2.0 / JITTER_TERMS)
        waves = np.sin(2.0 * np.pi * hz * t[..., None] + phase).sum(axis=-1)
        return np.concatenate([amplitude * waves, np.zeros_like(t)], axis=-1)


def kernel_path(
    camera: Camera,
    et: float,
    exposure_s: float,
    *,
    motion: CameraMotion | None = None,
    seed: int = 0,
    frame: str | None = None,
) -> AttitudePath:
    """Return the path that the open kernels' CK gives, with a motion added if one is given.

    Parameters
    ----------
    et
        Mid-exposure.
    seed
        Of the jitter.
    frame
        SPICE frame; the camera's own unless given.

    Raises
    ------
    KernelError
        The attitude is not known during the whole exposure.
    """
    name = camera.frame if frame is None else frame

    def attitude(time: float) -> FloatArray:
        return camera_attitude(name, time)

    return sample_path(camera, attitude, et, exposure_s, motion=motion, seed=seed)


def moving_path(
    camera: Camera,
    attitude: ArrayLike,
    et: float,
    exposure_s: float,
    *,
    motion: CameraMotion | None = None,
    seed: int = 0,
) -> AttitudePath:
    """Return the path of a camera that has `attitude` at mid-exposure, but for its shake, and drifts from there."""
    fixed = np.array(attitude, dtype=np.float64)
    return sample_path(camera, lambda _: fixed, et, exposure_s, motion=motion, seed=seed)


def sample_path(
    camera: Camera,
    attitude_at: Callable[[float], FloatArray],
    et: float,
    exposure_s: float,
    *,
    motion: CameraMotion | None = None,
    seed: int = 0,
) -> AttitudePath:
    """Sample an attitude over an exposure so that no point of the sky moves by more than `STEP_PX` between samples.

    A camera that moves by less than `STILL_PX` has one sample, at mid-exposure.

    Parameters
    ----------
    attitude_at
        ``camera_from_j2000`` (3, 3) at a time.
    et, exposure_s
        Mid-exposure and its length.
    motion
        Added to the attitude.
    seed
        Of the jitter.
    """
    moves = motion or CameraMotion()
    count = max(FEWEST, _shake_samples(moves, exposure_s))
    while True:
        path = _sampled(camera, attitude_at, et, exposure_s, moves, seed, count)
        tracks = _corner_tracks(camera, path)
        extent = np.ptp(tracks, axis=1).max()
        if not extent > STILL_PX:
            return AttitudePath(path.et[[count // 2]], path.middle[None], np.ones(1))
        step = np.linalg.norm(np.diff(tracks, axis=1), axis=-1).max()
        if step <= STEP_PX or count >= MOST:
            return path
        count = min(MOST, 2 * int(np.ceil(0.5 * count * step / STEP_PX)) + 1)


def _shake_samples(motion: CameraMotion, exposure_s: float) -> int:
    """Return an odd number of samples that resolves the shake: eight a period."""
    if motion.jitter_px == 0.0:
        return 1
    return min(MOST, 2 * int(4.0 * motion.jitter_hz * exposure_s) + 1)


def _sampled(
    camera: Camera,
    attitude_at: Callable[[float], FloatArray],
    et: float,
    exposure_s: float,
    motion: CameraMotion,
    seed: int,
    count: int,
) -> AttitudePath:
    time_s = exposure_s * ((np.arange(count) - count // 2) / count)
    attitudes = np.stack([attitude_at(et + t) for t in time_s])
    offsets = motion.offsets(time_s, seed)
    if offsets.any():
        attitudes = sky_turn(camera, offsets) @ attitudes
    return AttitudePath(et + time_s, attitudes, np.full(count, 1.0 / count))


def sky_turn(camera: Camera, offsets: ArrayLike) -> FloatArray:
    """Return the rotations (..., 3, 3), camera frame, that move the sky at the boresight.

    Parameters
    ----------
    offsets : (..., 3) array_like
        By how much along pixel and line, px, and about the boresight from +pixel toward +line, rad.
    """
    moved = np.asarray(offsets, dtype=np.float64)
    mm = moved[..., :2] @ np.linalg.inv(camera.pixel_from_mm).T / camera.focal_length_mm
    pixel_axis, line_axis, boresight = camera.focal_from_camera
    # d(boresight) = w x boresight for a small turn w: w = boresight x d(boresight). A mirrored camera's boresight is
    # not pixel x line; its twist runs the other way.
    shift = mm[..., :1] * pixel_axis + mm[..., 1:] * line_axis
    hand = np.sign(np.linalg.det(camera.focal_from_camera))
    return rotation_from_vector(np.cross(boresight, shift) + hand * moved[..., 2:] * boresight)


def _corner_tracks(camera: Camera, path: AttitudePath) -> FloatArray:
    """Return the tracks (5, k, 2), px, of the sky at the middle and in the corners."""
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]) * [camera.n_pixel - 1, camera.n_line - 1]
    tracks = path.places(camera, camera.unproject(corners) @ path.middle)
    return tracks[np.isfinite(tracks).all(axis=(1, 2))]
