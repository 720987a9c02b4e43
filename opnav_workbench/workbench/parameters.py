"""The parameters of the notebook ``workbench.ipynb``, checked, and what they mean: kernels and the list of images."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from opnav_workbench.image.picture_files import picture_files
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import OpenedProcessing, Processing, run_policy
from opnav_workbench.processing.automatic import open_or_resume
from opnav_workbench.processing.notebook import checked_parameters
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import EVERY_IMAGE
from opnav_workbench.workbench.image_queue import ImageQueue, predict_scene

__all__ = ["NotebookParameters", "workbench_job"]


class NotebookParameters(Processing):
    """Images, and how they are opened and processed.

    Attributes
    ----------
    ready
        Mission, catalog and decisions, read once.
    """

    mission: str = Field(default=DEMO_MISSION, description="Mission name or mission YAML.")
    images: tuple[str, ...] = Field(
        default=(),
        description="Pictures or folders of them, also comma-separated in one text; empty: two simulated pictures.",
    )
    folders: tuple[str, ...] = Field(
        default=(),
        description="Names of the images' folders in `out`, one each, also comma-separated; empty: named after the "
        "pictures.",
    )
    require: tuple[str, ...] = Field(
        default=("stars_confirmed", "pointing"),
        description="What must be decided before the notebook goes on; see `ImageSession.require`.",
    )
    mode: Literal["interactive", "headless"] = Field(
        default="interactive",
        description="Interactive shows the workbench; headless carries out the decisions, and the automatic policy where "
        "there are none.",
    )
    out: str = Field(default="workbench_run", description="Folder of the images' folders.")

    @field_validator("images", "folders", "require", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return (
            tuple(part.strip() for part in value.split(",") if part.strip())
            if isinstance(value, str)
            else value
        )

    @property
    def interactive(self) -> bool:
        """Whether a person looks on."""
        return self.mode == "interactive"

    @property
    def demo(self) -> bool:
        """Whether the pictures are simulated."""
        return not self.images

    @cached_property
    def ready(self) -> OpenedProcessing:
        """Mission, catalog and decisions; raises as `opened`."""
        return (self.changed(catalog=DEMO_CATALOG) if self.demo else self).opened()

    def kernel_set(self) -> AbstractContextManager[Any]:
        """Return the kernels to work in."""
        return super().kernel_set() if self.kernels or not self.demo else KernelSet(DEMO_KERNELS)

    def queue(self) -> ImageQueue:
        """Return the list of images; each is resumed where it was left.  Within the kernels.

        Where a person looks on, a picture that is opened for the first time is predicted; one that decisions concern is
        processed as they say.

        Raises
        ------
        OpNavError
            A picture is not there, or the mission is unknown.
        """
        images = picture_files(self.images if not self.demo else self._simulated())
        queue = ImageQueue.of_images(images, self.ready.mission, self.out, folders=self.folders)
        for item, image in zip(queue.items, images, strict=True):
            assert item.folder is not None
            item.open = partial(self._opened, image, item.folder)
        return queue

    def _opened(self, image: Path, folder: Path) -> ImageSession:
        """Return a picture's session; where a person looks on, its first steps are taken."""
        session = open_or_resume(image, folder, self.ready)
        if self.interactive and not session.journal:
            frame, decided = session.context.picture, self.ready.decisions.images
            if not {EVERY_IMAGE, frame.name, frame.sha256}.isdisjoint(decided):
                self.process(session)
            else:
                predict_scene(session, self.targets)
        return session

    def process(self, session: ImageSession) -> None:
        """Carry out the decisions, else the automatic policy; a session that was worked on before stays as it is.

        Raises
        ------
        OpNavError
            A step cannot be carried out.
        """
        if not session.standing:
            run_policy(session, self.ready)

    def _simulated(self) -> list[str]:
        """Simulate the demo's pictures, the same bit for bit each time."""
        folder = Path(self.out) / "pictures"
        paths = [folder / f"{request.name}.fit" for request in DEMO_PICTURES]
        mission = load_mission(DEMO_MISSION)
        return [
            str(path if path.is_file() else simulate_picture(request, mission, DEMO_CATALOG, folder).picture)
            for path, request in zip(paths, DEMO_PICTURES, strict=True)
        ]


def workbench_job(namespace: Mapping[str, Any]) -> NotebookParameters:
    """Check a notebook's parameters.

    Parameters
    ----------
    namespace
        The notebook's ``globals()`` after its parameters.

    Raises
    ------
    SessionError
        A parameter is unknown or of the wrong kind; papermill alone would only warn.

    Examples
    --------
    >>> workbench_job({"images": "a.fit, b.fit", "mission": "new_horizons"}).images
    ('a.fit', 'b.fit')
    """
    return checked_parameters(namespace, NotebookParameters)
