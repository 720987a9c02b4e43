"""Camera files: what they give, and errors that name the file and the field."""

import copy
import dataclasses

import numpy as np
import pytest
import yaml

from opnav_workbench.camera import (
    BrownDistortion,
    CahvorDistortion,
    Camera,
    ExposureLimits,
    FisheyeDistortion,
    ForwardSipDistortion,
    LegendreDistortion,
    NoDistortion,
    OwenDistortion,
    RadialDistortion,
    RationalDistortion,
    Reseau,
    SipDistortion,
    TaylorDistortion,
)
from opnav_workbench.errors import CameraError
from opnav_workbench.resources import kernels_meta_dir

GOOD = yaml.safe_load((kernels_meta_dir() / "generic/cameras/pinhole.yaml").read_text(encoding="utf-8"))


def write(folder, data):
    path = folder / "camera.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data), encoding="utf-8")
    return path


def changed(*keys, value=None):
    """The good file with one field replaced, or taken out where the value is None."""
    data = copy.deepcopy(GOOD)
    part = data
    for key in keys[:-1]:
        part = part[key]
    if value is None:
        del part[keys[-1]]
    else:
        part[keys[-1]] = value
    return data


def test_every_field_arrives(tmp_path):
    camera = Camera.from_yaml(write(tmp_path, GOOD))
    assert (camera.name, camera.frame, camera.instrument_id) == ("Generic pinhole", "GENERIC_CAMERA", -999100)
    assert (camera.n_pixel, camera.n_line, camera.bits) == (1024, 1024, 14)
    assert (camera.gain_e_per_dn, camera.read_noise_dn, camera.saturation_dn) == (10.0, 2.0, 15000.0)
    assert (camera.psf.sigma_px, camera.psf.sigma_sigma_px) == (0.8, 0.2)
    assert (camera.attitude_sigma.cross_px, camera.attitude_sigma.twist_deg) == (20.0, 0.1)
    assert (camera.zero_point_mag, camera.aperture_m, camera.source) == (18.0, 0.1, "invented")
    assert camera.exposure_limits == ExposureLimits(0.001, 100.0)
    np.testing.assert_array_equal(camera.pixel_from_mm, 100.0 * np.eye(2))


def test_values_nobody_knows_are_none():
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/mvic_framing.yaml")
    assert camera.bias_dn is None
    assert camera.exposure_limits is None
    with pytest.raises(CameraError, match="MVIC framing: bias_dn is not known"):
        camera.require("bias_dn")


@pytest.mark.parametrize(
    ("distortion", "kind"),
    [
        ({"model": "none"}, NoDistortion),
        ({"model": "owen", "e2_per_mm2": "2.7e-5"}, OwenDistortion),
        ({"model": "brown", "k1": 0.1, "s4": 0.001}, BrownDistortion),
        ({"model": "sip", "ap": {"3_0": 1e-9}, "bp": {"0_3": 1e-9}}, SipDistortion),
        ({"model": "sip_forward", "a": {"3_0": 1e-9}, "b": {"0_3": 1e-9}}, ForwardSipDistortion),
        ({"model": "radial", "k1_per_mm2": 1e-5}, RadialDistortion),
        (
            {"model": "taylor", "x_coefficients": [1e-3, 1] + [0] * 8, "y_coefficients": [0, 0, 1] + [0] * 7},
            TaylorDistortion,
        ),
        (
            {
                "model": "rational",
                "x_numerator": [0, 0, 0, 1, 0, 1e-3],
                "y_numerator": [0, 0, 0, 0, 1, 0],
                "denominator": [0, 0, 0, 0, 0, 1],
            },
            RationalDistortion,
        ),
        ({"model": "fisheye", "k1": -0.1}, FisheyeDistortion),
        ({"model": "cahvor", "axis": [0.01, 0, 1], "r1": 0.1}, CahvorDistortion),
        (
            {
                "model": "legendre",
                "half_size_mm": [5, 5],
                "x_coefficients": [1e-5] * 20,
                "y_coefficients": [0] * 20,
            },
            LegendreDistortion,
        ),
    ],
    ids=lambda value: value["model"] if isinstance(value, dict) else "",
)
def test_every_distortion_can_be_written(tmp_path, distortion, kind):
    camera = Camera.from_yaml(write(tmp_path, changed("optics", "distortion", value=distortion)))
    assert isinstance(camera.distortion, kind)
    shift = camera.distortion.distort([4.0, 3.0]) - [4.0, 3.0]
    assert (np.abs(shift).max() > 1e-9) == (kind is not NoDistortion)
    camera.to_yaml(tmp_path / "saved.yaml")
    assert_same(Camera.from_yaml(tmp_path / "saved.yaml"), camera)


def assert_same(again, camera):
    """Every field of two cameras is the same, and so is where they see a grid of points."""
    for field in dataclasses.fields(camera):
        value, other = getattr(camera, field.name), getattr(again, field.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value, err_msg=field.name)
        elif isinstance(value, Reseau):
            np.testing.assert_array_equal(other.marks_px, value.marks_px)
            np.testing.assert_array_equal(other.ideal_mm, value.ideal_mm)
        elif field.name not in ("distortion", "bandpass", "psf_shape"):
            assert other == value, field.name
    assert type(again.distortion) is type(camera.distortion)
    corners = np.array([[0.0, 0.0], [camera.n_pixel - 1.0, 0.0], [3.0, camera.n_line - 1.0]])
    np.testing.assert_allclose(again.unproject(corners), camera.unproject(corners), rtol=0, atol=1e-15)


@pytest.mark.slow(
    keep=["cassis", "fc2", "iss_nac", "lorri_1x1", "mapcam", "mdis_nac", "mvic_framing", "onc_w2"]
)
@pytest.mark.parametrize("path", sorted(kernels_meta_dir().glob("*/cameras/*.yaml")), ids=lambda p: p.stem)
def test_every_camera_saves_itself(tmp_path, path):
    camera = Camera.from_yaml(path)
    camera.to_yaml(tmp_path / "saved.yaml")
    again = Camera.from_yaml(tmp_path / "saved.yaml")
    assert_same(again, camera)
    if camera.bandpass is not None:
        np.testing.assert_array_equal(again.bandpass.response, camera.bandpass.response)
        assert again.sun_mag == camera.sun_mag


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (changed("optics", "focal_length_mm"), "optics.focal_length_mm: this field is required"),
        (changed("optics", "focal_length_mm", value=-5), "optics.focal_length_mm: .*greater than 0"),
        (changed("optics", "focal_length_mm", value=float("inf")), "optics.focal_length_mm: .*finite"),
        (changed("detector", "n_pixel", value="many"), "detector.n_pixel: .*integer"),
        (changed("detector", "well_depth_e", value=1e5), "detector.well_depth_e: unknown field"),
        (changed("optics", "distortion", value={"model": "mirror"}), "optics.distortion: .*mirror"),
        (
            changed("optics", "distortion", value={"model": "owen", "e2": 1}),
            "optics.distortion.e2: unknown",
        ),
        (
            changed("optics", "pixel_from_mm", value=[[1, 2]]),
            "optics.pixel_from_mm.1: this field is required",
        ),
        (
            changed("optics", "focal_from_camera", value=[[1, 0, 0], [1, 0, 0], [0, 0, 1]]),
            "orthogonal unit rows",
        ),
        (changed("detector", "exposure_max_s", value=1e-4), "exposure limits 0.001..0.0001 s"),
        ("just a text", "the file: fields with values"),
        ("name: [unclosed", "is not YAML"),
    ],
)
def test_errors_name_file_and_field(tmp_path, data, message):
    with pytest.raises(CameraError, match=message) as caught:
        Camera.from_yaml(write(tmp_path, data))
    assert "\n" not in str(caught.value)


def test_errors_of_the_schema_name_the_file(tmp_path):
    with pytest.raises(CameraError, match=r"camera\.yaml: line \d+: optics"):
        Camera.from_yaml(write(tmp_path, changed("optics")))


def test_only_the_first_few_errors_are_listed(tmp_path):
    with pytest.raises(CameraError, match=r"and \d+ more$"):
        Camera.from_yaml(write(tmp_path, {"name": "x"}))


def test_a_missing_or_binary_file_is_one_clear_error(tmp_path):
    with pytest.raises(CameraError, match="cannot be read"):
        Camera.from_yaml(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CameraError, match="cannot be read"):
        Camera.from_yaml(tmp_path / "binary.yaml")
