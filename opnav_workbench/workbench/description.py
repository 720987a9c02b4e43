"""How a body that no ephemeris knows is lit, and how far it is: by clicks in the picture, or typed.

The Sun's direction is a click on its side of the body, or a drag toward it; the phase angle a click on the terminator. What
is said is a step of the session, and the same words as in a file of decisions (`ImageSession.describe_body`).

Units  px, deg, km
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from opnav_workbench.errors import CenterfindingError, SessionError
from opnav_workbench.scene import phase_at_terminator
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import SUN, TERMINATOR
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, typed_number

__all__ = ["DescriptionControl", "DescriptionField", "description_fields", "description_line"]


# ---- What stands of a body that is described.


@dataclass(frozen=True, slots=True)
class DescriptionField:
    """A number of the description as the page shows it: what it is called, its text, and what it means."""

    key: str
    label: str
    text: str
    unit: str
    tooltip: str


def description_fields(session: ImageSession, name: str) -> list[DescriptionField]:
    """Return what can be typed of a described body; nothing of any other."""
    body = session.state.assisted.get(name)
    if body is None:
        return []
    phase, sun = np.degrees(body.phase_rad), np.degrees(body.sun_angle_rad) % 360.0
    far, sigma = session.inputs.targets[name].range_km, np.degrees(body.lighting_sigma_rad)
    return [
        DescriptionField("phase_deg", "phase", f"{phase:.0f}", "°", "Angle Sun - body - camera"),
        DescriptionField("sun_deg", "Sun toward", f"{sun:.0f}", "°", "Counted from right toward down"),
        DescriptionField("range_km", "range", f"{far:.4g}", " km", "To the body's center; its size follows"),
        DescriptionField(
            "lighting_sigma_deg", "Sun ±", f"{sigma:.3g}", "°", "How far it may stand from there"
        ),
    ]


def description_line(session: ImageSession, name: str) -> str:
    """How a described body is lit, and how far it is, in one line."""
    told = ", ".join(f"{f.label} {f.text}{f.unit}" for f in description_fields(session, name)[:3])
    return f"{name}: {told}; F finds its center."


# ---- What the analyst says of it.

LEAST_STEP_PX = 2.0  # a shorter one has no direction that a hand could mean


class Round(Protocol):
    """A circle as it is drawn."""

    @property
    def center_px(self) -> tuple[float, float]:
        """Center (pixel, line)."""

    @property
    def radius_px(self) -> float:
        """Radius."""


def direction_deg(pixel0: float, line0: float, pixel1: float, line1: float) -> float:
    """Return the direction of a step in the picture, deg from +pixel toward +line, 0 to 360.

    Raises
    ------
    SessionError
        It is too short to have one.

    Examples
    --------
    >>> direction_deg(10.0, 10.0, 10.0, 5.0)
    270.0
    """
    across, down = pixel1 - pixel0, line1 - line0
    if np.hypot(across, down) < LEAST_STEP_PX:
        raise SessionError(
            f"{np.hypot(across, down):.1f} px tell no direction; click farther from the center, or drag farther."
        )
    return round(float(np.degrees(np.arctan2(down, across))) % 360.0, 2)


class DescriptionControl:
    """What the analyst says of the described body at hand, beside its circle.

    Parameters
    ----------
    body
        Returns the name of the body at hand, or raises `SessionError`.
    circle
        Returns the circle of a body; None where it has none.
    """

    def __init__(
        self, runner: StepRunner, body: Callable[[], str], circle: Callable[[str], Round | None]
    ) -> None:
        self.runner = runner
        self._body, self._circle = body, circle

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {
            "sun": lambda _: self._take(SUN, "click on the Sun's side of the body, or drag toward the Sun."),
            "terminator": lambda _: self._take(TERMINATOR, "click a place on the terminator."),
            "description_field": self._typed,
        }

    def tapped(self, pixel: float, line: float) -> None:
        """Take the click toward the Sun, or on the terminator."""
        name = self._described()
        circle = self._circle(name)
        assert circle is not None  # a described body has one
        if self.runner.tool == SUN:
            self._say(name, "by click", sun_deg=direction_deg(*circle.center_px, pixel, line))
            return
        sun_rad = self.runner.session.state.assisted[name].sun_angle_rad
        place, center = np.array([pixel, line]), np.array(circle.center_px)
        try:
            phase_rad = phase_at_terminator(center, circle.radius_px, sun_rad, place)
        except CenterfindingError as error:
            raise SessionError(f"{name}: {error}") from error
        self._say(name, "by click", phase_deg=round(float(np.degrees(phase_rad)), 2))

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag toward the Sun."""
        self._say(self._described(), "by drag", sun_deg=direction_deg(pixel0, line0, pixel1, line1))

    def _typed(self, event: PageEvent) -> None:
        key, number = str(event["arg"]), typed_number(str(event["value"]))
        if number is None:
            raise SessionError(f"{key.partition('_')[0]} must be a number, not {event['value']!r}.")
        # A size follows from the range, and a range from the size: what was said last holds.
        instead = {"radius_px": None} if key == "range_km" else {}
        self._say(self._described(), "typed", **{key: number}, **instead)

    def _say(self, name: str, reason: str, **changed: Any) -> None:
        self.runner.tool = ""
        session = self.runner.session
        self.runner.run(
            "describing the body",
            lambda: session.describe_again(name, reason=reason, **changed),
            lambda: description_line(session, name),
        )

    def _described(self) -> str:
        name = self._body()
        if name not in self.runner.session.state.assisted:
            raise SessionError(
                f"how {name} is lit, and how far it is, its ephemeris tells; only a body that is described by "
                "its circle (add it with its radius: NIX 22 km) has these to be said."
            )
        return name

    def _take(self, tool: str, prompt: str) -> None:
        self._described()
        self.runner.toggle_tool(tool, prompt)
