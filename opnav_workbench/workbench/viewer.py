"""What the workbench asks of the picture: a small protocol, so that a fake picture serves the tests."""

import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from opnav_workbench.arrays import FloatArray
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import Action

__all__ = ["Layer", "Viewer"]

Segment = tuple[float, float, float, float]  # pixel, line of both ends
Label = tuple[float, float, str]


class Layer:
    """Lines and labels that a tool draws over the picture.

    Parameters
    ----------
    segments : sequence of (pixel, line, pixel, line)
    styles
        One per segment: ``used``, ``unused``, ``rejected`` or ``focus``.
    labels : sequence of (pixel, line, text)
    sides
        One per label: which side of the text is at its place, ``left``, ``right`` or ``center``; without, a text stands
        above its place, to the right.
    """

    __slots__ = ("labels", "segments", "sides", "styles")

    def __init__(
        self,
        segments: Sequence[Segment] = (),
        styles: Sequence[str] = (),
        labels: Sequence[Label] = (),
        sides: Sequence[str] = (),
    ) -> None:
        self.segments, self.styles, self.labels = tuple(segments), tuple(styles), tuple(labels)
        self.sides = tuple(sides)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Layer):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in self.__slots__)

    __hash__ = None  # type: ignore[assignment]


class Viewer(Protocol):
    """A picture that shows a session and reports clicks and drags in pixels and lines."""

    @property
    def actions(self) -> Sequence[Action]:
        """Its own actions, for the registry."""

    @property
    def lock(self) -> threading.RLock:
        """Held while the picture is changed and while clicks are reported; the workbench's steps hold no other."""

    def batch(self) -> AbstractContextManager[None]:
        """Let the changes of the block reach the pages together."""

    def show(self, session: ImageSession) -> None:
        """Show another session's picture."""

    def prepare(self, session: ImageSession) -> None:
        """Do ahead what showing a session costs; may be called in another thread."""

    def send_ahead(self, sessions: Sequence[ImageSession]) -> None:
        """Bring those that are prepared nearer to the pages, the likeliest to be shown next first."""

    def blank(self, message: str) -> None:
        """Show no picture but a message in its place."""

    def compare_with(self, others: Sequence[tuple[str, ImageSession]]) -> None:
        """Offer other images, by name, to be shown beside this one or blinked against."""

    def look(self, place_px: FloatArray, span_px: float | None = None, *, unless_seen: bool = False) -> None:
        """Bring a place into the middle, with a span so many pixels across; or, where it is in sight already, nothing."""

    def refresh(self) -> None:
        """Bring the overlays to the session's present state."""

    def do(self, name: str) -> str:
        """Carry out one of its own actions; return what to say."""

    def drag_mode(self, on: bool, shape: str = "box") -> None:
        """A drag draws a shape (``box``, ``circle``) and reports its ends (on), or moves the picture (off)."""

    def layer(self, name: str, layer: Layer) -> None:
        """Draw a tool's layer, replacing what it had drawn."""

    def circle(self, center_px: FloatArray | None, radius_px: float = 0.0) -> None:
        """Draw the analyst's circle; None takes it away."""

    def focus(self, place_px: FloatArray | None, radius_px: float = 0.0) -> None:
        """Ring the object under decision, and bring it into view."""

    def listen(
        self, tapped: Callable[[float, float], None], dragged: Callable[[float, float, float, float], None]
    ) -> None:
        """Report clicks (pixel, line) and, in drag mode, drags (from, to)."""
