"""Whole catalogs from an archive: a server on this machine has files of Tycho-2's layout."""

import gzip
import http.server
import threading
from functools import partial

import numpy as np
import pytest
from test_catalog_tycho2 import ROWS, SUPPLEMENT, content

from opnav_workbench.catalog import (
    catalog_contents,
    catalog_status,
    fetch_whole_sky,
    open_catalog,
    specs,
    tycho2,
)
from opnav_workbench.errors import CatalogError, DownloadError


class _Quiet(http.server.SimpleHTTPRequestHandler):
    asked: list[str]

    def log_message(self, *_):
        pass

    def do_GET(self):
        self.server.asked.append(self.path)
        super().do_GET()


@pytest.fixture
def archive(tmp_path, monkeypatch):
    """A folder on the web with Tycho-2 in twenty parts, four of them with a star."""
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "I_259"
    folder.mkdir()
    for number, name in enumerate(tycho2.PARTS):
        (folder / f"{name}.gz").write_bytes(gzip.compress(content(ROWS[number % len(ROWS)])))
    (folder / "suppl_1.dat.gz").write_bytes(gzip.compress(content(SUPPLEMENT)))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    server.asked = []
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield folder, f"http://127.0.0.1:{server.server_port}/", server.asked
    server.shutdown()
    server.server_close()


def test_whole_sky_goes_on_after_a_cut_and_is_part_of_bundled(archive, tmp_path, monkeypatch):
    folder, url, asked = archive
    np.savez(tmp_path / "two.npz", ra_deg=[1.0, 2.0], dec_deg=[0.0, 0.0], mag=[3.0, 4.0])
    few = open_catalog(f"npz:{tmp_path / 'two.npz'}")
    monkeypatch.setattr(specs, "open_bundled", lambda _progress: few)  # merging the packages takes seconds
    assert open_catalog("bundled") is few
    before = catalog_contents("bundled")
    cut = folder / "tyc2.dat.07.gz"
    whole = cut.read_bytes()
    cut.write_bytes(whole[:-9])
    with pytest.raises(DownloadError, match=r"tyc2\.dat\.07\.gz came damaged"):
        fetch_whole_sky("tycho2", url=url)
    cut.write_bytes(whole)
    asked.clear()
    stars = fetch_whole_sky("tycho2", mag_limit=11.0, url=url)
    assert len(asked) == 14  # the first seven files were there
    assert stars.describe()["faintest_mag"] <= 11.0
    assert open_catalog("fetched:tycho2").describe()["n_stars"] == stars.describe()["n_stars"] == 11
    assert open_catalog("bundled").describe()["n_stars"] == 2 + 11
    assert set(catalog_contents("bundled")) - set(before) == set(
        catalog_contents("fetched:tycho2")
    )  # a night notices
    told = next(s for s in catalog_status() if s.form == "fetched:NAME").detail
    assert told.startswith("tycho2: part of bundled; opnav catalog fetch gaia gets Gaia DR3")


def test_what_was_not_fetched_is_said(archive):
    with pytest.raises(CatalogError, match="run: opnav catalog fetch tycho2"):
        open_catalog("fetched:tycho2")
    with pytest.raises(CatalogError, match="the whole sky of 'sao' cannot be fetched"):
        fetch_whole_sky("sao")
