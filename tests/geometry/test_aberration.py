"""Stellar aberration against SPICE, against special relativity by another road, and both inverses."""

import numpy as np
import pytest
import spiceypy
from hypothesis import given
from hypothesis import strategies as st

from opnav_workbench import geometry as geo
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S

C = SPEED_OF_LIGHT_KM_S
ROUNDING_RAD = 1e-14
ARCSEC = np.pi / 180 / 3600
CONVENTIONS = pytest.mark.parametrize("convention", ["spice", "relativistic"])


def _random_directions(n, seed=5):
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _lorentz_boosted(direction, velocity_km_s):
    """Direction of a source: the null 4-vector of its incoming light, boosted by the 4x4 Lorentz matrix."""
    beta = np.asarray(velocity_km_s) / C
    b2 = beta @ beta
    gamma = 1.0 / np.sqrt(1.0 - b2)
    boost = np.eye(4)
    boost[0, 0] = gamma
    boost[0, 1:] = boost[1:, 0] = -gamma * beta
    boost[1:, 1:] += (gamma - 1.0) * np.outer(beta, beta) / b2
    photon = boost @ np.concatenate([[1.0], -np.asarray(direction)])
    return -photon[1:] / photon[0]


@pytest.mark.parametrize("speed", [0.5, 14.5, 35.0, 300.0])
def test_spice_convention_agrees_with_stelab(speed):
    velocity = speed * geo.unit([0.3, -0.8, 0.5])
    directions = _random_directions(200)
    ours = geo.apparent_direction(directions, velocity)
    spice = np.array([spiceypy.stelab(d, velocity) for d in directions])
    assert geo.angle_between(ours, spice).max() < ROUNDING_RAD


@pytest.mark.parametrize("speed", [14.5, 35.0, 0.6 * C])
def test_relativistic_convention_agrees_with_a_lorentz_boost(speed):
    velocity = speed * geo.unit([0.3, -0.8, 0.5])
    directions = _random_directions(200, seed=6)
    ours = geo.apparent_direction(directions, velocity, "relativistic")
    boosted = np.array([_lorentz_boosted(d, velocity) for d in directions])
    np.testing.assert_allclose(np.linalg.norm(boosted, axis=1), 1.0, atol=1e-14)  # light stays light
    assert geo.angle_between(ours, boosted).max() < ROUNDING_RAD


@pytest.mark.parametrize(("speed", "limit_mas"), [(14.5, 0.13), (35.0, 0.71)])
def test_conventions_differ_by_less_than_a_milliarcsecond(speed, limit_mas):
    """0.12 and 0.70 mas at the worst angle, 45 deg; and not zero, which would mean one formula twice."""
    w = np.linspace(0.0, np.pi, 181)
    directions = np.stack([np.cos(w), np.sin(w), np.zeros_like(w)], axis=1)
    velocity = [speed, 0.0, 0.0]
    difference = geo.angle_between(
        geo.apparent_direction(directions, velocity),
        geo.apparent_direction(directions, velocity, "relativistic"),
    )
    worst_mas = difference.max() / ARCSEC * 1e3
    assert 0.9 * limit_mas < worst_mas < limit_mas


@CONVENTIONS
def test_a_star_abeam_moves_forward_by_ten_arcseconds(convention):
    apparent = geo.apparent_direction([0.0, 0.0, 1.0], [14.5, 0.0, 0.0], convention)
    assert apparent[0] == pytest.approx(9.976 * ARCSEC, rel=1e-4)
    assert apparent[1] == 0.0


@CONVENTIONS
@given(
    st.floats(0.0, np.pi),
    st.floats(0.0, 2 * np.pi),
    st.floats(0.0, 0.9),
)
def test_inverse_round_trip(convention, w, around, beta):
    direction = np.array([np.cos(w), np.sin(w) * np.cos(around), np.sin(w) * np.sin(around)])
    velocity = [beta * C, 0.0, 0.0]
    apparent = geo.apparent_direction(direction, velocity, convention)
    assert np.linalg.norm(apparent) == pytest.approx(1.0, rel=0, abs=4e-16)
    back = geo.geometric_direction(apparent, velocity, convention)
    # Directions astern of a fast observer spread by up to (1 + beta) / (1 - beta), and rounding with them.
    assert geo.angle_between(back, direction) < ROUNDING_RAD * (1.0 if beta < 0.01 else 3.0 / (1.0 - beta))


@CONVENTIONS
def test_inverse_round_trip_at_flight_speeds(convention):
    rng = np.random.default_rng(7)
    directions, velocities = _random_directions(2000, seed=8), rng.normal(size=(2000, 3)) * 30.0
    apparent = geo.apparent_direction(directions, velocities, convention)
    back = geo.geometric_direction(apparent, velocities, convention)
    assert geo.angle_between(back, directions).max() < 1e-15
    assert geo.angle_between(apparent, directions).max() > 20 * ARCSEC


@CONVENTIONS
def test_no_velocity_no_change_and_length_does_not_matter(convention):
    directions = _random_directions(10)
    still = geo.apparent_direction(directions, np.zeros(3), convention)
    np.testing.assert_allclose(still, directions, rtol=0, atol=3e-16)
    scaled = geo.apparent_direction(directions * 4.0e9, [10.0, 20.0, -5.0], convention)
    np.testing.assert_allclose(
        scaled, geo.apparent_direction(directions, [10.0, 20.0, -5.0], convention), rtol=0, atol=3e-16
    )


def test_empty_and_single_shapes():
    assert geo.apparent_direction(np.empty((0, 3)), [1.0, 2.0, 3.0]).shape == (0, 3)
    assert geo.geometric_direction([1.0, 0.0, 0.0], [1.0, 2.0, 3.0]).shape == (3,)


@pytest.mark.parametrize("velocity", [[3.1e5, 0, 0], [C, 0, 0], [np.nan, 0, 0]])
def test_impossible_speeds_are_refused(velocity):
    with pytest.raises(ValueError, match="not below that of light"):
        geo.apparent_direction([1.0, 0.0, 0.0], velocity)


def test_unknown_conventions_are_refused():
    with pytest.raises(ValueError, match="unknown convention 'classical'"):
        geo.apparent_direction([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], "classical")  # type: ignore[arg-type]
