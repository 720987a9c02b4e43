"""A night: the same notebook for many pictures, each on its own, nothing done twice and nothing lost.

Flow   pictures -> what is left to do -> notebooks in processes of their own -> moved into place one by one -> archive ->
       summary, queue
Files  OUT/<picture>/ {result.json, observables.ecsv, session.json, notebook.ipynb, notebook.html, summary.png, night.json},
       OUT/{campaign.sqlite, summary.html, summary.json, queue.json}; OUT/.work is the night's own

Killed anywhere, the same command goes on: a picture's folder is whole or not there, and the archive takes whole pictures.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.campaign import Campaign
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import inside, make_folder, sha256_of, write_json
from opnav_workbench.headless.night_pool import Pool
from opnav_workbench.headless.night_record import Record, digest_of_session, fingerprint, read_record, settle
from opnav_workbench.headless.night_spec import NightSpec, pictures_of_night
from opnav_workbench.headless.night_worker import Job, Verdict
from opnav_workbench.headless.outcome import failed_result
from opnav_workbench.headless.picture_job import PictureJob
from opnav_workbench.image.picture_files import picture_names
from opnav_workbench.resources import notebooks_dir
from opnav_workbench.session import RESULT_FILE
from opnav_workbench.session.folder_lock import FolderLock
from opnav_workbench.spice import KernelSet
from opnav_workbench.version import __version__

__all__ = ["Night", "NightPlan", "Picture", "plan_night", "run_night"]

NOTEBOOK = "process_image.ipynb"
WORK_FOLDER = ".work"


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the night.

    Attributes
    ----------
    image : Path
    name : str
        Of its folder.
    fingerprint : str
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
    """What a night has to do.

    Attributes
    ----------
    spec : NightSpec
    out : Path
    pictures : tuple of Picture
    """

    spec: NightSpec
    out: Path
    pictures: tuple[Picture, ...]

    @property
    def todo(self) -> tuple[Picture, ...]:
        """Pictures to process."""
        return tuple(picture for picture in self.pictures if picture.state == "new")

    def job(self, picture: Picture) -> Job:
        """Return the work on one picture."""
        spec = self.spec
        return Job(
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
    plan : NightPlan
    verdicts : list of Verdict
        Of the pictures processed now.
    unarchived : list of str
        Why a picture could not be taken into the archive.
    """

    plan: NightPlan
    verdicts: list[Verdict] = field(default_factory=list)
    unarchived: list[str] = field(default_factory=list)


def plan_night(spec: NightSpec, out: str | Path, *, only_new: bool = False) -> NightPlan:
    """Find out what there is to do, and refuse at once what would fail for every picture.

    Parameters
    ----------
    spec : NightSpec
    out : path
        Folder of the results.
    only_new : bool
        Leave pictures alone that have been processed before, even if with other inputs.

    Raises
    ------
    OpNavError
        A mission, catalog, kernel set, decisions file or notebook is not what it should be; no pictures.
    """
    _check(spec)
    folder = make_folder(out).resolve()
    inputs = _inputs(spec)
    pictures = []
    for image, name in picture_names(pictures_of_night(spec)).items():
        mark = fingerprint(image, inputs)
        pictures.append(Picture(image, name, mark, _state_of(inside(folder, name), mark, only_new)))
    return NightPlan(spec, folder, tuple(pictures))


def _state_of(folder: Path, mark: str, only_new: bool) -> str:
    record = read_record(folder)
    if record is None:
        return "kept" if digest_of_session(folder) else "new"  # a session of its own: an analyst's
    if record.session != digest_of_session(folder):
        return "kept"
    if record.fingerprint == mark:
        return "done"
    return "older" if only_new and record.fingerprint else "new"


def run_night(
    night: Night, pool: Pool, *, archive: Path | None = None, say: Callable[[Verdict], None] = lambda _: None
) -> None:
    """Process what is to be done; every picture that is finished is in its place, and in the archive, at once.

    Parameters
    ----------
    night : Night
        Gains a verdict for every picture that is finished.
    pool : Pool
    archive : path, optional
        Campaign archive; default ``OUT/campaign.sqlite``.
    say : callable
        Told of every picture that is finished.

    Raises
    ------
    SessionError
        Another night writes into the folder, or it cannot be written any more; what is finished is kept.
    """
    plan = night.plan
    with _sole_night(plan.out), Campaign(archive or plan.out / "campaign.sqlite") as campaign:
        for picture in plan.pictures:
            if picture.state != "new":
                _archive(night, campaign, picture.name)
        by_name = {picture.name: picture for picture in plan.todo}
        with closing(pool.run([plan.job(picture) for picture in plan.todo])) as verdicts:
            for verdict in verdicts:
                _finish(plan, by_name[verdict.name], verdict)
                _archive(night, campaign, verdict.name)
                night.verdicts.append(verdict)
                say(verdict)


@contextmanager
def _sole_night(out: Path) -> Iterator[None]:
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


def _finish(plan: NightPlan, picture: Picture, verdict: Verdict) -> None:
    work = Path(verdict.folder) if verdict.folder else make_folder(plan.out / WORK_FOLDER / picture.name)
    if not (work / RESULT_FILE).is_file():
        reason = verdict.reason or "the notebook wrote no result"
        write_json(work / RESULT_FILE, failed_result(picture.image, plan.spec.mission, reason))
    record = Record(
        image=str(picture.image),
        fingerprint="" if verdict.fault == "machine" else picture.fingerprint,
        session=digest_of_session(work),
        fault=verdict.fault,
        reason=verdict.reason,
        seconds=verdict.seconds,
        peak_mb=verdict.peak_mb,
        tries=verdict.tries,
    )
    settle(work, inside(plan.out, picture.name), record, plan.out / WORK_FOLDER / "old")


def _archive(night: Night, campaign: Campaign, name: str) -> None:
    try:
        taken = campaign.ingest_run(night.plan.out / name)
    except OpNavError as error:
        night.unarchived.append(f"{name}: {error}")
        return
    if taken.what == "skipped":
        night.unarchived.append(f"{name}: {taken.reason}")


def _check(spec: NightSpec) -> None:
    _ = PictureJob(**_parameters(spec, Path("picture"))).policy  # mission, catalog, methods, decisions
    with KernelSet(spec.kernels) if spec.kernels else nullcontext():
        pass
    _check_notebook(_notebook(spec))


def _notebook(spec: NightSpec) -> Path:
    return Path(spec.notebook) if spec.notebook else notebooks_dir() / NOTEBOOK


def _check_notebook(path: Path) -> None:
    """Refuse a notebook that would ignore parameters: papermill alone only warns."""
    import papermill  # noqa: PLC0415  takes a second

    try:
        known = set(papermill.inspect_notebook(str(path)))
    except Exception as error:
        raise SessionError(f"the notebook {path} cannot be read ({error}); give a .ipynb file.") from error
    missing = sorted(set(PictureJob.model_fields) - known)
    if missing:
        raise SessionError(
            f"the notebook {path} has no parameter {', '.join(missing)}; its parameters cell needs all of {NOTEBOOK}'s."
        )


def _parameters(spec: NightSpec, image: Path) -> dict[str, Any]:
    """Return the notebook's parameters, but for the folder of the results."""
    return {
        "image": str(image),
        "mission": spec.mission,
        "kernels": spec.kernels or "",
        "catalog": spec.catalog,
        "targets": ",".join(spec.targets or ()),
        "methods": spec.methods,
        "target_stars": spec.target_stars or "",
        "decisions": spec.decisions or "",
        "attitude": spec.attitude,
        "model": spec.model,
        "centers": spec.centers,
        "mode": "headless",
    }


def _inputs(spec: NightSpec) -> dict[str, Any]:
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
        "notebook": sha256_of(_notebook(spec)),
    }
