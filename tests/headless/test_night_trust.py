"""A night that takes nothing from an analyst, notices what has changed, and tells a passing fault from a lasting one."""

import errno
import json
import os
import shutil
import signal
import sqlite3
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign, database
from opnav_workbench.campaign import archive as campaign_archive
from opnav_workbench.campaign.run_folder import read_run
from opnav_workbench.cli import app, nightly, terminal
from opnav_workbench.cli.terminal import Terminated, ended_by_signals
from opnav_workbench.errors import SessionError
from opnav_workbench.files import fitting_name
from opnav_workbench.headless import night as night_module
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.headless.night_summary import night_summary_dict, write_night_summary
from opnav_workbench.headless.night_workers import NotebookOutcome
from opnav_workbench.headless.notebook_run import for_papermill
from opnav_workbench.headless.watching import NightWatch
from opnav_workbench.kernels.files import kernel_file
from opnav_workbench.mission import load_mission
from opnav_workbench.session.folder_lock import FolderLock

sys.path.insert(0, str(Path(__file__).parent))
from stub_night import Analyst, StubPool, decisions_below, night, result_of, spec_of, states

OTHER = {"model": "image_plane"}


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a.fit").write_text("picture a")
    return folder


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def made_by(out: Path, name: str = "a") -> str:
    return json.loads((out / name / "result.json").read_text())["made_by"]


# ---- An analyst who comes between plan and end of a night


@pytest.mark.parametrize("still_there", [True, False], ids=["still at work", "gone home"])
def test_decisions_made_while_a_night_runs_are_kept(images, out, still_there):
    night(images, out)

    def meanwhile(job, folder):
        result_of(job, folder)
        analyst = Analyst(out / "a")
        analyst.decide("cosmic ray")
        if still_there:
            at_work.append(analyst)
        else:
            analyst.leave()

    at_work: list[Analyst] = []
    made = night(images, out, StubPool(meanwhile), how=OTHER)
    assert decisions_below(out / "a") == {"cosmic ray"}
    assert made_by(out) == "euler"
    for analyst in at_work:
        analyst.decide("double star")
        analyst.leave()
    assert decisions_below(out / "a") >= {"cosmic ray"}
    assert states(images, out, **OTHER) == {"a": "kept"}
    # The night's own work is named, and where it is.
    (note,) = write_night_summary(made)["notes"]
    place = Path(note.rpartition(" ")[2])
    assert note.startswith("a: left as it is")
    assert json.loads((place / "result.json").read_text())["made_by"] == "image_plane"
    with Campaign(out) as campaign:
        assert [row["content_sha256"] for row in campaign.history()] == []


def test_a_picture_that_is_open_is_left_to_its_analyst(images, out):
    night(images, out)
    analyst = Analyst(out / "a")
    assert states(images, out, **OTHER) == {"a": "kept"}
    analyst.leave()
    assert states(images, out, **OTHER) == {"a": "new"}


@pytest.mark.slow
def test_a_session_that_cannot_be_read_now_is_let_be(images, out, monkeypatch):
    """A stale handle of a file server, of one picture: the others are done."""
    (images / "b.fit").write_text("picture b")
    night(images, out)
    digest = night_module.session_digest

    def stale(folder):
        if folder == out / "a":
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        return digest(folder)

    monkeypatch.setattr(night_module, "session_digest", stale)
    assert states(images, out, **OTHER) == {"a": "kept", "b": "new"}


@pytest.mark.slow
def test_a_picture_that_is_opened_while_a_night_runs_is_left_to_its_analyst(images, out):
    """Who has decided nothing yet is known by the lock alone."""
    night(images, out)
    at_work: list[Analyst] = []

    def meanwhile(job, folder):
        result_of(job, folder)
        at_work.append(Analyst(out / "a"))

    made = night(images, out, StubPool(meanwhile), how=OTHER)
    assert made_by(out) == "euler"
    assert "open elsewhere" in made.unplaced["a"]
    at_work[0].decide("double star")
    at_work[0].leave()
    assert decisions_below(out / "a") == {"double star"}


@pytest.mark.slow
def test_files_that_no_night_wrote_go_to_the_attic(images, out):
    night(images, out)
    (out / "a" / "notes.txt").write_text("ask the instrument team")
    made = night(images, out, how=OTHER)
    assert made_by(out) == "image_plane"
    assert [p.read_text() for p in out.rglob("notes.txt")] == ["ask the instrument team"]
    assert "notes.txt" in made.notes[0]
    assert len(list(out.rglob("result.json"))) == 1
    # What a night wrote and nobody touched is replaced without a word.
    (out / "a" / "result.json").touch()
    assert night(images, out).notes == []


# ---- What has changed


def test_a_catalog_of_other_content_under_the_old_name_is_noticed(images, out, tmp_path):
    def write(mag):
        np.savez(tmp_path / "stars.npz", ra_deg=[1.0], dec_deg=[2.0], mag=[mag])

    write(5.0)
    how = {"catalog": f"npz:{tmp_path / 'stars.npz'}"}
    night(images, out, how=how)
    assert states(images, out, **how) == {"a": "done"}
    write(6.0)
    assert states(images, out, **how) == {"a": "new"}


def test_what_lies_beside_a_picture_counts_as_the_picture_does(images, out):
    """A sidecar tells its time and attitude; a picture beside which there is none knows of no difference."""
    night(images, out)
    (images / "a.json").write_text('{"utc": "2030-01-01T00:00:00"}')
    plan = plan_night(spec_of(images), out)
    assert [(p.state, p.why) for p in plan.pictures] == [("new", ("beside a.json: new",))]
    night(images, out)
    assert states(images, out) == {"a": "done"}
    (images / "a.json").write_text('{"utc": "2030-01-01T00:00:01"}')
    assert states(images, out) == {"a": "new"}


@pytest.mark.slow
def test_maplets_of_other_content_under_the_old_name_are_noticed(images, out, tmp_path, monkeypatch):
    monkeypatch.setattr(NightSpec, "opened", lambda _: SimpleNamespace(mission=load_mission("new_horizons")))
    (tmp_path / "pluto.npz").write_text("some")
    how = {"landmarks": {"PLUTO": str(tmp_path / "pluto.npz")}}
    night(images, out, how=how)
    assert states(images, out, **how) == {"a": "done"}
    (tmp_path / "pluto.npz").write_text("others")
    assert states(images, out, **how) == {"a": "new"}


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("in/a.fit", None), ("one_star.npz", ("picture", "cut short"))],
    ids=["solved", "failed"],
)
def test_what_was_there_for_a_moment_only_is_nobodys_result(images, out, tmp_path, name, verdict):
    """A file replaced while the night ran, and put back as it was: the digests say that nothing has happened."""
    file = tmp_path / name
    spec_of(images)  # writes the catalog

    def work(job, folder):
        as_it_was = file.read_bytes()
        file.write_bytes(b"other")
        result_of(job, folder)
        file.write_bytes(as_it_was)
        return verdict

    made = night(images, out, StubPool(work))
    assert (
        f"{file.name} was written to or taken away while the night ran"
        in write_night_summary(made)["notes"][0]
    )
    (picture,) = plan_night(spec_of(images), out).pictures
    (why,) = picture.why
    assert picture.state == "new"
    assert file.name in why
    assert "written to or taken away" in why


def test_a_kernel_of_the_same_size_and_time_of_change_is_noticed(tmp_path):
    file = tmp_path / "a.tls"
    file.write_text("KPL/LSK\n\\begindata\nA = 1\n")
    before, times = kernel_file(file).sha256, (0, 10**18)
    os.utime(file, ns=times)
    kernel_file(file)
    file.write_text("KPL/LSK\n\\begindata\nA = 2\n")
    os.utime(file, ns=times)
    assert kernel_file(file).sha256 != before


# ---- Passing faults


def test_a_result_that_was_taken_away_is_made_again(images, out):
    """Of two pictures one loses its working folder, and all lose the night's lock, before the results are in place."""
    (images / "b.fit").write_text("picture b")

    def work(job, folder):
        result_of(job, folder)
        if job.name == "a":
            shutil.rmtree(folder.parent)

    made = night(images, out, StubPool(work))
    assert [(v.name, v.fault) for v in made.verdicts] == [("a", "machine"), ("b", "")]
    assert states(images, out) == {"a": "new", "b": "done"}
    (out / "b" / "result.json").write_text('{"status": "o')  # damaged since
    assert states(images, out) == {"a": "new", "b": "new"}


@pytest.mark.slow
def test_a_night_whose_folder_another_has_taken_ends(images, out):
    def work(job, folder):
        result_of(job, folder)
        shutil.rmtree(folder.parent)
        folder.parent.mkdir()
        others.append(FolderLock(folder.parent))

    others: list[FolderLock] = []
    with pytest.raises(SessionError, match=r"another night writes into .* \(.*process \d+"):
        night(images, out, StubPool(work))
    others[0].release()


def test_names_that_mean_something_elsewhere_are_names(images, out):
    for name in ("p{image}", "-p", "p\nq", "campaign.sqlite", "summary.json"):
        (images / f"{name}.fit").write_text(name)
    write_night_summary(night(images, out))
    assert set(states(images, out).values()) == {"done"}
    assert for_papermill("p{image}.ipynb").format(image="/elsewhere") == "p{image}.ipynb"


def test_names_as_long_as_a_file_system_takes_them_are_names(images, out, tmp_path):
    """Working folders, folders named after two, and escapes would be longer."""
    long, escaped = "x" * 251, "\x1b" * 100
    for folder in ("one" * 20, "two" * 20):
        (tmp_path / folder).mkdir()
        for name in (long, "é" * 125, escaped):
            (tmp_path / folder / f"{name}.fit").write_text(folder + name)
    seen = tmp_path / "*" / "*.fit"

    class Pool(StubPool):
        def run(self, jobs):
            names = [fitting_name(job.name, "-working") for job in jobs]
            assert len({*names}) == len(jobs)
            for job, name in zip(jobs, names, strict=True):
                folder = Path(job.folder) / name
                folder.mkdir(parents=True)
                result_of(job, folder)
                yield NotebookOutcome(job.name, str(folder), "", "", 1.0, 10.0)

    write_night_summary(night(seen, out, Pool()))
    known = states(seen, out)
    assert len(known) == 7
    assert set(known.values()) == {"done"}


def test_a_picture_that_is_done_is_not_read_again_for_the_archive(images, out, monkeypatch):
    """Reading 7,000 of them took a night twenty seconds."""
    (images / "b.fit").write_text("picture b")
    night(images, out)
    read: list[str] = []
    monkeypatch.setattr(
        campaign_archive, "read_run", lambda place: read.append(place.name) or read_run(place)
    )
    night(images, out)
    assert read == []
    (out / "b" / "result.json").unlink()
    night(images, out)
    assert read == ["b"]
    # An archive that is made anew takes all in, and knows them from then on.
    (out / "campaign.sqlite").write_bytes(b"damaged")
    night(images, out)
    assert set(read) == {"a", "b"}
    read.clear()
    night(images, out)
    assert read == []


def test_an_archive_that_another_program_holds_delays_a_night_once(images, out, monkeypatch):
    """It waited for each picture, and for each of twenty attempts: hours, where a shell had a transaction open."""
    for name in "bc":
        (images / f"{name}.fit").write_text(f"picture {name}")
    monkeypatch.setattr(database, "BUSY_TIMEOUT_S", 0.3)
    held: list[sqlite3.Connection] = []
    begun: list[float] = []

    def meanwhile(job, folder):
        result_of(job, folder)
        if not held:
            held.append(sqlite3.connect(out / "campaign.sqlite", isolation_level=None))
            held[0].execute("BEGIN IMMEDIATE")

    made = night(images, out, StubPool(meanwhile), begun=lambda: begun.append(time.monotonic()))
    assert time.monotonic() - begun[0] < 5.0
    assert [reason.partition(":")[0] for reason in made.unarchived] == ["a", "b", "c"]
    assert "another program" in made.unarchived[0]
    held[0].close()
    assert night(images, out).unarchived == []
    with Campaign(out) as campaign:
        assert {entry.image for entry in campaign.entries()} == {"a.fit", "b.fit", "c.fit"}


@pytest.mark.parametrize(
    ("name", "value"),
    [("files", [1]), ("files", {"../../in/a.fit": "SHA"}), ("image", 5)],
)
def test_a_record_that_no_night_wrote_ends_no_night_and_deletes_nothing(images, out, name, value):
    night(images, out)
    (images / "b.fit").write_text("picture b")
    record = json.loads((out / "a" / "night.json").read_text())
    record["record"][name] = json.loads(json.dumps(value).replace("SHA", record["record"]["image_sha256"]))
    (out / "a" / "night.json").write_text(json.dumps(record))
    shutil.copytree(out / "a", out / ".attic" / "a" / "20260101T000000Z-000000")  # a night that was killed
    made = night(images, out, how=OTHER)
    assert [verdict.name for verdict in made.verdicts] == ["b"]
    assert states(images, out, **OTHER) == {"a": "kept", "b": "done"}
    assert (images / "a.fit").read_text() == "picture a"


def test_a_link_in_the_place_of_the_nights_own_folder_is_not_emptied(images, out, tmp_path):
    (tmp_path / "mine" / "data").mkdir(parents=True)
    out.mkdir()
    (out / ".work").symlink_to(tmp_path / "mine")
    with pytest.raises(SessionError, match="link"):
        night(images, out)
    assert (tmp_path / "mine" / "data").is_dir()


def test_what_stands_in_a_pictures_place_is_left_alone(images, out, tmp_path):
    """A link out of the folder and a file; hidden files, as copying programs make them, are no pictures."""
    (images / "b.fit").write_text("picture b")
    (images / ".b.fit").write_text("half of it")
    (tmp_path / "elsewhere").mkdir()
    out.mkdir()
    (out / "a").symlink_to(tmp_path / "elsewhere")
    (out / "b").write_text("mine")
    night(images, out)
    assert [(out / name / "result.json").is_file() for name in ("in_a", "in_b")] == [True, True]
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert (out / "b").read_text() == "mine"


@pytest.mark.slow
def test_what_comes_into_a_pictures_place_meanwhile_is_left_alone_and_not_archived(images, out):
    def work(job, folder):
        result_of(job, folder)
        (out / "a").write_text("mine")

    made = night(images, out, StubPool(work))
    assert (out / "a").read_text() == "mine"
    assert (list(made.unplaced), made.unarchived) == (["a"], [])


def test_a_time_of_change_in_the_future_holds_nobody_up(images, out):
    """The clock was set back, or the file's time came with it from elsewhere."""
    ahead = time.time() + 1e6
    os.utime(images / "a.fit", (ahead, ahead))
    assert states(images, out, choice={"quiet_s": 1e3}) == {"a": "arriving"}  # written this moment
    time.sleep(0.2)
    assert states(images, out, choice={"quiet_s": 0.2}) == {"a": "new"}


@pytest.mark.parametrize("fault", ["machine", "limit"])
def test_what_may_pass_is_tried_again(images, out, fault):
    made = night(images, out, StubPool(lambda job, folder: (fault, "no luck")), how={"time_limit_s": 10.0})
    assert made.unarchived == []
    (picture,) = plan_night(spec_of(images, time_limit_s=20.0), out).pictures
    why = {
        "machine": "the machine failed it: no luck",
        "limit": "a limit is higher now than when it failed: no luck",
    }
    assert (picture.state, picture.why) == ("new", (why[fault],))
    with Campaign(out) as campaign:  # a machine's fault is no picture's
        assert [entry.status for entry in campaign.entries()] == ([] if fault == "machine" else ["failed"])
    if fault == "limit":
        assert states(images, out, time_limit_s=10.0) == {"a": "done"}


@pytest.mark.slow
def test_what_another_version_calls_a_fault_is_tried_again(images, out):
    night(images, out)
    record = json.loads((out / "a" / "night.json").read_text())
    record["record"] |= {"fault": "cluster", "reason": "its node was drained"}
    (out / "a" / "night.json").write_text(json.dumps(record))
    assert states(images, out) == {"a": "new"}


def test_a_picture_that_was_missing_for_a_moment_is_tried_again(images, out):
    def away(job, folder):
        Path(job.image).rename(images / "a.away")
        return "picture", "a.fit: no such file"

    night(images, out, StubPool(away))
    (images / "a.away").rename(images / "a.fit")
    assert states(images, out) == {"a": "new"}


def test_a_fault_of_the_machine_leaves_an_older_result_where_it_is(images, out):
    night(images, out)
    made = night(images, out, StubPool(lambda job, folder: ("machine", "a worker was lost")), how=OTHER)
    assert made_by(out) == "euler"
    summary = write_night_summary(made)
    assert summary["failed_now"] == 1
    assert "a worker was lost" in summary["notes"][0]
    assert states(images, out, **OTHER) == {"a": "new"}


@pytest.mark.slow
def test_what_failed_as_its_inputs_went_away_leaves_an_older_result_where_it_is(images, out):
    """A disk of kernels or catalogs that is unmounted in the middle of a night."""
    (images / "b.fit").write_text("picture b")
    night(images, out)
    catalog, away = images.parent / "one_star.npz", images.parent / "away.npz"

    def work(job, folder):
        if catalog.exists():
            catalog.rename(away)
        return "picture", "no catalog"

    made = night(images, out, StubPool(work), how=OTHER)
    assert {made_by(out), made_by(out, "b")} == {"euler"}
    summary = write_night_summary(made)
    assert summary["failed_now"] == 2
    stands, gone = summary["notes"]  # one line each, for whatever number of pictures
    assert stands.startswith("a, b: the machine failed it, its older result stands: no catalog (one_star.npz")
    assert gone.startswith("one_star.npz was written to or taken away")
    with Campaign(out) as campaign:
        assert {entry.status for entry in campaign.entries()} == {"ok"}
    away.rename(catalog)
    assert states(images, out, **OTHER) == {"a": "new", "b": "new"}


@pytest.mark.slow
def test_what_failed_can_be_asked_for_again_and_all_by_force(images, out):
    (images / "b.fit").write_text("picture b")
    pool = StubPool(lambda job, folder: result_of(job, folder, "failed" if job.name == "a" else "ok"))
    night(images, out, pool)
    assert states(images, out) == {"a": "done", "b": "done"}
    assert states(images, out, {"retry_failed": True}) == {"a": "new", "b": "done"}
    assert states(images, out, {"force": True}) == {"a": "new", "b": "new"}
    Analyst(out / "b").decide("mine")
    assert states(images, out, {"force": True}) == {"a": "new", "b": "kept"}


@pytest.mark.slow
def test_a_failure_is_known_by_its_missions_name(images, out):
    """The mission file may be the night's own, with the PSF that it has learned."""
    file = str(load_mission("new_horizons").path)
    made = night(images, out, StubPool(lambda job, folder: ("picture", "no image")), how={"mission": file})
    assert (
        made.plan.job(made.plan.pictures[0]).mission == "new_horizons"
    )  # what a notebook's failure is written with
    assert json.loads((out / "a" / "result.json").read_text())["mission"] == "new_horizons"
    assert write_night_summary(made)["mission"] == "new_horizons"


# ---- Names, lock, archive


def test_a_picture_keeps_its_folder_when_another_of_its_name_comes(images, out, tmp_path):
    night(images, out)
    later = tmp_path / "later"
    later.mkdir()
    (later / "a.fit").write_text("another picture a")
    stars = {"catalog": f"npz:{tmp_path / 'one_star.npz'}"}
    assert states(tmp_path / "*" / "a.fit", out, **stars) == {"a": "done", "later_a": "new"}
    # One that was moved takes its folder along.
    moved = tmp_path / "elsewhere"
    images.rename(moved)
    assert states(moved / "a.fit", out, **stars) == {"a": "done"}


@pytest.mark.slow
def test_a_night_that_starts_as_another_ends_loses_nothing(images, out, monkeypatch):
    released = FolderLock.release
    begun = []

    def release_then_begin(self):
        path = self._path
        released(self)
        if path.parent.name == ".work" and not begun:
            begun.append(True)
            begun.append(night(images, out, StubPool(), how=OTHER))

    monkeypatch.setattr(FolderLock, "release", release_then_begin)
    night(images, out)
    assert made_by(out) == "image_plane"
    monkeypatch.undo()

    # And one that is at work while the first tidies up keeps what it has.
    def release_then_work(self):
        released(self)
        if self._path.parent.name == ".work" and not at_work:
            at_work.append(FolderLock(self._path.parent))
            (self._path.parent / "a-1").mkdir()

    at_work: list[FolderLock] = []
    monkeypatch.setattr(FolderLock, "release", release_then_work)
    night(images, out)
    assert (out / ".work" / "a-1").is_dir()
    monkeypatch.undo()
    at_work[0].release()


@pytest.mark.slow(keep=("head",))
@pytest.mark.parametrize("damage", ["head", "format", "pages"])
def test_a_damaged_archive_is_made_anew(images, out, damage):
    (images / "b.fit").write_text("picture b")
    night(images, out)
    file = out / "campaign.sqlite"
    with Campaign(out) as campaign:
        whole = campaign.digest()
    content = bytearray(file.read_bytes())
    start, end = {"head": (0, 16), "format": (18, 19), "pages": (100, len(content))}[damage]
    content[start:end] = b"\x55" * (end - start)
    file.write_bytes(content)
    made = night(images, out)
    with Campaign(out) as campaign:
        assert campaign.digest() == whole
    (kept,) = out.glob("campaign.sqlite.damaged-*")
    assert kept.read_bytes() == content
    assert kept.name in made.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize("table", ["images", "provenance"])
def test_a_page_of_the_archive_that_is_damaged_is_found_where_it_is_read(images, out, table):
    """That of `images` as a night asks what it knows, that of `provenance` as it takes a picture in."""
    night(images, out)
    file = out / "campaign.sqlite"
    with closing(sqlite3.connect(file)) as archive:
        (size,) = archive.execute("PRAGMA page_size").fetchone()
        (page,) = archive.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", [table]).fetchone()
    content = bytearray(file.read_bytes())
    content[(page - 1) * size : page * size] = b"\x55" * size
    file.write_bytes(content)
    (images / "b.fit").write_text("picture b")
    made = night(images, out)
    assert made.unarchived == []
    with Campaign(out) as campaign:
        assert {entry.image for entry in campaign.entries()} == {"a.fit", "b.fit"}
    (kept,) = out.glob("campaign.sqlite.damaged-*")
    assert kept.read_bytes() == content
    assert kept.name in made.notes[0]


# ---- The command


def run(images, out, monkeypatch, work, *words):
    pool = StubPool(work)
    monkeypatch.setattr(nightly, "LocalPool", lambda *_, **__: pool)
    stars = f"npz:{images.parent / 'one_star.npz'}"
    np.savez(images.parent / "one_star.npz", ra_deg=[1.0], dec_deg=[2.0], mag=[3.0])
    words = (
        "nightly",
        str(images),
        "--mission",
        "new_horizons",
        "--catalog",
        stars,
        "--out",
        str(out),
        *words,
    )
    answer = CliRunner().invoke(app, words, env={"COLUMNS": "160"})
    assert answer.exception is None or isinstance(answer.exception, SystemExit), answer.exception
    return answer.exit_code, answer.output


def test_exit_status_speaks_of_this_night(images, out, monkeypatch):
    failed = lambda job, folder: result_of(job, folder, "failed")  # noqa: E731
    assert run(images, out, monkeypatch, failed)[0] == 3
    status, said = run(images, out, monkeypatch, failed)
    assert (status, "0 of 1 pictures to process (1 done before)" in said) == (0, True)
    assert "1 failed" in said


@pytest.mark.slow
def test_a_night_is_not_put_into_a_pictures_folder(images, out):
    night(images, out)
    before = sorted(path.name for path in (out / "a").iterdir())
    with pytest.raises(SessionError, match="give that of the night") as refused:
        nightly._learned_and_planned(Console(), spec_of(images), out / "a")
    assert str(refused.value).endswith(f"as {out}.")
    assert sorted(path.name for path in (out / "a").iterdir()) == before


@pytest.mark.slow
def test_an_archive_that_takes_nothing_is_heard_of(images, out, monkeypatch):
    def refuse(*_):
        raise SessionError("a read-only disk")

    with monkeypatch.context() as broken:
        broken.setattr(Campaign, "ingest_run", refuse)
        assert run(images, out, monkeypatch, result_of)[0] == 3
        assert "WARNING not in the archive: a: a read-only disk" in (out / "night.log").read_text()
        assert (
            run(images, out, monkeypatch, result_of)[0] == 0
        )  # what an earlier night has done is not this one's
    assert run(images, out, monkeypatch, result_of)[0] == 0
    with Campaign(out) as campaign:
        assert [entry.image for entry in campaign.entries()] == ["a.fit"]


def test_sigterm_ends_a_night_with_its_summary(images, out, monkeypatch):
    (images / "b.fit").write_text("picture b")

    def work(job, folder):
        if job.name == "b":
            os.kill(os.getpid(), signal.SIGTERM)
        result_of(job, folder)

    before = signal.getsignal(signal.SIGTERM)
    status, said = run(images, out, monkeypatch, work)
    assert (status, "stopped (SIGTERM)" in said) == (143, True)
    assert "1 ok, 0 partial, 0 failed, 1 waiting" in said
    assert "not processed yet; run the same command again: b" in said
    assert ("needs an analyst" in said, "opnav lab" in said) == (False, False)
    summary = json.loads((out / "summary.json").read_text())
    assert {row["name"]: row["status"] for row in summary["images"]} == {"a": "ok", "b": "waiting"}
    assert [row["attention"] for row in summary["images"]] == [[], []]
    assert "Nothing so far; what is not processed yet waits" in (out / "summary.html").read_text()
    assert signal.getsignal(signal.SIGTERM) is before
    how = json.loads((out / "status.json").read_text())
    assert (how["state"], how["pictures"]["left"]) == ("stopped", 1)
    log = (out / "night.log").read_text()
    assert "a ok (1.0 s, 10 MB, try 1)" in log
    assert "stopped: Terminated SIGTERM" in log
    assert all(line[4] == "-" and line[19] == "Z" for line in log.splitlines())
    assert "opnav_night_pictures_processed 1\n" in (out / "night.prom").read_text()


@pytest.mark.slow
def test_what_a_stopped_night_has_put_into_its_place_is_done(images, out, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    stopped = Night(plan_night(spec_of(images), out))
    monkeypatch.setattr(night_module, "_archive", stop)
    with pytest.raises(KeyboardInterrupt):
        run_night(stopped, StubPool())
    (row,) = night_summary_dict(stopped)["images"]
    assert (row["state"], row["status"]) == ("done", "ok")
    other = Night(plan_night(spec_of(images, **OTHER), out))
    (row,) = night_summary_dict(other)["images"]  # what stands there is of other inputs
    assert (row["state"], row["status"]) == ("waiting", "waiting")


@pytest.mark.slow
def test_a_picture_that_was_delivered_twice_counts_once_and_is_told(images, out):
    (images / "again.fit").write_text("picture a")
    (images / "b.fit").write_text("picture b")
    for _ in range(2):
        summary = write_night_summary(night(images, out))
        assert [note.partition(" (")[0] for note in summary["notes"]] == ["a, again are one picture"]
    with Campaign(out) as campaign:
        assert len(campaign.entries()) == 2


class Dying:
    """Its end comes while garbage is collected: Python swallows what is raised there."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.slow
def test_sigterm_ends_a_night_that_is_being_planned(images, out, monkeypatch):
    """Without the handler the signal would end this process, and a job script would know nothing."""

    def told(*_, **__):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(30.0)

    monkeypatch.setattr(nightly, "plan_night", told)
    status, said = run(images, out, monkeypatch, result_of)
    assert (status, "stopped" in said) == (143, True)


def test_a_signal_that_comes_while_garbage_is_collected_is_not_lost(monkeypatch):
    """One in eight nights of a storm went on, deaf to any other signal.

    The first reminder is lost here, as one is that comes when the main thread is about to wait, and does not yet.
    """
    told = []

    def tell(number):
        told.append(number)
        if len(told) > 1:
            signal.pthread_kill(threading.main_thread().ident, number)

    monkeypatch.setattr(terminal, "_tell_main_thread", tell)

    def work() -> None:
        with ended_by_signals():
            Dying()
            time.sleep(20.0)

    began = time.monotonic()
    with pytest.raises(Terminated) as stop:
        work()
    assert stop.value.status == 128 + signal.SIGTERM
    assert time.monotonic() - began < 10.0
    assert len(told) > 1


def test_a_signal_that_was_swallowed_ends_what_is_done_before_it_comes_again(monkeypatch):
    """A watch's night has no right to keep it: the block around it is told; what is being written down is not."""
    monkeypatch.setattr(terminal, "AGAIN_S", 60.0)
    before = signal.getsignal(signal.SIGTERM)
    went_on = []

    def watch(passing: bool) -> None:
        with ended_by_signals():
            with ended_by_signals() as pass_over:
                Dying()
                if passing:
                    pass_over()
            went_on.append(passing)

    began = time.monotonic()
    with pytest.raises(Terminated):
        watch(passing=False)
    watch(passing=True)
    assert went_on == [True]
    assert time.monotonic() - began < 10.0
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.slow
def test_why_tells_what_has_changed(images, out, monkeypatch):
    work = result_of
    assert "a: to be processed\n  not processed yet" in run(images, out, monkeypatch, work, "--why", "a")[1]
    run(images, out, monkeypatch, work)
    assert run(images, out, monkeypatch, work, "--why", "a.fit")[1] == "a: done, nothing has changed\n"
    (images / "a.fit").write_text("calibrated anew")
    words = ("--model", "image_plane", "--why", str(images / "a.fit"))
    _, said = run(images, out, monkeypatch, work, *words)
    assert 'model: "euler", now "image_plane"' in said
    assert "picture: content" in said
    assert len(said.splitlines()) == 3
    Analyst(out / "a").decide("mine")
    assert (
        "left to its analyst\n  an analyst has worked on it" in run(images, out, monkeypatch, work, *words)[1]
    )


@pytest.mark.slow
def test_an_incoming_folder_is_watched_and_half_written_files_are_let_be(images, out, monkeypatch):
    naps = []

    def nap(_seconds):
        """What happens between two looks: a picture is being written, is ready, and the watch is ended."""
        naps.append({path.name for path in out.glob("*") if (path / "result.json").exists()})
        if len(naps) == 1:
            (images / "b.fit").write_text("half of b")
        if len(naps) == 3:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(nightly, "wait", nap)
    ages = {"a.fit": 60.0, "b.fit": 1.0}
    monkeypatch.setattr(night_module, "_age_s", lambda path: ages[path.name])
    words = ("--watch", "5", "--notify", f"cp --target-directory={out.parent}")
    status, said = run(images, out, monkeypatch, result_of, *words)
    assert (status, "stopped (SIGTERM)" in said) == (143, True)
    assert naps == [{"a"}, {"a"}, {"a"}]
    ages["b.fit"] = 60.0
    naps.clear()
    assert run(images, out, monkeypatch, result_of, *words)[0] == 143
    assert naps[0] == {"a", "b"}
    assert json.loads((out.parent / "summary.json").read_text())["processed_now"] == 1


@pytest.mark.slow
def test_a_watch_does_not_try_over_and_over_what_the_machine_fails(images, out, monkeypatch):
    naps = []

    def nap(_seconds):
        naps.append(len(pools[0].jobs))
        if len(naps) == 3:
            raise KeyboardInterrupt

    pools = [StubPool(lambda job, folder: ("machine", "no luck"))]
    monkeypatch.setattr(nightly, "wait", nap)
    monkeypatch.setattr(night_module, "_age_s", lambda _: 60.0)
    monkeypatch.setattr(nightly, "LocalPool", lambda *_, **__: pools[0])
    stars = str(spec_of(images).catalog)
    words = (
        "nightly",
        str(images),
        "-m",
        "new_horizons",
        "--catalog",
        stars,
        "--out",
        str(out),
        "--watch",
        "5",
    )
    answer = CliRunner().invoke(app, words)
    assert (answer.exit_code, naps) == (130, [1, 1, 1])


@pytest.mark.slow
def test_a_second_night_spoils_nothing_of_the_first(images, out, monkeypatch):
    def work(job, folder):
        result_of(job, folder)
        before = {name: (out / name).read_text() for name in ("status.json", "night.log")}
        answer = CliRunner().invoke(app, ["nightly", str(images), "-m", "new_horizons", "--out", str(out)])
        assert "another night writes into" in str(answer.exception)
        assert {name: (out / name).read_text() for name in before} == before
        assert not (out / "summary.json").exists()

    status, said = run(images, out, monkeypatch, work)
    assert (status, "1 ok" in said) == (0, True)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("log", ["/dev/full", "/nowhere/night.log"])
def test_a_log_that_cannot_be_written_costs_no_night(images, out, capfd, log):
    """It printed a traceback for every line, and ended a night that was done."""
    with NightWatch(plan_night(spec_of(images), out), Path(log)) as watch:
        watch.begin()
        watch.note("something")
    assert capfd.readouterr().err == ""
    assert watch.fault.startswith(f"the log {log} is not whole: ")
    assert json.loads((out / "status.json").read_text())["state"] == "finished"


def test_a_night_without_a_terminal_is_heard_of(images, out):
    heard, plan = [], plan_night(spec_of(images), out)
    with NightWatch(plan, heartbeat=heard.append, every_s=0.02) as watch:
        watch.begin()
        deadline = time.monotonic() + 10.0
        while not heard and time.monotonic() < deadline:
            time.sleep(0.01)
    assert heard[0] == "0 of 1 pictures done, 0 failed, 0.0 a minute"
