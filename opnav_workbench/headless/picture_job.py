"""The parameters of the notebook ``process_image.ipynb``, checked, and what they mean: policy, kernels, session."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from opnav_workbench.errors import SessionError
from opnav_workbench.headless.picture_run import Progress, open_picture, run_policy
from opnav_workbench.headless.policy import Policy
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import Decisions, load_decisions
from opnav_workbench.session.storage import SESSION_FILE
from opnav_workbench.yaml_file import check_model

__all__ = ["PictureJob", "picture_job"]

# What a fresh notebook's namespace holds besides its parameters.
NOTEBOOK_NAMES = frozenset({"In", "Out", "exit", "quit", "open", "get_ipython", "picture_job"})


class PictureJob(BaseModel):
    """One picture and how it is to be processed; empty text means "not given".

    Attributes
    ----------
    image, mission, kernels, catalog, target_stars, decisions, attitude, model, centers : str
        As ``opnav process`` takes them.
    targets : str
        Names, comma-separated; empty: the mission's own.
    method : str
        How bodies are found.
    methods : mapping of str to str
        The same for single bodies, by name.
    mode : {"interactive", "headless"}
        Interactive shows the workbench, headless the same pictures as they are; the processing is the same.
    out : str
        Folder of the picture's results; empty: ``run/<name of the picture>``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())

    image: str
    mission: str
    kernels: str = ""
    catalog: str = "bundled"
    targets: str = ""
    method: str = "auto"
    methods: dict[str, str] = {}
    target_stars: str = ""
    decisions: str = ""
    attitude: str = "auto"
    model: str = "euler"
    centers: str = "least_squares"
    mode: Literal["interactive", "headless"] = "headless"
    out: str = ""

    @property
    def interactive(self) -> bool:
        """Whether a person looks on."""
        return self.mode == "interactive"

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return Path(self.out) if self.out else Path("run") / Path(self.image).stem

    @cached_property
    def policy(self) -> Policy:
        """The policy that the parameters describe.

        Raises
        ------
        OpNavError
            A mission, catalog, method or decisions file is not what it should be.
        """
        names = [name.strip() for name in self.targets.split(",") if name.strip()]
        return Policy(
            mission=load_mission(self.mission),
            catalog=self.catalog,
            targets=names or None,
            method=self.method,
            methods=self.methods,
            target_stars=Path(self.target_stars) if self.target_stars else None,
            attitude=self.attitude,
            model=self.model,
            final=self.centers,
            decisions=load_decisions(self.decisions) if self.decisions else Decisions(),
        )

    def kernel_set(self) -> AbstractContextManager[Any]:
        """Return the kernels to work in; without any, time, attitude and state come from the header."""
        return KernelSet(self.kernels) if self.kernels else nullcontext()

    def open(self) -> ImageSession:
        """Open the picture, or continue the session that its folder holds; every step is saved there.

        Raises
        ------
        OpNavError
            As `ImageSession.open` and `ImageSession.open_or_resume`.
        """
        if (self.folder / SESSION_FILE).is_file():
            return ImageSession.open_or_resume(self.folder, self.image, self.policy.mission)
        session = open_picture(self.image, self.policy)
        session.autosave(self.folder)
        return session

    def process(self, session: ImageSession, say: Progress = print) -> None:
        """Carry out the decisions, else the automatic policy; a session that was worked on before stays as it is.

        Raises
        ------
        OpNavError
            A step cannot be carried out.
        """
        if session.standing:
            say(f"continuing a session of {len(session.standing)} steps")
        else:
            run_policy(session, self.policy, say)


def picture_job(namespace: Mapping[str, Any]) -> PictureJob:
    """Check a notebook's parameters.

    Parameters
    ----------
    namespace : mapping
        The notebook's ``globals()`` after its parameters.

    Raises
    ------
    SessionError
        A parameter is unknown, missing or of the wrong kind; papermill alone would only warn.

    Examples
    --------
    >>> picture_job({"image": "lor_0299.fit", "mission": "new_horizons"}).folder.as_posix()
    'run/lor_0299'
    """
    values = {k: v for k, v in namespace.items() if not k.startswith("_") and k not in NOTEBOOK_NAMES}
    if not values.get("image"):
        raise SessionError(
            "no image given; set the parameter image to a picture's path (papermill: -p image FILE)."
        )
    return check_model(values, PictureJob, "notebook parameters", SessionError)
