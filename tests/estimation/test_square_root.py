"""Square-root information filter and smoother by themselves: a published example, a closed form, a dense Kalman filter."""

import itertools

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.linalg import expm, solve_discrete_are

from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.square_root import (
    Information,
    last_smoothed,
    linear_step,
    smooth,
    with_measurements,
    with_step,
)
from opnav_workbench.estimation.state_transition import kepler
from opnav_workbench.estimation.stochastic import (
    Acceleration,
    acceleration_increments,
    epoch_weights,
    step_times,
)


def unknown(n):
    return Information(np.zeros((n, n)), np.zeros((n, 1)))


# -- Tapley, Schutz & Born (2004), Statistical Orbit Determination, section 4.8.2: a mass on two springs -----------------

SPRINGS = {"k1": 2.5, "k2": 3.7, "mass": 1.5, "height": 5.4}
RANGES = """6.1773780845922 5.56327661282686 5.69420161397342 6.15294262127432 5.46251322092491 5.83638064328625
6.08236452736002 5.40737619817037 5.97065615746125 5.97369258835895 5.40669060248179"""
RATES = """0.0 1.31285863495514 -1.54488114381612 0.534923988815733 0.884698415328368 -1.56123248918054
1.00979943157547 0.31705117039215 -1.37453070975606 1.36768169443236 -0.302111588503166"""


def mass_on_springs(state):
    """Range and range rate of the mass, (2,), and their partials (2, 2)."""
    x, v = state
    r = np.hypot(x, SPRINGS["height"])
    return np.array([r, x * v / r]), np.array([[x / r, 0.0], [v / r - x * x * v / r**3, x / r]])


def test_mass_on_two_springs_as_published():
    """Eleven ranges and rates of unit weight; published: 3.00019 m, 1.18181e-3 m/s, residuals 1.16e-4, 4.66e-4 rms."""
    ranges, rates = (np.array(text.split(), float) for text in (RANGES, RATES))
    w = np.sqrt((SPRINGS["k1"] + SPRINGS["k2"]) / SPRINGS["mass"])
    moved = np.array([[np.cos(w), np.sin(w) / w], [-w * np.sin(w), np.cos(w)]])  # by one second
    a_priori, state = np.array([4.0, 0.2]), np.array([4.0, 0.2])
    for _ in range(6):
        reference, rows = state, np.diag([1000.0**-0.5, 0.1])
        known = with_measurements(unknown(2), rows, rows @ (a_priori - reference)[:, None])
        residuals = []
        for k, observed in enumerate(zip(ranges, rates, strict=True)):
            if k:
                known, _ = with_step(known, linear_step(moved, np.zeros((2, 1))))
                reference = moved @ reference
            computed, partials = mass_on_springs(reference)
            residuals.append(observed - computed)
            known = with_measurements(known, partials, residuals[-1][:, None])
        back = np.linalg.matrix_power(np.linalg.inv(moved), len(ranges) - 1)
        state = state + back @ known.state()[:, 0]
    assert state[0] == pytest.approx(3.00019, abs=5e-6)
    assert state[1] == pytest.approx(1.18181e-3, abs=5e-9)
    rms = np.sqrt(np.mean(np.square(residuals), axis=0))
    assert rms == pytest.approx([1.16e-4, 4.66e-4], rel=3e-3)
    covariance = back @ known.covariance_root() @ known.covariance_root().T @ back.T
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.411, abs=1e-3)


# -- closed forms ----------------------------------------------------------------------------------------------------


def test_covariance_settles_where_the_riccati_equation_says():
    """A constant-velocity target in white noise, seen in position every second: scipy's discrete Riccati equation."""
    a, g, h, r = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]]), np.array([[1.0, 0.0]]), 9.0
    steady = solve_discrete_are(a.T, h.T, 0.04 * g @ g.T, np.array([[r]]))
    known = with_measurements(unknown(2), np.eye(2) / 100.0, np.zeros((2, 1)))
    for _ in range(200):
        known = with_measurements(known, h / 3.0, np.zeros((1, 1)))
        known, _ = with_step(known, linear_step(a, 0.2 * g))
    root = known.covariance_root()
    np.testing.assert_allclose(root @ root.T, steady, rtol=1e-12)


def test_filter_and_smoother_are_those_of_dense_matrices():
    """Random states, noises and measurements; Kalman's filter and Rauch, Tung & Striebel's smoother with covariances."""
    rng = np.random.default_rng(31)
    n, m = 5, 2
    x, p = rng.normal(size=n), np.eye(n)
    known = with_measurements(unknown(n), np.eye(n), x[:, None])
    steps, filtered, predicted, chi2 = [], [], [], 0.0
    for _ in range(12):
        a, g = np.eye(n) + 0.3 * rng.normal(size=(n, n)), rng.normal(size=(n, m))
        known, rows = with_step(known, linear_step(a, g))
        x, p = a @ x, a @ p @ a.T + g @ g.T
        predicted.append((x, p))
        h, y = rng.normal(size=(2, n)), rng.normal(size=2)
        known = with_measurements(known, h, y[:, None])
        s = h @ p @ h.T + np.eye(2)
        chi2 += (y - h @ x) @ np.linalg.solve(s, y - h @ x)
        gain = p @ h.T @ np.linalg.inv(s)
        x, p = x + gain @ (y - h @ x), (np.eye(n) - gain @ h) @ p
        filtered.append((x, p))
        steps.append((a, rows))
        np.testing.assert_allclose(known.state()[:, 0], x, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(
            known.covariance_root() @ known.covariance_root().T, p, rtol=1e-8, atol=1e-11
        )
    assert known.square_sum == pytest.approx(chi2, rel=1e-10)
    at = last_smoothed(known)
    for k in range(11, 0, -1):
        a, rows = steps[k]
        at = smooth(at, rows)
        (xf, pf), (xp, pp) = filtered[k - 1], predicted[k]
        gain = pf @ a.T @ np.linalg.inv(pp)
        x, p = xf + gain @ (x - xp), pf + gain @ (p - pp) @ gain.T
        np.testing.assert_allclose(at.state[:, 0], x, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(at.root @ at.root.T, p, rtol=1e-7, atol=1e-10)


def test_what_is_not_determined_says_so():
    known = with_measurements(unknown(2), [[1.0, 1.0]], [[3.0]])
    assert not known.determined
    with pytest.raises(EstimationError, match="not determined yet; give a priori sigmas"):
        known.state()
    assert with_measurements(known, [[1.0, -1.0]], [[1.0]]).state()[:, 0] == pytest.approx([2.0, 1.0])


# -- accelerations ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.02, 1.0, 70.0])
def test_correlated_acceleration_is_that_of_its_differential_equation(tau):
    """Position, velocity and acceleration over one second, by Van Loan's matrix exponential."""
    f, h = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]]), 1.0
    pieces = 64  # so that no exponential grows
    big = np.zeros((6, 6))
    big[:3, :3], big[3:, 3:] = -f, f.T
    big[2, 5] = 2.0 / tau
    turned = expm(big * h / pieces)
    phi, q = turned[3:, 3:].T, turned[3:, 3:].T @ turned[:3, 3:]
    whole, noise = np.eye(3), np.zeros((3, 3))
    for _ in range(pieces):
        whole, noise = phi @ whole, phi @ noise @ phi.T + q
    # Our increments are told at the epoch, here the end of the step: W(s) = [h - s, 1].
    at = [np.vstack([s * np.eye(3), np.eye(3)]) for s in (h, 0.0)]
    by_p, by_w, by_v = acceleration_increments(Acceleration(1.0, correlation_s=tau), h, *at)
    assert by_p[[0, 3], 0] == pytest.approx(whole[:2, 2], rel=1e-12)
    g = np.array([by_w[[0, 3], 0], by_v[[0, 3], 0], by_v[[0, 3], 3]]).T
    np.testing.assert_allclose(g @ g.T, noise[:2, :2], rtol=1e-8)
    share = np.sqrt(-np.expm1(-2.0 * h / tau))
    assert share * by_w[[0, 3], 0] == pytest.approx(
        noise[2, :2], rel=1e-8
    )  # with the acceleration's own noise


def test_steps_are_divided_where_an_orbit_bends():
    """White noise over a third of a revolution: the sum over the steps against a fine quadrature."""
    gm, radius = 398600.4, 7000.0
    transition = kepler([radius, 0.0, 0.0, 0.0, np.sqrt(gm / radius), 0.0], gm)
    weights, end = epoch_weights(transition, 0.0), 2000.0
    times = step_times(0.0, end, weights)
    assert 4 < len(times) < 200
    white = Acceleration(1e-9, hold_s=60.0)
    found = np.zeros((6, 6))
    for a, b in itertools.pairwise(times):
        _, _, g = acceleration_increments(white, b - a, weights(a), weights(b))
        found += g @ g.T
    nodes = np.linspace(0.0, end, 161)
    values = np.array([weights(t) @ weights(t).T for t in nodes])
    expected = 1e-18 * 60.0 * trapezoid(values, nodes, axis=0)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 2e-3
