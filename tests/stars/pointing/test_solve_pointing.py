"""Attitudes from stars: the paper's case, agreement of both models, few stars, input that cannot be used."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import (
    angle_between,
    camera_from_j2000,
    pointing_angles,
    rotation_from_vector,
    vector_from_rotation,
)
from opnav_workbench.stars.pointing import attitude_shift, iteration_table, solve_pointing

MODELS = ("euler", "image_plane")
CAMERAS = ("lorri", "mapcam", "mvic", "pinhole")


def attitude_shifted_by(camera, first, pixel, line, twist_rad):
    """Return the attitude that `attitude_shift` calls (pixel, line, twist) away from `first`, by Newton's method."""
    wanted, vector, second = np.array([pixel, line, twist_rad]), np.zeros(3), first
    scale = np.array([camera.pixel_scale_rad, camera.pixel_scale_rad, 1.0])

    def deltas(v):
        shift = attitude_shift(camera, first, rotation_from_vector(v @ camera.focal_from_camera) @ first)
        return np.array([shift.delta_pixel, shift.delta_line, shift.delta_twist_rad])

    for _ in range(8):
        h = 1e-2 * scale * [1, 1, 1e-3]
        slope = np.column_stack(
            [(deltas(vector + d) - deltas(vector - d)) / (2 * d.sum()) for d in np.diag(h)]
        )
        vector = vector + np.linalg.solve(slope, wanted - deltas(vector))
        second = rotation_from_vector(vector @ camera.focal_from_camera) @ first
    return second


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["lorri", "mvic"])
def test_table_2_of_the_paper(cameras, star_field, name, model):
    """AAS 13-443, Table 2: 4.5510 px, 12.274 lines, -1.1139e-2 deg; four iterations there."""
    camera = cameras[name]
    a_priori = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    table_2 = (4.5510, 12.274, np.radians(-1.1139e-2))
    true = attitude_shifted_by(camera, a_priori, *table_2)
    rng = np.random.default_rng(20060611)
    field = star_field(camera, rng, 20, sigma_px=1e-4, attitude=true)
    solution = solve_pointing(*field.arguments[:-1], a_priori, model=model)
    assert len(solution.iterations) <= 4
    assert solution.delta_pixel == pytest.approx(4.5510, abs=2e-4)
    assert solution.delta_line == pytest.approx(12.274, abs=2e-4)
    assert np.degrees(solution.delta_twist_rad) == pytest.approx(-1.1139e-2, abs=1e-4)
    assert angle_between(solution.camera_from_j2000.T, true.T).max() < 1e-6  # rows of the attitude: the axes
    # As in the paper nearly everything is done by the first step.
    assert solution.iterations[0].delta_pixel == pytest.approx(4.55, abs=0.05)
    # Convergence is quadratic: after a step of a hundredth of a pixel nothing is left that a test could see.
    assert abs(solution.iterations[-1].delta_line) < 1e-2


@pytest.mark.parametrize("model", MODELS)
def test_residual_scatter_of_table_2(cameras, star_field, model):
    """Post-fit scatter below half a pixel (Figure 10), with centers of 0.3 px, and the errors recovered within it."""
    camera = cameras["mvic"]
    a_priori = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    true = attitude_shifted_by(camera, a_priori, 4.5, 12.3, np.radians(-0.011))
    field = star_field(camera, np.random.default_rng(22), 25, sigma_px=0.3, attitude=true)
    solution = solve_pointing(*field.arguments[:-1], a_priori, model=model)
    assert len(solution.iterations) <= 4
    assert solution.rms_px < 0.5
    assert solution.delta_pixel == pytest.approx(4.5, abs=0.3)
    assert solution.delta_line == pytest.approx(12.3, abs=0.3)
    assert np.degrees(solution.delta_twist_rad) == pytest.approx(-0.011, abs=0.005)


def test_iteration_table_is_table_2(cameras, star_field):
    solution = solve_pointing(*star_field(cameras["lorri"], np.random.default_rng(23), 8).arguments)
    table = iteration_table(solution)
    count = len(solution.iterations)
    assert list(table["iteration"]) == [*map(str, range(1, count + 1)), "Total"]
    for name in ("delta_pixel", "delta_line", "delta_twist"):
        assert table[name][:-1].sum().value == pytest.approx(table[name][-1].value, abs=1e-9)
        assert table[name].info.description
    assert table["delta_line"].unit == "pix"
    assert table["delta_twist"][-1].to_value("rad") == pytest.approx(solution.delta_twist_rad, abs=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_iterations_sum_to_the_total_shift(cameras, star_field, model):
    field = star_field(cameras["mapcam"], np.random.default_rng(4), 8)
    solution = solve_pointing(*field.arguments, model=model)
    total = attitude_shift(field.camera, field.a_priori, solution.camera_from_j2000)
    for name in ("delta_pixel", "delta_line", "delta_twist_rad"):
        assert sum(getattr(step, name) for step in solution.iterations) == pytest.approx(
            getattr(total, name), abs=1e-9
        )
        assert getattr(solution, name) == pytest.approx(getattr(total, name), abs=1e-9)
    ra, dec, twist = pointing_angles(solution.camera_from_j2000, field.camera.focal_from_camera)
    assert (solution.ra_rad, solution.dec_rad, solution.twist_rad) == (ra, dec, twist)


@pytest.mark.parametrize("name", CAMERAS)
def test_noise_free_stars_give_the_attitude_back(cameras, star_field, name):
    rng = np.random.default_rng(5)
    for model in MODELS:
        field = star_field(cameras[name], rng, 6, sigma_px=1e-6)
        solution = solve_pointing(*field.arguments, model=model)
        error_px = field.camera.project(field.directions @ solution.camera_from_j2000.T) - field.true_px
        assert np.abs(error_px).max() < 2e-5  # convergence of the last step plus noise


@pytest.mark.slow(keep=["pinhole"])
@pytest.mark.parametrize("name", CAMERAS)
def test_both_models_agree_to_a_thousandth_of_a_pixel(cameras, star_field, name):
    rng = np.random.default_rng(6)
    for _ in range(20):
        field = star_field(cameras[name], rng, 8, sigma_px=0.1)
        attitudes = [solve_pointing(*field.arguments, model=model).camera_from_j2000 for model in MODELS]
        corners = field.camera.project(field.directions @ attitudes[0].T)
        assert np.abs(corners - field.camera.project(field.directions @ attitudes[1].T)).max() < 1e-3


def test_residuals_are_observed_minus_predicted(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(7), 6)
    solution = solve_pointing(*field.arguments)
    predicted = field.camera.project(field.directions @ solution.camera_from_j2000.T)
    assert_allclose(solution.residual_px, field.observed_px - predicted, atol=1e-12)
    assert solution.rms_px == pytest.approx(np.sqrt(np.mean(solution.residual_px**2)), abs=1e-12)
    assert solution.n_stars == 6
    assert solution.reasons == ("",) * 6


def test_covariance_matches_the_closed_form(cameras, star_field):
    """P = [sum (I - b b^T) / sigma^2]^-1 (Shuster & Oh 1981) for equal sigmas of a distortion-free camera."""
    camera = cameras["pinhole"]
    field = star_field(camera, np.random.default_rng(8), 8, sigma_px=0.1)
    sigma_rad = 0.1 * camera.pixel_scale_rad
    b = camera.unproject(field.true_px)
    closed = np.linalg.inv(np.sum(np.eye(3) - b[:, :, None] * b[:, None, :], axis=0) / sigma_rad**2)
    solution = solve_pointing(*field.arguments)
    # px are not exactly angles: up to 1/cos^2 of the half field, 0.5 % at 0.07 rad.
    half_field = camera.half_diagonal_rad
    tolerance = 2 * half_field**2 + 1e-4
    formal = solution.formal_covariance_rad2
    assert_allclose(np.sqrt(np.diag(formal)), np.sqrt(np.diag(closed)), rtol=tolerance)
    # Without scatter there is no sign of an excess, and the covariance is the formal one.
    exact = solve_pointing(field.true_px, *field.arguments[1:]).covariance_rad2
    assert_allclose(np.sqrt(np.diag(exact)), np.sqrt(np.diag(closed)), rtol=tolerance)


def test_weights_follow_the_covariances(cameras, star_field):
    """A catalog covariance counts like one of the center; a star with a huge one does not count at all."""
    field = star_field(cameras["lorri"], np.random.default_rng(9), 5)
    catalog = np.tile(0.05**2 * np.eye(2), (5, 1, 1))
    apart = solve_pointing(*field.arguments, catalog_covariance_px2=catalog)
    together = solve_pointing(
        field.observed_px, field.covariance_px2 + catalog, field.directions, field.camera, field.a_priori
    )
    assert_allclose(apart.camera_from_j2000, together.camera_from_j2000, atol=1e-15)
    assert_allclose(apart.covariance_rad2, together.covariance_rad2, rtol=1e-12)
    huge = field.covariance_px2.copy()
    huge[0] *= 1e8
    observed = field.observed_px.copy()
    observed[0] += 300.0
    weak = solve_pointing(observed, huge, field.directions, field.camera, field.a_priori)
    usable = np.arange(5) > 0
    without = solve_pointing(*field.arguments, usable=usable)
    moved = vector_from_rotation(weak.camera_from_j2000 @ without.camera_from_j2000.T)
    assert np.all(np.abs(moved) < 0.01 * np.sqrt(np.diag(without.covariance_rad2)))


def test_one_star_holds_the_twist(cameras, star_field):
    camera = cameras["lorri"]
    field = star_field(camera, np.random.default_rng(10), true_px=np.array([[900.0, 100.0]]), sigma_px=0.05)
    sigma = 2e-3
    solution = solve_pointing(*field.arguments, twist_sigma_rad=sigma)
    assert not solution.twist_solved
    assert np.isnan(solution.chi2_reduced)
    assert any("one star" in message and "held" in message for message in solution.messages)
    assert np.abs(solution.residual_px).max() < 1e-5
    turned = vector_from_rotation(solution.camera_from_j2000 @ field.a_priori.T)
    assert camera.boresight @ turned == pytest.approx(0.0, abs=1e-10)


def test_one_star_covariance_by_its_definition(cameras, star_field):
    """eps = (what moves the star, from its center) + (a turn about the star that makes up the a priori twist)."""
    camera = cameras["lorri"]
    field = star_field(camera, np.random.default_rng(11), true_px=np.array([[950.0, 80.0]]), sigma_px=0.05)
    sigma = 2e-3
    covariance = solve_pointing(*field.arguments, twist_sigma_rad=sigma).covariance_rad2
    boresight, star = camera.boresight, camera.unproject(field.true_px)[0]
    assert boresight @ covariance @ boresight == pytest.approx(sigma**2, rel=1e-6)
    # About the star itself the picture says nothing: nearly the whole twist sigma lies there, and only there.
    values, vectors = np.linalg.eigh(covariance)
    assert abs(vectors[:, 2] @ star) == pytest.approx(1.0, abs=1e-5)
    assert np.sqrt(values[2]) == pytest.approx(sigma / (boresight @ star), rel=1e-4)
    assert np.sqrt(values[:2]) == pytest.approx(0.05 * camera.pixel_scale_rad, rel=0.02)  # distortion: 1 %
    # At the star's own place the prediction is as good as the center, however large the twist's sigma is.
    jacobian = np.cross(np.eye(3), star) @ camera.project_jacobian(star[None])[0].T  # (3, 2): d(eps x v)
    place = jacobian.T @ covariance @ jacobian
    assert_allclose(place, 0.05**2 * np.eye(2), atol=1e-6)


def test_two_close_stars_use_the_a_priori_twist(cameras, star_field):
    camera = cameras["lorri"]
    near = np.array([[500.0, 500.0], [512.0, 507.0]])
    field = star_field(camera, np.random.default_rng(12), true_px=near, sigma_px=0.1)
    sigma = 2e-3  # the stars alone: 0.1 px * sqrt(2) / 14 px = 1e-2 rad
    solution = solve_pointing(*field.arguments, twist_sigma_rad=sigma)
    assert not solution.twist_solved
    assert any("enters as a measurement" in message for message in solution.messages)
    boresight = camera.boresight
    alone = 0.1 * np.sqrt(2.0) / np.hypot(12.0, 7.0)
    combined = (alone**-2 + sigma**-2) ** -0.5
    sigma_twist = np.sqrt(boresight @ solution.covariance_rad2 @ boresight)
    assert sigma_twist == pytest.approx(combined, rel=0.02)


def test_two_stars_apart_solve_the_twist_alone(cameras, star_field):
    far = np.array([[100.0, 500.0], [900.0, 600.0]])
    field = star_field(cameras["lorri"], np.random.default_rng(13), true_px=far, sigma_px=0.1)
    solutions = [solve_pointing(*field.arguments, twist_sigma_rad=sigma) for sigma in (2e-3, 2.0)]
    assert all(solution.twist_solved for solution in solutions)
    assert all(solution.messages == () for solution in solutions)
    assert_allclose(solutions[0].camera_from_j2000, solutions[1].camera_from_j2000, atol=1e-15)


def test_default_twist_sigma_is_the_cameras(cameras, star_field):
    camera = cameras["lorri"]
    field = star_field(camera, np.random.default_rng(14), 1)
    covariance = solve_pointing(*field.arguments).covariance_rad2
    expected = np.radians(camera.attitude_sigma.twist_deg)
    assert np.sqrt(camera.boresight @ covariance @ camera.boresight) == pytest.approx(expected, rel=1e-6)


def test_stars_that_cannot_be_used_say_why(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(15), 8)
    observed, covariance, directions = (
        a.copy() for a in (field.observed_px, field.covariance_px2, field.directions)
    )
    observed[0] = np.nan
    covariance[1] = np.nan
    covariance[2] = 0.0
    directions[3] = -directions[3]
    usable = np.arange(8) != 4
    solution = solve_pointing(observed, covariance, directions, field.camera, field.a_priori, usable=usable)
    assert solution.used.tolist() == [False] * 5 + [True] * 3
    assert solution.reasons == (
        "no center",
        "no usable covariance of its center",
        "no usable covariance of its center",
        "out of sight at the a priori attitude",
        "not offered",
        "",
        "",
        "",
    )
    assert np.isnan(solution.residual_px[0]).all()
    assert np.isfinite(solution.residual_px[4]).all()


def test_no_usable_star_is_an_error(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(16), 3)
    with pytest.raises(PointingError, match="none of 3 stars is usable"):
        solve_pointing(*field.arguments, usable=[False] * 3)
    with pytest.raises(PointingError, match="none of 0 stars"):
        solve_pointing(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 3)), field.camera, field.a_priori)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "wahba"}, "unknown pointing model 'wahba'"),
        ({"usable": [True]}, r"usable has shape \(1,\), expected \(3,\)"),
        ({"twist_sigma_rad": 0.0}, "twist_sigma_rad is 0.0"),
        ({"twist_sigma_rad": np.nan}, "twist_sigma_rad is nan"),
        ({"start": "triad"}, "unknown start 'triad'; use one of a_priori, svd, q_method"),
        ({"a_priori_covariance_rad2": np.eye(2)}, r"a_priori_covariance_rad2 has shape \(2, 2\)"),
        ({"a_priori_covariance_rad2": np.diag([1.0, 1.0, 0.0])}, "not positive definite"),
        ({"catalog_covariance_px2": np.zeros((3, 2))}, r"catalog_covariance_px2 has shape \(3, 2\)"),
    ],
)
def test_unusable_options_are_errors(cameras, star_field, change, message):
    field = star_field(cameras["lorri"], np.random.default_rng(17), 3)
    with pytest.raises(PointingError, match=message):
        solve_pointing(*field.arguments, **change)


@pytest.mark.parametrize(
    ("index", "value", "message"),
    [
        (0, np.zeros((3, 3)), r"observed_px has shape \(3, 3\), expected \(n, 2\)"),
        (1, np.zeros((2, 2, 2)), r"covariance_px2 has shape \(2, 2, 2\), expected \(3, 2, 2\)"),
        (2, np.zeros((3, 2)), r"directions has shape \(3, 2\), expected \(3, 3\)"),
        (4, np.diag([1.0, 1.0, -1.0]), "determinant -1"),
        (4, 2.0 * np.eye(3), "not orthonormal"),
    ],
)
def test_arrays_of_the_wrong_kind_are_errors(cameras, star_field, index, value, message):
    arguments = list(star_field(cameras["lorri"], np.random.default_rng(18), 3).arguments)
    arguments[index] = value
    with pytest.raises(PointingError, match=message):
        solve_pointing(*arguments)


def test_wrong_identification_of_everything_is_told(cameras, star_field):
    """Stars in disorder: either no attitude is found, or the error that is reported is as large as the disorder."""
    field = star_field(cameras["lorri"], np.random.default_rng(19), 6)
    solution = solve_pointing(field.observed_px[::-1], *field.arguments[1:])
    assert solution.excess_sigma_px > 20.0
    assert any("excess centering error" in message for message in solution.messages)


def test_results_are_read_only(cameras, star_field):
    solution = solve_pointing(*star_field(cameras["lorri"], np.random.default_rng(20), 3).arguments)
    for name in ("camera_from_j2000", "covariance_rad2", "used", "residual_px"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(solution, name)[0] = 0


def test_attitude_of_few_digits_comes_back_orthonormal(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(21), 4)
    solution = solve_pointing(*field.arguments[:-1], np.round(field.a_priori, 7))
    product = solution.camera_from_j2000 @ solution.camera_from_j2000.T
    assert_allclose(product, np.eye(3), atol=1e-14)
