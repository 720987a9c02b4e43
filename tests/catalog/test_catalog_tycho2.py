"""Tycho-2 from its distribution: real rows of the catalog, in every way that the files are packed."""

import gzip
import math
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR, StarQuality, cds_text, open_catalog, tycho2
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import et_from_jyear

MAS = math.radians(1.0 / 3.6e6)
# Real rows of tyc2.dat and suppl_1.dat (CDS I/259).
FAINT, BRIGHT, DOUBLE, OBSERVED = (
    (
        "0001 00008 1| |  2.31750494|  2.23184345|  -16.3|   -9.0| 68| 73| 1.7| 1.8|1958.89|1951.94| 4|1.0|1.0|0.9|1.0|"
        "12.146|0.158|12.146|0.223|999| |         |  2.31754222|  2.23186444|1.67|1.54| 88.0|100.8| |-0.2"
    ),
    (
        "0001 00013 1| |  1.12558209|  2.26739400|   27.7|   -0.5|  9| 12| 1.2| 1.2|1990.76|1989.25| 8|1.0|0.8|1.0|0.7|"
        "10.488|0.038| 8.670|0.015|999|T|         |  1.12551889|  2.26739556|1.81|1.52|  9.3| 12.7| |-0.2"
    ),
    (
        "0005 01505 1| |  3.25200241|  2.94960582|   47.8|  -13.6|  8| 11| 1.0| 1.0|1990.57|1989.33|11|0.6|1.2|0.7|1.2|"
        " 9.275|0.020| 8.738|0.015|999|T|  1040AB |  3.25189250|  2.94963750|1.76|1.45|  8.2| 10.5|P|-0.2"
    ),
    (
        "0001 00033 1|X|            |            |       |       |   |   |    |    |       |       |  |   |   |   |   |"
        "12.512|0.228|      |     |  5|T|         |  1.58432611|  0.94286667|1.69|1.58|115.5|125.1| | 0.0"
    ),
)
ROWS = (FAINT, BRIGHT, DOUBLE, OBSERVED)
SUPPLEMENT = (
    "0002 01127 2|H|004.36837051|+00.31948829|  -32.1|   -9.1| 13.6|  8.3|  8.2|  5.0|H|      |     |10.279|0.041| 75"
    "| |  1397B"
)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "catalogs"


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "I_259"
    place.mkdir()
    return place


def content(*rows: str, end: str = "\n") -> bytes:
    return "".join(row + end for row in rows).encode()


def stars_of(folder):
    """The stars by name, of everything that the folder holds."""
    stars = open_catalog(f"tycho2:{folder}").cone(0.0, 0.0, math.pi)
    return {name: stars.take([row]) for row, name in enumerate(stars.id)}


def test_the_real_rows_say_what_is_printed_in_them(folder) -> None:
    (folder / "tyc2.dat").write_bytes(content(*ROWS))
    stars = stars_of(folder)
    assert set(stars) == {"TYC 1-8-1", "TYC 1-13-1", "TYC 5-1505-1", "TYC 1-33-1"}
    star = stars["TYC 1-13-1"]
    np.testing.assert_allclose(
        np.degrees([star.ra_rad[0], star.dec_rad[0]]), [1.12558209, 2.267394], rtol=1e-14
    )
    np.testing.assert_allclose(
        [star.pmra_rad_yr[0] / MAS, star.pmdec_rad_yr[0] / MAS], [27.7, -0.5], rtol=1e-6
    )
    np.testing.assert_allclose(star.sigma[0, 3:] / MAS, [1.2, 1.2], rtol=1e-6)
    assert (star.mag[0], star.band[0], star.epoch_jyear[0]) == (8.670, "VT", 2000.0)
    assert star.motion_known[0]
    assert star.flags[0] == 0
    # V = 8.49 and B-V = 1.52 by Mamajek et al. (2002) of BT-VT = 1.818
    assert star.v_mag[0] == pytest.approx(
        8.670 + 9.7e-4 - 0.1334 * 1.818 + 0.05486 * 1.818**2 - 0.01998 * 1.818**3, abs=1e-6
    )
    assert star.b_v[0] == pytest.approx(
        1.818 - 0.007813 * 1.818 - 0.1489 * 1.818**2 + 0.03384 * 1.818**3, abs=1e-6
    )
    assert stars["TYC 1-8-1"].mag[0] == 12.146


def test_sigma_is_that_of_the_row_at_its_mean_epochs_and_grows_from_there(folder) -> None:
    (folder / "tyc2.dat").write_bytes(content(FAINT))
    star = stars_of(folder)["TYC 1-8-1"]
    for axis, (epoch, place, motion) in enumerate(((1958.89, 68.0, 1.7), (1951.94, 73.0, 1.8))):
        for year in (epoch, 2000.0, 2015.5, 1940.0):
            sigma = math.sqrt(star.sky_covariance(float(et_from_jyear(year)))[0, axis, axis]) / MAS
            # parallax is unknown and not observed from the barycenter: it adds nothing
            assert sigma == pytest.approx(math.hypot(place, motion * (year - epoch)), rel=1e-4), (axis, year)


def test_doubles_and_hipparcos_numbers(folder) -> None:
    (folder / "tyc2.dat").write_bytes(content(*ROWS))
    stars = stars_of(folder)
    assert stars["TYC 5-1505-1"].hip[0] == 1040
    assert stars["TYC 5-1505-1"].flags[0] == StarQuality.DOUBLE  # AB of CCDM, photocenter of two
    assert stars["TYC 1-33-1"].hip[0] == 0
    assert StarQuality.DOUBLE in StarQuality(int(stars["TYC 1-33-1"].flags[0]))  # a neighbor at 0.5 arcsec
    sharp = open_catalog(f"tycho2:{folder}").cone(0.0, 0.0, math.pi, exclude_flags=StarQuality.DOUBLE)
    assert sorted(sharp.id) == ["TYC 1-13-1", "TYC 1-8-1"]


def test_a_row_without_mean_position_has_the_observed_one_at_its_epoch(folder) -> None:
    (folder / "tyc2.dat").write_bytes(content(OBSERVED))
    star = stars_of(folder)["TYC 1-33-1"]
    np.testing.assert_allclose(
        np.degrees([star.ra_rad[0], star.dec_rad[0]]), [1.58432611, 0.94286667], rtol=1e-14
    )
    assert star.epoch_jyear[0] == pytest.approx(1991.635)
    np.testing.assert_allclose(star.sigma[0, :2] / MAS, [115.5, 125.1], rtol=1e-3)
    np.testing.assert_allclose(star.sigma[0, 3:] / MAS, UNKNOWN_MOTION_MAS_YR, rtol=1e-6)
    assert not star.motion_known[0]
    assert StarQuality.NO_MEAN_POSITION in StarQuality(int(star.flags[0]))
    assert (star.band[0], star.mag[0]) == ("BT", 12.512)
    assert np.isnan(star.b_v[0])
    assert star.v_sigma[0] > 0.5  # of BT alone: the spread of star colors
    np.testing.assert_array_equal(star.position_motion, 0.0)


def test_the_supplement_has_its_own_columns_and_epoch(folder) -> None:
    without_motion = (
        SUPPLEMENT[:41] + "       |       |     |     |     |     | | 9.000|0.020| 8.500|0.030|999| |       "
    )
    assert len(without_motion) == len(SUPPLEMENT) == 122
    (folder / "tyc2.dat").write_bytes(content(BRIGHT))
    (folder / "suppl_1.dat").write_bytes(content(SUPPLEMENT, without_motion.replace("01127 2", "01128 1")))
    stars = stars_of(folder)
    star = stars["TYC 2-1127-2"]
    np.testing.assert_allclose(
        np.degrees([star.ra_rad[0], star.dec_rad[0]]), [4.36837051, 0.31948829], rtol=1e-14
    )
    np.testing.assert_allclose(star.sigma[0, [0, 1, 3, 4]] / MAS, [13.6, 8.3, 8.2, 5.0], rtol=1e-6)
    np.testing.assert_allclose(
        [star.pmra_rad_yr[0] / MAS, star.pmdec_rad_yr[0] / MAS], [-32.1, -9.1], rtol=1e-6
    )
    assert (star.epoch_jyear[0], star.mag[0], star.band[0], star.hip[0]) == (1991.25, 10.279, "Hp", 1397)
    assert star.flags[0] == StarQuality.SUPPLEMENT | StarQuality.DOUBLE
    other = stars["TYC 2-1128-1"]
    assert (other.mag[0], other.band[0], other.hip[0]) == (8.5, "VT", 0)
    assert not other.motion_known[0]
    assert other.flags[0] == StarQuality.SUPPLEMENT


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("split", [False, True])
def test_every_packing_gives_the_same_stars(folder, end: str, packed: bool, split: bool) -> None:
    parts = [content(row, end=end) for row in (ROWS * 5 if split else [])] or [content(*ROWS * 5, end=end)]
    for part, data in enumerate(parts):
        name = f"tyc2.dat.{part:02d}" if split else "tyc2.dat"
        (folder / (name + ".gz" if packed else name)).write_bytes(gzip.compress(data) if packed else data)
    stars = open_catalog(f"tycho2:{folder}").cone(0.0, 0.0, math.pi)
    assert len(stars) == 20
    assert sorted(set(stars.id)) == ["TYC 1-13-1", "TYC 1-33-1", "TYC 1-8-1", "TYC 5-1505-1"]
    np.testing.assert_array_equal(np.unique(stars.mag), [8.670, 8.738, 12.146, 12.512])


def test_a_last_row_without_line_end_counts(folder) -> None:
    (folder / "tyc2.dat").write_bytes(content(*ROWS)[:-1])
    assert len(stars_of(folder)) == 4


def test_rows_are_read_in_portions(folder, monkeypatch) -> None:
    from opnav_workbench.catalog import cds_text

    monkeypatch.setattr(cds_text, "ROWS_AT_ONCE", 3)
    for end in ("\n", "\r\n"):
        (folder / "tyc2.dat").write_bytes(content(*ROWS * 7, end=end))
        told: list[float] = []
        catalog = open_catalog(f"tycho2:{folder}", told.append)
        assert len(catalog.cone(0.0, 0.0, math.pi)) == 28
        assert len(told) > 5
        assert np.all(np.diff(told) >= 0.0)
        assert told[-1] == 1.0


def test_the_text_is_read_once_and_again_when_it_changes(folder, cache, monkeypatch) -> None:
    reads: list[int] = []
    real = cds_text.read_rows
    monkeypatch.setattr(tycho2, "read_rows", lambda *arguments: reads.append(1) or real(*arguments))
    file = folder / "tyc2.dat"
    file.write_bytes(content(*ROWS))
    first, second = stars_of(folder), stars_of(folder)
    assert len(reads) == 1
    assert first.keys() == second.keys()
    file.write_bytes(content(*ROWS[:3]))
    assert len(stars_of(folder)) == 3
    os.utime(file, ns=(1, 1))
    stars_of(folder)
    assert len(reads) == 3
    (only,) = cache.iterdir()  # one file a folder, no temporary one left
    only.write_bytes(only.read_bytes()[:-7])
    assert len(stars_of(folder)) == 3
    assert len(reads) == 4


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("tyc2.dat", b"", "is empty"),
        ("tyc2.dat", content(*ROWS)[:-60], "ends within a row"),
        ("tyc2.dat", content("0001 00008 1| |"), "first row of 15 characters, not 206"),
        ("tyc2.dat", content(FAINT, FAINT[:100], FAINT + "x" * 106), "not 206 characters long"),
        ("tyc2.dat", content(FAINT.replace("2.31750494", "2.3175x494")), "not in the layout of CDS I/259"),
        (
            "tyc2.dat.gz",
            gzip.compress(os.urandom(8) + content(*ROWS))[:-30],
            "first row|within its compressed",
        ),
        ("tyc2.dat.gz", gzip.compress(content(*ROWS))[:-12], "ends within its compressed data"),
        ("tyc2.dat.gz", content(*ROWS), "ends within its compressed data"),
        ("tyc2.dat.03", content(*ROWS), r"lacks tyc2.dat.00, .*tyc2.dat.19"),
        ("readme.txt", b"hello", "holds none of the files"),
    ],
)
def test_what_cannot_be_read_gets_one_line_with_the_remedy(folder, cache, name, data, message: str) -> None:
    (folder / name).write_bytes(data)
    with pytest.raises(CatalogError, match=message) as caught:
        open_catalog(f"tycho2:{folder}")
    assert "\n" not in str(caught.value)
    assert "CDS catalog I/259" in str(caught.value)
    assert not cache.exists() or not list(cache.iterdir())  # nothing half-written


def test_an_absent_and_an_empty_folder(folder, tmp_path) -> None:
    with pytest.raises(CatalogError, match=r"does not exist; give the folder"):
        open_catalog(f"tycho2:{tmp_path / 'gone'}")
    with pytest.raises(CatalogError, match="is empty; give the folder"):
        open_catalog(f"tycho2:{folder}")
    (tmp_path / "file").write_text("")
    with pytest.raises(CatalogError, match="is a file, not the folder"):
        open_catalog(f"tycho2:{tmp_path / 'file'}")


@given(st.integers(1, 9537), st.integers(1, 12121), st.integers(1, 4))
def test_names_come_back_from_the_number(tyc1: int, tyc2: int, tyc3: int) -> None:
    from opnav_workbench.catalog.cds_text import TextRows

    row = f"{tyc1:04d} {tyc2:05d} {tyc3}|"
    number = tycho2._number(TextRows(np.frombuffer(row.encode(), dtype=np.uint8)[None, :]))
    assert list(tycho2._tyc(number.tolist())) == [f"TYC {tyc1}-{tyc2}-{tyc3}"]
