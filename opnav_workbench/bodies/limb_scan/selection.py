"""Which scans make the center: chosen by hand, or by themselves, each with the reason in plain words.

A scan should cross the lit limb where the albedo is even, and all of them together should span enough of the limb to hold
the center in both directions (AAS 13-443). So scans are left out, the most uneven first, as long as the weaker direction
of the center does not suffer: what an uneven scan would add to the span is worth more than what its albedo costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.limb_scan.fan import ScanFan
from opnav_workbench.bodies.limb_scan.view import ScanView
from opnav_workbench.bodies.results import NOT_CHOSEN, USED
from opnav_workbench.errors import CenterfindingError

__all__ = ["ScanSelection", "checked_scan_numbers", "choose_scans", "unevenness"]

FAINT_PX = 1.0  # uncertainty of an offset beyond which a scan says nothing
UNEVEN_RATIO = 2.0  # of the median unevenness, and
UNEVEN_SHARE = 0.10  # of the brightness: a scan this much uneven may be left out
WEAKER_BY = 1.05  # growth of the center's larger sigma that leaving scans out may cost
SPAN_RAD = np.radians(90.0)  # that scans left over must turn through, if all of them do
FEWEST = 4
BESIDE = 2  # scans to each side that count as the neighbourhood
INSIDE_SIGMAS = 2.5  # of the PSF inside of the edge, where the picture shows the surface and not the edge
LEAST_LIGHT = 0.2  # of the model's peak along the scan
LOST_SHARE = 0.02  # of what a scan tells may lie on unusable samples


@dataclass(frozen=True, slots=True, eq=False)
class ScanSelection:
    """n scans, chosen or not.

    Attributes
    ----------
    chosen : (n,) array of bool
    reason : (n,) array of str
    """

    chosen: BoolArray
    reason: NDArray[np.str_]
    summary: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def status(self) -> NDArray[np.str_]:
        """``used`` or ``not_chosen`` (n,)."""
        return np.where(self.chosen, USED, NOT_CHOSEN)


def checked_scan_numbers(numbers: Sequence[int], n_scans: int) -> NDArray[np.int64]:
    """Return scan numbers that an analyst chose.

    Raises
    ------
    CenterfindingError
        A number that no scan has, or none at all.
    """
    asked = [int(number) for number in numbers]
    wrong = [number for number in asked if not 0 <= number < n_scans]
    if wrong or not asked:
        what = f"no scan {', '.join(map(str, wrong))}" if wrong else "no scans chosen"
        raise CenterfindingError(
            f"{what}; give numbers from 0 to {n_scans - 1}, or None to choose automatically."
        )
    return np.unique(np.array(asked, dtype=np.int64))


def unevenness(
    fan: ScanFan, view: ScanView, brightness: FloatArray, psf_sigma_px: float, gain: float
) -> FloatArray:
    """Return the relative scatter (n,) of data over model along and beside each scan, noise taken out.

    Measured inside of the edge; what all scans have in common at one depth is the scattering law's and is taken out.
    """
    inside = fan.edge_px[:, None] - fan.distances()
    bright = view.model > LEAST_LIGHT * view.model.max(axis=1, keepdims=True)
    good = ~view.blocked & bright & (inside > INSIDE_SIGMAS * psf_sigma_px)
    light = np.where(good, view.model * brightness[:, None], 1.0)
    ratio = np.where(good, view.data / light, np.nan)
    variance = np.where(good, (view.noise2 + light / gain) / light**2, 0.0)
    usual = _column_medians(ratio, good)
    ratio = ratio / usual
    total, mean, square = (
        _around(np.where(good, plane, 0.0).sum(axis=1)) for plane in (np.ones_like(ratio), ratio, ratio**2)
    )
    noise = _around(variance.sum(axis=1))
    enough = total >= 2.0 * (2 * BESIDE + 1)
    count = np.where(enough, total, 1.0)
    scatter2 = square / count - (mean / count) ** 2 - noise / count
    level = np.maximum(np.abs(mean / count), 1e-3)
    return np.where(enough, np.sqrt(np.maximum(scatter2, 0.0)) / level, np.nan)


def _column_medians(ratio: FloatArray, good: BoolArray) -> FloatArray:
    out = np.ones(ratio.shape[1])
    for column in np.flatnonzero(good.sum(axis=0) > FEWEST):
        out[column] = np.median(ratio[good[:, column], column])
    return np.where(np.abs(out) > 1e-3, out, 1.0)


def _around(values: FloatArray) -> FloatArray:
    padded = np.pad(values, BESIDE, mode="wrap")
    return np.convolve(padded, np.ones(2 * BESIDE + 1), "valid")


def choose_scans(
    fan: ScanFan,
    view: ScanView,
    sigma_px: FloatArray,
    motion: FloatArray,
    uneven: FloatArray,
    numbers: NDArray[np.int64] | None,
) -> ScanSelection:
    """Choose scans.

    Parameters
    ----------
    sigma_px : (n,) array
        Uncertainty of their offsets.
    motion : (n, 2) array
        What their offsets say of the center.
    uneven : (n,) array
        See `unevenness`.
    numbers : (k,) array of int or None
        Chosen by hand; None: choose automatically.
    """
    reason = _obstacles(fan, view, sigma_px)
    possible = reason == ""
    if numbers is not None:
        return _by_hand(possible, reason, numbers)
    limb = possible & fan.crosses_limb
    terminator = possible & ~fan.crosses_limb
    alone = _major_sigma(motion, sigma_px, limb)
    needs_help = limb.sum() < FEWEST or not alone < FAINT_PX
    candidates = limb | terminator if needs_help else limb
    reason[terminator & ~candidates] = "crosses the terminator, not the lit limb"
    chosen, dropped = _thinned(fan, candidates, motion, sigma_px, uneven)
    _explain(reason, fan, chosen, dropped, uneven)
    return ScanSelection(chosen, reason, _summary(fan, chosen, dropped, motion, sigma_px))


def _obstacles(fan: ScanFan, view: ScanView, sigma_px: FloatArray) -> NDArray[np.str_]:
    """Return why scans cannot be used (n,); empty where they can."""
    reason = np.full(len(fan), "", dtype="<U120")
    told = np.square(np.einsum("nwk,nk->nw", view.slope, fan.direction))
    lost = np.where(view.blocked, told, 0.0).sum(axis=1) > LOST_SHARE * np.maximum(told.sum(axis=1), 1e-300)
    faint = ~(sigma_px < FAINT_PX)
    for row in np.flatnonzero(faint):
        reason[row] = f"too faint: its edge is uncertain by more than {FAINT_PX:g} px"
    reason[lost] = (
        "its edge lies off the detector, or on bad or saturated pixels or ones that another body lights"
    )
    reason[fan.covered] = "another body hides or shades it here"
    reason[~np.isfinite(fan.edge_px)] = "meets no lit surface"
    return reason


def _by_hand(possible: BoolArray, reason: NDArray[np.str_], numbers: NDArray[np.int64]) -> ScanSelection:
    asked = np.zeros(len(possible), dtype=bool)
    asked[numbers] = True
    reason[~asked] = "not in the analyst's list"
    reason[asked & possible] = "chosen by the analyst"
    unusable = int((asked & ~possible).sum())
    summary = f"{int((asked & possible).sum())} scans chosen by the analyst"
    if unusable:
        summary += f"; {unusable} more cannot be used"
    return ScanSelection(asked & possible, reason, (summary,))


def _thinned(
    fan: ScanFan, candidates: BoolArray, motion: FloatArray, sigma_px: FloatArray, uneven: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Return the scans kept, and those left out, the most uneven first, while the center's weaker direction bears it."""
    chosen, dropped = candidates.copy(), np.zeros(len(fan), dtype=bool)
    if candidates.sum() <= FEWEST:
        return chosen, dropped
    rough = np.nan_to_num(uneven)
    usual = float(np.median(rough[candidates]))
    limit = max(UNEVEN_RATIO * usual, UNEVEN_SHARE)
    bound = WEAKER_BY * _major_sigma(motion, sigma_px, candidates)
    span = min(_span_rad(fan.angle_rad[candidates]), SPAN_RAD)
    for row in np.argsort(-rough, kind="stable"):
        if not candidates[row] or rough[row] <= limit:
            continue
        trial = chosen.copy()
        trial[row] = False
        spans = _span_rad(fan.angle_rad[trial]) >= span
        if trial.sum() >= FEWEST and spans and _major_sigma(motion, sigma_px, trial) <= bound:
            chosen, dropped[row] = trial, True
    return chosen, dropped


def _explain(
    reason: NDArray[np.str_], fan: ScanFan, chosen: BoolArray, dropped: BoolArray, uneven: FloatArray
) -> None:
    rough = np.nan_to_num(uneven)
    usual = float(np.median(rough[chosen])) if chosen.any() else 0.0
    for row in np.flatnonzero(chosen | dropped):
        edge = "lit limb" if fan.crosses_limb[row] else "terminator, as the lit limb alone is not enough"
        albedo = "too small to judge its albedo"
        if np.isfinite(uneven[row]):
            albedo = f"albedo even to {max(100 * rough[row], 1.0):.0f} %"
        if dropped[row]:
            reason[row] = (
                f"albedo uneven by {100 * rough[row]:.0f} %, where {100 * usual:.0f} % is usual; the others span "
                "enough without it"
            )
        elif rough[row] > max(UNEVEN_RATIO * usual, UNEVEN_SHARE):
            reason[row] = f"{edge}; albedo uneven by {100 * rough[row]:.0f} %, kept for the span that it adds"
        else:
            reason[row] = f"{edge}; {albedo}"


def _summary(
    fan: ScanFan, chosen: BoolArray, dropped: BoolArray, motion: FloatArray, sigma_px: FloatArray
) -> tuple[str, ...]:
    span = np.degrees(_span_rad(fan.angle_rad[chosen]))
    said = [f"{int(chosen.sum())} of {len(fan)} scans chosen, over {span:.0f} deg"]
    if dropped.any():
        left = f"{int(dropped.sum())} left out for their uneven albedo"
        now, before = (
            f"{_major_sigma(motion, sigma_px, rows):.3f} px" for rows in (chosen, chosen | dropped)
        )
        costs = "at no cost" if now == before else f"at the cost of {now} instead of {before}"
        said.append(f"{left}, {costs} in the weaker direction")
    return tuple(said)


def _major_sigma(motion: FloatArray, sigma_px: FloatArray, rows: BoolArray) -> float:
    """Return the larger sigma of the center that scans with independent errors would give; infinite if undetermined."""
    weighted = motion[rows] / sigma_px[rows, None]
    smallest = float(np.linalg.eigvalsh(weighted.T @ weighted)[0]) if rows.any() else 0.0
    return float(smallest**-0.5) if smallest > 1e-12 else np.inf


def _span_rad(angle_rad: FloatArray) -> float:
    """Return the angle that holds all scans: a turn less the widest gap between neighbours."""
    if len(angle_rad) < 2:
        return 0.0
    ordered = np.sort(angle_rad)
    gaps = np.diff(np.append(ordered, ordered[0] + 2.0 * np.pi))
    return float(2.0 * np.pi - gaps.max())
