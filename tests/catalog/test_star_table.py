"""StarTable: lengths, read-only columns, selection, covariance, units."""

from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u

from opnav_workbench.catalog import StarQuality, StarTable
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import et_from_jyear


def table(n: int = 4, first: int = 0) -> StarTable:
    rows = np.arange(first, first + n)
    return StarTable(
        id=tuple(f"row:{row}" for row in rows),
        ra_rad=0.1 * rows,
        dec_rad=-0.05 * rows,
        pmra_rad_yr=1e-8 * rows,
        pmdec_rad_yr=-2e-8 * rows,
        parallax_rad=1e-9 * rows,
        rv_km_s=np.where(rows % 2 == 0, np.nan, 10.0),
        mag=5.0 + rows,
        band=["G"] * n,
        epoch_jyear=np.full(n, 2016.0),
        sigma=1e-9 * (1 + np.arange(5 * n).reshape(n, 5)),
        motion_known=rows > 0,
    )


def test_columns_are_read_only_and_of_one_kind() -> None:
    stars = table()
    assert stars.ra_rad.dtype == np.float64
    assert stars.motion_known.dtype == np.bool_
    assert stars.id.dtype.kind == stars.band.dtype.kind == "U"
    for name in StarTable.__slots__:
        with pytest.raises(ValueError, match="read-only"):
            getattr(stars, name)[0] = getattr(stars, name)[1]
    with pytest.raises(AttributeError):
        stars.mag = np.zeros(4)


@pytest.mark.parametrize("column", ["mag", "id", "sigma"])
def test_a_column_of_another_length_is_refused(column: str) -> None:
    columns = {name: getattr(table(), name) for name in StarTable.__slots__}
    with pytest.raises(CatalogError, match=rf"{column} has shape \(3,.*expected \(4,"):
        StarTable(**{**columns, column: columns[column][:3]})


def test_covariance_is_the_square_of_sigma_on_the_diagonal() -> None:
    stars = table()
    assert stars.covariance.shape == (4, 5, 5)
    for star, sigma in zip(stars.covariance, stars.sigma, strict=True):
        np.testing.assert_array_equal(star, np.diag(sigma**2))


def test_take_by_index_mask_slice_and_empty_list() -> None:
    stars = table()
    assert list(stars.take([2, 0]).id) == ["row:2", "row:0"]
    assert list(stars.take(stars.mag > 6.5).id) == ["row:2", "row:3"]
    assert list(stars.take(slice(1, 3)).id) == ["row:1", "row:2"]
    assert len(stars.take([])) == len(stars.take(np.zeros(4, bool))) == 0
    np.testing.assert_array_equal(stars.take([3]).sigma, stars.sigma[[3]])


def test_concatenate_keeps_rows_and_long_names() -> None:
    long = table(1).take([0])
    joined = StarTable.concatenate([table(2), StarTable.empty(), table(3, first=9)])
    assert list(joined.id) == ["row:0", "row:1", "row:9", "row:10", "row:11"]
    assert len(StarTable.concatenate([])) == 0
    assert len(StarTable.concatenate([long])) == 1


def test_qtable_has_units_and_the_same_values() -> None:
    stars = table()
    shown = stars.to_qtable()
    assert shown["ra"].unit == u.deg
    assert shown["pmra"].unit == u.mas / u.yr
    np.testing.assert_allclose(shown["dec"].to_value(u.rad), stars.dec_rad, rtol=0, atol=1e-16)
    np.testing.assert_allclose(shown["pmdec"].to_value(u.rad / u.yr), stars.pmdec_rad_yr, rtol=1e-14)
    np.testing.assert_allclose(shown["sigma_parallax"].to_value(u.rad), stars.sigma[:, 2], rtol=1e-14)
    assert list(shown["motion_known"]) == [False, True, True, True]
    assert all(shown[name].info.description for name in ("ra", "mag", "epoch", "sigma_pmra"))


def test_columns_left_out_are_unknown() -> None:
    stars = table()
    for name in ("v_mag", "v_sigma", "b_v", "b_v_sigma"):
        assert np.isnan(getattr(stars, name)).all()
        assert getattr(stars, name).shape == (4,)
    assert stars.flags.tolist() == stars.hip.tolist() == [0, 0, 0, 0]
    assert stars.flags.dtype == stars.hip.dtype == np.int64
    np.testing.assert_array_equal(stars.position_motion, np.zeros((4, 2)))


def test_photometry_and_flags_follow_their_stars() -> None:
    flags = [0, StarQuality.DOUBLE, StarQuality.DOUBLE | StarQuality.VARIABLE, 0]
    stars = replace(table(), v_mag=np.arange(4.0), b_v=np.arange(4.0) / 10.0, flags=flags, hip=np.arange(4))
    part = StarTable.concatenate([stars.take([2, 0]), table(1)])
    np.testing.assert_array_equal(part.v_mag, [2.0, 0.0, np.nan])
    assert part.flags.tolist() == [65, 0, 0]
    assert part.hip.tolist() == [2, 0, 0]
    shown = stars.to_qtable()
    assert shown["v_mag"].unit == u.mag
    assert list(shown["flags"]) == [0, 1, 65, 0]
    with pytest.raises(CatalogError, match=r"v_mag has shape \(3,.*expected \(4,"):
        replace(stars, v_mag=np.zeros(3))
    with pytest.raises(CatalogError, match=r"position_motion has shape \(4,.*expected \(4, 2"):
        replace(stars, position_motion=np.zeros(4))


def test_position_and_motion_vary_together() -> None:
    """A position reduced to J2000 from its mean epoch: the sigma at that epoch is the observed one again."""
    observed, motion, years = 20e-9, 3e-9, 12.0
    sigma = np.tile([np.hypot(observed, years * motion)] * 2 + [0.0] + [motion] * 2, (4, 1))
    stars = replace(
        table(),
        epoch_jyear=np.full(4, 2000.0),
        sigma=sigma,
        position_motion=np.full((4, 2), years * motion**2),
    )
    for year, expected in (
        (1988.0, observed),
        (2000.0, sigma[0, 0]),
        (2015.0, np.hypot(observed, 27.0 * motion)),
    ):
        variance = stars.sky_covariance(float(et_from_jyear(year)))
        np.testing.assert_allclose(np.sqrt(variance[:, [0, 1], [0, 1]]), expected, rtol=1e-6)
    for matrix in stars.covariance:
        assert np.linalg.eigvalsh(matrix).min() > -1e-30


def test_a_table_of_no_stars_may_have_forgotten_its_widths() -> None:
    empty = {name: np.array([]) for name in StarTable.__slots__}  # as JSON gives them back
    assert StarTable(**empty).covariance.shape == (0, 5, 5)
