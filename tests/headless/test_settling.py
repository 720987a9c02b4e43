"""A picture's folder changes hands: every interleaving of a night with an analyst, a reader and a kill, one by one.

Before each change of the file system that a night makes when it puts a folder in place, something else happens: an analyst
comes (and goes, or stays), a file is left there, the archive reads the folder, or the night is killed and another one takes
up. Whatever it is and whenever it comes: no decision is lost, no folder is half there, and nobody works where another does.
"""

import gc
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from opnav_workbench.campaign import run_folder
from opnav_workbench.campaign.run_folder import RunRows, read_run
from opnav_workbench.errors import SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.headless.records import NightRecord, is_of_an_analyst, read_record, session_digest
from opnav_workbench.headless.settling import settle, tidy_attic

sys.path.insert(0, str(Path(__file__).parent))
from types import SimpleNamespace

from stub_night import Analyst, decisions_below, result_of

CHANGES = ("rename", "replace", "unlink", "remove", "rmdir", "mkdir")


@pytest.fixture
def tmp_path(tmp_path: Path) -> Iterator[Path]:
    """In memory where that is a place: what is tried is the order of a thousand changes, each with its wait for the disk."""
    memory = Path("/dev/shm")
    if not (memory.is_dir() and os.access(memory, os.W_OK)):
        yield tmp_path
        return
    with TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


class Killed(BaseException):
    """What a killed process would do next is not done, nor anything after it."""


@contextmanager
def before_change(number: int, happens: Callable[[], None]) -> Iterator[list[str]]:
    """Let something happen before the night's change of this number (from 0); yields the changes so far."""
    made: list[str] = []
    state = {"dead": False, "busy": False}

    def watched(name, change):
        def call(*args, **kwargs):
            if state["dead"]:
                raise Killed
            if state["busy"]:  # the others' own changes
                return change(*args, **kwargs)
            made.append(name)
            if len(made) == number + 1:
                state["busy"] = True
                try:
                    happens()
                except Killed:
                    state["dead"] = True
                    raise
                finally:
                    state["busy"] = False
            return change(*args, **kwargs)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in CHANGES:
            patch.setattr(os, name, watched(name, getattr(os, name)))
        yield made


class Place:
    """A folder of results with one picture's, and a night that comes with new ones."""

    def __init__(self, top: Path) -> None:
        self.out, self.image = top / "out", top / "a.fit"
        self.image.parent.mkdir(parents=True, exist_ok=True)
        self.image.write_text("picture")
        self.final = self.out / "a"
        self.decided: set[str] = set()
        self.at_work: list[Analyst] = []
        self.notes: list[str] = []
        self.put("first")

    def put(self, name: str) -> None:
        """What a night does with a picture that it finds free when it plans."""
        tidy_attic(self.out)
        work = self.out / ".work" / f"a-{name}"
        if work.exists() or is_of_an_analyst(read_record(self.final), session_digest(self.final)):
            return
        work.mkdir(parents=True)
        job = SimpleNamespace(image=str(self.image), parameters={"model": name})
        result_of(job, work)  # type: ignore[arg-type]
        record = NightRecord("a", name, session_digest(work), image_sha256=sha256_of(self.image))
        settle(work, self.final, record)

    def come(self, *, stay: bool) -> None:
        with suppress(SessionError, AssertionError):  # refused, or nothing there to open
            analyst = Analyst(self.final)
            self.at_work.append(analyst)
            self.decide("cosmic ray")
            if not stay:
                self.at_work.remove(analyst)
                analyst.leave()

    def decide(self, reason: str) -> None:
        """A decision that is taken stands where the analyst works, at once."""
        for analyst in self.at_work:
            analyst.decide(reason)
            assert reason in decisions_below(self.final)
            self.decided.add(reason)

    def leave_note(self) -> None:
        with suppress(FileNotFoundError):
            (self.final / "notes.txt").write_text("ask the instrument team")
            self.notes.append("ask the instrument team")

    def read(self) -> None:
        with suppress(SessionError):
            assert is_of_one_moment(read_run(self.final))

    def kill(self) -> None:
        raise Killed

    def check(self) -> None:
        assert decisions_below(self.out) >= self.decided
        assert [path.read_text() for path in self.out.rglob("notes.txt")] == self.notes
        made_by = json.loads((self.final / "result.json").read_text())["made_by"]
        assert made_by in ("first", "second", "third")
        record = read_record(self.final)
        assert record is not None
        if not is_of_an_analyst(record, session_digest(self.final)):
            assert record.fingerprint == made_by
            assert all(sha256_of(self.final / name) == known for name, known in record.files.items())


def is_of_one_moment(run: RunRows) -> bool:
    return run.parts["journal"][0]["parameters"] == {"model": run.image["extra"]["made_by"]}


EVENTS = {
    "an analyst comes and goes": [lambda place: place.come(stay=False)],
    "an analyst comes and stays": [lambda place: place.come(stay=True)],
    "a file is left there": [Place.leave_note],
    "the archive reads it": [Place.read],
    "the night is killed": [Place.kill],
    "an analyst stays, and the night is killed": [lambda place: place.come(stay=True), Place.kill],
    "a file is left there, and the night is killed": [Place.leave_note, Place.kill],
}


@pytest.mark.slow
@pytest.mark.parametrize("events", EVENTS.values(), ids=EVENTS)
def test_every_moment_for_something_else_to_happen(tmp_path, events):
    def undisturbed() -> None:
        raise AssertionError("beyond the last change")

    with before_change(999, undisturbed) as changes:
        Place(tmp_path / "alone").put("second")
    assert len(changes) > 10
    for number in range(len(changes)):
        place = Place(tmp_path / str(number))
        happens = partial(_all_of, events, place)
        with suppress(Killed), before_change(number, happens):
            place.put("second")
        gc.collect()  # a killed process gives up its locks
        place.decide("double star")
        place.put("third")
        place.decide("and another")
        place.check()
        for analyst in place.at_work:
            analyst.leave()


def _all_of(events, place):
    for event in events:
        event(place)


def test_a_folder_that_a_killed_night_had_put_away_is_given_back(tmp_path):
    place = Place(tmp_path)
    moved = []

    def after_the_first_rename():
        if not place.final.exists() and not moved:
            moved.append(True)
            raise Killed

    for number in range(40):
        with suppress(Killed), before_change(number, after_the_first_rename):
            place.put(f"second {number}")
        if moved:
            break
    assert not place.final.exists()
    (said,) = tidy_attic(place.out)
    assert said.startswith("a: given back from")
    assert read_record(place.final) is not None
    assert not list((place.out / ".attic").glob("*/*"))


def test_what_is_read_is_of_one_moment(tmp_path, monkeypatch):
    """A night swaps the folder while the archive reads it, between one file and the next."""
    place, read = Place(tmp_path), run_folder._read_mapping
    swaps = iter(("second", "third"))

    def read_then_swap(path):
        found = read(path)
        if path.name == "result.json" and (name := next(swaps, "")):
            place.put(name)
        return found

    monkeypatch.setattr(run_folder, "_read_mapping", read_then_swap)
    run = read_run(place.final)
    assert is_of_one_moment(run)
    assert run.image["extra"]["made_by"] == "third"
