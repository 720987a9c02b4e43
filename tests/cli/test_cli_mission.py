"""``opnav mission``: a new mission from an instrument kernel and a picture whose detector lies as no kernel says."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from opnav_workbench.camera import Camera, RowTiming
from opnav_workbench.cli import app
from opnav_workbench.commissioning.header_words import header_words
from opnav_workbench.commissioning.orientation import eight_cameras, orientation_by_limb
from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.kernels import KernelSet, packaged_leap_seconds
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation import load_picture_scenario, simulate
from opnav_workbench.simulation.truth import read_truth
from opnav_workbench.targets import TargetState

sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile import answer

IK = r"""KPL/IK
\begindata
INS-555100_INSTRUMENT_NAME = 'PROBE_CAM'
INS-555100_FOV_FRAME = 'PROBE_CAM'
INS-555100_BORESIGHT = ( 0.0 0.0 1.0 )
INS-555100_FOV_REF_VECTOR = ( 1.0 0.0 0.0 )
INS-555100_FOV_CLASS_SPEC = 'ANGLES'
INS-555100_PIXEL_SAMPLES = ( 512 )
INS-555100_PIXEL_LINES = ( 512 )
INS-555100_PIXEL_SIZE = ( 13.0 )
INS-555100_FOCAL_LENGTH = ( 50.0 )
INS-555100_F/RATIO = ( 2.0 )
\begintext
"""
PIXEL_ALONG_MINUS_Y = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # and mirrored


def run(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    return result.exit_code, " ".join(result.output.split())


def patch_of_sky(path):
    """A catalog of a patch around the Pleiades: an index of it is made in no time."""
    rng = np.random.default_rng(8)
    dec, east = 24.12 + rng.uniform(-7.0, 7.0, 300), rng.uniform(-7.0, 7.0, 300)
    ra = 56.75 + east / np.cos(np.radians(dec))
    mag = 9.0 + np.log10(rng.uniform(1e-3, 1.0, 300)) / 0.5
    np.savez(path, ra_deg=ra, dec_deg=dec, mag=mag, epoch_jyear=2030.0, pmra_mas_yr=0.0, pmdec_mas_yr=0.0)
    return ("--catalog", f"npz:{path}")


@pytest.mark.slow
def test_an_afternoon_of_a_new_mission_is_two_commands_and_no_yaml(tmp_path, monkeypatch):
    """From an IK that does not say how the detector lies, and a picture that shows it mirrored and turned by 90 deg."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "probe.ti").write_text(IK, encoding="ascii")
    sky = patch_of_sky(tmp_path / "sky.npz")
    assert (
        run("mission", "new", "told", "--ik", "probe.ti", *sky)[0] == 0
    )  # a picture simulated as the guess has it
    flown = tmp_path / "flown"
    shutil.copytree(tmp_path / "told", flown)
    camera = Camera.from_yaml(flown / "cameras/camera.yaml")
    assert {"focal_from_camera", "distortion", "center_pixel_line"} < {
        guess.field for guess in camera.guesses
    }
    replace(camera, focal_from_camera=PIXEL_ALONG_MINUS_Y).to_yaml(flown / "cameras/camera.yaml")
    scenario = yaml.safe_load((flown / "pictures/star_fields.yaml").read_text(encoding="utf-8"))
    scenario["attitude"]["actual"] = {"source": "error", "shift_px": [9.0, -6.0], "twist_deg": 0.1}
    simulate(
        load_picture_scenario(scenario | {"mission": str(flown), "kernels": str(flown / "star_fields.yaml")}),
        flown,
        jobs=1,
    )

    code, said = run("mission", "new", "probe", "--ik", "probe.ti", "--image", "flown/star_field.fit", *sky)
    assert code == 0
    assert "the picture is mirrored" in said
    assert "solved with" in said
    made = Camera.from_yaml("probe/cameras/camera.yaml")
    np.testing.assert_array_equal(made.focal_from_camera, PIXEL_ALONG_MINUS_Y)
    assert "focal_from_camera" not in [guess.field for guess in made.guesses]
    assert made.confirmed_by.startswith("star_field.fit: solved with")
    assert (tmp_path / "probe/simulated/star_field_log.png").is_file()

    code, said = run("process", "flown/star_field.fit", "--mission", "probe", "--out", "out", *sky)
    assert (code, "ok" in said) == (0, True)
    pointing = json.loads((tmp_path / "out/star_field/result.json").read_text(encoding="utf-8"))["pointing"]
    found = matrix_from_quaternion(pointing["quaternion_camera_from_j2000"])
    between = found @ read_truth("flown/star_field.fit").camera_from_j2000.T
    error = 0.5 * np.array([(between - between.T)[row] for row in ((2, 1), (0, 2), (1, 0))])
    assert error @ np.linalg.solve(np.array(pointing["covariance_rad2"]), error) < 25.0  # chance in 10^5


def test_bad_requests_are_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments, message in (
        (("Probe!",), "is no name for a mission"),
        (("probe",), "how many pixels"),
        (("probe", "--size", "wide"), "give pixels and lines"),
        (("probe", "--size", "100x100"), "give an instrument kernel"),
    ):
        with pytest.raises(MissionError, match=message):
            run("mission", "new", *arguments)
    assert not list(tmp_path.iterdir())


def test_missions_and_what_their_cameras_rest_on_are_shown():
    assert "voyager1" in run("mission", "list")[1]
    code, said = run("mission", "show", "dawn")
    assert code == 0
    assert "no picture or label is known to have confirmed this camera" in said  # FC1
    assert "confirmed by label and image support data of FC21A0038582" in said
    assert "guessed psf" in said


def test_words_of_headers_are_found_and_what_they_leave_open_is_said():
    words = header_words(
        {
            "INSTRUMENT_HOST_NAME": "DAWN", "INSTRUMENT_ID": "FC2", "EXPOSURE_DURATION": 1800.0, "TARGET_NAME": "1 CERES",
            "START_TIME": "2015-06-19T16:15:46.345", "STOP_TIME": "2015-06-19T16:15:48.337",
        }
    )  # fmt: skip
    assert words.keywords["exposure_scale"] == 1e-3  # 1800 over the 2 s from start to stop
    assert words.exposure_s == pytest.approx(1.8)
    assert words.match == {"INSTRUMENT_ID": "FC2"}
    assert {origin.how for origin in words.origins} == {"known", "derived"}
    (guess,) = [
        o for o in header_words({"EXPOSURE": 2.0, "UTC": "2031-01-01"}).origins if o.field == "exposure_s"
    ]
    assert (guess.how, guess.text) == ("guessed", "EXPOSURE = 2, taken as s")


class _Picture:
    """As much of a session's context as a limb needs."""

    def __init__(self, camera, signal_dn):
        self.camera, self.signal_dn = camera, signal_dn


@pytest.mark.parametrize("way", range(8))
def test_a_gibbous_disk_tells_which_of_eight_ways_the_detector_lies(way):
    """The truth is painted sphere by sphere of light, with limb darkening that the comparison does not have."""
    pinhole = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    pinhole = replace(pinhole, n_pixel=200, n_line=200, center_pixel_line=[99.5, 99.5])
    true = eight_cameras(pinhole)[way]
    rock = TargetState(
        "ROCK", np.array([300.0, -150.0, 1e6]), np.full(3, 400.0), sun_position_km=np.array([1e8, 4e7, -6e7])
    )
    observer = Observer(np.zeros(3), np.zeros(3), "kernels")
    line, pixel = np.mgrid[:200, :200]
    rays = true.unproject(np.stack([pixel, line], axis=-1).reshape(-1, 2).astype(float))
    along = rays @ rock.position_km
    root = along**2 - rock.position_km @ rock.position_km + 400.0**2
    normal = (rays * (along - np.sqrt(np.clip(root, 0.0, None)))[:, None] - rock.position_km) / 400.0
    sun = rock.sun_position_km / np.linalg.norm(rock.sun_position_km)
    light = np.where(root > 0.0, np.clip(normal @ sun, 0.0, None) ** 0.7, 0.0)
    image = 1000.0 * light.reshape(200, 200) + np.random.default_rng(3).normal(0.0, 5.0, (200, 200))
    found = orientation_by_limb(_Picture(pinhole, image), rock, observer, np.eye(3))
    assert found is not None
    np.testing.assert_array_equal(found.camera.focal_from_camera, true.focal_from_camera)
    assert found.changed == (way != 0)
    assert found.mirrored == (np.linalg.det(true.focal_from_camera) < 0.0)


def test_attitude_from_the_header_needs_no_frame_in_the_kernels(demo_truths):
    """A set without the camera's frame kernel, and a picture whose header tells the attitude."""
    with packaged_leap_seconds() as leap_seconds, KernelSet(leap_seconds):
        for attitude in ("header", "auto"):
            session = ImageSession.open(demo_truths[0].picture, "new_horizons", attitude=attitude)
            assert session.inputs.attitude_source == "header"


@pytest.mark.slow
def test_a_new_mission_may_have_a_rolling_shutter(tmp_path):
    out = tmp_path / "m"
    told = answer(f"mission new probe --fov-deg 10 --size 64x64 --line-time-s -0.001 --out {out}".split())
    assert told[0] == 0, told
    assert load_mission(out).camera_named("camera").rows == RowTiming(-0.001)
    refused = answer(
        f"mission new probe --fov-deg 10 --size 64x64 --line-time-s 0 --out {tmp_path / 'n'}".split()
    )
    assert refused[0] == 2
    assert refused[2].startswith("error: line_time_s is 0")


@pytest.mark.slow
def test_a_new_mission_says_when_nothing_solves_its_simulated_picture(tmp_path, monkeypatch):
    """A small lens sees no star in a thousandth of a second, however right its files are."""
    monkeypatch.chdir(tmp_path)
    numbers = ("--fov-deg", "5", "--size", "256x256", *patch_of_sky(tmp_path / "sky.npz"), "--line-scan")
    for line_time_s, told in (("0.001", True), ("0.5", False)):
        code, said = run("mission", "new", f"a{line_time_s[-1]}", *numbers, "--line-time-s", line_time_s)
        assert (code, "nothing solves this picture" in said) == (0, told)


@pytest.mark.slow
def test_a_new_mission_may_be_a_line_scanner(tmp_path, monkeypatch):
    """The scan flown has pixels along -Y and lines against +X, which neither the IK nor the guess says."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan.ti").write_text(IK, encoding="ascii")
    sky = patch_of_sky(tmp_path / "sky.npz")
    scanner = ("--ik", "scan.ti", "--line-scan", *sky)
    with pytest.raises(MissionError, match="give it: --line-time-s"):
        run("mission", "new", "told", *scanner)
    scanner += ("--line-time-s", "0.1")
    code, said = run("mission", "new", "told", *scanner)
    assert (code, "opnav kernels make told/star_fields.yaml" in said) == (0, True)  # a scan wants its motion
    assert load_mission("told").camera_named("camera").rows == RowTiming(0.1, 255.5)
    assert load_mission("told").camera_for({"NAXIS2": 300}).n_line == 300  # scans have any length
    shutil.copytree("told", "flown")
    camera = Camera.from_yaml("flown/cameras/camera.yaml")
    replace(camera, focal_from_camera=PIXEL_ALONG_MINUS_Y).to_yaml("flown/cameras/camera.yaml")
    plan = yaml.safe_load(Path("flown/star_fields.yaml").read_text(encoding="utf-8"))
    plan["instruments"][0]["focal_from_camera"] = PIXEL_ALONG_MINUS_Y.tolist()
    Path("flown/star_fields.yaml").write_text(yaml.safe_dump(plan), encoding="utf-8")
    scenario = yaml.safe_load(Path("flown/pictures/star_fields.yaml").read_text(encoding="utf-8"))
    scenario |= {"mission": "flown", "kernels": "flown/star_fields.yaml"}
    simulate(load_picture_scenario(scenario), Path("flown"), jobs=1)
    assert run("kernels", "make", "flown/star_fields.yaml", "--out", "kernels")[0] == 0

    flown = ("--image", "flown/star_field.fit", "--kernels", "kernels/star_fields.tm")
    code, said = run("mission", "new", "probe", *scanner, *flown)
    assert code == 0
    assert "lie where the motion of the scan puts them" in said
    assert "the picture is mirrored" in said
    made = Camera.from_yaml("probe/cameras/camera.yaml")
    np.testing.assert_array_equal(made.focal_from_camera, PIXEL_ALONG_MINUS_Y)
    assert (tmp_path / "probe/simulated/star_field.fit").is_file()
    code, said = run(
        "process", "flown/star_field.fit", "--mission", "probe", *flown[2:], "--out", "out", *sky
    )
    assert (code, "ok" in said) == (0, True)
