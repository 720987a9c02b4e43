"""Attitudes during an exposure: sampling, direction of drift and twist, shake, and the CK."""

import numpy as np
import pytest
import spiceypy

from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.mission import load_mission
from opnav_workbench.simulation.attitude_path import CameraMotion, kernel_path, moving_path, sample_path

ET = 4.8e8
LORRI = {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"}
MVIC = {"MISSION": "New Horizons", "INSTRU": "mvi", "SCANTYPE": "FRAMING"}


@pytest.fixture(scope="module", params=["LORRI", "MVIC", "mirrored"])
def camera(request):
    if request.param == "mirrored":  # OCAMS: +Y along pixel, +X along line, +Z to the sky
        return Camera(
            name="M",
            frame="M",
            instrument_id=-1,
            n_pixel=1024,
            n_line=1024,
            focal_length_mm=628.9,
            center_pixel_line=[512.0, 512.0],
            pixel_from_mm=[[117.6, 0.0], [0.0, 117.6]],
            focal_from_camera=[[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        )
    return load_mission("new_horizons").camera_for(LORRI if request.param == "LORRI" else MVIC)


@pytest.fixture(scope="module")
def attitude():
    return np.array(spiceypy.eul2m(0.7, 1.1, -2.0, 3, 1, 3))


def test_a_steady_camera_has_one_sample(camera, attitude):
    path = moving_path(camera, attitude, ET, 5.0, motion=CameraMotion(rate_px_s=(0.003, 0.0)))
    assert path.is_still
    assert path.et.tolist() == [ET]
    assert path.weights.tolist() == [1.0]
    assert np.array_equal(path.middle, attitude)


def test_drift_moves_the_sky_at_its_rate(camera, attitude):
    rate, exposure_s = np.array([1.5, -0.8]), 4.0
    path = moving_path(camera, attitude, ET, exposure_s, motion=CameraMotion(rate_px_s=tuple(rate)))
    assert len(path) % 2 == 1
    assert path.middle == pytest.approx(attitude, abs=1e-15)
    assert path.weights.sum() == pytest.approx(1.0)
    assert np.linalg.norm(np.diff(path.offsets_px(camera), axis=0), axis=1).max() <= 0.25
    # The middles of equal parts of the exposure: the first stands half a part after its start.
    count = len(path)
    assert path.et[0] - ET == pytest.approx(-0.5 * exposure_s * (1.0 - 1.0 / count), abs=1e-7)
    # But for the distortion's slope, 3 % at most.
    assert path.offsets_px(camera) == pytest.approx((path.et - ET)[:, None] * rate, abs=0.05)


def test_twist_turns_the_sky_from_pixel_toward_line(camera, attitude):
    path = moving_path(camera, attitude, ET, 2.0, motion=CameraMotion(twist_rate_deg_s=0.05))
    corner = np.array([camera.n_pixel - 1.0, camera.center_pixel_line[1]])
    direction = camera.unproject(corner[None]) @ path.middle
    track = path.places(camera, direction)[0]
    arm = corner[0] - camera.center_pixel_line[0]
    assert track[-1, 1] - track[0, 1] == pytest.approx(
        arm * np.radians(0.05) * (path.et[-1] - path.et[0]), rel=0.03
    )
    assert np.ptp(track[:, 0]) < 0.05 * np.ptp(track[:, 1])
    assert path.offsets_px(camera) == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(np.diff(track, axis=0), axis=1).max() <= 0.25


def test_shake_has_its_size_is_seeded_and_resolved(attitude):
    camera = load_mission("new_horizons").camera_for(LORRI)
    motion = CameraMotion(jitter_px=1.0, jitter_hz=8.0)
    first, again, other = (moving_path(camera, attitude, ET, 3.0, motion=motion, seed=s) for s in (3, 3, 4))
    assert np.array_equal(first.camera_from_j2000, again.camera_from_j2000)
    assert not np.array_equal(first.camera_from_j2000[: len(other)], other.camera_from_j2000[: len(first)])
    rms = [
        moving_path(camera, attitude, ET, 20.0, motion=motion, seed=s).offsets_px(camera).std(axis=0)
        for s in range(12)
    ]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(1.0, rel=0.1)
    times = first.et - ET
    dense = motion.offsets(np.linspace(times[0], times[-1], 4001), 3)[:, :2]
    sampled = np.stack(
        [
            np.interp(np.linspace(times[0], times[-1], 4001), times, motion.offsets(times, 3)[:, i])
            for i in (0, 1)
        ]
    )
    assert np.abs(dense.T - sampled).max() < 0.05  # px: no swing is missed


def test_path_along_any_attitude_and_misalignment(camera, attitude):
    spin = np.array([0.0, 0.0, 2e-4])  # rad/s about J2000 z

    def at(time):
        return attitude @ rotation_from_vector(-(time - ET) * spin)

    path = sample_path(camera, at, ET, 1.0)
    for time, matrix in zip(path.et, path.camera_from_j2000, strict=True):
        assert matrix == pytest.approx(at(time), abs=1e-12)
    turn = rotation_from_vector([1e-4, -2e-4, 3e-4])
    assert path.turned(turn).middle == pytest.approx(turn @ attitude, abs=1e-14)
    moving = np.repeat((camera.boresight @ attitude)[None, None], len(path), axis=1)
    fixed = path.places(camera, [camera.boresight @ attitude])
    assert path.places(camera, moving) == pytest.approx(fixed, abs=1e-9)


def test_runaway_rates_are_cut_off(attitude):
    camera = load_mission("new_horizons").camera_for(LORRI)
    path = moving_path(camera, attitude, ET, 60.0, motion=CameraMotion(rate_px_s=(500.0, 0.0)))
    assert len(path) == 4001


def test_attitudes_come_from_the_ck():
    camera = load_mission("new_horizons").camera_for(LORRI)
    with KernelSet("new_horizons/pluto_opnav"):
        et = et_from_utc("2015-04-09T12:00:00")
        path = kernel_path(camera, et, 0.5)
        assert path.middle == pytest.approx(spiceypy.pxform("J2000", "NH_LORRI", et), abs=1e-15)
        drifting = kernel_path(camera, et, 10.0, motion=CameraMotion(rate_px_s=(0.4, 0.0)))
        expected = [spiceypy.pxform("J2000", "NH_LORRI", t) for t in drifting.et]
        assert np.abs(drifting.camera_from_j2000 - expected).max() < 0.2 * 10.0 * 5e-6
        assert drifting.middle == pytest.approx(path.middle, abs=1e-15)
        with pytest.raises(KernelError):
            kernel_path(camera, et_from_utc("2012-01-01T00:00:00"), 1.0)
