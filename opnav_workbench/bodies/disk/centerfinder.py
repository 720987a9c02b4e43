"""Center of a disk: found, fitted, read a second time in another way, and judged.

Flow   place (`opnav_workbench.bodies.place`) -> fit -> cosmic rays and stars out, fit again -> crossings of the limb at
       half of the local brightness: a second reading that knows neither weights nor albedo -> `BodyCenter`
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.disk.fit import DiskFit, DiskPixels, Unknown, fit_disk
from opnav_workbench.bodies.disk.marginal import FieldPrior
from opnav_workbench.bodies.neighbours import without_others
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.place import BodyPlace, LimbCrossings, cross_limb, find_place, fit_crossings
from opnav_workbench.bodies.results import (
    DOUBTFUL_FLAGS,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    DiskReading,
    SecondReading,
    flag_messages,
    flags_where,
)
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.bodies.subarray import choose_subarray, find_hit_pixels, search_radius
from opnav_workbench.errors import CenterfindingError

__all__ = ["METHOD", "find_disk"]

METHOD = "disk"
LEAST_DIAMETER_PX = 3.0
CONFIRMED_SIGMAS = 3.5  # of two coordinates: 0.2 % of right answers differ by more
CONFIRMED_PX = 0.1  # readings that lie so close are the same, whatever their sigmas
FEWEST_CROSSINGS = 12
MISFIT_SIGMAS = 3.0  # of the size, beyond what its model says of itself
POOR_CHI2 = 2.0
WEAK_PX, WEAK_SHARE = 1.0, 0.02  # of the radius: a center that is known no better
THIN_PX = 1.0
BRIGHT_SHARE = 0.1
LEAST_LIT = 0.1  # of a turn of limb that the picture must show
NOISE_ALONE = FieldPrior(1e-4, 0.4, 1e-5, 1e-4)


def find_disk(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = True,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure from all pixels about its limb.

    Parameters
    ----------
    name
        A sphere, a triaxial ellipsoid or a shape model of `picture.models`.
    circle
        An analyst's; None: predicted place and size.
    solve_range
        Tell the range as well: that of a body of the model's size, with the uncertainty of that size.
    search_radius_px
        How far from the expected place to look; None: anywhere.

    Returns
    -------
    BodyCenter
        Method ``disk``; `detail` is a `DiskReading`. Status ``ok`` where a second reading of the same pixels confirms
        the center; ``uncertain`` (see `flags` and `messages`), ``not_detected``, ``saturated`` or ``failed`` else.

    Raises
    ------
    CenterfindingError
        No such body in the picture.

    Notes
    -----
    The covariance is marginal over the body's albedo (a Gaussian random field whose strength and correlation length
    follow from the picture), size, axes, topography of the limb, scattering law, PSF and background.
    """
    if (none := _unsuitable(picture, name)) is not None:
        return none
    try:
        place = find_place(picture, name, circle, search_radius_px)
        if place is None:
            return BodyCenter.without_center(
                name, METHOD, "not_detected", "nothing of its size and phase stands out of the sky"
            )
        return _measured(picture, name, place, circle, search_radius_px, solve_range=solve_range)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, METHOD, "failed", str(error))


def _unsuitable(picture: BodyPicture, name: str) -> BodyCenter | None:
    if picture.model(name).is_point:
        why = "it has neither radii nor a shape; give them, or use method 'unresolved'"
        return BodyCenter.without_center(name, METHOD, "failed", why)
    diameter = picture.diameter_px(name)
    if 0.0 < diameter < LEAST_DIAMETER_PX:
        why = f"it is {diameter:.1f} px wide, too small for a limb (at least {LEAST_DIAMETER_PX:g} px); use 'least_squares'"
        return BodyCenter.without_center(name, METHOD, "failed", why)
    return None


# ---- The reading.


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """A fitted disk with all that speaks for and against it."""

    picture: BodyPicture
    name: str
    fit: DiskFit
    pixels: DiskPixels
    crossings: LimbCrossings
    second: SecondReading | None
    hits: BoolArray

    @property
    def radius_px(self) -> float:
        """Of the disk."""
        return 0.5 * self.fit.outline.diameter_px


def _measured(
    picture: BodyPicture,
    name: str,
    place: BodyPlace,
    circle: Circle | None,
    search_px: float | None,
    *,
    solve_range: bool,
) -> BodyCenter:
    pixels = _usable(picture, name, place)
    fit = fit_disk(picture, name, place, pixels)
    hits = _hits(fit, pixels)
    if hits.any():
        pixels = replace(pixels, use=pixels.use & ~hits)
        fit = fit_disk(picture, name, place, pixels, fit)
    crossings, second = _second_reading(picture, fit)
    reading = _Reading(picture, name, fit, pixels, crossings, second, hits)
    return _center(reading, circle, search_px, solve_range=solve_range)


def _usable(picture: BodyPicture, name: str, place: BodyPlace) -> DiskPixels:
    """Return the picture's planes, without pixels that are bad, saturated, or lit by other bodies."""
    whole = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    cutout = without_others(picture, name, place.center_px, whole)
    return DiskPixels(cutout.data_dn, cutout.noise_dn, cutout.use, cutout.gain_e_per_dn)


def _hits(fit: DiskFit, pixels: DiskPixels) -> BoolArray:
    """Return the pixels (n_line, n_pixel) of the strip whose light is not the body's."""
    near = fit.pixels
    residual, weight = np.zeros(pixels.use.shape), np.zeros(pixels.use.shape)
    here = (near.line, near.pixel)
    model = fit.model_dn()
    residual[here] = pixels.data_dn[here] - model
    light = np.maximum(model - fit.solution.theta[Unknown.LEVEL], 0.0)
    variance = pixels.noise_dn[here] ** 2 + light / pixels.gain_e_per_dn + (fit.prior.grain * light) ** 2
    weight[here] = np.where(pixels.use[here], 1.0 / variance, 0.0)
    if not len(near.line):
        return np.zeros(pixels.use.shape, dtype=bool)
    part = np.s_[near.line.min() : near.line.max() + 1, near.pixel.min() : near.pixel.max() + 1]
    out = np.zeros(pixels.use.shape, dtype=bool)
    out[part] = find_hit_pixels(residual[part], weight[part])
    return out


def _second_reading(picture: BodyPicture, fit: DiskFit) -> tuple[LimbCrossings, SecondReading | None]:
    """Read the center from where rays cross the limb; None where too few do."""

    def profiles(outline: Outline, angle: FloatArray, depth: FloatArray) -> FloatArray:
        places = np.broadcast_arrays(angle[:, None], depth)
        table = fit.light.at(places[0].ravel(), places[1].ravel(), fit.light.planes[:1])
        return np.asarray(table[0].reshape(places[0].shape))

    figure = fit.figure
    sigma = np.array([figure.size_sigma, figure.axes_sigma, figure.axes_sigma])
    expected = -np.array([fit.shape.log_size, *fit.shape.strain])
    reach = 3.0 + 3.0 * float(np.max(picture.psf.sigma_px))
    crossings = cross_limb(picture, fit.smooth_outline, reach, profiles)
    if np.count_nonzero(crossings.known) < FEWEST_CROSSINGS:
        return crossings, None
    read = fit_crossings(crossings, fit.smooth_outline, sigma, expected, 1.0)
    covariance = read.covariance[:2, :2]
    both = covariance + fit.covariance_px2
    away = float(np.sqrt(read.step_px @ np.linalg.solve(both, read.step_px)))
    return crossings, SecondReading("limb crossings", fit.center_px + read.step_px, covariance, away)


# ---- The judgement.


def _flags(reading: _Reading, circle: Circle | None, search_px: float | None) -> BodyFlag:
    picture, fit, name = reading.picture, reading.fit, reading.name
    radius, figure = reading.radius_px, fit.figure
    outline = fit.outline.points(fit.outline.angle_rad)
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    near = fit.pixels
    here = (near.line, near.pixel)
    bright = fit.light_dn() > BRIGHT_SHARE * max(fit.brightness_dn, 0.0)
    sigma = np.sqrt(np.linalg.eigvalsh(fit.covariance_px2))
    expected = picture.center_px(name) if circle is None else circle.center_px
    limit = search_px if circle is None else search_radius(radius, circle, search_px)
    thickness = radius * (1.0 + np.cos(picture.phase_rad(name)))
    degrees = max(np.count_nonzero(np.isfinite(fit.system.variance)) - len(Unknown), 1)
    unusable = bright & ~reading.pixels.use[here]
    size_sigma = float(np.hypot(figure.size_sigma, fit.sigma(Unknown.SIZE)))
    conditions = {
        BodyFlag.CUT_BY_EDGE: bool(np.any(outline < -0.5) or np.any(outline > size - 0.5)),
        BodyFlag.OVEREXPOSED: bool(np.any(bright & picture.saturated[here])),
        BodyFlag.THIN_CRESCENT: thickness < THIN_PX,
        BodyFlag.CIRCLE_MISFIT: abs(fit.shape.log_size) > MISFIT_SIGMAS * size_sigma,
        BodyFlag.POOR_FIT: fit.solution.chi2 > POOR_CHI2 * degrees,
        BodyFlag.AT_LIMIT: limit is not None and float(np.hypot(*(fit.center_px - expected))) > limit + 1.0,
        BodyFlag.WEAK_GEOMETRY: not sigma[1] < max(WEAK_PX, WEAK_SHARE * radius),
        BodyFlag.EMPTY: fit.lit_share < LEAST_LIT,
        BodyFlag.BAD_PIXELS: bool(np.any(unusable & picture.bad[here] & ~picture.saturated[here])),
        BodyFlag.HIT: bool(np.any(bright & reading.hits[here])),
        BodyFlag.NOT_CONVERGED: not fit.converged,
        BodyFlag.UNCONFIRMED: not _confirmed(reading),
    }  # fmt: skip
    return flags_where(conditions)


def _confirmed(reading: _Reading) -> bool:
    second = reading.second
    if second is None:
        return False
    apart = float(np.hypot(*(second.pixel_line - reading.fit.center_px)))
    return apart < CONFIRMED_PX or second.difference_sigmas < CONFIRMED_SIGMAS


def _notes(reading: _Reading) -> dict[BodyFlag, str]:
    fit, second = reading.fit, reading.second
    apart = "no second reading: too little of its limb can be crossed"
    if second is not None:
        away = second.pixel_line - fit.center_px
        apart = f"{second.method} put it ({away[0]:+.2f}, {away[1]:+.2f}) px beside, {second.difference_sigmas:.1f} sigma"
    ratio = 100.0 * (np.exp(fit.shape.log_size) - 1.0)
    return {
        BodyFlag.CIRCLE_MISFIT: f"{ratio:+.0f} %: check its radii, its range, or the circle",
        BodyFlag.UNCONFIRMED: apart,
        BodyFlag.EMPTY: f"{100.0 * fit.lit_share:.0f} % of its limb is lit and in sight",
        BodyFlag.OVEREXPOSED: "take a shorter exposure",
    }


def _center(
    reading: _Reading, circle: Circle | None, search_px: float | None, *, solve_range: bool
) -> BodyCenter:
    picture, fit = reading.picture, reading.fit
    flags = _flags(reading, circle, search_px)
    excess = picture.excess_sigma_px**2 * np.eye(2)
    noise = fit.system.solve(NOISE_ALONE).covariance[np.ix_([1, 2], [1, 2])]
    theta, scale = fit.solution.theta, fit.brightness_dn
    light = fit.light_dn()
    diameter = fit.outline.diameter_px
    center = BodyCenter(
        name=reading.name,
        method=METHOD,
        status="uncertain" if flags & DOUBTFUL_FLAGS else "ok",
        pixel_line=fit.center_px,
        covariance_px2=fit.covariance_px2 + excess,
        flux_dn=float(light.sum()),
        snr=scale / max(fit.sigma(Unknown.BRIGHTNESS), 1e-12),
        diameter_px=diameter,
        diameter_sigma_px=diameter * fit.sigma(Unknown.SIZE),
        messages=tuple(flag_messages(flags, _notes(reading))),
        flags=int(flags),
        noise_covariance_px2=noise + excess,
        chi2_reduced=fit.solution.chi2
        / max(np.count_nonzero(np.isfinite(fit.system.variance)) - len(Unknown), 1),
        brightness_scale=scale,
        brightness_scale_sigma=fit.sigma(Unknown.BRIGHTNESS),
        background_dn=float(theta[Unknown.LEVEL]),
        background_sigma_dn=fit.sigma(Unknown.LEVEL),
        pictures=_pictures(reading),
        detail=_detail(reading),
    )
    return _with_range(center, reading) if solve_range else center


def _with_range(center: BodyCenter, reading: _Reading) -> BodyCenter:
    fit = reading.fit
    range_km = reading.picture.model(reading.name).target.range_km * float(np.exp(-fit.shape.log_size))
    sigma = float(np.hypot(fit.sigma(Unknown.SIZE), fit.figure.size_sigma))
    return replace(center, range_km=range_km, range_sigma_km=range_km * sigma)


def _detail(reading: _Reading) -> DiskReading:
    fit = reading.fit
    return DiskReading(
        outline_px=fit.smooth_outline.points(fit.outline.angle_rad),
        size_ratio=float(np.exp(fit.shape.log_size)),
        size_ratio_sigma=float(np.exp(fit.shape.log_size)) * fit.sigma(Unknown.SIZE),
        strain=fit.shape.strain,
        law_shares=fit.solution.theta[[Unknown.LAW, Unknown.LAW_2]],
        albedo_sigma=fit.prior.albedo,
        albedo_length_rad=fit.prior.length_rad,
        limb_roughness_px=fit.prior.rough_px,
        steps_px=np.array(fit.lengths_px),
        second=reading.second,
    )


def _pictures(reading: _Reading) -> BodyResiduals:
    fit, picture, pixels = reading.fit, reading.picture, reading.pixels
    margin = fit.reach_px[1]
    window = choose_subarray(picture, reading.name, Circle(fit.center_px, reading.radius_px), margin).window
    near, here = fit.pixels, (fit.pixels.line, fit.pixels.pixel)
    model, mask = np.zeros(pixels.use.shape), np.zeros(pixels.use.shape, dtype=bool)
    level = float(fit.solution.theta[Unknown.LEVEL])
    model[here] = fit.model_dn() - level
    mask[near.line, near.pixel] = pixels.use[here]
    pixel, line, n_pixel, n_line = window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    data = np.nan_to_num(picture.signal_dn[part]) - level
    shown = np.where(mask[part], model[part], 0.0)
    return BodyResiduals(window, data, shown, np.where(mask[part], data - shown, 0.0), mask[part])
