"""Cone search against looking at every star: at the poles, across RA 0 and at another epoch."""

import math
from itertools import pairwise

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import Distance, SkyCoord, angular_separation
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.catalog.star_store import IndexedCatalog, MotionBound, SkyIndex
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.errors import CatalogError

HALF_PI = 0.5 * math.pi
MAS = math.radians(1.0 / 3.6e6)
EDGE_RAD = 1e-12  # 0.2 microarcsec: two exact formulas differ by rounding only


def catalog_of(ra, dec, mag, pmra=None, pmdec=None, epoch=2000.0) -> IndexedCatalog:
    n = len(ra)
    pmra, pmdec = (np.zeros(n) if v is None else np.asarray(v) for v in (pmra, pmdec))

    def build(rows):
        k = len(rows)
        return StarTable(
            id=np.array([f"row:{row}" for row in rows], dtype=np.str_),
            ra_rad=ra[rows],
            dec_rad=dec[rows],
            pmra_rad_yr=pmra[rows],
            pmdec_rad_yr=pmdec[rows],
            parallax_rad=np.zeros(k),
            rv_km_s=np.full(k, np.nan),
            mag=mag[rows],
            band=np.full(k, "V"),
            epoch_jyear=np.full(k, epoch),
            sigma=np.zeros((k, 5)),
            motion_known=np.ones(k, bool),
        )

    motion = MotionBound(float(np.hypot(pmra, pmdec).max()), epoch, epoch)
    return IndexedCatalog("test", {}, ra, dec, mag, build, motion)


def random_sky(rng, n):
    ra, dec = rng.uniform(0.0, 2.0 * math.pi, n), np.arcsin(rng.uniform(-1.0, 1.0, n))
    return ra, dec, np.round(rng.uniform(2.0, 12.0, n), 1)  # rounded, so that ties occur


def rows_of(stars: StarTable) -> list[int]:
    return [int(name.removeprefix("row:")) for name in stars.id]


@pytest.mark.parametrize(
    ("ra", "dec", "radius_deg"),
    [
        (0.001, 0.3, 1.0),
        (6.28, -0.3, 3.0),
        (-0.002, 0.1, 2.0),
        (12.6, 0.1, 2.0),
        (1.0, HALF_PI, 2.0),
        (4.0, -HALF_PI, 1.5),
        (2.0, 1.55, 1.19),
        (2.0, 1.55, 1.20),
        (3.0, -1.5, 5.0),
        (3.0, 0.2, 89.0),
        (3.0, 0.2, 91.0),
        (3.0, 0.2, 180.0),
    ],
)
def test_cone_equals_brute_force(ra: float, dec: float, radius_deg: float) -> None:
    star_ra, star_dec, mag = random_sky(np.random.default_rng(5), 20_000)
    # Many more where the coordinates are singular.
    star_dec[:3000] = HALF_PI - np.abs(np.random.default_rng(6).normal(0.0, 0.02, 3000))
    star_dec[3000:5000] = -star_dec[1000:3000]
    star_ra[5000:8000] = np.random.default_rng(7).normal(0.0, 0.02, 3000) % (2.0 * math.pi)
    radius, limit = math.radians(radius_deg), 9.5
    stars = catalog_of(star_ra, star_dec, mag).cone(ra, dec, radius, limit)
    apart = angular_separation(ra, dec, star_ra, star_dec)
    inside = np.flatnonzero((apart <= radius) & (mag <= limit))
    assert len(inside) > 5
    assert rows_of(stars) == inside[np.lexsort((inside, mag[inside]))].tolist()


coordinate = st.tuples(
    st.floats(0.0, 2.0 * math.pi) | st.sampled_from([0.0, 2.0 * math.pi, 1e-12, 6.283185307179]),
    st.floats(-HALF_PI, HALF_PI) | st.sampled_from([-HALF_PI, HALF_PI, 0.0, 1.5707963, math.pi / 360.0]),
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    stars=st.lists(coordinate, min_size=1, max_size=40),
    center=coordinate,
    radius=st.floats(0.0, math.pi) | st.floats(0.0, 0.02) | st.sampled_from([0.0, HALF_PI, math.pi]),
    turns=st.integers(-2, 2),
)
def test_no_star_is_missed_and_none_too_many(stars, center, radius, turns) -> None:
    ra, dec = (np.array(values) for values in zip(*stars, strict=True))
    mag = np.linspace(9.0, 3.0, len(ra))
    found = rows_of(catalog_of(ra, dec, mag).cone(center[0] + 2.0 * math.pi * turns, center[1], radius))
    apart = angular_separation(*center, ra, dec)
    # A whole turn added to the center's RA costs rounding of 2e-15.
    assert set(np.flatnonzero(apart <= radius - EDGE_RAD)) <= set(found)
    assert set(found) <= set(np.flatnonzero(apart <= radius + EDGE_RAD))
    assert all(mag[a] <= mag[b] for a, b in pairwise(found))
    assert len(set(found)) == len(found)


def test_a_star_at_the_center_is_in_a_cone_of_radius_zero() -> None:
    ra, dec = np.array([1.234567]), np.array([-0.7654321])
    assert len(catalog_of(ra, dec, np.array([5.0])).cone(1.234567, -0.7654321, 0.0)) == 1


def test_magnitude_limit_is_inclusive_for_single_precision_columns() -> None:
    mag = np.array([10.986, 10.987], dtype=np.float32)
    stars = catalog_of(np.zeros(2), np.zeros(2), mag).cone(0.0, 0.0, 0.1, float(mag[0]))
    assert rows_of(stars) == [0]


def test_stars_of_equal_magnitude_keep_the_order_of_the_file() -> None:
    ra = np.array([0.03, 0.01, 0.02, 0.0])
    stars = catalog_of(ra, np.array([0.0, 0.02, -0.02, 0.01]), np.array([7.0, 7.0, 6.0, 7.0])).cone(
        0.0, 0.0, 0.1
    )
    assert rows_of(stars) == [2, 0, 1, 3]


def test_index_looks_at_few_stars() -> None:
    ra, dec, _ = random_sky(np.random.default_rng(8), 200_000)
    for center in ((1.0, 0.2), (0.0, -1.2), (3.0, 1.5)):
        assert (
            SkyIndex(ra, dec).candidates(*center, math.radians(0.3)).size < 100
        )  # 1.4 stars in the cone itself


def test_a_fast_star_is_found_where_it_stands_at_the_epoch() -> None:
    # Barnard's star by Hipparcos (J1991.25): by 2016.0 it has moved 4.3 arcmin north.
    barnard = SkyCoord(
        ra=269.45402305 * u.deg,
        dec=4.66828815 * u.deg,
        pm_ra_cosdec=-797.84 * u.mas / u.yr,
        pm_dec=10326.93 * u.mas / u.yr,
        distance=Distance(parallax=549.3 * u.mas),
        radial_velocity=0.0 * u.km / u.s,
        obstime=Time(1991.25, format="jyear", scale="tdb"),
    )
    later = barnard.apply_space_motion(new_obstime=Time(2016.0, format="jyear", scale="tdb"))
    columns = [np.array([v]) for v in (barnard.ra.rad, barnard.dec.rad, 9.5, -797.84 * MAS, 10326.93 * MAS)]
    catalog = catalog_of(*columns, epoch=1991.25)
    radius, et = math.radians(1.0 / 3600.0), 16.0 * 365.25 * 86400.0
    assert len(catalog.cone(later.ra.rad, later.dec.rad, radius)) == 0
    moved = catalog.cone(later.ra.rad, later.dec.rad, radius, et_s=et)
    np.testing.assert_array_equal(moved.dec_rad, barnard.dec.rad)  # the row itself stays the catalog's
    assert len(catalog.cone(barnard.ra.rad, barnard.dec.rad, radius, et_s=et)) == 0


def test_cone_at_an_epoch_equals_moving_every_star() -> None:
    rng = np.random.default_rng(9)
    ra, dec, mag = random_sky(rng, 3000)
    pmra, pmdec = rng.normal(0.0, 3000.0 * MAS, (2, 3000))
    catalog = catalog_of(ra, dec, mag, pmra, pmdec, epoch=2016.0)
    year = 2106.0
    still = SkyCoord(
        ra=ra * u.rad,
        dec=dec * u.rad,
        distance=np.full(3000, 10.0) * u.pc,
        pm_ra_cosdec=pmra * u.rad / u.yr,
        pm_dec=pmdec * u.rad / u.yr,
        radial_velocity=np.zeros(3000) * u.km / u.s,
        obstime=Time(2016.0, format="jyear", scale="tdb"),
    )
    moved = still.apply_space_motion(new_obstime=Time(year, format="jyear", scale="tdb"))
    for center in ((0.0, 0.0), (2.0, 1.5), (4.0, -0.8)):
        apart = angular_separation(*center, moved.ra.rad, moved.dec.rad)
        found = catalog.cone(*center, 0.15, et_s=(year - 2000.0) * 365.25 * 86400.0)
        assert sorted(rows_of(found)) == np.flatnonzero(apart <= 0.15).tolist()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((math.nan, 0.0, 0.1), "no direction"),
        ((0.0, 1.6, 0.1), "no direction"),
        ((0.0, math.nan, 0.1), "no direction"),
        ((0.0, 0.0, -0.1), "radius -0.1 rad is out of range"),
        ((0.0, 0.0, 4.0), "radius"),
        ((0.0, 0.0, math.nan), "radius"),
        ((0.0, 0.0, 0.1, math.nan), "magnitude limit"),
        ((0.0, 0.0, 0.1, 9.0, math.inf), "epoch"),
    ],
)
def test_numbers_out_of_range_are_refused(arguments, message: str) -> None:
    with pytest.raises(CatalogError, match=message):
        catalog_of(np.zeros(1), np.zeros(1), np.zeros(1)).cone(*arguments)
