"""What is measured in a picture by hand: an aperture's sum, center and width; and the directions of the compass.

Flow   a place and a radius -> sky about it -> a round Gaussian fitted -> the sum in a circle about its center
Habit  as imexam and DS9 give it: sum and sky in DN, center and FWHM in px, brightness against radius

Line cuts, distances and histograms need no session: the page has them (static/image_tools.js).
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.errors import OpNavError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.psf import box_integrals
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.overlays import expected_directions, expected_places

__all__ = ["Aperture", "compass_arrows", "measure_aperture"]


# ---- An aperture.

FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
# The ring that the sky is taken from: its inner radius over the aperture's and at least so much beyond it; its width.
RING_BEGINS, RING_GAP_PX, RING_WIDTH_PX = 1.5, 2.0, 4.0
CLIP_SIGMAS, CLIP_TURNS = 3.0, 5  # of the ring's pixels, so that a neighbor there is no sky
SUBPIXELS = 10  # a side: the circle's area in a pixel of its edge is then right to 1 %
LEAST_RADIUS_PX, LEAST_PIXELS = 1.0, 7  # fewer pixels do not hold the fit's five unknowns
LEAST_SIGMA_PX = 0.2  # a narrower star is in one pixel, and its width cannot be told
PROFILE_POINTS = 400  # of brightness against radius: as many as a small plot shows
LEAST_PEAK_SIGMAS = 3.0  # above the sky's noise, to be called a star


@dataclass(frozen=True, slots=True)
class Aperture:
    """What stands in a circle of a picture.

    Attributes
    ----------
    pixel, line, radius_px
        The circle: about the center that was found, else as it was drawn.
    found
        Whether a round Gaussian was fitted in it.
    sum_dn, sigma_dn
        Above the sky, and what the sky's noise alone makes of it.
    sky_dn, noise_dn
        Of one pixel: median and scatter in the ring about the circle.
    peak_dn
        Highest pixel, above the sky.
    fwhm_px
        Of the fitted Gaussian, before the pixels blurred it; nan where none was fitted.
    n_missing
        Pixels in the circle that are bad, saturated or off the detector: the sum lacks them.
    """

    pixel: float
    line: float
    radius_px: float
    found: bool
    sum_dn: float
    sigma_dn: float
    sky_dn: float
    noise_dn: float
    peak_dn: float
    fwhm_px: float
    n_missing: int
    profile: tuple[tuple[float, ...], tuple[float, ...]]  # radius, px, and DN above the sky

    def as_page_values(self) -> dict[str, Any]:
        """Return plain values; what is not finite is None."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [[round(number, 3) for number in part] for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def measure_aperture(
    image_dn: FloatArray, usable: BoolArray, place_px: tuple[float, float], radius_px: float
) -> Aperture:
    """Measure what stands in a circle of a picture.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    usable : (n_line, n_pixel) array of bool
    place_px
        (pixel, line) of the circle's center.

    Raises
    ------
    OpNavError
        The circle, or the ring about it, holds too few pixels.

    Examples
    --------
    >>> star = np.full((21, 21), 5.0)
    >>> star[10, 10] = 105.0
    >>> found = measure_aperture(star, np.ones((21, 21), bool), (10.0, 10.0), 3.0)
    >>> round(found.sum_dn), found.sky_dn, found.peak_dn
    (100, 5.0, 100.0)
    """
    radius = max(float(radius_px), LEAST_RADIUS_PX)
    part = _part(image_dn, usable, place_px, radius)
    sky, noise, n_ring = _sky(part, radius)
    center, fwhm = _gaussian(part, place_px, radius, sky, noise)
    about = place_px if center is None else center
    share, distance = _shares(part, about, radius)
    good = np.isfinite(part.values)
    above = np.where(good, part.values - sky, 0.0)
    area = float(share[good].sum())
    inside = good & (share > 0.0)
    if not inside.any():
        raise OpNavError("no usable pixel is in the aperture; draw it elsewhere, or larger.")
    return Aperture(
        float(about[0]),
        float(about[1]),
        radius,
        center is not None,
        float((share * above).sum()),
        float(noise * np.sqrt(area + area**2 / n_ring)),
        sky,
        noise,
        float(above[inside].max()),
        fwhm,
        int((~good & (share > 0.0)).sum()),
        _profile(distance[good], above[good], radius),
    )


@dataclass(frozen=True, slots=True)
class _Part:
    """Pixels about a place: their values, nan where not usable, and the first one's place."""

    values: FloatArray
    first: tuple[int, int]

    def offsets(self, place_px: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Pixels and lines (size, size) from a place to each pixel's middle."""
        line, pixel = np.indices(self.values.shape).astype(np.float64)
        return np.asarray(pixel + self.first[0] - place_px[0]), np.asarray(line + self.first[1] - place_px[1])


def _part(image_dn: FloatArray, usable: BoolArray, place: tuple[float, float], radius: float) -> _Part:
    """Cut out a square that holds the ring, with nan where it reaches beyond the detector."""
    reach = int(np.ceil(_ring(radius)[1])) + 1
    first = tuple(int(np.rint(at)) - reach for at in place)
    (p0, l0), size = first, 2 * reach + 1
    values = np.full((size, size), np.nan)
    rows, columns = (slice(max(at, 0), max(at + size, 0)) for at in (l0, p0))
    there = np.where(usable[rows, columns], image_dn[rows, columns], np.nan)
    top, left = max(-l0, 0), max(-p0, 0)
    values[top : top + there.shape[0], left : left + there.shape[1]] = there
    return _Part(values, (p0, l0))


def _ring(radius: float) -> tuple[float, float]:
    inner = max(RING_BEGINS * radius, radius + RING_GAP_PX)
    return inner, inner + max(RING_WIDTH_PX, 0.5 * radius)


def _sky(part: _Part, radius: float) -> tuple[float, float, int]:
    """Level and noise of the ring, clipped, and how many pixels it kept."""
    reach = 0.5 * (len(part.values) - 1)
    line, pixel = np.indices(part.values.shape)
    distance = np.hypot(pixel - reach, line - reach)
    inner, outer = _ring(radius)
    values = part.values[(distance >= inner) & (distance <= outer) & np.isfinite(part.values)]
    if len(values) < LEAST_PIXELS:
        raise OpNavError("too few usable pixels about the aperture to take the sky from; draw it elsewhere.")
    for _ in range(CLIP_TURNS):
        level = float(np.median(values))
        noise = MAD_TO_SIGMA * float(np.median(np.abs(values - level))) or float(values.std())
        kept = values[np.abs(values - level) <= CLIP_SIGMAS * noise]
        if len(kept) in (0, len(values)):
            break
        values = kept
    return level, float(values.std(ddof=1)), len(values)


def _gaussian(
    part: _Part, place: tuple[float, float], radius: float, sky: float, noise: float
) -> tuple[tuple[float, float] | None, float]:
    """Fit a round Gaussian, integrated over pixels, within the circle: its center, None without one, and its FWHM, px."""
    x, y = part.offsets(place)
    inside = (np.hypot(x, y) <= radius + 0.5) & np.isfinite(part.values)
    data = np.where(inside, part.values - sky, 0.0)
    peak = float(data.max(initial=0.0))
    if inside.sum() < LEAST_PIXELS or peak < LEAST_PEAK_SIGMAS * noise or peak <= 0.0:
        return None, np.nan
    brightest = np.unravel_index(int(data.argmax()), data.shape)
    start = [float(x[brightest]), float(y[brightest]), np.log(max(0.35 * radius, 0.6)), 0.0]
    first = np.array([[part.first[0] - place[0], part.first[1] - place[1]]])

    def off(unknown: FloatArray) -> FloatArray:
        shape = np.array([[unknown[2], 0.0, 0.0]])
        star = box_integrals(unknown[None, :2], shape, first, len(data)).value[0][inside]
        both = np.stack([star, np.ones_like(star)], axis=1)  # flux and level follow from the rest
        return np.asarray(both @ np.linalg.lstsq(both, data[inside], rcond=None)[0] - data[inside])

    low, high = np.log(LEAST_SIGMA_PX), np.log(2.0 * radius)
    bounds = ([-radius, -radius, low], [radius, radius, high])
    begin = np.clip(start[:3], np.array(bounds[0]) + 1e-6, np.array(bounds[1]) - 1e-6)
    fit = least_squares(off, begin, bounds=bounds, x_scale=[1.0, 1.0, 0.5])
    dx, dy, log_sigma = fit.x
    if not fit.success or np.hypot(dx, dy) > radius or log_sigma > high - 1e-3:
        return None, np.nan
    fwhm = FWHM_PER_SIGMA * np.exp(log_sigma) if log_sigma > low + 1e-3 else np.nan
    return (float(place[0] + dx), float(place[1] + dy)), float(fwhm)


def _shares(part: _Part, place: tuple[float, float], radius: float) -> tuple[FloatArray, FloatArray]:
    """Share of each pixel that the circle covers, and the distance of its middle, px."""
    x, y = part.offsets(place)
    fine = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    within = (x[..., None, None] + fine) ** 2 + (y[..., None, None] + fine[:, None]) ** 2 <= radius**2
    return within.mean(axis=(2, 3)), np.hypot(x, y)


def _profile(
    distance: FloatArray, above: FloatArray, radius: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    near = np.flatnonzero(distance <= RING_BEGINS * radius)
    near = near[np.argsort(distance[near])][:: max(1, -(-len(near) // PROFILE_POINTS))]
    return tuple(distance[near].tolist()), tuple(above[near].tolist())


# ---- The compass: where north, east and the Sun lie in the picture.

STEP_RAD = 1e-5  # of the differences that directions are taken from


def compass_arrows(session: ImageSession) -> list[tuple[str, float, float]]:
    """Return name and direction (pixel, line), of length 1, of north and east at the picture's middle, and of the Sun.

    The Sun's is taken at the first target with a known Sun; it is left out where it points along the line of sight.
    """
    camera = session.context.camera
    middle = 0.5 * (np.array([camera.n_pixel, camera.n_line]) - 1.0)
    here = expected_directions(session, middle[None])[0]
    east = np.cross([0.0, 0.0, 1.0], here)
    named = {} if session.is_without_sky else {"N": (here, np.cross(here, east)), "E": (here, east)}
    target = next((t for t in session.inputs.targets.values() if t.sun_position_km is not None), None)
    if target is not None and target.sun_position_km is not None:
        velocity = session.inputs.observer.velocity_km_s
        seen = apparent_direction(target.position_km / np.linalg.norm(target.position_km), velocity)
        named["Sun"] = (seen, target.sun_position_km)
    arrows = []
    for name, (start, along) in named.items():
        step = _step_px(session, start, along)
        if step is not None:
            arrows.append((name, *step))
    return arrows


def _step_px(session: ImageSession, start: FloatArray, along: FloatArray) -> tuple[float, float] | None:
    """Direction in the picture of a step across the sky; None where there is none."""
    across = along - (along @ start) * start
    length = np.linalg.norm(across)
    if length <= 1e-6 * np.linalg.norm(along):  # nor has north at the pole
        return None
    ends = np.stack([start, start + STEP_RAD * across / length])
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    first, last = expected_places(session, ends)
    step = last - first
    size = float(np.hypot(*step))
    return (float(step[0] / size), float(step[1] / size)) if np.isfinite(size) and size > 0.0 else None
