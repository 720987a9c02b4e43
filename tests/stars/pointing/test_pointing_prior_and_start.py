"""The a priori attitude as a measurement, and closed-form starts."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import rotation_from_vector, vector_from_rotation
from opnav_workbench.stars.pointing import solve_pointing, wahba

STARTS = ("svd", "q_method")


def a_priori_covariance(camera, cross_px=8.0, twist_rad=1e-3):
    axes = camera.focal_from_camera
    cross = cross_px * camera.pixel_scale_rad
    return axes.T @ np.diag([cross, 1.3 * cross, twist_rad]) ** 2 @ axes


def field_with_prior(camera, star_field, rng, covariance, **options):
    """A field whose a priori attitude has an error of that covariance."""
    error = np.linalg.cholesky(covariance) @ rng.normal(size=3)
    return star_field(camera, rng, error_rotvec=error, **options)


@pytest.mark.slow(keep=["2"])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_stars_and_an_a_priori_attitude(cameras, star_field, n):
    camera, rng = cameras["lorri"], np.random.default_rng([71, n])
    covariance = a_priori_covariance(camera)
    errors = []
    for _ in range(300):
        field = field_with_prior(camera, star_field, rng, covariance, n=n, sigma_px=0.2)
        solution = solve_pointing(*field.arguments, a_priori_covariance_rad2=covariance)
        error = vector_from_rotation(field.attitude @ solution.camera_from_j2000.T)
        errors.append(error / np.sqrt(np.diag(solution.covariance_rad2)))
    ratio = np.sqrt(np.mean(np.square(errors)))  # 900 numbers
    assert 0.85 < ratio < 1.1


def test_prior_and_stars_add_their_information(cameras, star_field):
    camera = cameras["lorri"]
    covariance = a_priori_covariance(camera, 0.05)
    field = star_field(camera, np.random.default_rng(72), 2, sigma_px=0.2, error_rotvec=np.zeros(3))
    solution = solve_pointing(field.true_px, *field.arguments[1:], a_priori_covariance_rad2=covariance)
    jacobian = camera.attitude_jacobian(field.directions @ field.attitude.T)
    stars = np.einsum("nij,nik->jk", jacobian, jacobian) / 0.2**2
    assert_allclose(solution.covariance_rad2, np.linalg.inv(np.linalg.inv(covariance) + stars), rtol=1e-6)


def test_a_sure_a_priori_attitude_stays(cameras, star_field):
    camera = cameras["lorri"]
    covariance = a_priori_covariance(camera, 1e-4, 1e-9)
    field = star_field(camera, np.random.default_rng(73), 1, sigma_px=0.5, error_rotvec=np.zeros(3))
    solution = solve_pointing(*field.arguments, a_priori_covariance_rad2=covariance)
    assert np.hypot(solution.delta_pixel, solution.delta_line) < 1e-3
    assert not solution.twist_solved
    assert any("one star" in message and "a priori attitude" in message for message in solution.messages)


@pytest.mark.parametrize("model", ["euler", "image_plane"])
def test_a_weak_a_priori_attitude_changes_nothing(cameras, star_field, model):
    field = star_field(cameras["lorri"], np.random.default_rng(74), 8)
    alone = solve_pointing(*field.arguments, model=model)
    weak = solve_pointing(*field.arguments, model=model, a_priori_covariance_rad2=np.eye(3))
    assert weak.twist_solved
    moved = vector_from_rotation(alone.camera_from_j2000 @ weak.camera_from_j2000.T)
    assert np.all(np.abs(moved) < 1e-3 * np.sqrt(np.diag(alone.covariance_rad2)))


@pytest.mark.parametrize("method", STARTS)
def test_closed_forms_against_scipy(method):
    rng = np.random.default_rng(75)
    for n in (2, 3, 10):
        reference = rng.normal(size=(n, 3))
        reference /= np.linalg.norm(reference, axis=1, keepdims=True)
        true = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        observed = reference @ true.T + rng.normal(0.0, 1e-3, (n, 3))
        observed /= np.linalg.norm(observed, axis=1, keepdims=True)
        weights = rng.uniform(0.5, 2.0, n)
        expected, _ = Rotation.align_vectors(observed, reference, weights)
        assert_allclose(wahba(observed, reference, weights, method), expected.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("method", STARTS)
def test_start_from_the_stars_alone(cameras, star_field, method):
    """An a priori attitude off by 5 degrees of twist and 200 px; the closed form is the first step of the table."""
    camera = cameras["lorri"]
    error = np.array([150.0, 130.0, 0.0]) * camera.pixel_scale_rad + [0.0, 0.0, np.radians(5.0)]
    field = star_field(camera, np.random.default_rng(76), 8, error_rotvec=error @ camera.focal_from_camera)
    closed = solve_pointing(*field.arguments, start=method)
    iterated = solve_pointing(*field.arguments)
    moved = vector_from_rotation(closed.camera_from_j2000 @ iterated.camera_from_j2000.T)
    assert np.all(np.abs(moved) < 1e-3 * np.sqrt(np.diag(iterated.covariance_rad2)))
    assert sum(step.delta_line for step in closed.iterations) == pytest.approx(closed.delta_line, abs=1e-9)
    rest = np.hypot(
        closed.delta_pixel - closed.iterations[0].delta_pixel,
        closed.delta_line - closed.iterations[0].delta_line,
    )
    assert rest < 0.1  # nearly everything is done by the closed form: equal weights, little distortion


def test_closed_form_uses_stars_that_the_a_priori_attitude_does_not_see(cameras, star_field):
    camera = cameras["mapcam"]
    turned = rotation_from_vector(np.radians(3.0) * camera.focal_from_camera[0])
    field = star_field(camera, np.random.default_rng(77), 9)
    solution = solve_pointing(*field.arguments[:-1], turned @ field.attitude, start="svd")
    error = vector_from_rotation(field.attitude @ solution.camera_from_j2000.T)
    assert solution.n_stars == 9
    assert np.all(np.abs(error) < 5.0 * np.sqrt(np.diag(solution.covariance_rad2)))


def test_one_star_starts_a_priori(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(78), 1)
    closed, plain = (solve_pointing(*field.arguments, start=start) for start in ("svd", "a_priori"))
    assert_allclose(closed.camera_from_j2000, plain.camera_from_j2000, atol=1e-15)


def test_one_direction_leaves_the_rotation_open():
    with pytest.raises(PointingError, match="leave the rotation about it open"):
        wahba([[0.0, 0, 1]] * 2, [[1.0, 0, 0]] * 2, [1.0, 1.0])
    with pytest.raises(PointingError, match="unknown closed form 'quest'"):
        wahba(np.eye(3), np.eye(3), np.ones(3), "quest")
