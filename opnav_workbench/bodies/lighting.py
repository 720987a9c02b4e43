"""Where the Sun stands over a body, told by its disk alone: phase angle, and direction in the picture.

A sphere with the light of two laws, of any share, is laid over the circle; place and size may give way, since a circle by
hand is not exact. Albedo is taken as even: a pattern of half its contrast turns the answer by some degrees.

Frame  angles in the picture from +pixel toward +line
Units  px, rad
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.picture import Circle
from opnav_workbench.errors import CenterfindingError

__all__ = ["Lighting", "fit_lighting"]

CELLS = 40  # across the window: the shading is smooth
WINDOW_RADII = 1.3
SOFT = 0.15  # of the disk's brightness: what differs by more is no shading of an even sphere
PHASES_RAD = np.radians([10.0, 40.0, 70.0, 100.0, 130.0])
AZIMUTHS = 12
LOG_SIZES = (-0.1, 0.0, 0.1)  # a thin crescent is missed by a circle that is off by its width
MOST_FITS = 6
CIRCLE_SIGMA = 0.1  # of the radius: what a circle by hand is off by, in place and size
SMALLEST_RADIUS_PX = 3.0


@dataclass(frozen=True, slots=True)
class Lighting:
    """How a body is lit.

    Attributes
    ----------
    phase_rad
        Angle Sun - body - camera.
    sun_angle_rad
        Direction toward the Sun in the picture.
    unexplained
        Share of the light's scatter that the sphere does not explain, 0 to 1.
    """

    phase_rad: float
    sun_angle_rad: float
    unexplained: float


def fit_lighting(signal_dn: FloatArray, bad: BoolArray, circle: Circle) -> Lighting:
    """Return how a body in a circle is lit.

    Parameters
    ----------
    signal_dn : (n_line, n_pixel) array
        Picture above the sky.
    bad : (n_line, n_pixel) array of bool
    circle
        Around the body, good to about a tenth of its radius.

    Raises
    ------
    CenterfindingError
        The circle is too small, or nothing of it is in the picture or bright.

    Examples
    --------
    >>> line, pixel = np.mgrid[:100, :100]
    >>> x, y = (pixel - 50.0) / 30.0, (line - 50.0) / 30.0
    >>> z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    >>> light = np.where(z > 0.0, 100.0 * np.maximum(0.8 * y + 0.6 * z, 0.0), 0.0)
    >>> found = fit_lighting(light, np.zeros((100, 100), dtype=bool), Circle([50.0, 50.0], 31.0))
    >>> round(np.degrees(found.sun_angle_rad)), round(np.degrees(found.phase_rad))
    (90, 54)
    """
    seen, place = _cells(signal_dn, bad, circle)
    # Of cells: a cosmic ray is none of the disk
    bright = float(np.quantile(seen, 0.98)) if seen.size else 0.0
    if not bright > 0.0:
        raise CenterfindingError("no light in the circle; draw it around the body.")
    seen = seen / bright

    def residual(unknown: FloatArray) -> FloatArray:
        images = _laws(place, unknown)
        share, *_ = np.linalg.lstsq(images.T @ images + 1e-9 * np.eye(2), images.T @ seen, rcond=None)
        pull = unknown[2:] / CIRCLE_SIGMA
        # The circle weighs as much as a few cells that are off by what counts as soft.
        return np.concatenate([seen - images @ share, SOFT * pull])

    starts = [
        np.array([g * np.cos(a), g * np.sin(a), 0.0, 0.0, size])
        for size in LOG_SIZES
        for g in PHASES_RAD
        for a in np.linspace(0.0, 2.0 * np.pi, AZIMUTHS, endpoint=False)
    ]
    costs = [float(np.sum(np.log1p((residual(start) / SOFT) ** 2))) for start in starts]
    best = [starts[i] for i in np.argsort(costs)[:MOST_FITS]]
    fits = [least_squares(residual, start, loss="cauchy", f_scale=SOFT, max_nfev=60) for start in best]
    fit = min(fits, key=lambda found: float(found.cost))
    phase = float(np.hypot(*fit.x[:2]))
    rest = residual(fit.x)[: len(seen)]
    return Lighting(
        min(phase, np.pi), float(np.arctan2(fit.x[1], fit.x[0])), float(min(1.0, rest.var() / seen.var()))
    )


def _cells(signal_dn: FloatArray, bad: BoolArray, circle: Circle) -> tuple[FloatArray, FloatArray]:
    """Return the mean light of cells (n,) around the circle, and their places (n, 2) from its center in radii."""
    if circle.radius_px < SMALLEST_RADIUS_PX:
        raise CenterfindingError(
            f"a circle of {circle.radius_px:.1f} px is too small to tell how the body is lit; state phase and Sun."
        )
    size = max(1, int(2.0 * WINDOW_RADII * circle.radius_px / CELLS))
    half = int(np.ceil(WINDOW_RADII * circle.radius_px / size))
    corner = np.round(circle.center_px).astype(int) - half * size
    count = 2 * half * size
    line, pixel = (np.arange(count) + corner[axis] for axis in (1, 0))
    inside = ((line >= 0) & (line < signal_dn.shape[0]))[:, None] & (
        (pixel >= 0) & (pixel < signal_dn.shape[1])
    )
    at = np.ix_(np.clip(line, 0, signal_dn.shape[0] - 1), np.clip(pixel, 0, signal_dn.shape[1] - 1))
    good = inside & ~bad[at] & np.isfinite(signal_dn[at])
    light = np.where(good, signal_dn[at], 0.0)
    blocks = (2 * half, size, 2 * half, size)
    n_good = good.reshape(blocks).sum(axis=(1, 3))
    mean = light.reshape(blocks).sum(axis=(1, 3)) / np.maximum(n_good, 1)
    middle = (np.arange(2 * half) + 0.5) * size - 0.5
    x, y = np.meshgrid(middle + corner[0] - circle.center_px[0], middle + corner[1] - circle.center_px[1])
    known = n_good > 0.5 * size * size
    return mean[known], np.stack([x[known], y[known]], axis=1) / circle.radius_px


def _laws(place: FloatArray, unknown: FloatArray) -> FloatArray:
    """Return the light (n, 2) of a Lambert and a Lommel-Seeliger sphere; places in radii of the circle."""
    x, y = ((place - unknown[2:4]) / np.exp(unknown[4])).T
    height = 1.0 - x**2 - y**2
    phase = np.hypot(unknown[0], unknown[1])
    across = np.sinc(phase / np.pi)  # sin(phase) / phase
    z = np.sqrt(np.maximum(height, 0.0))
    incidence = np.maximum(across * (unknown[0] * x + unknown[1] * y) + np.cos(phase) * z, 0.0)
    # A cell on the limb is on the disk in part.
    cell = 0.5 * float(np.min(np.diff(np.unique(place[:, 0])))) if len(place) > 1 else 0.05
    on_disk = np.clip(0.5 + (1.0 - np.hypot(x, y)) / (2.0 * cell), 0.0, 1.0)
    return np.asarray(on_disk[:, None] * np.stack([incidence, incidence / (incidence + z + 1e-3)], axis=1))
