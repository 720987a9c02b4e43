"""The batched solver against scipy, one problem at a time, and at its limits."""

from dataclasses import replace

import numpy as np
from scipy.optimize import curve_fit

from opnav_workbench.psf import pixel_gaussian
from opnav_workbench.stars.boxes import check_image, cut_at
from opnav_workbench.stars.levenberg_marquardt import ModelEvaluation, solve_batched
from opnav_workbench.stars.results import ShapePrior
from opnav_workbench.stars.star_model import GaussianProfile, StarModel

X = np.linspace(0.0, 4.0, 25)


def decay(amplitude, rate):
    return amplitude * np.exp(-rate * X)


def decay_model(data, weight):
    def model(index, p):
        e = np.exp(-p[:, 1, None] * X)
        jacobian = np.stack([e, -p[:, 0, None] * X * e], axis=1)
        return ModelEvaluation(data[index] - p[:, 0, None] * e, weight[index], jacobian)

    return model


def solve(data, sigma, start, lower=-np.inf, upper=np.inf, mean=None, information=None):
    n = len(data)
    full = np.zeros((n, 2))
    return solve_batched(
        decay_model(data, np.full(data.shape, sigma**-2.0)), full + start, full + lower, full + upper,
        full if mean is None else full + mean, full if information is None else full + information,
    )  # fmt: skip


def test_batch_agrees_with_scipy_on_each_problem():
    rng = np.random.default_rng(1)
    truth = np.column_stack([rng.uniform(3.0, 9.0, 40), rng.uniform(0.2, 2.0, 40)])
    data = np.array([decay(*t) for t in truth]) + rng.normal(0.0, 0.05, (40, 25))
    solution = solve(data, 0.05, [5.0, 1.0])
    assert solution.converged.all()
    assert solution.determined.all()
    for row, parameters, covariance in zip(data, solution.parameters, solution.covariance, strict=True):
        expected, expected_covariance = curve_fit(
            lambda x, a, b: a * np.exp(-b * x),
            X,
            row,
            p0=[5.0, 1.0],
            sigma=np.full(25, 0.05),
            absolute_sigma=True,
        )
        np.testing.assert_allclose(parameters, expected, atol=1e-3 * 0.05)
        np.testing.assert_allclose(covariance, expected_covariance, rtol=2e-3, atol=1e-9)


def test_prior_adds_its_information():
    data = decay(5.0, 1.0)[None] + 0.0
    free = solve(data, 0.1, [4.0, 0.7])
    held = solve(data, 0.1, [4.0, 0.7], mean=[0.0, 1.02], information=[0.0, 1e4])
    # Close to the optimum the problem is linear: two Gaussians multiplied.
    information = np.linalg.inv(free.covariance[0]) + np.diag([0.0, 1e4])
    expected = free.parameters[0] + np.linalg.solve(information, [0.0, 1e4 * 0.02])
    np.testing.assert_allclose(held.covariance[0], np.linalg.inv(information), rtol=0.03)
    np.testing.assert_allclose(held.parameters[0], expected, atol=1e-3)


def test_bounds_hold_and_are_told():
    solution = solve(decay(5.0, 1.0)[None], 0.1, [4.0, 0.7], lower=[-9.0, 0.0], upper=[99.0, 0.8])
    assert solution.parameters[0, 1] == 0.8
    assert solution.at_bound.tolist() == [[False, True]]
    assert solution.converged[0]
    # The free parameter is at its optimum on the bound, a linear problem.
    e = np.exp(-0.8 * X)
    np.testing.assert_allclose(solution.parameters[0, 0], decay(5.0, 1.0) @ e / (e @ e), rtol=1e-5)


def test_a_problem_without_data_is_undetermined_and_leaves_the_others_alone():
    data = np.array([decay(5.0, 1.0), decay(3.0, 0.5)])
    weight = np.full(data.shape, 100.0)
    weight[0] = 0.0
    zero = np.zeros((2, 2))
    solution = solve_batched(
        decay_model(data, weight), np.array([[4.0, 0.7]] * 2), zero - np.inf, zero + np.inf, zero, zero
    )
    assert solution.determined.tolist() == [False, True]
    assert np.isnan(solution.covariance[0]).all()
    np.testing.assert_allclose(solution.parameters[1], [3.0, 0.5], atol=1e-4)


def test_what_is_hopeless_ends_where_it_is_and_leaves_the_others_as_they_are():
    rng = np.random.default_rng(4)
    data = np.array([decay(5.0, 1.0), decay(-5.0, 1.0), decay(7.0, 0.4)]) + rng.normal(0.0, 0.05, (3, 25))
    start, none, wide = np.tile([4.0, 0.7], (3, 1)), np.zeros((3, 2)), np.full((3, 2), np.inf)
    model = decay_model(data, np.full(data.shape, 400.0))
    free = solve_batched(model, start, -wide, wide, none, none)
    held = solve_batched(model, start, -wide, wide, none, none, hopeless=lambda p: p[:, 0] < 0.0)
    assert free.converged.all()
    assert held.converged.tolist() == [True, False, True]
    assert held.iterations[1] < free.iterations[1]
    assert held.parameters[1, 0] < 0.0
    for name in ("parameters", "covariance", "chi2", "iterations"):
        np.testing.assert_array_equal(getattr(held, name)[[0, 2]], getattr(free, name)[[0, 2]])


def test_a_curved_valley_does_not_lose_each_second_step():
    """Rosenbrock's: a refused step is followed by careful ones. Without them it took 93 and 131 trials."""

    def model(index, p):
        x, y = p.T
        jacobian = np.zeros((len(index), 2, 2))
        jacobian[:, 0] = np.stack([np.ones_like(x), -60.0 * x], axis=1)
        jacobian[:, 1, 1] = 30.0
        residual = np.stack([1.0 - x, 30.0 * (x**2 - y)], axis=1)
        return ModelEvaluation(residual, np.ones_like(residual), jacobian)

    start, free = np.array([[-1.2, 1.0], [-3.0, 5.0]]), np.full((2, 2), np.inf)
    solution = solve_batched(model, start, -free, free, 0.0 * start, 0.0 * start)
    np.testing.assert_allclose(solution.parameters, 1.0, atol=1e-4)
    assert (solution.iterations <= [70, 100]).all(), solution.iterations


def test_light_that_is_solved_fits_best_where_it_is_light():
    line, pixel = np.indices((7, 7)).reshape(2, 1, -1)
    shape = ShapePrior.round_psf(0.4)
    places = np.array([[3.0, 3.1], [3.6, 2.9]])
    unit = pixel_gaussian(places, np.tile(shape.mean, (2, 1)), pixel, line).value
    lights = np.array([[700.0, 200.0], [700.0, -200.0]]) @ unit + 5.0  # the second box holds no two stars
    boxes = cut_at(check_image(lights.reshape(14, 7), 2.0, None, None), np.array([[0, 0], [0, 7]]), 7)
    model = replace(StarModel.of(boxes, None, GaussianProfile(shape), "level", 2), light_solved=True)
    given = model.linear_start(np.stack([places, places + np.array([0.0, 7.0])]))
    given[:, model.flux_columns] = [300.0, 300.0]
    state = model(np.arange(2), given)
    assert state.parameters is not None
    np.testing.assert_allclose(state.parameters[0, model.flux_columns], [700.0, 200.0], rtol=1e-9)
    np.testing.assert_allclose(state.residual[0], 0.0, atol=1e-9)
    np.testing.assert_array_equal(state.parameters[1], given[1])
    np.testing.assert_array_equal(state.parameters[:, model.center_columns], given[:, model.center_columns])
