"""Index files written here by the documented layout, in every type and byte order that it allows."""

import io

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR, catalog_contents, open_catalog
from opnav_workbench.catalog.proper_motion import mean_motion_rad_yr
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import angle_between, unit_from_radec

BLOCK_BYTES = 2880
MAS = np.pi / 180.0 / 3.6e6
TYPES = {
    "u32": ("u4", 2.0**31 - 0.5),
    "u16": ("u2", 2.0**15 - 0.5),
    "double": ("f8", 1.0),
    "float": ("f4", 1.0),
}


def raw_table(name: str, numbers: np.ndarray, row_bytes: int, cards=()) -> bytes:
    """A FITS table of one opaque column, as libkd writes its arrays; astropy would refuse such text."""
    content = numbers.tobytes()
    size = [("NAXIS1", row_bytes), ("NAXIS2", len(content) // row_bytes), ("PCOUNT", 0), ("GCOUNT", 1)]
    kind = [("TFIELDS", 1), ("TFORM1", f"{row_bytes}A"), ("TTYPE1", name)]
    header = fits.Header([("XTENSION", "BINTABLE"), ("BITPIX", 8), ("NAXIS", 2), *size, *kind, *cards])
    return header.tostring().encode() + content + bytes(-len(content) % BLOCK_BYTES)


def plain_hdus(*hdus) -> bytes:
    stream = io.BytesIO()
    fits.HDUList([*hdus]).writeto(stream)
    return stream.getvalue()


def plain_table(columns, cards=()) -> bytes:
    listed = [fits.Column(name, form, array=values) for name, (form, values) in columns.items()]
    hdu = fits.BinTableHDU.from_columns(listed)
    hdu.header.update(cards)
    return plain_hdus(fits.PrimaryHDU(), hdu)[BLOCK_BYTES:]


def write_index(path, ra, dec, columns, kind="u32", order="<", stated=True, limits=7):
    dtype, scale = TYPES[kind]
    xyz = unit_from_radec(ra, dec)
    if dtype[0] == "u":
        xyz = np.round((xyz + 1.0) * scale)
    data = xyz.astype(order + dtype)
    endian = "04:03:02:01" if order == "<" else "01:02:03:04"
    tree = [("AN_FILE", "SKDT"), ("ENDIAN", endian)] + ([("KDT_DATA", kind)] if stated else [])
    box = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, scale], dtype=order + "f8")[:limits]
    primary = fits.PrimaryHDU()
    primary.header["ENDIAN"] = endian
    parts = [
        plain_hdus(primary),
        raw_table("kdtree_header_stars", np.zeros(0), 1, tree),
        raw_table("kdtree_range_stars", box, 8),
        raw_table("kdtree_data_stars", data, 3 * data.dtype.itemsize),
        plain_table({"sweep": ("B", np.ones(len(ra), np.uint8))}),
        plain_table(columns, {"AN_FILE": "TAGALONG"}) if columns else b"",
    ]
    path.write_bytes(b"".join(parts))
    return path


def sky(n=200, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 2.0 * np.pi, n), np.arcsin(rng.uniform(-1.0, 1.0, n)), rng.uniform(5.0, 12.0, n)


def everything(spec):
    return open_catalog(f"astrometry-net:{spec}").cone(0.0, 0.0, np.pi)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "tolerance_mas"),
    # Half a step along each axis: 0.05 mas for 32 bits, 3.2 arcsec for 16; single precision has 6e-8.
    [("u32", 0.1), ("double", 1e-6), ("u16", 6000.0), ("float", 25.0)],
)
def test_star_tree_decodes_to_the_directions_written(tmp_path, kind, order, tolerance_mas) -> None:
    ra, dec, mag = sky()
    path = write_index(tmp_path / "index.fits", ra, dec, {"MAG_VT": ("E", mag)}, kind, order)
    stars = everything(path)
    rows = [int(name.removeprefix("row:")) for name in stars.id]
    assert sorted(rows) == list(range(len(ra)))
    apart = angle_between(unit_from_radec(stars.ra_rad, stars.dec_rad), unit_from_radec(ra[rows], dec[rows]))
    assert apart.max() / MAS < tolerance_mas
    np.testing.assert_array_equal(stars.mag, mag[rows].astype(np.float32))
    assert (np.diff(stars.mag) >= 0.0).all()
    # The sigma covers the step of the storage: rms of an even error within half a step.
    step = {"u32": 1.0 / (2.0**31 - 0.5), "u16": 1.0 / (2.0**15 - 0.5)}.get(kind, 0.0) / MAS
    np.testing.assert_allclose(stars.sigma[:, 0] / MAS, np.hypot(60.0, step / np.sqrt(12.0)), rtol=0.02)


@pytest.mark.parametrize("kind", ["u32", "u16", "double"])
def test_the_type_of_the_tree_follows_from_its_width_where_not_stated(tmp_path, kind: str) -> None:
    ra, dec, mag = sky(20)
    stars = everything(write_index(tmp_path / "i.fits", ra, dec, {"MAG_VT": ("E", mag)}, kind, stated=False))
    assert len(stars) == 20


def test_a_tycho_index_has_its_epoch_and_no_motions(tmp_path) -> None:
    ra, dec, mag = sky(5)
    path = write_index(tmp_path / "index.fits", ra, dec, {"MAG_BT": ("E", mag + 1), "MAG_VT": ("E", mag)})
    stars = everything(path)
    np.testing.assert_array_equal(stars.epoch_jyear, 2000.0)
    assert set(stars.band) == {"VT"}
    assert not stars.motion_known.any()
    np.testing.assert_allclose(stars.sigma[:, 3:] / MAS, UNKNOWN_MOTION_MAS_YR, rtol=1e-14)
    np.testing.assert_array_equal(everything(f"{path}?epoch=1991.5").epoch_jyear, 1991.5)


def test_a_gaia_index_brings_names_motions_and_epoch(tmp_path) -> None:
    # Columns of series 5000 and 5200 (README of series 5000); nan where Gaia has two parameters only.
    ra, dec, _ = sky(3)
    columns = {
        "source_id": ("K", np.array([5853498713190525696, 12, 0])),
        "phot_g_mean_mag": ("E", np.array([8.98, 9.5, 10.0])),
        "phot_bp_mean_mag": ("E", np.array([11.4, 9.9, 10.5])),
        "parallax": ("E", np.array([768.5, np.nan, 2.0])),
        "parallax_error": ("E", np.array([0.2, np.nan, 0.3])),
        "pmra": ("E", np.array([-3781.25, np.nan, 0.0])),
        "pmra_error": ("E", np.array([0.03125, np.nan, 0.0])),
        "pmdec": ("E", np.array([769.5, np.nan, 0.0])),
        "pmdec_error": ("E", np.array([0.0625, np.nan, 0.0])),
        "ref_epoch": ("E", np.full(3, 2015.5)),
    }
    path = write_index(tmp_path / "index-5200.fits", ra, dec, columns)
    stars = everything(path)
    assert list(stars.id) == ["Gaia DR2 5853498713190525696", "Gaia DR2 12", "row:2"]
    assert stars.motion_known.tolist() == [True, False, False]  # an error of zero is none
    mean = mean_motion_rad_yr(stars.ra_rad, stars.dec_rad, stars.mag)[1:, 0] / MAS
    np.testing.assert_allclose(stars.pmra_rad_yr / MAS, [-3781.25, *mean], rtol=1e-14)
    np.testing.assert_allclose(stars.sigma[:, 4] / MAS, [0.0625, 15.0, 15.0], rtol=1e-14)
    np.testing.assert_allclose(stars.parallax_rad / MAS, [768.5, 0.0, 2.0], rtol=1e-14)
    np.testing.assert_allclose(stars.sigma[:, 2] / MAS, [0.2, 6.8 * 10 ** (-0.15 * 2.5), 0.3], rtol=1e-6)
    np.testing.assert_array_equal(stars.epoch_jyear, 2015.5)
    assert set(stars.band) == {"G"}
    del columns["ref_epoch"]
    np.testing.assert_array_equal(everything(write_index(path, ra, dec, columns)).epoch_jyear, 2015.5)
    # A fast star is found where it stands at another epoch.
    catalog = open_catalog(f"astrometry-net:{path}?epoch=2016.0")
    north = 769.5 * MAS * 50.0
    east = -3781.25 * MAS * 50.0 / np.cos(dec[0])
    at_2066 = {"et_s": 66.0 * 365.25 * 86400.0}
    assert len(catalog.cone(ra[0] + east, dec[0] + north, 1e-5)) == 0
    found = catalog.cone(ra[0] + east, dec[0] + north, 1e-5, **at_2066)
    assert list(found.id) == ["Gaia DR3 5853498713190525696"]


def gaia_columns(ra, dec, mag):
    """The columns of series 5000 and 5200-HEAVY, as their README lists them."""
    n = len(ra)
    wide = {
        "source_id": ("K", np.arange(1, n + 1)),
        "ra": ("D", np.degrees(ra)),
        "dec": ("D", np.degrees(dec)),
    }
    narrow = {
        "phot_g_mean_mag": mag,
        "phot_bp_mean_mag": mag + 0.33,
        "phot_rp_mean_mag": mag - 0.49,
        "parallax": np.full(n, 2.0),
        "parallax_error": np.full(n, 0.25),
        "pmra": np.full(n, 8.0),
        "pmra_error": np.full(n, 0.5),
        "pmdec": np.full(n, -4.0),
        "pmdec_error": np.full(n, 0.125),
        "ref_epoch": np.full(n, 2015.5),
    }
    return {**wide, **{name: ("E", values) for name, values in narrow.items()}}


def test_a_heavy_gaia_index_has_exact_places_and_colors(tmp_path) -> None:
    ra, dec, mag = sky(300)
    stars = everything(
        write_index(tmp_path / "index-5200-00.fits", ra, dec, gaia_columns(ra, dec, mag), kind="u16")
    )
    row = np.array([int(name.removeprefix("Gaia DR2 ")) for name in stars.id]) - 1
    # The tree of 16 bits rounds to arcseconds; the columns do not, and the sigma is Gaia's own.
    apart = angle_between(unit_from_radec(stars.ra_rad, stars.dec_rad), unit_from_radec(ra[row], dec[row]))
    assert apart.max() / MAS < 1e-6
    np.testing.assert_allclose(stars.sigma[:, 0] / MAS, 0.1, rtol=1e-12)
    np.testing.assert_allclose(stars.pmra_rad_yr / MAS, 8.0)
    np.testing.assert_allclose(stars.sigma[:, 2] / MAS, 0.25)
    np.testing.assert_allclose(stars.v_mag - stars.mag, 0.15, atol=0.01)  # the color of the Sun
    np.testing.assert_allclose(stars.b_v, 0.65, atol=0.02)
    assert stars.motion_known.all()


def test_places_that_belong_to_other_stars_are_noticed(tmp_path) -> None:
    ra, dec, mag = sky(300)
    shifted = gaia_columns(np.roll(ra, 1), dec, mag)
    with pytest.raises(CatalogError, match="the columns ra and dec differ from the star tree"):
        everything(write_index(tmp_path / "i.fits", ra, dec, shifted))


def test_tycho_magnitudes_give_colors(tmp_path) -> None:
    ra, dec, mag = sky(5)
    columns = {"MAG_BT": ("E", mag + 1.0), "MAG_VT": ("E", mag)}
    stars = everything(write_index(tmp_path / "index.fits", ra, dec, columns))
    np.testing.assert_allclose(stars.v_mag - stars.mag, 9.7e-4 - 0.1334 + 0.05486 - 0.01998, atol=1e-6)
    assert np.isfinite(stars.b_v).all()
    plain = everything(write_index(tmp_path / "plain.fits", ra, dec, {"MAG_VT": ("E", mag)}))
    np.testing.assert_allclose(plain.v_mag - plain.mag, -0.09, atol=1e-6)
    assert np.isnan(plain.b_v).all()


def test_a_column_that_is_only_named_like_a_magnitude_will_do(tmp_path) -> None:
    ra, dec, mag = sky(4)
    stars = everything(write_index(tmp_path / "i.fits", ra, dec, {"id": ("J", mag), "J_MAG": ("E", mag)}))
    assert set(stars.band) == {"J_MAG"}


def test_stars_shared_by_files_count_once_and_stars_without_magnitude_not_at_all(tmp_path) -> None:
    ra, dec, mag = sky(60)
    mag[3] = np.nan
    for name, part in (("index-00.fits", slice(0, 40)), ("index-01.fits", slice(20, 60))):
        write_index(tmp_path / name, ra[part], dec[part], {"MAG_VT": ("E", mag[part])})
    stars = everything(tmp_path / "index-*.fits")
    assert len(stars) == 59
    np.testing.assert_array_equal(stars.mag, np.sort(np.delete(mag, 3)).astype(np.float32))


def test_what_cannot_be_used_gets_one_clear_line(tmp_path) -> None:
    ra, dec, mag = sky(2000)
    path = write_index(tmp_path / "index.fits", ra, dec, {"MAG_VT": ("E", mag)})

    def complains(spec, message: str) -> None:
        with pytest.raises(CatalogError, match=message) as caught:
            open_catalog(f"astrometry-net:{spec}")
        assert "\n" not in str(caught.value)

    complains(tmp_path / "none-*.fits", "no file matches")
    complains(f"{path}?epok=2000", "unknown option")
    complains(f"{path}?epoch=soon", "unknown option")
    (tmp_path / "text.fits").write_text("hello")
    complains(tmp_path / "text.fits", "not a whole Astrometry.net index file")
    complains(tmp_path, "not a whole Astrometry.net index file")
    (tmp_path / "short.fits").write_bytes(path.read_bytes()[:20_000])
    complains(tmp_path / "short.fits", "not a whole Astrometry.net index file")
    fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / "picture.fits")
    complains(tmp_path / "picture.fits", "kdtree_data_stars")
    complains(write_index(tmp_path / "lite.fits", ra, dec, {}), "tells no magnitudes.*none.*5200-LITE")
    complains(write_index(tmp_path / "ids.fits", ra, dec, {"n": ("J", mag)}), r"tells no magnitudes.*: n\)")
    complains(write_index(tmp_path / "tag.fits", ra, dec, {"MAG": ("E", mag[:9])}), "2000 stars but 9 magn")
    complains(
        write_index(tmp_path / "nan.fits", ra, dec, {"MAG": ("E", mag * np.nan)}), "no star with a magn"
    )
    columns = {"MAG_VT": ("E", mag)}
    complains(write_index(tmp_path / "box.fits", ra, dec, columns, limits=6), "holds 6 numbers, not 7")
    bad_scale = write_index(tmp_path / "scale.fits", ra, dec, columns)
    whole = np.float64(2.0**31 - 0.5).tobytes()
    bad_scale.write_bytes(bad_scale.read_bytes().replace(whole, np.float64(1e9).tobytes()))
    complains(bad_scale, "star vectors have lengths")


@pytest.mark.slow
def test_bundled_has_debians_tycho2_kept_in_our_layout(tmp_path, monkeypatch) -> None:
    folder = tmp_path / "astrometry"
    folder.mkdir()
    ra, dec = np.radians([10.0, 10.02, 200.0]), np.radians([-5.0, -5.01, 40.0])
    mag = np.array([11.2, 11.9, 12.3], np.float32)
    columns = {"MAG_VT": ("E", mag), "MAG_BT": ("E", mag + 1.0)}
    write_index(folder / "index-tycho2-07.littleendian.fits", ra, dec, columns)
    monkeypatch.setenv("OPNAV_ASTROMETRY", str(folder))
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    alone = open_catalog(f"astrometry-net:{folder}/*.fits")
    for _ in range(2):  # made, then from the cache
        bundled = open_catalog("bundled")
        found = bundled.cone(ra[0], dec[0], np.radians(0.05))
        faint = found.take(np.flatnonzero(found.mag > 11.0))
        expected = alone.cone(ra[0], dec[0], np.radians(0.05))
        assert set(expected.id) <= set(faint.id)
        kept = faint.take(np.flatnonzero(np.isin(faint.id, expected.id)))
        for name in ("id", "ra_rad", "dec_rad", "mag", "band", "epoch_jyear", "motion_known"):
            np.testing.assert_array_equal(getattr(kept, name), getattr(expected, name))
        np.testing.assert_allclose(kept.sigma, expected.sigma, rtol=1e-6)
    assert "bundled: index-tycho2-07.littleendian.fits" in [name for name, _ in catalog_contents("bundled")]
