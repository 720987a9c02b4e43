"""Catalog files that lie: one line, and nothing of them in a cache."""

import zipfile

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.catalog import open_catalog
from opnav_workbench.catalog.cache import cache_path, cached_stars, star_records
from opnav_workbench.catalog.user_files import read_star_list
from opnav_workbench.errors import CatalogError

GOOD = {"ra_deg": np.array([10.0, 20.0]), "dec_deg": np.array([1.0, -2.0]), "mag": np.array([5.0, 6.0])}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"id": np.array([b"a", b"\xff\xfe"])}, "id holds bytes that are no UTF-8"),
        ({"mag": np.array([5.0, 1e300])}, "mag runs from 5 to 1e.300"),
        ({"pmra_mas_yr": np.array([1e200, 0.0]), "pmdec_mas_yr": np.array([0.0, 0.0])}, "pmra_mas_yr runs"),
        ({"parallax_mas": np.array([np.inf, np.nan])}, "parallax_mas is inf"),
        ({"rv_km_s": np.array([1e30, np.nan])}, "rv_km_s runs"),
    ],
)
def test_arrays_out_of_range(tmp_path, changed, words):
    np.savez(tmp_path / "stars.npz", **(GOOD | changed))
    with pytest.raises(CatalogError, match=words) as caught:
        open_catalog(f"npz:{tmp_path / 'stars.npz'}")
    assert str(caught.value).isprintable()


def test_headers_of_arrays_that_claim_more_than_there_is(tmp_path):
    np.savez(tmp_path / "stars.npz", **GOOD)
    with zipfile.ZipFile(tmp_path / "stars.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for claim in (b"(99999999999,)", b"(-5,)", b"(2, 'x')", b"((((((((((2,"):
        path = tmp_path / "claims.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data.replace(b"(2,), }" + b" " * (len(claim) - 4), claim + b", }", 1))
        with pytest.raises(CatalogError, match=r"damaged|whole|Python objects|shape"):
            open_catalog(f"npz:{path}")


def test_an_index_file_of_a_billion_axes(tmp_path):
    path = tmp_path / "index.fits"
    fits.HDUList([fits.PrimaryHDU(np.zeros((2, 2)))]).writeto(path)
    data = path.read_bytes()
    start = data.index(b"NAXIS   =")
    path.write_bytes(data[:start] + f"{'NAXIS':<8}= {999999999:>20}".ljust(80).encode() + data[start + 80 :])
    with pytest.raises(CatalogError, match="NAXIS = 999999999"):
        open_catalog(f"astrometry-net:{path}")
    path.write_bytes(data.replace(b"SIMPLE  =", b"SIMPLE\xff =", 1))
    with pytest.raises(CatalogError, match=r"not a whole Astrometry.net index file"):
        open_catalog(f"astrometry-net:{path}")


@pytest.mark.parametrize(("column", "value"), [("mag", np.inf), ("ra_rad", np.nan), ("parallax_rad", np.inf)])
def test_infinities_do_not_reach_the_cache(tmp_path, monkeypatch, column, value):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    path = cache_path("bad")
    records = star_records(3, ra_rad=[0.1, 0.2, 0.3], mag=[1.0, 2.0, 3.0])
    records[column][1] = value
    with pytest.raises(CatalogError, match=f"star 1 of the source has {column}"):
        cached_stars(path, {}, lambda: records)
    assert not path.exists()


@pytest.mark.parametrize("field", ["mag: .nan", "mag: .inf", "epoch_jyear: .inf", "pmra_mas_yr: 1.0e400"])
def test_star_lists_are_finite(tmp_path, field):
    values = {"name": "a", "ra_deg": 1, "dec_deg": 2, "epoch_jyear": 2000, "mag": 5}
    values = {k: v for k, v in values.items() if not field.startswith(k)}
    text = "stars:\n- {" + ", ".join(f"{k}: {v}" for k, v in values.items()) + f", {field}" + "}\n"
    (tmp_path / "stars.yaml").write_text(text)
    with pytest.raises(CatalogError, match="finite number"):
        read_star_list(tmp_path / "stars.yaml")
