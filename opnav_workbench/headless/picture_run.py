"""One picture without a person, from its file to its folder of results; whatever goes wrong is told in its outcome.

The steps are the same `ImageSession` methods that an analyst's clicks call: predict - find stars - decisions - repoint,
then once more around the solved pointing (which finds the faint stars that the first, wider search missed), then every
target, the largest first, and the observables.  A session that an analyst has recorded is taken again as it was instead.
A body that stands at the edge of where it was searched, or beyond, is looked for farther out: its ephemeris may be off by
more than anybody announced.  What is done is always saved.
"""

import contextlib
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench import report
from opnav_workbench.bodies import BodyCenter, BodyFlag
from opnav_workbench.bodies.subarray import search_radius
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import inside, sha256_of, write_json, write_text
from opnav_workbench.headless.policy import Policy
from opnav_workbench.kernels import KernelSet
from opnav_workbench.scene import BodyPrediction
from opnav_workbench.session import RESULT_FILE, ImageSession, Settings

__all__ = [
    "Outcome",
    "Progress",
    "failed_result",
    "open_picture",
    "process_image",
    "run_policy",
    "solve_stars",
]


# ---- A second, wider look for a body whose ephemeris is farther off than anybody announced.

# An ephemeris may be off by more than a body's size; a disk this wide is not mistaken for a star or another body.
WIDER_FROM_PX = 3.0
WIDER_SEARCHES = (2.5, 6.0)  # of the usual radius, one after the other
# A point may be mistaken for one: so far out it counts only if it is as clear and as bright as it should be.
POINT_SEARCHES_PX = (10.0, 30.0)
POINT_SNR = 10.0


def search_farther(session: ImageSession, name: str, method: str) -> None:
    """Look farther out for a body that stands at the edge of where it was searched, or beyond: as an analyst would."""
    diameter = float(np.nan_to_num(session.predict_body(name).diameter_px))
    if diameter < WIDER_FROM_PX:
        _search_point_farther(session, name, method)
        return
    for factor in WIDER_SEARCHES:
        center = _last_center(session, name)
        if center.pixel_line is not None and not center.flags & BodyFlag.AT_LIMIT:
            return
        session.find_body(name, method, factor * search_radius(0.5 * diameter, None))


def _search_point_farther(session: ImageSession, name: str, method: str) -> None:
    """Look farther out for a point of known brightness; what does not fit is taken back."""
    missed = _last_center(session, name)
    known = session.inputs.targets[name].magnitude is not None
    if missed.method != "unresolved" or missed.status != "not_detected" or not known:
        return
    for radius_px in POINT_SEARCHES_PX:
        session.find_body(name, method, radius_px)
        found = _last_center(session, name)
        if found.status == "ok" and found.snr >= POINT_SNR:
            return
        session.undo()


def _last_center(session: ImageSession, name: str) -> BodyCenter:
    return next(body for body in reversed(session.state.bodies) if body.name == name)


# ---- The automatic policy for one picture: the same `ImageSession` methods that an analyst's clicks call.

Progress = Callable[[str], None]


def quiet(_words: str) -> None:
    """Say nothing."""


def open_picture(image: str | Path, policy: Policy) -> ImageSession:
    """Open a picture as the policy says, with the settings of its recorded decisions where there are any.

    Raises
    ------
    OpNavError
        As `ImageSession.open`.
    """
    settings = policy.settings
    if policy.decisions.images and Path(image).is_file():
        recorded = policy.decisions.recorded(sha256_of(image))
        if recorded is not None:
            settings = Settings.from_dict(Settings().to_dict() | recorded.settings)
    return ImageSession.open(
        image,
        policy.mission,
        catalog=policy.catalog,
        opened_catalog=policy.opened_catalog,
        target_stars=policy.target_stars,
        attitude=policy.attitude,
        settings=settings,
    )


def run_policy(
    session: ImageSession,
    policy: Policy,
    say: Progress = quiet,
    cancelled: Callable[[], bool] = lambda: False,
) -> bool:
    """Carry out the policy on an open session, as a night's run does; what the analyst decided in it stays decided.

    Parameters
    ----------
    session : ImageSession
    policy : Policy
    say : callable
        Called with a few words before each step, for progress.
    cancelled : callable
        Asked between steps; once it says True, what is done stands and the rest is left.

    Returns
    -------
    bool
        Whether all of it was done.

    Raises
    ------
    OpNavError
        A step cannot be carried out.
    """
    if not session.standing and policy.decisions.recorded(session.context.frame.sha256) is not None:
        say("repeating the analyst's session")
        policy.decisions.apply(session)
        return True
    for words, step in _steps(session, policy):
        if cancelled():
            return False
        say(words)
        step()
    return True


def _steps(session: ImageSession, policy: Policy) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield the policy's steps with their words; later ones depend on what earlier ones found."""
    yield "predicting", session.predict
    targets = _add_targets(session, policy)
    yield "finding stars", lambda: _identify(session, policy)
    yield "solving the pointing", lambda: _repoint_twice(session, policy)
    for name in _largest_first(session, policy, targets):
        yield f"finding {name}", lambda name=name: _find_target(session, policy, name)  # type: ignore[misc]
    yield "computing observables", session.observables


def solve_stars(session: ImageSession, policy: Policy) -> None:
    """Find the predicted stars and solve the pointing, then once more around the solved pointing."""
    _identify(session, policy)
    _repoint_twice(session, policy)


def _identify(session: ImageSession, policy: Policy) -> None:
    policy.decisions.apply_field(session)
    session.find_stars(policy.initial, policy.final)
    policy.decisions.apply(session)


def _repoint_twice(session: ImageSession, policy: Policy) -> None:
    if session.state.centers is not None:
        session.repoint(policy.model)
    if session.state.pointing is not None:
        session.find_stars(policy.initial, policy.final)
        session.repoint(policy.model)


def _add_targets(session: ImageSession, policy: Policy) -> list[str]:
    """Take the targets into the scene; one that nothing is known of costs the picture neither stars nor pointing."""
    known = []
    for name in dict.fromkeys((*_wanted_targets(policy), *policy.decisions.bodies_of(session))):
        try:
            session.add_target(name)
            known.append(name)
        except OpNavError as error:
            session.skip_target(name, str(error))
    return known


def _wanted_targets(policy: Policy) -> list[str]:
    if policy.targets is not None:
        return list(policy.targets)
    return list(policy.mission.default_targets) if KernelSet.active() is not None else []


def _largest_first(session: ImageSession, policy: Policy, targets: Sequence[str]) -> list[str]:
    """Return the targets to look for, the largest first: what it is off by is expected of the others.

    A target that nobody asked for by name is not looked for where it cannot be seen.
    """
    wanted = dict.fromkeys(targets) if policy.targets is not None else {}
    wanted |= dict.fromkeys(policy.decisions.bodies_of(session))
    predicted = {name: session.predict_body(name) for name in targets}
    seen = [name for name in targets if name in wanted or _may_be_on_detector(session, predicted[name])]
    return sorted(seen, key=lambda name: -np.nan_to_num(predicted[name].diameter_px))


def _may_be_on_detector(session: ImageSession, body: BodyPrediction) -> bool:
    """Whether some of a body may be on the detector; before the pointing is solved, that is not known."""
    if session.state.pointing is None:
        return True
    radius = float(np.nan_to_num(0.5 * body.diameter_px))
    return bool(session.context.camera.on_detector(body.pixel_line, radius + search_radius(radius, None)))


def _find_target(session: ImageSession, policy: Policy, name: str) -> None:
    decided = policy.decisions.methods_of(session, name)
    method = policy.methods.get(name, policy.method)
    for options in decided or ({"method": method},):
        session.find_body(name, **options)
    if not decided and session.state.pointing is not None:
        search_farther(session, name, method)


# ---- One picture from its file to its folder of results; whatever goes wrong is told in its outcome.

FIGURE_FILE = "summary.png"
TRACEBACK_FILE = "traceback.txt"


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


def process_image(image: str | Path, policy: Policy, out: str | Path, say: Progress = quiet) -> Outcome:
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
        folder = _picture_folder(out, path)
    except OpNavError as error:
        return Outcome(path, Path(out), failed_result(path, policy.mission.name, str(error)), str(error))
    try:
        say("reading")
        session = open_picture(path, policy)
        run_policy(session, policy, say)
        say("writing")
        session.save(folder)
        report.write_summary(session, folder / FIGURE_FILE)
    except OpNavError as error:
        return _recorded_failure(path, folder, policy, str(error))
    except Exception as error:  # a defect of ours must not cost the other pictures
        return _recorded_defect(path, folder, policy, error)
    result = session.result()
    reason = (
        "; ".join(result["messages"] or ["pointing not determined"]) if result["status"] == "failed" else ""
    )
    return Outcome(path, folder, result, reason)


def _picture_folder(out: str | Path, picture: Path) -> Path:
    """Return the picture's own folder in `out`; a name such as ``...fit`` (stem ``..``) has none."""
    folder = inside(out, picture.stem)
    if folder == Path(out).resolve():
        raise SessionError(f"{picture.name!r} gives no name for a folder in {out}; rename the picture.")
    return folder


def failed_result(image: Path, mission: str, reason: str) -> dict[str, Any]:
    """Return the ``result.json`` of a picture that could not be processed, so that a night's summary can name it."""
    result = {"image": image.name, "mission": mission, "status": "failed", "messages": [reason]}
    with contextlib.suppress(OSError):  # a file that cannot be read has no fingerprint
        result["sha256"] = sha256_of(image)
    return result


def _recorded_failure(path: Path, folder: Path, policy: Policy, reason: str) -> Outcome:
    """Record a picture that could not be processed."""
    result = failed_result(path, policy.mission.name, reason)
    with contextlib.suppress(SessionError):  # the folder cannot be written: the reason tells it already
        write_json(folder / RESULT_FILE, result)
    return Outcome(path, folder, result, reason)


def _recorded_defect(path: Path, folder: Path, policy: Policy, error: Exception) -> Outcome:
    """Keep the traceback of an unforeseen error beside the picture's results."""
    with contextlib.suppress(SessionError):
        write_text(folder / TRACEBACK_FILE, "".join(traceback.format_exception(error)))
    reason = f"unforeseen {type(error).__name__}: {' '.join(str(error).split())}"
    return _recorded_failure(
        path, folder, policy, f"{reason}; please report it with {folder / TRACEBACK_FILE}."
    )
