"""SPK files: states come back through SPICE, here and in a new process; bad input leaves nothing behind."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import spiceypy

from opnav_workbench.constants import HOUR_S
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.writing import SpkSegment, write_spk

GM_KM3_S2 = 975.5
POSITION_TOLERANCE_KM = 1e-6
VELOCITY_TOLERANCE_KM_S = 1e-12
TARGET, CENTER = -999, 9


def orbit(et: np.ndarray) -> np.ndarray:
    """States on an ellipse of 6.4 days: SPICE's own two-body propagation."""
    elements = [17000.0, 0.1, 0.3, 1.0, 2.0, 0.5, 0.0, GM_KM3_S2]
    return np.array([spiceypy.conics(elements, t) for t in et])


@pytest.fixture
def segment() -> SpkSegment:
    et = np.arange(0.0, 240.0 * HOUR_S, 6.0 * HOUR_S)
    return SpkSegment(TARGET, CENTER, et, orbit(et))


@pytest.fixture(autouse=True)
def clean_pool():
    spiceypy.kclear()
    yield
    spiceypy.kclear()


def read(path: Path, et: np.ndarray) -> np.ndarray:
    spiceypy.furnsh(str(path))
    return np.array([spiceypy.spkgeo(TARGET, t, "J2000", CENTER)[0] for t in et])


def test_states_at_nodes(tmp_path, segment):
    write_spk(tmp_path / "a.bsp", [segment])
    states = read(tmp_path / "a.bsp", segment.et)
    assert np.abs(states[:, :3] - segment.states[:, :3]).max() < POSITION_TOLERANCE_KM
    assert np.abs(states[:, 3:] - segment.states[:, 3:]).max() < VELOCITY_TOLERANCE_KM_S


@pytest.mark.parametrize(
    ("interpolation", "kind", "tolerance_km"), [("hermite", 13, 2e-4), ("lagrange", 9, 1.0)]
)
def test_states_between_nodes(tmp_path, segment, interpolation, kind, tolerance_km):
    write_spk(
        tmp_path / "a.bsp", [SpkSegment(TARGET, CENTER, segment.et, segment.states, "J2000", interpolation)]
    )
    et = np.linspace(segment.et[3], segment.et[-4], 501)
    error_km = np.linalg.norm(read(tmp_path / "a.bsp", et)[:, :3] - orbit(et)[:, :3], axis=1).max()
    assert error_km < tolerance_km
    _, summary, _ = spiceypy.spksfs(TARGET, et[0], 40)
    assert spiceypy.dafus(summary, 2, 6)[1][3] == kind


def test_states_in_a_new_process(tmp_path, segment):
    path = tmp_path / "a.bsp"
    write_spk(path, [segment])
    code = (
        "import sys, json, spiceypy; spiceypy.furnsh(sys.argv[1]);"
        "print(json.dumps([list(spiceypy.spkgeo(-999, t, 'J2000', 9)[0]) for t in json.loads(sys.argv[2])]))"
    )
    arguments = [sys.executable, "-c", code, str(path), json.dumps(segment.et.tolist())]
    states = np.array(json.loads(subprocess.run(arguments, check=True, capture_output=True).stdout))
    assert np.abs(states[:, :3] - segment.states[:, :3]).max() < POSITION_TOLERANCE_KM


def test_later_segment_wins_and_comment_is_kept(tmp_path, segment):
    shifted = segment.states + np.array([1000.0, 0, 0, 0, 0, 0])
    second = SpkSegment(TARGET, CENTER, segment.et[4:9], shifted[4:9])
    write_spk(tmp_path / "a.bsp", [segment, second], "JPL Horizons\n\nof today µ")
    states = read(tmp_path / "a.bsp", segment.et[[2, 6]])
    assert states[:, 0] - segment.states[[2, 6], 0] == pytest.approx([0.0, 1000.0], abs=POSITION_TOLERANCE_KM)
    handle = spiceypy.dafopr(str(tmp_path / "a.bsp"))
    count, lines, done = spiceypy.dafec(handle, 10, 100)
    spiceypy.dafcls(handle)
    assert [line.strip() for line in lines[:count]] == ["JPL Horizons", "", "of today ?"]
    assert done


def test_two_states_are_enough(tmp_path):
    et = np.array([0.0, 60.0])
    states = np.array([[1.0, 2.0, 3.0, 0.1, 0.0, 0.0], [7.0, 2.0, 3.0, 0.1, 0.0, 0.0]])
    write_spk(tmp_path / "a.bsp", [SpkSegment(TARGET, CENTER, et, states)])
    assert read(tmp_path / "a.bsp", np.array([30.0]))[0, 0] == pytest.approx(4.0, abs=1e-12)


def test_replaces_an_older_file_and_gives_the_same_bytes(tmp_path, segment):
    write_spk(tmp_path / "a.bsp", [segment], "one")
    write_spk(tmp_path / "a.bsp", [segment], "two")
    write_spk(tmp_path / "b.bsp", [segment], "two")
    a, b = ((tmp_path / name).read_bytes() for name in ("a.bsp", "b.bsp"))
    assert a.replace(b"a.bsp", b"b.bsp") == b
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.bsp", "b.bsp"]


def _changed(segment: SpkSegment, **changes) -> dict:
    values = {"target": TARGET, "center": CENTER, "et": segment.et, "states": segment.states}
    return values | changes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {"et": s.et[::-1]}, "must increase"),
        (lambda s: {"et": np.r_[s.et[0], s.et[:-1]]}, "must increase: number 1 is 0.0, after 0.0"),
        (lambda s: {"et": s.et[:1], "states": s.states[:1]}, "1 epochs, at least 2"),
        (lambda s: {"et": np.where(s.et == s.et[3], np.nan, s.et)}, r"et\[3\] is not finite"),
        (
            lambda s: {"states": np.where(s.states == s.states[5, 2], np.inf, s.states)},
            r"states\[5, 2\] is not finite",
        ),
        (lambda s: {"states": s.states[:, :3]}, "shape"),
        (lambda s: {"states": s.states[1:]}, "shape"),
        (lambda s: {"center": TARGET}, "same body"),
        (lambda s: {"interpolation": "spline"}, "neither hermite nor lagrange"),
    ],
)
def test_states_that_make_no_segment(segment, change, message):
    with pytest.raises(KernelError, match=message) as caught:
        SpkSegment(**_changed(segment, **change(segment)))
    assert "\n" not in str(caught.value)


def test_no_segments_unknown_frame_unwritable_folder(tmp_path, segment):
    with pytest.raises(KernelError, match="no segments"):
        write_spk(tmp_path / "a.bsp", [])
    odd = SpkSegment(TARGET, CENTER, segment.et, segment.states, "NO_SUCH_FRAME")
    with pytest.raises(KernelError, match="NO_SUCH_FRAME"):
        write_spk(tmp_path / "a.bsp", [odd])
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(KernelError, match="cannot write"):
        write_spk(tmp_path / "file" / "a.bsp", [segment])
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_read_only_folder(tmp_path, segment):
    tmp_path.chmod(0o555)
    try:
        with pytest.raises(KernelError, match="cannot write"):
            write_spk(tmp_path / "a.bsp", [segment])
    finally:
        tmp_path.chmod(0o755)


def open_files() -> list[str]:
    """Files this process holds open, deleted ones included."""
    links = Path("/proc/self/fd")
    if not links.is_dir():
        pytest.skip("open files are listed on Linux only")
    return [str(link.readlink()) for link in links.iterdir() if link.is_symlink()]


def test_failure_inside_spice_leaves_no_file_and_no_handle(tmp_path, segment, monkeypatch):
    target = tmp_path / "a.bsp"
    write_spk(target, [segment])
    before = target.read_bytes()

    def broken(*args):
        spiceypy.bodvcd(424242, "RADII", 3)  # any SPICE error, raised while the new file is open

    monkeypatch.setattr(spiceypy, "spkw13", broken)
    with pytest.raises(KernelError):
        write_spk(target, [segment, segment])
    assert target.read_bytes() == before
    assert list(tmp_path.iterdir()) == [target]
    assert not [name for name in open_files() if str(tmp_path) in name]
    assert not spiceypy.failed()


def test_span_within_the_states(tmp_path, segment):
    first, last = 30.0 * HOUR_S, 100.0 * HOUR_S
    part = SpkSegment(TARGET, CENTER, segment.et, segment.states, span_et=(first, last))
    write_spk(tmp_path / "part.bsp", [part])
    assert list(spiceypy.spkcov(str(tmp_path / "part.bsp"), TARGET)) == [first, last]
    truth = orbit(np.array([first]))
    assert np.abs(read(tmp_path / "part.bsp", np.array([first])) - truth)[0, :3].max() < 1e-3
    with pytest.raises(KernelError, match="is not within the states"):
        SpkSegment(TARGET, CENTER, segment.et, segment.states, span_et=(-1.0, last))
