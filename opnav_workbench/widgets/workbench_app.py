"""The workbench: an analyst steps through images in JupyterLab, with a key for everything."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from opnav_workbench.campaign import Campaign
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.widgets.image_view import ImageView
from opnav_workbench.widgets.queue_images import ImageQueue
from opnav_workbench.widgets.status import Status
from opnav_workbench.widgets.workbench_controller import REGIONS, WorkbenchController
from opnav_workbench.widgets.workbench_shell import Region, WorkbenchBox

__all__ = ["Workbench", "queue_of", "workbench"]

Images = ImageSession | Campaign | ImageQueue | Sequence[ImageSession]


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
        self.controller = WorkbenchController(queue, self.view, out, status)
        self.regions = {name: Region(name, self.controller.handle) for name in REGIONS}
        self.regions["header"].picture_keys = [key for action in self.view.actions for key in action.keys]
        self.regions["header"].keymap = self.controller.registry.keys
        self.controller.painted = self._paint
        picture = self.view.widget
        picture.add_class("opnav-picture")
        regions = self.regions
        self.box = WorkbenchBox(
            [regions["header"], regions["queue"], picture, regions["panel"], regions["status"]],
            self.view.picture,
        )
        self.controller.refresh()

    @property
    def session(self) -> ImageSession:
        """The session of the image at hand."""
        return self.controller.queue.session

    def _paint(self, html: Mapping[str, str]) -> None:
        for name, shown in html.items():
            self.regions[name].html = shown  # sent only where it differs

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.box._repr_mimebundle_(**options)


def workbench(images: Images, out: str | Path | None = None) -> Workbench:
    """Open the workbench on one session, several, a list of images, or a campaign.

    Everything done in it is a call of an `ImageSession` method and stands in that session's journal; with a folder,
    each decision is on disk when it is shown.

    Parameters
    ----------
    images : ImageSession, sequence of them, ImageQueue, or Campaign
        A campaign offers the images that need an analyst, or all if none does.
    out : path, optional
        Folder of the sessions' folders, for sessions that do not save themselves yet.

    Returns
    -------
    Workbench

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
    if isinstance(images, Campaign):
        folders = [e.folder for e in (images.attention() or images.entries()) if e.resumable]
        if not folders:
            raise SessionError("no image of this campaign can be resumed: its run folders hold no session.")
        return ImageQueue.of_folders(folders)
    return ImageQueue.of_sessions(images, out)
