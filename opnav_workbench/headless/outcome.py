"""One picture from its file to its folder of results; whatever goes wrong is told in its outcome."""

import contextlib
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import inside, sha256_of, write_json, write_text
from opnav_workbench.headless.policy import Policy, Say, open_picture, quiet, run_policy
from opnav_workbench.report import write_summary
from opnav_workbench.session import RESULT_FILE

__all__ = ["Outcome", "failed_result", "process_image"]

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


def process_image(image: str | Path, policy: Policy, out: str | Path, say: Say = quiet) -> Outcome:
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
        return Outcome(path, Path(out), failed_result(path, policy.mission.name, str(error)), str(error))
    try:
        say("reading")
        session = open_picture(path, policy)
        run_policy(session, policy, say)
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


def failed_result(image: Path, mission: str, reason: str) -> dict[str, Any]:
    """Return the ``result.json`` of a picture that could not be processed, so that a night's summary can name it."""
    result = {"image": image.name, "mission": mission, "status": "failed", "messages": [reason]}
    with contextlib.suppress(OSError):  # a file that cannot be read has no fingerprint
        result["sha256"] = sha256_of(image)
    return result


def _failure(path: Path, folder: Path, policy: Policy, reason: str) -> Outcome:
    """Record a picture that could not be processed."""
    result = failed_result(path, policy.mission.name, reason)
    with contextlib.suppress(SessionError):  # the folder cannot be written: the reason tells it already
        write_json(folder / RESULT_FILE, result)
    return Outcome(path, folder, result, reason)


def _defect(path: Path, folder: Path, policy: Policy, error: Exception) -> Outcome:
    """Keep the traceback of an unforeseen error beside the picture's results."""
    with contextlib.suppress(SessionError):
        write_text(folder / TRACEBACK_FILE, "".join(traceback.format_exception(error)))
    reason = f"unforeseen {type(error).__name__}: {' '.join(str(error).split())}"
    return _failure(path, folder, policy, f"{reason}; please report it with {folder / TRACEBACK_FILE}.")
