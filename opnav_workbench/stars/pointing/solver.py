"""Camera attitude from the measured centers of identified stars: input checked, stars chosen, the outcome in words.

Flow   `stars` (centers), `scene` (apparent directions, catalog covariance) -> here -> `observables`, CK
Frame  J2000 and the camera's own SPICE frame
Units  px, rad

Reference: Jackman & Dumont (2013), AAS 13-443, "Spacecraft Repointing Solution".
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import (
    checked_rotation,
    matrix_from_quaternion,
    pointing_angles,
    quaternion_from_matrix,
)
from opnav_workbench.stars.pointing.attitude_fit import (
    AttitudeFit,
    AttitudePrior,
    PointingProblem,
    catalog_turns,
    fit_attitude,
    with_common_errors,
)
from opnav_workbench.stars.pointing.attitude_steps import POINTING_MODELS, PointingModel, StepModel
from opnav_workbench.stars.pointing.closed_form import ClosedForm, wahba
from opnav_workbench.stars.pointing.motion_tails import MotionTails, effective_covariance
from opnav_workbench.stars.pointing.residuals import BELIEVED, StarSelection, chi2_probability, select_stars
from opnav_workbench.stars.pointing.solution import PointingSolution, steps_between

__all__ = ["PointingStart", "solve_pointing"]


# ---- What a caller gives to `solve_pointing`, checked, and sorted into usable stars and reasons why not.

PointingStart = Literal["a_priori"] | ClosedForm
POINTING_STARTS = ("a_priori", *get_args(ClosedForm))

MIN_RECIPROCAL_CONDITION = 1e-12  # a covariance flatter than this has lost a direction to rounding


@dataclass(frozen=True, slots=True, eq=False)
class PointingInput:
    """All n stars of the caller, used or not.

    Attributes
    ----------
    sightings
        The usable ones.
    index : (m,) array of int
        Their rows.
    observed_px : (n, 2) array
    directions : (n, 3) array
    reasons
        Why a star is not usable, "" where it is; n entries.
    """

    sightings: PointingProblem
    index: np.ndarray
    observed_px: FloatArray
    directions: FloatArray
    reasons: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def checked_input(
    observed_px: ArrayLike,
    covariance_px2: ArrayLike,
    catalog_covariance_px2: ArrayLike | None,
    directions: ArrayLike,
    usable: ArrayLike | None,
    camera: Camera,
    a_priori: ArrayLike,
    twist_sigma_rad: float | None,
    a_priori_covariance_rad2: ArrayLike | None,
    start: PointingStart,
) -> PointingInput:
    """Return the checked input.

    Raises
    ------
    PointingError
        An array of the wrong shape, an a priori attitude that is no rotation, a twist sigma that is not
        positive, an a priori covariance that is not positive definite, or an unknown start.
    """
    observed = _checked_array("observed_px", observed_px, None, 2)
    n = len(observed)
    covariance = _checked_array("covariance_px2", covariance_px2, n, 2, 2)
    if catalog_covariance_px2 is not None:
        covariance = covariance + _checked_array("catalog_covariance_px2", catalog_covariance_px2, n, 2, 2)
    covariance = symmetric(covariance)
    sky = _checked_array("directions", directions, n, 3)
    wanted: BoolArray = np.ones(n, dtype=bool) if usable is None else np.asarray(usable, dtype=bool)
    if wanted.shape != (n,):
        raise PointingError(f"usable has shape {wanted.shape}, expected ({n},): one entry per star")
    attitude = _checked_attitude(a_priori)
    camera = camera.standing(attitude)
    if start not in POINTING_STARTS:
        raise PointingError(f"unknown start {start!r}; use one of {', '.join(POINTING_STARTS)}")
    reasons = _reasons_unusable(wanted, observed, covariance, camera.project(sky @ attitude.T), start)
    index = np.array([i for i, reason in enumerate(reasons) if not reason], dtype=np.int64)
    prior = AttitudePrior(
        attitude,
        camera.boresight,
        _twist_sigma(twist_sigma_rad, camera),
        None if a_priori_covariance_rad2 is None else _checked_attitude_covariance(a_priori_covariance_rad2),
    )
    begin = _start_attitude(start, observed[index], covariance[index], sky[index], camera, attitude)
    sightings = PointingProblem(observed[index], covariance[index], sky[index], camera, prior, begin)
    return PointingInput(sightings, index, observed, sky, reasons)


def _start_attitude(
    start: PointingStart,
    observed: FloatArray,
    covariance: FloatArray,
    sky: FloatArray,
    camera: Camera,
    a_priori: FloatArray,
) -> FloatArray:
    """Attitude (3, 3) to start from; stars that leave a closed form open take the a priori one."""
    if start == "a_priori":
        return a_priori
    in_camera = camera.unproject(observed)
    seen = np.isfinite(in_camera).all(axis=1)
    if not seen.any():
        return a_priori
    weights = 2.0 / np.trace(covariance[seen], axis1=1, axis2=2)
    try:
        return wahba(in_camera[seen], sky[seen], weights, start)
    except PointingError:
        return a_priori


def _reasons_unusable(
    wanted: BoolArray,
    observed: FloatArray,
    covariance: FloatArray,
    predicted: FloatArray,
    start: PointingStart,
) -> tuple[str, ...]:
    finite: BoolArray = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], covariance, np.eye(2)))
    definite = eigenvalues[:, 0] > MIN_RECIPROCAL_CONDITION * np.abs(eigenvalues[:, 1])
    reasons = np.full(len(observed), "", dtype=object)
    # From the least to the most basic reason, which is the one that stays.
    if start == "a_priori":
        reasons[~np.isfinite(predicted).all(axis=1)] = "out of sight at the a priori attitude"
    reasons[~(finite & definite)] = "no usable covariance of its center"
    reasons[~np.isfinite(observed).all(axis=1)] = "no center"
    reasons[~wanted] = "not offered"
    return tuple(reasons.tolist())


def _checked_array(name: str, values: ArrayLike, n: int | None, *rest: int) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.size == 0 and n in (None, 0):
        return np.zeros((0, *rest))
    if array.shape[1:] != rest or (n is not None and len(array) != n):
        expected = ", ".join(map(str, ("n" if n is None else n, *rest)))
        raise PointingError(f"{name} has shape {array.shape}, expected ({expected}): one row per star")
    return array


def _checked_attitude(a_priori: ArrayLike) -> FloatArray:
    try:
        rotation = checked_rotation(a_priori, "a_priori_camera_from_j2000")
    except ValueError as error:
        raise PointingError(str(error)) from error
    # A matrix printed with few digits is orthonormal to 1e-7 only, which is already a tenth of a pixel.
    return matrix_from_quaternion(quaternion_from_matrix(rotation))


def _twist_sigma(twist_sigma_rad: float | None, camera: Camera) -> float:
    sigma = camera.a_priori_sigma_rad[2] if twist_sigma_rad is None else twist_sigma_rad
    if not 0.0 < sigma < np.inf:
        raise PointingError(
            f"twist_sigma_rad is {sigma}; give a positive number (1 sigma of the a priori twist)"
        )
    return float(sigma)


def _checked_attitude_covariance(covariance_rad2: ArrayLike) -> FloatArray:
    covariance = np.asarray(covariance_rad2, dtype=np.float64)
    if covariance.shape != (3, 3):
        raise PointingError(f"a_priori_covariance_rad2 has shape {covariance.shape}, expected (3, 3)")
    covariance = symmetric(covariance)
    if not (np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] > 0.0):
        raise PointingError(
            "a_priori_covariance_rad2 is not positive definite; give the covariance of the rotation vector about "
            "the camera frame's axes, rad^2"
        )
    return covariance


# ---- Camera attitude from the measured centers of identified stars.

UNLIKELY = 0.01  # a chi-squared this rare is worth a word to the analyst


def solve_pointing(
    observed_px: ArrayLike,
    covariance_px2: ArrayLike,
    directions: ArrayLike,
    camera: Camera,
    a_priori_camera_from_j2000: ArrayLike,
    *,
    catalog_covariance_px2: ArrayLike | None = None,
    common_px: FloatArray | None = None,
    model: PointingModel = "euler",
    usable: ArrayLike | None = None,
    trusted: ArrayLike | None = None,
    twist_sigma_rad: float | None = None,
    a_priori_covariance_rad2: ArrayLike | None = None,
    start: PointingStart = "a_priori",
    motion_tails: MotionTails | None = None,
) -> PointingSolution:
    """Solve for the camera attitude that brings predicted stars onto their measured centers.

    Stars are weighted by the inverse of their center and catalog covariances. Outliers are rejected (see
    `PointingSolution.reasons`); how much more than their covariances say the others may scatter, as far as their
    residuals tell, enters weights and covariance as one excess centering sigma.

    Parameters
    ----------
    observed_px : (n, 2) array_like
        Measured centers (pixel, line); rows with nan are not used.
    covariance_px2 : (n, 2, 2) array_like
        Covariances of the centers.
    directions : (n, 3) array_like
        Apparent directions of the same stars, J2000 (space motion, parallax and stellar aberration applied).
    a_priori_camera_from_j2000 : (3, 3) array_like
    catalog_covariance_px2 : (n, 2, 2) array_like, optional
        Covariances of the predicted places.
    common_px : (n, 2, r) array, optional
        What of `covariance_px2` the stars share, such as an error of the PSF that all were fitted with: what each of r
        independent one-sigma errors makes of their centers. In the attitude's covariance they do not average out.
    model : {"euler", "image_plane"}
        Characterization of the attitude (see `opnav_workbench.stars.pointing.attitude_steps`); both find the same attitude,
        but for residuals times distortion.
    usable : (n,) array_like of bool, optional
        False for stars that must not be used.
    trusted : (n,) array_like of bool, optional
        True for usable stars that must not be rejected as outliers.
    twist_sigma_rad
        1 sigma of the a priori rotation about the boresight, by default the camera's ``attitude_sigma``. It
        counts where the stars alone determine that rotation less well.
    a_priori_covariance_rad2 : (3, 3) array_like, optional
        Covariance of the a priori attitude (rotation vector about the camera frame's axes). Given, the a priori
        attitude enters as a measurement of all three angles, however few or many the stars.
    start : {"a_priori", "svd", "q_method"}
        Where the iteration starts: the a priori attitude, or a closed form from the stars themselves (see
        `opnav_workbench.stars.pointing.closed_form`), which is then the first step. One star always starts a priori.
    motion_tails
        What of `catalog_covariance_px2` stems from motions that nobody measured, (n) stars, and how they are distributed:
        each star then counts by what the others say of it (see `opnav_workbench.stars.pointing.motion_tails`).

    Raises
    ------
    PointingError
        No usable star, no attitude that fits them, or input of the wrong shape.

    Examples
    --------
    The whole picture is off by 4.5 px and 12.3 lines:

    >>> from opnav_workbench.geometry import camera_from_j2000
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> a_priori = camera_from_j2000(1.0, 0.3, 2.0, camera.focal_from_camera)
    >>> predicted = np.array([[100.0, 200.0], [900.0, 300.0], [400.0, 800.0]])
    >>> stars = camera.unproject(predicted) @ a_priori
    >>> covariance = np.tile(0.01 * np.eye(2), (3, 1, 1))
    >>> solution = solve_pointing(predicted + [4.5, 12.3], covariance, stars, camera, a_priori)
    >>> print(f"{solution.delta_pixel:.2f} px, {solution.delta_line:.2f} lines, {solution.n_stars} stars")
    4.50 px, 12.30 lines, 3 stars
    """
    if model not in POINTING_MODELS:
        raise PointingError(f"unknown pointing model {model!r}; use one of {', '.join(POINTING_MODELS)}")
    given = checked_input(
        observed_px,
        covariance_px2,
        catalog_covariance_px2,
        directions,
        usable,
        camera,
        a_priori_camera_from_j2000,
        twist_sigma_rad,
        a_priori_covariance_rad2,
        start,
    )
    if len(given.sightings) == 0:
        raise PointingError(
            f"none of {len(given.reasons)} stars is usable, so the attitude cannot be solved; "
            "search fainter stars or a larger radius, or keep the a priori attitude"
        )
    selection, fit = _select_and_fit(given, model, _trusted(given, trusted), motion_tails)
    if common_px is not None:
        fit = _with_common(given, selection, fit, common_px)
    centers = None if catalog_covariance_px2 is None else symmetric(np.asarray(covariance_px2, float))
    return _solution(given, selection, fit, model, centers)


def _trusted(given: PointingInput, trusted: ArrayLike | None) -> BoolArray | None:
    """Return which of the usable stars are trusted."""
    if trusted is None:
        return None
    mask = np.asarray(trusted, dtype=bool)
    if mask.shape != (len(given.reasons),):
        raise PointingError(
            f"trusted has shape {mask.shape}, expected ({len(given.reasons)},): one entry per star"
        )
    return np.asarray(mask[given.index])


def _select_and_fit(
    given: PointingInput, model: PointingModel, trusted: BoolArray | None, tails: MotionTails | None
) -> tuple[StarSelection, AttitudeFit]:
    """Choose the stars, then fit them from the a priori attitude on: those steps are reported."""
    stars, steps = given.sightings, POINTING_MODELS[model](given.sightings.camera)
    everyone = np.ones(len(stars), dtype=bool)
    moving = None if tails is None else tails.take(given.index)
    stars = _with_tails(stars, steps, moving, everyone)
    selection = select_stars(stars, steps, trusted)
    if selection is not None and moving is not None and not selection.used.all():
        stars = _with_tails(given.sightings, steps, moving, selection.used)
        selection = select_stars(stars, steps, trusted)
    if selection is not None and selection.fit.path[0] is stars.start:
        return selection, selection.fit
    if selection is not None:
        fit = fit_attitude(stars, steps, stars.start, selection.used, selection.excess_sigma_px)
        if fit is not None:
            return selection, fit
    raise PointingError(
        f"no attitude near the a priori one fits the {len(stars)} usable stars; check their identification"
    )


def _with_common(
    given: PointingInput, selection: StarSelection, fit: AttitudeFit, common_px: FloatArray
) -> AttitudeFit:
    """Return the fit with what the used stars share in its covariance."""
    if common_px.shape[:2] != (len(given.reasons), 2):
        raise PointingError(
            f"common_px has shape {common_px.shape}, expected ({len(given.reasons)}, 2, r): one row per star"
        )
    # The excess is then in the covariance alone, not in the weights
    believed = chi2_probability(fit.linear) >= BELIEVED
    used = common_px[given.index][selection.used]
    return with_common_errors(fit, used, 0.0 if believed else selection.excess_sigma_px)


def _with_tails(
    stars: PointingProblem, steps: StepModel, tails: MotionTails | None, used: BoolArray
) -> PointingProblem:
    """Return the stars with the covariances that they have beside the `used` ones, unknown motions and all."""
    if tails is None or not tails.covariance_px2.any():
        return stars
    fit = fit_attitude(stars, steps, stars.start, used)
    if fit is None:
        return stars
    prior = stars.prior.rows(0.0)
    covariance = np.array(stars.covariance_px2)
    covariance[used] = effective_covariance(
        fit.residual_px[used], fit.jacobian[used], covariance[used], tails.take(used), prior.T @ prior
    )
    return replace(stars, covariance_px2=covariance)


def _solution(
    given: PointingInput,
    selection: StarSelection,
    fit: AttitudeFit,
    model: PointingModel,
    center_covariance_px2: FloatArray | None,
) -> PointingSolution:
    camera = given.sightings.camera.standing(fit.attitude)
    used = np.zeros(len(given.reasons), dtype=bool)
    used[given.index] = selection.used
    residual = given.observed_px - camera.project(given.directions @ fit.attitude.T)
    turns = np.zeros((0, 3, 2))
    if center_covariance_px2 is not None:
        turns = np.zeros((len(used), 3, 2))
        turns[used] = catalog_turns(
            fit, center_covariance_px2[used], given.directions[used], selection.excess_sigma_px
        )
    steps = steps_between(camera, _attitude_path(given, fit))
    ra, dec, twist = pointing_angles(fit.attitude, camera.focal_from_camera)
    return PointingSolution(
        camera_from_j2000=fit.attitude,
        covariance_rad2=fit.covariance_rad2,
        formal_covariance_rad2=fit.formal_covariance_rad2,
        ra_rad=ra,
        dec_rad=dec,
        twist_rad=twist,
        delta_pixel=sum(step.delta_pixel for step in steps),
        delta_line=sum(step.delta_line for step in steps),
        delta_twist_rad=sum(step.delta_twist_rad for step in steps),
        iterations=steps,
        rms_px=float(np.sqrt(np.mean(residual[used] ** 2))),
        n_stars=int(np.sum(used)),
        used=used,
        reasons=_reasons_not_used(given, selection, residual),
        residual_px=residual,
        excess_sigma_px=selection.excess_sigma_px,
        chi2_reduced=fit.linear.chi2(0.0) / fit.linear.freedom if fit.linear.freedom > 0 else float("nan"),
        model=model,
        twist_solved=fit.twist_solved,
        messages=_messages(given, selection, fit),
        catalog_turns_rad=turns,
    )


def _attitude_path(given: PointingInput, fit: AttitudeFit) -> tuple[FloatArray, ...]:
    """Attitudes from the a priori one on; a closed form is the first step from it."""
    a_priori = given.sightings.prior.attitude
    return fit.path if np.array_equal(fit.path[0], a_priori) else (a_priori, *fit.path)


def _reasons_not_used(
    given: PointingInput, selection: StarSelection, residual_px: FloatArray
) -> tuple[str, ...]:
    reasons = list(given.reasons)
    for i in np.flatnonzero(~selection.used):
        size = float(np.linalg.norm(residual_px[given.index[i]]))
        reasons[given.index[i]] = (
            f"residual {_two_digits(size)} px is {_two_digits(float(selection.distance[i]))} sigma"
        )
    return tuple(reasons)


def _messages(given: PointingInput, selection: StarSelection, fit: AttitudeFit) -> tuple[str, ...]:
    rejected = int(np.sum(~selection.used))
    prior = _prior_message(given.sightings.prior, int(np.sum(selection.used)), fit)
    messages = [prior, _excess_message(selection, fit)]
    if rejected:
        messages.append(f"{rejected} of {len(selection.used)} stars rejected as outliers")
    if selection.ambiguous:
        messages.append(
            "three stars disagree, and it cannot be told which one is wrong: all are used; "
            "check their identification"
        )
    return tuple(message for message in messages if message)


def _prior_message(prior: AttitudePrior, n_used: int, fit: AttitudeFit) -> str:
    if fit.twist_solved:
        return ""
    value = f"its a priori value ({_two_digits(np.degrees(prior.twist_sigma_rad))} deg, 1 sigma)"
    if prior.covariance_rad2 is not None:
        sigma = np.degrees(np.sqrt(prior.axis @ prior.covariance_rad2 @ prior.axis))
        value = f"the a priori attitude ({_two_digits(float(sigma))} deg, 1 sigma)"
    if n_used == 1:
        return f"one star: the twist (rotation about the boresight) is held at {value}"
    return (
        f"{n_used} stars determine the twist (rotation about the boresight) less well than {value}, "
        "which therefore enters as a measurement"
    )


def _excess_message(selection: StarSelection, fit: AttitudeFit) -> str:
    """What is worth telling: an excess that chance does not explain, not the little that can never be excluded."""
    if selection.excess_sigma_px == 0.0 or chi2_probability(fit.linear) >= UNLIKELY:
        return ""
    chi2, freedom = _two_digits(fit.linear.chi2(0.0)), fit.linear.freedom
    return (
        f"residuals exceed their covariances (chi-squared {chi2} for {freedom} degrees of freedom, "
        f"probability {chi2_probability(fit.linear):.1g}): an excess centering error of "
        f"{selection.excess_sigma_px:.3f} px is added to every star"
    )


def _two_digits(value: float) -> str:
    """Two significant digits, but never an exponent for numbers a person reads at a glance."""
    if value >= 10.0:
        return f"{value:.0f}"
    return f"{value:.1f}" if value >= 1.0 else f"{value:.2g}"
