"""What an analyst's hand does with the circle of a body: two clicks or a drag, then arrow keys and fields."""

from collections.abc import Callable

from opnav_workbench.errors import SessionError
from opnav_workbench.widgets.target_circle import CircleTool, DrawnCircle, circle_through, typed_circle
from opnav_workbench.widgets.workbench_bench import Bench
from opnav_workbench.widgets.workbench_desk import SIDES, Event, Handler

__all__ = ["TOOL", "CircleHand"]

TOOL = "circle"
FINE = 0.1  # px, of an arrow key with Shift


class CircleHand:
    """The circle of the body at hand; every change of it is a session step.

    Parameters
    ----------
    bench : Bench
    body : callable
        Returns the name of the body at hand, or raises `SessionError`.
    """

    def __init__(self, bench: Bench, body: Callable[[], str]) -> None:
        self.bench = bench
        self.tool = CircleTool()
        self._body = body

    def of(self, name: str) -> DrawnCircle | None:
        """Return the analyst's circle of a body, if there is one."""
        circle = self.bench.session.state.circles.get(name)
        if circle is None:
            return None
        return DrawnCircle(float(circle.center_px[0]), float(circle.center_px[1]), float(circle.radius_px))

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        moves: dict[str, Handler] = {}
        for side, (across, down) in SIDES.items():
            moves[f"circle_{side}"] = self._moving(across, down)
            moves[f"circle_fine_{side}"] = self._moving(FINE * across, FINE * down)
        return moves | {
            "circle_larger": lambda _: self.set(self._present().grown(+1.0)),
            "circle_smaller": lambda _: self.set(self._present().grown(-1.0)),
            "circle_field": self._typed,
            "circle": lambda _: self._take_tool(),
            "clear_circle": lambda _: self._clear(),
        }

    def set(self, circle: DrawnCircle) -> None:
        """Make it the circle of the body at hand."""
        name, session = self._body(), self.bench.session
        self.bench.run(
            "setting the circle",
            lambda: session.set_circle(name, circle.center_px, circle.radius_px),
            f"{name}: circle set, center {circle.pixel:.1f}, {circle.line:.1f}, radius {circle.radius_px:.1f} px; "
            "F finds the center from it.",
        )

    def tapped(self, pixel: float, line: float) -> None:
        """Take the click on the center, or on the limb."""
        circle = self.tool.clicked(pixel, line)
        if circle is None:
            self.bench.status.say(self.tool.prompt)
            return
        self.bench.tool = ""
        self.set(circle)

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag from the center to the limb."""
        self.tool.drop()
        circle = circle_through(pixel0, line0, pixel1, line1)
        self.bench.tool = ""
        self.set(circle)

    def _take_tool(self) -> None:
        self._body()
        self.tool.drop()
        self.bench.tool = "" if self.bench.tool == TOOL else TOOL
        if self.bench.tool:
            self.bench.status.say(self.tool.prompt)

    def _present(self) -> DrawnCircle:
        circle = self.of(self._body())
        if circle is None:
            raise SessionError("no circle is set for this body: K, then two clicks.")
        return circle

    def _moving(self, across: float, down: float) -> Handler:
        return lambda _: self.set(self._present().moved(across, down))

    def _typed(self, event: Event) -> None:
        self.set(typed_circle(self._present(), str(event["arg"]), str(event["value"])))

    def _clear(self) -> None:
        name = self._body()
        self._present()
        self.bench.run(
            "clearing the circle", lambda: self.bench.session.clear_circle(name), f"{name}: no circle."
        )
