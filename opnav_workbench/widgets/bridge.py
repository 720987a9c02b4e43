"""The bridge: one bokeh document, shown in a notebook and kept in step with every page that shows it.

Flow   Python changes a model -> JSON patch -> every page;  a page changes a model -> JSON patch -> Python callbacks
       -> every other page
Pages  each display has an id; a page never hears of its own changes, and Python's changes are not echoed back
State  lives here: a page that opens or reloads asks for the whole document and gets it as it is now

The patches are bokeh's own (bokeh.document.events); the carrier, in `bridge_carrier`, only transports them.
"""

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

from bokeh.core.json_encoder import PayloadEncoder
from bokeh.core.serialization import Buffer, Serializer
from bokeh.document import Document
from bokeh.document.events import DocumentPatchedEvent
from bokeh.model import Model

from opnav_workbench.widgets.bridge_patches import Outgoing, grouped
from opnav_workbench.widgets.status import Status

__all__ = ["Bridge", "Carrier", "Message"]

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
    picture : callable, optional
        Returns the PNG that front ends without a live kernel show.
    status : Status, optional
        Where failures are told; default a line of its own below the view.
    parts : sequence of str
        Parts of BokehJS that the models need.

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
        self.picture = picture
        self.parts = tuple(parts)
        self.status = Status(message="", changed=self._send_status) if status is None else status
        self._lock = threading.RLock()
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
            from opnav_workbench.widgets.bridge_carrier import BridgeWidget  # noqa: PLC0415

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
        key : str
            As ``KeyboardEvent.key`` has it: ``a``, ``A``, ``?``, ``ArrowLeft``, ``Enter``; with modifiers
            ``Shift+ArrowLeft``, ``Ctrl+z``, ``Ctrl+Shift+z``. Meta counts as Ctrl.
        callback : callable, optional
            Runs in Python.
        page : str
            Name of an action of the page instead, which needs no round trip.
        """
        with self._lock:
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
        with self._lock:
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self._flush()

    def _changed(self, event: Any) -> None:
        if not isinstance(event, DocumentPatchedEvent):
            return
        with self._lock:
            self._pending.append(event)
            if self._depth == 0:
                self._flush()

    def redraw(self) -> None:
        """Let every page ask for the whole document, where nearly all of it changes in the present batch."""
        self._redraw = True

    def _flush(self) -> None:
        events, self._pending = self._pending, []
        redraw, self._redraw = self._redraw, False
        if not self._pages:
            return  # the next page gets the whole document
        if redraw:
            self._send({"kind": "refresh"})
            return
        for group in grouped(events, self.document):
            self._send_patch(group)

    def _send_patch(self, group: Outgoing) -> None:
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
        with self._lock:
            if self._pages:
                for carrier in self._carriers:
                    carrier.send_message(message, buffers)

    # -- messages in -------------------------------------------------------------------------------------------

    def attach(self, carrier: Carrier) -> None:
        """Add a way to the pages."""
        self._carriers.append(carrier)

    def receive(self, message: Message) -> None:
        """Handle one message of a page; see `opnav_workbench.widgets.static` for the other side."""
        handlers: dict[str, Callable[[Message], None]] = {
            "open": self._on_open,
            "patch": self._on_patch,
            "key": lambda m: self.press(str(m["key"])),
            "event": self._on_event,
            "error": self._on_page_error,
            "closed": lambda m: self._pages.discard(str(m["page"])),
        }
        with self.status.reporting():
            self._active = str(message["page"])
            handlers[str(message["kind"])](message)
            if "sequence" in message:
                self._send({"kind": "done", "page": message["page"], "sequence": message["sequence"]})

    def _on_open(self, message: Message) -> None:
        with self._lock:
            self._flush()  # what the older pages still lack; the new one gets it with the document
            self._pages.add(str(message["page"]))
            serialized = self.document.to_json()
            head = {"kind": "document", "page": message["page"], **self._key_table()}
            self._send_payload(head, serialized.content, serialized.buffers)
            self._send_status()

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
