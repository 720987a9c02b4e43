"""VizieR's catalogs: rows become stars, cones are kept and serve without a network, failures say what to do.

The service is played by a function; its tables have the names and units of the real ones.
"""

import numpy as np
import pytest
from astropy import units as u
from astropy.table import MaskedColumn, Table

from opnav_workbench.catalog.proper_motion import UNKNOWN_MOTION_MAS_YR
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.specs import open_catalog
from opnav_workbench.catalog.vizier import VizierCatalog
from opnav_workbench.catalog.vizier_tables import TABLES
from opnav_workbench.constants import RAD_PER_MAS
from opnav_workbench.errors import CatalogError

# Proxima Cen (Gaia DR3) and two invented companions: one with two parameters only, one with a poor fit.
GAIA = {
    "Source": np.array([5853498713190525696, 5853498713190525697, 9], dtype=np.int64),
    "RA_ICRS": [217.39232147200883, 217.40, 217.38],
    "DE_ICRS": [-62.67607511676666, -62.67, -62.68],
    "e_RA_ICRS": [0.0240, 1.5, 0.3],
    "e_DE_ICRS": [0.0340, 1.6, 0.3],
    "Plx": [768.0665391873573, np.nan, 2.0],
    "e_Plx": [0.0499, np.nan, 0.4],
    "pmRA": [-3781.741008265163, np.nan, 5.0],
    "e_pmRA": [0.0314, np.nan, 0.3],
    "pmDE": [769.4650146478623, np.nan, -6.0],
    "e_pmDE": [0.0507, np.nan, 0.3],
    "RUWE": [0.94, np.nan, 3.0],
    "Gmag": [8.984749, 15.0, 12.0],
    "BPmag": [11.373116, np.nan, 12.4],
    "RPmag": [7.5685353, np.nan, 11.4],
    "RV": [-20.578199, np.nan, np.nan],
}
UNITS = {"RA_ICRS": u.deg, "DE_ICRS": u.deg}
HERE = (np.radians(217.39), np.radians(-62.675), np.radians(0.05))


def gaia_rows():
    table = Table()
    for name, given in GAIA.items():
        values = np.asarray(given)
        mask = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
        table[name] = MaskedColumn(values, mask=mask, unit=UNITS.get(name))
    return table


class Service:
    def __init__(self, rows):
        self.rows, self.asked, self.down = rows, [], False

    def __call__(self, layout, cone):
        if self.down:
            raise CatalogError("VizieR did not answer: no route to host")
        self.asked.append(cone)
        return self.rows


@pytest.fixture
def service(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    return Service(gaia_rows())


def test_rows_become_stars(service):
    stars = VizierCatalog("gaia-dr3", service).cone(*HERE)
    assert stars.id.tolist() == ["Gaia DR3 5853498713190525696", "Gaia DR3 9", "Gaia DR3 5853498713190525697"]
    proxima = stars.take([0])
    assert np.degrees(proxima.ra_rad[0]) == pytest.approx(217.39232147200883, abs=1e-12)
    assert proxima.pmra_rad_yr[0] / RAD_PER_MAS == pytest.approx(-3781.741008265163)
    assert proxima.parallax_rad[0] / RAD_PER_MAS == pytest.approx(768.0665391873573)
    assert proxima.rv_km_s[0] == pytest.approx(-20.578199)
    assert proxima.sigma[0] / RAD_PER_MAS == pytest.approx([0.0240, 0.0340, 0.0499, 0.0314, 0.0507])
    assert proxima.v_mag[0] == pytest.approx(11.1, abs=0.5)  # V of Proxima Cen
    assert stars.motion_known.tolist() == [True, True, False]
    assert stars.flags.tolist() == [0, int(StarQuality.BAD_ASTROMETRY), 0]
    assert stars.sigma[2, 3] == pytest.approx(UNKNOWN_MOTION_MAS_YR * RAD_PER_MAS)
    assert np.isfinite(stars.pmra_rad_yr).all()


def test_a_kept_cone_serves_without_a_network(service):
    catalog = VizierCatalog("gaia-dr3", service)
    first = catalog.cone(*HERE)
    service.down = True
    again = VizierCatalog("gaia-dr3", service)
    for cone in (HERE, (HERE[0] + 1e-5, HERE[1], 0.9 * HERE[2])):
        assert set(again.cone(*cone).id) <= set(first.id)
    np.testing.assert_array_equal(again.cone(*HERE).ra_rad, first.ra_rad)
    assert len(service.asked) == 1
    assert again.cone(*HERE, mag_limit=10.0).mag.tolist() == [8.984749]
    assert len(again.cone(*HERE, exclude_flags=StarQuality.BAD_ASTROMETRY)) == 2
    described = again.describe()
    assert described["n_stars"] == 3
    assert described["cones_on_disk"][0]["radius_deg"] == pytest.approx(0.055)


def test_a_brighter_cone_does_not_serve_for_a_deeper_one(service):
    catalog = VizierCatalog("gaia-dr3", service)
    catalog.cone(*HERE, mag_limit=10.0)
    catalog.cone(*HERE, mag_limit=9.0)
    assert len(service.asked) == 1
    catalog.cone(*HERE, mag_limit=12.0)
    catalog.cone(*HERE)
    assert [cone.mag_limit for cone in service.asked] == [10.0, 12.0, None]


def test_an_epoch_widens_the_cone_by_the_fastest_motion(service):
    catalog = VizierCatalog("gaia-dr3", service)
    found = catalog.cone(*HERE, et_s=20.0 * 365.25 * 86400.0)
    assert "Gaia DR3 5853498713190525696" in found.id
    assert service.asked[0].radius_deg == pytest.approx(1.1 * (0.05 + 4.0 * 10.4 / 3600.0), rel=1e-3)


def test_without_network_the_message_has_the_command(service):
    service.down = True
    with pytest.raises(
        CatalogError, match=r"opnav catalog fetch gaia-dr3 --cone 217\.3900 -62\.6750 0\.0550 --mag 14"
    ) as caught:
        VizierCatalog("gaia-dr3", service).cone(*HERE, mag_limit=14.0)
    assert "no route to host" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_real_service_out_of_reach_is_one_clear_error(tmp_path, monkeypatch):
    pytest.importorskip("astroquery", reason="the online extra is not installed")
    import requests

    def refuse(*_args, **_kwargs):
        raise requests.ConnectionError("Name or service not known")

    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    monkeypatch.setattr(requests.Session, "send", refuse)
    known = r"did not answer \(Name or service not known\); check the network"
    with pytest.raises(CatalogError, match=rf"{known}.*opnav catalog fetch hip2 --cone"):
        open_catalog("vizier:hip2").cone(*HERE)
    with pytest.raises(CatalogError, match=known):
        open_catalog("vizier:hip2").fetch(10.0, 20.0, 0.1, None)


def test_a_damaged_file_is_fetched_again(service, tmp_path):
    catalog = VizierCatalog("gaia-dr3", service)
    catalog.cone(*HERE)
    kept = next(catalog.folder.glob("*.npz"))
    kept.write_bytes(kept.read_bytes()[:200])
    assert len(catalog.cone(*HERE)) == 3
    assert len(service.asked) == 2


def test_a_changed_table_says_so(service):
    service.rows.remove_column("RUWE")
    with pytest.raises(CatalogError, match="came without RUWE"):
        VizierCatalog("gaia-dr3", service).cone(*HERE)


def test_an_empty_answer_is_no_error(service):
    service.rows = service.rows[:0]
    catalog = VizierCatalog("gaia-dr3", service)
    assert len(catalog.cone(*HERE)) == 0
    assert len(catalog.cone(*HERE)) == 0
    assert len(service.asked) == 1


@pytest.mark.parametrize("kind", sorted(TABLES))
def test_every_table_makes_stars(kind, tmp_path, monkeypatch):
    """Numbers of the right size under the names of each table."""
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    layout = TABLES[kind]
    rows = Table({name: np.full(2, 7.0) for name in layout.columns})
    for name, value in zip(layout.position, HERE, strict=False):
        rows[name] = np.full(2, np.degrees(value))
        rows[name].unit = u.deg
    if "UCAC4" in rows.colnames:
        rows["UCAC4"] = np.array(["137-123456", "137-123457"])
    stars = VizierCatalog(kind, lambda *_: rows).cone(*HERE)
    assert len(stars) == 2
    assert stars.epoch_jyear.tolist() == [layout.epoch_jyear] * 2
    assert stars.motion_known.all()
    assert np.isfinite(stars.v_mag).all()


def test_radians_are_taken_as_such(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    rows = Table({name: np.full(1, 7.0) for name in TABLES["hip2"].columns})
    rows["RArad"], rows["DErad"] = [HERE[0]], [HERE[1]]
    rows["RArad"].unit = rows["DErad"].unit = u.rad
    stars = VizierCatalog("hip2", lambda *_: rows).cone(*HERE)
    assert stars.ra_rad[0] == pytest.approx(HERE[0], abs=1e-14)


def test_unknown_names():
    with pytest.raises(CatalogError, match="unknown VizieR catalog 'sao'; use gaia-dr3"):
        open_catalog("vizier:sao")
