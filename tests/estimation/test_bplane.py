"""The B-plane against closed forms of the hyperbola, SPICE's elements, and the numbers of the Pluto rehearsal."""

import numpy as np
import pytest
import spiceypy

from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation import (
    b_plane,
    b_plane_partials,
    error_ellipse,
    estimate,
    map_to_b_plane,
    propagate_two_body,
)
from opnav_workbench.geometry.differences import jacobian_by_differences
from opnav_workbench.kernels import KernelSet, et_from_utc, state, utc_from_et

GM_JUPITER, GM_PLUTO = 126712764.1, 975.5
ENCOUNTER_ET = 490146664.0


def hyperbola(s, t, b_dot_t, b_dot_r, v_infinity, gm, anomaly):
    """State on the hyperbola with this B at a hyperbolic anomaly, from a, e and the perifocal frame; and its time."""
    r_axis = np.cross(s, t)
    b = b_dot_t * t + b_dot_r * r_axis
    a = gm / v_infinity**2
    e = np.sqrt(1.0 + (np.linalg.norm(b) / a) ** 2)
    normal = np.cross(b, s) / np.linalg.norm(b)
    half = np.arccos(1.0 / e)  # between the asymptote's direction and periapsis
    p = np.cos(half) * s + np.sin(half) * np.cross(s, normal)
    q = np.cross(normal, p)
    x, y = a * (e - np.cosh(anomaly)), a * np.sqrt(e * e - 1.0) * np.sinh(anomaly)
    rate = v_infinity / a / (e * np.cosh(anomaly) - 1.0)
    position = x * p + y * q
    velocity = rate * (-a * np.sinh(anomaly) * p + a * np.sqrt(e * e - 1.0) * np.cosh(anomaly) * q)
    return position, velocity, (e * np.sinh(anomaly) - anomaly) * a / v_infinity, a * (e - 1.0), e


@pytest.mark.parametrize("gm", [GM_JUPITER, GM_PLUTO])
@pytest.mark.parametrize("anomaly", [-6.0, -2.0, -0.1, 0.5])
def test_values_put_in_come_back(gm, anomaly):
    s = np.array([0.3, -0.8, 0.52])
    s /= np.linalg.norm(s)
    t = np.cross(s, [0.0, 0.0, 1.0])
    t /= np.linalg.norm(t)
    position, velocity, time_s, periapsis, e = hyperbola(s, t, 4e5, -7e5, 11.0, gm, anomaly)
    flyby = b_plane(position, velocity, gm, "j2000")
    np.testing.assert_allclose(flyby.s, s, atol=1e-11)
    np.testing.assert_allclose(flyby.t, t, atol=1e-11)
    np.testing.assert_allclose(np.cross(flyby.s, flyby.t), flyby.r, atol=1e-15)
    assert flyby.b_dot_t_km == pytest.approx(4e5, rel=1e-9)
    assert flyby.b_dot_r_km == pytest.approx(-7e5, rel=1e-9)
    assert flyby.v_infinity_km_s == pytest.approx(11.0, rel=1e-10)
    assert flyby.closest_km == pytest.approx(periapsis, rel=1e-9)
    assert flyby.closest_s == pytest.approx(-time_s, rel=1e-8, abs=1e-3)
    assert flyby.eccentricity == pytest.approx(e, rel=1e-9)
    # SPICE's elements of the same state: periapsis and, from its mean anomaly, the time of it.
    perifocal, eccentricity, *_, mean, _, _ = spiceypy.oscelt(np.concatenate([position, velocity]), 0.0, gm)
    assert flyby.closest_km == pytest.approx(perifocal, rel=1e-9)
    assert flyby.closest_s == pytest.approx(-mean * gm / 11.0**3, rel=1e-6, abs=1e-2)
    assert eccentricity == pytest.approx(e, rel=1e-8)


def test_flyby_is_the_same_from_every_point_of_the_orbit():
    position, velocity = np.array([-3e6, 4e5, -2e5]), np.array([14.0, 0.5, 0.3])
    first = b_plane(position, velocity, GM_JUPITER)
    for time_s in (-1e5, 1e5, 4e5):
        later = propagate_two_body(np.concatenate([position, velocity]), GM_JUPITER, time_s)
        other = b_plane(later[:3], later[3:], GM_JUPITER)
        np.testing.assert_allclose(other.in_axes_of(first)[:2], first.in_axes_of(first)[:2], rtol=1e-8)
        assert other.closest_s + time_s == pytest.approx(first.closest_s, abs=1e-3)
        assert other.linearized_s + time_s == pytest.approx(first.linearized_s, abs=1e-3)


def test_linearized_time_does_not_depend_on_the_miss():
    """Two spacecraft side by side far out: the nearer one comes to periapsis half an hour sooner or later, LTOF does not."""
    s, t, v_infinity, far_km = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0]), 9.0, 1e12
    times = []
    for miss in (7e5, 7.5e5):
        e = np.sqrt(1.0 + (miss * v_infinity**2 / GM_JUPITER) ** 2)
        anomaly = -np.log(2.0 * far_km * v_infinity**2 / (GM_JUPITER * e))  # r = a (e cosh F - 1)
        position, velocity, *_ = hyperbola(s, t, miss, 0.0, v_infinity, GM_JUPITER, anomaly)
        flyby = b_plane(position, velocity, GM_JUPITER, "j2000")
        # Both counted from the same place along the asymptote, where gravity is gone.
        times.append(np.array([flyby.closest_s, flyby.linearized_s]) + position @ s / v_infinity)
    closest, linearized = np.abs(times[0] - times[1])
    assert closest > 2000.0
    assert linearized < 1.0


def test_straight_line_is_the_limit_of_weak_gravity():
    position, velocity = np.array([-2e6, 9e3, -6e3]), np.array([13.8, 0.02, -0.01])
    line, weak = b_plane(position, velocity), b_plane(position, velocity, 1e-4)
    assert np.linalg.norm(weak.b_km) == pytest.approx(np.linalg.norm(line.b_km), rel=1e-8)
    assert weak.closest_s == pytest.approx(line.closest_s, abs=1e-3)
    assert line.closest_s == line.linearized_s == pytest.approx(-position @ velocity / (velocity @ velocity))
    assert line.closest_km == np.linalg.norm(line.b_km)
    # The linear far field of the facts: B = r - (r.S) S, LTOF = -(r.S)/v.
    s = velocity / np.linalg.norm(velocity)
    np.testing.assert_allclose(line.b_km, position - (position @ s) * s, rtol=1e-14)


@pytest.mark.parametrize("gm", [0.0, GM_PLUTO, GM_JUPITER])
def test_partials_are_differences_and_closed_forms(gm):
    position, velocity = np.array([-2.5e6, 3e5, -2e5]), np.array([13.0, 1.2, -0.7])
    partials = b_plane_partials(position, velocity, gm)
    nominal = b_plane(position, velocity, gm)
    steps = np.concatenate([np.full(3, 50.0), np.full(3, 3e-4)])
    expected = jacobian_by_differences(
        lambda x: b_plane(x[:3], x[3:], gm).in_axes_of(nominal), np.concatenate([position, velocity]), steps
    )
    for row, other in zip(partials, expected, strict=True):
        assert np.abs((row - other) * steps).max() < 1e-7 * np.abs(other * steps).max()
    if gm == 0.0:
        speed, along = nominal.v_infinity_km_s, position @ nominal.s
        across = np.eye(3) - np.outer(nominal.s, nominal.s)
        axes = np.array([nominal.t, nominal.r])
        closed = np.zeros((3, 6))
        closed[:2, :3] = axes @ across
        closed[:2, 3:] = -along / speed * axes @ across
        closed[2, :3] = -nominal.s / speed
        closed[2, 3:] = -(across @ position) / speed**2 + along / speed**2 * nominal.s
        scale = 1.0 / steps
        assert np.abs((partials - closed) / scale).max() < 1e-9 * np.abs(closed / scale).max()


def test_pole_chooses_the_axes_alone():
    position, velocity = np.array([-2e6, 9e3, -6e3]), np.array([13.8, 0.02, -0.01])
    ecliptic, equator = (b_plane(position, velocity, GM_PLUTO, pole) for pole in ("ecliptic", "j2000"))
    np.testing.assert_allclose(ecliptic.b_km, equator.b_km)
    north = np.array([0.0, -np.sin(np.radians(84381.448 / 3600.0)), np.cos(np.radians(84381.448 / 3600.0))])
    assert abs(ecliptic.t @ north) < 1e-15
    assert ecliptic.r @ north < 0.0  # R points south
    own = b_plane(position, velocity, GM_PLUTO, 5.0 * north)
    np.testing.assert_allclose(own.t, ecliptic.t, atol=1e-12)
    np.testing.assert_allclose(north, spiceypy.pxform("ECLIPJ2000", "J2000", 0.0)[:, 2], atol=1e-15)


@pytest.mark.parametrize(
    ("position", "velocity", "gm", "pole", "message"),
    [
        ((1e5, 0, 0), (0, 0.05, 0), GM_PLUTO, "ecliptic", "needs an open orbit"),
        ((1e5, 0, 0), (5, 0, 0), GM_PLUTO, "ecliptic", "misses the center"),
        ((1e5, 0, 0), (0, 0, 0), 0.0, "ecliptic", "no flyby with"),
        ((np.nan, 0, 0), (5, 0, 0), 0.0, "ecliptic", "no flyby with"),
        ((1e5, 0, 0), (5, 1, 0), 0.0, "up", "unknown pole 'up'; choose one of ecliptic, j2000"),
        ((1e5, 0, 0), (0, 0, 3), 0.0, "j2000", "lies along the pole"),
    ],
)
def test_what_is_no_flyby_is_one_line(position, velocity, gm, pole, message):
    with pytest.raises(EstimationError, match=message) as caught:
        b_plane(position, velocity, gm, pole)
    assert "\n" not in str(caught.value)


# -- the Pluto rehearsal -------------------------------------------------------------------------------------------


def test_numbers_of_the_rehearsal_in_closed_form(approach):
    """13 695 km miss; 4500 km sunward at 15 degrees: 4347 km down-track, 1165 km cross-track, 315 s (facts, section 10)."""
    make = approach()
    position, velocity = make.relative_km(ENCOUNTER_ET - 3.0 * DAY_S), make.speed_km_s * make.s
    nominal = b_plane(position, velocity, pole="j2000")
    assert np.linalg.norm(nominal.b_km) == pytest.approx(13695.0, abs=1e-3)
    assert nominal.linearized_s == pytest.approx(3.0 * DAY_S, abs=1e-3)
    moved = b_plane(position - 4500.0 * make.toward_sun, velocity, pole="j2000")
    shift = moved.in_axes_of(nominal) - nominal.in_axes_of(nominal)
    assert np.hypot(shift[0], shift[1]) == pytest.approx(1165.0, abs=0.5)
    assert shift[2] * make.speed_km_s == pytest.approx(-4347.0, abs=0.5)
    assert shift[2] == pytest.approx(-315.0, abs=0.6)


def test_numbers_of_the_rehearsal_with_the_kernels():
    """The real approach: closest approach at 11:49:57 UTC, 13 695 km from Pluto, and 4500 km toward the real Sun."""
    with KernelSet("new_horizons/pluto_approach"):
        et = et_from_utc("2015-07-13T11:00:00")
        craft = state("NEW HORIZONS", et, "PLUTO BARYCENTER")
        sun = state("SUN", et, "PLUTO BARYCENTER").position_km
        pluto = state("PLUTO", et, "PLUTO BARYCENTER").position_km
        charon = state("CHARON", et, "PLUTO")
        flyby = b_plane(craft.position_km, craft.velocity_km_s, GM_PLUTO)
        assert utc_from_et(et + flyby.closest_s, 0) in ("2015-07-14T11:49:57", "2015-07-14T11:49:58")
    # Pluto swings about the barycenter by two-body motion until the encounter, which the kernels do not cover.
    share = pluto @ charon.position_km / (charon.position_km @ charon.position_km)
    own = np.concatenate([craft.position_km, craft.velocity_km_s])
    moon = np.concatenate([charon.position_km, charon.velocity_km_s])
    distances = [
        np.linalg.norm(
            (propagate_two_body(own, GM_PLUTO, t) - share * propagate_two_body(moon, GM_PLUTO, t))[:3]
        )
        for t in flyby.closest_s + np.arange(-300.0, 300.0, 10.0)
    ]
    assert min(distances) == pytest.approx(
        13695.0, abs=25.0
    )  # as flown: of a trajectory to 5 km, moons to 1 km
    toward = sun / np.linalg.norm(sun)
    moved = b_plane(craft.position_km - 4500.0 * toward, craft.velocity_km_s, GM_PLUTO)
    shift = moved.in_axes_of(flyby) - flyby.in_axes_of(flyby)
    assert np.hypot(shift[0], shift[1]) == pytest.approx(1165.0, abs=2.0)
    assert -shift[2] * flyby.v_infinity_km_s == pytest.approx(4347.0, abs=2.0)
    assert shift[2] == pytest.approx(-315.0, abs=1.0)


@pytest.mark.slow
def test_estimate_in_the_b_plane_over_many_trials(approach, noise_of):
    """4500 km found from pictures: the flyby moves by as much, with a covariance that 200 trials confirm."""
    offset = 4500.0 * approach().toward_sun
    make = approach(target_offset_km=tuple(offset), range_sigma=2e-3)
    observables = make.observables(np.linspace(11.0, 2.2, 6))
    epoch = observables[-1].et
    position, velocity = make.relative_km(epoch), make.speed_km_s * make.s
    true = b_plane(position - offset, velocity, GM_PLUTO)
    noise, rng, scores = noise_of(observables), np.random.default_rng(8), []
    for _ in range(200):
        result = estimate(noise.draw(rng), epoch_et=epoch, reject_sigmas=np.inf)
        solution = map_to_b_plane(result, position, velocity, GM_PLUTO)
        scores.append((solution.values_after - true.in_axes_of(solution.a_priori)) / solution.sigma)
    assert np.abs(np.std(scores, axis=0) - 1.0).max() < 0.175  # 3.5 sigma of 200 trials
    assert np.abs(np.mean(scores, axis=0)).max() < 0.25
    assert np.hypot(*solution.shift[:2]) == pytest.approx(1165.0, abs=10.0)
    assert solution.shift[2] == pytest.approx(-315.0, abs=4.0 * solution.sigma[2])
    # Pictures see across: kilometers in the B-plane, but many seconds of arrival.
    assert solution.ellipse.semi_major_km < 10.0
    assert solution.sigma[2] > 5.0


def test_error_ellipse_is_that_of_the_covariance():
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    ellipse = error_ellipse(turn @ np.diag([25.0, 4.0]) @ turn.T)
    assert (ellipse.semi_major_km, ellipse.semi_minor_km) == pytest.approx((5.0, 2.0))
    assert ellipse.angle_rad == pytest.approx(0.4)
