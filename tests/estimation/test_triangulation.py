"""Triangulation: truth, Monte Carlo, a brute-force minimiser, closed forms, and the published fix of New Horizons.

Published: Lauer et al. (2025), AJ 170, 22, doi:10.3847/1538-3881/addabe, with its notebook (doi:10.5281/zenodo.15359866):
mean directions of six pictures each, their errors, and the position from them.
"""

from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import Distance, SkyCoord
from astropy.time import Time
from scipy.optimize import minimize

from opnav_workbench.catalog import StarTable, read_star_list
from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation import best_pairs, nearest_stars, star_positions, triangulate
from opnav_workbench.geometry import angle_between, radec_from_unit, rotation_from_vector, tangent_basis, unit
from opnav_workbench.resources import kernels_meta_dir

ARCSEC = np.pi / 648000.0
MAS = 1e-3 * ARCSEC
PARSEC_KM = 648000.0 / np.pi * AU_KM
ET = 640_900_000.0  # 2020-04-23
NEW_HORIZONS_KM = np.array([13.549, -42.019, -16.457]) * AU_KM
# Four stars at 1.3 to 3.2 parsecs, and catalog errors large enough to matter beside 0.2 arcsec.
STARS_KM = np.array([[1.2, -0.4, 0.3], [-0.5, 2.3, 0.6], [0.3, -0.9, -2.6], [-2.5, -1.2, 1.6]]) * PARSEC_KM
SIGMA = 0.2 * ARCSEC
STAR_COVARIANCE = np.array([np.diag([0.3, 0.5, 0.4]), np.diag([0.9, 0.2, 0.6])] * 2) ** 2 * AU_KM**2


@pytest.fixture(scope="module")
def flight_stars() -> StarTable:
    """Proxima Centauri and Wolf 359."""
    return read_star_list(kernels_meta_dir() / "new_horizons" / "stars.yaml")


def tilted(directions: np.ndarray, east_north: np.ndarray) -> np.ndarray:
    """Directions moved by small angles toward east and north."""
    basis = np.stack(tangent_basis(*radec_from_unit(directions)), axis=1)
    return unit(directions + np.einsum("ni,nij->nj", east_north, basis))


# -- truth ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 3, 4])
def test_errorless_directions_give_the_place(n):
    fix = triangulate(unit(STARS_KM[:n] - NEW_HORIZONS_KM), STARS_KM[:n], SIGMA**2)
    assert np.linalg.norm(fix.position_km - NEW_HORIZONS_KM) < 1.0  # 1e-16 of 4e13 km, a few times over
    assert fix.chi2 < 1e-12
    assert fix.degrees_of_freedom == 2 * n - 3
    np.testing.assert_allclose(fix.distance_km, np.linalg.norm(STARS_KM[:n] - NEW_HORIZONS_KM, axis=1))


def test_the_published_position_of_new_horizons(flight_stars):
    """Published: 0.351 au from the trajectory; semi-axes 0.441, 0.233 and 0.206 au from 0.44 arcsec a picture."""
    directions = np.radians([[217.363147017, -62.676324134], [164.094300560, 7.001008218]])
    places = star_positions(flight_stars, ET, NEW_HORIZONS_KM)
    fix = triangulate(
        directions,
        places.position_km,
        (0.44 * ARCSEC) ** 2 / 6.0,
        star_covariance_km2=places.covariance_km2,
    )
    assert np.linalg.norm(fix.position_km - NEW_HORIZONS_KM) / AU_KM == pytest.approx(0.351, abs=0.005)
    assert fix.semi_axes_km / AU_KM == pytest.approx([0.441, 0.233, 0.206], abs=0.003)
    assert fix.sigmas_from(NEW_HORIZONS_KM) < 1.5


def test_errors_over_sigma_with_catalog_errors_and_repeated_stars(sample):
    """1500 trials, all told: scatter within 10 % of the covariance, no bias, chi-squared as the degrees of freedom."""
    rng = np.random.default_rng(7)
    which = np.array([0, 0, 1, 2, 3, 1])
    truth_lines = unit(STARS_KM[which] - NEW_HORIZONS_KM)
    factor = np.linalg.cholesky(STAR_COVARIANCE)
    trials = sample.trials(1500)
    errors, chi2 = np.empty((trials, 3)), np.empty(trials)
    for i in range(trials):
        measured = tilted(truth_lines, rng.normal(0.0, SIGMA, (6, 2)))
        believed = STARS_KM + np.einsum("nij,nj->ni", factor, rng.normal(size=(4, 3)))
        fix = triangulate(measured, believed, SIGMA**2, star_covariance_km2=STAR_COVARIANCE, stars=which)
        white = np.linalg.inv(np.linalg.cholesky(fix.covariance_km2))
        errors[i], chi2[i] = white @ (fix.position_km - NEW_HORIZONS_KM), fix.chi2
    assert np.all(np.abs(errors.std(axis=0) - 1.0) < sample.within(0.1))
    assert np.all(np.abs(errors.mean(axis=0)) < sample.within(0.1))
    # 9 degrees of freedom: mean 9, known to sqrt(18 / 1500).
    assert chi2.mean() == pytest.approx(9.0, abs=sample.within(0.45))
    assert chi2.std() == pytest.approx(np.sqrt(18.0), rel=sample.within(0.1))


def test_agrees_with_a_minimiser_that_knows_nothing_of_it():
    """Least squares over the position and the stars' own errors, angles by arctangents; 0.01 sigma."""
    rng = np.random.default_rng(11)
    measured = tilted(unit(STARS_KM - NEW_HORIZONS_KM), rng.normal(0.0, SIGMA, (4, 2)))
    fix = triangulate(measured, STARS_KM, SIGMA**2, star_covariance_km2=STAR_COVARIANCE)

    def cost(parameters):
        position = NEW_HORIZONS_KM + parameters[:3] * AU_KM
        shift = parameters[3:].reshape(4, 3) * AU_KM
        line = STARS_KM + shift - position
        angle = np.arctan2(np.linalg.norm(np.cross(measured, line), axis=1), np.sum(measured * line, axis=1))
        prior = np.einsum("ni,nij,nj->", shift, np.linalg.inv(STAR_COVARIANCE), shift)
        return np.sum((angle / SIGMA) ** 2) + prior

    best = minimize(cost, np.zeros(15), method="BFGS", options={"gtol": 1e-6})
    brute = NEW_HORIZONS_KM + best.x[:3] * AU_KM
    assert fix.sigmas_from(brute) < 0.01
    assert fix.chi2 == pytest.approx(best.fun, rel=1e-4)


def test_closed_form_start_is_near_the_optimum():
    rng = np.random.default_rng(3)
    measured = tilted(unit(STARS_KM - NEW_HORIZONS_KM), rng.normal(0.0, SIGMA, (4, 2)))
    fix = triangulate(measured, STARS_KM, SIGMA**2)
    assert fix.sigmas_from(fix.start_km) < 0.01
    assert fix.iterations <= 3


def test_a_near_target_needs_the_weights_to_follow():
    """Inside the triangle of its targets, where the distances differ by ten and errors are degrees."""
    places = np.array([[10.0, 0.0, 0.0], [0.0, 100.0, 0.0], [-80.0, 10.0, 60.0]])
    errors = np.radians([[0.4, -0.3], [0.1, 0.2], [-0.3, 0.1]])
    measured = tilted(unit(places - [1.0, 2.0, 0.5]), errors)
    fix = triangulate(measured, places, np.radians(0.3) ** 2)

    def cost(position):
        return np.sum((angle_between(measured, places - position) / np.radians(0.3)) ** 2)

    best = minimize(
        cost, [1.0, 2.0, 0.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxfev": 4000}
    )
    assert fix.sigmas_from(best.x) < 0.01


# -- covariance and geometry ---------------------------------------------------------------------------------------


def test_dilution_of_two_stars_at_right_angles():
    """Each star fixes the two axes across it to its own distance a radian, the axis across both by both."""
    near, far = 4e13, 7e13
    fix = triangulate(np.eye(3)[:2], np.diag([near, far, 1.0])[:2], SIGMA**2)
    both = 1.0 / np.hypot(1.0 / near, 1.0 / far)
    np.testing.assert_allclose(fix.dilution_km_per_rad, [far, near, both], rtol=1e-9)
    np.testing.assert_allclose(fix.semi_axes_km, SIGMA * fix.dilution_km_per_rad, rtol=1e-9)
    np.testing.assert_allclose(fix.sigma_km, SIGMA * np.array([far, near, both]), rtol=1e-9)


def test_many_pictures_do_not_average_a_catalog_error_away():
    lines = unit(STARS_KM[:2] - NEW_HORIZONS_KM)
    which = np.repeat([0, 1], 50)
    options = {"star_covariance_km2": STAR_COVARIANCE[:2], "stars": which}
    many = triangulate(lines[which], STARS_KM[:2], SIGMA**2, **options)
    floor = triangulate(
        lines, STARS_KM[:2], (1e-6 * SIGMA) ** 2, star_covariance_km2=STAR_COVARIANCE[:2]
    )  # fmt: skip
    assert np.all(many.semi_axes_km > 0.99 * floor.semi_axes_km)
    ideal = triangulate(lines[which], STARS_KM[:2], SIGMA**2, stars=which)
    single = triangulate(lines, STARS_KM[:2], SIGMA**2)
    np.testing.assert_allclose(ideal.semi_axes_km * np.sqrt(50.0), single.semi_axes_km, rtol=1e-9)


def test_forms_of_input_agree():
    rng = np.random.default_rng(5)
    lines = tilted(unit(STARS_KM - NEW_HORIZONS_KM), rng.normal(0.0, SIGMA, (4, 2)))
    first = triangulate(lines, STARS_KM, SIGMA**2)
    angles = np.stack(radec_from_unit(lines), axis=-1)
    one = SIGMA**2 * np.eye(2)
    for directions, covariance in (
        (angles, one),
        (lines, np.broadcast_to(one, (4, 2, 2))),
        (lines, SIGMA**2 * np.eye(8)),
    ):
        fix = triangulate(directions, STARS_KM, covariance)
        assert first.sigmas_from(fix.position_km) < 1e-6
        np.testing.assert_allclose(fix.covariance_km2, first.covariance_km2, rtol=1e-9)


def test_the_answer_turns_with_the_frame():
    """East and north are other directions then: residuals and covariances must keep their meaning."""
    rng = np.random.default_rng(9)
    turn = rotation_from_vector([0.5, -1.1, 0.8])
    measured = tilted(unit(STARS_KM - NEW_HORIZONS_KM), rng.normal(0.0, SIGMA, (4, 2)))
    plain = triangulate(measured, STARS_KM, SIGMA**2, star_covariance_km2=STAR_COVARIANCE)
    turned = triangulate(
        measured @ turn.T, STARS_KM @ turn.T, SIGMA**2, star_covariance_km2=turn @ STAR_COVARIANCE @ turn.T
    )
    assert turned.sigmas_from(turn @ plain.position_km) < 1e-5
    np.testing.assert_allclose(turned.covariance_km2, turn @ plain.covariance_km2 @ turn.T, rtol=1e-6)
    assert turned.chi2 == pytest.approx(plain.chi2, rel=1e-5)


def test_residual_is_measured_minus_computed():
    """Many directions to star 0, one of them 1 arcsec east: all but a little of it is left over there."""
    which = np.array([0] * 40 + [1])
    errors = np.zeros((41, 2))
    errors[3, 0] = ARCSEC
    lines = tilted(unit(STARS_KM[which] - NEW_HORIZONS_KM), errors)
    fix = triangulate(lines, STARS_KM[:2], SIGMA**2, stars=which)
    np.testing.assert_allclose(fix.residual_rad[3] / ARCSEC, [39.0 / 40.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(fix.residual_rad[0] / ARCSEC, [-1.0 / 40.0, 0.0], atol=1e-4)


def test_a_moving_spacecraft():
    """Pictures a day apart: the fix holds for the epoch, not for a time between."""
    moved = np.array([[0.0, 0.0, 0.0], [0.9e6, -0.7e6, 0.2e6]])
    lines = unit(STARS_KM[:2] - NEW_HORIZONS_KM - moved)
    fix = triangulate(lines, STARS_KM[:2], (1e-3 * MAS) ** 2, displacement_km=moved)
    assert np.linalg.norm(fix.position_km - NEW_HORIZONS_KM) < 10.0
    still = triangulate(lines, STARS_KM[:2], (1e-3 * MAS) ** 2)
    assert np.linalg.norm(still.position_km - NEW_HORIZONS_KM) > 1e5


def test_results_cannot_be_changed():
    fix = triangulate(unit(STARS_KM - NEW_HORIZONS_KM), STARS_KM, SIGMA**2)
    with pytest.raises(ValueError, match="read-only"):
        fix.position_km[0] = 0.0


# -- what cannot be solved -----------------------------------------------------------------------------------------

TWO = unit(STARS_KM[:2] - NEW_HORIZONS_KM)
PARALLEL = np.array([[1.0, 0.0, 0.0], [1.0, 1e-7, 0.0]])


@pytest.mark.parametrize(
    ("directions", "places", "covariance", "options", "words"),
    [
        (TWO[:1], STARS_KM[:1], SIGMA**2, {}, "1 directions to 1 star: a line, not a point"),
        (TWO[[0, 0, 0]], STARS_KM[:2], SIGMA**2, {"stars": [0, 0, 0]}, "measure a second star"),
        (unit(PARALLEL), PARALLEL * 4e13, SIGMA**2, {}, "parallel within 0.0206 arcsec, that is 0.1 sigmas"),
        (np.array([[1.0, 0, 0], [-1.0, 0, 0]]), np.array([[4e13, 0, 0], [-4e13, 0, 0]]), SIGMA**2, {}, "opposite"),
        (TWO, STARS_KM, SIGMA**2, {}, "2 directions but 4 stars; say with `stars`"),
        (TWO, STARS_KM, SIGMA**2, {"stars": [0, 4]}, "2 numbers 0 to 3"),
        (-TWO, STARS_KM[:2], SIGMA**2, {}, "points away from its star"),
        (STARS_KM[:2], STARS_KM[:2], SIGMA**2, {}, "give unit vectors"),
        (np.array([[np.nan, 0, 0], [0, 1, 0]]), STARS_KM[:2], SIGMA**2, {}, "not finite"),
        (TWO, STARS_KM[:2], 0.0, {}, "not positive definite"),
        (TWO, STARS_KM[:2], np.eye(3), {}, "shape"),
        (TWO, STARS_KM[:2, :2], SIGMA**2, {}, "star_positions_km has shape"),
        (TWO, STARS_KM[:2], SIGMA**2, {"displacement_km": [0.0, 0.0, 0.0]}, "displacement_km has shape"),
    ],
)  # fmt: skip
def test_what_has_no_solution_says_so(directions, places, covariance, options, words):
    with pytest.raises(EstimationError) as caught:
        triangulate(directions, places, covariance, **options)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


# -- places of stars -----------------------------------------------------------------------------------------------


def test_places_give_the_directions_of_the_catalog(flight_stars):
    """The way from a place in space and the way by parallax are one: 1e-3 mas at 47 au."""
    places = star_positions(flight_stars, ET, NEW_HORIZONS_KM)
    seen = flight_stars.directions(ET, NEW_HORIZONS_KM)
    assert np.all(angle_between(places.position_km - NEW_HORIZONS_KM, seen) < 1e-3 * MAS)


def test_places_agree_with_astropy(flight_stars):
    """Rigorous space motion: 0.01 mas and 0.1 au of 270,000."""
    places = star_positions(flight_stars, ET)
    mas_yr = u.mas / u.yr
    coordinates = SkyCoord(
        flight_stars.ra_rad * u.rad,
        flight_stars.dec_rad * u.rad,
        distance=Distance(parallax=flight_stars.parallax_rad / MAS * u.mas),
        pm_ra_cosdec=flight_stars.pmra_rad_yr / MAS * mas_yr,
        pm_dec=flight_stars.pmdec_rad_yr / MAS * mas_yr,
        radial_velocity=flight_stars.rv_km_s * u.km / u.s,
        obstime=Time(2016.0, format="jyear", scale="tdb"),
    )
    moved = coordinates.apply_space_motion(
        Time(2000.0 + ET / (365.25 * 86400.0), format="jyear", scale="tdb")
    )
    theirs = moved.cartesian.xyz.to_value(u.km).T
    assert np.all(angle_between(places.position_km, theirs) < 0.02 * MAS)
    off = np.linalg.norm(places.position_km, axis=1) - np.linalg.norm(theirs, axis=1)
    assert np.all(np.abs(off) < 0.1 * AU_KM)


def test_covariance_of_places_against_scattered_catalogs(flight_stars):
    rng = np.random.default_rng(2)
    star = flight_stars.take([1])
    trials = 20_000
    error = rng.normal(size=(trials, 5)) * star.sigma
    many = star.take(np.zeros(trials, dtype=int))
    many = replace(
        many,
        ra_rad=many.ra_rad + error[:, 0] / np.cos(many.dec_rad),
        dec_rad=many.dec_rad + error[:, 1],
        parallax_rad=many.parallax_rad + error[:, 2],
        pmra_rad_yr=many.pmra_rad_yr + error[:, 3],
        pmdec_rad_yr=many.pmdec_rad_yr + error[:, 4],
    )
    stated = star_positions(star, ET)
    scatter = np.cov((star_positions(many, ET).position_km - stated.position_km).T)
    white = np.linalg.inv(np.linalg.cholesky(stated.covariance_km2[0]))
    np.testing.assert_allclose(white @ scatter @ white.T, np.eye(3), atol=0.05)


def test_a_star_without_a_parallax_has_no_place(flight_stars):
    unknown = replace(flight_stars, parallax_rad=np.array([0.0, 1e-6]))
    with pytest.raises(EstimationError, match="Proxima Cen has no parallax"):
        star_positions(unknown, ET)


# -- pairs ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def near_stars(flight_stars) -> StarTable:
    return nearest_stars(flight_stars)


@pytest.mark.slow
def test_nearest_stars_have_each_star_once(near_stars):
    assert len(near_stars) == 60
    names = near_stars.id.tolist()
    assert names.count("Proxima Cen") == names.count("Wolf 359") == 1
    assert names[:5] == ["alpha Cen B", "Proxima Cen", "alpha Cen A", "Barnard's Star", "Wolf 359"]
    # The mission's list comes first: Gaia's parallax, not that of Hipparcos.
    assert near_stars.parallax_rad[1] / MAS == pytest.approx(768.0665, abs=1e-3)
    assert np.all(np.diff(near_stars.parallax_rad) <= 0.0)


def test_best_pair_is_the_published_one(near_stars):
    """Lauer et al. (2025): Proxima Centauri and Barnard's Star are the best pair."""
    table = best_pairs(near_stars, ET, NEW_HORIZONS_KM, 0.1)
    assert [str(s) for s in table["star_1", "star_2"][0]] == ["Proxima Cen", "Barnard's Star"]
    assert np.all(np.diff(table["sigma"]) >= 0.0)


def test_sigma_of_a_pair_is_that_of_its_fix(near_stars):
    table = best_pairs(near_stars, ET, NEW_HORIZONS_KM, 0.1, count=10_000)
    names = near_stars.id.tolist()
    for row in (table[0], table[17], table[400]):
        pair = near_stars.take([names.index(row["star_1"]), names.index(row["star_2"])])
        known = star_positions(pair, ET, NEW_HORIZONS_KM)
        lines = unit(known.position_km - NEW_HORIZONS_KM)
        fix = triangulate(
            lines, known.position_km, (0.1 * ARCSEC) ** 2, star_covariance_km2=known.covariance_km2
        )
        axes = [row[name].to_value(u.km) for name in ("major", "middle", "minor")]
        np.testing.assert_allclose(axes, fix.semi_axes_km, rtol=1e-6)
        assert row["sigma_km"].to_value(u.km) == pytest.approx(np.linalg.norm(fix.sigma_km), rel=1e-6)
        assert row["separation"].to_value(u.rad) == pytest.approx(float(angle_between(*lines)), abs=1e-9)


def test_pairs_are_those_that_can_be_seen(near_stars):
    table = best_pairs(
        near_stars, ET, NEW_HORIZONS_KM, 0.1, mag_limit=9.0, min_elongation_deg=60.0, count=10_000
    )
    for k in ("1", "2"):
        assert table[f"mag_{k}"].max() <= 9.0 * u.mag
        assert table[f"elongation_{k}"].min() >= 60.0 * u.deg
        assert not set(table[f"star_{k}"].tolist()) & {"Wolf 359", "Lalande 21185", "alpha Cen A", "Sirius"}
    among = set(table["star_1"].tolist()) | set(table["star_2"].tolist())
    assert len(table) == len(among) * (len(among) - 1) // 2


@pytest.mark.parametrize(
    ("options", "error_arcsec", "words"),
    [({"mag_limit": 0.0}, 0.1, "two are needed"), ({}, 0.0, "larger than zero")],
)
def test_no_pair_says_why(near_stars, options, error_arcsec, words):
    with pytest.raises(EstimationError, match=words):
        best_pairs(near_stars, ET, NEW_HORIZONS_KM, error_arcsec, **options)
