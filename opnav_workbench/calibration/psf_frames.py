"""Frames for a PSF stack, and which of them show stars of one shape."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.starcenters import NoiseModel, StarCenters

__all__ = ["PsfFrame", "gaussian_of", "moments", "same_shape"]

# Second moments, pixel included, that differ by more than this part are those of another smear or focus: a stack of both
# would fit neither to better than the Gaussian does.
SHAPE_TOLERANCE = 0.2
PIXEL_VARIANCE_PX2 = 1.0 / 12.0
MIN_SIGMA_PX = 0.15  # below this a Gaussian is one pixel, whatever its sigma


@dataclass(frozen=True, slots=True, eq=False)
class PsfFrame:
    """One frame and its bright, isolated stars; arrays are read-only.

    Attributes
    ----------
    name : str
    signal_dn, noise_dn : (n_line, n_pixel) arrays
        Picture without background, and its 1-sigma noise without the stars' own.
    bad : (n_line, n_pixel) array of bool
        Pixels to leave out, also saturated ones.
    pixel_line : (n, 2) array
        First centers, good to a pixel.
    noise_model : NoiseModel or None
        For the stars' shot noise.
    """

    name: str
    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    pixel_line: FloatArray
    noise_model: NoiseModel | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def moments(fit: StarCenters) -> FloatArray:
    """Return second moments (n, 3) px^2 of fitted shapes: along pixel, mixed, along line; usable stars only."""
    major2, minor2, angle = fit.shape[:, 0] ** 2, fit.shape[:, 1] ** 2, fit.shape[:, 2]
    mean, half = 0.5 * (major2 + minor2), 0.5 * (major2 - minor2)
    even, odd = half * np.cos(2.0 * angle), half * np.sin(2.0 * angle)
    return np.stack([mean + even, odd, mean - even], axis=1)[fit.usable]


def gaussian_of(second_moments: FloatArray) -> GaussianPsf:
    """Return the Gaussian of second moments (3,)."""
    along, mixed, across = second_moments
    values, axes = np.linalg.eigh(np.array([[along, mixed], [mixed, across]]))
    minor, major = np.sqrt(np.maximum(values, MIN_SIGMA_PX**2))
    return GaussianPsf(float(major), float(minor), float(np.arctan2(axes[1, 1], axes[0, 1])))


def same_shape(frames: Sequence[PsfFrame], fits: Sequence[StarCenters]) -> tuple[BoolArray, tuple[str, ...]]:
    """Return which frames (m,) have stars of the commonest shape, and a word on each of the others."""
    of_frame = [moments(fit) for fit in fits]
    common = np.median(np.concatenate(of_frame), axis=0) if sum(map(len, of_frame)) else np.zeros(3)
    size = 0.5 * (common[0] + common[2]) + PIXEL_VARIANCE_PX2
    used, words = np.zeros(len(frames), dtype=bool), []
    for i, (frame, own) in enumerate(zip(frames, of_frame, strict=True)):
        if not len(own):
            words.append(f"{frame.name}: no bright star, left out")
            continue
        shape = np.median(own, axis=0)
        used[i] = bool(np.abs(shape - common).max() <= SHAPE_TOLERANCE * size)
        if not used[i]:
            mine = gaussian_of(shape)
            words.append(
                f"{frame.name}: its stars are of another shape ({mine.sigma_major_px:.2f} x {mine.sigma_minor_px:.2f} px), "
                "smeared perhaps; left out"
            )
    return used, tuple(words)
