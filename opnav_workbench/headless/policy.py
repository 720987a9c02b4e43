"""The automatic policy for one picture: the same `ImageSession` methods that an analyst's clicks call.

predict - find stars - decisions - repoint, then once more around the solved pointing (which finds the faint stars that
the first, wider search missed), then every target and the observables.  What is done is always saved.
"""

import contextlib
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.catalog import Catalog, open_catalog
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import inside, write_json, write_text
from opnav_workbench.headless.decisions import Decisions
from opnav_workbench.mission import Mission
from opnav_workbench.pointing.models import MODELS
from opnav_workbench.report import write_summary
from opnav_workbench.session import ATTITUDE_SOURCES, RESULT_FILE, ImageSession, Settings
from opnav_workbench.spice import KernelSet

__all__ = ["Outcome", "Policy", "open_picture", "process_image", "solve_stars"]

FIGURE_FILE = "summary.png"
TRACEBACK_FILE = "traceback.txt"


@dataclass(frozen=True, slots=True)
class Policy:
    """How pictures are processed without a person.

    Attributes
    ----------
    mission : Mission
    catalog : str
    targets : sequence of str or None
        None takes the mission's default targets where kernels are loaded, and none without.
    target_stars : Path or None
    attitude : {"auto", "kernels", "header"}
    model : {"euler", "image_plane"}
    initial, final : str
        Star centerfinders.
    decisions : Decisions
    settings : Settings
    """

    mission: Mission
    catalog: str = "bundled"
    targets: Sequence[str] | None = None
    target_stars: Path | None = None
    attitude: str = "auto"
    model: str = "euler"
    initial: str = "matched_filter"
    final: str = "least_squares"
    decisions: Decisions = field(default_factory=Decisions)
    settings: Settings = field(default_factory=Settings)
    opened_catalog: Catalog = field(init=False, repr=False)  # once for all pictures

    def __post_init__(self) -> None:
        """Refuse at once what would fail for every picture."""
        if self.model not in MODELS:
            raise SessionError(f"unknown pointing model {self.model!r}; choose one of {', '.join(MODELS)}.")
        if self.attitude not in ATTITUDE_SOURCES:
            raise SessionError(
                f"unknown attitude source {self.attitude!r}; choose one of {', '.join(ATTITUDE_SOURCES)}."
            )
        object.__setattr__(self, "opened_catalog", open_catalog(self.catalog))


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one picture.

    Attributes
    ----------
    image : Path
    folder : Path
        Where its files are.
    result : mapping
        The content of ``result.json``.
    error : str
        The one line that says why the picture failed; empty otherwise.
    """

    image: Path
    folder: Path
    result: dict[str, Any]
    error: str = ""

    @property
    def failed(self) -> bool:
        """Whether no pointing came out."""
        return bool(self.result["status"] == "failed")


def process_image(
    image: str | Path, policy: Policy, out: str | Path, say: Callable[[str], None] = lambda _: None
) -> Outcome:
    """Process one picture and write its folder ``OUT/<stem>``.

    Parameters
    ----------
    image : path
    policy : Policy
    out : path
        The folder of all pictures' folders.
    say : callable
        Called with a few words before each step, for progress.

    Returns
    -------
    Outcome
        Never raises an `OpNavError`: a picture that fails is an outcome with its one line.
    """
    path = Path(image)
    try:
        folder = _folder(out, path)
    except OpNavError as error:
        return Outcome(path, Path(out), _failed_result(path, policy, str(error)), str(error))
    try:
        say("reading")
        session = open_picture(path, policy)
        _run(session, policy, say)
        say("writing")
        session.save(folder)
        write_summary(session, folder / FIGURE_FILE)
    except OpNavError as error:
        return _failure(path, folder, policy, str(error))
    except Exception as error:  # a defect of ours must not cost the other pictures
        return _defect(path, folder, policy, error)
    result = session.result()
    reason = (
        "; ".join(result["messages"] or ["pointing not determined"]) if result["status"] == "failed" else ""
    )
    return Outcome(path, folder, result, reason)


def _folder(out: str | Path, picture: Path) -> Path:
    """Return the picture's own folder in `out`; a name such as ``...fit`` (stem ``..``) has none."""
    folder = inside(out, picture.stem)
    if folder == Path(out).resolve():
        raise SessionError(f"{picture.name!r} gives no name for a folder in {out}; rename the picture.")
    return folder


def open_picture(image: str | Path, policy: Policy) -> ImageSession:
    """Open a picture as the policy says; raises as `ImageSession.open`."""
    return ImageSession.open(
        image,
        policy.mission,
        catalog=policy.catalog,
        opened_catalog=policy.opened_catalog,
        target_stars=policy.target_stars,
        attitude=policy.attitude,
        settings=policy.settings,
    )


def _run(session: ImageSession, policy: Policy, say: Callable[[str], None]) -> None:
    say("predicting")
    session.predict()
    targets = _add_targets(session, policy)
    say("finding stars")
    solve_stars(session, policy)
    for name in targets:
        say(f"finding {name}")
        session.find_body(name)
    session.observables()


def solve_stars(session: ImageSession, policy: Policy) -> None:
    """Find the predicted stars and solve the pointing, then once more around the solved pointing."""
    session.find_stars(policy.initial, policy.final)
    policy.decisions.apply(session)
    if session.state.centers is not None:
        session.repoint(policy.model)
    if session.state.pointing is not None:
        session.find_stars(policy.initial, policy.final)
        session.repoint(policy.model)


def _add_targets(session: ImageSession, policy: Policy) -> list[str]:
    """Take the targets into the scene; one that nothing is known of costs the picture neither stars nor pointing."""
    known = []
    for name in _targets(policy):
        try:
            session.add_target(name)
            known.append(name)
        except OpNavError as error:
            session.skip_target(name, str(error))
    return known


def _targets(policy: Policy) -> list[str]:
    if policy.targets is not None:
        return list(policy.targets)
    return list(policy.mission.default_targets) if KernelSet.active() is not None else []


def _failed_result(path: Path, policy: Policy, reason: str) -> dict[str, Any]:
    return {"image": path.name, "mission": policy.mission.name, "status": "failed", "messages": [reason]}


def _failure(path: Path, folder: Path, policy: Policy, reason: str) -> Outcome:
    """Record a picture that could not be processed, so that a night's summary can name it."""
    result = _failed_result(path, policy, reason)
    with contextlib.suppress(SessionError):  # the folder cannot be written: the reason tells it already
        write_json(folder / RESULT_FILE, result)
    return Outcome(path, folder, result, reason)


def _defect(path: Path, folder: Path, policy: Policy, error: Exception) -> Outcome:
    """Keep the traceback of an unforeseen error beside the picture's results."""
    with contextlib.suppress(SessionError):
        write_text(folder / TRACEBACK_FILE, "".join(traceback.format_exception(error)))
    reason = f"unforeseen {type(error).__name__}: {' '.join(str(error).split())}"
    return _failure(path, folder, policy, f"{reason}; please report it with {folder / TRACEBACK_FILE}.")
