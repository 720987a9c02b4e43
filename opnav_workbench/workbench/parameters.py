"""The parameters of the notebook ``workbench.ipynb``, checked, and what they mean: kernels and the list of images."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from opnav_workbench.errors import SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.yaml_file import check_model

__all__ = []

# What a fresh notebook's namespace holds besides its parameters.
NOTEBOOK_NAMES = frozenset({"In", "Out", "exit", "quit", "open", "get_ipython", "workbench_job"})


class NotebookParameters(BaseModel):
    """Images and how they are opened.

    Attributes
    ----------
    images : tuple of str
        Pictures or folders of them, also comma-separated in one text; empty: two simulated pictures.
    folders : tuple of str
        Names of the images' folders in `out`, one each, also comma-separated; empty: named after the pictures.
    mission, kernels, catalog : str
        As ``opnav process`` takes them; without kernels, time, attitude and state come from the header.
    targets : tuple of str
        Names, also comma-separated in one text; empty: the mission's own.
    decisions : str
        YAML of an analyst's decisions, for a headless run.
    require : tuple of str
        What must be decided before the notebook goes on; see `ImageSession.require`.
    mode : {"interactive", "headless"}
        Interactive shows the workbench; headless applies `decisions`, and the automatic policy where there are none.
    out : str
        Folder of the images' folders.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    images: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    mission: str = DEMO_MISSION
    kernels: str | None = None
    catalog: str = "bundled"
    targets: tuple[str, ...] = ()
    decisions: str = ""
    require: tuple[str, ...] = ("stars_confirmed", "pointing")
    mode: Literal["interactive", "headless"] = "interactive"
    out: str = "workbench_run"

    @field_validator("images", "folders", "targets", "require", mode="before")
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

    def kernel_set(self) -> AbstractContextManager[Any]:
        """Return the kernels to work in."""
        kernels = self.kernels or (DEMO_KERNELS if self.demo else None)
        return KernelSet(kernels) if kernels else nullcontext()

    def queue(self) -> ImageQueue:
        """Return the list of images; each is resumed where it was left.  Within the kernels.

        Raises
        ------
        OpNavError
            A picture is not there, or the mission is unknown.
        """
        images = self.images if not self.demo else tuple(self._simulated())
        return ImageQueue.of_images(
            images,
            load_mission(self.mission),
            self.out,
            folders=self.folders,
            targets=self.targets or None,
            predict=self.interactive,
            catalog=DEMO_CATALOG if self.demo else self.catalog,
        )

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
    namespace : mapping
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
    values = {k: v for k, v in namespace.items() if not k.startswith("_") and k not in NOTEBOOK_NAMES}
    return check_model(values, NotebookParameters, "notebook parameters", SessionError)
