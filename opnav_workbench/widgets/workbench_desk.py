"""What every tab of the workbench offers: its page, its actions, and what it draws over the picture."""

from collections.abc import Callable, Mapping
from typing import Any

from opnav_workbench.widgets.actions import ActionRegistry
from opnav_workbench.widgets.workbench_bench import Bench
from opnav_workbench.widgets.workbench_html import button

__all__ = ["SIDES", "Desk", "Event", "Handler"]

Event = Mapping[str, Any]  # what the page reports: act, arg, value, picks, shift
Handler = Callable[[Event], None]
# Steps (pixel, line) of the arrow keys, as the actions name them.
SIDES = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}


class Desk:
    """A tab.  Each public attribute is for the workbench that holds it.

    Parameters
    ----------
    bench : Bench
    registry : ActionRegistry
    """

    name = ""

    def __init__(self, bench: Bench, registry: ActionRegistry) -> None:
        self.bench = bench
        self.registry = registry

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {}

    def html(self) -> str:
        """Return its page."""
        raise NotImplementedError

    def entered(self) -> None:
        """Take note that the tab, or another image, is shown now."""

    def draw(self) -> None:
        """Draw over the picture what belongs to this tab."""

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click in the picture."""

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag in the picture."""

    def abandon(self) -> bool:
        """Drop a shape that is half drawn; False where there is none."""
        return False

    def button(self, name: str, **options: Any) -> str:
        """Return the button of an action."""
        return button(self.registry[name], **options)
