"""``opnav calibrate``: files, tables and errors as a user sees them."""

import json
import shutil

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from opnav_workbench.camera import Camera
from opnav_workbench.cli import app
from opnav_workbench.cli.program import main
from opnav_workbench.mission import load_mission
from opnav_workbench.psf import EmpiricalPsf
from opnav_workbench.rehearsal import DEMO_KERNELS

WIDE = {"COLUMNS": "160", "NO_COLOR": "1", "TERM": "dumb"}


def invoke(*arguments):
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)], env=WIDE)


def words_of_error(capsys, monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["opnav", "calibrate", *map(str, arguments)])
    monkeypatch.setenv("COLUMNS", "300")
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    return capsys.readouterr().err


@pytest.mark.slow
def test_camera_from_one_wide_frame(demo_truths, tmp_path):
    """The MVIC demo picture was simulated with the camera of the file: nothing may move significantly."""
    picture, out = demo_truths[1].picture, tmp_path / "out"
    options = ("-m", "new_horizons", "--kernels", DEMO_KERNELS, "--out", out)
    answer = invoke("camera", picture, *options, "--solve", "focal_length_mm,center_pixel")
    assert answer.exit_code == 0, answer.output
    assert "focal_length_mm" in answer.output
    assert "px rms before" in answer.output
    old = load_mission("new_horizons").camera_named("mvic_framing")
    new = Camera.from_yaml(out / "mvic_framing.yaml")
    report = json.loads((out / "mvic_framing_calibration.json").read_text())
    focal = report["parameters"][0]
    assert focal["name"] == "focal_length_mm"
    assert new.focal_length_mm == pytest.approx(focal["after"], rel=1e-10)
    assert abs(new.focal_length_mm - old.focal_length_mm) < 4.0 * focal["sigma"]
    assert report["n_stars"] >= 14
    assert report["rms_after_px"] <= report["rms_before_px"]
    assert np.shape(report["correlation"]) == (2, 2)
    assert report["frames"][0]["image"] == picture.name
    assert imread(out / "mvic_framing_residuals.png").shape[1] > 1000


@pytest.mark.slow
def test_mounting_is_solved_from_kernels(demo_truths, tmp_path):
    out = tmp_path / "out"
    names = "mounting_pixel_rad,mounting_line_rad,mounting_boresight_rad"
    options = ("-m", "new_horizons", "--kernels", DEMO_KERNELS, "--solve", names, "--out", out)
    answer = invoke("camera", demo_truths[1].picture, *options)
    assert answer.exit_code == 0, answer.output
    report = json.loads((out / "mvic_framing_calibration.json").read_text())
    assert [p["before"] for p in report["parameters"]] == [0.0] * 3
    # One frame: the mounting takes the whole a priori error of its attitude, and says how little that means.
    camera = load_mission("new_horizons").camera_named("mvic_framing")
    sigma = camera.attitude_sigma.cross_px * camera.pixel_scale_rad
    assert report["parameters"][0]["sigma"] == pytest.approx(sigma, rel=0.05)


@pytest.mark.slow
def test_psf_needs_stars(demo_truths, tmp_path, capsys, monkeypatch):
    said = words_of_error(
        capsys, monkeypatch, "psf", demo_truths[1].picture, "-m", "new_horizons", "--kernels", DEMO_KERNELS,
        "--min-snr", 140, "--out", tmp_path / "out",
    )  # fmt: skip
    assert "bright stars cannot fill the cells of a PSF" in said
    assert not list((tmp_path / "out").glob("*")) if (tmp_path / "out").exists() else True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--solve", "focal_lenght_mm"), "cannot solve for focal_lenght_mm"),
        (("--distortion", "zernike"), "unknown distortion model 'zernike'"),
    ],
)
def test_bad_options_are_one_line(demo_truths, tmp_path, capsys, monkeypatch, options, message):
    said = words_of_error(
        capsys, monkeypatch, "camera", demo_truths[1].picture, "-m", "new_horizons", "--kernels", DEMO_KERNELS,
        "--out", tmp_path, *options,
    )  # fmt: skip
    assert message in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_pictures_of_several_cameras(demo_truths, capsys, monkeypatch):
    pictures = [truth.picture for truth in demo_truths]
    said = words_of_error(
        capsys, monkeypatch, "camera", *pictures, "-m", "new_horizons", "--kernels", DEMO_KERNELS
    )
    assert "calibrate one camera at a time" in said


def test_no_picture_that_can_be_solved(tmp_path, capsys, monkeypatch):
    empty = tmp_path / "empty.fits"
    empty.write_bytes(b"no picture")
    said = words_of_error(capsys, monkeypatch, "camera", empty, "-m", "new_horizons")
    assert "no picture could be solved" in said
    assert "empty.fits" in said


@pytest.fixture(scope="module")
def psf_of_real_frames(data_dir, tmp_path_factory):
    """What LORRI 4x4's frames of the Proxima and the Wolf 359 fields teach, by the command."""
    folder = tmp_path_factory.mktemp("psf")
    frames = sorted((data_dir / "images" / "lorri_interstellar").glob("*.fits"))
    catalog = f"npz:{data_dir / 'stars' / 'tycho2.npz'}"
    answer = invoke("psf", *frames, "-m", "new_horizons", "--catalog", catalog, "--out", folder)
    assert answer.exit_code == 0, answer.output
    return folder


@pytest.mark.slow
@pytest.mark.realdata
def test_psf_of_real_frames_explains_their_stars(psf_of_real_frames):
    """The second field's set is smeared otherwise and must be left out."""
    folder = psf_of_real_frames
    report = json.loads((folder / "lorri_4x4_psf.json").read_text())
    medians = report["chi2_reduced_median"]
    assert medians["empirical"] < 0.85 * medians["gaussian"]
    assert medians["empirical_other_stars"] < 0.9 * medians["gaussian"]  # not by knowing the stars themselves
    assert [f["used"] for f in report["frames"]] == [True] * 3 + [False] * 3
    camera = Camera.from_yaml(folder / "lorri_4x4.yaml")
    assert isinstance(camera.psf_shape, EmpiricalPsf)
    assert camera.psf_shape.samples.shape == EmpiricalPsf.load(folder / "lorri_4x4_psf.npz").samples.shape
    assert camera.effective_psf is not None
    assert len(camera.effective_psf.pictures) == report["effective"]["n_pictures"] == 3
    assert camera.effective_psf.n_stars == report["effective"]["n_stars"] > 100


@pytest.mark.slow
@pytest.mark.realdata
def test_real_frames_know_the_published_focal_length(data_dir, tmp_path):
    """27 stars of three frames: 2618.478 mm (sigma 0.020) of nh_lorri_v201.ti, within three sigma."""
    frames = sorted((data_dir / "images" / "lorri_interstellar").glob("lor_04498559*.fits"))
    catalog = f"npz:{data_dir / 'stars' / 'tycho2.npz'}"
    options = ("-m", "new_horizons", "--catalog", catalog, "--solve", "focal_length_mm,e2_per_mm2")
    answer = invoke("camera", *frames, *options, "--out", tmp_path)
    assert answer.exit_code == 0, answer.output
    report = json.loads((tmp_path / "lorri_4x4_calibration.json").read_text())
    for parameter, published in zip(report["parameters"], (2618.4776, 2.717e-5), strict=True):
        assert abs(parameter["after"] - published) < 3.0 * parameter["sigma"]
    assert report["parameters"][0]["sigma"] < 2.0
    assert report["rms_after_px"] < 0.1


@pytest.mark.slow
@pytest.mark.realdata
def test_template_goes_with_the_camera_file(data_dir, psf_of_real_frames, tmp_path):
    """A camera calibration of a mission whose camera uses a template: the new file finds it beside itself."""
    frames = sorted((data_dir / "images" / "lorri_interstellar").glob("lor_04498559*.fits"))
    catalog = f"npz:{data_dir / 'stars' / 'tycho2.npz'}"
    mission = load_mission("new_horizons")
    shutil.copytree(mission.path.parent, tmp_path / "mission")
    for name in ("lorri_4x4.yaml", "lorri_4x4_psf.npz", "lorri_4x4_effective_psf.npz"):
        shutil.copy(psf_of_real_frames / name, tmp_path / "mission" / "cameras" / name)
    options = ("-m", tmp_path / "mission", "--catalog", catalog, "--solve", "focal_length_mm")
    answer = invoke("camera", *frames, *options, "--out", tmp_path / "new")
    assert answer.exit_code == 0, answer.output
    camera = Camera.from_yaml(tmp_path / "new" / "lorri_4x4.yaml")
    assert isinstance(camera.psf_shape, EmpiricalPsf)
    assert camera.effective_psf is not None
