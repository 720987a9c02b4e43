"""Camera files with new values: what is replaced, what stays, and that nothing half-written is left."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from opnav_workbench.calibration import (
    Edit,
    calibrate_camera,
    camera_edits,
    with_distortion,
    write_camera_file,
)
from opnav_workbench.calibration.camera_file import edited
from opnav_workbench.camera import BrownDistortion, Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.resources import kernels_meta_dir

LORRI = kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml"
NAMES = ("focal_length_mm", "e2_per_mm2", "e1_per_mm", "line_scale", "mounting_boresight_rad")


def test_a_calibration_goes_through_the_file(cameras, star_pictures, tmp_path):
    camera = cameras["lorri"]
    pictures = star_pictures(camera, np.random.default_rng(1), mounting_rad=(0.0, 0.0, 2e-3))
    result = calibrate_camera(pictures, camera, NAMES)
    target = tmp_path / "new.yaml"
    written = write_camera_file(LORRI, target, camera_edits(result), "calibrated")
    places = result.camera.unproject(np.random.default_rng(2).uniform(0, 1023, (50, 2)))
    for read in (written, Camera.from_yaml(target)):
        assert np.abs(read.project(places) - result.camera.project(places)).max() < 1e-6
    text = target.read_text()
    assert text.startswith("# calibrated\n")
    sigma = dict(zip(result.names, result.sigmas, strict=True))
    assert f"# sigma {sigma['focal_length_mm']:.2g}" in text
    old = [line for line in LORRI.read_text().splitlines() if line.strip().startswith("#")]
    assert old
    assert all(line in text for line in old)  # comments of its own lines stay
    unchanged = {"psf", "photometry", "attitude_sigma", "detector"}
    before, after = (yaml.safe_load(path.read_text()) for path in (LORRI, target))
    assert all(before[key] == after[key] for key in unchanged if key in before)


def test_another_distortion_model_replaces_all_terms(cameras, star_pictures, tmp_path):
    start = with_distortion(cameras["lorri"], "brown")
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(3))
    result = calibrate_camera(pictures, start, ("focal_length_mm", "k1", "p1", "p2"))
    written = write_camera_file(LORRI, tmp_path / "new.yaml", camera_edits(result, "brown"), "calibrated")
    assert isinstance(written.distortion, BrownDistortion)
    assert written.distortion.k1 == pytest.approx(result.values[1], rel=1e-9)
    assert written.distortion.focal_mm == pytest.approx(result.values[0], rel=1e-9)


def test_center_and_what_is_not_determined(cameras, star_pictures, tmp_path):
    camera = with_distortion(cameras["lorri"], "none")
    result = calibrate_camera(
        star_pictures(camera, np.random.default_rng(4)), camera, ("center_pixel", "center_line")
    )
    written = write_camera_file(LORRI, tmp_path / "new.yaml", camera_edits(result, "none"), "x")
    assert written.center_pixel_line.tolist() == camera.center_pixel_line.tolist()
    assert "not determined" in (tmp_path / "new.yaml").read_text()


def test_nothing_is_left_of_a_file_that_is_no_camera(tmp_path):
    with pytest.raises(CameraError, match="focal_length_mm"):
        write_camera_file(LORRI, tmp_path / "new.yaml", {("optics", "focal_length_mm"): Edit(-1.0)}, "bad")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(CameraError, match="cannot be read"):
        write_camera_file(tmp_path / "none.yaml", tmp_path / "new.yaml", {}, "bad")


TEXT = """\
# head
optics:
  focal: 1.0  # old
  matrix: [[1.0, 0.0],
           [0.0, 1.0]]  # two lines
  distortion: {model: owen, e2: 1.0}
  deep:
    a: 1
    # comment between
    b: 2
# comment before detector
detector:
  n: 3
"""


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("optics", "focal"), 2.5),
        (("optics", "matrix"), [[2.0, 0.0], [0.0, 2.0]]),
        (("optics", "distortion", "e2"), 3.0),
        (("optics", "distortion", "e5"), 4.0),
        (("optics", "distortion"), {"model": "brown", "k1": 0.5}),
        (("optics", "deep", "b"), 9),
        (("optics", "deep", "c"), 7),
        (("optics", "deep"), {"a": 5}),
        (("detector", "n"), 4),
        (("detector", "m"), "text"),
        (("top",), 1e-12),
    ],
)
def test_edits_change_one_field_only(place, value):
    new = edited(TEXT, place, Edit(value, "new"))
    content, expected = yaml.safe_load(new), yaml.safe_load(TEXT)
    inner = expected
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = value
    assert content == expected
    assert "# head" in new
    assert "# comment before detector" in new


def test_edits_remove_a_field():
    for place in (("optics", "deep", "a"), ("optics", "distortion", "e2"), ("optics", "matrix")):
        content = yaml.safe_load(edited(TEXT, place, Edit(None)))
        for name in place[:-1]:
            content = content[name]
        assert place[-1] not in content
    assert edited(TEXT, ("optics", "none"), Edit(None)) == TEXT
    with pytest.raises(CameraError, match=r"camera file: psf is missing, so model cannot be set"):
        edited(TEXT, ("psf", "model"), Edit(1))


def test_camera_parts_that_are_not_solved_are_kept(cameras):
    camera = cameras["mapcam"]
    same = with_distortion(camera, "brown")
    assert same is camera
    assert replace(camera).distortion is camera.distortion
