"""Gates of a notebook: what must be decided before its later cells may run."""

from collections.abc import Callable, Sequence

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.session.state import SessionState

__all__ = ["NEEDS", "pending"]

SHOWN = 3  # names that a message gives as examples


def pending(state: SessionState, needs: Sequence[str]) -> list[str]:
    """Return what is missing of `needs`, one line each.

    Raises
    ------
    SessionError
        A need is unknown.
    """
    unknown = [need for need in needs if need not in NEEDS]
    if unknown:
        raise SessionError(f"unknown need {', '.join(unknown)}; choose of {', '.join(NEEDS)}.")
    lines = (NEEDS[need](state) for need in needs)
    return [line for line in lines if line]


def _stars_confirmed(state: SessionState) -> str:
    if state.a_priori is None or state.centers is None:
        return "no stars are found yet: predict() and find_stars()"
    open_ones = [
        star
        for star, used in zip(state.a_priori.id.tolist(), state.mask("used"), strict=True)
        if used and star not in state.decisions
    ]
    if not open_ones:
        return ""
    named = ", ".join(open_ones[:SHOWN]) + (", ..." if len(open_ones) > SHOWN else "")
    return f"{len(open_ones)} stars wait to be accepted or rejected ({named})"


def _pointing(state: SessionState) -> str:
    return "" if state.pointing is not None else "the pointing is not solved: repoint()"


def _bodies(state: SessionState) -> str:
    found = {body.name for body in state.bodies}
    open_ones = [name for name in state.targets if name not in found]
    return f"{', '.join(open_ones)} not looked for yet: find_body()" if open_ones else ""


def _observables(state: SessionState) -> str:
    if len(state.observables) == len(state.bodies) and np.all(
        [o.name == b.name for o, b in zip(state.observables, state.bodies, strict=True)]
    ):
        return ""
    return "the observables are not computed: observables()"


NEEDS: dict[str, Callable[[SessionState], str]] = {
    "stars_confirmed": _stars_confirmed,
    "pointing": _pointing,
    "bodies": _bodies,
    "observables": _observables,
}
