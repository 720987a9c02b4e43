"""Cosmic rays: straight tracks of charge, isotropic, through the layer of silicon that collects it.

The flux through a surface from direction (zenith angle theta) goes as cos(theta), so that sin^2(theta) is uniform; a
track of a layer of depth d is d tan(theta) long on the detector, and its path in silicon is d / cos(theta).
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.simulation.effects import CosmicRays

__all__ = ["CosmicRayHits", "draw_cosmic_rays"]

DEEP_SPACE_PER_CM2_S = 4.0  # galactic protons and nuclei near solar minimum, through a surface
STEP_PX = 0.2  # a track is laid down in steps of this length
MM_PER_CM, UM_PER_MM = 10.0, 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class CosmicRayHits:
    """The particles that hit the detector.

    Attributes
    ----------
    start_px, end_px : (n, 2) arrays
        Ends of the tracks on the detector, (pixel, line).
    electrons : (n,) array
        Charge of each, whole numbers, whether it falls on the detector or beside it.
    """

    start_px: FloatArray
    end_px: FloatArray
    electrons: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.electrons)

    @property
    def length_px(self) -> FloatArray:
        """Lengths of the tracks (n,)."""
        return np.asarray(np.hypot(*(self.end_px - self.start_px).T))

    @classmethod
    def none(cls) -> "CosmicRayHits":
        """Return no hits."""
        return cls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))

    def charge(self, shape: tuple[int, int]) -> FloatArray:
        """Return the electrons (n_line, n_pixel) that the tracks leave."""
        count = np.maximum(1, np.ceil(self.length_px / STEP_PX).astype(np.int64))
        track = np.repeat(np.arange(len(self)), count)
        step = np.arange(len(track)) - np.repeat(np.cumsum(count) - count, count)
        along = ((step + 0.5) / count[track])[:, None]
        places = np.rint(self.start_px[track] + along * (self.end_px - self.start_px)[track]).astype(np.int64)
        size = np.array(shape[::-1])
        inside = ((places >= 0) & (places < size)).all(axis=1)
        pixel, line = places[inside].T
        share = (self.electrons / count)[track][inside]
        summed = np.bincount(line * shape[1] + pixel, weights=share, minlength=shape[0] * shape[1])
        return np.asarray(np.rint(summed.reshape(shape)))


def draw_cosmic_rays(
    settings: CosmicRays, camera: Camera, open_s: float, rng: np.random.Generator
) -> CosmicRayHits:
    """Draw the particles of a picture.

    Parameters
    ----------
    settings : CosmicRays
    camera : Camera
        Its pixel size turns rates per area into rates per pixel, and tracks into pixels.
    open_s : float
        Time during which charge lies on the detector.
    rng : numpy.random.Generator
    """
    pixel_mm = 1.0 / np.sqrt(abs(np.linalg.det(camera.pixel_from_mm)))
    rate = settings.rate_per_px_s
    if rate is None:
        per_area = settings.rate_per_cm2_s
        per_area = DEEP_SPACE_PER_CM2_S if per_area is None else per_area
        rate = per_area * (pixel_mm / MM_PER_CM) ** 2
    n = int(rng.poisson(rate * camera.n_pixel * camera.n_line * open_s))
    uniform = rng.random((n, 4))
    start = uniform[:, :2] * [camera.n_pixel, camera.n_line] - 0.5
    cosine = np.sqrt(1.0 - uniform[:, 2])  # sin^2(theta) is uniform
    path_px = settings.depth_um / UM_PER_MM / pixel_mm / cosine
    path_px = np.minimum(path_px, settings.longest_px)
    azimuth = 2.0 * np.pi * uniform[:, 3]
    length = path_px * np.sqrt(1.0 - cosine**2)
    end = start + length[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    loss = settings.electrons_per_um * np.exp(settings.spread * rng.standard_normal(n))
    return CosmicRayHits(start, end, np.rint(loss * path_px * pixel_mm * UM_PER_MM))
