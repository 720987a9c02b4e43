"""Verdict over a body's center: flags, status, and what the analyst must know."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodycenters.expectation import Found
from opnav_workbench.bodycenters.flags import BodyFlag, describe_body_flags
from opnav_workbench.bodycenters.picture import BodyPicture

__all__ = ["DOUBTFUL", "Evidence", "flags_of", "messages_of", "status_of"]

LOST_LIGHT = 0.1  # share of a body's light off the detector that makes its center doubtful
SATURATED_PART = 0.2  # of its bright pixels
BAD_PART = 0.1
CERTAIN_SNR = 5.0
POORLY_EXPLAINED = (
    0.6  # share of the light's variation under it; an albedo map of Pluto's contrast leaves 0.9
)
CIRCLE_TOLERANCE = 0.15  # an analyst draws a circle to a few percent
SIZE_TOLERANCE = 0.1
THIN_PHASE_RAD = np.radians(130.0)
THIN_PX = 1.0  # widest part of a crescent: below, the sampled model holds its light to a few percent only
WEAK_RATIO = 10.0  # of the axes of the error ellipse
WEAK_SIGMA_PX = 0.05
DOUBTFUL = (
    BodyFlag.THIN_CRESCENT
    | BodyFlag.CIRCLE_MISFIT
    | BodyFlag.POOR_FIT
    | BodyFlag.AT_LIMIT
    | BodyFlag.WEAK_GEOMETRY
    | BodyFlag.EMPTY
    | BodyFlag.NOT_CONVERGED
    | BodyFlag.SIZE_UNSOLVED
)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a fit tells of one body.

    Attributes
    ----------
    found : Found
    center_px : (2,) array
    covariance_px2 : (2, 2) array
    snr : float
    occulted : float
        Share of its light that others hide.
    light_dn : (n_line, n_pixel) array
        Its light in the window, at the solution.
    flux_dn : float
        All of its light, on and off the window.
    use, saturated, hits : (n_line, n_pixel) arrays of bool
    explained : float
        Share, 0..1, of the data's variation under the body.
    size_ratio : float
        Size of its image over the model's, where that was checked; nan where not.
    converged : bool
    """

    found: Found
    center_px: FloatArray
    covariance_px2: FloatArray
    snr: float
    occulted: float
    light_dn: FloatArray
    flux_dn: float
    use: BoolArray
    saturated: BoolArray
    hits: BoolArray
    explained: float
    size_ratio: float
    converged: bool

    @property
    def bright(self) -> BoolArray:
        """Pixels that show the body."""
        return np.asarray(self.light_dn > 0.1 * self.light_dn.max(initial=0.0))

    @property
    def lost_light(self) -> float:
        """Share of its light that falls off the window."""
        return float(1.0 - self.light_dn.sum() / self.flux_dn) if self.flux_dn > 0.0 else 0.0


def flags_of(picture: BodyPicture, evidence: Evidence, *, size_solved: bool) -> BodyFlag:
    """Return what is known against a center."""
    expected, bright = evidence.found.expectation, evidence.bright
    unusable = bright & ~evidence.use & ~evidence.saturated
    error = np.linalg.eigvalsh(evidence.covariance_px2)
    beyond = float(np.hypot(*(evidence.center_px - expected.center_px))) > expected.search_px + 1.0
    conditions = {
        BodyFlag.CUT_BY_EDGE: _cut(picture, evidence),
        BodyFlag.OVEREXPOSED: bool(np.any(bright & evidence.saturated)),
        BodyFlag.OCCULTED: evidence.occulted > 0.0,
        BodyFlag.THIN_CRESCENT: _thin(picture, expected.name, expected.radius_px),
        BodyFlag.CIRCLE_MISFIT: _misfit(evidence, size_solved=size_solved),
        BodyFlag.POOR_FIT: evidence.explained < POORLY_EXPLAINED,
        BodyFlag.AT_LIMIT: beyond,
        BodyFlag.WEAK_GEOMETRY: bool(
            error[1] > WEAK_SIGMA_PX**2 and error[1] > WEAK_RATIO**2 * max(error[0], 0.0)
        ),
        BodyFlag.BAD_PIXELS: bool(unusable.any()),
        BodyFlag.HIT: bool(np.any(bright & evidence.hits)),
        BodyFlag.NOT_CONVERGED: not evidence.converged,
    }
    flags = BodyFlag.OK
    for flag, condition in conditions.items():
        flags |= flag if condition else BodyFlag.OK
    return flags


def status_of(evidence: Evidence, flags: BodyFlag) -> str:
    """Return ``ok`` or ``uncertain``."""
    bright = evidence.bright
    count = max(int(bright.sum()), 1)
    saturated = int((bright & evidence.saturated).sum()) / count
    bad = int((bright & ~evidence.use & ~evidence.saturated).sum()) / count
    doubtful = (
        bool(flags & DOUBTFUL)
        or evidence.lost_light > LOST_LIGHT
        or saturated > SATURATED_PART
        or bad > BAD_PART
        or evidence.snr < CERTAIN_SNR
    )
    return "uncertain" if doubtful else "ok"


def messages_of(picture: BodyPicture, evidence: Evidence, flags: BodyFlag) -> tuple[str, ...]:
    """Return what is known against a center, in words and numbers."""
    said = []
    numbers = {
        BodyFlag.CUT_BY_EDGE: f"{100 * evidence.lost_light:.0f} % of its light",
        BodyFlag.OCCULTED: f"{100 * evidence.occulted:.0f} % of its light",
        BodyFlag.POOR_FIT: f"the model explains {100 * evidence.explained:.0f} % of the light",
        BodyFlag.CIRCLE_MISFIT: _size_words(picture, evidence),
        BodyFlag.OVEREXPOSED: f"{int((evidence.bright & evidence.saturated).sum())} px",
        BodyFlag.BAD_PIXELS: f"{int((evidence.bright & ~evidence.use & ~evidence.saturated).sum())} px",
        BodyFlag.HIT: f"{int((evidence.bright & evidence.hits).sum())} px",
    }
    for flag in BodyFlag:
        if flags & flag:
            note = numbers.get(flag, "")
            said.append(describe_body_flags(flag) + (f" ({note})" if note else ""))
    if evidence.snr < CERTAIN_SNR:
        said.append(f"SNR {evidence.snr:.1f} is below {CERTAIN_SNR:g}")
    return tuple(said)


def _cut(picture: BodyPicture, evidence: Evidence) -> bool:
    radius = evidence.found.expectation.radius_px
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low, high = evidence.center_px - radius, evidence.center_px + radius
    return bool(np.any(low < -0.5) or np.any(high > size - 0.5))


def _thin(picture: BodyPicture, name: str, radius_px: float) -> bool:
    """Tell whether the lit crescent is less than a pixel wide."""
    phase = picture.phase_rad(name)
    if not phase > THIN_PHASE_RAD:
        return False
    return bool(radius_px * (1.0 + np.cos(phase)) < THIN_PX)


def _misfit(evidence: Evidence, *, size_solved: bool) -> bool:
    off = abs(evidence.size_ratio - 1.0)
    if np.isfinite(off) and off > SIZE_TOLERANCE:
        return True
    ratio = evidence.found.expectation.circle_ratio
    return bool(not size_solved and abs(np.log(ratio)) > CIRCLE_TOLERANCE) if np.isfinite(ratio) else False


def _size_words(picture: BodyPicture, evidence: Evidence) -> str:
    expected = evidence.found.expectation
    ratio, circle = evidence.size_ratio, expected.circle_ratio
    predicted = picture.diameter_px(expected.name)
    words = []
    if np.isfinite(ratio) and abs(ratio - 1.0) > SIZE_TOLERANCE:
        words.append(
            f"it is about {100 * abs(ratio - 1.0):.0f} % {'larger' if ratio > 1.0 else 'smaller'} than the predicted "
            f"{predicted:.1f} px: check its range and radii, or solve for its range"
        )
    if np.isfinite(circle) and abs(np.log(circle)) > CIRCLE_TOLERANCE:
        words.append(
            f"the circle is {2 * expected.radius_px * circle:.1f} px wide, the prediction {2 * expected.radius_px:.1f} px"
        )
    return "; ".join(words)
