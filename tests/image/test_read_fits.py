"""FITS pictures made here with astropy: what comes out, and one clear line for everything that is wrong."""

import gzip
import re
import warnings

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from opnav_workbench.errors import ImageError
from opnav_workbench.geometry.times import et_from_text
from opnav_workbench.image import KeywordMap, read_image

SHAPE = (12, 20)
KEYWORDS = KeywordMap(
    exposure_s="EXPTIME",
    et="SCET",
    utc="UTC",
    sclk="SCLK",
    quaternion=("QA", "QX", "QY", "QZ"),
    sun_position=("SX", "SY", "SZ"),
    sun_velocity=("SVX", "SVY", "SVZ"),
    target="TARGET",
    geometry_quality="SPCQUAL",
    error_extension="ERR",
    quality_extension="QUAL",
    quality_table="new_horizons_lorri",
    required={"INSTRU": "lor"},
)
ATTITUDE = Rotation.from_euler("ZYZ", [40.0, 70.0, -25.0], degrees=True)  # camera to J2000


def header(**changes: object) -> fits.Header:
    w, x, y, z = ATTITUDE.as_quat(scalar_first=True)
    values = {
        "INSTRU": "lor     ", "EXPTIME": 0.5, "SCET": 640822081.5339231, "UTC": "2020-04-22T10:06:52.348",
        "SCLK": "3/0449855929:36485", "QA": w, "QX": x, "QY": y, "QZ": z, "SX": 1.0e9, "SY": -2.0e9,
        "SZ": 3.0e8, "SVX": -5.0, "SVY": 11.0, "SVZ": 4.0, "TARGET": "PLUTO", "SPCQUAL": "PREDICT",
    }  # fmt: skip
    made = fits.Header()
    for keyword, value in (values | changes).items():
        if value is not None:
            made[keyword] = value
    return made


def picture() -> np.ndarray:
    return np.random.default_rng(3).normal(20.0, 2.0, SHAPE).astype(">f4")


def write(path, data=None, head=None, *extensions):
    primary = fits.PrimaryHDU(picture() if data is None else data, header() if head is None else head)
    fits.HDUList([primary, *extensions]).writeto(path)
    return path


def data_start(path, extension: int) -> int:
    with fits.open(path) as hdus:
        return hdus[extension].fileinfo()["datLoc"]


def error_of(path, keywords=KEYWORDS, **options) -> str:
    with pytest.raises(ImageError) as caught:
        read_image(path, keywords, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


class TestFrame:
    def test_pixels_are_native_float64_and_arrays_read_only(self, tmp_path):
        data = picture()
        frame = read_image(write(tmp_path / "a.fit", data), KEYWORDS)
        assert frame.image_dn.dtype == np.dtype("=f8")
        np.testing.assert_array_equal(frame.image_dn, data.astype(float))
        for array in (frame.image_dn, frame.bad, frame.saturated, frame.header_geometry.camera_from_j2000):
            assert not array.flags.writeable

    def test_header_is_plain_and_without_comments(self, tmp_path):
        head = header()
        head["HISTORY"] = "made by a test"
        head["COMMENT"] = "nothing"
        head["UNDEF"] = None
        head["FLAG"] = True
        frame = read_image(write(tmp_path / "a.fit", head=head), KEYWORDS)
        assert {type(v) for v in frame.header.values()} == {str, int, float, bool}
        assert not {"HISTORY", "COMMENT", "", "UNDEF"} & set(frame.header)
        assert frame.header["exptime"] == 0.5
        with pytest.raises(TypeError):
            frame.header["EXPTIME"] = 1.0

    def test_attitude_and_sun_vectors(self, tmp_path):
        geometry = read_image(write(tmp_path / "a.fit"), KEYWORDS).header_geometry
        np.testing.assert_allclose(geometry.camera_from_j2000, ATTITUDE.as_matrix().T, atol=1e-15)
        np.testing.assert_array_equal(geometry.spacecraft_from_sun_km, [-1.0e9, 2.0e9, -3.0e8])
        np.testing.assert_array_equal(geometry.spacecraft_velocity_km_s, [5.0, -11.0, -4.0])
        assert geometry.quality == "PREDICT"

    def test_quaternion_of_the_other_sense(self, tmp_path):
        other = KeywordMap(quaternion=KEYWORDS.quaternion, quaternion_sense="j2000_to_camera")
        geometry = read_image(write(tmp_path / "a.fit"), other).header_geometry
        np.testing.assert_allclose(geometry.camera_from_j2000, ATTITUDE.as_matrix(), atol=1e-15)

    @pytest.mark.parametrize(
        ("changes", "reason"),
        [({"QX": None}, "QA, QX, QY, QZ are not all"), ({"QA": 5.0}, "length"), ({"QA": -1e32}, "not all")],
    )
    def test_unusable_quaternion_is_a_message(self, tmp_path, changes, reason):
        frame = read_image(write(tmp_path / "a.fit", head=header(**changes)), KEYWORDS)
        assert (
            frame.header_geometry.camera_from_j2000 is None
        )  # where the spacecraft was is told all the same
        assert any(reason in m for m in frame.messages)

    def test_missing_sun_vector_leaves_the_attitude(self, tmp_path):
        geometry = read_image(write(tmp_path / "a.fit", head=header(SX=-1e32)), KEYWORDS).header_geometry
        assert geometry.spacecraft_from_sun_km is None
        assert geometry.spacecraft_velocity_km_s is not None

    def test_other_reference_system_is_noted(self, tmp_path):
        path = write(tmp_path / "a.fit", head=header(RADESYS="FK5"))
        assert any("FK5" in m for m in read_image(path, KEYWORDS).messages)
        path = write(tmp_path / "b.fit", head=header(RADESYS="ICRS"))
        assert not any("ICRS" in m for m in read_image(path, KEYWORDS).messages)

    @pytest.mark.parametrize(
        ("card", "said"), [({"BAYERPAT": "rggb "}, True), ({"BAYERPAT": ""}, False), ({}, False)]
    )
    def test_a_mosaic_of_color_filters_is_told(self, tmp_path, card, said):
        messages = read_image(write(tmp_path / "a.fit", head=header(**card)), KEYWORDS).messages
        assert any("BAYERPAT = RGGB" in m for m in messages) is said

    def test_card_that_breaks_the_standard_is_left_out(self, tmp_path):
        path = write(tmp_path / "a.fit", head=header(ODD="fine"))
        path.write_bytes(path.read_bytes().replace(b"ODD     = 'fine    '", b"ODD     = 'fine     "))
        frame = read_image(path, KEYWORDS)
        assert "ODD" not in frame.header
        assert any("ODD" in m for m in frame.messages)

    def test_dispatch_is_by_content_and_reads_gzip(self, tmp_path):
        plain = write(tmp_path / "picture.fit")
        odd = tmp_path / "picture.dat"
        odd.write_bytes(gzip.compress(plain.read_bytes()))
        np.testing.assert_array_equal(
            read_image(odd, KEYWORDS).image_dn, read_image(plain, KEYWORDS).image_dn
        )

    def test_picture_in_an_extension_keeps_the_primary_header(self, tmp_path):
        path = tmp_path / "a.fit"
        hdus = [
            fits.PrimaryHDU(header=header(EXPTIME=9.0)),
            fits.ImageHDU(picture(), header(EXPTIME=0.5, TARGET=None)),
        ]
        fits.HDUList(hdus).writeto(path)
        frame = read_image(path, KEYWORDS)
        assert (frame.exposure_s, frame.header["TARGET"]) == (0.5, "PLUTO")

    def test_compressed_picture(self, tmp_path):
        whole = np.rint(picture()).astype(np.int16)
        path = tmp_path / "a.fits"
        fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(whole, header())]).writeto(path)
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, whole)

    def test_a_cube_of_one_plane_is_a_picture(self, tmp_path):
        data = picture()
        np.testing.assert_array_equal(
            read_image(write(tmp_path / "a.fit", data[None]), KEYWORDS).image_dn, data
        )

    def test_missing_padding_is_a_message_only(self, tmp_path):
        path = write(tmp_path / "a.fit")
        start = data_start(path, 0)
        path.write_bytes(path.read_bytes()[: start + 4 * SHAPE[0] * SHAPE[1]])
        frame = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(frame.image_dn, picture())
        assert any("truncated" in m for m in frame.messages)


class TestMasks:
    def test_single_nan_pixels_are_bad_and_counted(self, tmp_path):
        data = picture()
        data[2, 3] = np.nan
        data[4, 5] = np.inf
        data[6, 7] = -1e32
        frame = read_image(write(tmp_path / "a.fit", data), KEYWORDS)
        assert np.argwhere(frame.bad).tolist() == [[2, 3], [4, 5], [6, 7]]
        assert np.all(np.isfinite(frame.image_dn))
        assert "3 pixels without a value masked" in frame.messages

    def test_error_and_quality_planes(self, tmp_path):
        quality = np.zeros(SHAPE, np.uint16)
        quality[0, :5], quality[3, 4], quality[5, 6] = 32, 16, 2
        error = np.full(SHAPE, 1.25, np.float32)
        error[7, 8], error[9, 10] = 0.0, np.nan
        path = write(
            tmp_path / "a.fit",
            None,
            None,
            fits.ImageHDU(error, name="ERR"),
            fits.ImageHDU(quality, name="QUAL"),
        )
        frame = read_image(path, KEYWORDS)
        assert np.argwhere(frame.bad).tolist() == [[0, 0], [0, 1], [0, 2], [0, 3], [0, 4], [5, 6]]
        assert np.argwhere(frame.saturated).tolist() == [[3, 4]]
        np.testing.assert_array_equal(frame.error_dn, np.full(SHAPE, 1.25))
        assert any("2 values not positive" in m for m in frame.messages)

    def test_absent_planes_are_messages(self, tmp_path):
        frame = read_image(write(tmp_path / "a.fit"), KEYWORDS)
        assert frame.error_dn is None
        assert sum("ERR" in m or "QUAL" in m for m in frame.messages) == 2

    def test_saturation_by_level_and_by_bits(self, tmp_path):
        data = np.full(SHAPE, 100.0, np.float32)
        data[1, 1], data[2, 2] = 3000.0, 4095.0
        path = write(tmp_path / "a.fit", data, header(NBITS=12))
        keywords = KeywordMap(bits="NBITS")
        assert np.argwhere(read_image(path, keywords).saturated).tolist() == [[2, 2]]
        both = read_image(path, keywords, saturation_dn=3000.0)
        assert np.argwhere(both.saturated).tolist() == [[1, 1], [2, 2]]
        assert not both.bad.any()
        again = both.with_saturated(np.zeros(SHAPE, bool))
        assert not again.saturated.any()
        with pytest.raises(ImageError, match="shape"):
            both.with_saturated(np.zeros((3, 3), bool))

    def test_dark_columns_and_housekeeping(self, tmp_path):
        keywords = KeywordMap(dark_columns={20: 4}, housekeeping_pixels=6)
        frame = read_image(write(tmp_path / "a.fit"), keywords)
        np.testing.assert_array_equal(frame.image_dn, picture()[:, :16])
        assert np.argwhere(frame.bad).tolist() == [[0, i] for i in range(6)]
        assert any("4 dark columns" in m for m in frame.messages)

    def test_empty_picture_is_a_message(self, tmp_path):
        frame = read_image(write(tmp_path / "a.fit", np.zeros(SHAPE, np.int16)), KEYWORDS)
        assert any("lost picture" in m for m in frame.messages)


class TestTime:
    def test_header_values_are_kept(self, tmp_path):
        frame = read_image(write(tmp_path / "a.fit"), KEYWORDS)
        assert (frame.et, frame.utc) == (640822081.5339231, "2020-04-22T10:06:52.348")
        assert frame.sclk == "3/0449855929:36485"
        assert frame.exposure_s == 0.5

    def test_each_follows_from_the_other(self, tmp_path):
        only_utc = read_image(write(tmp_path / "a.fit", head=header(SCET=None)), KEYWORDS)
        assert only_utc.et == pytest.approx(640822081.5339, abs=0.5e-3)  # the text ends at a millisecond
        only_et = read_image(write(tmp_path / "b.fit", head=header(UTC="N/A")), KEYWORDS)
        assert only_et.utc == "2020-04-22T10:06:52.348"

    def test_start_is_shifted_by_half_the_exposure(self, tmp_path):
        keywords = KeywordMap(
            exposure_s="EXPMS", exposure_scale=1e-3, et="SCET", utc="UTC", time_reference="start"
        )
        frame = read_image(write(tmp_path / "a.fit", head=header(EXPMS=3000)), keywords)
        assert frame.exposure_s == pytest.approx(3.0, abs=1e-12)
        assert frame.et == pytest.approx(640822081.5339231 + 1.5, abs=1e-6)
        assert frame.utc == "2020-04-22T10:06:53.848"

    def test_disagreement_is_a_message(self, tmp_path):
        frame = read_image(
            write(tmp_path / "a.fit", head=header(SCET=640822081.5339231 + 432000.0)), KEYWORDS
        )
        assert frame.utc == "2020-04-27T10:06:52.348"
        assert any("differ by +432000.000 s" in m for m in frame.messages)

    def test_clock_alone_leaves_et_open(self, tmp_path):
        frame = read_image(write(tmp_path / "a.fit", head=header(SCET=-999.0, UTC=None)), KEYWORDS)
        assert (frame.et, frame.utc) == (None, None)
        assert frame.sclk == "3/0449855929:36485"
        assert any("clock" in m for m in frame.messages)

    def test_no_keyword_known(self, tmp_path):
        frame = read_image(write(tmp_path / "a.fit"), KeywordMap())
        assert frame.et is None
        assert np.isnan(frame.exposure_s)


class TestFailures:
    def test_missing_file(self, tmp_path):
        assert "no such file" in error_of(tmp_path / "absent.fit")

    def test_folder(self, tmp_path):
        assert "folder" in error_of(tmp_path)

    def test_zero_bytes(self, tmp_path):
        path = tmp_path / "zero.fit"
        path.touch()
        assert "0 bytes" in error_of(path)

    def test_text_file(self, tmp_path):
        path = tmp_path / "text.fit"
        path.write_text("this is not a picture\n")
        assert re.search(r"not a FITS.*this is not a pict", error_of(path))

    @pytest.mark.parametrize("kept", [0, 1, 333, 4 * SHAPE[0] * SHAPE[1] - 1])
    def test_truncated_data_names_the_bytes(self, tmp_path, kept):
        path = write(tmp_path / "short.fit")
        start = data_start(path, 0)
        path.write_bytes(path.read_bytes()[: start + kept])
        assert f"truncated: the data section has {kept} of {4 * SHAPE[0] * SHAPE[1]} bytes" in error_of(path)

    def test_truncated_extension_is_named(self, tmp_path):
        path = write(tmp_path / "short.fit", None, None, fits.ImageHDU(picture(), name="ERR"))
        start = data_start(path, 1)
        path.write_bytes(path.read_bytes()[: start + 100])
        assert "extension 1 (ERR) has 100 of 960 bytes" in error_of(path)

    def test_truncated_header(self, tmp_path):
        path = write(tmp_path / "short.fit")
        path.write_bytes(path.read_bytes()[:1000])
        assert "damaged FITS" in error_of(path)

    def test_truncated_gzip(self, tmp_path):
        path = tmp_path / "a.fit.gz"
        path.write_bytes(gzip.compress(write(tmp_path / "a.fit").read_bytes())[:-50])
        assert "damaged gzip" in error_of(path)

    def test_no_picture(self, tmp_path):
        path = tmp_path / "table.fits"
        table = fits.BinTableHDU.from_columns([fits.Column("A", "E", array=np.arange(3.0))])
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(path)
        assert "no two-dimensional picture" in error_of(path)
        assert "no picture in a FITS extension 1" in error_of(path, KeywordMap(image_extension=1))
        assert "no picture in a FITS extension 'SCI'" in error_of(path, KeywordMap(image_extension="SCI"))

    def test_spectrum(self, tmp_path):
        assert "no two-dimensional picture" in error_of(
            write(tmp_path / "line.fits", np.zeros(30, np.float32))
        )

    def test_cube(self, tmp_path):
        assert "cube of 3 x 12 x 20" in error_of(write(tmp_path / "cube.fits", np.stack([picture()] * 3)))

    def test_nothing_finite(self, tmp_path):
        assert "no finite value" in error_of(write(tmp_path / "nan.fits", np.full(SHAPE, np.nan, np.float32)))

    def test_everything_flagged(self, tmp_path):
        quality = fits.ImageHDU(np.full(SHAPE, 32, np.int16), name="QUAL")
        assert "marked as bad" in error_of(write(tmp_path / "bad.fits", None, None, quality))

    def test_plane_of_another_size(self, tmp_path):
        quality = fits.ImageHDU(np.zeros((5, 5), np.int16), name="QUAL")
        assert "(5, 5)" in error_of(write(tmp_path / "odd.fits", None, None, quality))

    def test_another_mission(self, tmp_path):
        text = error_of(write(tmp_path / "mvic.fit", head=header(INSTRU="mvi")))
        assert "INSTRU = 'mvi'" in text
        assert "'lor'" in text
        assert "has no INSTRU" in error_of(write(tmp_path / "none.fit", head=header(INSTRU=None)))

    def test_one_of_several_instruments_is_enough(self, tmp_path):
        path = write(tmp_path / "a.fit", head=header(INSTRU="MVI"))
        read_image(path, KeywordMap(required={"INSTRU": ["lor", "mvi"]}))
        assert "'a' or 'b'" in error_of(path, KeywordMap(required={"INSTRU": ["a", "b"]}))

    def test_without_time(self, tmp_path):
        text = error_of(write(tmp_path / "a.fit", head=header(SCET=None, UTC=None, SCLK=None)))
        assert "SCET, UTC, SCLK" in text

    @pytest.mark.parametrize("utc", ["yesterday", "2020-04-22", "2020-13-41T00:00:00", "2020-400T01:02:03"])
    def test_unreadable_utc(self, tmp_path, utc):
        assert "no UTC" in error_of(write(tmp_path / "a.fit", head=header(SCET=None, UTC=utc)))

    def test_impossible_et(self, tmp_path):
        assert "no date" in error_of(write(tmp_path / "a.fit", head=header(SCET=1e300, UTC=None)))

    @pytest.mark.parametrize(
        ("value", "reason"),
        [
            (0.0, "not positive"),
            (-0.5, "not positive"),
            ("NaN", "not positive"),
            (None, "no exposure"),
            ("long", "no exposure"),
        ],
    )
    def test_bad_exposure(self, tmp_path, value, reason):
        text = error_of(write(tmp_path / "a.fit", head=header(EXPTIME=value)))
        assert reason in text
        assert "EXPTIME" in text

    def test_start_without_exposure(self, tmp_path):
        assert "start of the exposure" in error_of(
            write(tmp_path / "a.fit"), KeywordMap(et="SCET", time_reference="start")
        )

    def test_unreadable_file(self, tmp_path, monkeypatch):
        def refuse(path):
            raise PermissionError(13, "Permission denied", str(path))

        path = write(tmp_path / "a.fit")
        monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
        assert "Permission denied" in error_of(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(st.tuples(st.integers(10, 7000), st.integers(0, 255)), min_size=1, max_size=12),
    end=st.integers(100, 12000),
)
def test_damaged_bytes_give_a_frame_or_one_line(tmp_path, changes, end):
    """Whatever happens to a file, reading ends in a frame or an ImageError of one line, without warnings."""
    path = tmp_path / "fuzz.fit"
    quality = fits.ImageHDU(np.zeros(SHAPE, np.uint16), name="QUAL")
    fits.HDUList([fits.PrimaryHDU(picture(), header()), quality]).writeto(path, overwrite=True)
    data = bytearray(path.read_bytes()[:end])
    for place, value in changes:
        data[place % len(data)] = value
    path.write_bytes(bytes(data))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            outcome = read_image(path, KEYWORDS)
        except ImageError as error:
            outcome = str(error)
    if isinstance(outcome, str):
        assert "\n" not in outcome
    else:
        assert outcome.image_dn.shape == outcome.bad.shape
        assert np.all(np.isfinite(outcome.image_dn))


@pytest.mark.parametrize(
    ("scale", "early_s"), [("UTC", 0.0), ("TDB", 69.184), ("tt", 69.184), ("TAI", 37.0), ("TOPOCENT", None)]
)
def test_the_scale_of_fits_times(tmp_path, scale, early_s):
    """FITS 4.0, section 9.2: TIMESYS tells in which scale the words that begin with DATE are."""
    head = fits.Header({"EXPTIME": 2.0, "DATE-AVG": "2020-04-22T10:06:52.348", "TIMESYS": scale})
    path, keywords = write(tmp_path / "a.fit", head=head), KeywordMap(exposure_s="EXPTIME", utc="DATE-AVG")
    if early_s is None:
        with pytest.raises(ImageError, match="TIMESYS = 'TOPOCENT' is no scale of time"):
            read_image(path, keywords)
        return
    read = read_image(path, keywords)
    assert read.et == pytest.approx(et_from_text("2020-04-22T10:06:52.348") - early_s, abs=0.003)
    assert et_from_text(read.utc) == pytest.approx(read.et, abs=0.001)


def test_a_time_beyond_the_known_leap_seconds_is_said_once(tmp_path):
    """Missions that are planned for the 2030s; ERFA says it for each of its steps."""
    path = write(tmp_path / "a.fit", head=header(SCET=None, UTC="2061-07-28T12:00:00.000"))
    (said,) = (m for m in read_image(path, KEYWORDS).messages if "leap" in m or "dubious" in m)
    assert said.startswith("the time lies beyond the leap seconds")


@pytest.mark.parametrize("behind", [b"", b"more"], ids=["plain", "by astropy"])
def test_words_that_stand_twice(tmp_path, behind):
    """Of the same value they are as one; of two values, where the mission asks for the word, they contradict."""
    head = fits.Header({"EXPTIME": 2.0, "MORE": 1, "TWICE": 3.0})
    for keyword, value in (("EXPTIME", 5.0), ("MORE", 2), ("TWICE", 3.0)):
        head.append((keyword, value), end=True)
    path = write(tmp_path / "a.fit", head=head)
    path.write_bytes(path.read_bytes() + behind)
    read = read_image(path, KeywordMap(exposure_s="EXPTIME", quaternion=["TWICE", "A", "B", "C"]))
    assert read.exposure_s == 2.0
    said = "EXPTIME stands twice in the header, as 2.0 and 5.0; the first is used"
    assert read.contradictions == (said,)
