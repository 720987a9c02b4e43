"""Center of a body by scans across its limb, with the model of a disk that all methods share.

Flow   measured disk -> scans about its center -> data and model along each -> offset of each (``matching``) -> scans
       chosen (``selection``) -> outline by least squares (``center_solution``) -> judgement
       (`opnav_workbench.bodies.judgement`), and what every scan showed (`LimbScans`)

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.fit import DiskShape, Unknown
from opnav_workbench.bodies.disk.measurement import MeasuredDisk, measure_disk
from opnav_workbench.bodies.judgement import (
    CenterReading,
    crossing_reading,
    difference_covariance,
    judged_center,
    second_reading,
)
from opnav_workbench.bodies.limb_scan.center_solution import FEWEST, OutlineStep, solve_outline
from opnav_workbench.bodies.limb_scan.fan import N_SCANS, STEP_PX, ScanSampler
from opnav_workbench.bodies.limb_scan.matching import ScanMatch, correlate_scans, match_scans
from opnav_workbench.bodies.limb_scan.selection import ScanSelection, checked_scan_numbers, choose_scans
from opnav_workbench.bodies.limb_scan.view import LAG_PX, ScanView, view_scans
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import REJECTED, BodyCenter, BodyFlag, LimbScans, SecondReading
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.threads import one_thread

__all__ = ["find_limb_scan"]

METHOD = "limb_scan"
# The likelihood stands where it is likeliest; from there one step is the answer of the scans, linear in the data. A second
# one from where noise and albedo have taken the first would follow these: 1.4 instead of 1.1 sigma of error on 30 disks.
# Farther than the PSF a limb's derivatives do not reach: then the scans are laid anew, `MOST_TURNS` times at the most.
LONGEST_PX, MOST_TURNS = 1.0, 8
MOSTLY = 0.5  # of the light on saturated pixels
SIZE = 2  # of the outline's step


@one_thread()
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

    Brightness and background of every scan are free; albedo, figure, law and PSF are as uncertain as the disk about the
    limb says (`opnav_workbench.bodies.disk`).

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
        Tell the range as well: that of a body of the model's size, with the uncertainty of that size.
    search_radius_px
        How far from its prediction (or circle) the body may be; None: anywhere.

    Returns
    -------
    BodyCenter
        `detail` is a `LimbScans`: every scan with its offset and the reason why it was used or not. Status ``ok`` where
        the likelihood of the whole disk and the crossings of the limb confirm the center; ``uncertain`` (see its
        messages); ``not_detected``, ``off_detector``, ``saturated`` or ``failed`` without a center. `diameter_px` is
        measured with the same scans.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, or a scan number does not exist.
    """
    if n_scans < FEWEST:
        raise CenterfindingError(
            f"{n_scans} scans cannot give a center; use {FEWEST} at least, such as {N_SCANS}."
        )
    numbers = None if scans is None else checked_scan_numbers(scans, n_scans)
    disk = measure_disk(picture, name, METHOD, circle, search_radius_px)
    if isinstance(disk, BodyCenter):
        return disk
    run = _scanned(disk, n_scans, numbers)
    if isinstance(run, ScanSelection):
        return _undetermined(disk, run)
    center = judged_center(disk, _reading(run), _detail(run), solve_range=solve_range)
    return replace(center, messages=(*center.messages, *run.choice.summary))


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """A limb scan that has come to its end."""

    disk: MeasuredDisk
    shape: DiskShape
    view: ScanView
    match: ScanMatch
    choice: ScanSelection
    solved: OutlineStep
    steps: tuple[tuple[float, float], ...]

    @property
    def center_px(self) -> FloatArray:
        return np.asarray(self.shape.center_px + self.solved.step[:2])


def _scanned(disk: MeasuredDisk, n_scans: int, numbers: NDArray[np.int64] | None) -> _Run | ScanSelection:
    shape, steps = disk.fit.shape, []
    while True:
        view = view_scans(disk, shape, n_scans)
        match = match_scans(view, disk.fit)
        choice = choose_scans(disk, view, match, numbers)
        if choice.chosen.sum() < FEWEST:
            return choice
        solved = solve_outline(match, choice.chosen, disk.fit, shape)
        length = float(np.hypot(*solved.step[:2]))
        part = min(1.0, LONGEST_PX / max(length, 1e-12))
        steps.append((part * float(solved.step[0]), part * float(solved.step[1])))
        if length < LONGEST_PX or len(steps) == MOST_TURNS:
            return _Run(disk, shape, view, match, choice, solved, tuple(steps))
        shape = _moved(shape, part * solved.step)


def _moved(shape: DiskShape, step: FloatArray) -> DiskShape:
    strain = shape.strain.copy()
    strain[:2] += step[SIZE + 1 : SIZE + 3]
    log_size = shape.log_size + float(step[SIZE])
    return replace(shape, center_px=shape.center_px + step[:2], log_size=log_size, strain=strain)


def _undetermined(disk: MeasuredDisk, choice: ScanSelection) -> BodyCenter:
    reasons, counts = np.unique(choice.reason[~choice.chosen], return_counts=True)
    said = [f"{n} scans: {text}" for n, text in sorted(zip(counts, reasons, strict=True), reverse=True)]
    message = f"{int(choice.chosen.sum())} usable scans do not determine a center"
    near, light = disk.fit.pixels, disk.fit.light_dn()
    saturated = disk.picture.saturated[near.index]
    if light[saturated].sum() > MOSTLY * light.sum():
        flags = int(BodyFlag.OVEREXPOSED)
        return BodyCenter.without_center(disk.name, METHOD, "saturated", message, *said[:3], flags=flags)
    return BodyCenter.without_center(disk.name, METHOD, "failed", message, *said[:3])


def _farther_reading(run: _Run) -> SecondReading:
    """Return the one that differs more of the likelihood, where the scans began, and of crossings that know no weights."""
    fit, own = run.disk.fit, run.solved.covariance[:2, :2]
    likelihood = second_reading(
        "the likelihood of the disk", fit.center_px, fit.covariance_px2, run.center_px, own
    )
    crossings = crossing_reading(run.disk, run.center_px, own)
    readings = [likelihood] if crossings is None else [likelihood, crossings]
    return max(readings, key=lambda reading: reading.difference_sigmas)


def _reading(run: _Run) -> CenterReading:
    fit, solved = run.disk.fit, run.solved
    second = _farther_reading(run)
    away = second.pixel_line - run.center_px
    chosen, used, covered = (int(n.sum()) for n in (run.choice.chosen, solved.used, run.choice.covered))
    return CenterReading(
        method=METHOD,
        center_px=run.center_px,
        covariance_px2=solved.covariance[:2, :2] + difference_covariance(away),
        noise_covariance_px2=solved.noise_covariance[:2, :2],
        log_size=run.shape.log_size + float(solved.step[SIZE]),
        log_size_sigma=float(np.sqrt(solved.covariance[SIZE, SIZE])),
        chi2_reduced=solved.chi2_reduced,
        converged=fit.converged and float(np.hypot(*solved.step[:2])) < LONGEST_PX,
        second=second,
        conditions={BodyFlag.OCCULTED: True} if covered else {},
        notes={
            BodyFlag.OCCULTED: f"{covered} scans left out",
            BodyFlag.POOR_FIT: f"{chosen - used} of {chosen} scans rejected",
        },
    )


# ---- What every scan showed.


def _detail(run: _Run) -> LimbScans:
    view, match, solved = run.view, run.match, run.solved
    fan = view.fan
    last = int((fan.first + fan.n_samples).max())
    distance: FloatArray = STEP_PX * np.arange(last + 1.0)
    sampler = ScanSampler(fan.places(distance), view.window)
    level = float(run.disk.fit.solution.theta[Unknown.LEVEL])
    data = sampler.sample(view.data_plane) - level
    lag, correlation = _correlation(view, match)
    status, reason = _statuses(run)
    known = np.isfinite(run.choice.edge_px)
    return LimbScans(
        start_px=fan.center_px,
        angle_rad=fan.angle_rad,
        distance_px=distance,
        places_px=fan.places(distance),
        data_dn=np.where(sampler.blocked(view.use), np.nan, data),
        model_dn=float(np.mean(match.brightness[solved.used])) * sampler.sample(view.model_plane),
        limb_px=fan.limb_px,
        edge_px=run.choice.edge_px,
        correlation=correlation,
        lag_px=lag,
        offset_px=np.where(known, match.offset_px, np.nan),
        sigma_px=np.where(known, match.sigma_px, np.nan),
        motion=match.common[:, :2],
        brightness=match.brightness,
        unevenness=run.choice.uneven,
        residual_px=np.where(known, solved.residual_px, np.nan),
        status=status,
        reason=reason,
        roughness=run.disk.fit.prior.albedo,
        iterations=run.steps,
        summary=run.choice.summary,
    )


def _correlation(view: ScanView, match: ScanMatch) -> tuple[FloatArray, FloatArray]:
    """Return lags (k,) px and correlations (n, k) about the last model's place."""
    reach = round(LAG_PX / STEP_PX)
    sampler = ScanSampler(view.fan.places(view.fan.distances(reach)), view.window)
    data, blocked = sampler.sample(view.data_plane), sampler.blocked(view.use)
    correlation = correlate_scans(match, view.model, data, blocked)
    return np.asarray(STEP_PX * np.arange(-reach, reach + 1.0)), correlation


def _statuses(run: _Run) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Return status and reason of every scan, with those of rejected outliers."""
    status, reason = run.choice.status.astype("<U12"), run.choice.reason.astype("<U160")
    for row in np.flatnonzero(run.choice.chosen & ~run.solved.used):
        residual, sigma = run.solved.residual_px[row], run.match.sigma_px[row]
        status[row] = REJECTED
        reason[row] = (
            f"off by {residual:+.3f} px from the other scans, {abs(residual) / sigma:.1f} of its sigma"
        )
    return status, reason
