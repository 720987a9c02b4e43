"""The bridge: one bokeh document, shown in a notebook and kept in step with every page that shows it.

Flow      Python changes a model -> JSON patch -> every page;  a page changes a model -> JSON patch -> Python callbacks
          -> every other page
Pages     each display has an id; a page never hears of its own changes, and Python's changes are not echoed back
State     lives here: a page that opens or reloads asks for the whole document and gets it as it is now
Patches   bokeh's own (bokeh.document.events): the newest value of each property once, grouped by who made it
Pixels    beside the document: each page asks for what it lacks, piece by piece (sent_arrays.py)
Carrier   an anywidget sends messages as they are (static/bridge.js is the other side), and BokehJS once a page, from the
          installed bokeh package, so that a notebook needs neither a network nor its own copy
"""

import contextlib
import functools
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import anywidget
import bokeh
import bokeh.util.paths
import traitlets
from bokeh.core.json_encoder import PayloadEncoder
from bokeh.core.serialization import Buffer, Serializer
from bokeh.document import Document
from bokeh.document.events import (
    ColumnDataChangedEvent,
    ColumnsPatchedEvent,
    ColumnsStreamedEvent,
    DocumentPatchedEvent,
    ModelChangedEvent,
)
from bokeh.model import Model

from opnav_workbench.workbench.markup import page_files, with_still_picture
from opnav_workbench.workbench.sent_arrays import ArrayStore
from opnav_workbench.workbench.status_line import Status

__all__ = ["Bridge"]


# ---- Bokeh change events made ready for sending: the newest value of each property once, grouped by who made it.

MODEL_EVENTS = (ModelChangedEvent, ColumnDataChangedEvent, ColumnsPatchedEvent, ColumnsStreamedEvent)


@dataclass(frozen=True, slots=True)
class Patch:
    """Events of one origin: the id of the page that made them (it has them already), or None for Python."""

    origin: str | None
    events: tuple[DocumentPatchedEvent, ...]


def patches_by_origin(events: Iterable[DocumentPatchedEvent], document: Document) -> list[Patch]:
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
        key = _property_key(event, number)
        if key in kept and kept.pop(key)[1] != origin:
            origin = None
        kept[key] = (event, origin)
    return _joined(kept.values())


def _property_key(event: DocumentPatchedEvent, number: int) -> Any:
    if isinstance(event, ModelChangedEvent):
        return (event.model.id, event.attr)
    if isinstance(event, ColumnDataChangedEvent) and event.cols is None:
        return (event.model.id, event.attr)
    return number


def _joined(events: Iterable[tuple[DocumentPatchedEvent, str | None]]) -> list[Patch]:
    runs: list[Patch] = []
    for event, origin in events:
        if isinstance(event, ModelChangedEvent):
            event.new = event.model.lookup(event.attr).get_value(event.model)
        if runs and runs[-1].origin == origin:
            runs[-1] = Patch(origin, (*runs[-1].events, event))
        else:
            runs.append(Patch(origin, (event,)))
    return runs


# ---- The bridge itself.

Message = Mapping[str, Any]
TITLE = "opnav_workbench"
# bokeh.min.js lacks buttons, Div and tables: what it does not know fails late, so all parts are the default.
BOKEH_PARTS = ("bokeh", "bokeh-widgets", "bokeh-tables")


class Carrier(Protocol):
    """What takes messages to the pages; a list serves tests."""

    def send_message(self, content: Message, buffers: Sequence[Any]) -> None:
        """Send one message with its binary buffers to every page."""


class Bridge:
    """A bokeh document with its callbacks, keys and status line.

    Parameters
    ----------
    *roots : bokeh Model
        What is shown, from top to bottom.
    picture
        Returns the PNG that front ends without a live kernel show.
    status
        Where failures are told; default a line of its own below the view.
    parts
        Parts of BokehJS that the models need.

    Attributes
    ----------
    lock : RLock
        Held while anything is changed or a callback runs; who has a lock of his own for what callbacks do has to take this.

    Examples
    --------
    >>> from bokeh.models import Div
    >>> bridge = Bridge(Div(text="hello"))
    >>> bridge.bind_key("a", lambda: bridge.status.say("accepted"))
    >>> bridge.press("a")
    >>> bridge.status.message
    'accepted'
    """

    def __init__(
        self,
        *roots: Model,
        picture: Callable[[], bytes] | None = None,
        status: Status | None = None,
        parts: Sequence[str] = BOKEH_PARTS,
    ) -> None:
        self.document = Document(title=TITLE)
        self.arrays = ArrayStore()
        self.picture = picture
        self.parts = tuple(parts)
        self.status = Status(message="", changed=self._send_status) if status is None else status
        self.lock = threading.RLock()
        self._carriers: list[Carrier] = []
        self._pages: set[str] = set()
        self._keys: dict[str, Callable[[], object]] = {}
        self._page_keys: dict[str, str] = {}
        self._events: dict[str, list[Callable[..., object]]] = {}
        self._active = ""  # the page that spoke last
        self._pending: list[DocumentPatchedEvent] = []
        self._depth = 0
        self._redraw = False
        self._widget: Any = None
        self.show(*roots)
        self.document.on_change(self._changed)

    # -- what is shown -----------------------------------------------------------------------------------------

    def show(self, *roots: Model) -> None:
        """Show these models, instead of what was shown."""
        with self.batch():
            for old in list(self.document.roots):
                self.document.remove_root(old)
            for root in roots:
                self.document.add_root(root)

    @property
    def widget(self) -> Any:
        """The notebook widget (built on first use, so that nothing is built without a display)."""
        if self._widget is None:
            self._widget = BridgeWidget(self)
        return self._widget

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        return self.widget._repr_mimebundle_(**kwargs)

    # -- callbacks ---------------------------------------------------------------------------------------------

    def guarded(self, callback: Callable[..., object]) -> Callable[..., None]:
        """Return `callback` made safe: its changes are one patch, and an exception becomes a status line."""

        @functools.wraps(callback)  # bokeh looks at the signature
        def call(*args: Any, **kwargs: Any) -> None:
            with self.status.reporting(), self.batch():
                callback(*args, **kwargs)

        return call

    def bind_key(self, key: str, callback: Callable[[], object] | None = None, *, page: str = "") -> None:
        """Call `callback` when `key` is pressed in the view; without one, the key is free again.

        Parameters
        ----------
        key
            As ``KeyboardEvent.key`` has it: ``a``, ``A``, ``?``, ``ArrowLeft``, ``Enter``; with modifiers
            ``Shift+ArrowLeft``, ``Ctrl+z``, ``Ctrl+Shift+z``. Meta counts as Ctrl.
        callback
            Runs in Python.
        page
            Name of an action of the page instead, which needs no round trip.
        """
        with self.lock:
            self._keys.pop(key, None)
            self._page_keys.pop(key, None)
            if callback is not None:
                self._keys[key] = self.guarded(callback)
            if page:
                self._page_keys[key] = page
            self._send({"kind": "keys", **self._key_table()})

    def _key_table(self) -> dict[str, Any]:
        return {"keys": sorted(self._keys), "page_keys": dict(self._page_keys)}

    def press(self, key: str) -> None:
        """Do what the key does, as if it had been pressed (what happens in the page alone is not done)."""
        if (callback := self._keys.get(key)) is not None:
            callback()

    def on_event(self, name: str, callback: Callable[..., object]) -> None:
        """Call `callback` with the values of each event `name` that a page sends, such as ``tap``."""
        self._events.setdefault(name, []).append(self.guarded(callback))

    def do(self, name: str) -> None:
        """Carry out an action of the page, in the page that was used last."""
        self._send({"kind": "do", "page": self._active, "name": name})

    def _send_status(self) -> None:
        self._send({"kind": "status", "text": self.status.message, "level": self.status.kind})

    # -- patches out -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def batch(self) -> Iterator[None]:
        """Collect the changes of the block into one patch; other threads wait."""
        with self.lock:
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self.flush()

    def _changed(self, event: Any) -> None:
        if not isinstance(event, DocumentPatchedEvent):
            return
        with self.lock:
            self._pending.append(event)
            if self._depth == 0:
                self.flush()

    def redraw(self) -> None:
        """Let every page ask for the whole document, where nearly all of it changes in the present batch."""
        self._redraw = True

    def flush(self) -> None:
        """Send what has changed so far; within a batch too, where what is sent by another way is to come after it."""
        with self.lock:
            events, self._pending = self._pending, []
            redraw, self._redraw = self._redraw, False
            if not self._pages:
                return  # the next page gets the whole document
            if redraw:
                self._send({"kind": "refresh"})
                return
            for group in patches_by_origin(events, self.document):
                self._send_patch(group)

    def _send_patch(self, group: Patch) -> None:
        models = self.document.models
        serializer = Serializer(references=models.synced_references)
        content = {"events": serializer.encode(list(group.events))}
        models.flush_synced(lambda model: not serializer.has_ref(model))
        self._send_payload({"kind": "patch", "origin": group.origin}, content, serializer.buffers)

    def _send_payload(self, message: dict[str, Any], content: Any, buffers: Sequence[Buffer]) -> None:
        text = PayloadEncoder(separators=(",", ":")).encode(content).encode()
        self._send(
            message | {"buffer_ids": [buffer.id for buffer in buffers]},
            [text, *(buffer.data for buffer in buffers)],
        )

    def _send(self, message: Message, buffers: Sequence[Any] = ()) -> None:
        with self.lock:
            if self._pages:
                for carrier in self._carriers:
                    carrier.send_message(message, buffers)

    # -- messages in -------------------------------------------------------------------------------------------

    def attach(self, carrier: Carrier) -> None:
        """Add a way to the pages."""
        self._carriers.append(carrier)

    def receive(self, message: Message) -> None:
        """Handle one message of a page; static/bridge.js is the other side."""
        handlers: dict[str, Callable[[Message], None]] = {
            "open": self._on_open,
            "patch": self._on_patch,
            "key": lambda m: self.press(str(m["key"])),
            "event": self._on_event,
            "error": self._on_page_error,
            "closed": lambda m: self._pages.discard(str(m["page"])),
        }
        if message["kind"] == "pull":
            self._on_pull(message)
            return
        with self.status.reporting():
            self._active = str(message["page"])
            handlers[str(message["kind"])](message)
            if "sequence" in message:
                self._send({"kind": "done", "page": message["page"], "sequence": message["sequence"]})

    def _on_open(self, message: Message) -> None:
        with self.lock:
            self.flush()  # what the older pages still lack; the new one gets it with the document
            self._pages.add(str(message["page"]))
            serialized = self.document.to_json()
            head = {"kind": "document", "page": message["page"], **self._key_table()}
            self._send_payload(head, serialized.content, serialized.buffers)
            self._send_status()

    def _on_pull(self, message: Message) -> None:
        """Send a piece of an array to the page that lacks it; one that is gone is needed no more."""
        token, first = str(message["token"]), int(message["first"])
        array = self.arrays.get(token)
        head = {"kind": "piece", "page": message["page"], "token": token, "first": first}
        if array is None:
            self._send(head | {"gone": True})
        else:
            self._send(head, [array.piece(first, int(message["count"]))])

    def _on_patch(self, message: Message) -> None:
        damaged = False
        page: Any = str(message["page"])  # bokeh calls it the setter, and has sessions of its own in mind
        with self.batch():
            for event in message["patch"]["events"]:
                # One by one: what follows a failing callback still counts.
                try:
                    self.document.apply_json_patch({"events": [event]}, setter=page)
                except Exception as error:  # a callback's, or a model that is gone
                    damaged = True
                    self.status.fail(error)
            if damaged:
                self.redraw()  # some page may differ from Python now

    def _on_event(self, message: Message) -> None:
        for callback in self._events.get(str(message["name"]), ()):
            callback(*message["values"])

    def _on_page_error(self, message: Message) -> None:
        error = PageError(str(message.get("text")))
        error.add_note(str(message.get("stack")))
        self.status.fail(error)


class PageError(RuntimeError):
    """JavaScript failed in the page."""


# ---- What carries the bridge: an anywidget, which sends messages as they are and BokehJS once a page.

# In the order in which they need each other; together one JavaScript module.
SCRIPTS = (
    "theme.js",
    "keys.js",
    "status.js",
    "camera.js",
    "stretch.js",
    "measures.js",
    "pixel_store.js",
    "image_layout.js",
    "small_plot.js",
    "inspect_card.js",
    "image_tools.js",
    "second_picture.js",
    "crowd.js",
    "image_pointer.js",
    "image_actions.js",
    "image_cursor.js",
    "image_view.js",
    "bridge.js",
)
STYLE = "view.css"


def bokeh_scripts(parts: Sequence[str]) -> list[bytes]:
    """Return parts of BokehJS from the installed package."""
    folder = Path(bokeh.util.paths.bokehjs_path()) / "js"
    return [(folder / f"{part}.min.js").read_bytes() for part in parts]


class BridgeWidget(anywidget.AnyWidget):
    """The notebook's side of a `Bridge`."""

    bokeh_version = traitlets.Unicode(bokeh.__version__).tag(sync=True)
    bokeh_parts = traitlets.List(traitlets.Unicode()).tag(sync=True)

    def __init__(self, bridge: Bridge) -> None:
        self._esm, self._css = page_files(*SCRIPTS), page_files(STYLE)
        super().__init__(bokeh_parts=list(bridge.parts))
        self._bridge = bridge
        bridge.attach(self)
        self.on_msg(self._received)

    def send_message(self, content: Message, buffers: Sequence[Any]) -> None:
        """Send one message to every page."""
        self.send(dict(content), list(buffers))

    def _received(self, _: Any, content: Message, __: Any) -> None:
        if content.get("kind") == "bokeh":
            # Only BokehJS itself is ever read, whatever the page asks for.
            wanted = [part for part in self._bridge.parts if part in content["parts"]]
            self.send({"kind": "bokeh", "page": content["page"]}, bokeh_scripts(wanted))
        else:
            self._bridge.receive(content)

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        bundle = super()._repr_mimebundle_(**kwargs)
        return with_still_picture(bundle, self._bridge.picture)
