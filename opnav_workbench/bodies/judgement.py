"""From a center that a method read off a disk to a `BodyCenter`: one set of flags and one judgement for all such methods.

Flow   measured disk, center, a second reading of the same pixels -> flags -> status and messages -> `BodyCenter`
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.bodies.disk.columns import CENTER, Unknown
from opnav_workbench.bodies.disk.measurement import (
    MeasuredDisk,
    crossing_covariance,
    same_center,
    sigmas_apart,
)
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import (
    DOUBTFUL_FLAGS,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    SecondReading,
    flag_messages,
    flags_where,
)
from opnav_workbench.bodies.subarray import choose_subarray, left_search

__all__ = [
    "POOR_CHI2",
    "CenterReading",
    "confirmed_center",
    "crossing_reading",
    "difference_covariance",
    "disk_reading",
    "is_other_size",
    "judged_center",
    "lost_pixels",
    "second_reading",
    "size_words",
    "standing_flags",
]

DIFFERENCE_SHARE = 0.5
COORDINATES = 2  # of a center: chi-squared that their difference is expected to have
MISFIT_SIGMAS = 3.0  # of the size, beyond what its model says of itself
POOR_CHI2 = 2.0
WEAK_PX, WEAK_SHARE = 1.0, 0.02  # of the radius: a center that is known no better
THIN_PHASE_RAD = np.radians(130.0)
THIN_PX = 1.0  # widest part of a crescent: below, the sampled model holds its light to a few percent only
BRIGHT_SHARE = 0.1
LEAST_LIT = 0.1  # of a turn of limb that the picture must show


@dataclass(frozen=True, slots=True, eq=False)
class CenterReading:
    """A center that a method read off a disk.

    Attributes
    ----------
    center_px : (2,) array
    covariance_px2, noise_covariance_px2 : (2, 2) arrays
        Marginal over all else; from the noise of the pixels alone.
    log_size, log_size_sigma
        Logarithm of the size over the model's.
    second
        Another reading of the same pixels; None where there is none.
    conditions, notes
        Flags that only this method can know, and what it adds to their messages.
    """

    method: str
    center_px: FloatArray
    covariance_px2: FloatArray
    noise_covariance_px2: FloatArray
    log_size: float
    log_size_sigma: float
    chi2_reduced: float
    converged: bool
    second: SecondReading | None
    conditions: Mapping[BodyFlag, bool] = field(default_factory=dict)
    notes: Mapping[BodyFlag, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze_arrays(self)


def second_reading(
    method: str,
    center_px: FloatArray,
    covariance_px2: FloatArray,
    first_px: FloatArray,
    first_covariance_px2: FloatArray,
) -> SecondReading:
    """Return a reading with its distance from a first one."""
    away = center_px - first_px
    return SecondReading(
        method, center_px, covariance_px2, sigmas_apart(away, covariance_px2 + first_covariance_px2)
    )


def crossing_reading(
    disk: MeasuredDisk, first_px: FloatArray, first_covariance_px2: FloatArray
) -> SecondReading | None:
    """Return what the crossings of the limb say of a center; None where too few rays cross it.

    A fit that has wandered off what it began from sees no limb any more; then the crossings that made its place count,
    though they confirm nothing.
    """
    fit, read, start = disk.fit, disk.crossing, disk.place
    if read is not None:
        place, covariance = fit.center_px + read.step_px, crossing_covariance(read.covariance[:2, :2])
    elif np.isfinite(start.center_sigma_px):
        place, covariance = start.center_px, crossing_covariance(start.center_sigma_px**2 * np.eye(2))
    else:
        return None
    covariance = covariance + disk.hidden_px2
    name = "limb crossings" + " among its patches" * (read is not None and read.patterned)
    return second_reading(name, place, covariance, first_px, first_covariance_px2)


def difference_covariance(away_px: FloatArray, sigmas: float = np.inf) -> FloatArray:
    """Return what the difference (2,) of two readings of the same pixels adds to the covariance of either, px^2.

    Parameters
    ----------
    sigmas
        How far they differ by what both say of themselves: what is expected of two coordinates adds nothing that is not
        in either covariance already. Infinite where these hold less than what may be wrong.
    """
    share = 1.0 - COORDINATES / (COORDINATES + sigmas**2)
    return np.asarray(share * DIFFERENCE_SHARE**2 * np.outer(away_px, away_px))


def confirmed_center(center: BodyCenter, disk: BodyCenter) -> BodyCenter:
    """Return a center by the light of the whole disk beside that of its likelihood.

    The center stays, its covariance holds half of the difference. It is unconfirmed where the difference is too far, or
    the likelihood has no center or one that is doubtful itself.

    Parameters
    ----------
    disk
        As `find_disk` has found it in the same picture.
    """
    if center.pixel_line is None:
        return center
    if disk.pixel_line is None:
        return _unconfirmed(center, f"there is no likelihood of its disk: {'; '.join(disk.messages)}")
    first = center.pixel_line
    second = second_reading(
        "the likelihood of the disk", disk.pixel_line, disk.covariance_px2, first, center.covariance_px2
    )
    away = second.pixel_line - first
    covariance = symmetric(center.covariance_px2 + difference_covariance(away))
    told = replace(center, second=second, covariance_px2=covariance)
    if not same_center(away, second.difference_sigmas):
        return _unconfirmed(told, _apart(second, first))
    doubts = flag_messages(BodyFlag(disk.flags & ~center.flags) & DOUBTFUL_FLAGS, {})
    return _unconfirmed(told, f"{second.method} agrees, but: {'; '.join(doubts)}") if doubts else told


def _unconfirmed(center: BodyCenter, why: str) -> BodyCenter:
    return replace(
        center,
        status="uncertain" if center.status == "ok" else center.status,
        flags=int(center.flags | BodyFlag.UNCONFIRMED),
        messages=(
            *center.messages,
            *flag_messages(BodyFlag.UNCONFIRMED, {BodyFlag.UNCONFIRMED: why}),
        ),
    )


def _apart(second: SecondReading, center_px: FloatArray) -> str:
    away = second.pixel_line - center_px
    return f"{second.method} put it ({away[0]:+.2f}, {away[1]:+.2f}) px beside, {second.difference_sigmas:.1f} sigma"


def disk_reading(disk: MeasuredDisk, method: str, second: SecondReading | None) -> CenterReading:
    """Return the likelihood's own center."""
    fit = disk.fit
    noise = fit.system.noise_covariance(fit.prior)[np.ix_(CENTER, CENTER)]
    return CenterReading(
        method,
        fit.center_px,
        fit.covariance_px2,
        noise,
        *disk.log_size,
        fit.chi2_reduced,
        fit.converged,
        second,
    )


def judged_center(
    disk: MeasuredDisk, reading: CenterReading, detail: object, *, solve_range: bool
) -> BodyCenter:
    """Return the body's center with everything that is known of it."""
    fit, flags = disk.fit, _flags(disk, reading)
    excess = disk.picture.excess_sigma_px**2 * np.eye(2)
    diameter = fit.outline.diameter_px * float(np.exp(reading.log_size - fit.shape.log_size))
    center = BodyCenter(
        name=disk.name,
        method=reading.method,
        status="uncertain" if flags & DOUBTFUL_FLAGS else "ok",
        pixel_line=reading.center_px,
        covariance_px2=symmetric(reading.covariance_px2 + disk.relief_px2 + excess),
        flux_dn=float(fit.light_dn().sum()),
        snr=fit.brightness_dn / max(fit.sigma(Unknown.BRIGHTNESS), 1e-12),
        diameter_px=diameter,
        diameter_sigma_px=diameter * reading.log_size_sigma,
        messages=tuple(flag_messages(flags, _notes(disk, reading))),
        flags=int(flags),
        noise_covariance_px2=symmetric(reading.noise_covariance_px2 + excess),
        chi2_reduced=reading.chi2_reduced,
        brightness_scale=fit.brightness_dn,
        brightness_scale_sigma=fit.sigma(Unknown.BRIGHTNESS),
        background_dn=float(fit.solution.theta[Unknown.LEVEL]),
        background_sigma_dn=fit.sigma(Unknown.LEVEL),
        pictures=_pictures(disk),
        detail=detail,
        second=reading.second,
    )
    return _with_range(center, disk, reading) if solve_range else center


def _with_range(center: BodyCenter, disk: MeasuredDisk, reading: CenterReading) -> BodyCenter:
    """Return the center with the range of a body of the model's size, as uncertain as that is."""
    model = disk.picture.model(disk.name)
    range_km = model.target.range_km * float(np.exp(-reading.log_size))
    sigma = float(np.hypot(reading.log_size_sigma, model.figure.size_sigma))
    return replace(center, range_km=range_km, range_sigma_km=range_km * sigma)


def _flags(disk: MeasuredDisk, reading: CenterReading) -> BodyFlag:
    picture, fit = disk.picture, disk.fit
    outline = fit.outline.points(fit.outline.angle_rad)
    extent = outline.min(axis=0), outline.max(axis=0)
    away = float(np.hypot(*(reading.center_px - disk.expected_px)))
    lit = fit.light_dn() > BRIGHT_SHARE * max(fit.brightness_dn, 0.0)
    here = fit.pixels.index
    conditions = {
        BodyFlag.CIRCLE_MISFIT: is_other_size(
            reading.log_size, reading.log_size_sigma, fit.figure.size_sigma
        ),
        BodyFlag.POOR_FIT: fit.chi2_reduced > POOR_CHI2 and not _holds_beside_other_light(disk, reading),
        BodyFlag.AT_LIMIT: left_search(away, disk.radius_px, disk.circle, disk.search_px),
        BodyFlag.EMPTY: fit.lit_share < LEAST_LIT,
        BodyFlag.NOT_CONVERGED: not (reading.converged or _confirmed(disk, reading)),
        BodyFlag.UNCONFIRMED: not _confirmed(disk, reading),
        BodyFlag.ROUGH_LIMB: disk.is_rough,
    }
    standing = standing_flags(picture, disk.name, extent, disk.radius_px, reading.covariance_px2)
    lost = lost_pixels(picture, here, lit, disk.pixels.use[here], disk.hits[here])
    return flags_where({**conditions, **standing, **lost, **reading.conditions})


def is_other_size(log_size: float, sigma: float, allowed: float) -> bool:
    """Tell whether an image has not its model's size, beyond what is allowed that and the measurement (1 sigma each)."""
    return abs(log_size) > MISFIT_SIGMAS * float(np.hypot(allowed, sigma))


def size_words(log_size: float) -> str:
    """Return by how much a size differs from its model's, and what to do."""
    share = 100.0 * float(np.expm1(log_size))
    word = "larger" if share > 0.0 else "smaller"
    return f"it is {abs(share):.0f} % {word}: check its radii, its range, or the circle"


def standing_flags(
    picture: BodyPicture,
    name: str,
    extent_px: tuple[FloatArray, FloatArray],
    radius_px: float,
    covariance_px2: FloatArray,
) -> dict[BodyFlag, bool]:
    """Tell what is against a center by where the body stands in the picture, and how it is lit there.

    Parameters
    ----------
    extent_px : (2,) array, (2,) array
        Lowest and highest (pixel, line) that its outline reaches.
    """
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance_px2), 0.0))
    return {
        BodyFlag.CUT_BY_EDGE: bool(np.any(extent_px[0] < -0.5) or np.any(extent_px[1] > size - 0.5)),
        BodyFlag.THIN_CRESCENT: _is_thin_crescent(picture, name, radius_px),
        BodyFlag.WEAK_GEOMETRY: not sigma[1] < max(WEAK_PX, WEAK_SHARE * radius_px),
    }


def _is_thin_crescent(picture: BodyPicture, name: str, radius_px: float) -> bool:
    phase = picture.phase_rad(name)
    return bool(phase > THIN_PHASE_RAD and radius_px * (1.0 + np.cos(phase)) < THIN_PX)


def lost_pixels(
    picture: BodyPicture, index: Any, lit: BoolArray, use: BoolArray, hits: BoolArray
) -> dict[BodyFlag, int]:
    """Return how many of the pixels that a body lights were left out, by why.

    Parameters
    ----------
    index
        Of the picture's planes: the pixels that the arrays are of.
    """
    saturated, hit = lit & picture.overexposed[index], lit & hits
    unsound = picture.bad[index] | ~np.isfinite(picture.signal_dn[index])
    bad = lit & ~use & unsound & ~saturated
    others = lit & ~use & ~(saturated | hit | bad)
    flags = BodyFlag.OVEREXPOSED, BodyFlag.OCCULTED, BodyFlag.BAD_PIXELS, BodyFlag.HIT
    return dict(zip(flags, (int(np.count_nonzero(n)) for n in (saturated, others, bad, hit)), strict=True))


def _confirming(disk: MeasuredDisk, reading: CenterReading) -> SecondReading | None:
    """Return the reading that may confirm a center: none without crossings, for those of its place have held a fit there."""
    return None if disk.crossing is None else reading.second


def _confirmed(disk: MeasuredDisk, reading: CenterReading) -> bool:
    second = _confirming(disk, reading)
    if second is None:
        return False
    return same_center(second.pixel_line - reading.center_px, second.difference_sigmas)


def _holds_beside_other_light(disk: MeasuredDisk, reading: CenterReading) -> bool:
    """Tell whether a center may be believed of a picture that has light which no model has.

    That light is in its sigmas as far as cells show it, and the limb has to be where the fit has it: by crossings that know
    nothing of the fitted albedo, for that takes such light for its own.
    """
    crossing = disk.crossing
    return crossing is not None and not crossing.patterned and _confirmed(disk, reading)


def _notes(disk: MeasuredDisk, reading: CenterReading) -> dict[BodyFlag, str]:
    second = _confirming(disk, reading)
    apart = "no second reading: too little of its limb can be crossed"
    if second is not None:
        apart = _apart(second, reading.center_px)
    return {
        BodyFlag.CIRCLE_MISFIT: size_words(reading.log_size),
        BodyFlag.UNCONFIRMED: apart,
        BodyFlag.EMPTY: f"{100.0 * disk.fit.lit_share:.0f} % of its limb is lit and in sight",
        BodyFlag.OVEREXPOSED: "take a shorter exposure",
        BodyFlag.ROUGH_LIMB: f"its relief is {100.0 * disk.relief_share:.1f} % of the radius: state its limb_roughness, or "
        "give its shape",
        **reading.notes,
    }


def _pictures(disk: MeasuredDisk) -> BodyResiduals:
    fit, picture, pixels = disk.fit, disk.picture, disk.pixels
    about = Circle(fit.center_px, disk.radius_px)
    window = choose_subarray(picture, disk.name, about, fit.reach_px[1]).window
    here = fit.pixels.index
    model, mask = np.zeros(pixels.use.shape), np.zeros(pixels.use.shape, dtype=bool)
    level = float(fit.solution.theta[Unknown.LEVEL])
    model[here] = fit.model_dn() - level
    mask[here] = pixels.use[here]
    pixel, line, n_pixel, n_line = window
    part = np.s_[line : line + n_line, pixel : pixel + n_pixel]
    data = np.nan_to_num(picture.signal_dn[part]) - level
    shown = np.where(mask[part], model[part], 0.0)
    return BodyResiduals(window, data, shown, np.where(mask[part], data - shown, 0.0), mask[part])
