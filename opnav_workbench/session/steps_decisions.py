"""Session steps that record what the analyst says of bodies and of the picture.  Pure functions of the state."""

from types import MappingProxyType
from typing import Any

from opnav_workbench.bodycenters import Circle
from opnav_workbench.session.context import Context
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["clear_circle", "note", "set_circle"]


def set_circle(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Record where the analyst sees a body, and how large."""
    circle = Circle(parameters["center_px"], parameters["radius_px"])
    return state.replace(circles=MappingProxyType({**state.circles, parameters["name"]: circle}))


def clear_circle(
    context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
) -> SessionState:
    """Forget the analyst's circle of a body: the predicted one counts again."""
    kept = {name: circle for name, circle in state.circles.items() if name != parameters["name"]}
    return state.replace(circles=MappingProxyType(kept))


def note(context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]) -> SessionState:
    """Keep a remark of the analyst."""
    return state.replace(user_notes=(*state.user_notes, parameters["text"]))
