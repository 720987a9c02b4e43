"""Camera attitude from the measured centers of identified stars.

Flow   `starcenters` (centers), `scene` (apparent directions, catalog covariance) -> here -> `observables`, CK
Frame  J2000 and the camera's own SPICE frame
Units  px, rad

Reference: Jackman & Dumont (2013), AAS 13-443, "Spacecraft Repointing Solution".
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.pointing.excess import probability
from opnav_workbench.pointing.fit import Fit, fit_attitude
from opnav_workbench.pointing.inputs import Given, Start, check_given
from opnav_workbench.pointing.models import MODELS, Model
from opnav_workbench.pointing.prior import Prior
from opnav_workbench.pointing.results import PointingSolution
from opnav_workbench.pointing.robust import Selection, select_stars
from opnav_workbench.pointing.shift import steps_between

__all__ = ["solve_pointing"]

UNLIKELY = 0.01  # a chi-squared this rare is worth a word to the analyst


def solve_pointing(
    observed_px: ArrayLike,
    covariance_px2: ArrayLike,
    directions: ArrayLike,
    camera: Camera,
    a_priori_camera_from_j2000: ArrayLike,
    *,
    catalog_covariance_px2: ArrayLike | None = None,
    model: Model = "euler",
    usable: ArrayLike | None = None,
    trusted: ArrayLike | None = None,
    twist_sigma_rad: float | None = None,
    a_priori_covariance_rad2: ArrayLike | None = None,
    start: Start = "a_priori",
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
    camera : Camera
    a_priori_camera_from_j2000 : (3, 3) array_like
    catalog_covariance_px2 : (n, 2, 2) array_like, optional
        Covariances of the predicted places.
    model : {"euler", "image_plane"}
        Characterization of the attitude (see `opnav_workbench.pointing.models`); both find the same attitude,
        but for residuals times distortion.
    usable : (n,) array_like of bool, optional
        False for stars that must not be used.
    trusted : (n,) array_like of bool, optional
        True for usable stars that must not be rejected as outliers.
    twist_sigma_rad : float, optional
        1 sigma of the a priori rotation about the boresight, by default the camera's ``attitude_sigma``. It
        counts where the stars alone determine that rotation less well.
    a_priori_covariance_rad2 : (3, 3) array_like, optional
        Covariance of the a priori attitude (rotation vector about the camera frame's axes). Given, the a priori
        attitude enters as a measurement of all three angles, however few or many the stars.
    start : {"a_priori", "svd", "q_method"}
        Where the iteration starts: the a priori attitude, or a closed form from the stars themselves (see
        `opnav_workbench.pointing.wahba`), which is then the first step. One star always starts a priori.

    Returns
    -------
    PointingSolution

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
    if model not in MODELS:
        raise PointingError(f"unknown pointing model {model!r}; use one of {', '.join(MODELS)}")
    given = check_given(
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
    selection, fit = _solve(given, model, _trusted(given, trusted))
    return _solution(given, selection, fit, model)


def _trusted(given: Given, trusted: ArrayLike | None) -> BoolArray | None:
    """Return which of the usable stars are trusted."""
    if trusted is None:
        return None
    mask = np.asarray(trusted, dtype=bool)
    if mask.shape != (len(given.reasons),):
        raise PointingError(
            f"trusted has shape {mask.shape}, expected ({len(given.reasons)},): one entry per star"
        )
    return np.asarray(mask[given.index])


def _solve(given: Given, model: Model, trusted: BoolArray | None) -> tuple[Selection, Fit]:
    """Choose the stars, then fit them from the a priori attitude on: those steps are reported."""
    stars, steps = given.sightings, MODELS[model](given.sightings.camera)
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


def _solution(given: Given, selection: Selection, fit: Fit, model: Model) -> PointingSolution:
    camera = given.sightings.camera
    used = np.zeros(len(given.reasons), dtype=bool)
    used[given.index] = selection.used
    residual = given.observed_px - camera.project(given.directions @ fit.attitude.T)
    steps = steps_between(camera, _path(given, fit))
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
        reasons=_reasons(given, selection, residual),
        residual_px=residual,
        excess_sigma_px=selection.excess_sigma_px,
        chi2_reduced=fit.linear.chi2(0.0) / fit.linear.freedom if fit.linear.freedom > 0 else float("nan"),
        model=model,
        twist_solved=fit.twist_solved,
        messages=_messages(given, selection, fit),
    )


def _path(given: Given, fit: Fit) -> tuple[FloatArray, ...]:
    """Attitudes from the a priori one on; a closed form is the first step from it."""
    a_priori = given.sightings.prior.attitude
    return fit.path if np.array_equal(fit.path[0], a_priori) else (a_priori, *fit.path)


def _reasons(given: Given, selection: Selection, residual_px: FloatArray) -> tuple[str, ...]:
    reasons = list(given.reasons)
    for i in np.flatnonzero(~selection.used):
        size = float(np.linalg.norm(residual_px[given.index[i]]))
        reasons[given.index[i]] = (
            f"residual {_short(size)} px is {_short(float(selection.distance[i]))} sigma"
        )
    return tuple(reasons)


def _messages(given: Given, selection: Selection, fit: Fit) -> tuple[str, ...]:
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


def _prior_message(prior: Prior, n_used: int, fit: Fit) -> str:
    if fit.twist_solved:
        return ""
    value = f"its a priori value ({_short(np.degrees(prior.twist_sigma_rad))} deg, 1 sigma)"
    if prior.covariance_rad2 is not None:
        sigma = np.degrees(np.sqrt(prior.axis @ prior.covariance_rad2 @ prior.axis))
        value = f"the a priori attitude ({_short(float(sigma))} deg, 1 sigma)"
    if n_used == 1:
        return f"one star: the twist (rotation about the boresight) is held at {value}"
    return (
        f"{n_used} stars determine the twist (rotation about the boresight) less well than {value}, "
        "which therefore enters as a measurement"
    )


def _excess_message(selection: Selection, fit: Fit) -> str:
    """What is worth telling: an excess that chance does not explain, not the little that can never be excluded."""
    if selection.excess_sigma_px == 0.0 or probability(fit.linear) >= UNLIKELY:
        return ""
    chi2, freedom = _short(fit.linear.chi2(0.0)), fit.linear.freedom
    return (
        f"residuals exceed their covariances (chi-squared {chi2} for {freedom} degrees of freedom, "
        f"probability {probability(fit.linear):.1g}): an excess centering error of "
        f"{selection.excess_sigma_px:.3f} px is added to every star"
    )


def _short(value: float) -> str:
    """Two significant digits, but never an exponent for numbers a person reads at a glance."""
    if value >= 10.0:
        return f"{value:.0f}"
    return f"{value:.1f}" if value >= 1.0 else f"{value:.2g}"
