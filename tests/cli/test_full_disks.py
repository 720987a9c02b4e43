"""Disks that are full, or cannot be written: one clear line, what stood there stays, and no half file is left.

A disk of a few kB is a tmpfs where root may mount one; a limit of the process on the size of files serves elsewhere, and
lets some files through and others not. Links, pipes and devices stand in ``test_strange_places``.
"""

import contextlib
import errno
import json
import os
import resource
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from opnav_workbench.contracts import check_file
from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_text
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session.folder_lock import FolderLock

sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile import answer

SMALL = 512 << 10  # bytes
# What writes, and whether a picture that fails leaves the others: status 3, not 2.
COMMANDS = {
    "export": "export run --format csv --out OUT/x.csv",
    "export ecsv": "export run --out OUT/x.ecsv",
    "export tdm": "export run --out OUT/x.tdm",
    "cone": "catalog cone npz:s.npz 10 5 60 --out OUT/c.ecsv",
    "chart": "catalog cone npz:s.npz 10 5 60 --plot OUT/c.png",
    "shape": "kernels make s.obj --body PLUTO --frame IAU_PLUTO --kernels k.tpc --out OUT/k.bds",
    "kernels": "kernels make nh/pluto_opnav.yaml --out OUT/k",
    "make-ck": f"kernels make-ck run --out OUT/k.bc --kernels {DEMO_KERNELS}",
    "make-isd": f"kernels make-isd run --out OUT/i --target PLUTO --kernels {DEMO_KERNELS}",
    "campaign": "campaign ingest run --archive OUT/a.sqlite",
    "campaign export": "campaign export OUT/x.json --archive a.sqlite",
    "campaign plot": "campaign plot --archive a.sqlite --out OUT/x.png",
    "schemas": "check --schemas OUT/s",
    "simulate": "simulate new_horizons/jf56_2006 --out OUT/s --jobs 1",
    "plan": "plan new_horizons/pluto_approach --only pluto_charon --no-exposures --out OUT/p",
    "process": "process p.fit --mission new_horizons --attitude header --targets none --out OUT/r",
    "ort": "ort new new_horizons/pluto_flyby_targeting --out OUT/o --pictures 1 --jobs 1",
    "mission": "mission new probe --fov-deg 20 --size 64x64 --no-compare --out OUT/m",
}


READ_ONLY_TOO = ("export", "chart", "kernels", "make-ck", "campaign", "schemas", "simulate", "process")


@contextlib.contextmanager
def files_below(size: int) -> Iterator[None]:
    """No file of this process, and of those that it starts, gets larger."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys, "dont_write_bytecode", True
        )  # Python would keep the first kB of a module it compiled
        patch.setenv("PYTHONDONTWRITEBYTECODE", "1")
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system of `SMALL` bytes."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SMALL}", "none", str(place)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("only root, where it may, mounts a small disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def check_refusal(name: str, out: Path, before: set[Path]) -> None:
    status, said, err = answer(COMMANDS[name].replace("OUT", str(out)).split())
    lines = [line for line in err.splitlines() if line]
    assert status in (2, 3), (status, said, err)
    assert "Traceback" not in said + err
    assert "unforeseen" not in said + err
    if status == 2:
        assert len(lines) == 1, err
        assert lines[0].startswith("error: ")
    left = set(out.rglob("*")) - before
    assert [p for p in left if p.name.startswith(".")] == []
    for path in left:
        if path.is_file() and path.suffix in (".json", ".csv", ".ecsv", ".tdm"):
            assert path.suffix != ".json" or json.loads(path.read_text())
            assert path.name != "result.json" or check_file(path).faults == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["export ecsv", "chart", "shape", "make-ck", "campaign", "simulate", "process"]
)
def test_files_that_cannot_grow(name, with_run, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with files_below(1000):
        check_refusal(name, out, set())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_disk_that_is_full_or_cannot_be_written(name, with_run, small_disk):
    older = small_disk / "older"
    older.write_bytes(bytes(SMALL))
    check_refusal(name, small_disk, {older})
    if name in READ_ONLY_TOO:
        subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
        check_refusal(name, small_disk, {older})
    assert older.stat().st_size == SMALL


@pytest.mark.slow
def test_results_that_stand_outlive_a_full_disk(with_run, small_disk):
    """Of an older run, nothing is lost and nothing half written, wherever the disk ends."""
    shutil.copytree(with_run / "run", small_disk / "out" / "r")
    kept = {p: p.read_bytes() for p in (small_disk / "out").rglob("*") if p.is_file()}
    free = shutil.disk_usage(small_disk).free
    (small_disk / "older").write_bytes(bytes(free))
    check_refusal("process", small_disk / "out", set((small_disk / "out").rglob("*")))
    for path, content in kept.items():
        standing = path.read_bytes()
        assert standing == content or path.suffix == ".json"  # a failure may be noted, whole
        if path.name == "result.json":
            assert check_file(path).faults == ()


# ---- Other people's umask and other users.


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_files_are_as_open_as_their_writer_wants(umask, mode, tmp_path):
    """They were readable to everybody, whatever was asked for."""
    before = os.umask(umask)
    try:
        write_text(tmp_path / "a.json", "{}")
        with FolderLock(tmp_path):
            locked = (tmp_path / ".session.lock").stat().st_mode & 0o777
    finally:
        os.umask(before)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == mode
    assert locked == tmp_path.stat().st_mode & 0o666  # who may write into the folder may hold it


def test_who_holds_a_folder_is_named(tmp_path):
    """User, host, process and since when, to whoever comes second: also to another user, who may not touch the lock."""
    code = (
        "import sys, time; from pathlib import Path; from opnav_workbench.session.folder_lock import FolderLock\n"
        f"lock = FolderLock(Path({str(tmp_path)!r})); print('held', flush=True); sys.stdin.read()"
    )
    environment = os.environ | {"LOGNAME": "maria"}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(SessionError) as refused:
            FolderLock(tmp_path)
        other.stdin.close()
    said = str(refused.value)
    assert f"is being written by maria, process {other.pid} on {socket.gethostname()} (since 20" in said
    assert "close the session there" in said


def test_a_lock_that_another_user_signed_is_told(tmp_path, monkeypatch):
    """His umask keeps us from asking the system; the lock's own words tell whose it is."""
    (tmp_path / ".session.lock").write_text(
        '{"pid": 7, "host": "elsewhere", "user": "maria", "since": "2030-01-01T00:00:00+00:00"}'
    )

    def refused(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("opnav_workbench.session.folder_lock._asked", refused)
    with pytest.raises(
        SessionError, match=r"Permission denied.*maria, process 7 on elsewhere.*Choose another folder"
    ):
        FolderLock(tmp_path)
