"""Center of a body by scans across its limb, with the model of a disk that all methods share.

Flow   measured disk -> scans, those chosen that cross the lit limb over an even albedo (``scanning``) -> judgement
       (`opnav_workbench.bodies.judgement`), and what every scan showed (`LimbScans`)

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.columns import Unknown
from opnav_workbench.bodies.disk.measurement import measure_disk
from opnav_workbench.bodies.judgement import judged_center
from opnav_workbench.bodies.limb_scan.center_solution import FEWEST
from opnav_workbench.bodies.limb_scan.fan import N_SCANS, STEP_PX, ScanSampler
from opnav_workbench.bodies.limb_scan.matching import ScanMatch, correlate_scans
from opnav_workbench.bodies.limb_scan.scanning import (
    ScannedLimb,
    scan_limb,
    scan_reading,
    undetermined_center,
)
from opnav_workbench.bodies.limb_scan.selection import ScanSelection, checked_scan_numbers
from opnav_workbench.bodies.limb_scan.view import LAG_PX, ScanView
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, LimbScans
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.threads import one_thread

__all__ = ["find_limb_scan"]

METHOD = "limb_scan"


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
    quick: bool = False,
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
    quick
        As of `opnav_workbench.bodies.find_disk`.

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
    disk = measure_disk(picture, name, METHOD, circle, search_radius_px, quick=quick)
    if isinstance(disk, BodyCenter):
        return disk
    run = scan_limb(disk, n_scans, numbers)
    if isinstance(run, ScanSelection):
        return undetermined_center(disk, METHOD, run)
    center = judged_center(disk, scan_reading(run, METHOD), _detail(run), solve_range=solve_range)
    return replace(center, messages=(*center.messages, *run.choice.summary))


# ---- What every scan showed.


def _detail(run: ScannedLimb) -> LimbScans:
    view, match, solved = run.view, run.match, run.solved
    fan = view.fan
    last = int((fan.first + fan.n_samples).max())
    distance: FloatArray = STEP_PX * np.arange(last + 1.0)
    sampler = ScanSampler(fan.places(distance), view.window)
    level = float(run.disk.fit.solution.theta[Unknown.LEVEL])
    data = sampler.sample(view.data_plane) - level
    lag, correlation = _correlation(view, match)
    status, reason = run.statuses()
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
        sigma_px=np.where(known, run.sigma_px, np.nan),
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
