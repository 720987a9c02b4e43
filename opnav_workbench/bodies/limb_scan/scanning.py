"""Scans across the limb of a measured disk, and the center they agree with: what the limb scan and the ellipse share.

Flow   measured disk -> scans about its center -> data and model along each -> offset of each (``matching``) -> scans
       chosen -> outline by least squares (``center_solution``), scans laid anew if it is far -> reading of the center
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.columns import DiskShape
from opnav_workbench.bodies.disk.measurement import MeasuredDisk
from opnav_workbench.bodies.judgement import (
    CenterReading,
    crossing_reading,
    difference_covariance,
    second_reading,
)
from opnav_workbench.bodies.limb_scan.center_solution import FEWEST, OutlineStep, solve_outline
from opnav_workbench.bodies.limb_scan.matching import ScanMatch, match_scans
from opnav_workbench.bodies.limb_scan.selection import ScanSelection, choose_scans
from opnav_workbench.bodies.limb_scan.view import ScanView, view_scans
from opnav_workbench.bodies.results import REJECTED, BodyCenter, BodyFlag, SecondReading

__all__ = ["ScannedLimb", "scan_limb", "scan_reading", "undetermined_center"]

# The likelihood stands where it is likeliest; from there one step is the answer of the scans, linear in the data. A second
# one from where noise and albedo have taken the first would follow these: 1.4 instead of 1.1 sigma of error on 30 disks.
# Farther than the PSF a limb's derivatives do not reach: then the scans are laid anew, `MOST_TURNS` times at the most.
LONGEST_PX, MOST_TURNS = 1.0, 8
MOSTLY = 0.5  # of the light on saturated pixels
# Each scan has a brightness and a background of its own: light that the disk's model does not explain is no fault of theirs.
SCATTERED_PX, SCATTERED_SHARE = 0.5, 0.02  # of the radius: a limb that scatters more is not that of the model
SIZE = 2  # of the outline's step


@dataclass(frozen=True, slots=True, eq=False)
class ScannedLimb:
    """Scans across a limb that have come to their end: where they lie, what they show, and the outline they agree with."""

    disk: MeasuredDisk
    shape: DiskShape
    view: ScanView
    match: ScanMatch
    choice: ScanSelection
    solved: OutlineStep
    steps: tuple[tuple[float, float], ...]

    @property
    def center_px(self) -> FloatArray:
        """Center (2,) that the scans agree with."""
        return self.solved_shape.center_px

    @property
    def solved_shape(self) -> DiskShape:
        """Shape that they agree with; the one that they were laid about is `shape`."""
        return _moved(self.shape, self.solved.step)

    @property
    def sigma_px(self) -> FloatArray:
        """Uncertainty of the offset of each scan (n,)."""
        return np.sqrt(np.diag(self.solved.offset_covariance))

    def statuses(self) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
        """Return status and reason of every scan, with those of rejected outliers."""
        status, reason = self.choice.status.astype("<U12"), self.choice.reason.astype("<U160")
        sigmas = self.sigma_px
        for row in np.flatnonzero(self.choice.chosen & ~self.solved.used):
            residual, sigma = self.solved.residual_px[row], sigmas[row]
            status[row] = REJECTED
            reason[row] = (
                f"off by {residual:+.3f} px from the other scans, {abs(residual) / sigma:.1f} of its sigma"
            )
        return status, reason


def scan_limb(
    disk: MeasuredDisk, n_scans: int, numbers: NDArray[np.int64] | None = None, *, uneven: bool = False
) -> ScannedLimb | ScanSelection:
    """Scan the limb of a measured disk until the outline stands still; the choice alone where it holds too few scans.

    Parameters
    ----------
    numbers
        Of the scans that an analyst chose; None: automatically.
    uneven
        Whether to choose scans over an uneven albedo too, where others would do.
    """
    shape, steps = disk.fit.shape, []
    while True:
        view = view_scans(disk, shape, n_scans)
        match = match_scans(view, disk.fit)
        choice = choose_scans(disk, view, match, numbers, uneven=uneven)
        if choice.chosen.sum() < FEWEST:
            return choice
        solved = solve_outline(match, choice.chosen, disk.fit, shape)
        length = float(np.hypot(*solved.step[:2]))
        part = min(1.0, LONGEST_PX / max(length, 1e-12))
        steps.append((part * float(solved.step[0]), part * float(solved.step[1])))
        if length < LONGEST_PX or len(steps) == MOST_TURNS:
            return ScannedLimb(disk, shape, view, match, choice, solved, tuple(steps))
        shape = _moved(shape, part * solved.step)


def _moved(shape: DiskShape, step: FloatArray) -> DiskShape:
    strain = shape.strain.copy()
    strain[:2] += step[SIZE + 1 : SIZE + 3]
    log_size = shape.log_size + float(step[SIZE])
    return replace(shape, center_px=shape.center_px + step[:2], log_size=log_size, strain=strain)


def undetermined_center(disk: MeasuredDisk, method: str, choice: ScanSelection) -> BodyCenter:
    """Return the answer of a method whose scans do not make a center."""
    reasons, counts = np.unique(choice.reason[~choice.chosen], return_counts=True)
    said = [f"{n} scans: {text}" for n, text in sorted(zip(counts, reasons, strict=True), reverse=True)]
    message = f"{int(choice.chosen.sum())} usable scans do not determine a center"
    near, light = disk.fit.pixels, disk.fit.light_dn()
    saturated = disk.picture.saturated[near.index]
    if light[saturated].sum() > MOSTLY * light.sum():
        flags = int(BodyFlag.OVEREXPOSED)
        why = "its disk is saturated up to the limb, whose place the brightness would tell; take a shorter exposure"
        return BodyCenter.without_center(disk.name, method, "saturated", why, message, *said[:3], flags=flags)
    return BodyCenter.without_center(disk.name, method, "failed", message, *said[:3])


def _farther_reading(run: ScannedLimb) -> SecondReading:
    """Return the one that differs more of the likelihood, where the scans began, and of crossings that know no weights."""
    fit, own = run.disk.fit, run.solved.covariance[:2, :2]
    likelihood = second_reading(
        "the likelihood of the disk", fit.center_px, fit.covariance_px2, run.center_px, own
    )
    crossings = crossing_reading(run.disk, run.center_px, own)
    readings = [likelihood] if crossings is None else [likelihood, crossings]
    return max(readings, key=lambda reading: reading.difference_sigmas)


def scan_reading(run: ScannedLimb, method: str) -> CenterReading:
    """Return the center that scans agree with, beside the likelihood's and that of the crossings."""
    fit, solved = run.disk.fit, run.solved
    second = _farther_reading(run)
    away = second.pixel_line - run.center_px
    own = np.median(run.sigma_px[solved.used])
    scattered = bool(own > max(SCATTERED_PX, SCATTERED_SHARE * run.disk.radius_px))
    chosen, used, covered = (int(n.sum()) for n in (run.choice.chosen, solved.used, run.choice.covered))
    return CenterReading(
        method=method,
        center_px=run.center_px,
        covariance_px2=solved.covariance[:2, :2] + difference_covariance(away),
        noise_covariance_px2=solved.noise_covariance[:2, :2],
        log_size=run.solved_shape.log_size,
        log_size_sigma=float(np.sqrt(solved.covariance[SIZE, SIZE])),
        chi2_reduced=solved.chi2_reduced,
        converged=fit.converged and float(np.hypot(*solved.step[:2])) < LONGEST_PX,
        second=second,
        conditions={BodyFlag.POOR_FIT: scattered, **({BodyFlag.OCCULTED: True} if covered else {})},
        notes={
            BodyFlag.OCCULTED: f"{covered} scans left out",
            BodyFlag.POOR_FIT: f"{chosen - used} of {chosen} scans rejected",
        },
    )
