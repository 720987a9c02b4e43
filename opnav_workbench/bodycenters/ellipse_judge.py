"""Which pieces of limb count, and why the others do not."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.limb_points import EdgeFit
from opnav_workbench.bodycenters.limb_points_pieces import LimbPieces
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.silhouette import Silhouette
from opnav_workbench.errors import CenterfindingError

__all__ = ["LimbVerdict", "judge_limb", "missing_share"]

LIT_SHARE = 0.2  # of the brightest piece: darker ones lie at the terminator, where relief makes the edge
LEAST_HEIGHT_SNR = 5.0
LEAST_HEIGHT = 0.15  # of the median: no surface has a tenth of its own albedo all along a piece of limb
LARGEST_SIGMA_PX = 0.5
SKY_SHARE = 0.5  # of the limb's brightness: what is brighter outside is no sky, however wide the halo of a fouled lens
CHI2_RATIO = 6.0  # over that of the other pieces, or over 1
NO_LIMB, FAINTER = "nothing like a limb stands out there", "far fainter than the rest of the limb"

Mark = Callable[[BoolArray, str, str | list[str]], None]


@dataclass(frozen=True, slots=True, eq=False)
class LimbVerdict:
    """Status (n,) and reason (n,) of pieces of limb, see `LimbEllipse`, and what befell them."""

    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    usable: BoolArray
    hidden: BoolArray
    saturated: BoolArray
    missing: BoolArray  # lit limb in the model, none in the picture

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def with_outliers(self, used: BoolArray, residual_px: FloatArray, sigma_px: FloatArray) -> "LimbVerdict":
        """Return the verdict with those usable pieces rejected that the fit left out."""
        status, reason = self.status.copy(), self.reason.copy()
        for row in np.flatnonzero(self.usable & ~used):
            status[row] = "rejected"
            many = residual_px[row] / sigma_px[row]
            reason[row] = (
                f"it lies {residual_px[row]:+.2f} px from the limb of the others ({many:+.0f} sigma)"
            )
        return replace(self, status=status, reason=reason, usable=self.usable & used)


def judge_limb(
    picture: BodyPicture, silhouette: Silhouette, pieces: LimbPieces, edges: EdgeFit, reach: float
) -> LimbVerdict:
    """Judge pieces of limb by what their pixels say."""
    n = len(pieces)
    status = np.full(n, "used", dtype="<U10")
    reason = np.full(n, "", dtype="<U96")
    hidden, by = _beside_others(picture, silhouette.name, pieces, reach)
    lit = edges.peak >= LIT_SHARE * max(float(edges.peak.max()), np.finfo(float).tiny)

    def mark(which: BoolArray, verdict: str, why: str | list[str]) -> None:
        rows = np.flatnonzero(which & (status == "used"))
        status[rows] = verdict
        reason[rows] = why if isinstance(why, str) else [why[row] for row in rows]

    mark(~pieces.complete, "not_chosen", "off the detector")
    mark(~lit, "not_chosen", "no light there: beyond the terminator")
    mark(hidden, "rejected", by)
    mark(edges.n_saturated > 0, "rejected", "saturated")
    mark(~np.isfinite(edges.sigma_px), "rejected", "too few good pixels")
    with np.errstate(invalid="ignore", divide="ignore"):
        snr = edges.height / edges.height_sigma
        mark(~(snr >= LEAST_HEIGHT_SNR), "rejected", NO_LIMB)
        mark(~(edges.sigma_px <= LARGEST_SIGMA_PX), "rejected", "too faint to place the limb")
    _by_the_others(edges, status, mark)
    seen = lit & pieces.complete
    missing = seen & ((reason == NO_LIMB) | (reason == FAINTER))
    return LimbVerdict(
        status, reason, status == "used", hidden & lit, (edges.n_saturated > 0) & seen, missing
    )


def _by_the_others(edges: EdgeFit, status: NDArray[np.str_], mark: Mark) -> None:
    """Reject pieces that are unlike the rest."""
    left = status == "used"
    if not left.any():
        return
    typical = float(np.median(edges.height[left]))
    mark(edges.height < LEAST_HEIGHT * typical, "rejected", FAINTER)
    bright = edges.background_dn > SKY_SHARE * edges.height * edges.peak
    mark(bright, "rejected", "bright outside: not the limb, or something beside it")
    usual = max(float(np.median(edges.chi2_reduced[left])), 1.0)
    why = [f"its light is not that of a limb (chi-squared {c:.1f})" for c in edges.chi2_reduced]
    mark(edges.chi2_reduced > CHI2_RATIO * usual, "rejected", why)


def _beside_others(
    picture: BodyPicture, name: str, pieces: LimbPieces, reach: float
) -> tuple[BoolArray, list[str]]:
    """Tell which points of limb lie behind or beside another body, and whose."""
    hidden, by = np.zeros(len(pieces), dtype=bool), [""] * len(pieces)
    for model in picture.models:
        other = model.target.name
        if other == name or model.is_point:
            continue
        try:
            outline = Silhouette(picture, other).at(picture.center_px(other))
        except CenterfindingError:
            continue  # it is not before the camera
        away = pieces.point_px - outline.center_px
        near = np.hypot(*away.T) <= outline.radius(np.arctan2(away[:, 1], away[:, 0])) + reach
        for row in np.flatnonzero(near & ~hidden):
            by[row] = f"{other} stands there"
        hidden |= near
    return hidden, by


def missing_share(verdict: LimbVerdict) -> float:
    """Return the share of the model's lit limb, as far as it lies on the detector, that the picture does not show."""
    return float(verdict.missing.sum() / max(int((verdict.missing | verdict.usable).sum()), 1))
