"""State transitions and two-body motion, against SPICE's own and by differences."""

import numpy as np
import pytest
import spiceypy
from scipy.optimize import brentq

from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation import estimate, kepler, propagate_two_body, straight_line
from opnav_workbench.geometry.differences import jacobian_by_differences

CHARON = np.array([17500.0, 3000.0, -8000.0, 0.03, 0.19, 0.06])
GM = 975.5


def relative(first, second):
    return max(
        np.linalg.norm(first[i] - second[i]) / np.linalg.norm(second[i]) for i in (slice(0, 3), slice(3, 6))
    )


def by_keplers_equation(state, gm, time_s):
    """Ellipse or hyperbola by the difference x of its (eccentric, hyperbolic) anomaly; f and g (Battin, 1999)."""
    r, v = state[:3], state[3:]
    distance, radial = np.linalg.norm(r), r @ v
    a = 1.0 / (2.0 / distance - v @ v / gm)
    bound, size = a > 0.0, abs(a)
    sine, cosine = (np.sin, np.cos) if bound else (np.sinh, np.cosh)
    mean_motion = np.sqrt(gm / size**3)
    e_cos, e_sin = 1.0 - distance / a, radial / np.sqrt(gm * size)

    def late(x):
        turned = x - e_cos * sine(x) if bound else e_cos * sine(x) - x
        return turned + e_sin * (1.0 - cosine(x) if bound else cosine(x) - 1.0) - mean_motion * time_s

    reach = 1.0
    while late(reach) * late(-reach) > 0.0:
        reach *= 2.0
    x = brentq(late, -reach, reach, xtol=1e-14, rtol=1e-14)
    swept = (1.0 - cosine(x)) if bound else (cosine(x) - 1.0)
    f, g = 1.0 - size / distance * swept, time_s - abs(x - sine(x)) * np.sign(x) / mean_motion
    place = f * r + g * v
    after = np.linalg.norm(place)
    f_rate, g_rate = -np.sqrt(gm * size) * sine(x) / (after * distance), 1.0 - size / after * swept
    return np.concatenate([place, f_rate * r + g_rate * v])


def test_two_body_motion_solves_keplers_equation():
    """Ellipses and hyperbolas, forward and back, a few times the present distance over speed."""
    rng = np.random.default_rng(1)
    for _ in range(500):
        gm = 10.0 ** rng.uniform(-1.0, 6.0)
        r = rng.normal(size=3) * 10.0 ** rng.uniform(3.0, 5.0)
        v = rng.normal(size=3) * np.sqrt(gm / np.linalg.norm(r)) * 10.0 ** rng.uniform(-0.5, 1.0)
        state = np.concatenate([r, v])
        time_s = rng.uniform(-5.0, 5.0) * np.linalg.norm(r) / np.linalg.norm(v)
        assert relative(propagate_two_body(state, gm, time_s), by_keplers_equation(state, gm, time_s)) < 1e-9
    escape = np.array([1e4, 0.0, 0.0, 0.0, np.sqrt(2.0 * GM / 1e4), 0.0])
    d = brentq(
        lambda d: d + d**3 / 3.0 - 1e5 * np.sqrt(GM / (2.0 * 1e4**3)), 0.0, 100.0, xtol=1e-14
    )  # Barker
    np.testing.assert_allclose(
        propagate_two_body(escape, GM, 1e5)[:2], [1e4 * (1 - d * d), 2e4 * d], rtol=1e-12
    )


def test_two_body_motion_comes_back():
    """Over up to a thousand revolutions, and far out on hyperbolas."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        r, v = rng.normal(size=(2, 3))
        state = np.concatenate([2e4 * r, rng.uniform(0.3, 2.0) * np.sqrt(2.0 * GM / 2e4) * v])
        time_s = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(2.0, 6.0)
        there = propagate_two_body(state, GM, time_s)
        assert relative(propagate_two_body(there, GM, -time_s), state) < 1e-9


def test_two_body_motion_at_once_and_without_gravity():
    np.testing.assert_array_equal(propagate_two_body(CHARON, GM, 0.0), CHARON)
    moved = propagate_two_body(CHARON, 0.0, 100.0)
    np.testing.assert_allclose(moved[:3], CHARON[:3] + 100.0 * CHARON[3:], rtol=1e-15)
    for state, gm in ((np.zeros(6), GM), (np.full(6, np.nan), GM), (CHARON, -1.0)):
        with pytest.raises(EstimationError, match="no two-body orbit"):
            propagate_two_body(state, gm, 1.0)


@pytest.mark.parametrize("days", [-6.4, -0.5, 0.01, 3.0])
def test_kepler_transition_is_the_difference_of_orbits(days):
    """Differences of SPICE's propagation; and the matrix keeps volume (its determinant is 1)."""
    time_s = 86400.0 * days
    matrix = kepler(CHARON, GM)(100.0, 100.0 + time_s)
    steps = np.concatenate([np.full(3, 20.0), np.full(3, 2e-4)])
    expected = jacobian_by_differences(lambda s: np.array(spiceypy.prop2b(GM, s, time_s)), CHARON, steps)
    scale = np.outer(1.0 / steps, steps)  # km and km/s compared
    assert np.abs((matrix - expected) * scale).max() < 1e-6 * np.abs(expected * scale).max()
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-6)


def test_straight_line_is_the_limit_without_gravity():
    np.testing.assert_allclose(kepler(CHARON, 0.0)(0.0, 5e4), straight_line(0.0, 5e4), atol=1e-7)


def test_estimate_uses_the_transition_that_is_given(approach):
    """Charon's orbit about Pluto: with two-body motion its error moves as the orbit does, not in a line."""
    make = approach(center_sigma_px=0.02, pointing_sigma_px=0.02)
    days = np.linspace(12.0, 4.0, 9)
    observables = make.observables(days, names=("CHARON",))
    epoch = observables[0].et
    state = np.concatenate([make.body_km("CHARON", epoch), np.zeros(3)])
    step = 1.0
    state[3:] = (make.body_km("CHARON", epoch + step) - make.body_km("CHARON", epoch - step)) / (2.0 * step)
    prior = {"target_position": 500.0, "target_velocity": 0.01}
    options = {"a_priori": prior, "epoch_et": epoch}
    line = estimate(observables, list(prior), **options)
    orbit = estimate(observables, list(prior), target_transition=kepler(state, GM), **options)
    # Down-track: a line of sight sees it through the orbit alone.
    u = make.s
    along = [np.sqrt(u @ result.covariance[:3, :3] @ u) for result in (line, orbit)]
    assert along[1] < 0.2 * along[0]
