"""The analyst's circle of a body: two clicks or a drag, then arrow keys (1 px, with Shift 0.1 px) and typed numbers.

The circle itself is immutable, in pixels and lines; each change of it is a session step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.workbench.actions import CIRCLE
from opnav_workbench.workbench.tabs import ARROW_STEPS, Handler, PageEvent, StepRunner, typed_number

__all__ = ["CircleControl", "CircleTool", "DrawnCircle", "typed_circle"]


# ---- The circle, and the two clicks or the drag that make it.

MIN_RADIUS_PX = 1.0  # a smaller circle is two clicks on one place


@dataclass(frozen=True, slots=True)
class DrawnCircle:
    """A circle (pixels and lines)."""

    pixel: float
    line: float
    radius_px: float

    @property
    def center_px(self) -> tuple[float, float]:
        """Center (pixel, line)."""
        return self.pixel, self.line

    def moved(self, d_pixel: float, d_line: float) -> "DrawnCircle":
        """Return the circle moved.

        Examples
        --------
        >>> DrawnCircle(10.0, 20.0, 5.0).moved(0.1, -1.0)
        DrawnCircle(pixel=10.1, line=19.0, radius_px=5.0)
        """
        return DrawnCircle(round(self.pixel + d_pixel, 3), round(self.line + d_line, 3), self.radius_px)

    def grown(self, d_radius: float) -> "DrawnCircle":
        """Return the circle with another radius, at least `MIN_RADIUS_PX`."""
        return DrawnCircle(self.pixel, self.line, max(round(self.radius_px + d_radius, 3), MIN_RADIUS_PX))


def circle_through(pixel0: float, line0: float, pixel1: float, line1: float) -> DrawnCircle:
    """Return the circle about the first place through the second.

    Raises
    ------
    SessionError
        Both are the same place.
    """
    radius = float(np.hypot(pixel1 - pixel0, line1 - line0))
    if radius < MIN_RADIUS_PX:
        raise SessionError(
            f"the circle's radius is {radius:.1f} px; click the center, then a place on the limb."
        )
    return DrawnCircle(round(pixel0, 3), round(line0, 3), round(radius, 3))


def typed_circle(circle: DrawnCircle, field: str, value: str) -> DrawnCircle:
    """Return the circle with one number typed by the analyst.

    Raises
    ------
    SessionError
        It is no number, or no radius.
    """
    number = typed_number(value)
    if number is None or (field == "radius" and number < MIN_RADIUS_PX):
        raise SessionError(f"the circle's {field} must be a number of pixels, not {value!r}.")
    numbers = {"pixel": circle.pixel, "line": circle.line, "radius": circle.radius_px} | {field: number}
    return DrawnCircle(numbers["pixel"], numbers["line"], numbers["radius"])


class CircleTool:
    """Collects the two clicks.

    Examples
    --------
    >>> tool = CircleTool()
    >>> tool.clicked(480.0, 500.0)
    >>> tool.clicked(610.0, 500.0)
    DrawnCircle(pixel=480.0, line=500.0, radius_px=130.0)
    """

    def __init__(self) -> None:
        self.center: tuple[float, float] | None = None

    def clicked(self, pixel: float, line: float) -> DrawnCircle | None:
        """Take a click; return the circle once it is complete.

        Raises
        ------
        SessionError
            Both clicks are in the same place; the center is kept.
        """
        if self.center is None:
            self.center = (pixel, line)
            return None
        circle = circle_through(*self.center, pixel, line)
        self.center = None
        return circle

    def drop(self) -> bool:
        """Forget a center without a radius; False where there is none."""
        begun, self.center = self.center is not None, None
        return begun

    @property
    def prompt(self) -> str:
        """What to do next."""
        if self.center is None:
            return "click the body's center, or drag from its center to its limb."
        return "now click a place on the limb."


# ---- The circle of the body at hand: set, moved, typed, cleared.

FINE_STEP_PX = 0.1  # px, of an arrow key with Shift


class CircleControl:
    """The circle of the body at hand; every change of it is a session step.

    Parameters
    ----------
    body
        Returns the name of the body at hand, or raises `SessionError`.
    radii_km
        Returns the radii of a body that the analyst is about to describe; None of any other.
    """

    def __init__(
        self,
        runner: StepRunner,
        body: Callable[[], str],
        radii_km: Callable[[str], Sequence[float] | None] = lambda _: None,
    ) -> None:
        self.runner = runner
        self._radii_km = radii_km
        self.tool = CircleTool()
        self._body = body

    def of(self, name: str) -> DrawnCircle | None:
        """Return the analyst's circle of a body, if there is one."""
        state = self.runner.session.state
        circle = state.circles.get(name) or state.assisted.get(name)
        if circle is None or circle.radius_px is None:
            return None
        return DrawnCircle(float(circle.center_px[0]), float(circle.center_px[1]), float(circle.radius_px))

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        moves: dict[str, Handler] = {}
        for side, (across, down) in ARROW_STEPS.items():
            moves[f"circle_{side}"] = self._moving(across, down)
            moves[f"circle_fine_{side}"] = self._moving(FINE_STEP_PX * across, FINE_STEP_PX * down)
        return moves | {
            "circle_larger": lambda _: self.set(self._present().grown(+1.0)),
            "circle_smaller": lambda _: self.set(self._present().grown(-1.0)),
            "circle_field": self._typed,
            "circle": lambda _: self._take_tool(),
            "clear_circle": lambda _: self._clear(),
        }

    def set(self, circle: DrawnCircle) -> None:
        """Make it the circle of the body at hand."""
        name, session = self._body(), self.runner.session
        radii = self._radii_km(name)
        if radii is not None or name in session.state.assisted:
            self._describe(name, circle, radii)
            return
        self.runner.run(
            "setting the circle",
            lambda: session.set_circle(name, circle.center_px, circle.radius_px),
            f"{name}: circle set, center {circle.pixel:.1f}, {circle.line:.1f}, radius {circle.radius_px:.1f} px; "
            "F finds the center from it.",
        )

    def _describe(self, name: str, circle: DrawnCircle, radii_km: Sequence[float] | None) -> None:
        """Describe a body by its circle, or move the circle of one that is described."""
        session = self.runner.session

        def work() -> None:
            if name in session.state.assisted:
                session.move_described(name, circle.center_px, circle.radius_px)
            else:
                session.describe_body(name, circle.center_px, circle.radius_px, radii_km=radii_km)

        self.runner.run("describing the body", work, lambda: f"{name}: {self.lit(name)}; F finds its center.")

    def lit(self, name: str) -> str:
        """How a described body is lit, and how far it is, in words; empty of any other."""
        body = self.runner.session.state.assisted.get(name)
        if body is None:
            return ""
        target = self.runner.session.inputs.targets[name]
        return (
            f"phase {np.degrees(body.phase_rad):.0f}°, Sun toward {np.degrees(body.sun_angle_rad) % 360.0:.0f}°, "
            f"range {target.range_km:.4g} km"
        )

    def tapped(self, pixel: float, line: float) -> None:
        """Take the click on the center, or on the limb."""
        circle = self.tool.clicked(pixel, line)
        if circle is None:
            self.runner.status.say(self.tool.prompt)
            return
        self.runner.tool = ""
        self.set(circle)

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag from the center to the limb."""
        self.tool.drop()
        circle = circle_through(pixel0, line0, pixel1, line1)
        self.runner.tool = ""
        self.set(circle)

    def _take_tool(self) -> None:
        self._body()
        self.tool.drop()
        self.runner.toggle_tool(CIRCLE, self.tool.prompt)

    def _present(self) -> DrawnCircle:
        circle = self.of(self._body())
        if circle is None:
            raise SessionError("no circle is set for this body: K, then two clicks.")
        return circle

    def _moving(self, across: float, down: float) -> Handler:
        return lambda _: self.set(self._present().moved(across, down))

    def _typed(self, event: PageEvent) -> None:
        self.set(typed_circle(self._present(), str(event["arg"]), str(event["value"])))

    def _clear(self) -> None:
        name = self._body()
        self._present()
        if name not in self.runner.session.state.circles:
            raise SessionError(f"{name} is described by its circle alone; undo takes it back (Ctrl+Z).")
        self.runner.run(
            "clearing the circle", lambda: self.runner.session.clear_circle(name), f"{name}: no circle."
        )
