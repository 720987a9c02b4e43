"""The archive's file: versions, strangers, several processes at once, and death in the middle."""

import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

from opnav_workbench.campaign import ARCHIVE_FILE, Campaign
from opnav_workbench.campaign.schema import APPLICATION_ID, SCHEMA_VERSION
from opnav_workbench.errors import SessionError

INGEST = "import sys; from opnav_workbench.campaign import Campaign\nwith Campaign(sys.argv[1]) as c: c.ingest(sys.argv[2:])"
# As many processes as there are lists, all at once: forked, so that none is late for having to start up.
AT_ONCE = """
import json, os, sys
from opnav_workbench.campaign import Campaign
children = []
for runs in json.loads(sys.argv[2]):
    children.append(os.fork())
    if children[-1] == 0:
        status = 1
        try:
            with Campaign(sys.argv[1]) as campaign:
                assert campaign.ingest(runs).count("skipped") == 0
            status = 0
        finally:
            os._exit(status)
sys.exit(any(os.waitpid(child, 0)[1] for child in children))
"""
# The archive as version 1 made it, as far as it differs: no journal, and no reasons to look at a picture.
BACK_TO_1 = """
DROP TABLE journal;
DROP TABLE readings;
ALTER TABLE images DROP COLUMN attention;
PRAGMA user_version = 1;
"""


@contextlib.contextmanager
def sqlite(path):
    connection = sqlite3.connect(path)
    yield connection
    connection.commit()
    connection.close()


def pragma(path, name):
    with sqlite(path) as connection:
        return connection.execute(f"PRAGMA {name}").fetchone()[0]


def test_a_new_archive_says_whose_and_which_it_is(tmp_path):
    with Campaign(tmp_path) as campaign:
        assert campaign.path == tmp_path / ARCHIVE_FILE
        assert len(campaign.images()) == len(campaign.bodies()) == len(campaign.observables()) == 0
        assert campaign.entries() == ()
    assert pragma(tmp_path / ARCHIVE_FILE, "application_id") == APPLICATION_ID
    assert pragma(tmp_path / ARCHIVE_FILE, "user_version") == SCHEMA_VERSION
    assert pragma(tmp_path / ARCHIVE_FILE, "journal_mode") == "wal"
    assert sorted(p.name for p in tmp_path.iterdir()) == [ARCHIVE_FILE]  # the log is folded in


@pytest.mark.slow
def test_an_archive_of_version_1_is_brought_up(make_run, tmp_path):
    def unsure(result, session):
        result["status"], result["messages"] = "partial", ["CHARON: SNR 3.7 is below 5"]
        result["bodies"][0]["status"] = "uncertain"

    path = tmp_path / "c.sqlite"
    runs = [make_run(tmp_path / "a", 1), make_run(tmp_path / "b", 2, edit=unsure)]
    with Campaign(path) as campaign:
        campaign.ingest(runs)
        expected = campaign.dump()
    with sqlite(path) as connection:
        connection.executescript(BACK_TO_1)
    with Campaign(path) as campaign:
        assert pragma(path, "user_version") == SCHEMA_VERSION
        content = campaign.dump()
        assert [entry.attention for entry in campaign.entries()] == [
            (), ("CHARON: SNR 3.7 is below 5", "PLUTO: uncertain"),
        ]  # fmt: skip
        assert content.pop("journal") == []  # version 1 did not keep it; the runs bring it
        expected.pop("journal")
        assert content == expected
        assert campaign.ingest(runs).count("unchanged") == 2


def test_a_newer_archive_is_refused_and_left_alone(make_run, tmp_path):
    path = tmp_path / "c.sqlite"
    with Campaign(path) as campaign:
        campaign.ingest_run(make_run(tmp_path / "a", 1))
    with sqlite(path) as connection:
        connection.execute("PRAGMA user_version = 99")
    before = path.read_bytes()
    with pytest.raises(
        SessionError,
        match=rf"schema 99, this program knows {SCHEMA_VERSION} at most.*nothing has been changed",
    ):
        Campaign(path)
    assert path.read_bytes() == before


def test_strangers_are_refused_and_left_alone(tmp_path):
    other = tmp_path / "other.sqlite"
    with sqlite(other) as connection:
        connection.execute("CREATE TABLE songs (title TEXT)")
    text = tmp_path / "notes.txt"
    text.write_text("not a database at all")
    damaged = tmp_path / "damaged.sqlite"
    damaged.write_bytes(b"SQLite format 3\x00" + b"\x07" * 2000)
    for path, words in (
        (other, "of another program"),
        (text, "no SQLite file"),
        (damaged, "campaign archive"),
    ):
        before = path.read_bytes()
        with pytest.raises(SessionError, match=words):
            Campaign(path)
        assert path.read_bytes() == before
    with pytest.raises(SessionError, match="there is no campaign archive"):
        Campaign(tmp_path / "missing.sqlite", create=False)
    assert not (tmp_path / "missing.sqlite").exists()


def test_a_folder_that_cannot_be_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="cannot make the folder"):
        Campaign(tmp_path / "file" / "c.sqlite")


@pytest.mark.slow
def test_several_processes_ingest_at_once(make_run, tmp_path):
    """Four processes that begin with no archive, each with runs of its own and all with the same eight."""
    common = [make_run(tmp_path / f"common{i}", i) for i in range(8)]
    own = [[make_run(tmp_path / f"own{p}_{i}", 10 * (p + 1) + i) for i in range(4)] for p in range(4)]
    path = tmp_path / "c.sqlite"
    lists = json.dumps([[str(run) for run in (*common, *mine)] for mine in own])
    done = subprocess.run(
        [sys.executable, "-c", AT_ONCE, path, lists], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    with Campaign(path) as together, Campaign(tmp_path / "alone.sqlite") as alone:
        alone.ingest([*common, *(run for mine in own for run in mine)])
        assert together.digest() == alone.digest()
        assert len(together.images()) == 24
    assert pragma(path, "integrity_check") == "ok"


@pytest.mark.slow
def test_killed_in_the_middle_nothing_is_half_there(make_run, tmp_path):
    """SIGKILL at some moment of an ingest of 40 runs; what stands is whole, and going on gives the undisturbed archive."""
    runs = tmp_path / "runs"
    for i in range(40):
        make_run(runs / f"r{i:02d}", i)
    path = tmp_path / "c.sqlite"
    process = subprocess.Popen([sys.executable, "-c", INGEST, path, runs])
    limit = time.monotonic() + 60.0
    while not _stands(path) and time.monotonic() < limit:
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    with Campaign(path) as campaign:
        count = len(campaign.images())
        assert 0 < count < 40
        assert len(campaign.provenance()) == len(campaign.pointings()) == count
        assert len(campaign.bodies()) == len(campaign.observables()) == 2 * count
        report = campaign.ingest(runs)
        assert (report.count("unchanged"), report.count("new")) == (count, 40 - count)
        with Campaign(tmp_path / "undisturbed.sqlite") as other:
            other.ingest(runs)
            assert campaign.digest() == other.digest()
    assert pragma(path, "integrity_check") == "ok"


def _stands(path):
    """Whether an ingest that goes on has put anything into the archive for good."""
    if not path.exists():
        return False
    try:
        with sqlite(path) as connection:
            return connection.execute("SELECT count(*) FROM images").fetchone()[0] > 0
    except sqlite3.OperationalError:  # as it is made
        return False


def test_readers_do_not_wait_for_a_writer(make_run, tmp_path):
    """A transaction that another program holds open blocks no question, and ingest waits for its end."""
    with Campaign(tmp_path / "c.sqlite") as campaign:
        campaign.ingest_run(make_run(tmp_path / "a", 1))
        blocker = sqlite3.connect(campaign.path, isolation_level=None)
        blocker.execute("BEGIN IMMEDIATE")
        begun = time.monotonic()
        assert len(campaign.images()) == 1
        assert campaign.ingest_run(tmp_path / "a").result == "unchanged"
        assert time.monotonic() - begun < 5.0
        blocker.execute("COMMIT")
        blocker.close()
        assert campaign.ingest_run(make_run(tmp_path / "b", 2)).result == "new"


def test_the_digest_sees_every_part(make_run, tmp_path):
    digests = set()
    edits = (
        lambda r, s: None,
        lambda r, s: r.update(messages=["word"]),
        lambda r, s: r["pointing"].update(rms_px=0.5),
        lambda r, s: r["stars"][0].update(mag=1.0),
        lambda r, s: r["bodies"][0].update(snr=1.0),
        lambda r, s: r["provenance"].update(catalog="other"),
        lambda r, s: r["provenance"].update(notes=["a note"]),
        lambda r, s: s["journal"].pop(),
    )
    for number, edit in enumerate(edits):
        with Campaign(tmp_path / f"{number}.sqlite") as campaign:
            campaign.ingest_run(make_run(tmp_path / f"run{number}", 1, edit=edit))
            json.dumps(campaign.dump(), allow_nan=False)
            digests.add(campaign.digest())
    assert len(digests) == len(edits)
