"""The workbench's regions in the notebook: each shows HTML from Python and reports what the person does."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import anywidget
import ipywidgets
import traitlets

from opnav_workbench.widgets.static_picture import with_picture

__all__ = ["Region", "WorkbenchBox"]

HERE = Path(__file__).parent


class Region(anywidget.AnyWidget):
    """One part of the page.

    Parameters
    ----------
    name : str
    heard : callable
        Called with what the page reports.

    Attributes
    ----------
    keymap, picture_keys : list of str
        Keys that the whole workbench handles, set on one of its regions; and those of them that the picture handles by
        itself while it has the focus.
    """

    _esm = "\n".join(
        (HERE / name).read_text(encoding="utf-8") for name in ("static/keys.js", "workbench_shell.js")
    )
    _css = (HERE / "workbench_shell.css").read_text(encoding="utf-8")
    name = traitlets.Unicode("").tag(sync=True)
    html = traitlets.Unicode("").tag(sync=True)
    keymap = traitlets.List(traitlets.Unicode()).tag(sync=True)
    picture_keys = traitlets.List(traitlets.Unicode()).tag(sync=True)

    def __init__(self, name: str, heard: Callable[[Mapping[str, Any]], None]) -> None:
        super().__init__(name=name)
        self._heard = heard
        self.on_msg(self._message)

    def _message(self, _: object, content: Mapping[str, Any], __: object) -> None:
        self._heard(content)
        self.send({"heard": content.get("act", "")})  # the page then knows that the kernel lives


class WorkbenchBox(ipywidgets.Box):  # type: ignore[misc]  # ipywidgets has no types
    """The regions around the picture; a front end without a kernel shows a message and the picture.

    Parameters
    ----------
    children : sequence of Widget
    picture : callable
        Returns the PNG of the picture.
    """

    def __init__(self, children: Sequence[ipywidgets.Widget], picture: Callable[[], bytes]) -> None:
        super().__init__(children=tuple(children))
        self.add_class("opnav-workbench")
        self._picture = picture

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return with_picture(super()._repr_mimebundle_(**options), self._picture)
