"""StarTable: lengths, read-only columns, selection, covariance, units."""

import numpy as np
import pytest
from astropy import units as u

from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import CatalogError


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
