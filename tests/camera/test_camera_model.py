"""The camera model: projection, its inverse and its derivatives, for every camera file of the package."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.camera import (
    AttitudeSigma,
    BrownDistortion,
    Camera,
    ExposureLimits,
    OwenDistortion,
    PsfPrior,
)
from opnav_workbench.errors import CameraError
from opnav_workbench.resources import kernels_meta_dir

NEAREST = ("new_horizons", "osiris_rex", "near")  # all cameras of these, and of each other kind of optics one
OTHERS = (
    "iss_nac",
    "iss_wac",
    "onc_w1",
    "onc_w2",
    "pinhole",
    "mdis_nac",
    "cassis",
    "lroc_wac_604",
    "ssi",
    "junocam_red",
)
FILES = sorted(
    path
    for path in kernels_meta_dir().glob("*/cameras/*.yaml")
    if path.parts[-3] in NEAREST or path.stem in OTHERS
)
MARGIN_PX = 60.0  # how far off the detector the identification of stars looks


@pytest.fixture(params=FILES, ids=[f"{f.parts[-3]}/{f.stem}" for f in FILES])
def camera(request):
    return Camera.from_yaml(request.param)


def pinhole(**changes):
    values = {
        "name": "test",
        "frame": "TEST",
        "instrument_id": -1,
        "n_pixel": 400,
        "n_line": 300,
        "focal_length_mm": 50.0,
        "center_pixel_line": [199.5, 149.5],
        "pixel_from_mm": [[100.0, 0.0], [0.0, 100.0]],
        "focal_from_camera": np.eye(3),
    }
    return Camera(**(values | changes))


def detector_grid(camera, margin_px=MARGIN_PX, n=21):
    pixel = np.linspace(-0.5 - margin_px, camera.n_pixel - 0.5 + margin_px, n)
    line = np.linspace(-0.5 - margin_px, camera.n_line - 0.5 + margin_px, n)
    return np.stack(np.meshgrid(pixel, line), axis=-1).reshape(-1, 2)


def test_six_cameras_come_with_the_package():
    assert len(FILES) >= 6


def test_unproject_inverts_project(camera):
    points = detector_grid(camera)
    directions = camera.unproject(points)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(camera.project(directions), points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(camera.project(7.5e6 * directions), points, rtol=0, atol=1e-6)


def test_project_jacobian_equals_central_differences(camera):
    vectors = 3.0 * camera.unproject(detector_grid(camera, margin_px=-1.0, n=9))
    step = 3e-6
    columns = [
        (camera.project(vectors + step * axis) - camera.project(vectors - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    scale = 1.0 / camera.pixel_scale_rad  # px per unit of the vector
    np.testing.assert_allclose(
        camera.project_jacobian(vectors) / scale, np.stack(columns, -1) / scale, rtol=0, atol=2e-8
    )


def test_projection_does_not_change_along_the_line_of_sight(camera):
    vectors = 3.0 * camera.unproject(detector_grid(camera, n=5))
    along = camera.project_jacobian(vectors) @ vectors[..., None]
    np.testing.assert_allclose(along * camera.pixel_scale_rad, 0.0, rtol=0, atol=1e-14)


def test_unproject_jacobian_equals_central_differences(camera):
    points = detector_grid(camera, margin_px=-1.0, n=9)
    step_px = 0.05
    columns = [
        (camera.unproject(points + step_px * axis) - camera.unproject(points - step_px * axis))
        / (2 * step_px)
        for axis in np.eye(2)
    ]
    scale = camera.pixel_scale_rad
    np.testing.assert_allclose(
        camera.unproject_jacobian(points) / scale, np.stack(columns, -1) / scale, rtol=0, atol=1e-6
    )


def test_jacobians_are_each_others_inverse(camera):
    points = detector_grid(camera, n=5)
    product = camera.project_jacobian(camera.unproject(points)) @ camera.unproject_jacobian(points)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), rtol=0, atol=1e-10)


def test_boresight_falls_on_the_center(camera):
    np.testing.assert_allclose(
        camera.project(camera.boresight[None])[0], camera.center_pixel_line, rtol=0, atol=0.3
    )


def test_first_two_focal_axes_are_increasing_pixel_and_line(camera):
    tiny = 1e-4
    for axis, (row, other) in enumerate(((0, 1), (1, 0))):
        tilted = camera.boresight + tiny * camera.focal_from_camera[axis]
        step = camera.project(tilted[None])[0] - camera.project(camera.boresight[None])[0]
        oblong = abs(camera.pixel_from_mm[row, row]) / np.sqrt(abs(np.linalg.det(camera.pixel_from_mm)))
        px_per_rad = oblong / camera.pixel_scale_rad
        np.testing.assert_allclose(
            step[row] / px_per_rad, tiny, rtol=0.03
        )  # distortion at the center: 2.7 % (ONC-W1)
        assert abs(step[other]) < 0.01 * step[row]


def test_nothing_behind_the_image_plane_is_seen(camera):
    back = -camera.boresight
    across = camera.focal_from_camera[0] + 1e-12 * back  # rounding may put it on either side
    unseen = np.array([back, across, across + 0.5 * back, [np.nan, 0.0, 1.0]])
    assert np.isnan(camera.project(unseen)).all()
    assert np.isnan(camera.project_jacobian(unseen)).all()


def test_no_direction_far_from_the_field_falls_on_the_detector(camera):
    """A polynomial that folds back must not bring the far sky into the picture."""
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = directions[
        np.arccos(np.clip(directions @ camera.boresight, -1, 1)) > 1.2 * camera.half_diagonal_rad
    ]
    assert len(far) > 15000
    assert not camera.on_detector(camera.project(far)).any()


def test_shapes_of_one_direction_none_and_a_grid(camera):
    assert camera.project(camera.boresight).shape == (2,)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.project_jacobian(np.ones((4, 5, 3))).shape == (4, 5, 2, 3)
    assert camera.unproject(np.ones((4, 5, 2))).shape == (4, 5, 3)
    assert camera.unproject_jacobian([1.0, 2.0]).shape == (3, 2)


def test_pinhole_agrees_with_a_fits_tangent_projection():
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [30.0, 20.0]
    wcs.wcs.crpix = [200.5, 150.5]
    scale_deg = np.degrees(1.0 / 5000.0)  # 50 mm at 100 px/mm
    wcs.wcs.cd = [[-scale_deg, 0.0], [0.0, scale_deg]]
    ra, dec = np.radians(30.0), np.radians(20.0)
    west = -np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    out = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    camera = pinhole(focal_from_camera=np.stack([west, north, out]))  # mirrored: determinant -1
    points = detector_grid(camera)
    lon, lat = np.radians(wcs.all_pix2world(points, 0)).T
    sky = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    np.testing.assert_allclose(camera.project(sky), points, rtol=0, atol=1e-8)


def test_skew_and_unequal_pixel_scales():
    matrix = np.array([[100.0, 2.0], [-1.5, 110.0]])
    camera = pinhole(pixel_from_mm=matrix, distortion=OwenDistortion(e2_per_mm2=1e-4, e5_per_mm=1e-4))
    points = detector_grid(camera)
    np.testing.assert_allclose(camera.project(camera.unproject(points)), points, rtol=0, atol=1e-9)
    undistorted = pinhole(pixel_from_mm=matrix)
    assert undistorted.project([0.02, 0.01, 1.0]) == pytest.approx([199.5 + 101.0, 149.5 + 53.5], abs=1e-9)
    assert undistorted.pixel_scale_rad == pytest.approx(1.0 / (50.0 * np.sqrt(11003.0)), rel=1e-14)


@settings(max_examples=50)
@given(
    axes=st.permutations((0, 1, 2)),
    signs=st.tuples(*[st.sampled_from((-1.0, 1.0))] * 3),
    x=st.floats(-0.03, 0.03),
    y=st.floats(-0.03, 0.03),
)
def test_any_choice_of_axes_works_the_same(axes, signs, x, y):
    """Boresight and detector axes are data: 48 cameras that differ by them alone."""
    matrix = np.eye(3)[list(axes)] * np.array(signs)[:, None]
    direction = matrix.T @ [x, y, 1.0]
    expected = pinhole().project([x, y, 1.0])
    np.testing.assert_allclose(
        pinhole(focal_from_camera=matrix).project(direction), expected, rtol=0, atol=1e-10
    )


def test_on_detector_ends_half_a_pixel_beyond_the_last_center():
    camera = pinhole()
    points = [[-0.5, 0.0], [-0.51, 0.0], [399.5, 299.5], [399.5, 299.51], [np.nan, 5.0], [-10.0, 5.0]]
    np.testing.assert_array_equal(camera.on_detector(points), [True, False, True, False, False, False])
    np.testing.assert_array_equal(
        camera.on_detector(points, margin_px=9.6), [True, True, True, True, False, True]
    )


def test_half_diagonal_is_the_farthest_corner():
    expected = np.arctan(np.hypot(2.1, 1.6) / 50.0)  # center 10 px off, both ways
    camera = pinhole(center_pixel_line=[189.5, 139.5])
    assert camera.half_diagonal_rad == pytest.approx(expected, abs=1e-12)


def test_a_missing_value_is_named_when_it_is_needed():
    camera = pinhole(read_noise_dn=2.5)
    assert camera.require("read_noise_dn") == 2.5
    with pytest.raises(CameraError, match="test: gain_e_per_dn is not known"):
        camera.require("gain_e_per_dn")


def test_arrays_are_read_only_and_copied():
    center = np.array([199.5, 149.5])
    camera = pinhole(center_pixel_line=center)
    center[0] = 0.0
    assert camera.center_pixel_line[0] == 199.5
    for name in ("center_pixel_line", "pixel_from_mm", "focal_from_camera"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(camera, name)[0] = 0.0


def test_replace_makes_another_camera():
    camera = replace(pinhole(), focal_length_mm=100.0)
    assert camera.pixel_scale_rad == pytest.approx(1e-4, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal_length_mm": -1.0}, "focal_length_mm is -1.0"),
        ({"n_line": 0}, "n_line is 0"),
        ({"pixel_from_mm": [[1.0, 1.0], [1.0, 1.0]]}, "singular"),
        ({"center_pixel_line": [1.0, np.nan]}, "center_pixel_line holds a value that is not finite"),
        ({"focal_from_camera": 2.0 * np.eye(3)}, "orthogonal unit rows"),
        ({"focal_from_camera": np.eye(2)}, r"focal_from_camera has shape \(2, 2\)"),
        ({"distortion": BrownDistortion(50.0, k1=-300.0)}, "folds over inside the detector"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(changes, message):
    with pytest.raises(CameraError, match=message):
        pinhole(**changes)


@pytest.mark.parametrize(
    "build",
    [
        lambda: PsfPrior(0.0, 0.1),
        lambda: PsfPrior(0.5, float("nan")),
        lambda: AttitudeSigma(-1.0, 0.1),
        lambda: ExposureLimits(2.0, 1.0),
    ],
)
def test_priors_that_cannot_be_are_refused(build):
    with pytest.raises(CameraError):
        build()
