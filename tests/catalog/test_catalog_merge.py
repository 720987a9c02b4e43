"""The rule that makes one catalog of Hipparcos and Gaia, on stars whose truth is known."""

import math

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.time import Time

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR, StarQuality, bundled
from opnav_workbench.catalog.bundled import GaiaStars
from opnav_workbench.catalog.hipparcos import HipparcosStars
from opnav_workbench.catalog.johnson import Johnson

MAS = math.radians(1.0 / 3.6e6)
YEARS = 24.75
HIP_SIGMA = (0.9, 0.7, 1.1, 1.2, 1.0)


def moved(ra_rad, dec_rad, pmra_mas_yr, pmdec_mas_yr, years):
    """Move stars along straight lines in space by astropy; return RA, dec."""
    n = len(ra_rad)
    start = SkyCoord(
        ra=ra_rad * u.rad,
        dec=dec_rad * u.rad,
        distance=np.full(n, 50.0) * u.pc,
        pm_ra_cosdec=pmra_mas_yr * u.mas / u.yr,
        pm_dec=pmdec_mas_yr * u.mas / u.yr,
        radial_velocity=np.zeros(n) * u.km / u.s,
        obstime=Time(1991.25, format="jyear", scale="tdb"),
    )
    end = start.apply_space_motion(new_obstime=Time(1991.25 + years, format="jyear", scale="tdb"))
    return end.ra.rad, end.dec.rad


def hipparcos(ra, dec, pmra, pmdec, hp=8.0, sigma_mas=HIP_SIGMA, first=1) -> HipparcosStars:
    n = len(ra)
    return HipparcosStars(
        hip=np.arange(first, first + n),
        ra_rad=np.asarray(ra, float),
        dec_rad=np.asarray(dec, float),
        motion_rad_yr=np.stack([pmra, pmdec], axis=-1) * MAS,
        parallax_rad=np.full(n, 20.0 * MAS),
        sigma=np.tile(np.asarray(sigma_mas) * MAS, (n, 1)),
        hp_mag=np.broadcast_to(np.asarray(hp, float), n).copy(),
        johnson=Johnson(*np.tile([[8.0], [0.02], [0.6], [0.01]], n)),
        flags=np.full(n, int(StarQuality.DOUBLE)),
    )


def gaia(ra, dec, g=8.0) -> GaiaStars:
    n = len(ra)
    g_mag = np.broadcast_to(np.asarray(g, float), n).copy()
    number, johnson = np.arange(10**18, 10**18 + n), Johnson(*np.tile([[8.1], [0.03], [0.7], [0.04]], n))
    return GaiaStars(number, np.asarray(ra, float), np.asarray(dec, float), g_mag, johnson)


def beside(ra, dec, east_mas, north_mas):
    return ra + east_mas * MAS / np.cos(dec), dec + north_mas * MAS


def sky(n, seed=3):
    rng = np.random.default_rng(seed)
    ra, dec = rng.uniform(0.0, 2.0 * math.pi, n), np.arcsin(rng.uniform(-1.0, 1.0, n))
    ra[0], dec[0], ra[1], dec[1], ra[2] = 1.0, 1.5705, 4.0, -1.5702, 1e-8  # near the poles, and at RA 0
    return rng, ra, dec


def in_order(stars: bundled.MergedStars, n: int) -> bundled.MergedStars:
    """Rows sorted by HIP number, which must be 1..n."""
    order = np.argsort(-stars.number)
    assert (-stars.number[order]).tolist() == list(range(1, n + 1))
    return bundled.MergedStars(*(getattr(stars, name)[order] for name in bundled.MergedStars.__slots__))


def test_two_positions_give_the_motion_anywhere_on_the_sky() -> None:
    rng, ra, dec = sky(400)
    pmra, pmdec = rng.normal(0.0, 800.0, (2, 400))
    ra16, dec16 = moved(ra, dec, pmra, pmdec, YEARS)
    # Hipparcos' own motions err by their sigmas, the positions are exact.
    own = rng.normal(0.0, 1.0, (2, 400)) * [[1.2], [1.0]]
    stars = bundled.merge_hipparcos_gaia(hipparcos(ra, dec, pmra + own[0], pmdec + own[1]), gaia(ra16, dec16))
    stars = in_order(stars, 400)
    assert stars.from_gaia.all()
    np.testing.assert_array_equal(np.stack([stars.ra_rad, stars.dec_rad]), np.stack([ra16, dec16]))
    # Moved back by the merged motion the star stands where Hipparcos saw it.
    from opnav_workbench.geometry import angle_between, et_from_jyear, propagate, unit_from_radec

    back = propagate(
        ra16, dec16, *stars.motion_rad_yr.T.astype(float), 0.0, 0.0, 2016.0, et_from_jyear(1991.25)
    )
    assert (
        np.max(angle_between(back, unit_from_radec(ra, dec))) < 0.01 * MAS
    )  # float32 motions: 1e-7 of 60 arcsec


def test_sigma_of_an_undisturbed_motion_is_that_of_two_positions() -> None:
    _, ra, dec = sky(50)
    still = np.zeros(50)
    g = np.linspace(3.0, 9.0, 50)
    stars = in_order(
        bundled.merge_hipparcos_gaia(hipparcos(ra, dec, still, still, hp=g), gaia(ra, dec, g)), 50
    )
    floor = 0.06 * np.where(g < 6.0, 10.0 ** (-0.3 * (g - 6.0)), 1.0)
    for axis, sigma in ((3, 0.9), (4, 0.7)):
        expected = np.sqrt((sigma**2 + 0.1**2) / YEARS**2 + floor**2)
        np.testing.assert_allclose(stars.sigma[:, axis] / MAS, expected, rtol=1e-6)
    np.testing.assert_allclose(stars.sigma[:, 0] / MAS, 0.1, rtol=1e-6)
    np.testing.assert_allclose(stars.sigma[:, 2] / MAS, 1.1, rtol=1e-6)
    np.testing.assert_allclose(stars.parallax_rad / MAS, 20.0, rtol=1e-6)


def test_motions_scatter_no_more_than_their_sigmas() -> None:
    n = 4000
    rng, ra, dec = sky(n)
    ra, dec = ra[10:], np.clip(dec[10:], -1.4, 1.4)
    pmra, pmdec = rng.normal(0.0, 50.0, (2, len(ra)))
    ra16, dec16 = moved(ra, dec, pmra, pmdec, YEARS)
    ra_seen, dec_seen = beside(ra, dec, *(rng.normal(0.0, 1.0, (2, len(ra))) * [[0.9], [0.7]]))
    ra16, dec16 = beside(ra16, dec16, *rng.normal(0.0, 0.1, (2, len(ra))))
    own = rng.normal(0.0, 1.0, (2, len(ra))) * [[1.2], [1.0]]
    drift = rng.normal(0.0, 0.06, (2, len(ra)))  # what the floor stands for: an orbit seen over 25 years
    seen = hipparcos(ra_seen, dec_seen, pmra + own[0], pmdec + own[1])
    stars = in_order(bundled.merge_hipparcos_gaia(seen, gaia(ra16, dec16)), len(ra))
    error = stars.motion_rad_yr.astype(float) / MAS - np.stack([pmra, pmdec], axis=-1) + drift.T
    chi = np.abs(error) / (stars.sigma[:, 3:] / MAS)
    quiet = stars.sigma[:, 3] / MAS < 0.08  # no chance excess of Hipparcos' own motion
    assert quiet.mean() > 0.5
    assert 0.9 < np.sqrt(np.mean(chi[quiet] ** 2)) < 1.1
    assert np.percentile(chi, 68.27) < 1.05


def test_a_motion_that_two_positions_contradict_carries_the_difference() -> None:
    # A binary: Hipparcos caught 30 mas/yr of orbit that the mean over 25 years does not have.
    ra, dec = np.array([1.0]), np.array([0.3])
    stars = bundled.merge_hipparcos_gaia(hipparcos(ra, dec, [30.0], [0.0]), gaia(ra, dec))
    assert len(stars) == 1
    np.testing.assert_allclose(stars.motion_rad_yr[0] / MAS, [0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(stars.sigma[0, 3:] / MAS, 30.0 / math.sqrt(2.0), rtol=0.01)


def test_hipparcos_own_motion_is_kept_where_it_is_better() -> None:
    ra, dec = np.array([1.0]), np.array([0.3])
    poor_position = hipparcos(ra, dec, [5.0], [-5.0], sigma_mas=(300.0, 300.0, 1.0, 0.5, 0.5))
    stars = bundled.merge_hipparcos_gaia(
        poor_position, gaia(*beside(ra, dec, 5.0 * YEARS + 200.0, -5.0 * YEARS))
    )
    np.testing.assert_allclose(stars.motion_rad_yr[0] / MAS, [5.0, -5.0], rtol=1e-6)
    np.testing.assert_allclose(stars.sigma[0, 3:] / MAS, 0.5, rtol=1e-6)


@pytest.mark.parametrize(
    ("apart_mas", "hp", "g", "same"),
    [
        (100.0, 8.0, 8.2, True),
        (2400.0, 8.0, 7.8, True),  # a binary with an orbit of arcseconds
        (2800.0, 8.0, 7.8, False),
        (1000.0, 8.0, 9.5, False),  # the companion of a star that Gaia lacks
        (1000.0, 11.0, 8.0, False),  # the primary of a faint Hipparcos star
        (50.0, 12.0, 8.0, True),  # a Mira variable: same place, any magnitude
    ],
)
def test_what_counts_as_the_same_star(apart_mas: float, hp: float, g: float, same: bool) -> None:
    ra, dec = np.array([6.283185]), np.array([-1.2])
    stars = bundled.merge_hipparcos_gaia(
        hipparcos(ra, dec, [0.0], [0.0], hp=hp), gaia(*beside(ra, dec, apart_mas, 0.0), g)
    )
    assert len(stars) == (1 if same else 2)
    assert stars.from_gaia.sum() == 1
    if same:
        assert stars.number[0] == -1
        assert stars.mag[0] == np.float32(g)


def test_poor_hipparcos_stars_are_sought_farther_out() -> None:
    ra, dec = np.array([1.0]), np.array([0.3])
    where = gaia(*beside(ra, dec, 4000.0, 0.0))
    poor = hipparcos(ra, dec, [0.0], [0.0], sigma_mas=(20.0, 20.0, 20.0, 20.0, 20.0))
    assert len(bundled.merge_hipparcos_gaia(poor, where)) == 1
    assert len(bundled.merge_hipparcos_gaia(hipparcos(ra, dec, [0.0], [0.0]), where)) == 2


def test_part_of_the_light_leaves_the_hipparcos_star_alone() -> None:
    ra, dec = np.array([1.0]), np.array([0.3])
    stars = bundled.merge_hipparcos_gaia(
        hipparcos(ra, dec, [3.0], [4.0], hp=3.7), gaia(*beside(ra, dec, 80.0, 90.0), 6.8)
    )
    assert len(stars) == 1
    assert not stars.from_gaia[0]
    assert stars.mag[0] == np.float32(3.7)
    np.testing.assert_array_equal([stars.ra_rad[0], stars.dec_rad[0]], [1.0, 0.3])
    np.testing.assert_allclose(stars.sigma[0] / MAS, HIP_SIGMA, rtol=1e-6)


def test_a_gaia_star_belongs_to_the_nearer_of_two_hipparcos_stars() -> None:
    ra, dec = beside(np.array([1.0, 1.0]), np.array([0.3, 0.3]), np.array([1500.0, 20.0]), 0.0)
    stars = bundled.merge_hipparcos_gaia(hipparcos(ra, dec, [0.0, 0.0], [0.0, 0.0]), gaia([1.0], [0.3]))
    assert sorted(stars.number.tolist()) == [-2, -1]
    assert stars.from_gaia[stars.number == -2].all()
    assert not stars.from_gaia[stars.number == -1].any()


def test_of_a_close_pair_the_component_of_the_right_magnitude_is_taken() -> None:
    ra, dec = beside(np.array([1.0, 1.0]), np.array([0.3, 0.3]), np.array([700.0, 1500.0]), 0.0)
    stars = bundled.merge_hipparcos_gaia(
        hipparcos([1.0], [0.3], [0.0], [0.0], hp=6.0), gaia(ra, dec, [9.0, 6.1])
    )
    assert len(stars) == 2
    assert stars.mag[stars.number < 0] == np.float32(6.1)


def test_gaia_alone_has_the_sigmas_of_the_unknown() -> None:
    stars = bundled.merge_hipparcos_gaia(hipparcos([1.0], [0.3], [0.0], [0.0]), gaia([2.0], [0.3], 9.5))
    alone = stars.number > 0
    assert stars.motion_known.tolist() == (~alone).tolist()
    np.testing.assert_array_equal(stars.motion_rad_yr[alone], 0.0)
    np.testing.assert_allclose(stars.sigma[alone, 3:] / MAS, UNKNOWN_MOTION_MAS_YR, rtol=1e-6)
    np.testing.assert_allclose(stars.sigma[alone, 2] / MAS, 6.8 * 10 ** (-0.15 * 2.5), rtol=1e-6)


def test_colors_and_flags_of_hipparcos_stay_with_the_matched_star() -> None:
    matched = bundled.merge_hipparcos_gaia(
        hipparcos([1.0], [0.2], [5.0], [0.0]), gaia([1.0, 2.0], [0.2, 0.2])
    )
    of_hipparcos, alone = matched.number < 0, matched.number > 0
    np.testing.assert_allclose(matched.johnson[of_hipparcos], [[8.0, 0.02, 0.6, 0.01]], rtol=1e-6)
    np.testing.assert_allclose(matched.johnson[alone], [[8.1, 0.03, 0.7, 0.04]], rtol=1e-6)
    assert matched.flags[of_hipparcos] == StarQuality.DOUBLE
    assert matched.flags[alone] == 0
