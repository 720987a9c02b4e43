"""A night: the same notebook for many pictures, each on its own, nothing done twice and nothing lost.

Flow   pictures -> what is left to do -> notebooks in processes of their own -> moved into place one by one -> archive ->
       summary, queue
Files  OUT/<picture>/ {result.json, observables.ecsv, session.json, notebook.ipynb, notebook.html, summary.png, night.json},
       OUT/{campaign.sqlite, summary.html, summary.json, queue.json}; OUT/.work is the night's own

Killed anywhere, the same command goes on: a picture's folder is whole or not there, and the archive takes whole pictures.
``night.json`` says what was done, so that it is done once; it moves into place together with the results, in one rename.
"""

import hashlib
import json
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.campaign import Campaign
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import inside, json_text, make_folder, sha256_of, write_json
from opnav_workbench.headless.night_spec import NightSpec, pictures_of_night
from opnav_workbench.headless.night_workers import NightPool, NotebookOutcome, NotebookRequest
from opnav_workbench.image.picture_files import picture_names
from opnav_workbench.processing import notebook_parameters
from opnav_workbench.processing.pictures import failed_result
from opnav_workbench.resources import notebooks_dir
from opnav_workbench.session import RESULT_FILE
from opnav_workbench.session.folder_lock import FolderLock
from opnav_workbench.session.history import JOURNAL_FILE
from opnav_workbench.session.storage import SESSION_FILE
from opnav_workbench.version import __version__

__all__ = ["Night", "NightPicture", "NightPlan", "fingerprint", "plan_night", "read_record", "run_night"]


# ---- What a night leaves beside a picture's results: what was done, so that it is done once (``night.json``).

RECORD_FILE = "night.json"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class NightRecord:
    """How a picture was processed.

    Attributes
    ----------
    fingerprint
        Of everything that the result depends on; empty where another try may come to another result.
    session
        Digest of the session as the night left it; another one tells of an analyst's work since.
    fault, reason
        As in `night_workers.NotebookOutcome`.
    """

    image: str
    fingerprint: str
    session: str
    fault: str = ""
    reason: str = ""
    seconds: float = 0.0
    peak_mb: float = 0.0
    tries: int = 1


def fingerprint(image: Path, inputs: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a picture and of what it is processed with."""
    text = json_text({"image": sha256_of(image), **inputs})
    return hashlib.sha256(text.encode()).hexdigest()


def session_digest(folder: Path) -> str:
    """Return the SHA-256 of a folder's session and journal; empty where there is none."""
    found = [folder / name for name in (SESSION_FILE, JOURNAL_FILE) if (folder / name).is_file()]
    if not found:
        return ""
    return hashlib.sha256("".join(sha256_of(path) for path in found).encode()).hexdigest()


def read_record(folder: Path) -> NightRecord | None:
    """Return the record of a picture's folder; None where there is none that can be read."""
    try:
        data = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        return NightRecord(**data["record"]) if data["schema"] == SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def move_into_place(work: Path, final: Path, record: NightRecord, attic: Path) -> None:
    """Move a working folder to its place, with its record; what stood there goes.

    Parameters
    ----------
    attic
        Folder on the same file system for what is about to be deleted.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    write_json(work / RECORD_FILE, {"schema": SCHEMA, "record": asdict(record)})
    attic.mkdir(parents=True, exist_ok=True)
    old = attic / f"{final.name}-{uuid.uuid4().hex[:8]}"
    try:
        if final.exists():
            final.rename(old)
        work.rename(final)
    except OSError as error:
        raise SessionError(
            f"cannot move results to {final}: {error.strerror}; what is finished is kept, run the same command again."
        ) from error
    shutil.rmtree(old, ignore_errors=True)


# ---- A night: the same notebook for many pictures, each on its own, nothing done twice and nothing lost.

NOTEBOOK = "process_image.ipynb"
# It belongs to the version: this is the digest that it had when nights were first recorded, so that another word in one of
# its cells does no night over again.
PACKAGED_NOTEBOOK = "6c55442aa9e39dd68f2aed0463bc6772c7fb5b152b95e730ccd53a1e24ec4e6d"
WORK_FOLDER = ".work"


@dataclass(frozen=True, slots=True)
class NightPicture:
    """A picture of the night.

    Attributes
    ----------
    name
        Of its folder.
    state : {"new", "done", "kept", "older"}
        To be processed; done before in the same way; worked on by an analyst since, and left alone; done before in another
        way, and left alone because only new pictures were asked for.
    """

    image: Path
    name: str
    fingerprint: str
    state: str


@dataclass(frozen=True, slots=True)
class NightPlan:
    """What a night has to do."""

    spec: NightSpec
    out: Path
    pictures: tuple[NightPicture, ...]

    @property
    def todo(self) -> tuple[NightPicture, ...]:
        """Pictures to process."""
        return tuple(picture for picture in self.pictures if picture.state == "new")

    def job(self, picture: NightPicture) -> NotebookRequest:
        """Return the work on one picture."""
        spec = self.spec
        return NotebookRequest(
            image=str(picture.image),
            name=picture.name,
            folder=str(self.out / WORK_FOLDER),
            notebook=str(_notebook(spec)),
            parameters=_parameters(spec, picture.image),
            mission=spec.mission,
            time_limit_s=spec.time_limit_s,
            memory_limit_mb=spec.memory_limit_mb,
            retries=spec.retries,
        )


@dataclass(slots=True)
class Night:
    """What came of a night so far.

    Attributes
    ----------
    verdicts
        Of the pictures processed now.
    unarchived
        Why a picture could not be taken into the archive.
    """

    plan: NightPlan
    verdicts: list[NotebookOutcome] = field(default_factory=list)
    unarchived: list[str] = field(default_factory=list)


def plan_night(spec: NightSpec, out: str | Path, *, only_new: bool = False) -> NightPlan:
    """Find out what there is to do, and refuse at once what would fail for every picture.

    Parameters
    ----------
    out
        Folder of the results.
    only_new
        Leave pictures alone that have been processed before, even if with other inputs.

    Raises
    ------
    OpNavError
        A mission, catalog, kernel set, decisions file or notebook is not what it should be; no pictures.
    """
    _check_spec(spec)
    folder = make_folder(out).resolve()
    inputs = _processing_inputs(spec)
    pictures = []
    for image, name in picture_names(pictures_of_night(spec)).items():
        mark = fingerprint(image, inputs)
        pictures.append(NightPicture(image, name, mark, _state_of(inside(folder, name), mark, only_new)))
    return NightPlan(spec, folder, tuple(pictures))


def _state_of(folder: Path, mark: str, only_new: bool) -> str:
    record = read_record(folder)
    if record is None:
        return "kept" if session_digest(folder) else "new"  # a session of its own: an analyst's
    if record.session != session_digest(folder):
        return "kept"
    if record.fingerprint == mark:
        return "done"
    return "older" if only_new and record.fingerprint else "new"


def run_night(
    night: Night,
    pool: NightPool,
    *,
    archive: Path | None = None,
    say: Callable[[NotebookOutcome], None] = lambda _: None,
) -> None:
    """Process what is to be done; every picture that is finished is in its place, and in the archive, at once.

    Parameters
    ----------
    night
        Gains a verdict for every picture that is finished.
    archive
        Campaign archive; default ``OUT/campaign.sqlite``.
    say
        Told of every picture that is finished.

    Raises
    ------
    SessionError
        Another night writes into the folder, or it cannot be written any more; what is finished is kept.
    """
    plan = night.plan
    with _night_lock(plan.out), Campaign(archive or plan.out / "campaign.sqlite") as campaign:
        for picture in plan.pictures:
            if picture.state != "new":
                _archive(night, campaign, picture.name)
        by_name = {picture.name: picture for picture in plan.todo}
        with closing(pool.run([plan.job(picture) for picture in plan.todo])) as verdicts:
            for verdict in verdicts:
                _move_results(plan, by_name[verdict.name], verdict)
                _archive(night, campaign, verdict.name)
                night.verdicts.append(verdict)
                say(verdict)


@contextmanager
def _night_lock(out: Path) -> Iterator[None]:
    work = make_folder(out / WORK_FOLDER)
    try:
        lock = FolderLock(work)
    except SessionError as error:
        raise SessionError(
            f"another night writes into {out}; wait for it, or choose another folder ({error})"
        ) from error
    try:
        for path in work.iterdir():  # what a night that was killed has left
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
        yield
    finally:
        lock.release()
        shutil.rmtree(work, ignore_errors=True)


def _move_results(plan: NightPlan, picture: NightPicture, verdict: NotebookOutcome) -> None:
    work = Path(verdict.folder) if verdict.folder else make_folder(plan.out / WORK_FOLDER / picture.name)
    if not (work / RESULT_FILE).is_file():
        reason = verdict.reason or "the notebook wrote no result"
        write_json(work / RESULT_FILE, failed_result(picture.image, plan.spec.mission, reason))
    record = NightRecord(
        image=str(picture.image),
        fingerprint="" if verdict.fault == "machine" else picture.fingerprint,
        session=session_digest(work),
        fault=verdict.fault,
        reason=verdict.reason,
        seconds=verdict.seconds,
        peak_mb=verdict.peak_mb,
        tries=verdict.tries,
    )
    move_into_place(work, inside(plan.out, picture.name), record, plan.out / WORK_FOLDER / "old")


def _archive(night: Night, campaign: Campaign, name: str) -> None:
    try:
        taken = campaign.ingest_run(night.plan.out / name)
    except OpNavError as error:
        night.unarchived.append(f"{name}: {error}")
        return
    if taken.result == "skipped":
        night.unarchived.append(f"{name}: {taken.reason}")


def _check_spec(spec: NightSpec) -> None:
    spec.changed("night").opened()  # fields that were set unchecked; mission, catalog, decisions
    with spec.kernel_set():
        pass
    _check_notebook(_notebook(spec), _parameters(spec, Path("picture")))


def _notebook(spec: NightSpec) -> Path:
    return Path(spec.notebook) if spec.notebook else notebooks_dir() / NOTEBOOK


def _check_notebook(path: Path, parameters: Mapping[str, Any]) -> None:
    """Refuse a notebook that would ignore parameters: papermill alone only warns."""
    import papermill  # noqa: PLC0415  takes a second

    try:
        known = set(papermill.inspect_notebook(str(path)))
    except Exception as error:
        raise SessionError(f"the notebook {path} cannot be read ({error}); give a .ipynb file.") from error
    missing = sorted({*parameters, "out"} - known)
    if missing:
        raise SessionError(
            f"the notebook {path} has no parameter {', '.join(missing)}; its parameters cell needs all of {NOTEBOOK}'s."
        )


def _parameters(spec: NightSpec, image: Path) -> dict[str, Any]:
    """Return the notebook's parameters, but for the folder of the results."""
    return {"image": str(image), **notebook_parameters(spec), "mode": "headless"}


def _processing_inputs(spec: NightSpec) -> dict[str, Any]:
    """What a result depends on, besides the picture: contents of files, not their places."""
    files = {
        name: sha256_of(value)
        for name in ("kernels", "decisions", "target_stars", "mission")
        if (value := getattr(spec, name)) is not None and Path(value).is_file()
    }
    parameters = {k: v for k, v in _parameters(spec, Path("picture")).items() if k not in {*files, "image"}}
    return {
        "version": __version__,
        "parameters": parameters,
        "files": files,
        "notebook": sha256_of(spec.notebook) if spec.notebook else PACKAGED_NOTEBOOK,
    }
