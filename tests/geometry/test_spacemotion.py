"""Space motion against astropy, ERFA and a star flown through space; parallax, Roemer delay, covariances."""

import warnings
from typing import NamedTuple

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import Distance, SkyCoord
from astropy.io import fits
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from opnav_workbench import geometry as geo
from opnav_workbench.constants import AU_KM, JULIAN_YEAR_S

MAS = np.pi / 180 / 3600e3
ARCSEC = 1e3 * MAS
C_KM_S = 299792.458
FAR_OUT_KM = 47.1 * AU_KM * np.array([0.21, -0.86, -0.46])  # like New Horizons in 2020


class Star(NamedTuple):
    """Arguments of `propagate` up to the epoch."""

    ra: float
    dec: float
    pmra: float
    pmdec: float
    parallax: float
    rv: float


def _star(ra_deg, dec_deg, pmra_mas, pmdec_mas, parallax_mas, rv):
    return Star(
        np.radians(ra_deg), np.radians(dec_deg), pmra_mas * MAS, pmdec_mas * MAS, parallax_mas * MAS, rv
    )


# Gaia DR3, epoch J2016.0
PROXIMA = _star(
    217.39232147200883,
    -62.67607511676666,
    -3781.741008265163,
    769.4650146478623,
    768.0665391873573,
    -20.578199,
)
WOLF_359 = _star(
    164.10319030755974, 7.002726940984864, -3866.3382751436793, -2699.214987679166, 415.17941567802137, 19.57
)
RUNAWAY = _star(40.0, 71.0, 6000.0, -8000.0, 250.0, 400.0)  # hypothetical: perspective acceleration shows
STARS = pytest.mark.parametrize("star", [PROXIMA, WOLF_359, RUNAWAY], ids=["proxima", "wolf359", "runaway"])


def test_julian_years_and_et():
    assert geo.et_from_jyear(2000.0) == 0.0
    assert geo.jyear_from_et(0.0) == 2000.0
    for jyear in (1991.25, 2016.0, 2020.3):
        astropy_s = (Time(jyear, format="jyear", scale="tdb") - Time("J2000.0", scale="tdb")).to_value("s")
        assert geo.et_from_jyear(jyear) == pytest.approx(astropy_s, rel=0, abs=1e-4)
        assert geo.jyear_from_et(geo.et_from_jyear(jyear)) == pytest.approx(jyear, rel=0, abs=3e-13)


@STARS
@pytest.mark.parametrize("jyear", [2015.5, 2020.3])
def test_space_motion_agrees_with_astropy(star, jyear):
    start = SkyCoord(
        star.ra * u.rad,
        star.dec * u.rad,
        pm_ra_cosdec=star.pmra * u.rad / u.yr,
        pm_dec=star.pmdec * u.rad / u.yr,
        distance=Distance(parallax=star.parallax * u.rad),
        radial_velocity=star.rv * u.km / u.s,
        obstime=Time(2016.0, format="jyear", scale="tdb"),
    )
    moved = start.apply_space_motion(new_obstime=Time(jyear, format="jyear", scale="tdb"))
    ours = geo.propagate(*star, 2016.0, geo.et_from_jyear(jyear))
    theirs = geo.unit_from_radec(moved.ra.rad, moved.dec.rad)
    assert geo.angle_between(ours, theirs) < 0.1 * MAS
    assert geo.angle_between(ours, geo.unit_from_radec(star.ra, star.dec)) > 1e3 * MAS  # it did move


@STARS
@pytest.mark.parametrize("function", [erfa.pmsafe, erfa.starpm])
def test_space_motion_agrees_with_erfa_over_decades(star, function):
    """Fifty years, 0.1 mas; RUNAWAY's relativistic terms, 400 km/s over c of its perspective, get 2 mas."""
    years = 50.0
    start = (star.ra, star.dec, star.pmra / np.cos(star.dec), star.pmdec, star.parallax / ARCSEC, star.rv)
    ra, dec, *_ = function(*start, 2451545.0, 0.0, 2451545.0, years * 365.25)
    ours = geo.propagate(*star, 2000.0, geo.et_from_jyear(2000.0 + years))
    assert geo.angle_between(ours, geo.unit_from_radec(ra, dec)) < (2.0 if star is RUNAWAY else 0.1) * MAS


def test_radial_velocity_matters_and_has_the_right_sign():
    """An approaching star gains proper motion: 1 + 2 |mu_r| t of it, half of that in the mean."""
    without = RUNAWAY._replace(rv=0.0)
    et = geo.et_from_jyear(2016.0)
    start = geo.unit_from_radec(RUNAWAY.ra, RUNAWAY.dec)
    moved, moved_without = (
        geo.angle_between(geo.propagate(*star, 2000.0, et), start) for star in (RUNAWAY, without)
    )
    mu_r = 400.0 * 250.0 * MAS / 4.740470446  # the Hipparcos volumes' constant
    assert (moved - moved_without) / moved_without == pytest.approx(-mu_r * 16.0, rel=3e-3)
    assert abs(moved - moved_without) > 50 * MAS


class _FlownStar:
    """A star on a straight path, seen by light that takes its time: no catalogue model inside."""

    def __init__(self, distance_km, velocity_km_s):
        self.start_km = distance_km * geo.unit([-0.5, 0.3, -0.8])
        self.velocity_km_s = np.asarray(velocity_km_s, float)
        self.first_light_s = distance_km / C_KM_S  # light from the start arrives at the barycenter at et 0

    def seen_from(self, observer_km, et):
        light_s = self.first_light_s
        for _ in range(12):
            sight = self.start_km + self.velocity_km_s * (et + self.first_light_s - light_s) - observer_km
            light_s = np.linalg.norm(sight) / C_KM_S
        return sight

    def catalogue(self):
        """Position, motion and distance as measured from the barycenter at J2000.0."""
        half = JULIAN_YEAR_S / 2
        before, now, after = (self.seen_from(np.zeros(3), et) for et in (-half, 0.0, half))
        ra, dec = geo.radec_from_unit(now)
        east, north = geo.tangent_basis(ra, dec)
        turn = geo.unit(after) - geo.unit(before)
        rv = (np.linalg.norm(after) - np.linalg.norm(before)) / JULIAN_YEAR_S
        return Star(float(ra), float(dec), turn @ east, turn @ north, AU_KM / np.linalg.norm(now), float(rv))


@pytest.mark.parametrize("observer_km", [np.zeros(3), FAR_OUT_KM, -2 * FAR_OUT_KM])
def test_directions_agree_with_a_star_flown_through_space(observer_km):
    """Parallax (36 arcsec), Roemer delay (10, 20 mas) and perspective (20 mas) together.

    What remains is the quadratic change of the light time, v_across^3 t^2 / (2 distance^2 c): 0.08 mas after
    20 years for this star, which is faster on the sky than any known one.
    """
    flown = _FlownStar(4.0e13, [60.0, 70.0, -30.0])
    star = flown.catalogue()
    et = geo.et_from_jyear(2020.3)
    ours = geo.propagate(*star, 2000.0, et, observer_km)
    assert geo.angle_between(ours, flown.seen_from(observer_km, et)) < 0.1 * MAS
    at_epoch = geo.propagate(*star, 2000.0, 0.0, observer_km)
    assert geo.angle_between(at_epoch, flown.seen_from(observer_km, 0.0)) < 0.01 * MAS


def test_roemer_delay_in_size_and_sign():
    """Nearer to a star by one light day its picture is a day ahead of the barycenter's."""
    star = _star(0.0, 0.0, 10_000.0, 0.0, 0.0, 0.0)
    one_day = 86400.0 * C_KM_S
    ahead, behind = (geo.propagate(*star, 2000.0, 0.0, [side * one_day, 0.0, 0.0]) for side in (1, -1))
    per_day = 10_000.0 * MAS / 365.25
    np.testing.assert_allclose([ahead[1], behind[1]], [per_day, -per_day], rtol=1e-6)


def test_parallax_at_the_observer():
    """Proxima from 47 au, against its position in astronomical units, subtracted by hand."""
    still = PROXIMA._replace(pmra=0.0, pmdec=0.0, rv=0.0)
    star_au = geo.unit_from_radec(still.ra, still.dec) / still.parallax
    seen = geo.propagate(*still, 2016.0, 0.0, FAR_OUT_KM)
    assert geo.angle_between(seen, star_au - FAR_OUT_KM / 149597870.7) < 1e-15
    assert geo.angle_between(seen, star_au) > 10 * ARCSEC


def test_unknown_parallax_and_radial_velocity_count_as_zero():
    ra, dec = np.array([1.0, 1.0, 1.0]), np.array([0.5, 0.5, 0.5])
    seen = geo.propagate(
        ra, dec, MAS, -MAS, [np.nan, 0.0, np.nan], [np.nan, 30.0, 30.0], 2000.0, 3e8, FAR_OUT_KM
    )
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])


def test_an_infinite_parallax_stays_visible_as_nan():
    with np.errstate(invalid="ignore"):
        assert np.isnan(geo.propagate(0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 2000.0, 0.0, FAR_OUT_KM)).any()


def test_shapes():
    columns = np.array([PROXIMA, WOLF_359, RUNAWAY]).T
    assert geo.propagate(*columns, 2016.0, 1e8, FAR_OUT_KM).shape == (3, 3)
    assert geo.propagate(
        *columns, np.full(3, 2016.0), [1e8, 2e8, 3e8], np.tile(FAR_OUT_KM, (3, 1))
    ).shape == (3, 3)
    assert geo.propagate(*columns[:, :0], 2016.0, 1e8).shape == (0, 3)
    assert geo.propagate(*PROXIMA, 2016.0, 1e8).shape == (3,)
    args = (2016.0, 1e8, columns[0], columns[1], FAR_OUT_KM)
    assert geo.propagate_covariance(np.zeros((3, 5, 5)), *args).shape == (3, 2, 2)
    empty = geo.propagate_covariance(np.zeros((0, 5, 5)), 2016.0, 1e8, np.zeros(0), np.zeros(0))
    assert empty.shape == (0, 2, 2)


def _random_covariance(seed):
    """5 x 5, fully correlated; sigmas like a poor catalogue's: 30 mas, 30 mas, 5 mas, 8 and 8 mas/yr."""
    factors = np.random.default_rng(seed).normal(size=(5, 9))
    scaled = factors * (np.array([30.0, 30.0, 5.0, 8.0, 8.0]) * MAS)[:, None] / 3.0
    return scaled @ scaled.T


def _disturbed(star, shift):
    """The star with catalogue errors; its motion in space keeps its direction when the position errs."""
    east, north = geo.tangent_basis(star.ra, star.dec)
    moved = geo.unit(geo.unit_from_radec(star.ra, star.dec) + shift[0] * east + shift[1] * north)
    motion = (star.pmra + shift[3]) * east + (star.pmdec + shift[4]) * north
    ra, dec = geo.radec_from_unit(moved)
    new_east, new_north = geo.tangent_basis(ra, dec)
    return Star(
        float(ra), float(dec), motion @ new_east, motion @ new_north, star.parallax + shift[2], star.rv
    )


def _difference_jacobian(star, epoch, et, observer_km):
    middle = geo.propagate(*star, epoch, et, observer_km)
    across = np.array(geo.tangent_basis(*geo.radec_from_unit(middle)))
    columns = []
    for i, step in enumerate([1e-6, 1e-6, 3e-8, 1e-6, 1e-6]):  # a parallax is small, and multiplied by 47
        shift = step * np.eye(5)[i]
        high, low = (
            geo.propagate(*_disturbed(star, side * shift), epoch, et, observer_km) for side in (1, -1)
        )
        columns.append(across @ (high - low) / (2 * step))
    return np.transpose(columns)


@STARS
@pytest.mark.parametrize("observer_km", [None, FAR_OUT_KM])
@pytest.mark.parametrize("jyear", [2020.3, 2240.0])
def test_covariance_agrees_with_differences(star, observer_km, jyear):
    """Each parameter alone, so that none hides behind a greater one, and then all of them, correlated."""
    et = geo.et_from_jyear(jyear)
    jacobian = _difference_jacobian(star, 2016.0, et, observer_km)
    alone = [np.diag(row) * MAS**2 for row in np.eye(5)]
    for covariance in [*alone, _random_covariance(11)]:
        ours = geo.propagate_covariance(
            covariance, 2016.0, et, star.ra, star.dec, observer_km,
            pmra_rad_yr=star.pmra, pmdec_rad_yr=star.pmdec, parallax_rad=star.parallax, rv_km_s=star.rv,
        )  # fmt: skip
        expected = jacobian @ covariance @ jacobian.T
        np.testing.assert_allclose(ours, expected, rtol=0, atol=2e-6 * np.trace(expected))
        assert ours[0, 1] == ours[1, 0]


@STARS
def test_covariance_without_motion_is_good_to_half_a_percent(star):
    et, covariance = geo.et_from_jyear(2020.3), _random_covariance(12)
    known = geo.propagate_covariance(
        covariance, 2016.0, et, star.ra, star.dec, FAR_OUT_KM,
        pmra_rad_yr=star.pmra, pmdec_rad_yr=star.pmdec, parallax_rad=star.parallax, rv_km_s=star.rv,
    )  # fmt: skip
    plain = geo.propagate_covariance(covariance, 2016.0, et, star.ra, star.dec, FAR_OUT_KM)
    np.testing.assert_allclose(plain, known, rtol=0, atol=5e-3 * np.trace(known))


def test_covariance_agrees_with_monte_carlo():
    """20,000 draws: a variance is good to 1 percent (1 sigma), so 4 percent is a fair limit."""
    n, et = 20_000, geo.et_from_jyear(2020.3)
    covariance = _random_covariance(13)
    draws = np.random.default_rng(14).multivariate_normal(np.zeros(5), covariance, n, method="cholesky").T
    star = PROXIMA
    seen = geo.propagate(
        star.ra + draws[0] / np.cos(star.dec), star.dec + draws[1],
        star.pmra + draws[3], star.pmdec + draws[4], star.parallax + draws[2], star.rv,
        2016.0, et, FAR_OUT_KM,
    )  # fmt: skip
    middle = geo.propagate(*star, 2016.0, et, FAR_OUT_KM)
    scatter = np.cov(seen @ np.transpose(geo.tangent_basis(*geo.radec_from_unit(middle))), rowvar=False)
    ours = geo.propagate_covariance(covariance, 2016.0, et, star.ra, star.dec, FAR_OUT_KM)
    np.testing.assert_allclose(scatter, ours, rtol=0, atol=0.04 * np.sqrt(np.prod(np.diag(ours))))


def test_parallax_error_grows_with_the_distance_of_the_observer():
    """1 mas of parallax is 40 mas of direction from 40 au abeam, toward the side away from the observer."""
    covariance = np.diag([0.0, 0.0, MAS, 0.0, 0.0]) ** 2
    ours = geo.propagate_covariance(covariance, 2016.0, 0.0, 0.0, 0.0, [0.0, 40 * AU_KM, 0.0])
    np.testing.assert_allclose(ours, [[(40 * MAS) ** 2, 0.0], [0.0, 0.0]], rtol=1e-9, atol=1e-30)


@given(st.floats(0, 2 * np.pi), st.floats(-np.pi / 2, np.pi / 2), st.floats(1980.0, 2060.0))
def test_covariance_stays_finite_and_positive_anywhere(ra, dec, jyear):
    et = geo.et_from_jyear(jyear)
    ours = geo.propagate_covariance(_random_covariance(15), 2016.0, et, ra, dec, FAR_OUT_KM)
    assert np.linalg.eigvalsh(ours / MAS**2).min() > 0.0


# Measured by Lauer et al. (2025) on these LORRI frames: J2000 RA, Dec in deg, stellar aberration removed.
MEASURED = {
    "proxima": (
        PROXIMA,
        {
            "0449855930": (217.363443584, -62.676359090),
            "0449855931": (217.362917492, -62.676324665),
            "0449855932": (217.362885635, -62.676382283),
        },
    ),
    "wolf359": (
        WOLF_359,
        {
            "0449933827": (164.094316069, 7.001013311),
            "0449933832": (164.094306594, 7.001021465),
            "0449933837": (164.094305581, 7.001002589),
        },
    ),
}


@pytest.mark.realdata
@pytest.mark.parametrize("name", MEASURED)
def test_parallax_that_new_horizons_saw(name, data_dir):
    """Published directions of Proxima and Wolf 359 from 47 au: within 0.5 arcsec (0.1 LORRI px) of ours."""
    star, frames = MEASURED[name]
    offsets = []
    for met, (ra_deg, dec_deg) in frames.items():
        path = next((data_dir / "images" / "lorri_interstellar").glob(f"*{met}*"))
        with warnings.catch_warnings(action="ignore"):
            header = fits.getheader(path)
        heliocentric_km = -np.array([header[f"SPCSSC{axis}"] for axis in "XYZ"])
        seen = geo.propagate(*star, 2016.0, header["SPCSCET"], heliocentric_km)
        east, north = geo.tangent_basis(*geo.radec_from_unit(seen))
        measured = geo.unit_from_radec(np.radians(ra_deg), np.radians(dec_deg))
        offsets.append([measured @ east, measured @ north])
        assert geo.angle_between(seen, geo.propagate(*star, 2016.0, header["SPCSCET"])) > 15 * ARCSEC
    assert np.linalg.norm(np.mean(offsets, axis=0)) < 0.5 * ARCSEC
