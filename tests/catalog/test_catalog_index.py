"""Polygon search and the memory-mapped cache, against looking at every star."""

import json
import math
import os
import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from opnav_workbench.catalog import StarQuality
from opnav_workbench.catalog import cache as cache_files
from opnav_workbench.catalog.cache import HEADER_BYTES, RecordStore, cache_path, cached_stars, star_records
from opnav_workbench.catalog.region import Cone, polygon_region
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import angle_between, et_from_jyear, tangent_basis, unit_from_radec

MAS = math.radians(1.0 / 3.6e6)
N_STARS = 20_000


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def sky_records(n=N_STARS, seed=4):
    rng = np.random.default_rng(seed)
    dec = np.arcsin(rng.uniform(-1.0, 1.0, n))
    dec[: n // 5] = 0.5 * math.pi - np.abs(
        rng.normal(0.0, 0.02, n // 5)
    )  # many more where coordinates are singular
    dec[n // 10 : n // 5] *= -1.0
    ra = rng.uniform(0.0, 2.0 * math.pi, n)
    ra[n // 2 : n // 2 + n // 10] = rng.normal(0.0, 0.02, n // 10) % (2.0 * math.pi)
    return star_records(
        n,
        number=np.arange(n),
        ra_rad=ra,
        dec_rad=dec,
        epoch_jyear=2000.0,
        mag=np.round(rng.uniform(2.0, 12.0, n), 1),
        pmra_rad_yr=rng.normal(0.0, 1000.0 * MAS, n),
        pmdec_rad_yr=rng.normal(0.0, 1000.0 * MAS, n),
        flags=rng.integers(0, 4, n),
        motion_known=True,
    )


def open_cached(records, name="test", identity=None):
    stars = cached_stars(cache_path(name), identity or {}, lambda: records)
    store = RecordStore(
        stars.records, stars.keys, ["V"], lambda part: [f"{n}" for n in part["number"]], stars.limits
    )
    return StoredCatalog(
        "test", {}, store, MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear)
    )


def brute_force(records, corners) -> set[str]:
    """A star is inside where, seen from it, the corners turn once round: the angles between them add up to a circle."""
    stars = unit_from_radec(records["ra_rad"], records["dec_rad"])
    east, north = tangent_basis(records["ra_rad"], records["dec_rad"])
    bearing = np.stack([np.arctan2(north @ c, east @ c) for c in corners])
    turns = np.diff(np.append(bearing, bearing[:1], axis=0), axis=0)
    turned = np.sum((turns + math.pi) % (2.0 * math.pi) - math.pi, axis=0)
    same_side = stars @ np.mean(corners, axis=0) > 0.0  # a turn about the antipode does not count
    return {str(n) for n in records["number"][(np.abs(turned) > math.pi) & same_side]}


def footprint(ra_deg, dec_deg, half_deg, roll_deg=0.0, aspect=1.0):
    """Corners of a detector whose sides span twice `half_deg`."""
    ra, dec, half, roll = np.radians([ra_deg, dec_deg, half_deg, roll_deg])
    east, north = tangent_basis(ra, dec)
    x = math.cos(roll) * east + math.sin(roll) * north
    y = math.cos(roll) * north - math.sin(roll) * east
    size = math.tan(half)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.stack([unit_from_radec(ra, dec) + size * (a * x + aspect * b * y) for a, b in signs])


@pytest.mark.parametrize("turned_round", [False, True])
@pytest.mark.parametrize(
    ("ra", "dec", "half", "roll"),
    [
        (0.0, 0.0, 2.0, 0.0),
        (359.9, 20.0, 3.0, 30.0),
        (120.0, 90.0, 2.0, 10.0),
        (0.0, -89.5, 1.5, 70.0),
        (200.0, 88.9, 1.0, 45.0),
        (80.0, -60.0, 10.0, 5.0),
        (300.0, 30.0, 40.0, 20.0),
    ],
)
def test_a_polygon_equals_brute_force(ra, dec, half, roll, turned_round) -> None:
    records = sky_records()
    corners = footprint(ra, dec, half, roll, aspect=0.7)
    found = open_cached(records).polygon(corners[::-1] if turned_round else corners)
    expected = brute_force(records, corners)
    assert len(expected) > 5
    assert set(found.id) == expected
    assert (np.diff(found.mag) >= 0.0).all()


@pytest.fixture(scope="module")
def hypothesis_catalog(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPNAV_CACHE", str(tmp_path_factory.mktemp("cache")))
        records = sky_records(4000, seed=5)
        yield records, open_cached(records)


angles = st.lists(st.floats(0.0, 2.0 * math.pi), min_size=3, max_size=7, unique_by=lambda a: round(a, 2))


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    ra=st.floats(0.0, 360.0) | st.sampled_from([0.0, 360.0]),
    dec=st.floats(-90.0, 90.0) | st.sampled_from([-90.0, 90.0]),
    half=st.floats(0.5, 50.0),
    bearings=angles,
    limit=st.floats(3.0, 12.0),
)
def test_any_convex_polygon_equals_brute_force(hypothesis_catalog, ra, dec, half, bearings, limit) -> None:
    records, catalog = hypothesis_catalog
    order = np.sort(bearings)
    gaps = np.diff(np.append(order, order[0] + 2.0 * math.pi))
    assume(
        gaps.max() < 0.95 * math.pi and gaps.min() > 0.05
    )  # else the center is outside, or two corners are one
    center, (east, north) = unit_from_radec(*np.radians([ra, dec])), tangent_basis(*np.radians([ra, dec]))
    size = math.tan(math.radians(half))
    corners = np.stack([center + size * (math.cos(a) * east + math.sin(a) * north) for a in order])
    found = catalog.polygon(corners, limit)
    names = brute_force(records, corners)
    expected = {str(n) for n in records["number"][records["mag"] <= limit]} & names
    assert set(found.id) == expected


@settings(max_examples=100, deadline=None)
@given(
    ra=st.floats(-7.0, 7.0),
    dec=st.floats(-0.5 * math.pi, 0.5 * math.pi),
    radius=st.floats(0.0, math.pi) | st.floats(0.0, 0.05),
)
def test_a_cone_of_mapped_records_equals_brute_force(hypothesis_catalog, ra, dec, radius) -> None:
    records, catalog = hypothesis_catalog
    apart = angle_between(unit_from_radec(records["ra_rad"], records["dec_rad"]), unit_from_radec(ra, dec))
    found = {int(name) for name in catalog.cone(ra, dec, radius).id}
    assert (
        set(np.flatnonzero(apart <= radius - 1e-12)) <= found <= set(np.flatnonzero(apart <= radius + 1e-12))
    )


@pytest.mark.parametrize("radius", [1e-9, 1e-6, 1e-3, 0.5 * math.pi, 3.0, math.pi - 1e-9, math.pi])
def test_the_edge_of_a_cone_is_where_its_angle_is(radius) -> None:
    cone = Cone.about(1.0, 0.3, radius)
    east, _ = tangent_basis(1.0, 0.3)
    steps = (
        radius * np.array([1.0 - 1e-6, 1.0 + 1e-6])
        if radius < 3.0
        else np.array([radius - 1e-9, radius + 1e-9])
    )
    places = np.cos(steps)[:, None] * cone.center + np.sin(steps)[:, None] * east
    expected = [True, radius > math.pi - 1e-9]  # past the antipode one comes back
    assert cone.contains(places).tolist() == expected


def test_a_polygon_at_an_epoch_holds_what_has_moved_into_it() -> None:
    records, et = sky_records(), float(et_from_jyear(2100.0))
    catalog, corners = open_cached(records), footprint(10.0, 89.4, 0.4)
    every = catalog.cone(0.0, 0.0, math.pi)
    moved = every.take(polygon_region(corners).contains(every.directions(et)))
    assert list(catalog.polygon(corners, et_s=et).id) == list(moved.id)
    assert set(moved.id) != set(catalog.polygon(corners).id)


def test_excluded_flags() -> None:
    records = sky_records()
    catalog = open_cached(records)
    for flags in (StarQuality.DOUBLE, StarQuality.DOUBLE | StarQuality.BAD_ASTROMETRY):
        kept = catalog.cone(0.0, 0.0, math.pi, exclude_flags=flags)
        np.testing.assert_array_equal(
            np.sort([int(n) for n in kept.id]), np.flatnonzero((records["flags"] & int(flags)) == 0)
        )


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (np.eye(3)[:2], r"shape \(2, 3\); give \(m, 3\)"),
        (np.ones((4, 2)), r"shape \(4, 2\)"),
        ([[1, 0, 0], [0, 0, 0], [0, 1, 0]], "no direction"),
        ([[1, 0, 0], [math.nan, 0, 0], [0, 1, 0]], "no direction"),
        ([[1, 0, 0], [1, 0, 0], [0, 1, 0]], "coincide or are opposite"),
        (
            [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]],
            "coincide or are opposite|smaller than a hemisphere",
        ),
        (footprint(10.0, 0.0, 2.0)[[0, 2, 1, 3]], "not those of a convex polygon"),  # a bow tie
        (
            np.concatenate([footprint(10.0, 0.0, 2.0)[:3], unit_from_radec(*np.radians([[11.0], [-1.0]]))]),
            "not those of a convex",
        ),
        (
            np.concatenate([np.eye(3) - 0.4, [[-1.0, -1.0, -1.2]]]),
            "convex polygon smaller than a hemisphere|coincide",
        ),
    ],
)
def test_what_is_no_polygon_is_refused(corners, message: str) -> None:
    with pytest.raises(CatalogError, match=message):
        open_cached(sky_records(100)).polygon(corners)


# ---------- the cache file


def test_columns_come_back_from_the_file_as_they_went_in() -> None:
    records = sky_records(500)
    rng = np.random.default_rng(6)
    for name in ("sigma", "position_motion", "v_mag", "v_sigma", "b_v", "b_v_sigma", "parallax_rad"):
        records[name] = rng.uniform(0.0, 1.0, records[name].shape)
    records["hip"], records["band"] = rng.integers(0, 120_000, 500), 0
    stars = open_cached(records).cone(0.0, 0.0, math.pi)
    row = np.array([int(name) for name in stars.id])
    for name in (
        "ra_rad",
        "dec_rad",
        "mag",
        "sigma",
        "position_motion",
        "v_mag",
        "b_v_sigma",
        "hip",
        "flags",
        "parallax_rad",
    ):
        np.testing.assert_array_equal(getattr(stars, name), records[name][row])


def test_a_file_is_used_only_while_its_identity_holds() -> None:
    builds: list[int] = []

    def build(seed):
        builds.append(seed)
        return sky_records(50, seed)

    path = cache_path("test")
    for seed, version in ((1, "a"), (2, "a"), (3, "b"), (4, "b")):
        cached_stars(path, {"version": version}, lambda seed=seed: build(seed))
    assert builds == [1, 3]
    assert [file.name for file in path.parent.iterdir()] == ["test.stars"]


@pytest.mark.parametrize("place", [3, 20, HEADER_BYTES + 100, -1])
def test_a_single_wrong_byte_is_noticed(place) -> None:
    path, builds = cache_path("test"), []
    cached_stars(path, {}, lambda: sky_records(50))
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(bytes(content))
    again = cached_stars(path, {}, lambda: builds.append(1) or sky_records(50))
    assert len(builds) == 1
    np.testing.assert_array_equal(np.sort(again.records["number"]), np.arange(50))


def test_a_block_of_a_large_file_is_checked_before_its_stars_are_used(monkeypatch) -> None:
    monkeypatch.setattr(cache_files, "WHOLE_BYTES", 0)
    monkeypatch.setattr(cache_files, "BLOCK_RECORDS", 64)
    path = cache_path("test")

    def opened():
        stars = cached_stars(path, {}, lambda: sky_records(1000))
        store = RecordStore(
            stars.records, stars.keys, ["V"], lambda r: r["number"], stars.limits, stars.checks
        )
        return store, stars.records["ra_rad"][[5, -5]], stars.records["dec_rad"][[5, -5]]

    store, ra, dec = opened()
    assert len(store.near(ra[0], dec[0], 1e-3).rows) > 0
    times = path.stat()
    content = bytearray(path.read_bytes())
    content[-300] ^= 1  # in the last block, with the file's times as they were
    with path.open("r+b") as stream:
        stream.write(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    store, ra, dec = opened()
    assert len(store.near(ra[0], dec[0], 1e-3).rows) > 0
    with pytest.raises(CatalogError, match=r"damaged on the disk.*Run the same command again"):
        store.near(ra[1], dec[1], 1e-3)
    store, ra, dec = opened()  # made anew
    assert len(store.near(ra[1], dec[1], 1e-3).rows) > 0
    content = bytearray(path.read_bytes())
    content[HEADER_BYTES + 20] ^= 1  # of the keys
    path.write_bytes(content)
    store, ra, dec = opened()
    assert len(store.near(ra[1], dec[1], 1e-3).rows) > 0


def test_the_header_says_what_the_file_is() -> None:
    path = cache_path("test")
    cached_stars(path, {"version": "a"}, lambda: sky_records(50))
    with path.open("rb") as stream:
        magic, text = stream.read(8), stream.read(HEADER_BYTES - 8)[8:].rstrip(b"\0")
    header = json.loads(text)
    assert magic == b"OPNAVSTR"
    assert header["identity"]["version"] == "a"
    assert header["n"] == 50


@pytest.mark.slow
def test_memory_stays_flat_over_a_mapped_file() -> None:
    records = sky_records(300_000)  # a file of 35 MB
    catalog = open_cached(records)
    del records
    tracemalloc.start()
    try:
        for ra in np.linspace(0.0, 6.0, 40):
            catalog.cone(float(ra), 0.4, math.radians(0.3))
            open_cached(None)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 1e6
    assert peak < 20e6  # one portion of 8 MB is checksummed at a time
