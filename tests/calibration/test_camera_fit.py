"""Camera calibration against simulated truth: errors over sigmas, what is not determined, outliers, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from opnav_workbench.calibration import (
    CameraParameters,
    StarPictures,
    calibrate_camera,
    solvable,
    with_distortion,
)
from opnav_workbench.calibration.bundle_adjustment import camera_jacobian
from opnav_workbench.camera import BrownDistortion, NoDistortion, OwenDistortion
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import rotation_from_vector

MOUNTING = (2e-4, -1e-4, 3e-3)
CASES = {
    "lorri": ("focal_length_mm", "e2_per_mm2", "e5_per_mm", "e6_per_mm"),
    "mapcam": ("focal_length_mm", "k1", "k2", "p1", "p2", "line_scale"),
}
MOUNTING_NAMES = ("mounting_pixel_rad", "mounting_line_rad", "mounting_boresight_rad")


def wrong(camera):
    """The camera that the calibration starts from: focal length off by 5e-4, distortion by a few percent."""
    distortion = camera.distortion
    if isinstance(distortion, OwenDistortion):
        distortion = OwenDistortion(e2_per_mm2=2e-5)
    else:
        distortion = replace(distortion, k1=0.95 * distortion.k1, p1=0.0)
    return replace(camera, focal_length_mm=1.0005 * camera.focal_length_mm, distortion=distortion)


def truth(camera, names):
    values = {"focal_length_mm": camera.focal_length_mm, "line_scale": 1.0}
    values |= dict(zip(MOUNTING_NAMES, MOUNTING, strict=True))
    return np.array([values[n] if n in values else getattr(camera.distortion, n) for n in names])


@pytest.mark.parametrize("name", CASES)
def test_parameters_come_back_within_three_sigma(cameras, star_pictures, name):
    camera = cameras[name]
    pictures = star_pictures(camera, np.random.default_rng([1, len(name)]), mounting_rad=MOUNTING)
    result = calibrate_camera(pictures, wrong(camera), (*CASES[name], *MOUNTING_NAMES))
    assert result.names == (*CASES[name], *MOUNTING_NAMES)
    error = (result.values - truth(camera, result.names)) / result.sigmas
    assert np.all(np.abs(error) < 3.0), dict(zip(result.names, error, strict=True))
    assert result.rms_after_px < 0.105
    assert result.rms_before_px > 1.2 * result.rms_after_px
    assert result.used.all()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_error_over_sigma_is_one(cameras, star_pictures, sample, name):
    camera, rng = cameras[name], np.random.default_rng([2, len(name)])
    errors = []
    for _ in range(sample.trials(60)):
        pictures = star_pictures(camera, rng, pictures=6, stars=20, mounting_rad=MOUNTING)
        result = calibrate_camera(pictures, wrong(camera), (*CASES[name], *MOUNTING_NAMES))
        errors.append((result.values - truth(camera, result.names)) / result.sigmas)
    ratio = np.sqrt(np.mean(np.square(errors)))  # 420 or 540 numbers, correlated: about 5 % by chance
    assert abs(ratio - 1.0) < sample.within(0.13)
    each = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(np.abs(each - 1.0) < sample.within(0.3)), each  # 9 % by chance


def test_the_new_camera_predicts_better(cameras, star_pictures):
    """Other stars, with the solved camera turned by its mounting: directions in the picture of the kernels."""
    camera = cameras["lorri"]
    pictures = star_pictures(camera, np.random.default_rng(3), pictures=30, mounting_rad=MOUNTING)
    result = calibrate_camera(pictures, wrong(camera), (*CASES["lorri"], *MOUNTING_NAMES))
    other = star_pictures(camera, np.random.default_rng(4), pictures=30, sigma_px=1e-6, mounting_rad=MOUNTING)
    directions = np.einsum("nij,nj->ni", other.a_priori[other.picture_index], other.directions)

    def mean_error(used):
        return np.linalg.norm((other.observed_px - used.project(directions)).mean(axis=0))

    # Mounting of 40 and 20 px; the a priori attitudes' own 20 px average out over 30 pictures, twice.
    assert mean_error(wrong(camera)) > 30.0
    assert mean_error(result.camera) < 4.0 * 20.0 * np.sqrt(2.0 / 30.0)


@pytest.mark.parametrize("name", ["lorri", "mapcam"])
def test_jacobian_by_linearity(cameras, name):
    """Owen's terms and the focal length act linearly on the picture, Brown's nearly: a finite change tells."""
    camera = cameras[name]
    parameters = CameraParameters(camera, CASES[name])
    places = np.random.default_rng(5).uniform(0.0, 1023.0, (50, 2))
    directions = camera.unproject(places)
    jacobian = camera_jacobian(parameters, parameters.values(), directions)
    for j in range(len(CASES[name])):
        values = parameters.values()
        change = 1e-3 / np.abs(jacobian[:, :, j]).max()  # moves stars by up to 1e-3 px
        values[j] += change
        moved = parameters.camera_with(values).project(directions) - places
        assert_allclose(jacobian[:, :, j] * change, moved, atol=2e-7)


def test_brown_terms_recover_an_owen_camera(cameras, star_pictures):
    """Another model, from zero: what is left is what its terms cannot express."""
    camera = cameras["lorri"]
    pictures = star_pictures(camera, np.random.default_rng(6))
    start = with_distortion(camera, "brown")
    assert isinstance(start.distortion, BrownDistortion)
    result = calibrate_camera(pictures, start, ("focal_length_mm", "k1", "p1", "p2"))
    assert result.rms_before_px > 0.2
    assert result.rms_after_px < 0.11
    assert with_distortion(camera, "keep") is camera
    assert with_distortion(camera, "owen") is camera
    with pytest.raises(CameraError, match="unknown distortion model 'sip'"):
        with_distortion(camera, "sip")


def test_what_is_not_determined_is_said(cameras, star_pictures):
    """Without distortion, over 0.3 deg, the center of the picture is the pictures' own pointing."""
    camera = replace(cameras["lorri"], distortion=NoDistortion())
    pictures = star_pictures(camera, np.random.default_rng(7))
    result = calibrate_camera(pictures, camera, ("focal_length_mm", "center_pixel", "center_line"))
    assert np.isfinite(result.sigmas).tolist() == [True, False, False]
    assert_allclose(result.values[1:], camera.center_pixel_line)
    assert sum("not determined by these frames" in message for message in result.messages) == 2
    assert all("center_pixel" in message or "center_line" in message for message in result.messages[:2])
    assert np.isnan(result.correlation[0, 1])
    alone = calibrate_camera(pictures, camera, ("focal_length_mm",))
    assert result.values[0] == pytest.approx(alone.values[0], abs=1e-3 * alone.sigmas[0])
    assert result.sigmas[0] == pytest.approx(alone.sigmas[0], rel=1e-3)


def test_two_parameters_that_do_the_same(cameras, star_pictures):
    """Pictures with stars along one line of the detector cannot tell line_scale from the focal length... along pixel."""
    camera = cameras["pinhole"]
    pictures = star_pictures(camera, np.random.default_rng(8))
    flat = replace(camera, n_line=1, center_pixel_line=np.array([511.5, 0.0]))
    pictures = star_pictures(flat, np.random.default_rng(8))
    result = calibrate_camera(pictures, flat, ("focal_length_mm", "line_scale"))
    assert np.isfinite(result.sigmas).tolist() == [True, False]
    assert "line_scale is not determined" in result.messages[0]


def test_strong_correlations_are_listed(cameras, star_pictures):
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(9))
    result = calibrate_camera(pictures, cameras["lorri"], ("focal_length_mm", "e2_per_mm2", "e4_per_mm4"))
    names = {frozenset(pair[:2]) for pair in result.strong_correlations}
    assert frozenset(("e2_per_mm2", "e4_per_mm4")) in names
    assert_allclose(np.diag(result.correlation), 1.0)


def test_outliers_and_hidden_scatter(cameras, star_pictures):
    camera, rng = cameras["lorri"], np.random.default_rng(10)
    pictures = star_pictures(camera, rng, sigma_px=0.2)
    observed = pictures.observed_px.copy()
    wrong_stars = np.arange(0, len(pictures), 20)
    observed[wrong_stars] += rng.choice([-1, 1], (len(wrong_stars), 2)) * rng.uniform(
        3, 30, (len(wrong_stars), 2)
    )
    pictures = replace(pictures, observed_px=observed, covariance_px2=0.25 * pictures.covariance_px2)
    result = calibrate_camera(pictures, wrong(camera), CASES["lorri"])
    assert not result.used[wrong_stars].any()
    assert result.used.sum() >= len(pictures) - len(wrong_stars) - 3
    assert result.excess_sigma_px == pytest.approx(np.sqrt(0.2**2 - 0.1**2), rel=0.1)
    error = (result.values - truth(camera, result.names)) / result.sigmas
    assert np.all(np.abs(error) < 3.5)
    assert any("rejected as outliers" in message for message in result.messages)


def test_attitudes_are_those_of_the_frames(cameras, star_pictures):
    camera = cameras["lorri"]
    pictures = star_pictures(camera, np.random.default_rng(11), sigma_px=1e-4)
    result = calibrate_camera(pictures, wrong(camera), CASES["lorri"])
    places = np.einsum("nij,nj->ni", result.attitudes[pictures.picture_index], pictures.directions)
    assert np.abs(result.camera.project(places) - pictures.observed_px).max() < 1e-3


def test_same_input_same_output(cameras, star_pictures):
    pictures = star_pictures(cameras["mapcam"], np.random.default_rng(12))
    first, second = (calibrate_camera(pictures, cameras["mapcam"], CASES["mapcam"]) for _ in range(2))
    assert first.values.tobytes() == second.values.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_names_that_a_camera_does_not_have(cameras, star_pictures):
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(13))
    with pytest.raises(CameraError, match=r"cannot solve for k1; .* e2_per_mm2"):
        calibrate_camera(pictures, cameras["lorri"], ("k1",))
    with pytest.raises(CameraError, match="given twice"):
        calibrate_camera(pictures, cameras["lorri"], ("e2_per_mm2", "e2_per_mm2"))
    assert "p2" in solvable(cameras["mapcam"])
    assert "focal_mm" not in solvable(cameras["mapcam"])


def test_frames_with_too_few_stars(cameras, star_pictures):
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(14), stars=1)
    with pytest.raises(CameraError, match="8 of 8 frames have fewer than 2"):
        calibrate_camera(pictures, cameras["lorri"], ("focal_length_mm",))
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(14), pictures=1, stars=2)
    with pytest.raises(CameraError, match="4 measurements for 5 unknowns"):
        calibrate_camera(pictures, cameras["lorri"], ("focal_length_mm", "e2_per_mm2"))


def test_arrays_that_do_not_fit(cameras, star_pictures):
    pictures = star_pictures(cameras["lorri"], np.random.default_rng(15))
    with pytest.raises(CameraError, match="observed_px must be finite of shape"):
        replace(pictures, observed_px=np.full((len(pictures), 2), np.nan))
    with pytest.raises(CameraError, match="frame numbers"):
        replace(pictures, picture_index=pictures.picture_index + 1)
    assert isinstance(pictures, StarPictures)
    with pytest.raises(CameraError, match="positive definite"):
        calibrate_camera(pictures, cameras["lorri"], (), a_priori_covariance_rad2=-np.eye(3))


def test_no_parameters_fits_the_attitudes_only(cameras, star_pictures):
    camera = cameras["lorri"]
    result = calibrate_camera(star_pictures(camera, np.random.default_rng(16)), camera, ())
    assert_allclose(result.residual_before_px, result.residual_after_px, atol=1e-6)
    assert result.covariance.shape == (0, 0)
    assert_allclose(
        result.camera.focal_from_camera, camera.focal_from_camera @ rotation_from_vector(np.zeros(3))
    )
