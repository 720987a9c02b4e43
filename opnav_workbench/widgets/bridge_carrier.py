"""What carries the bridge: an anywidget, which sends messages as they are and BokehJS once a page.

BokehJS comes from the installed bokeh package, so that a notebook needs neither a network nor its own copy.
"""

from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anywidget
import bokeh
import bokeh.util.paths
import traitlets

from opnav_workbench.widgets import static_picture

if TYPE_CHECKING:
    from opnav_workbench.widgets.bridge import Bridge, Message

__all__ = ["BridgeWidget", "page_script"]

# In the order in which they need each other; together one JavaScript module.
SCRIPTS = (
    "theme.js",
    "keys.js",
    "status.js",
    "camera.js",
    "stretch.js",
    "image_layout.js",
    "image_pointer.js",
    "image_actions.js",
    "image_cursor.js",
    "image_view.js",
    "bridge.js",
)
STYLE = "view.css"


@cache
def page_script() -> str:
    """Return the JavaScript module that runs in the page."""
    folder = resources.files("opnav_workbench.widgets") / "static"
    return "\n".join((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)


@cache
def page_style() -> str:
    """Return the style sheet of the views."""
    return (resources.files("opnav_workbench.widgets") / "static" / STYLE).read_text(encoding="utf-8")


def bokeh_scripts(parts: Sequence[str]) -> list[bytes]:
    """Return parts of BokehJS from the installed package."""
    folder = Path(bokeh.util.paths.bokehjs_path()) / "js"
    return [(folder / f"{part}.min.js").read_bytes() for part in parts]


class BridgeWidget(anywidget.AnyWidget):
    """The notebook's side of a `Bridge`."""

    bokeh_version = traitlets.Unicode(bokeh.__version__).tag(sync=True)
    bokeh_parts = traitlets.List(traitlets.Unicode()).tag(sync=True)

    def __init__(self, bridge: "Bridge") -> None:
        self._esm, self._css = page_script(), page_style()
        super().__init__(bokeh_parts=list(bridge.parts))
        self._bridge = bridge
        bridge.attach(self)
        self.on_msg(self._received)

    def send_message(self, content: "Message", buffers: Sequence[Any]) -> None:
        """Send one message to every page."""
        self.send(dict(content), list(buffers))

    def _received(self, _: Any, content: "Message", __: Any) -> None:
        if content.get("kind") == "bokeh":
            # Only BokehJS itself is ever read, whatever the page asks for.
            wanted = [part for part in self._bridge.parts if part in content["parts"]]
            self.send({"kind": "bokeh", "page": content["page"]}, bokeh_scripts(wanted))
        else:
            self._bridge.receive(content)

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        bundle = super()._repr_mimebundle_(**kwargs)
        return static_picture.with_picture(bundle, self._bridge.picture)
