"""Bokeh change events made ready for sending: the newest value of each property once, grouped by who made them."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from bokeh.document import Document
from bokeh.document.events import (
    ColumnDataChangedEvent,
    ColumnsPatchedEvent,
    ColumnsStreamedEvent,
    DocumentPatchedEvent,
    ModelChangedEvent,
)

__all__ = ["Outgoing", "grouped"]

MODEL_EVENTS = (ModelChangedEvent, ColumnDataChangedEvent, ColumnsPatchedEvent, ColumnsStreamedEvent)


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Events of one origin: the id of the page that made them (it has them already), or None for Python."""

    origin: str | None
    events: tuple[DocumentPatchedEvent, ...]


def grouped(events: Iterable[DocumentPatchedEvent], document: Document) -> list[Outgoing]:
    """Return the patches to send, in order.

    A property that changed more than once is sent once, with the value that it has now: a callback that corrects
    what a page set runs before the page's own change is announced, and the other pages must end with the correction.
    """
    kept: dict[Any, tuple[DocumentPatchedEvent, str | None]] = {}
    for number, event in enumerate(events):
        if isinstance(event, MODEL_EVENTS) and event.model.document is not document:
            continue  # removed since; no page knows it
        setter: Any = event.setter  # bokeh names its sessions; ours are ids of pages
        origin = setter if isinstance(setter, str) else None
        key = _key(event, number)
        if key in kept and kept.pop(key)[1] != origin:
            origin = None
        kept[key] = (event, origin)
    return _runs(kept.values())


def _key(event: DocumentPatchedEvent, number: int) -> Any:
    if isinstance(event, ModelChangedEvent):
        return (event.model.id, event.attr)
    if isinstance(event, ColumnDataChangedEvent) and event.cols is None:
        return (event.model.id, event.attr)
    return number


def _runs(events: Iterable[tuple[DocumentPatchedEvent, str | None]]) -> list[Outgoing]:
    runs: list[Outgoing] = []
    for event, origin in events:
        if isinstance(event, ModelChangedEvent):
            event.new = event.model.lookup(event.attr).get_value(event.model)
        if runs and runs[-1].origin == origin:
            runs[-1] = Outgoing(origin, (*runs[-1].events, event))
        else:
            runs.append(Outgoing(origin, (event,)))
    return runs
