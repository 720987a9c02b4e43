"""Errors against their predicted covariance: Monte Carlo over the sky, with elliptical centers of mixed quality."""

import numpy as np
import pytest

from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import (
    radec_from_unit,
    rotation_from_vector,
    tangent_basis,
    vector_from_rotation,
)
from opnav_workbench.stars.pointing import solve_pointing

TRIALS = 600  # the ratio is then known to 2.9 %
RATIO = (0.9, 1.1)
SHARP_TRIALS = 1500  # 1.8 %
SHARP_RATIO = (0.95, 1.05)
BIAS_SIGMA = 0.15  # 3.5 sigma of a mean over TRIALS


def mixed_covariances(rng, n):
    """Return elliptical covariances (n, 2, 2) of 0.02 to 0.3 px."""
    factors = rng.normal(size=(n, 2, 2)) + 0.5 * np.eye(2)
    size = np.exp(rng.uniform(np.log(0.02), np.log(0.3), n))
    return size[:, None, None] ** 2 * (factors @ np.swapaxes(factors, 1, 2) + 0.2 * np.eye(2))


def error_of(field, solution):
    return vector_from_rotation(field.attitude @ solution.camera_from_j2000.T)


def errors_and_sigmas(camera, star_field, rng, counts, model="euler", trials=TRIALS):
    """Return errors (trials, 3) in units of their predicted sigmas, and their Mahalanobis distances squared."""
    errors, distances = [], []
    for _ in range(trials):
        n = int(rng.integers(*counts))
        field = star_field(camera, rng, n, covariance_px2=mixed_covariances(rng, n))
        solution = solve_pointing(*field.arguments, model=model)
        error = error_of(field, solution)
        errors.append(error / np.sqrt(np.diag(solution.covariance_rad2)))
        distances.append(error @ np.linalg.solve(solution.covariance_rad2, error))
    return np.array(errors), np.array(distances)


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("lorri", "euler"),
        ("pinhole", "euler"),
        pytest.param("mapcam", "image_plane", marks=pytest.mark.slow),
    ],
)
def test_errors_are_what_the_covariance_says(cameras, star_field, sample, name, model):
    """Both handednesses of the focal axes; half of the fields lie within a degree of a celestial pole."""
    errors, distances = errors_and_sigmas(
        cameras[name], star_field, np.random.default_rng(31), (5, 31), model, sample.trials(TRIALS)
    )
    ratio = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all(np.abs(ratio - 1.0) < sample.within(0.1)), ratio
    assert np.all(np.abs(errors.mean(axis=0)) < sample.within(BIAS_SIGMA))
    chance = sample.within(0.12)  # 3.3 % of all trials
    assert np.mean(distances) / 3.0 == pytest.approx(1.0, abs=chance)  # correlations too


@pytest.mark.slow
def test_error_over_sigma_within_five_percent_on_each_axis(cameras, star_field):
    """Error over sigma within 0.95..1.05 on every axis, twist included, with the stars of an ordinary picture."""
    rng = np.random.default_rng(35)
    errors, _ = errors_and_sigmas(cameras["lorri"], star_field, rng, (8, 41), trials=SHARP_TRIALS)
    ratio = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all((ratio > SHARP_RATIO[0]) & (ratio < SHARP_RATIO[1])), ratio


@pytest.mark.slow
def test_twist_error_has_the_predicted_sign_and_correlation(cameras, star_field):
    """One star off the boresight: the a priori twist's error must show up in the cross axes as predicted."""
    camera, rng = cameras["lorri"], np.random.default_rng(32)
    sigma = np.radians(camera.attitude_sigma.twist_deg)
    place = np.array([[950.0, 120.0]])
    errors, covariance = [], np.zeros((3, 3))
    for _ in range(TRIALS):
        field = star_field(camera, rng, true_px=place, sigma_px=0.2)
        solution = solve_pointing(*field.arguments, twist_sigma_rad=sigma)
        errors.append(error_of(field, solution))
        covariance = solution.covariance_rad2
    errors = np.array(errors)
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.diag(covariance))
    assert np.all((ratio > RATIO[0]) & (ratio < RATIO[1])), ratio
    distance = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors)
    assert np.mean(distance) / 3.0 == pytest.approx(1.0, abs=0.12)
    sampled = np.corrcoef(errors.T)
    predicted = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs(predicted[0, 2]) > 0.8  # the case is one with strong correlation
    assert sampled == pytest.approx(predicted, abs=0.03)


@pytest.mark.slow
def test_two_close_stars_with_the_a_priori_twist(cameras, star_field):
    camera, rng = cameras["lorri"], np.random.default_rng(33)
    places = np.array([[500.0, 300.0], [560.0, 330.0]])
    errors, distances = [], []
    for _ in range(TRIALS):
        field = star_field(camera, rng, true_px=places, sigma_px=0.2)
        solution = solve_pointing(*field.arguments)
        assert not solution.twist_solved
        error = error_of(field, solution)
        errors.append(error / np.sqrt(np.diag(solution.covariance_rad2)))
        distances.append(error @ np.linalg.solve(solution.covariance_rad2, error))
    ratio = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((ratio > RATIO[0]) & (ratio < RATIO[1])), ratio
    assert np.mean(distances) / 3.0 == pytest.approx(1.0, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lorri", "pinhole"])
def test_scatter_reaches_the_cramer_rao_bound(cameras, star_field, name):
    """The bound is inv(J^T W J) with the Jacobian taken by differences of the camera alone."""
    camera, rng = cameras[name], np.random.default_rng(34)
    places = rng.uniform(50.0, 950.0, (8, 2))
    covariance = mixed_covariances(rng, 8)
    errors = []
    for _ in range(500):
        field = star_field(camera, rng, true_px=places, covariance_px2=covariance)
        errors.append(error_of(field, solve_pointing(*field.arguments)))
    h, v = 1e-6, camera.unproject(places)
    jacobian = np.stack(
        [(camera.project(v + h * np.cross(e, v)) - camera.project(v - h * np.cross(e, v))) / (2 * h)
         for e in np.eye(3)], axis=-1
    )  # fmt: skip
    bound = np.linalg.inv(np.sum(np.swapaxes(jacobian, 1, 2) @ np.linalg.inv(covariance) @ jacobian, axis=0))
    ratio = np.std(errors, axis=0) / np.sqrt(np.diag(bound))
    assert np.all((ratio > 0.9) & (ratio < 1.1)), ratio


@pytest.mark.parametrize("share", [0.0, 0.04])
def test_what_all_centers_share_does_not_average_out(cameras, star_field, sample, share):
    """An error that moves all stars alike, part of each covariance; where it is not told 40 stars are 4 sigma off."""
    camera, rng, n = cameras["lorri"], np.random.default_rng(8), 40
    covariance = np.tile((0.05**2 + share**2) * np.eye(2), (n, 1, 1))
    common = np.tile(share * np.eye(2), (n, 1, 1))
    ratios = []
    for _ in range(sample.trials(200)):
        field = star_field(camera, rng, n, covariance_px2=np.tile(0.05**2 * np.eye(2), (n, 1, 1)))
        observed, _, *rest = field.arguments
        observed = observed + share * rng.normal(size=2)
        solution = solve_pointing(observed, covariance, *rest, common_px=common)
        ratios.append((error_of(field, solution) / np.sqrt(np.diag(solution.covariance_rad2)))[:2])
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=sample.within(0.15))


def test_shared_errors_of_other_stars_are_refused(cameras, star_field):
    field = star_field(cameras["lorri"], np.random.default_rng(9), 5)
    with pytest.raises(PointingError, match="common_px has shape"):
        solve_pointing(*field.arguments, common_px=np.zeros((4, 2, 1)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lorri", "mapcam"])
def test_a_star_off_its_catalog_turns_every_picture_of_it(cameras, star_field, name):
    """By differences, with the errors toward east and north on the sky: those of one star are the same in two pictures."""
    camera, rng, n = cameras[name], np.random.default_rng(6), 7
    first = star_field(camera, rng, n, sigma_px=0.05)
    turned = rotation_from_vector(0.3 * camera.boresight) @ first.attitude  # the same stars, another twist
    sky = [mixed_covariances(rng, 1)[0] * camera.pixel_scale_rad**2 for _ in range(n)]
    values, vectors = np.linalg.eigh(np.array(sky))
    roots = (vectors * np.sqrt(values)[:, None]) @ np.swapaxes(vectors, 1, 2)
    axes = np.stack(tangent_basis(*radec_from_unit(first.directions)), axis=-1)  # (n, 3, 2)
    for attitude in (first.attitude, turned):
        place = camera.project(first.directions @ attitude.T)
        inside = camera.on_detector(place)
        assert inside.sum() >= 5
        rows = np.flatnonzero(inside)
        steps = [
            camera.project((first.directions[:, None] + h * np.swapaxes(axes, 1, 2)) @ attitude.T)
            for h in (1e-7, -1e-7)
        ]
        to_px = np.swapaxes(steps[0] - steps[1], 1, 2) / 2e-7
        covariance = to_px @ np.array(sky) @ np.swapaxes(to_px, 1, 2)

        def solved(directions, rows=rows, covariance=covariance, place=place, attitude=attitude):
            return solve_pointing(
                place[rows],
                first.covariance_px2[rows],
                directions[rows],
                camera,
                attitude,
                catalog_covariance_px2=covariance[rows],
            )

        even = solved(first.directions)
        sum_of = np.einsum("nij,nkj->ik", even.catalog_turns_rad, even.catalog_turns_rad)
        assert (np.linalg.eigvals(np.linalg.solve(even.covariance_rad2, sum_of)) < 1.0).all()
        for k, row in enumerate(rows[:3]):
            for axis in (0, 1):
                off = np.array(first.directions)
                off[row] += 0.1 * axes[row] @ roots[row][:, axis]
                turn = vector_from_rotation(even.camera_from_j2000 @ solved(off).camera_from_j2000.T) / 0.1
                scale = np.abs(even.catalog_turns_rad[k]).max(axis=1)
                np.testing.assert_allclose(
                    even.catalog_turns_rad[k][:, axis] / scale, turn / scale, atol=0.02
                )
