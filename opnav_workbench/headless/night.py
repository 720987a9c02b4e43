"""A night: the same notebook for many pictures, each on its own, nothing done twice and nothing lost.

Flow   pictures -> what is left to do -> notebooks in processes of their own -> moved into place one by one -> archive ->
       pointings carried to pictures without stars -> summary, queue
Files  OUT/<picture>/ {result.json, observables.ecsv, session.json, notebook.ipynb, notebook.html, summary.png, night.json},
       OUT/{campaign.sqlite, summary.html, summary.json, queue.json}; OUT/.work is the night's own, OUT/.attic what it found
       in a place that it needed, or could not put into its own

Killed anywhere, the same command goes on: a picture's folder is whole or not there, and the archive takes whole pictures.
``night.json`` says what was done, so that it is done once; it moves into place together with the results, in one rename.
"""

import math
import shutil
import time
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from opnav_workbench.errors import SessionError, plain_line, some_of
from opnav_workbench.files import fitting_name, inside, make_folder, sha256_of, write_json
from opnav_workbench.headless.faults import FAULTS, is_raised
from opnav_workbench.headless.inputs import (
    NightInputs,
    changes,
    file_stamp,
    fingerprint,
    night_inputs,
    picture_et,
)
from opnav_workbench.headless.night_archive import NightArchive
from opnav_workbench.headless.night_carrying import carry_in_night
from opnav_workbench.headless.night_psf import with_kept_psf
from opnav_workbench.headless.night_spec import NightSpec, pictures_of_night
from opnav_workbench.headless.night_workers import NightPool, NotebookOutcome, NotebookRequest
from opnav_workbench.headless.notebook_run import for_papermill, load_papermill
from opnav_workbench.headless.records import (
    RECORD_FILE,
    NightRecord,
    is_of_an_analyst,
    read_record,
    result_field,
    session_digest,
)
from opnav_workbench.headless.settling import settle, tidy_attic
from opnav_workbench.image.formats.sidecar import find_sidecar
from opnav_workbench.image.picture_files import FolderOwner, picture_names
from opnav_workbench.mission import Mission
from opnav_workbench.paths import is_file, is_text
from opnav_workbench.processing import notebook_parameters
from opnav_workbench.processing.pictures import failed_result
from opnav_workbench.resources import notebooks_dir
from opnav_workbench.session import RESULT_FILE
from opnav_workbench.session.folder_lock import FolderInUse, FolderLock, check_unlocked
from opnav_workbench.session.storage import session_owner

__all__ = ["Night", "NightChoice", "NightPicture", "NightPlan", "check_place", "plan_night", "run_night"]


NOTEBOOK = "process_image.ipynb"
# It belongs to the version: this is the digest that it had when nights were first recorded, so that another word in one of
# its cells does no night over again.
PACKAGED_NOTEBOOK = "6c55442aa9e39dd68f2aed0463bc6772c7fb5b152b95e730ccd53a1e24ec4e6d"
WORK_FOLDER = ".work"
CLOCKS_DIFFER_S = 60.0  # this machine's and a file server's
# Beginnings of the names of a night's own files, which no picture's folder may have.
OWN_NAMES = ("campaign.sqlite", "night.", "queue.json", "status.json", "summary.", "summary-", "trends.png")


# ---- What there is to do.


@dataclass(frozen=True, slots=True)
class NightPicture:
    """A picture of the night.

    Attributes
    ----------
    name
        Of its folder.
    fingerprint
        Of all that its result depends on; empty for a picture that cannot be read.
    state : {"new", "done", "kept", "older", "arriving"}
        To be processed; done before in the same way; an analyst's, and left alone; done before in another way, and left
        alone because only new pictures were asked for; still being written.
    why
        What made it so, in words.
    basis
        A record with what is known of the picture and of what it is processed with.
    """

    image: Path
    name: str
    fingerprint: str
    state: str
    why: tuple[str, ...] = ()
    basis: NightRecord = field(default_factory=lambda: NightRecord("", "", ""))


@dataclass(frozen=True, slots=True)
class NightChoice:
    """Which pictures to process beside those that are new or have other inputs.

    Attributes
    ----------
    only_new
        Leave pictures alone that have been processed before, even if with other inputs.
    force
        Process again what is done; an analyst's sessions are left alone all the same.
    retry_failed
        Process again what failed, whatever its fault.
    quiet_s
        Let files be that were written within this time: they may be half there.
    """

    only_new: bool = False
    force: bool = False
    retry_failed: bool = False
    quiet_s: float = 0.0


@dataclass(frozen=True, slots=True)
class NightPlan:
    """What a night has to do.

    Attributes
    ----------
    mission
        Its name, whatever file it was read from: that may be the night's own, with the PSF that it has learned.
    """

    spec: NightSpec
    out: Path
    pictures: tuple[NightPicture, ...]
    inputs: NightInputs
    mission: str

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
            mission=self.mission,
            time_limit_s=spec.time_limit_s,
            memory_limit_mb=spec.memory_limit_mb,
            retries=spec.retries,
            pages=spec.pages,
            warm=spec.warm,
            contents=fingerprint(self.inputs.common),
        )


def plan_night(
    spec: NightSpec,
    out: str | Path,
    *,
    only_new: bool = False,
    force: bool = False,
    retry_failed: bool = False,
    quiet_s: float = 0.0,
) -> NightPlan:
    """Find out what there is to do, and refuse at once what would fail for every picture.

    Parameters
    ----------
    out
        Folder of the results.
    only_new, force, retry_failed, quiet_s
        As in `NightChoice`.

    Raises
    ------
    OpNavError
        A mission, catalog, kernel set, decisions file or notebook is not what it should be; no pictures; `out` is a
        picture's.
    """
    check_place(out)
    # Fields may have been set unchecked; mission, catalog and decisions are read.
    spec = with_kept_psf(spec.changed("night"), out)
    mission = spec.opened().mission
    folder = make_folder(out).resolve()
    if not is_text(folder):
        raise SessionError(f"the path {folder} has bytes that are no UTF-8; give the night another folder.")
    _check_notebook(_notebook(spec), _parameters(spec, Path("picture")))
    choice = NightChoice(only_new, force, retry_failed, quiet_s)
    with spec.kernel_set():
        notebook = sha256_of(spec.notebook) if spec.notebook else PACKAGED_NOTEBOOK
        inputs = night_inputs(spec, mission, _parameters(spec, Path("picture")), notebook)
        names = picture_names(pictures_of_night(spec), partial(_folder_owner, folder))
        pictures = [
            _planned(image, name, inside(folder, name), spec, mission, inputs, choice)
            for image, name in zip(names, map(_shown_name, names.values()), strict=True)
        ]
    return NightPlan(spec, folder, tuple(pictures), inputs, mission.name)


def _shown_name(name: str) -> str:
    """Return the name of a picture's folder as a log, a page and an archive can show it, not longer than a name may be."""
    return fitting_name(plain_line(name))


def check_place(out: str | Path) -> None:
    """Refuse a folder that is a picture's: of another night, or of ``opnav process``.

    Raises
    ------
    SessionError
        It is one; the folder around it is named.
    """
    folder = Path(out)
    if is_file(folder / RESULT_FILE) or is_file(folder / RECORD_FILE):
        raise SessionError(
            f"{folder} is the folder of a picture; give that of the night, as {folder.absolute().parent}."
        )


def _folder_owner(out: Path, name: str) -> FolderOwner | None:
    """Return whose a folder of a night is; a night's own files, links and whatever is no folder are nobody's picture's."""
    folder = out / _shown_name(name)
    if folder.name.startswith(OWN_NAMES) or folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        return FolderOwner(out)
    record = read_record(folder)
    if record is not None:
        return FolderOwner(Path(record.image), record.image_sha256)
    return session_owner(folder)


def _planned(
    image: Path,
    name: str,
    folder: Path,
    spec: NightSpec,
    mission: Mission,
    inputs: NightInputs,
    choice: NightChoice,
) -> NightPicture:
    record = read_record(folder)
    sidecar = find_sidecar(image)
    basis = _basis(image, None if sidecar else record, mission, spec)
    beside = _beside(sidecar)
    mark = inputs.fingerprint(basis.image_sha256, basis.et, beside) if basis.image_sha256 else ""
    used = {"picture": basis.image_sha256, **beside, **inputs.of(basis.et)}
    basis = replace(basis, fingerprint=mark, inputs=used)
    try:
        session, in_use = session_digest(folder), _in_use(folder)
    except OSError as error:  # of a picture that an analyst may have worked on, for all that anybody can tell
        session, in_use = "", f"its session cannot be read now ({error.strerror})"
    state, why = state_of(record, basis, session, choice, in_use)
    if state == "done" and not _has_result(folder, record):
        state, why = "new", (f"its {RESULT_FILE} is missing or damaged",)
    if state == "new" and choice.quiet_s > 0.0 and (age := _age_s(image)) < choice.quiet_s:
        state, why = "arriving", (f"its file was written {age:.0f} s ago, and may not be whole",)
    return NightPicture(image, name, mark, state, why, basis)


def _has_result(folder: Path, record: NightRecord | None) -> bool:
    """Tell whether a folder has a result that can be read; one that is as the night wrote it need not be taken apart."""
    if record is not None and record.status and (known := record.files.get(RESULT_FILE)):
        with suppress(OSError):
            if sha256_of(folder / RESULT_FILE) == known:
                return True
    return bool(result_field(folder, "status"))


def _beside(path: Path | None) -> dict[str, str]:
    """Return the digest of what lies beside a picture and tells of it: a sidecar, image support data."""
    try:
        return {} if path is None else {f"beside {path.name}": sha256_of(path)}
    except OSError:  # gone again, or unreadable for now: processing will say it
        return {}


def _age_s(image: Path) -> float:
    """Return how long a file has been left alone; one that is gone again has not.

    A time of change in the future tells nothing: the clock was set back, or it came with a copy.
    """
    try:
        status = image.stat()
    except OSError:
        return 0.0
    ages = [time.time() - changed for changed in (status.st_mtime, status.st_ctime)]
    return min((max(age, 0.0) for age in ages if age > -CLOCKS_DIFFER_S), default=math.inf)


def _basis(image: Path, record: NightRecord | None, mission: Mission, spec: NightSpec) -> NightRecord:
    """What is known of a picture; a file that has not been touched since its record was made is not read again."""
    limits = {"time_limit_s": spec.time_limit_s, "memory_limit_mb": spec.memory_limit_mb}
    stamp = file_stamp(image)
    if record is not None and stamp and record.stamp == stamp:
        return NightRecord(
            str(image), "", "", image_sha256=record.image_sha256, stamp=stamp, et=record.et, limits=limits
        )
    try:
        sha256 = sha256_of(image)
    except OSError:  # gone, or unreadable for now: processing will say it
        return NightRecord(str(image), "", "", limits=limits)
    et = picture_et(image, mission)
    return NightRecord(str(image), "", "", image_sha256=sha256, stamp=stamp, et=et, limits=limits)


def _in_use(folder: Path) -> str:
    """Return who has a folder open; empty: nobody."""
    try:
        check_unlocked(folder)
    except SessionError as error:
        return str(error)
    return ""


def state_of(
    record: NightRecord | None, now: NightRecord, session: str, choice: NightChoice, in_use: str = ""
) -> tuple[str, tuple[str, ...]]:
    """Return what is to be done about a picture, and why, in words.

    Parameters
    ----------
    record
        What stands in its folder.
    now
        Fingerprint, inputs and limits of the night that is planned.
    session
        Digest of the session in the folder.
    in_use
        Who has it open.
    """
    if in_use:
        return "kept", (in_use,)
    if record is None and session:
        return "kept", (
            f"it has a session, and no {RECORD_FILE} that can be read tells of a night that made it",
        )
    if record is None:
        return "new", ("not processed yet",)
    if is_of_an_analyst(record, session):
        return "kept", ("an analyst has worked on it",)
    again = FAULTS[record.fault].again_next_night if record.fault in FAULTS else "always"
    if again == "always":
        return "new", (f"the machine failed it: {record.reason}",)
    if not record.fingerprint:
        said = tuple(f"{name} was written to or taken away while it was processed" for name in record.touched)
        return "new", said or changes(record.inputs, now.inputs)
    if again == "raised" and is_raised(record.limits, now.limits):
        return "new", (f"a limit is higher now than when it failed: {record.reason}",)
    if choice.retry_failed and (record.fault or record.status == "failed"):
        return "new", (f"failed before: {record.reason or 'no pointing'}",)
    if record.fingerprint == now.fingerprint:
        return ("new", ("asked for by force",)) if choice.force else ("done", ())
    return ("older" if choice.only_new else "new"), changes(record.inputs, now.inputs)


# ---- What is done.


@dataclass(slots=True)
class Night:
    """What came of a night so far.

    Attributes
    ----------
    verdicts
        Of the pictures processed now.
    unarchived
        Why a picture could not be taken into the archive.
    unplaced
        Pictures whose place is an analyst's, each with why, and where the night's own result is.
    outlived
        Pictures that the machine failed and whose older results stand, each with why.
    touched
        Files that were written to while pictures were processed with them, and how many: those are not done.
    notes
        What else somebody must know.
    begun
        Whether the folder was this night's: no other one ran there.
    archive
        The file that its pictures went into.
    """

    plan: NightPlan
    verdicts: list[NotebookOutcome] = field(default_factory=list)
    unarchived: list[str] = field(default_factory=list)
    unplaced: dict[str, str] = field(default_factory=dict)
    outlived: dict[str, str] = field(default_factory=dict)
    touched: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    begun: bool = False
    archive: Path | None = None


def run_night(
    night: Night,
    pool: NightPool,
    *,
    archive: Path | None = None,
    say: Callable[[NotebookOutcome], None] = lambda _: None,
    begun: Callable[[], None] = lambda: None,
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
    begun
        Called once the folder is this night's.

    Raises
    ------
    SessionError
        Another night writes into the folder, or it cannot be written any more; what is finished is kept.
    """
    plan = night.plan
    with _NightLock(plan.out) as lock, NightArchive(plan.out, archive, night.notes.append) as taken:
        night.begun, night.archive = True, taken.path
        begun()
        night.notes.extend(tidy_attic(plan.out))
        for picture in plan.pictures:
            if picture.state not in ("new", "arriving"):
                _archive(night, taken, picture.name)
        by_name = {picture.name: picture for picture in plan.todo}
        with closing(_verdicts(plan, pool)) as verdicts:
            for verdict in verdicts:
                lock.hold()
                verdict = _put_results(night, by_name[verdict.name], verdict)  # noqa: PLW2901
                if FAULTS[verdict.fault].is_result and verdict.name not in night.unplaced:
                    _archive(night, taken, verdict.name)
                night.verdicts.append(verdict)
                say(verdict)
        _carry(night, taken)
        night.unarchived.extend(f"{folder.name}: {reason}" for folder, reason in taken.take_late())


def _carry(night: Night, archive: NightArchive) -> None:
    """Let pictures without stars take their neighbors' pointing, where that is asked for."""
    plan = night.plan
    names = [picture.name for picture in plan.pictures if picture.name not in night.unplaced]
    folders = [inside(plan.out, name) for name in names]
    for carried in carry_in_night(plan.spec, folders, plan.out / WORK_FOLDER):
        if carried.placed:
            _archive(night, archive, carried.name)
        if carried.note:
            night.notes.append(f"{carried.name}: {carried.note}")


def _verdicts(plan: NightPlan, pool: NightPool) -> Generator[NotebookOutcome, None, None]:
    """Yield what becomes of the pictures; one that no notebook can be told of costs no process."""
    for picture in plan.todo:
        if not is_text(picture.image):
            reason = f"the path {plain_line(str(picture.image))} has bytes that are no UTF-8; rename it"
            yield NotebookOutcome(picture.name, "", "picture", reason, 0.0, 0.0)
    with closing(pool.run([plan.job(p) for p in plan.todo if is_text(p.image)])) as verdicts:
        yield from verdicts


class _NightLock:
    """The right to be the night of a folder, as long as the block."""

    def __init__(self, out: Path) -> None:
        self._out, self._work = out, out / WORK_FOLDER
        self._lock = self._taken()

    def _taken(self) -> FolderLock:
        if self._work.is_symlink():  # what stands there is emptied: not where a link leads
            raise SessionError(f"{self._work} is a link; remove it, a night makes its own folder there.")
        try:
            return FolderLock(make_folder(self._work))
        except FolderInUse as error:
            raise SessionError(
                f"another night writes into {self._out} ({error.holder}); wait for it, or choose another folder."
            ) from error

    def hold(self) -> None:
        """Take the right anew where somebody has deleted the working folder; refuse where another night has it now."""
        if not self._lock.stands:
            self._lock = self._taken()

    def __enter__(self) -> Self:
        self._empty()  # what a night that was killed has left
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._lock.stands:  # deleted, and perhaps another night's by now
            return
        self._empty()  # while it is ours: the next night may begin as soon as it is not
        self._lock.release()
        with suppress(OSError):  # not empty: the next night has begun
            self._work.rmdir()

    def _empty(self) -> None:
        for path in self._work.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)


def _put_results(night: Night, picture: NightPicture, verdict: NotebookOutcome) -> NotebookOutcome:
    """Put what a picture's process left into its place; return the verdict, another one if that is gone.

    A fault of the machine tells nothing of the picture: an older result stays, and none is made up. The same holds for any
    fault while a file was written to or taken away: a disk of kernels that is gone fails every picture.
    """
    plan = night.plan
    # Not there where no process was begun, or somebody has deleted it.
    work = make_folder(verdict.folder or plan.out / WORK_FOLDER / picture.name)
    final = inside(plan.out, picture.name)
    if not (verdict.fault or (work / RESULT_FILE).is_file()):
        verdict = replace(
            verdict, fault="machine", reason="its result was taken away from the night's folder"
        )
    touched = (*_touched(picture, work), *plan.inputs.touched())
    if touched and verdict.fault and FAULTS[verdict.fault].is_result:
        because = f"{some_of(touched)} written to or taken away meanwhile"
        verdict = replace(verdict, fault="machine", reason=f"{verdict.reason.rstrip('.')} ({because})")
    night.touched.update(touched)
    if not FAULTS[verdict.fault].is_result:
        (work / RESULT_FILE).unlink(missing_ok=True)
        if (final / RESULT_FILE).is_file():
            night.outlived[picture.name] = f"the machine failed it, its older result stands: {verdict.reason}"
            return verdict
    elif not (work / RESULT_FILE).is_file():
        write_json(work / RESULT_FILE, failed_result(picture.image, plan.mission, verdict.reason))
    record = _record(picture, verdict, work, touched)
    settled = settle(work, final, record)
    if not settled.placed:
        night.unplaced[picture.name] = settled.note
    elif settled.note:
        night.notes.append(f"{picture.name}: {settled.note}")
    return verdict


def _record(
    picture: NightPicture, verdict: NotebookOutcome, work: Path, touched: tuple[str, ...]
) -> NightRecord:
    return replace(
        picture.basis,
        fingerprint="" if touched else picture.fingerprint,
        session=session_digest(work),
        fault=verdict.fault,
        reason=verdict.reason,
        seconds=verdict.seconds,
        peak_mb=verdict.peak_mb,
        tries=verdict.tries,
        status=result_field(work, "status"),
        touched=touched,
    )


def _touched(picture: NightPicture, work: Path) -> tuple[str, ...]:
    """Return the picture's name if its file, or what was processed, is not what the night was planned with."""
    known = picture.basis
    same = file_stamp(picture.image) == known.stamp
    same &= result_field(work, "sha256") in ("", known.image_sha256)
    return () if same else (picture.image.name,)


def _archive(night: Night, archive: NightArchive, name: str) -> None:
    reason = archive.take(night.plan.out / name)
    if reason:
        night.unarchived.append(f"{name}: {reason}")


def _notebook(spec: NightSpec) -> Path:
    return Path(spec.notebook) if spec.notebook else notebooks_dir() / NOTEBOOK


def _check_notebook(path: Path, parameters: Mapping[str, Any]) -> None:
    """Refuse a notebook that would ignore parameters: papermill alone only warns."""
    papermill = load_papermill()
    try:
        known = set(papermill.inspect_notebook(for_papermill(str(path))))
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
