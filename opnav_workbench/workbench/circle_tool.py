"""The analyst's circle of a body: two clicks or a drag, or three clicks on its limb; then arrow keys and typed numbers.

The circle itself is immutable, in pixels and lines; each change of it is a session step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.scene import apparent_radius_px
from opnav_workbench.workbench.actions import CIRCLE, LIMB_POINTS
from opnav_workbench.workbench.description import description_line
from opnav_workbench.workbench.tabs import ARROW_STEPS, Handler, PageEvent, StepRunner, typed_number
from opnav_workbench.workbench.viewer import Layer

__all__ = ["CircleControl", "CircleTool", "DrawnCircle", "typed_circle"]


# ---- The circle, and the clicks or the drag that make it.

MIN_RADIUS_PX = 1.0  # a smaller circle is two clicks on one place
LEAST_BEND = (
    0.02  # height of three places over their longest side; flatter, a pixel decides how large the circle is
)
CROSS_PX = 6.0  # half the length of the crosses at places clicked


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


def circle_through_limb(places_px: Sequence[tuple[float, float]]) -> DrawnCircle:
    """Return the circle through three places (pixel, line) on the limb.

    Raises
    ------
    SessionError
        They lie on a line, or nearly.

    Examples
    --------
    >>> circle_through_limb([(0.0, 5.0), (5.0, 0.0), (10.0, 5.0)])
    DrawnCircle(pixel=5.0, line=5.0, radius_px=5.0)
    """
    places = np.array(places_px)
    sides = places[1:] - places[0]
    longest = float(max(np.linalg.norm(one - other) for one in places for other in places))
    double_area = float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    if longest < MIN_RADIUS_PX or abs(double_area) < LEAST_BEND * longest**2:
        raise SessionError("the three places lie on a line; click places far apart on the limb.")
    # The center is as far from all: its distances from the chords' middles are at right angles to them.
    center = places[0] + np.linalg.solve(sides, 0.5 * (sides**2).sum(axis=1))
    radius = float(np.linalg.norm(places[0] - center))
    return DrawnCircle(*(round(float(x), 3) for x in (*center, radius)))


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
    """Collects the clicks: center and limb, or three places on the limb.

    Examples
    --------
    >>> tool = CircleTool()
    >>> tool.clicked(480.0, 500.0)
    >>> tool.clicked(610.0, 500.0)
    DrawnCircle(pixel=480.0, line=500.0, radius_px=130.0)
    """

    def __init__(self) -> None:
        self.places: list[tuple[float, float]] = []
        self.by_limb = False

    def clicked(self, pixel: float, line: float) -> DrawnCircle | None:
        """Take a click; return the circle once it is complete.

        Raises
        ------
        SessionError
            The places make no circle; those before the last are kept.
        """
        places = [*self.places, (pixel, line)]
        if len(places) < (3 if self.by_limb else 2):
            self.places = places
            return None
        circle = circle_through_limb(places) if self.by_limb else circle_through(*places[0], *places[1])
        self.places = []
        return circle

    def begin(self, *, by_limb: bool) -> None:
        """Begin anew."""
        self.places, self.by_limb = [], by_limb

    def drop(self) -> bool:
        """Forget places that make no circle yet; False where there are none."""
        begun, self.places = bool(self.places), []
        return begun

    def layer(self) -> Layer:
        """Return crosses at the places clicked so far."""
        crosses = [
            ends
            for pixel, line in self.places
            for ends in (
                (pixel - CROSS_PX, line, pixel + CROSS_PX, line),
                (pixel, line - CROSS_PX, pixel, line + CROSS_PX),
            )
        ]
        return Layer(crosses, ["focus"] * len(crosses))

    @property
    def prompt(self) -> str:
        """What to do next."""
        if self.by_limb:
            left = ("three places on the limb, far apart", "a second place on the limb", "a third one")
            return f"click {left[len(self.places)]}."
        if not self.places:
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
        radii_km: Callable[[str], Sequence[float] | None],
    ) -> None:
        self.runner = runner
        self._radii_km = radii_km
        self.tool = CircleTool()
        self._body = body

    def of(self, name: str) -> DrawnCircle | None:
        """Return the analyst's circle of a body, if there is one."""
        state = self.runner.session.state
        circle, body = state.circles.get(name), state.assisted.get(name)
        if circle is not None:
            return DrawnCircle(
                float(circle.center_px[0]), float(circle.center_px[1]), float(circle.radius_px)
            )
        if body is None:
            return None
        radius = apparent_radius_px(body, self.runner.session.context.camera)
        return DrawnCircle(float(body.center_px[0]), float(body.center_px[1]), round(radius, 3))

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
            "circle": lambda _: self.take_tool(),
            "limb_points": lambda _: self.take_tool(LIMB_POINTS),
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
        session, present = self.runner.session, self.of(name)

        def work() -> None:
            if name not in session.state.assisted or present is None:
                session.describe_body(name, circle.center_px, circle.radius_px, radii_km=radii_km)
                return
            # Another size tells another range; a circle that is moved alone keeps the one that was stated.
            resized = circle.radius_px != present.radius_px
            size: dict[str, Any] = {"radius_px": circle.radius_px, "range_km": None} if resized else {}
            session.describe_again(name, center_px=circle.center_px, **size)

        self.runner.run("describing the body", work, lambda: description_line(session, name))

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

    def take_tool(self, tool: str = CIRCLE) -> None:
        """Take the tool of two clicks or a drag, or that of three places on the limb; taken, it is put away."""
        self._body()
        self.tool.begin(by_limb=tool == LIMB_POINTS)
        self.runner.toggle_tool(tool, self.tool.prompt)

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
