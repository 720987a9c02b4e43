"""VICAR and PDS3 pictures made here: pixels, labels, and one clear line for what is wrong."""

import numpy as np
import pytest
from astropy.io import fits
from picture_bytes import vicar_bytes

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, read_image

KEYWORDS = KeywordMap(
    exposure_s="EXPOSURE_DURATION", exposure_scale=1e-3, utc="START_TIME", time_reference="start"
)
PIXELS = np.random.default_rng(5).integers(0, 4000, (6, 9)).astype(np.int16)
LABEL = """PDS_VERSION_ID = PDS3
/* made for a test */
RECORD_TYPE    = FIXED_LENGTH
RECORD_BYTES   = {record}
^IMAGE         = {pointer}
MISSION_NAME   = "A TEST
                  OF LABELS"
FILTER_NAME    = ("CL1",
                  "IR3")
START_TIME     = 2000-02-25T05:16:12.656
EXPOSURE_DURATION = 90.00 <ms>
OBJECT         = IMAGE
  LINES        = {lines}
  LINE_SAMPLES = {samples}
  SAMPLE_TYPE  = {kind}
  SAMPLE_BITS  = {bits}
  {extra}
END_OBJECT     = IMAGE
END
"""


def label(pointer: object, *, record=64, lines=6, samples=9, kind="MSB_INTEGER", bits=16, extra="") -> bytes:
    text = LABEL.format(
        pointer=pointer, record=record, lines=lines, samples=samples, kind=kind, bits=bits, extra=extra
    )
    return text.replace("\n", "\r\n").encode()


def attached(path, content: bytes, **options) -> None:
    """Write a label of 16 records of 64 bytes, then the data."""
    path.write_bytes(label(17, **options).ljust(1024) + content)


def error_of(path, keywords=KEYWORDS) -> str:
    with pytest.raises(ImageError) as caught:
        read_image(path, keywords)
    assert "\n" not in str(caught.value)
    assert path.name.lower() in str(caught.value).lower()
    return str(caught.value)


def write_vicar(path, array, **items) -> None:
    path.write_bytes(vicar_bytes(array, **items))


class TestVicar:
    def test_picture_and_label(self, tmp_path):
        path = tmp_path / "a.img"
        write_vicar(
            path, PIXELS, EXPOSURE_DURATION=1200.0, START_TIME="2005-068T04:09:08.968Z", FILTERS=["A", "B"]
        )
        frame = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(frame.image_dn, PIXELS)
        assert frame.exposure_s == pytest.approx(1.2, abs=1e-12)
        assert frame.utc == "2005-03-09T04:09:09.568"
        assert frame.header["FILTERS"] == "A, B"

    def test_truncated(self, tmp_path):
        path = tmp_path / "a.img"
        write_vicar(path, PIXELS, EXPOSURE_DURATION=1200.0)
        whole = path.read_bytes()
        path.write_bytes(whole[: whole.index(b"LBLSIZE") + 40])
        assert "truncated: the VICAR label has 40 of" in error_of(path)
        size = int(whole[8:20].split()[0])
        path.write_bytes(whole[: size + 50])
        assert "has 50 of 108 bytes" in error_of(path)

    def test_cube(self, tmp_path):
        path = tmp_path / "a.img"
        write_vicar(path, np.stack([PIXELS] * 2))
        assert "cube of 2 x 6 x 9" in error_of(path)

    def test_damaged_label(self, tmp_path):
        path = tmp_path / "a.img"
        write_vicar(path, PIXELS)
        path.write_bytes(path.read_bytes().replace(b"FORMAT='HALF'", b"FORMAT='HELF'"))
        assert "FORMAT 'HELF'" in error_of(path)


class TestPds3:
    @pytest.mark.parametrize(
        ("kind", "bits", "dtype"),
        [
            ("MSB_INTEGER", 16, ">i2"),
            ("LSB_INTEGER", 16, "<i2"),
            ("SUN_UNSIGNED_INTEGER", 32, ">u4"),
            ("UNSIGNED_INTEGER", 16, ">u2"),
            ("PC_REAL", 32, "<f4"),
            ("IEEE_REAL", 64, ">f8"),
        ],
    )
    def test_attached_raw_picture(self, tmp_path, kind, bits, dtype):
        path = tmp_path / "a.img"
        attached(path, PIXELS.astype(dtype).tobytes(), kind=kind, bits=bits)
        frame = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(frame.image_dn, PIXELS)
        assert frame.exposure_s == pytest.approx(0.090, abs=1e-12)
        assert frame.utc == "2000-02-25T05:16:12.701"
        assert frame.header["MISSION_NAME"] == "A TEST OF LABELS"
        assert frame.header["FILTER_NAME"] == "CL1, IR3"

    def test_prefix_bytes_scale_and_byte_pointer(self, tmp_path):
        path = tmp_path / "a.img"
        rows = np.zeros((6, 4 + 18), np.uint8)
        rows[:, 4:] = PIXELS.astype(">i2").view(np.uint8).reshape(6, 18)
        extra = "LINE_PREFIX_BYTES = 4\n  SCALING_FACTOR = 0.5\n  OFFSET = -3.0"
        path.write_bytes(label("2001 <BYTES>", extra=extra).ljust(2000) + rows.tobytes())
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, PIXELS * 0.5 - 3.0)

    def test_detached_raw_and_fits(self, tmp_path):
        """The label has capitals, the file beside it has not; the frame names the file with the pixels."""
        (tmp_path / "raw.dat").write_bytes(bytes(128) + PIXELS.astype(">i2").tobytes())
        path = tmp_path / "raw.lbl"
        path.write_bytes(label('("RAW.DAT", 3)'))
        frame = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(frame.image_dn, PIXELS)
        assert frame.path.name == "raw.dat"
        fits.PrimaryHDU(PIXELS + 1, fits.Header({"XTIME": 2.5})).writeto(tmp_path / "a.fit")
        path.write_bytes(label('"A.FIT"'))
        frame = read_image(path, KeywordMap(exposure_s="XTIME", utc="START_TIME"))
        np.testing.assert_array_equal(frame.image_dn, PIXELS + 1)
        assert (frame.exposure_s, frame.utc) == (2.5, "2000-02-25T05:16:12.656")

    def test_detached_file_missing(self, tmp_path):
        path = tmp_path / "a.lbl"
        path.write_bytes(label('("../../SECRET.IMG", 1)'))
        assert "SECRET.IMG, which is not beside it" in error_of(path)

    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            ({"extra": "BANDS = 3"}, "cube of 3 bands"),
            ({"lines": 0}, "LINES = 0"),
            ({"lines": '"many"'}, "LINES = 'many'"),
            ({"kind": "VAX_REAL", "bits": 64}, "VAX_REAL"),
            ({"bits": 12}, "12 bits"),
            ({"lines": 7}, "108 of 126 bytes"),
            ({"extra": "OFFSET = unknown"}, "OFFSET"),
            ({"record": '"?"'}, "RECORD_BYTES"),
        ],
    )
    def test_unusable_labels(self, tmp_path, options, reason):
        path = tmp_path / "a.img"
        attached(path, PIXELS.astype(">i2").tobytes(), **options)
        assert reason in error_of(path)

    def test_label_without_picture(self, tmp_path):
        path = tmp_path / "a.lbl"
        path.write_bytes(b"PDS_VERSION_ID = PDS3\r\n^TABLE = 3\r\nEND\r\n")
        assert "^IMAGE" in error_of(path)
