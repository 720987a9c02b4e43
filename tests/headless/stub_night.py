"""A night whose processes are stood in for, and an analyst at work, so that what lies around them is tested in no time."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.headless.night_workers import NotebookOutcome, NotebookRequest
from opnav_workbench.session.autosave import Autosave, start_autosave
from opnav_workbench.session.history import JournalEntry
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.storage import session_on_disk


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def result_of(job: NotebookRequest, folder: Path, status: str = "ok") -> None:
    """Leave what a picture's notebook leaves: a result, and the session that it was made in."""
    image = Path(job.image)
    known, model = sha256(image), job.parameters["model"]
    result = {
        "image": image.name,
        "mission": "new_horizons",
        "status": status,
        "messages": [],
        "sha256": known,
    }
    result |= {
        "bodies": [],
        "stars": [],
        "pointing": None,
        "made_by": model,
        "provenance": {"version": "stub"},
    }
    (folder / "result.json").write_text(json.dumps(result))
    session = {"schema": 1, "session": folder.name, "sha256": known, "image": job.image}
    session["journal"] = [JournalEntry("predict", {"model": job.parameters["model"]}).to_dict()]
    (folder / "session.json").write_text(json.dumps(session))
    (folder / "journal.jsonl").touch()  # as autosave leaves it once the session is saved


class StubPool:
    """Does every job at once by calling `work(job, folder)`, which may return ``(fault, reason)``."""

    def __init__(self, work: Callable[[NotebookRequest, Path], Any] = result_of) -> None:
        self.work = work
        self.jobs: list[str] = []

    def run(self, jobs: Sequence[NotebookRequest]) -> Iterator[NotebookOutcome]:
        for number, job in enumerate(jobs):
            self.jobs.append(job.name)
            folder = Path(job.folder) / f"{job.name}-{number}-{id(self)}"
            folder.mkdir(parents=True)
            fault, reason = self.work(job, folder) or ("", "")
            yield NotebookOutcome(job.name, str(folder), fault, reason, 1.0, 10.0)


def spec_of(images: Path, **how: Any) -> NightSpec:
    """A night with a catalog of one star, which is read at once."""
    stars = Path(str(images).partition("*")[0]).parent / "one_star.npz"
    if not stars.exists():
        np.savez(stars, ra_deg=[1.0], dec_deg=[2.0], mag=[3.0])
    return NightSpec(
        **{"images": (str(images),), "mission": "new_horizons", "catalog": f"npz:{stars}", **how}
    )


def night(
    images: Path, out: Path, pool: Any = None, how: Any = None, choice: Any = None, **options: Any
) -> Night:
    made = Night(plan_night(spec_of(images, **(how or {})), out, **(choice or {})))
    run_night(made, pool or StubPool(), **options)
    return made


def states(images: Path, out: Path, choice: Any = None, **how: Any) -> dict[str, str]:
    plan = plan_night(spec_of(images, **how), out, **(choice or {}))
    return {picture.name: picture.state for picture in plan.pictures}


class Analyst:
    """Opens a picture's folder as `ImageSession.open_or_resume` does, and decides."""

    def __init__(self, folder: Path) -> None:
        stored = session_on_disk(folder)
        assert stored is not None
        self.journal = stored.journal
        saved = {"session": stored.session, "sha256": stored.sha256}
        self._writer: Autosave = start_autosave(folder, self, saved)  # type: ignore[arg-type]

    @property
    def inputs(self) -> Any:
        nothing = {field.name: None for field in fields(Inputs)}
        return SimpleNamespace(**nothing | {"targets": {}, "shapes": {}})

    def decide(self, reason: str) -> None:
        self.journal = (*self.journal, JournalEntry("reject_stars", {"ids": ["HIP 1"]}, reason))
        self._writer.append_new(self)  # type: ignore[arg-type]

    def leave(self) -> None:
        self._writer.close()


def decisions_below(folder: Path) -> set[str]:
    """Every reason that stands in any session or journal file below a folder."""
    found = set()
    for path in (*folder.rglob("journal.jsonl"), *folder.rglob("session.json")):
        for line in path.read_text().splitlines():
            data = json.loads(line)
            entries = data["journal"] if "journal" in data else [data["entry"]]
            found |= {entry["reason"] for entry in entries}
    return found - {""}
