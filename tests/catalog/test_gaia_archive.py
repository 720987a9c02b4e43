"""Gaia's whole sky from a TAP service: a server on this machine answers the questions as the IVOA's standard says."""

import http.server
import re
import threading
from functools import partial
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from opnav_workbench.catalog import fetch_whole_sky, gaia_archive, open_catalog
from opnav_workbench.errors import CatalogError, DownloadError

FIELDS = {
    "Source": ("long", ""), "RA_ICRS": ("double", "deg"), "DE_ICRS": ("double", "deg"), "e_RA_ICRS": ("float", "mas"),
    "e_DE_ICRS": ("float", "mas"), "pmRA": ("double", "mas/yr"), "pmDE": ("double", "mas/yr"), "e_pmRA": ("float", "mas/yr"),
    "e_pmDE": ("float", "mas/yr"), "Plx": ("double", "mas"), "e_Plx": ("float", "mas"), "RV": ("double", "km/s"),
    "Gmag": ("double", "mag"), "BPmag": ("double", "mag"), "RPmag": ("double", "mag"), "RUWE": ("double", ""),
}  # fmt: skip
PIECES = 12  # of the coarsest level


def random_sky(n):
    """Stars all over the sky, as text, numbered by the piece that they stand in."""
    rng = np.random.default_rng(6)
    ra, dec = rng.uniform(0.0, 360.0, n), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, n)))
    z, phi = np.sin(np.radians(dec)), ra / 90.0
    # The twelve base pixels by Gorski et al. (2005), eqs. 3 to 7.
    piece = np.where(np.abs(z) > 2.0 / 3.0, np.where(z > 0.0, 0, 8) + np.floor(phi), -1)
    up, down = np.floor(0.5 + phi - 0.75 * z), np.floor(0.5 + phi + 0.75 * z)
    belt = np.where(up == down, 4 + up % 4, np.where(up < down, up % 4, 8 + down % 4))
    piece = np.where(piece < 0, belt, piece).astype(np.int64)
    number = piece * 2**59 + rng.integers(0, 2**59, n)
    return {"Source": number, "RA_ICRS": ra, "DE_ICRS": dec, "Gmag": rng.uniform(8.0, 14.0, n)}


class _Service(http.server.BaseHTTPRequestHandler):
    def log_message(self, *_):
        pass

    def do_GET(self):
        question = parse_qs(urlsplit(self.path).query)
        (query,) = question["QUERY"]
        assert (question["LANG"], question["REQUEST"]) == (["ADQL"], ["doQuery"])
        first, last = map(int, re.search(r'"Source" BETWEEN (\d+) AND (\d+)', query).groups())
        limit = float(re.search(r'"Gmag" <= ([\d.]+)', query)[1])
        piece = first // 2**59
        self.server.asked.append(piece)
        sky = self.server.sky
        rows = np.flatnonzero((sky["Source"] >= first) & (sky["Source"] <= last) & (sky["Gmag"] <= limit))
        body = answer({name: values[rows] for name, values in sky.items()}, self.server.status)
        if piece in self.server.cut:
            body = body[: len(body) // 2]
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def answer(stars, status):
    fields = "".join(
        f'<FIELD name="{name}" datatype="{kind}" unit="{unit}"/>' for name, (kind, unit) in FIELDS.items()
    )
    usual = {"e_RA_ICRS": 0.02, "e_DE_ICRS": 0.02, "pmRA": 3.0, "pmDE": -2.0, "e_pmRA": 0.02, "e_pmDE": 0.02, "Plx": 1.5,
             "e_Plx": 0.03, "RUWE": 1.0}  # fmt: skip
    rows = []
    for i in range(len(stars["Source"])):
        told = usual | {name: values[i] for name, values in stars.items()}
        told |= {"BPmag": told["Gmag"] + 0.3, "RPmag": told["Gmag"] - 0.5}
        cells = "".join(f"<TD>{told[name]}</TD>" if name in told else "<TD/>" for name in FIELDS)
        rows.append(f"<TR>{cells}</TR>")
    return (
        '<?xml version="1.0"?><VOTABLE version="1.3" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">'
        f'<RESOURCE type="results"><INFO name="QUERY_STATUS" value="OK"/><TABLE>{fields}<DATA><TABLEDATA>'
        f"{''.join(rows)}</TABLEDATA></DATA></TABLE>{status}</RESOURCE></VOTABLE>"
    ).encode()


@pytest.fixture
def service(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    for name, value in (("N_PIECES", PIECES), ("NUMBERS_A_PIECE", 2**59)):
        monkeypatch.setattr(gaia_archive, name, value)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Service)
    server.sky, server.asked, server.cut, server.status = random_sky(600), [], set(), ""
    threading.Thread(target=partial(server.serve_forever, poll_interval=0.01), daemon=True).start()
    yield server, f"http://127.0.0.1:{server.server_port}/tap/sync"
    server.shutdown()
    server.server_close()


def test_whole_sky_of_gaia_goes_on_after_a_cut(service, tmp_path):
    server, url = service
    server.cut = {7}
    with pytest.raises(DownloadError, match=r"gaia-007\.vot came cut short"):
        fetch_whole_sky("gaia", 12.0, url)
    assert server.asked == list(range(8))
    server.cut = set()
    server.asked.clear()
    stars = fetch_whole_sky("gaia", 12.0, url)
    assert server.asked == list(range(7, PIECES))
    sky = server.sky
    bright = sky["Gmag"] <= 12.0
    assert stars.describe()["n_stars"] == np.count_nonzero(bright)
    found = open_catalog("fetched:gaia").cone(1.0, 0.4, 0.8)
    place = np.radians(np.stack([sky["RA_ICRS"], sky["DE_ICRS"]]))
    cosine = np.sin(place[1]) * np.sin(0.4) + np.cos(place[1]) * np.cos(0.4) * np.cos(place[0] - 1.0)
    near = bright & (cosine >= np.cos(0.8))
    assert set(found.id) == {f"Gaia DR3 {number}" for number in sky["Source"][near]}
    np.testing.assert_allclose(found.mag, np.sort(sky["Gmag"][near]), rtol=1e-12)
    assert set(found.epoch_jyear) == {2016.0}
    assert found.motion_known.all()
    np.testing.assert_allclose(np.degrees(found.pmdec_rad_yr) * 3.6e6, -2.0, rtol=1e-6)
    assert not list((tmp_path / "cache" / "catalogs").glob("fetching-*"))


def test_a_deeper_sky_is_asked_for_anew(service):
    server, url = service
    shallow = fetch_whole_sky("gaia", 10.0, url)
    deep = fetch_whole_sky("gaia", 13.0, url)
    assert deep.describe()["n_stars"] > shallow.describe()["n_stars"]
    assert open_catalog("fetched:gaia").describe()["n_stars"] == deep.describe()["n_stars"]
    assert len(server.asked) == 2 * PIECES


@pytest.mark.parametrize(
    ("status", "said"),
    [
        ('<INFO name="QUERY_STATUS" value="OVERFLOW"/>', "cuts its answers short"),
        ('<INFO name="QUERY_STATUS" value="ERROR">no disk</INFO>', "answers with an error"),
    ],
)
def test_answers_that_are_not_whole(service, status, said):
    server, url = service
    server.status = status
    with pytest.raises(DownloadError, match=said):
        fetch_whole_sky("gaia", 12.0, url)


def test_a_piece_of_another_place_is_refused(service, tmp_path):
    sky = {name: values[:1] for name, values in service[0].sky.items()}
    sky["Source"] = np.array([3 * 2**59 + 5])
    for piece in range(PIECES):
        (tmp_path / f"gaia-{piece:03d}.vot").write_bytes(answer(sky, ""))
    with pytest.raises(CatalogError, match=r"gaia-000\.vot holds stars of another piece"):
        gaia_archive.piece_records(tmp_path)
    (tmp_path / "gaia-000.vot").write_bytes(b"<VOTABLE></VOTABLE>")
    with pytest.raises(CatalogError, match=r"gaia-000\.vot cannot be read"):
        gaia_archive.piece_records(tmp_path)


@pytest.mark.parametrize("limit", [None, 16.5, 1.0])
def test_limits_that_no_machine_could_keep(service, limit):
    with pytest.raises(CatalogError, match="give --mag-limit, 3 to 15"):
        fetch_whole_sky("gaia", limit, service[1])
