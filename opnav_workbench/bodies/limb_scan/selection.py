"""Which scans make the center: chosen by hand, or by themselves, each with the reason in plain words.

A scan is able where it crosses the lit limb in sight. Those over an uneven albedo are left out as long as the others span
enough of the limb (AAS 13-443); what remains uneven is in the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.crossings import crossing_depths
from opnav_workbench.bodies.disk.limb_cells import piece_of
from opnav_workbench.bodies.disk.measurement import MeasuredDisk
from opnav_workbench.bodies.limb_scan.fan import ScanFan
from opnav_workbench.bodies.limb_scan.matching import ScanMatch
from opnav_workbench.bodies.limb_scan.view import ScanView
from opnav_workbench.bodies.neighbours import near_bodies
from opnav_workbench.bodies.picture import displaced_model, pixel_rays, placed_models
from opnav_workbench.bodies.results import NOT_CHOSEN, USED
from opnav_workbench.constants import FWHM_PER_SIGMA
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render.body import PlacedBody

__all__ = ["ScanSelection", "checked_scan_numbers", "choose_scans"]

FAINT_PX = 1.0  # uncertainty of an offset beyond which a scan says nothing
FAINT_LIMB = 0.15  # of the brightest limb: nearer to the cusps limb and terminator mix
LOST_SHARE = 0.02  # of what a scan tells may lie on unusable samples
# Of the median unevenness, and of the brightness: both, and a scan is left out
UNEVEN_RATIO, UNEVEN_SHARE = 2.0, 0.1
SPAN_RAD = np.radians(90.0)  # that the others must turn through, if all of them do


@dataclass(frozen=True, slots=True, eq=False)
class ScanSelection:
    """n scans, chosen or not.

    Attributes
    ----------
    chosen, covered : (n,) arrays of bool
        Covered: another body hides or shades the limb.
    uneven, edge_px : (n,) arrays
        Relative scatter of the albedo near the scan; distance of the outermost lit point, nan without one.
    reason : (n,) array of str
    """

    chosen: BoolArray
    covered: BoolArray
    uneven: FloatArray
    edge_px: FloatArray
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


def choose_scans(
    disk: MeasuredDisk,
    view: ScanView,
    match: ScanMatch,
    numbers: NDArray[np.int64] | None,
    *,
    uneven: bool = False,
) -> ScanSelection:
    """Choose scans; `numbers` are those that an analyst chose, None: automatically, over `uneven` albedo too or not."""
    edge, limb = lit_edges(disk, view)
    covered, scatter = covered_scans(disk, view.fan), _unevenness(disk, view.fan)
    reason = _obstacles(view, match, edge, covered)
    able = reason == ""
    if numbers is not None:
        asked = np.isin(np.arange(len(able)), numbers)
        reason[~asked] = "not in the analyst's list"
        reason[asked & able] = "chosen by the analyst"
        summary = f"{int((asked & able).sum())} scans chosen by the analyst"
        if lost := int((asked & ~able).sum()):
            summary += f"; {lost} more cannot be used"
        return ScanSelection(asked & able, covered, scatter, edge, reason, (summary,))
    reason[able & ~limb] = "crosses the terminator, not the lit limb"
    chosen = able & limb if uneven else _even(view.fan, able & limb, scatter)
    for row in np.flatnonzero(able & limb):
        words = f"lit limb; albedo even to {max(100 * scatter[row], 1.0):.0f} %"
        reason[row] = (
            words
            if chosen[row]
            else f"albedo uneven by {100 * scatter[row]:.0f} %, and the others span enough"
        )
    summary = f"{int(chosen.sum())} of {len(able)} scans chosen, over {np.degrees(_span_rad(view.fan, chosen)):.0f} deg"
    if left := int((able & limb & ~chosen).sum()):
        summary += f"; {left} left out for their uneven albedo"
    return ScanSelection(chosen, covered, scatter, edge, reason, (summary,))


def lit_edges(disk: MeasuredDisk, view: ScanView) -> tuple[FloatArray, BoolArray]:
    """Return the distance (n,) of each scan's outermost lit point, nan without one, and whether that is on the limb."""
    fan = view.fan
    width = max(0.5 * FWHM_PER_SIGMA * float(np.max(disk.picture.psf.sigma_px)), 1.0)
    brightest = float(view.model.max(initial=0.0))
    depth = np.arange(-disk.fit.reach_px[0], disk.fit.reach_px[1], 0.25)
    angle, places = np.broadcast_arrays(fan.angle_rad[:, None], depth)
    light = disk.fit.made.light.at(angle.ravel(), places.ravel(), 1)[0].reshape(angle.shape)
    crossing = crossing_depths(light, depth, width, 0.01)
    near = np.abs(view.fan.depth_px) < 2.0 * width
    strength = np.where(near, view.model, 0.0).max(axis=1)
    on_limb = (np.abs(crossing) < 2.0 * width) & (strength > FAINT_LIMB * brightest)
    return np.where(on_limb, fan.limb_px, fan.limb_px + crossing), on_limb


def _obstacles(view: ScanView, match: ScanMatch, edge_px: FloatArray, covered: BoolArray) -> NDArray[np.str_]:
    """Return why scans cannot be used (n,); empty where they can."""
    reason = np.full(len(view.fan), "", dtype="<U160")
    told = view.limb**2
    lost = np.where(view.blocked, told, 0.0).sum(axis=1) > LOST_SHARE * np.maximum(told.sum(axis=1), 1e-300)
    reason[~(match.edge_sigma_px < FAINT_PX)] = (
        f"too faint: its edge is uncertain by more than {FAINT_PX:g} px"
    )
    reason[lost] = (
        "its edge lies off the detector, or on bad or saturated pixels or ones that another body lights"
    )
    reason[covered] = "another body hides or shades it here"
    reason[~np.isfinite(edge_px)] = "meets no lit surface near the limb"
    return reason


def covered_scans(disk: MeasuredDisk, fan: ScanFan) -> BoolArray:
    """Tell at which scans' limb (n,) another body hides or shades the body, or shows beside it."""
    picture, name, center = disk.picture, disk.name, fan.center_px
    others = near_bodies(picture, name, center)
    if not others:
        return np.zeros(len(fan), dtype=bool)
    pixel_scale = picture.camera.pixel_scale_rad
    size = float(np.exp(-disk.fit.shape.log_size))
    models = placed_models(picture, {name: center, **others}, {name: size})
    placed = [PlacedBody(m, pixel_scale) for m in models if not m.is_point]
    own = PlacedBody(displaced_model(picture, name, center, size), pixel_scale)
    inner, limb = (pixel_rays(picture, fan.places(fan.limb_px[:, None] * part)[:, 0]) for part in (0.95, 1.0))
    alone = own.radiance(inner)
    own.note_occulters(placed)
    covered = np.abs(alone - own.radiance(inner)) > 0.01 * alone
    for body in placed:
        if body.model.target.name != name:
            covered |= body.blocks(limb, np.full(len(fan), np.inf))
    return np.asarray(covered)


def _unevenness(disk: MeasuredDisk, fan: ScanFan) -> FloatArray:
    """Return the relative scatter (n,) of the albedo that the disk has near each scan."""
    fit = disk.fit
    albedo = 1.0 + fit.system.field.at_limb(fit.solution.albedo) / fit.brightness_dn
    near = np.stack([np.roll(albedo, k, axis=0) for k in (-1, 0, 1)], axis=1).reshape(len(albedo), -1)
    rough = near.std(axis=1) / np.maximum(near.mean(axis=1), 0.1)
    return np.asarray(rough[piece_of(fan.angle_rad, len(albedo))])


def _even(fan: ScanFan, able: BoolArray, uneven: FloatArray) -> BoolArray:
    """Return the able scans without the uneven ones, if those that are left span enough."""
    if not able.any():
        return able
    even = able & (uneven <= max(UNEVEN_RATIO * float(np.median(uneven[able])), UNEVEN_SHARE))
    enough = _span_rad(fan, even) >= 0.95 * max(_span_rad(fan, able), SPAN_RAD)
    return even if enough and even.sum() > 2 else able


def _span_rad(fan: ScanFan, rows: BoolArray) -> float:
    """Return the angle that holds all scans: a turn less the widest gap between neighbours."""
    if rows.sum() < 2:
        return 0.0
    ordered = np.sort(fan.angle_rad[rows])
    gaps = np.diff(np.append(ordered, ordered[0] + 2.0 * np.pi))
    return float(2.0 * np.pi - gaps.max())
