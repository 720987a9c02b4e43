"""Bodies of one picture share its pointing error: the joint covariance against Monte Carlo."""

import numpy as np
import pytest

from opnav_workbench.bodies import BodyCenter, JointCenters
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector
from opnav_workbench.observables import center_cross, cross_covariance_px2, joint_covariance_px2, observe
from opnav_workbench.targets import TargetState

PLACES = {"PLUTO": (300.0, 800.0), "CHARON": (700.0, 250.0)}


def make_observable(
    cameras, name, observed, attitude, covariances, image="lor.fit", joint=None, method="ellipse"
):
    camera = cameras["lorri"]
    true = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    direction = camera.unproject(np.array([PLACES[name]]))[0] @ true
    center_covariance, attitude_covariance = covariances
    return observe(
        TargetState(name, 6e6 * direction),
        BodyCenter(name, method, "ok", observed, center_covariance),
        camera,
        attitude,
        attitude_covariance,
        observer_velocity_km_s=np.zeros(3),
        a_priori_px=np.zeros(2),
        diameter_px=30.0,
        image=image,
        et=0.0,
        utc="2015-07-12T08:46:57",
        reference_body="PLUTO",
        center_cross_px2=None if joint is None else center_cross(joint, name),
    )


@pytest.fixture
def joint():
    """Two centers whose covariance is everything but diagonal."""
    factor = np.random.default_rng(3).normal(size=(4, 4)) * 0.05
    centers = tuple(BodyCenter(n, "ellipse", "ok", np.array(p), 0.01 * np.eye(2)) for n, p in PLACES.items())
    return JointCenters(centers, factor @ factor.T + 1e-4 * np.eye(4))


def test_joint_covariance_is_that_of_simulated_residuals(cameras, joint):
    """1500 trials of pointing and center errors: chi-squared of both bodies together is 4 on average."""
    camera, rng = cameras["lorri"], np.random.default_rng(5)
    true = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    scale = camera.pixel_scale_rad
    factor = np.diag([0.3 * scale, 0.2 * scale, 4e-4]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    attitude_covariance = factor @ factor.T
    centers = np.linalg.cholesky(joint.covariance_px2)
    blocks = [joint.covariance_px2[i : i + 2, i : i + 2] for i in (0, 2)]
    places = np.array(list(PLACES.values()))
    pair = [
        make_observable(cameras, n, p, true, (b, attitude_covariance), joint=joint)
        for n, p, b in zip(PLACES, places, blocks, strict=True)
    ]
    covariance = joint_covariance_px2(pair)
    directions = np.array([camera.unproject(p[None])[0] @ true for p in places])
    chi2, alone, residuals = [], [], []
    for _ in range(1500):
        solved = rotation_from_vector(factor @ rng.normal(size=3)).T @ true
        noise = (centers @ rng.normal(size=4)).reshape(2, 2)
        residual = places + noise - camera.project(directions @ solved.T)
        residuals.append(residual.ravel())
        chi2.append(residual.ravel() @ np.linalg.solve(covariance, residual.ravel()))
        apart = [(r, o.total_covariance_px2) for r, o in zip(residual, pair, strict=True)]
        alone.append(sum(r @ np.linalg.solve(c, r) for r, c in apart))
    assert np.mean(chi2) == pytest.approx(4.0, abs=0.26)  # 3.5 sigma of the mean, sqrt(8/1500)
    assert np.std(alone) > 1.2 * np.std(chi2)  # leaving the correlation out is seen in the scatter
    sample = np.cov(np.array(residuals).T)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        sample / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=0.11
    )


def test_nothing_is_shared_between_pictures(cameras, joint):
    attitude = camera_from_j2000(4.7, -0.25, 2.0, cameras["lorri"].focal_from_camera)
    covariances = 0.01 * np.eye(2), 1e-12 * np.eye(3)
    here, there = (
        make_observable(cameras, n, np.array(p), attitude, covariances, image=image, joint=joint)
        for (n, p), image in zip(PLACES.items(), ("a.fit", "b.fit"), strict=True)
    )
    assert not cross_covariance_px2(here, there).any()
    # Another method's center was not part of the joint fit: the pointing alone is shared.
    pair = [
        make_observable(cameras, n, np.array(p), attitude, covariances, joint=joint, method=m)
        for (n, p), m in zip(PLACES.items(), ("ellipse", "limb_scan"), strict=True)
    ]
    expected = pair[0].partials_px_per_rad @ pair[1].partials_px_per_rad.T * 1e-12
    np.testing.assert_allclose(cross_covariance_px2(*pair), expected, rtol=1e-12)


def test_cross_of_a_joint_fit_is_its_block(joint):
    np.testing.assert_array_equal(center_cross(joint, "CHARON")["PLUTO"], joint.covariance_px2[2:, :2])
    with pytest.raises(CenterfindingError, match="NIX"):
        center_cross(joint, "NIX")
