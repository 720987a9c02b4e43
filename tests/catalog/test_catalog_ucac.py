"""UCAC2 and UCAC4 zone files: against rms-starcat, and records written byte by byte from the documented layout."""

import math
import struct
import tracemalloc

import numpy as np
import pytest
from astropy.coordinates import angular_separation
from starcat.ucac4 import UCAC4StarCatalog

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR, StarQuality, open_catalog
from opnav_workbench.catalog.ucac2 import UCAC2_RECORD
from opnav_workbench.catalog.ucac4 import UCAC4_RECORD
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import et_from_jyear

MAS = math.radians(1.0 / 3.6e6)
YEAR_S = 365.25 * 86400.0
UCAC4_STRUCT = "<iihhBBBbbBBBHHhhbbIhhh3B3B5h5bBIBBIHI"  # 78 bytes; no dtype of the code under test
UCAC2_STRUCT = "<iihbbbbbbhhiibbbbihhhbb"  # 44 bytes
RADIUS = math.radians(0.3)
SOUTH = np.radians([200.0, -0.25])  # and that of UCAC2's zone 180
HERE = np.radians([200.0, 0.1])  # where the single records stand: the middle of UCAC4's zone 451


def peer_stars(folder, ra, dec, radius):
    """The stars that rms-starcat finds in a cone, by its own reading of the files."""
    half = radius / math.cos(dec) * 1.01
    found = UCAC4StarCatalog(folder).find_stars(
        ra_min=(ra - half) % (2.0 * math.pi),
        ra_max=(ra + half) % (2.0 * math.pi),
        dec_min=dec - radius,
        dec_max=dec + radius,
        return_everything=True,
    )
    return {star.id_str: star for star in found if angular_separation(ra, dec, star.ra, star.dec) <= radius}


@pytest.mark.parametrize("center_deg", [(57.0, 0.1), (0.1, 0.05), (359.95, 0.15), (181.3, 0.2)])
def test_the_same_stars_and_values_as_an_independent_reader(ucac4_folder, center_deg) -> None:
    ra, dec = np.radians(center_deg)
    stars, peers = (
        open_catalog(f"ucac4:{ucac4_folder}").cone(ra, dec, RADIUS),
        peer_stars(ucac4_folder, ra, dec, RADIUS),
    )
    assert len(stars) > 400
    assert set(stars.id) == peers.keys()

    def peer(name: str):
        return np.array([getattr(peers[star], name) for star in stars.id], dtype=np.float64)

    np.testing.assert_allclose(stars.ra_rad, peer("ra"), rtol=0, atol=1e-6 * MAS)
    np.testing.assert_allclose(stars.dec_rad, peer("dec"), rtol=0, atol=1e-6 * MAS)
    np.testing.assert_allclose(stars.mag, peer("vmag"), rtol=0, atol=1e-12)
    np.testing.assert_allclose(stars.pmra_rad_yr, peer("pm_rac") * YEAR_S, rtol=1e-12)
    np.testing.assert_allclose(stars.pmdec_rad_yr, peer("pm_dec") * YEAR_S, rtol=1e-12)
    motion_sigma = np.stack([peer("pm_rac_sigma"), peer("pm_dec_sigma")], axis=-1) * YEAR_S
    np.testing.assert_allclose(stars.sigma[:, 3:], motion_sigma, rtol=1e-12)
    place, epochs = (
        np.stack([peer(a), peer(b)], axis=-1)
        for a, b in (("rac_sigma", "dec_sigma"), ("ra_mean_epoch", "dec_mean_epoch"))
    )
    at_2000 = np.hypot(place, (2000.0 - epochs) * motion_sigma)
    np.testing.assert_allclose(stars.sigma[:, :2], at_2000, rtol=1e-9)
    known = (
        np.isfinite(peer("apass_mag_b"))
        & (peer("apass_mag_b_sigma") != 0.0)
        & (peer("apass_mag_v_sigma") != 0.0)
    )
    assert np.count_nonzero(known) > 150
    color = peer("apass_mag_b") - peer("apass_mag_v")
    np.testing.assert_allclose(stars.v_mag[known], peer("apass_mag_v")[known], rtol=0, atol=1e-9)
    np.testing.assert_allclose(stars.b_v[known], color[known], rtol=0, atol=1e-9)
    assert np.isfinite(stars.v_mag).all()


def test_limits_and_order(ucac4_folder) -> None:
    catalog = open_catalog(f"ucac4:{ucac4_folder}")
    every, bright = (catalog.cone(1.0, 0.002, RADIUS, limit) for limit in (math.inf, 12.0))
    assert (np.diff(every.mag) >= 0.0).all()
    assert list(bright.id) == list(every.id[every.mag <= 12.0])
    assert 0 < len(bright) < len(every)


def test_a_polygon_is_what_lies_on_the_inner_side_of_its_edges(ucac4_folder) -> None:
    # A square of 0.5 deg about RA 0, dec +0.1: edges along RA are meridians, so two tests need no vectors.
    catalog, half = open_catalog(f"ucac4:{ucac4_folder}"), math.radians(0.25)
    center = math.radians(0.1)
    angles = [(-half, center - half), (half, center - half), (half, center + half), (-half, center + half)]
    corners = np.array(
        [(math.cos(d) * math.cos(a), math.cos(d) * math.sin(a), math.sin(d)) for a, d in angles]
    )
    inside = catalog.polygon(corners)
    every = catalog.cone(0.0, center, math.radians(0.37))
    ra = (every.ra_rad + math.pi) % (2.0 * math.pi) - math.pi
    # The northern and southern edges are great circles: tan(dec) = tan(dec of the corner) cos(ra) / cos(half)
    bulge = np.cos(ra) / math.cos(half)
    north, south = (np.arctan(math.tan(center + side) * bulge) for side in (half, -half))
    expected = (np.abs(ra) <= half) & (every.dec_rad <= north) & (every.dec_rad >= south)
    assert list(inside.id) == list(every.id[expected])
    assert len(inside) > 400


def test_at_another_epoch_the_moved_places_count(ucac4_folder) -> None:
    catalog, et = open_catalog(f"ucac4:{ucac4_folder}"), float(et_from_jyear(2100.0))
    ra, dec, radius = 2.0, 0.002, math.radians(0.1)
    moved = catalog.cone(ra, dec, radius, et_s=et)
    every = catalog.cone(ra, dec, math.radians(0.12))
    at_epoch = every.directions(et)
    center = np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
    expected = np.arccos(np.clip(at_epoch @ center, -1.0, 1.0)) <= radius
    assert sorted(moved.id) == sorted(every.id[expected])
    assert sorted(moved.id) != sorted(catalog.cone(ra, dec, radius).id)


def test_memory_stays_flat(ucac4_folder) -> None:
    catalog = open_catalog(f"ucac4:{ucac4_folder}")
    catalog.cone(0.0, 0.002, RADIUS)
    tracemalloc.start()
    try:
        for ra in np.linspace(0.0, 2.0 * math.pi, 60):
            catalog.cone(float(ra), 0.002, RADIUS)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4e6  # bytes, of 52 MB of zone files: 500 stars and their candidates
    assert held < 1e6


# ---------- single records, byte by byte


def ucac4_record(**changes) -> bytes:
    fields = {
        "ra": 720_000_000, "spd": 324_360_000, "magm": 12_100, "maga": 12_000, "sigmag": 3, "objt": 0, "cdf": 0,
        "sigra": 20 - 128, "sigdc": 30 - 128, "na1": 4, "nu1": 3, "cu1": 5, "cepra": 9_800, "cepdc": 9_900,
        "pmrac": -123, "pmdc": 45, "sigpmr": 12 - 128, "sigpmd": 14 - 128, "pts": 7, "j": 10_900, "h": 10_600, "k": 10_500,
        "flags": (1, 1, 1, 2, 2, 2), "apasm": (12_900, 12_300, 12_500, 12_200, 12_100), "apase": (3, 2, 2, 2, 2),
        "gcflg": 0, "icf": 0, "leda": 0, "x2m": 0, "rnm": 113_038_183, "zn2": 200, "rn2": 77,
    }  # fmt: skip
    fields.update(changes)
    flat = [x for value in fields.values() for x in (value if isinstance(value, tuple) else (value,))]
    return struct.pack(UCAC4_STRUCT, *flat)


def only_star(tmp_path, *records: bytes, kind="ucac4", zone=451, beside=()):
    folder = tmp_path / kind
    folder.mkdir(exist_ok=True)
    (folder / f"z{zone:03d}").write_bytes(b"".join(records))
    for name, content in beside:
        (folder / name).write_text(content)
    return open_catalog(f"{kind}:{folder}").cone(*HERE, math.radians(0.01))


def test_ucac4_fields_come_out_in_their_units(tmp_path) -> None:
    assert UCAC4_RECORD.itemsize == struct.calcsize(UCAC4_STRUCT) == 78
    star = only_star(tmp_path, ucac4_record())
    assert list(star.id) == ["UCAC4-451-000001"]
    np.testing.assert_allclose(
        [star.ra_rad[0] / MAS, star.dec_rad[0] / MAS], [720_000_000, 360_000], rtol=1e-9
    )
    np.testing.assert_allclose(
        [star.pmra_rad_yr[0] / MAS, star.pmdec_rad_yr[0] / MAS], [-12.3, 4.5], rtol=1e-12
    )
    np.testing.assert_allclose(star.sigma[0, 3:] / MAS, [1.2, 1.4], rtol=1e-12)
    np.testing.assert_allclose(
        star.sigma[0, :2] / MAS, [math.hypot(20, 2 * 1.2), math.hypot(30, 1.4)], rtol=1e-12
    )
    for axis, (epoch, sigma) in enumerate(((1998.0, 20.0), (1999.0, 30.0))):
        at_mean = star.sky_covariance(float(et_from_jyear(epoch)))[0, axis, axis]
        assert math.sqrt(at_mean) / MAS == pytest.approx(sigma, rel=1e-6)
    assert (star.mag[0], star.band[0], star.epoch_jyear[0], star.flags[0]) == (12.0, "UCAC", 2000.0, 0)
    np.testing.assert_allclose([star.v_mag[0], star.b_v[0], star.v_sigma[0]], [12.3, 0.6, 0.02], rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "flags"),
    [
        ({"objt": 1}, StarQuality.BAD_PHOTOMETRY),
        ({"objt": 2}, StarQuality.BAD_ASTROMETRY),
        ({"objt": 3}, StarQuality.HIGH_PROPER_MOTION),
        ({"objt": 9}, StarQuality.HIGH_PROPER_MOTION | StarQuality.BAD_ASTROMETRY),
        ({"objt": 7}, StarQuality.SUPPLEMENT),
        ({"cdf": 35}, StarQuality.DOUBLE),
        ({"leda": 1}, StarQuality.EXTENDED),
        ({"x2m": 12}, StarQuality.EXTENDED),
        ({"nu1": 0}, StarQuality.BAD_ASTROMETRY),
    ],
)
def test_ucac4_flags(tmp_path, changes, flags) -> None:
    star = only_star(tmp_path, ucac4_record(**changes))
    assert star.flags[0] == flags
    catalog = open_catalog(f"ucac4:{tmp_path / 'ucac4'}")
    assert len(catalog.cone(*HERE, 0.001, exclude_flags=flags)) == 0
    assert len(catalog.cone(*HERE, 0.001, exclude_flags=~flags)) == 1


def test_ucac4_star_without_motion_stands_at_its_epoch_of_observation(tmp_path) -> None:
    star = only_star(
        tmp_path, ucac4_record(pmrac=0, pmdc=0, sigpmr=127, sigpmd=127, cepra=10_010, cepdc=10_030)
    )
    assert not star.motion_known[0]
    assert star.epoch_jyear[0] == pytest.approx(2000.2)
    np.testing.assert_allclose(star.sigma[0, :2] / MAS, [20.0, 30.0], rtol=1e-12)
    np.testing.assert_allclose(star.sigma[0, 3:] / MAS, UNKNOWN_MOTION_MAS_YR, rtol=1e-12)


@pytest.mark.parametrize(("code", "sigma"), [(250, 25.0), (251, 27.5), (252, 32.5), (253, 37.5), (254, 45.0)])
def test_ucac4_large_motion_sigmas_are_coded(tmp_path, code, sigma) -> None:
    star = only_star(tmp_path, ucac4_record(sigpmr=code - 128))
    assert star.sigma[0, 3] / MAS == pytest.approx(sigma)


def test_ucac4_fastest_stars_are_in_a_file_of_their_own(tmp_path) -> None:
    # A line as in the real u4hpm.dat: unique number, zone, record, motions in 0.1 mas/yr, RA, SPD, magnitude.
    table = "  113038183 494  48937   10990  -51230  442763714  355581607 12513\n"
    fast = ucac4_record(pmrac=32_767, pmdc=32_767, objt=4)
    star = only_star(tmp_path, fast, beside=[("u4hpm.dat", table)])
    np.testing.assert_allclose(
        [star.pmra_rad_yr[0] / MAS, star.pmdec_rad_yr[0] / MAS], [1099.0, -5123.0], rtol=1e-12
    )
    assert star.motion_known[0]
    (tmp_path / "ucac4" / "u4hpm.dat").unlink()
    assert not only_star(tmp_path, fast).motion_known[0]
    with pytest.raises(CatalogError, match=r"u4hpm.dat is not the file of high motions"):
        only_star(tmp_path, fast, beside=[("u4hpm.dat", "hello world\n")])


def test_ucac4_magnitudes_that_are_missing(tmp_path) -> None:
    none = (20_000,) * 5
    star = only_star(tmp_path, ucac4_record(maga=20_000))
    assert (star.mag[0], star.band[0], star.flags[0]) == (12.1, "UCAC", StarQuality.BAD_PHOTOMETRY)
    star = only_star(tmp_path, ucac4_record(maga=20_000, magm=20_000))
    assert (star.mag[0], star.band[0]) == (12.3, "V")
    star = only_star(tmp_path, ucac4_record(maga=20_000, magm=20_000, apasm=none, apase=(99,) * 5))
    assert (star.mag[0], star.band[0]) == (10.9, "J")
    assert star.b_v[0] == pytest.approx(0.05 + 1.55 * 0.4)
    star = only_star(tmp_path, ucac4_record(apasm=none, apase=(99,) * 5))  # from UCAC and J-K
    assert star.v_mag[0] == pytest.approx(12.0 + 0.556 * (0.0313 + 0.8567 * 0.4))
    assert star.v_sigma[0] > 0.1
    # An error of 0 marks Tycho magnitudes: BT 12.9, VT 12.3.
    star = only_star(tmp_path, ucac4_record(apase=(0, 0, 2, 2, 2)))
    assert star.v_mag[0] == pytest.approx(12.3 + 9.7e-4 - 0.1334 * 0.6 + 0.05486 * 0.36 - 0.01998 * 0.216)


# ---------- UCAC2


def ucac2_record(**changes) -> bytes:
    fields = {
        "ra": 720_000_000, "dec": -900_000, "mag": 1484, "e_ra": 18 - 127, "e_dec": 15 - 127, "nobs": 3, "e_pos": 15 - 127,
        "ncat": 4, "cflg": 0, "epra": 27_104, "epdec": 27_340, "pmra": 450, "pmdec": -29, "e_pmra": 58 - 127,
        "e_pmdec": 59 - 127, "q_pmra": 20 - 127, "q_pmdec": 20 - 127, "id": 931_184_455, "j": 13_796, "h": 13_403,
        "k": 13_327, "ph": 0, "cc": 0,
    }  # fmt: skip
    return struct.pack(UCAC2_STRUCT, *{**fields, **changes}.values())


def test_ucac2_fields_come_out_in_their_units(tmp_path) -> None:
    assert UCAC2_RECORD.itemsize == struct.calcsize(UCAC2_STRUCT) == 44
    folder = tmp_path / "u2"
    folder.mkdir()
    dec_mas = 50 * 3_600_000 + 900_000
    (folder / "z281").write_bytes(ucac2_record(dec=dec_mas))
    star = open_catalog(f"ucac2:{tmp_path}").cone(*np.radians([200.0, 50.25]), 0.001)
    assert list(star.id) == ["UCAC2-281-000001"]
    np.testing.assert_allclose(
        [star.ra_rad[0] / MAS, star.dec_rad[0] / MAS], [720_000_000, dec_mas], rtol=1e-12
    )
    # The catalog's motion lacks cos(dec); its sigmas have it.
    expected = [45.0 * math.cos(math.radians(50.25)), -2.9]
    np.testing.assert_allclose([star.pmra_rad_yr[0] / MAS, star.pmdec_rad_yr[0] / MAS], expected, rtol=1e-12)
    np.testing.assert_allclose(star.sigma[0, 3:] / MAS, [5.8, 5.9], rtol=1e-12)
    for axis, (epoch, sigma) in enumerate(((2002.104, 18.0), (2002.340, 15.0))):
        at_mean = star.sky_covariance(float(et_from_jyear(epoch)))[0, axis, axis]
        assert math.sqrt(at_mean) / MAS == pytest.approx(sigma, rel=1e-5)
    assert (star.mag[0], star.band[0], star.flags[0]) == (14.84, "UCAC", 0)
    assert star.b_v[0] == pytest.approx(0.05 + 1.55 * (13.796 - 13.327))


def test_ucac2_without_2mass_and_with_a_poor_motion(tmp_path) -> None:
    (tmp_path / "z180").write_bytes(ucac2_record(j=30_000, h=30_000, k=30_000, id=0, q_pmra=121 - 127))
    star = open_catalog(f"ucac2:{tmp_path}").cone(*SOUTH, 0.001)
    assert np.isnan(star.b_v[0])
    assert star.v_mag[0] == pytest.approx(14.84 + 0.27)
    assert star.flags[0] == StarQuality.BAD_ASTROMETRY


def test_ucac2_ends_in_the_north(tmp_path) -> None:
    (tmp_path / "z180").write_bytes(ucac2_record())
    assert len(open_catalog(f"ucac2:{tmp_path}").cone(1.0, math.radians(60.0), 0.001)) == 0


# ---------- poles, index files and errors


def zone_records(zone: int, ra, spd) -> bytes:
    stars = np.zeros(len(ra), dtype=UCAC4_RECORD)
    stars["ra"], stars["spd"], stars["maga"], stars["na1"], stars["nu1"] = np.sort(ra), spd, 12_000, 1, 1
    return stars.tobytes()


@pytest.mark.parametrize("dec_deg", [-90.0, -89.9, 90.0, 89.85])
def test_cones_over_the_poles_equal_brute_force(tmp_path, dec_deg) -> None:
    rng = np.random.default_rng(90)
    places = {}
    for zone in (1, 2, 899, 900):
        ra, spd = (
            np.sort(rng.integers(0, 1_296_000_000, 300)),
            rng.integers((zone - 1) * 720_000, zone * 720_000, 300),
        )
        (tmp_path / f"z{zone:03d}").write_bytes(zone_records(zone, ra, spd))
        for number, (a, s) in enumerate(zip(ra, spd, strict=True), 1):
            places[f"UCAC4-{zone:03d}-{number:06d}"] = (a * MAS, s * MAS - 0.5 * math.pi)
    catalog, radius = open_catalog(f"ucac4:{tmp_path}"), math.radians(0.15)
    for ra_deg in (0.0, 123.0, 359.9):
        center = (math.radians(ra_deg), math.radians(dec_deg))
        expected = {name for name, place in places.items() if angular_separation(*center, *place) <= radius}
        assert set(catalog.cone(*center, radius).id) == expected
        assert len(expected) > 50


def test_an_index_tells_how_long_a_zone_must_be(tmp_path) -> None:
    (tmp_path / "u4b").mkdir()
    (tmp_path / "u4i").mkdir()
    counts = np.zeros((2, 1440, 900), dtype="<i4")  # n0 and nn, the zone running fastest
    counts[1, [3, 700], 450] = 2, 1
    counts.tofile(tmp_path / "u4i" / "u4index.unf")
    path = tmp_path / "u4b" / "z451"
    path.write_bytes(b"".join([ucac4_record()] * 3))
    spec = f"ucac4:{tmp_path}"
    assert len(open_catalog(spec).cone(*HERE, 0.001)) == 3
    assert len(open_catalog(f"{spec}/u4b").cone(*HERE, 0.001)) == 3
    path.write_bytes(ucac4_record())
    with pytest.raises(CatalogError, match=r"z451 has 1 of 3 records by the catalog's index"):
        open_catalog(spec).cone(*HERE, 0.001)


def test_ucac2_index(tmp_path) -> None:
    last = np.zeros((288, 240), dtype="<i4")
    last[179:, 100:], last[180:, :] = 2, 2
    last.tofile(tmp_path / "u2index.da")
    (tmp_path / "z180").write_bytes(ucac2_record() * 2)
    assert len(open_catalog(f"ucac2:{tmp_path}").cone(*SOUTH, 0.001)) == 2
    (tmp_path / "z180").write_bytes(ucac2_record())
    with pytest.raises(CatalogError, match=r"has 1 of 2 records"):
        open_catalog(f"ucac2:{tmp_path}").cone(*SOUTH, 0.001)


@pytest.mark.parametrize("kind", ["ucac2", "ucac4"])
def test_what_is_missing_or_damaged_gets_one_line_with_the_remedy(tmp_path, kind) -> None:
    zone, record = {"ucac2": (180, ucac2_record()), "ucac4": (451, ucac4_record())}[kind]
    folder = tmp_path / "zones"

    def complains(message: str, dec_deg: float = {"ucac2": -0.25, "ucac4": 0.1}[kind]) -> None:
        with pytest.raises(CatalogError, match=message) as caught:
            open_catalog(f"{kind}:{folder}").cone(
                math.radians(200.0), math.radians(dec_deg), math.radians(0.01)
            )
        assert "\n" not in str(caught.value)
        assert "copied in binary mode" in str(caught.value)

    complains("does not exist")
    folder.mkdir()
    complains("is empty")
    (folder / "readme").write_text("")
    complains("holds no zone file")
    path = folder / f"z{zone:03d}"
    path.write_bytes(record * 3)
    complains(r"the zone file z\d+ of UCAC\d is not in", dec_deg=-30.0)
    path.write_bytes((record * 3)[:-5])
    complains(rf"has {3 * len(record) - 5} bytes, not records of {len(record)}")
    path.write_bytes(b"")
    complains("has 0 bytes")
    big_endian = np.frombuffer(record * 3, dtype="u1").reshape(3, -1)
    swapped = big_endian.copy()
    swapped[:, :4], swapped[:, 4:8] = big_endian[:, 3::-1], big_endian[:, 7:3:-1]
    path.write_bytes(swapped.tobytes())
    complains("wrong byte order or another file")
