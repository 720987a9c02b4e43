"""Center of a body by scans across its limb, which albedo features on its disk do not move.

Flow   expected place -> coarse search -> scans over a wide range (``acquisition``) -> rendered model at the center -> data
       and model along each scan -> offset of each (``matching``) -> scans chosen (``selection``) -> center by least
       squares (``center_solution``) -> model at the new center, until that moves by less than 0.01 px -> `BodyCenter`
       with flags, status, pictures, and what every scan showed (`LimbScans`)

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.detection import DetectedBody, ExpectedBody, detect_body, expect_body
from opnav_workbench.bodies.limb_scan.acquisition import Acquisition, acquire
from opnav_workbench.bodies.limb_scan.fan import N_SCANS, STEP_PX, ScanFan, ScanSampler
from opnav_workbench.bodies.limb_scan.iteration import FEWEST, ScanIteration, ScanSolution, iterate_center
from opnav_workbench.bodies.limb_scan.matching import correlate_scans
from opnav_workbench.bodies.limb_scan.selection import ScanSelection, checked_scan_numbers
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import (
    DOUBTFUL_FLAGS,
    REJECTED,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    LimbScans,
    flag_messages,
    flags_where,
    size_messages,
)
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.constants import FWHM_PER_SIGMA
from opnav_workbench.errors import CenterfindingError

__all__ = ["find_limb_scan"]


# ---- The result of a limb scan: center, flags and status, pictures, and what every scan showed.

LAG_PX = 5.0  # to each side: what an analyst looks at
POOR_CHI2 = 4.0
POOR_SHARE = 0.35  # of the scans rejected: more, and they do not see one body
BRIGHT_SKY = 0.2  # light beside the limb over that inside: more, and an edge within the disk was taken for it
WEAK_SIGMA_PX = 0.3
WEAK_RATIO = 10.0  # of the axes of the error ellipse, if the larger one matters
WEAK_MATTERS_PX = 0.05
LIMIT_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ScanRun:
    """A limb scan that has come to its end."""

    picture: BodyPicture
    found: DetectedBody
    captured: Acquisition
    solution: ScanSolution
    by_hand: bool
    size_solved: bool

    @property
    def name(self) -> str:
        """Of the body."""
        return self.found.expectation.name

    @property
    def fan(self) -> ScanFan:
        """The scans."""
        return self.captured.fan

    @property
    def last(self) -> ScanIteration:
        """The last round."""
        assert self.solution.last is not None
        return self.solution.last

    @property
    def size_ratio(self) -> float:
        """Size of the body's image over that of the a priori model."""
        return float(np.exp(self.last.solved.size))


def report_scan_run(run: ScanRun, method: str) -> BodyCenter:
    """Return the body's center with everything that is known of it."""
    flags = _flags(run)
    status = "uncertain" if flags & DOUBTFUL_FLAGS or _too_uncertain(run) else "ok"
    model = _final_model(run)
    use = run.last.evaluation.cutout.use
    under = float(np.sum(model[use] ** 2))
    scale = (
        float(np.sum(run.last.evaluation.cutout.data_dn[use] * model[use])) / under if under > 0.0 else np.nan
    )
    scatter = run.last.match.brightness[run.last.solved.used]
    detail = _detail(run, float(np.mean(scatter)), model)
    excess = run.picture.excess_sigma_px**2 * np.eye(2)
    diameter = run.picture.diameter_px(run.name) * run.size_ratio
    distance = run.picture.model(run.name).target.range_km
    return BodyCenter(
        name=run.name,
        method=method,
        status=status,
        pixel_line=run.last.evaluation.center + run.last.solved.step_px,
        covariance_px2=run.last.solved.covariance_px2 + excess,
        flux_dn=scale * run.last.evaluation.body.flux_dn,
        snr=run.found.place.snr,
        diameter_px=diameter,
        diameter_sigma_px=diameter * run.last.solved.size_sigma,
        messages=_messages(run, flags),
        flags=int(flags),
        noise_covariance_px2=run.last.solved.noise_covariance_px2,
        chi2_reduced=run.last.solved.chi2_reduced,
        brightness_scale=scale,
        brightness_scale_sigma=float(np.std(scatter) / np.sqrt(len(scatter))),
        range_km=distance / run.size_ratio if run.size_solved else np.nan,
        range_sigma_km=distance / run.size_ratio * run.last.solved.size_sigma if run.size_solved else np.nan,
        background_dn=float(np.median(run.last.match.background_dn[run.last.solved.used])),
        background_sigma_dn=float(
            np.std(run.last.match.background_dn[run.last.solved.used]) / np.sqrt(len(scatter))
        ),
        pictures=_pictures(run, scale * model),
        detail=detail,
    )


def _final_model(run: ScanRun) -> FloatArray:
    """Return the body's light at the solution: the last picture, moved by the last step."""
    moved = run.last.evaluation.body.light_dn + np.tensordot(
        run.last.solved.step_px, run.last.evaluation.body.slope_dn, axes=1
    )
    return np.asarray(np.maximum(moved, 0.0))


def _pictures(run: ScanRun, model_dn: FloatArray) -> BodyResiduals:
    pixel, line, n_pixel, n_line = run.last.evaluation.body.window
    data = run.picture.signal_dn[line : line + n_line, pixel : pixel + n_pixel]
    return BodyResiduals(
        run.last.evaluation.body.window, data, model_dn, data - model_dn, run.last.evaluation.cutout.use
    )


def _flags(run: ScanRun) -> BodyFlag:
    bright = run.last.evaluation.body.light_dn > 0.1 * run.last.evaluation.body.light_dn.max(initial=0.0)
    chosen, used = int(run.last.choice.chosen.sum()), int(run.last.solved.used.sum())
    minor, major = np.sqrt(np.maximum(np.linalg.eigvalsh(run.last.solved.covariance_px2), 0.0))
    pixel, line, n_pixel, n_line = run.last.evaluation.body.window
    part, cutout = np.s_[line : line + n_line, pixel : pixel + n_pixel], run.last.evaluation.cutout
    bad = run.picture.bad[part] | ~np.isfinite(run.picture.signal_dn[part])
    expected = run.found.expectation
    final = run.last.evaluation.center + run.last.solved.step_px
    conditions = {
        BodyFlag.CUT_BY_EDGE: _cut(run, final),
        BodyFlag.OVEREXPOSED: bool(np.any(bright & cutout.saturated)),
        BodyFlag.OCCULTED: bool(run.fan.covered.any()),
        BodyFlag.THIN_CRESCENT: _thin(run),
        BodyFlag.CIRCLE_MISFIT: bool(_misfit_words(run)),
        BodyFlag.POOR_FIT: run.last.solved.chi2_reduced > POOR_CHI2
        or used < (1.0 - POOR_SHARE) * chosen
        or _sky_share(run) > BRIGHT_SKY,
        BodyFlag.AT_LIMIT: float(np.hypot(*(final - expected.center_px))) > expected.search_px + LIMIT_PX,
        BodyFlag.WEAK_GEOMETRY: major > WEAK_SIGMA_PX
        or (major > WEAK_MATTERS_PX and major > WEAK_RATIO * minor),
        BodyFlag.BAD_PIXELS: bool(np.any(bright & bad)),
        BodyFlag.HIT: bool(np.any(bright & ~cutout.use & ~cutout.saturated & ~bad)),
        BodyFlag.NOT_CONVERGED: not run.solution.converged,
    }
    return flags_where(conditions)


def _sky_share(run: ScanRun) -> float:
    """Return the light beside the limb over that inside of it: a limb has the dark of the sky behind it."""
    used = run.last.solved.used
    inside = (run.last.match.brightness[:, None] * run.last.evaluation.view.model).max(axis=1)
    with np.errstate(over="ignore"):  # a limb without any light inside has a share beyond all numbers
        share = run.last.match.background_dn[used] / np.maximum(inside[used], np.finfo(float).tiny)
    return float(np.median(share))


def _cut(run: ScanRun, center: FloatArray) -> bool:
    limb = center + run.fan.direction * run.fan.limb_px[:, None]
    size = np.array([run.picture.camera.n_pixel, run.picture.camera.n_line])
    return bool(np.any(limb < -0.5) or np.any(limb > size - 0.5))


def _thin(run: ScanRun) -> bool:
    """Tell whether the lit part is nowhere wider than the camera resolves."""
    width = float(np.median(run.fan.limb_px)) * (1.0 + np.cos(run.picture.phase_rad(run.name)))
    return bool(width < max(FWHM_PER_SIGMA * float(np.min(run.picture.psf.sigma_px)), 1.0))


def _misfit_words(run: ScanRun) -> str:
    significant = abs(run.size_ratio - 1.0) > 3.0 * run.last.solved.size_sigma
    words = size_messages(
        run.size_ratio if significant else np.nan,
        run.found.expectation.circle_ratio,
        run.picture.diameter_px(run.name),
        "its limb is",
        "check its range and radii",
    )
    return "; ".join(words)


def _too_uncertain(run: ScanRun) -> bool:
    """Tell whether too little of the body is left: half of the scans across the lit limb lost to edges and pixels."""
    limb = run.fan.crosses_limb
    share = float(run.last.choice.chosen[limb].mean()) if limb.any() else 0.0
    return bool(not run.by_hand and share < 0.3)


def _messages(run: ScanRun, flags: BodyFlag) -> tuple[str, ...]:
    size = run.picture.camera
    notes = {
        BodyFlag.CUT_BY_EDGE: f"the detector has {size.n_pixel} x {size.n_line} px",
        BodyFlag.OCCULTED: f"{int(run.fan.covered.sum())} scans left out",
        BodyFlag.CIRCLE_MISFIT: _misfit_words(run),
        BodyFlag.POOR_FIT: f"scatter of the scans {run.last.solved.chi2_reduced**0.5:.1f} times their sigmas, "
        f"{int((run.last.choice.chosen & ~run.last.solved.used).sum())} of {int(run.last.choice.chosen.sum())} rejected; "
        f"light beside the limb is {min(_sky_share(run), 99.0):.2g} times that inside",
        BodyFlag.WEAK_GEOMETRY: f"to {np.sqrt(np.linalg.eigvalsh(run.last.solved.covariance_px2)[1]):.2f} px",
    }
    messages = flag_messages(flags, notes)
    if _too_uncertain(run):
        messages.append("few scans of its lit limb could be used")
    return (*messages, *run.last.choice.summary)


def _detail(run: ScanRun, brightness: float, model_dn: FloatArray) -> LimbScans:
    fan, solved = run.fan, run.last.solved
    center = run.last.evaluation.center + solved.step_px
    last = int((fan.first + fan.n_samples).max())
    distance: FloatArray = STEP_PX * np.arange(last + 1.0)
    places = fan.places(center, distance)
    sampler = ScanSampler(places, run.last.evaluation.body.window)
    data = np.where(
        sampler.blocked(run.last.evaluation.cutout.use),
        np.nan,
        sampler.sample(run.last.evaluation.cutout.data_dn),
    )
    lag, correlation = _correlation(run)
    status, reason = _scan_statuses(run)
    known = np.isfinite(fan.edge_px)
    return LimbScans(
        start_px=center,
        angle_rad=fan.angle_rad,
        distance_px=distance,
        places_px=places,
        data_dn=data,
        model_dn=brightness * sampler.sample(model_dn),
        limb_px=fan.limb_px,
        edge_px=fan.edge_px,
        correlation=correlation,
        lag_px=lag,
        offset_px=np.where(known, run.last.match.offset_px, np.nan),
        sigma_px=np.where(known, run.last.errors.sigma_px, np.nan),
        motion=run.last.match.motion,
        brightness=run.last.match.brightness,
        unevenness=run.last.uneven,
        residual_px=np.where(known, solved.residual_px, np.nan),
        status=status,
        reason=reason,
        roughness=run.last.roughness,
        iterations=run.solution.steps,
        summary=run.last.choice.summary,
    )


def _correlation(run: ScanRun) -> tuple[FloatArray, FloatArray]:
    """Return lags (k,) px and correlations (n, k) about the last model's place."""
    reach = round(LAG_PX / STEP_PX)
    evaluation, fan = run.last.evaluation, run.fan
    sampler = ScanSampler(fan.places(evaluation.center, fan.distances(reach, reach)), evaluation.body.window)
    data, blocked = sampler.sample(evaluation.cutout.data_dn), sampler.blocked(evaluation.cutout.use)
    correlation = correlate_scans(run.last.system, evaluation.view.model, data, blocked, run.last.roughness)
    return np.asarray(STEP_PX * np.arange(-reach, reach + 1.0)), correlation


def _scan_statuses(run: ScanRun) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Return status and reason of every scan, with those of rejected outliers."""
    status, reason = run.last.choice.status.astype("<U12"), run.last.choice.reason.astype("<U160")
    for row in np.flatnonzero(run.last.choice.chosen & ~run.last.solved.used):
        residual, sigma = run.last.solved.residual_px[row], run.last.errors.sigma_px[row]
        status[row] = REJECTED
        reason[row] = (
            f"off by {residual:+.3f} px from the other scans, {abs(residual) / sigma:.1f} of its sigma"
        )
    return status, reason


# ---- Center of a body by scans across its limb, which albedo features on its disk do not move.

METHOD = "limb_scan"
WELL_EXPLAINED = 0.6  # share of the light under the model; an albedo map of Pluto's contrast leaves 0.9


def find_limb_scan(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    scans: Sequence[int] | None = None,
    n_scans: int = N_SCANS,
    solve_range: bool = False,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure with scans across its limb.

    Brightness and background of every scan are free, and the albedo near the limb is taken for a random function whose
    roughness the data tell; so neither an albedo map nor a wrong scattering law moves the center much.

    Parameters
    ----------
    circle
        Where an analyst sees the body.
    scans
        Numbers of the scans to use; scan k leaves the center at ``360 k / n_scans`` degrees from +pixel toward +line.
        None: they are chosen automatically.
    n_scans
        How many there are.
    solve_range
        Solve for the range from the size of the image. Without, the body has the size of its model unless the limb
        clearly says otherwise.
    search_radius_px
        How far from its prediction (or circle) the body may be.

    Returns
    -------
    BodyCenter
        `detail` is a `LimbScans`: every scan with its offset and the reason why it was used or not. Status ``ok``;
        ``uncertain`` (see its messages); ``not_detected``, ``off_detector``, ``saturated`` or ``failed`` without a
        center. `diameter_px` is measured with the same scans.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, has no size, or a scan number does not exist.
    """
    if n_scans < FEWEST:
        raise CenterfindingError(
            f"{n_scans} scans cannot give a center; use {FEWEST} at least, such as {N_SCANS}."
        )
    numbers = None if scans is None else checked_scan_numbers(scans, n_scans)
    silhouette = Silhouette(picture, name)
    expected = expect_body(picture, name, METHOD, circle, search_radius_px)
    if isinstance(expected, BodyCenter):
        return expected
    found = _found(picture, expected, solve_range=solve_range)
    if isinstance(found, BodyCenter):
        return found
    try:
        captured = acquire(picture, silhouette, found.sized_place.center_px, 1.0 / found.size_ratio, n_scans)
        solution = iterate_center(picture, name, captured, numbers, solve_size=solve_range)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, METHOD, "failed", str(error))
    if solution.last is None:
        return _undetermined(name, solution.choice)
    return report_scan_run(
        ScanRun(picture, found, captured, solution, numbers is not None, solve_range), METHOD
    )


def _found(picture: BodyPicture, expected: ExpectedBody, *, solve_range: bool) -> DetectedBody | BodyCenter:
    """Search with the size that is expected; with other sizes, which takes longer, only if that explains little."""
    found = detect_body(picture, expected, METHOD, solve_range=solve_range, other_sizes=False)
    unseen = isinstance(found, BodyCenter) and found.status == "not_detected"
    if unseen or (isinstance(found, DetectedBody) and found.place.explained < WELL_EXPLAINED):
        return detect_body(picture, expected, METHOD, solve_range=solve_range)
    return found


def _undetermined(name: str, choice: ScanSelection) -> BodyCenter:
    reasons, counts = np.unique(choice.reason[~choice.chosen], return_counts=True)
    said = [f"{n} scans: {text}" for n, text in sorted(zip(counts, reasons, strict=True), reverse=True)]
    message = f"{int(choice.chosen.sum())} usable scans do not determine a center"
    return BodyCenter.without_center(name, METHOD, "failed", message, *said[:3])
