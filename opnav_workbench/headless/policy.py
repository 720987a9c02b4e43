"""The automatic policy for one picture: the same `ImageSession` methods that an analyst's clicks call.

predict - find stars - decisions - repoint, then once more around the solved pointing (which finds the faint stars that
the first, wider search missed), then every target and the observables.  What is done is always saved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.errors import OpNavError
from opnav_workbench.files import inside, write_json
from opnav_workbench.headless.decisions import Decisions
from opnav_workbench.mission import Mission
from opnav_workbench.report import write_summary
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.spice import KernelSet

__all__ = ["Outcome", "Policy", "process_image"]

FIGURE_FILE = "summary.png"
RESULT_FILE = "result.json"


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
    folder = inside(out, path.stem)
    try:
        say("reading")
        session = ImageSession.open(
            path,
            policy.mission,
            catalog=policy.catalog,
            target_stars=policy.target_stars,
            attitude=policy.attitude,
            settings=policy.settings,
        )
        _run(session, policy, say)
        say("writing")
        session.save(folder)
        write_summary(session, folder / FIGURE_FILE)
    except OpNavError as error:
        return _failure(path, folder, policy, str(error))
    result = session.result()
    reason = (
        "; ".join(result["messages"] or ["pointing not determined"]) if result["status"] == "failed" else ""
    )
    return Outcome(path, folder, result, reason)


def _run(session: ImageSession, policy: Policy, say: Callable[[str], None]) -> None:
    say("predicting")
    session.predict()
    targets = _targets(policy)
    for name in targets:
        session.add_target(name)
    say("finding stars")
    session.find_stars(policy.initial, policy.final)
    policy.decisions.apply(session)
    if session.state.centers is not None:
        session.repoint(policy.model)
    if session.state.pointing is not None:
        session.find_stars(policy.initial, policy.final)
        session.repoint(policy.model)
    for name in targets:
        say(f"finding {name}")
        session.find_body(name)
    session.observables()


def _targets(policy: Policy) -> list[str]:
    if policy.targets is not None:
        return list(policy.targets)
    return list(policy.mission.default_targets) if KernelSet.active() is not None else []


def _failure(path: Path, folder: Path, policy: Policy, reason: str) -> Outcome:
    """Record a picture that could not be processed, so that a night's summary can name it."""
    result = {"image": path.name, "mission": policy.mission.name, "status": "failed", "messages": [reason]}
    try:
        write_json(folder / RESULT_FILE, result)
    except OpNavError as error:
        reason = f"{reason} ({error})"
    return Outcome(path, folder, result, reason)
