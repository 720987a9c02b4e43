"""``opnav kernels make-ck`` and ``geometry`` as a user types them."""

import json
import shutil

import numpy as np
import pytest
import spiceypy
import typer
from typer.testing import CliRunner

from opnav_workbench.camera.support_data import read_support_data
from opnav_workbench.cli.kernels import geometry, make_ck, make_isd
from opnav_workbench.errors import CameraError, KernelError, SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.scene import body_target, observer_from_kernels, predict_body
from opnav_workbench.session import ImageSession, support_data_of_result

WIDE = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
APPROACH = ("new_horizons/pluto_approach", "--mission", "new_horizons")
EPOCH = ("--time", "2015-07-09T04:29:00")

app = typer.Typer(rich_markup_mode="rich")
app.command()(geometry)
app.command("make-ck")(make_ck)
app.command("make-isd")(make_isd)


def run(*arguments, fails=None):
    answer = CliRunner().invoke(app, [str(a) for a in arguments], env=WIDE)
    if fails is None:
        assert answer.exit_code == 0, answer.output
        return answer.output
    assert isinstance(answer.exception, fails), answer.output
    return str(answer.exception)


@pytest.fixture(scope="module")
def run_dir(demo_truths, tmp_path_factory):
    """A run folder with one solved picture and one that failed."""
    folder = tmp_path_factory.mktemp("run")
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[1].picture, "new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
        session.save(folder / "solved")
        ImageSession.open(demo_truths[0].picture, "new_horizons").save(folder / "untouched")
    return folder


@pytest.mark.parametrize("command", ["geometry", "make-ck"])
def test_help_has_an_example(command):
    assert f"opnav kernels {command} " in " ".join(run(command, "--help").split())


def test_geometry_shows_the_paper_s_epoch():
    text = run("geometry", *APPROACH, "--camera", "lorri_1x1", *EPOCH)
    assert "NEW HORIZONS" in text
    assert "State relative to PLUTO, J2000" in text
    rows = {line[2:27].strip(): line[27:].split() for line in text.splitlines()}
    assert rows["diameter, px"][0] == "75.819"
    assert rows["phase, deg"][0].startswith("15.1")
    assert "CHARON" in text


def test_geometry_as_json():
    text = run(
        "geometry",
        *APPROACH,
        "--camera",
        "LORRI 4x4",
        *EPOCH,
        "--targets",
        "NIX, PLUTO",
        "--json",
        "--center",
        "SUN",
    )
    report = json.loads(text)
    assert [b["name"] for b in report["bodies"]] == ["NIX", "PLUTO"]
    assert report["center"] == "SUN"
    assert report["bodies"][1]["diameter_px"] == pytest.approx(75.82 / 4, abs=0.01)
    with KernelSet(APPROACH[0]):
        state, _ = spiceypy.spkezr("-98", report["et"], "J2000", "NONE", "SUN")
    assert report["spacecraft_km"] == pytest.approx(state[:3], abs=1e-6)


def test_geometry_without_a_camera_in_another_frame():
    text = run("geometry", *APPROACH, *EPOCH, "--frame", "IAU_PLUTO")
    assert "State relative to PLUTO, IAU_PLUTO" in text
    assert "Attitude" not in text


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((*APPROACH, "--time", "yesterday noonish"), KernelError, "yesterday"),
        (
            (*APPROACH, *EPOCH, "--camera", "polycam"),
            CameraError,
            "has no camera 'polycam'; it has lorri_1x1, lorri_4x4",
        ),
        ((*APPROACH, *EPOCH, "--targets", "VULCAN"), KernelError, "'VULCAN' is unknown"),
        ((*APPROACH, *EPOCH, "--frame", "NOPE"), KernelError, "NOPE"),
        (("nowhere.tm", *APPROACH[1:], *EPOCH), KernelError, "nowhere.tm"),
    ],
)
def test_geometry_of_what_is_not_there(arguments, error, message):
    said = run("geometry", *arguments, fails=error)
    assert message in said
    assert "\n" not in said


def test_make_ck_of_a_run(run_dir, tmp_path):
    text = run("make-ck", run_dir, "--kernels", DEMO_KERNELS, "--out", tmp_path / "new.bc")
    assert "attitude of NH_SPACECRAFT (-98000) from 1 picture" in text
    assert "left out" in text
    assert "no pointing solved" in text
    result = json.loads((run_dir / "solved" / "result.json").read_text())
    with KernelSet(DEMO_KERNELS, extra=[tmp_path / "new.bc"]):
        frame = load_mission("new_horizons").camera_named(result["camera"]).frame
        found = spiceypy.pxform("J2000", frame, result["et"])
    assert np.abs(found - spiceypy.q2m(result["pointing"]["quaternion_camera_from_j2000"])).max() < 1e-9


def test_image_support_data_see_the_target_where_the_solved_picture_does(run_dir, demo_truths, tmp_path):
    """Read back as a mapping program reads them: the body's center and a limb point, through camera, attitude and place."""
    truth = demo_truths[0]
    pointing = {"quaternion_camera_from_j2000": spiceypy.m2q(truth.camera_from_j2000.copy()).tolist()}
    solved = {
        "image": "pluto.fit",
        "mission": "new_horizons",
        "camera": truth.camera,
        "et": truth.et,
        "pointing": pointing,
    }
    run_dir = shutil.copytree(run_dir, tmp_path / "run")
    (run_dir / "pluto").mkdir()
    (run_dir / "pluto" / "result.json").write_text(json.dumps(solved))
    answer = CliRunner().invoke(
        app,
        ["make-isd", str(run_dir), "--kernels", DEMO_KERNELS, "--target", "PLUTO", "--out", str(tmp_path)],
        env=WIDE,
    )
    assert answer.exit_code == 3, answer.output
    said = " ".join(answer.output.split())
    assert "no pointing solved" in said
    assert "hold its distortion to" in said  # MVIC's, of fifth degree
    (path,) = tmp_path.glob("*.isd.json")
    data = read_support_data(path)
    camera = load_mission("new_horizons").camera_named(truth.camera)
    with KernelSet(DEMO_KERNELS):
        target, observer = (
            f(*a)
            for f, a in (
                (body_target, ("PLUTO", -98, truth.et)),
                (observer_from_kernels, (-98, truth.et)),
            )
        )
        expected = predict_body(target, observer, camera, truth.camera_from_j2000)
    across = data.body_from_j2000.T @ np.array([0.0, 0.0, data.radii_km[1]])  # the pole
    center, pole = (
        data.camera.project(data.camera_from_j2000 @ (point - data.position_km))
        for point in (0.0 * across, across)
    )
    np.testing.assert_allclose(center, expected.pixel_line, rtol=0, atol=0.02)
    assert 0.0 < np.hypot(*(pole - center)) < 0.51 * expected.diameter_px
    assert data.et == truth.et


def test_make_ck_of_one_picture_beside_its_result(run_dir):
    run("make-ck", run_dir / "solved", "--kernels", DEMO_KERNELS, "-m", "new_horizons")
    assert (run_dir / "solved" / "reconstructed.bc").stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((), KernelError, "open kernels with LSK and SCLK"),
        (("--kernels", DEMO_KERNELS, "-m", "osiris_rex"), CameraError, "has no camera"),
    ],
)
def test_make_ck_without_what_it_needs(run_dir, tmp_path, arguments, error, message):
    said = run("make-ck", run_dir, "--out", tmp_path / "no.bc", *arguments, fails=error)
    assert message in said
    assert not (tmp_path / "no.bc").exists()


@pytest.mark.parametrize("content", [None, "{", "[]", "{}"])
def test_make_ck_of_no_run(tmp_path, content):
    if content is not None:
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "result.json").write_text(content)
    said = run("make-ck", tmp_path, "--kernels", DEMO_KERNELS, fails=SessionError)
    assert str(tmp_path) in said
    assert "\n" not in said


def test_support_data_of_a_binned_window(run_dir, tmp_path):
    """Of a picture that shows a part of the detector, the whole detector's were written."""
    result = json.loads((run_dir / "solved" / "result.json").read_text())
    mission = load_mission("new_horizons")
    whole = mission.camera_named("lorri_1x1")
    part = {"binning": [2, 2], "first": [100, 20], "size": [200, 50]}
    settings = result["provenance"]["settings"] | {"focal_scale": 1.01}
    changed = result | {"camera": whole.name, "readout": part, "provenance": {"settings": settings}}
    path = tmp_path / "a.isd.json"
    with KernelSet(DEMO_KERNELS):
        path.write_text(json.dumps(support_data_of_result(changed, mission, "PLUTO")))
    camera = read_support_data(path).camera
    assert (camera.n_pixel, camera.n_line) == (200, 50)
    assert camera.pixel_scale_rad == pytest.approx(2.0 * whole.pixel_scale_rad / 1.01, rel=1e-3)
    middle = (whole.center_pixel_line - [100, 20] + 0.5) / 2 - 0.5
    np.testing.assert_allclose(camera.center_pixel_line, middle, atol=1e-6)
