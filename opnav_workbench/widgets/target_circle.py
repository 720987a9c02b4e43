"""Click-to-circle: center and radius of a target by two clicks or one drag, adjusted afterwards step by step."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.errors import SessionError

__all__ = ["CircleTool", "DrawnCircle", "circle_through", "typed_circle"]

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
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number) or (field == "radius" and number < MIN_RADIUS_PX):
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
