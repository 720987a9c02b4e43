"""Batch least squares against simulated truth: recovery, honest sigmas, chi-squared, Jacobians, outliers, a priori."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation import estimate, observability
from opnav_workbench.estimation.measurements import Dynamics, measurements_of
from opnav_workbench.estimation.parameters import parameter_count, parse_groups
from opnav_workbench.estimation.state_transition import straight_line
from opnav_workbench.geometry.differences import jacobian_by_differences

ENCOUNTER_ET = 490146664.0
OFFSET_KM = 4500.0
DAYS = np.linspace(11.0, 2.2, 8)
EVERYTHING = (
    "target_position",
    "target_velocity",
    "spacecraft_position",
    "spacecraft_velocity",
    "range_scale",
)


@pytest.fixture(scope="module")
def offset_km(approach):
    return OFFSET_KM * approach().toward_sun


@pytest.fixture(scope="module")
def sequence(approach, offset_km):
    """Pluto and Charon in eight pictures, the system 4500 km nearer the Sun than the navigator believes."""
    return approach(target_offset_km=tuple(offset_km), range_sigma=2e-3).observables(DAYS)


# -- recovery ------------------------------------------------------------------------------------------------------


def test_offset_is_recovered_exactly_without_noise(sequence, offset_km):
    """The first pass is linear and errs by tens of kilometers; the passes after it converge quadratically."""
    result = estimate(sequence, ["target_position"])
    assert result.converged
    assert np.abs(result.correction - offset_km).max() < 1e-3  # km, of 4500
    errors = [np.linalg.norm(step - offset_km) for step in result.iterations]
    assert errors[0] > 10.0
    assert errors[1] < 0.1
    assert len(errors) <= 5
    assert result.chi2_before > 1e5
    assert result.chi2_after < 1e-6
    # Every residual is explained; before, they were dozens of pixels.
    assert max(np.abs(r.before).max() for r in result.residuals if r.kind == "center") > 50.0
    assert max(np.abs(r.after).max() for r in result.residuals if r.kind == "center") < 1e-6


def test_residuals_before_are_those_of_the_pictures(sequence):
    """On the sky and through the camera alike, but for how the camera bends between the two places."""
    result = estimate(sequence)
    centers = [r for r in result.residuals if r.kind == "center"]
    for r, o in zip(centers, sequence, strict=True):
        assert (r.image, r.body) == (o.image, o.name)
        np.testing.assert_allclose(r.before, o.residual_px, atol=2e-3 * np.hypot(*o.residual_px))


@pytest.mark.slow
def test_errors_over_sigmas_and_chi_squared_over_many_trials(sequence, noise_of, offset_km):
    """500 trials: the covariance is honest, the bias small, chi-squared distributed as it should be."""
    rng, noise = np.random.default_rng(75), noise_of(sequence)
    errors, sizes, probabilities = [], [], []
    for _ in range(500):
        result = estimate(noise.draw(rng), reject_sigmas=np.inf)
        errors.append((result.correction - offset_km) / result.sigma)
        error = result.correction - offset_km
        sizes.append(error @ np.linalg.solve(result.covariance, error))
        probabilities.append(result.probability)
    errors, sizes = np.array(errors), np.array(sizes)
    scatter = errors.std(axis=0)
    assert (scatter > 0.9).all(), scatter
    assert (scatter < 1.1).all(), scatter
    assert np.abs(errors.mean(axis=0)).max() < 0.15  # sigma; 500 trials know it to 0.045
    assert kstest(sizes, chi2(3).cdf).pvalue > 1e-3
    assert kstest(probabilities, "uniform").pvalue > 1e-3
    # Recovered within 3 sigma, each time but the few that normal errors allow.
    assert np.mean(np.abs(errors).max(axis=1) < 3.0) > 0.98


def test_velocity_and_radius_are_recovered_with_a_priori_sigmas(sequence, noise_of, offset_km):
    a_priori = {"target_position": 1e4, "target_velocity": 1e-3, "range_scale": 1e-3}
    rng = np.random.default_rng(7)
    result = estimate(noise_of(sequence).draw(rng), list(a_priori), a_priori=a_priori)
    truth = np.concatenate([offset_km, np.zeros(4)])
    assert np.abs((result.correction - truth) / result.sigma).max() < 3.5
    assert result.degrees_of_freedom == 2 * 16 + 8 + 7 - 7
    assert 1e-3 < result.probability < 1.0 - 1e-3
    position, covariance = result.group("target_position")
    np.testing.assert_array_equal(position, result.correction[:3])
    np.testing.assert_array_equal(covariance, result.covariance[:3, :3])
    assert result.labels[3:] == ("target_velocity x", "target_velocity y", "target_velocity z", "range_scale")
    assert result.units[-2:] == ("km/s", "")
    np.testing.assert_allclose(np.diag(result.correlation), 1.0)
    with pytest.raises(EstimationError, match="was not estimated"):
        result.group("spacecraft_position")


def test_pointing_error_that_bodies_share_is_weighted_as_shared(approach, noise_of):
    """Pluto and Charon in one picture know their relative place better than either alone, and not their mean."""
    make = approach(center_sigma_px=0.02, pointing_sigma_px=0.5, twist_sigma_rad=1e-9)
    both, one = make.observables([5.0]), make.observables([5.0], names=("PLUTO",))
    names = ["target_position", "target_position:CHARON"]
    u = both[0].position_km / both[0].range_km
    plane = 1e8 * (np.eye(3) - np.outer(u, u)) + np.outer(u, u)  # the distance is known, nothing else
    prior = dict.fromkeys(names, plane)
    pair = estimate(both, names, a_priori=prior)
    km_per_px = 5.0 * DAY_S * 13.78 * 4.963571e-6
    across = np.cross(both[0].position_km, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    system, charon = (np.sqrt(across @ pair.group(name)[1] @ across) / km_per_px for name in names)
    assert system == pytest.approx(0.5, rel=0.02)  # the pointing's share, whatever the number of bodies
    assert charon == pytest.approx(0.02 * np.sqrt(2.0), rel=0.02)  # free of it
    alone = estimate(one, ["target_position"], a_priori={"target_position": plane})
    assert np.sqrt(across @ alone.covariance @ across) / km_per_px == pytest.approx(0.5, rel=0.02)


# -- derivatives ---------------------------------------------------------------------------------------------------


def test_jacobian_is_the_difference_quotient(sequence):
    """Of every parameter, at zero and at the 4500 km."""
    groups = parse_groups((*EVERYTHING, "target_velocity:CHARON", "range_scale:PLUTO"))
    dynamics = Dynamics(ENCOUNTER_ET - 3.0 * DAY_S, straight_line, straight_line)
    measured = measurements_of(sequence, groups, dynamics)
    n = parameter_count(groups)
    steps = np.concatenate([np.repeat([300.0, 3e-3, 300.0, 3e-3], 3), [1e-3], np.full(3, 3e-3), [1e-3]])
    rng = np.random.default_rng(2)
    for point in (np.zeros(n), 3.0 * steps * rng.normal(size=n)):
        jacobian = measured.evaluate(point)[1]
        numerical = -jacobian_by_differences(measured.residuals, point, steps)
        for row, expected in zip(jacobian, numerical, strict=True):
            assert np.abs((row - expected) * steps).max() < 1e-6 * np.abs(expected * steps).max()


def test_jacobian_is_that_of_the_exported_partials(approach):
    """What an orbit determination program would use: d(pixel, line)/d(states), light time solved."""
    observables = approach().observables([5.0, 3.0])
    groups = parse_groups(("spacecraft_position", "target_position", "target_velocity"))
    for o in observables:
        measured = measurements_of([o], groups, Dynamics(o.et, straight_line, straight_line))
        jacobian = measured.evaluate(np.zeros(9))[1]
        exported = (
            o.partials_px_per_km,
            o.target_partials_px_per_km,
            o.target_partials_px_per_km_s,
        )
        for k, partials in enumerate(exported):
            mine = jacobian[:, 3 * k : 3 * k + 3]
            assert np.abs(mine - partials).max() < 1e-6 * np.abs(partials).max()


# -- outliers ------------------------------------------------------------------------------------------------------


def test_outliers_are_named_and_left_out(sequence, noise_of, displaced, offset_km):
    drawn = noise_of(sequence).draw(np.random.default_rng(11))
    drawn[5] = displaced(drawn[5], np.array([1.5, -0.8]))
    drawn[8] = displaced(drawn[8], np.zeros(2), 0.03 * drawn[8].range_km)
    result = estimate(drawn)
    rejected = [r for r in result.residuals if not r.used]
    assert [(r.image, r.body, r.kind) for r in rejected] == [
        ("lor_002.fit", "CHARON", "center"),
        ("lor_004.fit", "PLUTO", "range"),
    ]
    assert all("sigma off after the fit" in r.reason for r in rejected)
    assert all(r.sigmas > 8.0 for r in rejected)
    assert result.degrees_of_freedom == 2 * 15 + 7 - 3
    assert np.abs((result.correction - offset_km) / result.sigma).max() < 3.0
    assert result.probability > 1e-3
    kept = estimate(drawn, reject_sigmas=np.inf)
    assert all(r.used for r in kept.residuals)
    assert kept.probability < 1e-10


def test_wrong_sigmas_are_an_error_and_not_outliers(sequence, displaced):
    rng = np.random.default_rng(4)
    wild = [displaced(o, rng.normal(size=2) * 8.0) for o in sequence]
    with pytest.raises(EstimationError, match=r"7 of 24 measurements|9 of 24 measurements"):
        estimate(wild)


def test_what_is_not_measured_is_left_out_with_its_status(sequence):
    few = [
        replace(sequence[0], observed_px=None, status="not_detected"),
        replace(sequence[1], status="uncertain"),
        *sequence[2:],
    ]
    result = estimate(few)
    assert result.left_out == ("PLUTO in lor_000.fit: not_detected", "CHARON in lor_000.fit: uncertain")
    assert len(estimate(few, statuses=("ok", "uncertain")).residuals) == len(result.residuals) + 1


# -- a priori, and what pictures determine ---------------------------------------------------------------------------


def test_a_priori_adds_its_information(approach):
    sequence = approach(range_sigma=2e-3).observables(DAYS)
    free = estimate(sequence)
    prior = np.diag([50.0, 60.0, 70.0]) ** 2 + 900.0
    held = estimate(sequence, a_priori={"target_position": prior})
    expected = np.linalg.inv(np.linalg.inv(free.covariance) + np.linalg.inv(prior))
    np.testing.assert_allclose(held.covariance, expected, rtol=1e-6)
    np.testing.assert_allclose(estimate(sequence, a_priori=prior).covariance, held.covariance, rtol=1e-9)
    # What no picture sees keeps its a priori sigma.
    both = estimate(
        sequence,
        ["target_position", "spacecraft_position"],
        a_priori={"target_position": 1e4, "spacecraft_position": 10.0},
    )
    np.testing.assert_allclose(both.sigma[3:], 10.0, rtol=1e-3)
    # Their sum is the sky's; the one known less takes it.
    state, covariance = both.relative_state()
    np.testing.assert_allclose(state[:3], -free.correction, atol=1e-3)
    assert not state[3:].any()
    assert np.sqrt(np.diag(covariance))[0] < 10.0


def test_what_nothing_determines_is_an_error_that_says_so(sequence):
    with pytest.raises(EstimationError, match="the pictures do not determine 3 of 6 parameters") as caught:
        estimate(sequence, ["target_position", "spacecraft_position"])
    assert "give a priori sigmas or estimate less" in str(caught.value)
    single = [replace(o, measured_range_km=np.nan) for o in sequence[:1]]
    with pytest.raises(EstimationError, match="target position down-track"):
        estimate(single)


def test_directions_say_what_pictures_determine(sequence, approach):
    s = approach().s
    directions = observability(sequence, ["target_position"])
    assert [d.words.split(":")[0] for d in directions] == [
        "target position cross-track",
        "target position cross-track",
        "target position down-track (along the line of sight)",
    ]
    assert abs(directions[2].vector @ s) > 0.999
    assert directions[2].sigma > 50.0 * directions[1].sigma
    # The sigmas are those of the covariance without a priori knowledge.
    covariance = estimate(sequence).covariance
    values = np.sqrt(np.linalg.eigvalsh(covariance))
    np.testing.assert_allclose([d.sigma for d in directions], values, rtol=0.01)
    single = [replace(o, measured_range_km=np.nan) for o in sequence[:1]]
    last = observability(single, ["target_position"])[-1]
    assert not last.determined
    assert last.sigma == np.inf
    assert (
        last.words
        == "target position down-track (along the line of sight): not determined by the measurements"
    )


def test_range_takes_what_the_centers_leave(approach, offset_km):
    """One picture: centers see across; the size of 0.2 % alone sees along, with its own sigma."""
    (o,) = approach(target_offset_km=tuple(offset_km), range_sigma=2e-3).observables([2.2], names=("PLUTO",))
    result = estimate([o], a_priori={"target_position": 1e5})
    u = o.position_km / o.range_km
    assert np.sqrt(u @ result.covariance @ u) == pytest.approx(o.range_sigma_km, rel=1e-2)
    assert u @ (result.correction - offset_km) == pytest.approx(0.0, abs=0.01 * o.range_sigma_km)
    scaled = estimate(
        [o], ["target_position", "range_scale"], a_priori={"target_position": 1e5, "range_scale": 2e-3}
    )
    # A radius known to 0.2 % doubles the variance.
    assert np.sqrt(u @ scaled.covariance[:3, :3] @ u) == pytest.approx(
        np.sqrt(2.0) * o.range_sigma_km, rel=1e-2
    )


# -- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "a_priori", "message"),
    [
        ((), None, "no parameters to estimate"),
        (("target",), None, "unknown parameter 'target'; choose among target_position"),
        (("spacecraft_position:PLUTO",), None, "unknown parameter"),
        (("target_position", "target_position"), None, "given twice"),
        (("target_position:NIX",), None, "no observable of that body"),
        (("target_position",), {"target_velocity": 1.0}, "target_velocity, which is not estimated"),
        (("target_position",), {"target_position": 0.0}, "not positive definite"),
        (("target_position",), np.eye(2), r"shape \(2, 2\); expected \(3, 3\)"),
    ],
)
def test_bad_parameters_are_one_line(sequence, parameters, a_priori, message):
    with pytest.raises(EstimationError, match=message) as caught:
        estimate(sequence, parameters, a_priori=a_priori)
    assert "\n" not in str(caught.value)


def test_bad_observables_are_one_line(sequence):
    with pytest.raises(EstimationError, match=r"PLUTO in lor_000.fit is given twice, by several methods"):
        estimate([sequence[0], replace(sequence[0], method="ellipse")])
    with pytest.raises(EstimationError, match=r"lor_000.fit has no position_km"):
        estimate([replace(sequence[0], position_km=None)])
    with pytest.raises(EstimationError, match="none of 1 observables has a center with status ok"):
        estimate([replace(sequence[0], status="failed")])
