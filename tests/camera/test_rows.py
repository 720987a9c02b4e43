"""Rolling shutters and line scanners: where a direction falls, against a search over times that knows no derivative."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from opnav_workbench.camera import Camera, RowTiming, read_out, row_sweep
from opnav_workbench.errors import CameraError
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir

FILE = kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml"
ROLLING = RowTiming(-2e-3)  # the last line first, in 2 s
SCAN = RowTiming(4e-3, 511.0)
RATE = np.array([2e-3, 1.1e-3, 3e-3])  # rad/s about the camera's axes: 200 px along line, and a twist


def attitude(time_s: float) -> np.ndarray:
    """A turn that speeds up, on an attitude of its own."""
    turn = Rotation.from_rotvec(RATE * time_s + np.array([0.0, 2e-5, -1e-4]) * time_s**2)
    return (turn * Rotation.from_rotvec([0.3, -1.0, 0.2])).as_matrix()


def scanning(time_s: float) -> np.ndarray:
    """A turn about the axis along pixel by some 1.02 px a line."""
    turn = Rotation.from_rotvec(np.array([1.02 * 4.96e-6 / 4e-3, 2e-5, 1e-5]) * time_s)
    return (turn * Rotation.from_rotvec([0.3, -1.0, 0.2])).as_matrix()


def camera_with(timing: RowTiming, motion) -> Camera:
    camera = replace(Camera.from_yaml(FILE), rows=timing)
    sweep = row_sweep(timing, camera.n_line, camera.pixel_scale_rad, motion)
    return replace(camera, sweep=sweep)


def searched(camera: Camera, timing: RowTiming, motion, direction: np.ndarray) -> np.ndarray:
    """Return where a direction (frame of the attitudes) falls: the line at whose time it is there, by bisection."""
    rest = replace(camera, rows=None, sweep=None)

    def place(line: float) -> np.ndarray:
        return rest.project(motion((line - 511.5) * timing.line_time_s) @ direction)

    def off(line: float) -> float:
        return place(line)[1] - (line if timing.detector_line is None else timing.detector_line)

    line = brentq(off, -300.0, 1300.0, xtol=1e-11)
    return np.array([place(line)[0], line])


@pytest.mark.parametrize(("timing", "motion"), [(ROLLING, attitude), (SCAN, scanning)])
def test_a_direction_falls_where_its_line_is_exposed(timing, motion):
    camera = camera_with(timing, motion)
    points = np.random.default_rng(1).uniform(0.0, 1023.0, (60, 2))
    in_camera = camera.unproject(points)
    np.testing.assert_allclose(camera.project(in_camera), points, atol=1e-7)
    for point, direction in zip(points[:12], in_camera @ motion(0.0), strict=False):
        np.testing.assert_allclose(searched(camera, timing, motion, direction), point, atol=2e-3)
    shift = np.abs(replace(camera, sweep=None).project(in_camera) - points).max()
    assert shift > 50.0  # a camera at rest is far off: the test can fail


@pytest.mark.parametrize(("timing", "motion"), [(ROLLING, attitude), (SCAN, scanning)])
def test_jacobians_are_those_of_differences(timing, motion):
    camera = camera_with(timing, motion)
    points = np.random.default_rng(2).uniform(0.0, 1023.0, (20, 2))
    vectors = camera.unproject(points)
    steps = 1e-7 * np.eye(3)
    by_steps = (
        np.stack([camera.project(vectors + s) - camera.project(vectors - s) for s in steps], axis=-1) / 2e-7
    )
    scale = np.abs(by_steps).max()
    np.testing.assert_allclose(camera.project_jacobian(vectors) / scale, by_steps / scale, atol=1e-6)
    ahead = 0.01 * np.eye(2)
    by_steps = (
        np.stack([camera.unproject(points + s) - camera.unproject(points - s) for s in ahead], axis=-1) / 0.02
    )
    np.testing.assert_allclose(camera.unproject_jacobian(points), by_steps, atol=2e-11)


@pytest.mark.parametrize(("timing", "motion"), [(ROLLING, attitude), (SCAN, scanning)])
def test_a_camera_mounted_otherwise_flies_the_same_path(timing, motion):
    mounted = Rotation.from_rotvec([2e-4, -3e-4, 6e-3]).as_matrix()
    kept = camera_with(timing, motion)
    camera = kept.standing(mounted @ motion(0.0))
    points = np.random.default_rng(3).uniform(100.0, 900.0, (12, 2))
    directions = camera.unproject(points) @ mounted @ motion(0.0)
    places = [searched(camera, timing, lambda t: mounted @ motion(t), d) for d in directions]
    np.testing.assert_allclose(places, points, atol=2e-3)
    # turned in the camera's frame as before, a path of its own is flown: the test can fail
    as_before = kept.project(directions @ (mounted @ motion(0.0)).T)
    assert np.nanmax(np.abs(as_before - points)) > 0.1
    there_and_back = camera.standing(motion(0.0))
    np.testing.assert_allclose(there_and_back.sweep.turn_rad, kept.sweep.turn_rad, atol=1e-15)
    assert kept.standing(motion(0.0)) is kept


@pytest.mark.parametrize(("timing", "motion"), [(ROLLING, attitude), (SCAN, scanning)])
def test_the_attitude_s_jacobian_turns_all_lines_alike(timing, motion):
    middle = motion(0.0)
    camera = camera_with(timing, motion)
    directions = camera.unproject(np.random.default_rng(4).uniform(100.0, 900.0, (20, 2))) @ middle

    def places(turn: np.ndarray) -> np.ndarray:
        stands = Rotation.from_rotvec(turn).as_matrix() @ middle
        return camera.standing(stands).project(directions @ stands.T)

    steps = 1e-6 * np.eye(3)
    by_steps = np.stack([places(step) - places(-step) for step in steps], axis=-1) / 2e-6
    jacobian = camera.attitude_jacobian(directions @ middle.T)
    np.testing.assert_allclose(jacobian, by_steps, atol=1e-4 * np.abs(by_steps).max())


def test_behind_the_camera_is_nowhere():
    camera = camera_with(ROLLING, attitude)
    assert np.isnan(camera.project(-camera.boresight)).all()
    assert np.isnan(camera.project(np.full((2, 3), np.nan))).all()


def test_a_camera_that_rests_sees_as_one_without_rows():
    plain = Camera.from_yaml(FILE)
    points = np.random.default_rng(3).uniform(0.0, 1023.0, (20, 2))
    still = camera_with(ROLLING, lambda _: np.eye(3))
    np.testing.assert_allclose(still.project(plain.unproject(points)), points, atol=1e-9)
    with pytest.raises(CameraError, match="the camera does not move during the picture; give the CK"):
        camera_with(SCAN, lambda _: np.eye(3))


def test_a_camera_file_says_when_lines_are_exposed(tmp_path):
    camera = replace(Camera.from_yaml(FILE), rows=SCAN)
    camera.to_yaml(tmp_path / "scan.yaml")
    assert Camera.from_yaml(tmp_path / "scan.yaml").rows == SCAN
    binned = read_out(camera, binning=(2, 2), first=(0, 512))
    assert binned.rows == RowTiming(8e-3, -0.75)
    text = (tmp_path / "scan.yaml").read_text()
    (tmp_path / "scan.yaml").write_text(re.sub("line_time_s: .*", "line_time_s: 0", text))
    with pytest.raises(CameraError, match="line_time_s is 0"):
        Camera.from_yaml(tmp_path / "scan.yaml")


def test_a_header_tells_lines_and_line_time(tmp_path):
    """One camera file for scans of any length and rate."""
    replace(Camera.from_yaml(FILE), rows=RowTiming(-4e-3, 511.0)).to_yaml(tmp_path / "scan.yaml")
    readout = {
        "n_pixel": "LINE_SAMPLES",
        "n_line": "LINES",
        "line_time": "LINE_TIME",
        "line_time_scale": 1e-3,
    }
    mission = {
        "name": "scans", "spacecraft": {"name": "PROBE", "id": -999}, "clock_id": -999, "bus_frame": "PROBE_BUS",
        "reference_body": "SUN", "cameras": [{"file": "scan.yaml", "match": {}, "readout": readout}],
        "keywords": {"exposure_s": "EXPTIME"},
    }  # fmt: skip
    (tmp_path / "mission.yaml").write_text(yaml.safe_dump(mission))
    scans = load_mission(tmp_path / "mission.yaml")
    header = {"LINES": 5000, "LINE_SAMPLES": 1024, "LINE_TIME": "2.5 <ms>"}
    camera = scans.camera_for(header)
    assert camera.n_line == 5000
    assert camera.rows == RowTiming(-2.5e-3, 511.0)
    assert scans.camera_as_read("scan", scans.readout_told(header)).rows == camera.rows
    with pytest.raises(
        CameraError, match=r"LINE_TIME = 'none' in the header is no time from a line to the next one"
    ):
        scans.camera_for(header | {"LINE_TIME": "none"})
