"""`workbench`: opens the workbench on a session, several, a list of images or a campaign, and shows it in the notebook.

The page is five widgets: header, list of images, picture, panel of the tab, status line. Each region shows HTML from
Python and reports what the person does (static/region.js); all deciding is done by `WorkbenchController`.
"""

import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import anywidget
import ipywidgets
import traitlets

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import PICTURE, ROOM
from opnav_workbench.workbench.controller import REGIONS, WorkbenchController
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.workbench.image_view import ImageView
from opnav_workbench.workbench.markup import in_parts, page_files, with_still_picture
from opnav_workbench.workbench.status_line import Status

if TYPE_CHECKING:
    from opnav_workbench.campaign import Campaign

__all__ = ["queue_of", "workbench"]


# ---- The regions in the notebook.


class Region(anywidget.AnyWidget):
    """One part of the page.

    Parameters
    ----------
    on_message
        Called with what the page reports.

    Attributes
    ----------
    keymap, picture_keys, picture_alone : list of str
        Keys that the whole workbench handles, set on one of its regions; those of them that the picture handles by
        itself while it has the focus; and those that mean nothing but in the picture, which Python need not be asked for.
    page_keys : dict
        Keys of what happens in the page alone, and its names.
    typing_keys : list of str
        Keys that open a field: what is typed until it is there is meant for it.
    """

    _esm = page_files("keys.js", "region.js")
    _css = page_files("workbench.css")
    name = traitlets.Unicode("").tag(sync=True)
    html = traitlets.Unicode("").tag(sync=True)
    keymap = traitlets.List(traitlets.Unicode()).tag(sync=True)
    picture_keys = traitlets.List(traitlets.Unicode()).tag(sync=True)
    picture_alone = traitlets.List(traitlets.Unicode()).tag(sync=True)
    page_keys = traitlets.Dict().tag(sync=True)
    typing_keys = traitlets.List(traitlets.Unicode()).tag(sync=True)

    def __init__(self, name: str, on_message: Callable[[Mapping[str, Any]], None]) -> None:
        super().__init__(name=name)
        self._on_message = on_message
        self._parts: list[str] = []
        self._around: list[str] = [""]
        self._patches = False
        self.on_msg(self._message)

    def show(self, html: str) -> None:
        """Show HTML; where only marked parts of it differ from what is shown (`in_parts`), nothing but these is sent."""
        before, around_before = self._parts, self._around
        self._parts, self._around = in_parts(html)
        whole = "".join(text for pair in zip(self._around, [*self._parts, ""], strict=True) for text in pair)
        if whole == self.html:
            return
        self._patches = self._around == around_before
        try:
            self.html = whole  # what a page gets that opens later
        finally:
            patches, self._patches = self._patches, False
        if patches:
            pairs = enumerate(zip(before, self._parts, strict=True))
            self.send({"parts": {str(number): new for number, (old, new) in pairs if new != old}})

    def _should_send_property(self, key: str, value: object) -> bool:
        if key == "html" and self._patches:
            return False
        return bool(super()._should_send_property(key, value))

    def _message(self, _: object, content: Mapping[str, Any], __: object) -> None:
        if content.get("act") == "whole":  # of a page that lacks what was patched
            self.send({"whole": self.html})
            return
        self._on_message(content)
        # The page then knows that the kernel lives, and of a key that opens a field whether one has come.
        self.send(
            {
                "heard": content.get("act", ""),
                "key": content.get("arg") if content.get("act") == "key" else None,
            }
        )


class WorkbenchBox(ipywidgets.Box):  # type: ignore[misc]  # ipywidgets has no types
    """The regions around the picture; a front end without a kernel shows a message and the picture.

    Parameters
    ----------
    picture
        Returns the PNG of the picture.
    """

    def __init__(self, children: Sequence[ipywidgets.Widget], picture: Callable[[], bytes]) -> None:
        super().__init__(children=tuple(children))
        self.add_class("opnav-workbench")
        self._picture = picture

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return with_still_picture(super()._repr_mimebundle_(**options), self._picture)


# ---- The workbench: regions, picture and controller together.

Images: TypeAlias = "ImageSession | Campaign | ImageQueue | Sequence[ImageSession]"


class Workbench:
    """What `workbench` returns: show it as a cell's value, or with ``display``.

    Attributes
    ----------
    controller : WorkbenchController
        Everything but the page.
    """

    def __init__(self, queue: ImageQueue, out: Path | None = None) -> None:
        status = Status()
        self.view = ImageView(None, status=status)
        self.controller = WorkbenchController(queue, self.view, out, status, ahead=True)
        self.regions = {name: Region(name, self.controller.handle) for name in REGIONS}
        registry = self.controller.registry
        self.regions["header"].page_keys = {key: name for name in ROOM for key in registry[name].keys}
        self.regions["header"].picture_keys = [key for action in self.view.actions for key in action.keys]
        self.regions["header"].picture_alone = registry.keys_alone(PICTURE)
        self.regions["header"].typing_keys = list(registry["note"].keys)
        self.regions["header"].keymap = self.controller.registry.keys
        self.controller.on_render = self._paint
        picture = self.view.widget
        picture.add_class("opnav-picture")
        regions = self.regions
        self.box = WorkbenchBox(
            [regions["header"], regions["queue"], picture, regions["panel"], regions["status"]],
            self.view.picture,
        )
        self.controller.refresh()
        threading.Thread(target=_beat, args=(weakref.ref(self.regions["status"]),), daemon=True).start()

    @property
    def session(self) -> ImageSession:
        """The session of the image at hand."""
        return self.controller.queue.session

    def _paint(self, html: Mapping[str, str]) -> None:
        self.view.bridge.flush()  # what is told in words is seen by then
        for name, shown in html.items():
            self.regions[name].show(shown)  # sent only where it differs

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.box._repr_mimebundle_(**options)


BEAT_S = 2.0


def _beat(status: "weakref.ref[Region]") -> None:
    """Tell the pages that the kernel lives, whatever its main thread is at; ends with the workbench."""
    while (region := status()) is not None:
        with suppress(Exception):  # no page is there, or the kernel is going down: nobody is to be told
            region.send({"beat": True})
        del region
        time.sleep(BEAT_S)


def workbench(images: Images, out: str | Path | None = None) -> Workbench:
    """Open the workbench on one session, several, a list of images, or a campaign.

    Everything done in it is a call of an `ImageSession` method and stands in that session's journal; with a folder,
    each decision is on disk when it is shown.

    Parameters
    ----------
    images : ImageSession, sequence of them, ImageQueue, or Campaign
        A campaign offers the images that need an analyst, or all if none does.
    out
        Folder of the sessions' folders, for sessions that do not save themselves yet.

    Raises
    ------
    SessionError
        There is no image.

    Examples
    --------
    ::

        session = opnav.ImageSession.open("lor_0299.fit", mission="new_horizons")
        workbench(session, out="run")
    """
    return Workbench(queue_of(images, out), None if out is None else Path(out))


def queue_of(images: Images, out: str | Path | None = None) -> ImageQueue:
    """Return the list of images that `workbench` was given.

    Raises
    ------
    SessionError
        There is no image.
    """
    if isinstance(images, ImageQueue):
        return images
    if isinstance(images, ImageSession):
        return ImageQueue.of_sessions([images], out)
    if isinstance(images, (list, tuple)):
        return ImageQueue.of_sessions(images, out)
    # The database takes half a second to load, which those who bring none do not wait for.
    from opnav_workbench.campaign import Campaign  # noqa: PLC0415

    if isinstance(images, Campaign):
        folders = [e.folder for e in (images.attention() or images.entries()) if e.resumable]
        if not folders:
            raise SessionError("no image of this campaign can be resumed: its run folders hold no session.")
        return ImageQueue.of_folders(folders)
    return ImageQueue.of_sessions(images, out)
