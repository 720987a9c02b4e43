"""The analyst's decisions on stars, and what they make of the automatic statuses: a decision outranks them."""

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from opnav_workbench.arrays import BoolArray
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction
from opnav_workbench.session.state import SessionState, StarStatus

__all__ = ["ACCEPTED", "REJECTED", "check_known", "decide", "has_center", "unsearched", "with_verdicts"]

ACCEPTED, REJECTED = "accepted", "rejected"
NAMED = 3  # star ids that an error message gives as examples


def unsearched(on_detector: BoolArray) -> tuple[StarStatus, ...]:
    """Return the statuses of stars that are predicted (n,) on the detector or off it, and not looked for yet."""
    return tuple(
        StarStatus("not_detected", "not searched yet")
        if on
        else StarStatus("off_detector", "predicted outside the detector")
        for on in on_detector
    )


def has_center(state: SessionState) -> BoolArray:
    """Return which predicted stars have a measured center."""
    if state.centers is None:
        return np.zeros(len(state.found_status), dtype=bool)
    return np.asarray(np.isfinite(state.centers.pixel_line).all(axis=1))


def with_verdicts(state: SessionState, statuses: Sequence[StarStatus]) -> tuple[StarStatus, ...]:
    """Return `statuses` (one per predicted star) with the analyst's decisions carried out."""
    if state.a_priori is None:
        return tuple(statuses)
    rows = zip(state.a_priori.id.tolist(), statuses, has_center(state), strict=True)
    return tuple(_decided(state.decisions.get(star, ("", "")), status, bool(m)) for star, status, m in rows)


def _decided(decision: tuple[str, str], status: StarStatus, measured: bool) -> StarStatus:
    verdict, reason = decision
    if verdict == REJECTED:
        return StarStatus("rejected", f"by the analyst: {reason}" if reason else "by the analyst")
    # What was fitted off the detector, at its edge, is no picture of that star.
    if verdict == ACCEPTED and measured and status.status != "off_detector":
        return StarStatus("used", reason)
    return status


def check_known(stars: StarPrediction, ids: Sequence[str]) -> None:
    """Refuse ids that none of the predicted stars has.

    Raises
    ------
    SessionError
        They are named, and some that there are.
    """
    known = stars.id.tolist()
    unknown = sorted(set(ids) - set(known))
    if unknown:
        raise SessionError(
            f"no star {', '.join(unknown)} in this field; stars are named as in result.json, "
            f"such as {', '.join(sorted(known)[:NAMED])}."
        )


def decide(state: SessionState, ids: Sequence[str], verdict: str, reason: str) -> SessionState:
    """Return the state with a decision on some stars, effective at once.

    Raises
    ------
    SessionError
        No stars are predicted yet, or one of `ids` is not among them.
    """
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    known = state.a_priori.id.tolist()
    check_known(state.a_priori, ids)
    decisions = dict(state.decisions) | dict.fromkeys(ids, (verdict, reason))
    rows = zip(known, state.found_status, state.status, strict=True)
    statuses = [found if star in ids else status for star, found, status in rows]
    state = state.replace(decisions=MappingProxyType(decisions))
    return state.replace(status=with_verdicts(state, statuses))
