"""Autosave: on disk when the method returns, whole after a crash, one writer at a time, and clear words on a full disk."""

import errno
import gc
import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text
from opnav_workbench.session import ImageSession
from opnav_workbench.session.autosave import STATE_FILE, read_state
from opnav_workbench.session.folder_lock import FolderLock, check_unlocked
from opnav_workbench.session.history import JOURNAL_FILE

WORKER = """
import sys
from opnav_workbench.session import ImageSession
session = ImageSession.{how}
session.autosave(sys.argv[2])
print(len(session.journal), flush=True)
session.predict(); print(len(session.journal), flush=True)
session.find_stars(); print(len(session.journal), flush=True)
star = str(session.state.a_priori.id[0])
for number in range(100000):
    for act in (lambda: session.note(f"note {{number}}"), lambda: session.accept_stars([star]), session.undo):
        act()
        print(len(session.journal), flush=True)
"""
OPEN = 'open(sys.argv[1], "new_horizons")'


def _result(session: ImageSession) -> str:
    result = session.result()
    del result["provenance"]["kernels"]
    return json_text(result)


def _worker(picture: Path, folder: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", WORKER.format(how=OPEN), str(picture), str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def saved(opened, tmp_path) -> ImageSession:
    opened.autosave(tmp_path / "run")
    opened.predict()
    opened.find_stars()
    return opened


# -- every step is on disk -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_step_can_be_resumed_as_soon_as_it_returns(opened, tmp_path):
    folder = tmp_path / "run"
    opened.autosave(folder)
    assert opened.folder == folder.resolve()
    star = str(opened.predict().id[0])
    for act in (
        opened.find_stars,
        lambda: opened.reject_stars([star], "odd"),
        opened.repoint,
        lambda: opened.find_body("PLUTO"),  # its ephemeris comes with the step
        opened.undo,
        opened.redo,
        opened.observables,
        lambda: opened.note("looked at it"),
    ):
        act()
        resumed = ImageSession.resume(folder)
        assert resumed.journal == opened.journal
        assert _result(resumed) == _result(opened)
        assert resumed.id == opened.id


@pytest.mark.slow
def test_stars_of_a_wide_search_are_kept_with_their_step(opened, tmp_path):
    opened.autosave(tmp_path)
    opened.predict()
    opened.nudge(3.0, 0.0)
    assert opened.inputs.wide_stars is None
    opened.nudge(300.0, 0.0)  # farther than the stars at hand reach
    assert opened.inputs.wide_stars is not None
    resumed = ImageSession.resume(tmp_path)
    assert resumed.inputs.wide_stars.id.tolist() == opened.inputs.wide_stars.id.tolist()
    assert resumed.state.star_field.shift_px.tolist() == opened.state.star_field.shift_px.tolist()


def test_saving_into_the_same_folder_empties_the_journal_file(saved):
    saved.save(saved.folder)
    assert (saved.folder / JOURNAL_FILE).read_bytes() == b""
    saved.note("after")
    resumed = ImageSession.resume(saved.folder)
    assert resumed.journal == saved.journal
    assert len(json.loads((saved.folder / "session.json").read_text())["journal"]) == 2


def test_a_crash_between_saving_and_emptying_does_no_harm(saved):
    before = (saved.folder / JOURNAL_FILE).read_bytes()
    saved.save(saved.folder)
    (saved.folder / JOURNAL_FILE).write_bytes(before)  # its lines are in session.json, too
    assert ImageSession.resume(saved.folder).journal == saved.journal


@pytest.mark.slow
def test_autosave_goes_on_where_a_resumed_session_stopped(saved):
    folder, count = saved.folder, len(saved.journal)
    saved.autosave(None)
    assert saved.folder is None
    resumed = ImageSession.resume(folder)
    resumed.note("in memory")  # before autosave: written when it begins
    resumed.autosave(folder)
    resumed.note("on disk")
    assert [entry.step for entry in ImageSession.resume(folder).journal[count:]] == ["note", "note"]
    saved.note("not saved any more")
    assert len(ImageSession.resume(folder).journal) == count + 2


@pytest.mark.slow
def test_open_or_resume(truth, kernels, tmp_path):
    first = ImageSession.open_or_resume(tmp_path, truth.picture, "new_horizons")
    first.predict()
    again = ImageSession.open_or_resume(tmp_path, truth.picture, "new_horizons")
    assert again.journal == first.journal
    again.note("goes on")
    assert ImageSession.resume(tmp_path).journal == again.journal


# -- crashes -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_kill_9_loses_nothing_that_had_returned(demo_truths, tmp_path):
    picture, folder, after = demo_truths[0].picture, tmp_path / "run", 40
    worker = _worker(picture, folder)
    told = 0
    for line in worker.stdout:
        told = int(line)
        if told >= after:
            break
    worker.send_signal(signal.SIGKILL)
    rest, _ = worker.communicate()
    told = max([told, *map(int, rest.split())])
    resumed = ImageSession.resume(folder)
    assert len(resumed.journal) >= told >= after
    # The lock died with its process, and the journal goes on.
    resumed.autosave(folder)
    resumed.note("after the crash")
    assert ImageSession.resume(folder).journal == resumed.journal


@pytest.mark.slow
@pytest.mark.parametrize("left", [1, 20, -1])
def test_a_torn_last_line_is_left_out_with_a_note(saved, left):
    """Cut within the last line, at its start, in its middle, before its end."""
    folder, path = saved.folder, saved.folder / JOURNAL_FILE
    saved.autosave(None)
    whole = path.read_bytes()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    path.write_bytes(whole[: last + left] if left > 0 else whole[:left])
    resumed = ImageSession.resume(folder)
    assert [entry.step for entry in resumed.journal] == ["predict"]
    assert "cut short by a crash" in resumed.resume_note
    resumed.autosave(folder)
    resumed.find_stars()
    assert _result(ImageSession.resume(folder)) == _result(saved)
    assert ImageSession.resume(folder).resume_note == ""


def test_lines_of_another_session_are_left_out_with_a_note(saved, tmp_path):
    path = saved.folder / JOURNAL_FILE
    lines = path.read_text().splitlines(keepends=True)
    other = json.loads(lines[1]) | {"session": "somebody else"}
    path.write_text(lines[0] + json.dumps(other) + "\n")
    resumed = ImageSession.resume(saved.folder)
    assert [entry.step for entry in resumed.journal] == ["predict"]
    assert "belongs to another session" in resumed.resume_note


@pytest.mark.slow
def test_a_kept_state_saves_the_work_but_decides_nothing(near, tmp_path, monkeypatch):
    """Resuming takes the kept state; without it, or with one that does not fit, the steps give the same."""
    monkeypatch.setattr("opnav_workbench.session.autosave.KEEP_AFTER_S", 0.0)
    near.autosave(tmp_path)
    near.find_body("PLUTO")
    near.observables()
    assert (tmp_path / STATE_FILE).exists()
    quick = ImageSession.resume(tmp_path)
    with monkeypatch.context() as patch:  # nothing is computed
        patch.setattr("opnav_workbench.session.history.STEPS", dict.fromkeys(_steps(near)))
        assert _result(ImageSession.resume(tmp_path)) == _result(near)
    again, first = quick.state.bodies[0], near.state.bodies[0]
    assert again.second.pixel_line.tolist() == first.second.pixel_line.tolist()
    assert again.detail.outline_px.tolist() == first.detail.outline_px.tolist()
    near.note("newer than the kept state")
    assert ImageSession.resume(tmp_path).state.user_notes == ("newer than the kept state",)
    for content in (b"", b"PK\x03\x04 damaged", (tmp_path / STATE_FILE).read_bytes()[:-100]):
        (tmp_path / STATE_FILE).write_bytes(content)
        assert _result(ImageSession.resume(tmp_path)) == _result(near)


def test_a_kept_state_of_a_class_with_other_fields_is_not_taken(near, tmp_path, monkeypatch):
    """A class that gained or lost a field since the state was kept would be rebuilt in part only."""
    monkeypatch.setattr("opnav_workbench.session.autosave.KEEP_AFTER_S", 0.0)
    near.autosave(tmp_path)
    near.note("kept")
    sha256 = near.context.picture.sha256
    assert read_state(tmp_path, sha256, near.standing) is not None
    with np.load(tmp_path / STATE_FILE) as file:
        arrays = dict(file)
    tree = json.loads(arrays.pop("tree").tobytes())
    del tree["state"]["fields"]["user_notes"]
    np.savez(tmp_path / STATE_FILE, tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8), **arrays)
    assert read_state(tmp_path, sha256, near.standing) is None
    assert ImageSession.resume(tmp_path).state.user_notes == ("kept",)


def _steps(session: ImageSession) -> list[str]:
    return [entry.step for entry in session.journal]


# -- one writer ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_second_process_is_refused_in_one_line_that_names_the_first(demo_truths, tmp_path):
    picture, folder = demo_truths[0].picture, tmp_path / "run"
    worker = _worker(picture, folder)
    try:
        assert worker.stdout.readline().strip() == "0"
        for act in (
            lambda: ImageSession.open(picture, "new_horizons").autosave(folder),
            lambda: ImageSession.open(picture, "new_horizons").save(folder),
            lambda: ImageSession.resume(folder).autosave(folder),
        ):
            with pytest.raises(SessionError, match=rf"process {worker.pid} on .* \(since .*\)") as caught:
                act()
            assert "\n" not in str(caught.value)
        assert ImageSession.resume(folder).context.picture.path.name == picture.name  # reading is free
    finally:
        worker.kill()
        worker.communicate()
    ImageSession.resume(folder).autosave(folder)


@pytest.mark.slow
def test_a_second_session_of_the_same_process_takes_over(saved):
    """A notebook's cell that is run again makes a new session; the older one must not write into its journal."""
    folder = saved.folder
    newer = ImageSession.resume(folder)
    newer.autosave(folder)
    newer.note("newer")
    with pytest.raises(SessionError, match="written by a newer session") as caught:
        saved.note("older")
    assert "\n" not in str(caught.value)
    assert saved.state.user_notes == ("older",)  # in memory
    assert ImageSession.resume(folder).state.user_notes == ("newer",)


def test_a_stale_lock_file_is_taken_over(opened, tmp_path):
    (tmp_path / ".session.lock").write_text(json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename}))
    opened.autosave(tmp_path)
    opened.predict()
    assert len(ImageSession.resume(tmp_path).journal) == 1


@pytest.mark.parametrize("error", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_goes_by_the_word_of_the_file(opened, tmp_path, monkeypatch, error):
    fcntl = pytest.importorskip("fcntl")

    def no_locks(*_):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    lock = tmp_path / ".session.lock"
    lock.write_text(json.dumps({"pid": 1, "host": os.uname().nodename, "since": "today"}))
    for act in (opened.autosave, opened.save):
        with pytest.raises(SessionError, match="process 1 on"):
            act(tmp_path)
    lock.write_text(json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename}))
    opened.autosave(tmp_path)
    assert json.loads(lock.read_text())["pid"] == os.getpid()
    opened.autosave(None)
    assert lock.read_text() == ""


def test_a_session_that_is_gone_holds_no_lock(truth, kernels, tmp_path):
    """A notebook's variable that is bound anew; nobody closed the older session."""
    session = ImageSession.open_or_resume(tmp_path, truth.picture, "new_horizons")
    session.note("first")
    del session
    gc.collect()
    again = ImageSession.open_or_resume(tmp_path, truth.picture, "new_horizons")
    assert again.state.user_notes == ("first",)


@pytest.mark.slow
def test_only_one_of_many_threads_gets_the_lock(tmp_path):
    def taken(_):
        with suppress(SessionError):
            return FolderLock(tmp_path)
        return None

    with ThreadPoolExecutor(8) as pool:
        locks = [lock for lock in pool.map(taken, range(32)) if lock is not None]
        assert len(locks) == 1
        pool.submit(locks[0].release).result()  # whichever thread releases it
    FolderLock(tmp_path).release()
    check_unlocked(tmp_path)


@pytest.mark.slow
def test_another_session_is_not_overwritten(saved, truth, kernels):
    fresh = ImageSession.open(truth.picture, "new_horizons")
    folder = saved.folder
    saved.autosave(None)
    with pytest.raises(SessionError, match=r"holds another session \(2 entries") as caught:
        fresh.autosave(folder)
    assert "\n" not in str(caught.value)
    assert ImageSession.resume(folder).journal == saved.journal


@pytest.mark.slow
def test_newer_steps_of_the_session_are_not_overwritten(saved):
    folder = saved.folder
    saved.autosave(None)
    early = ImageSession.resume(folder)
    late = ImageSession.resume(folder)
    late.autosave(folder)
    late.note("newer")
    late.autosave(None)
    with pytest.raises(SessionError, match="newer steps of this session"):
        early.autosave(folder)


# -- a disk that is full -------------------------------------------------------------------------------------------


def test_a_full_disk_is_told_once_and_the_step_is_written_with_the_next(saved, monkeypatch):
    heard = []
    saved.on_change(lambda session: heard.append(len(session.journal)))

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = (saved.folder / JOURNAL_FILE).read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(
            SessionError, match="No space left on device; 1 steps are kept in memory"
        ) as caught:
            saved.note("kept")
    assert "\n" not in str(caught.value)
    assert saved.state.user_notes == ("kept",)
    assert heard == [3]
    assert (saved.folder / JOURNAL_FILE).read_bytes() == before
    saved.note("next")
    assert ImageSession.resume(saved.folder).state.user_notes == ("kept", "next")


def test_a_file_changed_by_others_is_not_written_over(saved):
    path = saved.folder / JOURNAL_FILE
    path.write_bytes(path.read_bytes() + b"{}\n")
    with pytest.raises(SessionError, match="changed by another program"):
        saved.note("kept in memory")
    assert path.read_bytes().endswith(b"{}\n")


@pytest.mark.parametrize("name", ["file", "file/inside"])
def test_a_folder_that_cannot_be_made(opened, tmp_path, name):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(SessionError, match="cannot write into") as caught:
        opened.autosave(tmp_path / name)
    assert "\n" not in str(caught.value)
    opened.predict()  # the session itself is whole
