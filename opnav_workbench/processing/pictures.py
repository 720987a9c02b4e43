"""Pictures from their files to their folders of results, one after the other; enter by `process`.

Whatever goes wrong with a picture is told in its `Outcome` and costs the others nothing; what is done is always saved.
"""

import contextlib
import inspect
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from opnav_workbench import report
from opnav_workbench.errors import OpNavError, SessionError, plain_line
from opnav_workbench.files import inside, make_folder, sha256_of, write_json, write_text
from opnav_workbench.format_versions import stamped
from opnav_workbench.paths import is_file
from opnav_workbench.processing.automatic import Progress, open_picture, run_policy, silent
from opnav_workbench.processing.carrying import FIGURE_FILE, carry_between, may_take_pointing
from opnav_workbench.processing.model import OpenedProcessing, Processing
from opnav_workbench.session import RESULT_FILE

__all__ = ["Outcome", "failed_result", "process", "process_image", "process_images"]

TRACEBACK_FILE = "traceback.txt"
LONGEST_REASON = 300  # characters of an unforeseen error: the rest stands in its traceback


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one picture.

    Attributes
    ----------
    folder
        Where its files are; None where nothing was to be written.
    result
        The content of ``result.json``.
    error
        The one line that says why the picture failed; empty otherwise.
    note
        What else somebody must know; empty as a rule.
    """

    image: Path
    folder: Path | None
    result: dict[str, Any]
    error: str = ""
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether no pointing came out."""
        return bool(self.result["status"] == "failed")


# ---- Many pictures.


def process(
    images: str | Path | Sequence[str | Path],
    *,
    out: str | Path | None = None,
    say: Callable[[str, str], None] = lambda _name, _words: None,
    done: Callable[[Outcome], None] = lambda _outcome: None,
    figure: bool = True,
    **how: Any,
) -> tuple[Outcome, ...]:
    """Solve pointing and target centers of pictures, as the command ``opnav process`` does.

    Parameters
    ----------
    images
        Pictures of any format of `opnav_workbench.image.formats`.
    mission : str or path
        Mission name or mission YAML; must be given.
    kernels : str or path, optional
        Metakernel, kernel folder or kernel-set name.  Without any, an open `KernelSet` serves; where none is open, time,
        attitude and state come from the header.
    catalog : str
        Catalog spec; default ``bundled``.
    targets : str or sequence of str, optional
        Names, each with its method if wanted (``"PLUTO:limb_scan,CHARON"``); empty or ``"none"``: no targets; default the
        mission's own, where kernels are open.
    method : {"auto", "disk", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"}
        How the centers of targets are found.
    methods : mapping of str to str, optional
        The same for single targets, by name.
    target_stars : path, optional
        YAML star list; without `targets`, its stars are targets.
    shapes : str or mapping of str to str, optional
        Shape models by body (``"BENNU:bennu.obj:m"``), in km unless told; they outrank those of kernels and mission.
    landmarks : str or mapping of str to str, optional
        Files of maplets by body (``"BENNU:bennu.npz"``) whose landmarks are looked for; besides, those of the mission.
    decisions : path, optional
        YAML of an analyst's decisions on stars, bodies and scans.
    attitude : {"auto", "kernels", "header", "none"}
        Where the a priori attitude comes from.
    initial : {"matched_filter", "cross_correlation"}
        Coarse star centers.
    centers : {"least_squares", "psf_fit", "matched_filter", "cross_correlation"}
        Star centers.
    model : {"euler", "image_plane"}
        Pointing model.
    settings : mapping of str to float, optional
        Limits of searches and other thresholds that differ from the usual ones; see `Settings`.
    out
        Folder for the results: each picture has ``OUT/<picture>/`` with ``result.json``, ``observables.ecsv``,
        ``session.json`` and ``summary.png``.  None: nothing is written.
    say
        Called with a picture's name and a few words before each step.
    done
        Called with each outcome as soon as it stands.
    figure
        Whether ``summary.png`` is drawn: half of a first picture's time.  `opnav_workbench.report.write_summary` draws it
        of a resumed session at any time.

    Returns
    -------
    tuple of Outcome
        One a picture, in their order; ``result`` is the content of ``result.json``.  A picture that fails is an outcome
        with its one line in ``error``.

    Raises
    ------
    OpNavError
        What would fail for every picture: an option that is not allowed, an unknown mission, kernels or a catalog that
        cannot be opened, `out` that cannot be written, two pictures of one name.

    Examples
    --------
    >>> import tempfile
    >>> import opnav_workbench as opnav
    >>> from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_PICTURES, simulate_picture
    >>> mission = opnav.load_mission("new_horizons")
    >>> with opnav.KernelSet(DEMO_KERNELS), tempfile.TemporaryDirectory() as folder:
    ...     truth = simulate_picture(DEMO_PICTURES[0], mission, "bundled", folder)
    ...     (outcome,) = opnav.process(truth.picture, mission="new_horizons", targets="PLUTO,CHARON")
    >>> outcome.result["status"], [body["status"] for body in outcome.result["bodies"]]
    ('ok', ['ok', 'ok'])
    """
    paths = [Path(image) for image in ([images] if isinstance(images, str | Path) else images)]
    return process_images(paths, Processing.checked(how), out, say, done, figure=figure)


def _with_fields(signature: inspect.Signature) -> inspect.Signature:
    """Return a signature with the fields of `Processing` in place of ``**how``, for ``help`` and notebooks."""
    fields = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.is_required() else field.default,
            annotation=field.annotation,
        )
        for name, field in Processing.model_fields.items()
    ]
    images, *rest = (p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD)
    return signature.replace(parameters=[images, *fields, *rest])


process.__signature__ = _with_fields(inspect.signature(process))  # type: ignore[attr-defined]


def process_images(
    images: Sequence[Path],
    how: Processing,
    out: str | Path | None,
    say: Callable[[str, str], None] = lambda _name, _words: None,
    done: Callable[[Outcome], None] = lambda _outcome: None,
    *,
    figure: bool = True,
) -> tuple[Outcome, ...]:
    """Process pictures one after the other; parameters, outcomes and errors as of `process`."""
    opened = how.opened()
    with how.kernel_set():
        if out is not None:
            _check_names(images)
            make_folder(out)
        outcomes, waiting = [], []
        for image in images:
            outcome = process_image(image, opened, out, partial(say, image.name), figure=figure)
            outcomes.append(outcome)
            if may_take_pointing(outcome.result, opened.settings):
                waiting.append(image)  # told when its neighbors are done too
            else:
                done(outcome)
        carried = with_carried(outcomes, opened, say)
        for outcome in carried:
            if outcome.image in waiting:
                done(outcome)
    return carried


def with_carried(
    outcomes: Sequence[Outcome],
    opened: OpenedProcessing,
    say: Callable[[str, str], None] = lambda _name, _words: None,
) -> tuple[Outcome, ...]:
    """Return the outcomes after pictures without stars have taken their neighbors' pointing, where that is asked for."""
    folders = [outcome.folder for outcome in outcomes if outcome.folder is not None]
    made = carry_between(folders, opened, say)
    return tuple(
        outcome if outcome.folder not in made else _carried_outcome(outcome, made[outcome.folder])
        for outcome in outcomes
    )


def _carried_outcome(outcome: Outcome, result: dict[str, Any]) -> Outcome:
    words = "its pointing is carried from other pictures: see its messages"
    return replace(outcome, result=result, error="", note="; ".join(filter(None, (outcome.note, words))))


def _check_names(images: Sequence[Path]) -> None:
    twice = [name for name, count in Counter(image.stem for image in images).items() if count > 1]
    if twice:
        raise SessionError(
            f"more than one picture is named {', '.join(twice)}; process them in calls of their own, each with its --out."
        )


# ---- One picture.


def process_image(
    image: str | Path,
    opened: OpenedProcessing,
    out: str | Path | None,
    say: Progress = silent,
    *,
    figure: bool = True,
) -> Outcome:
    """Process one picture and write its folder ``OUT/<stem>``.

    Parameters
    ----------
    out
        The folder of all pictures' folders; None: nothing is written.
    say : callable
        Called with a few words before each step, for progress.
    figure
        Whether ``summary.png`` is drawn; without, an older one is taken away, as it shows an older result.

    Returns
    -------
    Outcome
        Never raises an `OpNavError`: a picture that fails is an outcome with its one line.
    """
    path = Path(image)
    try:
        folder = None if out is None else _picture_folder(out, path)
    except OpNavError as error:
        reason = str(error)
        return Outcome(path, Path(str(out)), failed_result(path, opened.mission.name, reason), reason)
    try:
        say("reading")
        session = open_picture(path, opened)
        run_policy(session, opened, say)
        if folder is not None:
            say("writing")
            session.save(folder)
            if figure:
                report.write_summary(session, folder / FIGURE_FILE)
            else:
                (folder / FIGURE_FILE).unlink(missing_ok=True)
    except OpNavError as error:
        return _recorded_failure(path, folder, opened, str(error))
    except OSError as error:  # of the machine: a disk that is full, a folder that is gone
        reason = f"{error.strerror or error}; see to that, and process it again."
        return _recorded_failure(path, folder, opened, f"{plain_line(path.name)}: {reason}")
    except Exception as error:  # a defect of ours must not cost the other pictures
        return _recorded_defect(path, folder, opened, error)
    result = session.result()
    reason = (
        "; ".join(result["messages"] or ["pointing not determined"]) if result["status"] == "failed" else ""
    )
    found = f"an analyst's session stood there; it is kept in {session.put_away}" if session.put_away else ""
    return Outcome(path, folder, result, reason, found)


def _picture_folder(out: str | Path, picture: Path) -> Path:
    """Return the picture's own folder in `out`; a name such as ``...fit`` (stem ``..``) has none."""
    folder = inside(out, picture.stem)
    if folder == Path(out).resolve():
        raise SessionError(f"{picture.name!r} gives no name for a folder in {out}; rename the picture.")
    return folder


def failed_result(image: Path, mission: str, reason: str) -> dict[str, Any]:
    """Return the ``result.json`` of a picture that could not be processed, so that a night's summary can name it."""
    result = {"image": plain_line(image.name), "mission": mission, "status": "failed", "messages": [reason]}
    with contextlib.suppress(OSError):  # a file that cannot be read has no fingerprint
        if is_file(image):  # a pipe would block, a device never end
            result["sha256"] = sha256_of(image)
    return stamped("result", result)


def _recorded_failure(path: Path, folder: Path | None, opened: OpenedProcessing, reason: str) -> Outcome:
    """Record a picture that could not be processed."""
    result = failed_result(path, opened.mission.name, reason)
    if folder is not None:
        with contextlib.suppress(SessionError):  # the folder cannot be written: the reason tells it already
            write_json(folder / RESULT_FILE, result)
    return Outcome(path, folder, result, reason)


def _recorded_defect(path: Path, folder: Path | None, opened: OpenedProcessing, error: Exception) -> Outcome:
    """Keep the traceback of an unforeseen error beside the picture's results."""
    remedy = "give a folder for the results, and report it with the traceback that is kept there."
    if folder is not None:
        remedy = f"please report it with {folder / TRACEBACK_FILE}."
        with contextlib.suppress(SessionError):
            write_text(folder / TRACEBACK_FILE, "".join(traceback.format_exception(error)))
    reason = plain_line(f"unforeseen {type(error).__name__}: {' '.join(str(error).split())}", LONGEST_REASON)
    return _recorded_failure(path, folder, opened, f"{reason}; {remedy}")
