"""Labels as other software and other hands write them: the same picture, or one line that says what to do."""

import json
import re

import numpy as np
import pytest
from astropy.io import fits
from picture_bytes import pds4_label, vicar_bytes
from PIL import Image

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, read_image

PIXELS = np.random.default_rng(7).integers(0, 4000, (12, 20))
KEYWORDS = KeywordMap(utc="IMAGE_TIME", exposure_s="EXPOSURE_DURATION")
SIZE = 1600
HEAD = "PDS_VERSION_ID = PDS3\n"
BODY = "RECORD_BYTES = 40\n^IMAGE = 41\nIMAGE_TIME = 2010-01-01T00:00:00\nEXPOSURE_DURATION = 0.5\n"
IMAGE = (
    "OBJECT = IMAGE\n LINES = 12\n LINE_SAMPLES = 20\n SAMPLE_TYPE = MSB_UNSIGNED_INTEGER\n SAMPLE_BITS = 16\n"
    "END_OBJECT = IMAGE\n"
)
LABEL = HEAD + BODY + IMAGE + "END\n"

SAME = {
    "other line ends": LABEL.replace("\n", "\r"),
    "no spaces": LABEL.replace(" = ", "="),
    "tabs": LABEL.replace(" = ", "\t  =\t"),
    "small letters": re.sub(
        r"^.*$", lambda m: m[0] if "TIME" in m[0] else m[0].lower(), LABEL, flags=re.MULTILINE
    ),
    "a comment first": "/* made by hand */\n" + LABEL,
    "comments": LABEL.replace("41\n", "41 /* records */\n").replace(
        "OBJECT = IMAGE", "/* LINES = 7\n */\nOBJECT = IMAGE", 1
    ),
    "a comment at the end": LABEL.replace("END\n", "") + "END /* of the label */\n",
    "a wrapper of JPL": LABEL.replace(HEAD, "NJPL1I00PDS100000000 = SFDU_LABEL\n"),
    "numbers in quotes": LABEL.replace("= 12", '= "12"').replace("= 20\n", "= 20.0\n"),
    "numbers with their base": LABEL.replace("= 12", "= 10#12#"),
    "units": LABEL.replace("12\n", "12 <LINES>\n").replace("= 40", "= 40 <BYTES>"),
    "an object in quotes": LABEL.replace("OBJECT = IMAGE", 'OBJECT = "IMAGE"'),
    "a type in words": LABEL.replace("MSB_UNSIGNED_INTEGER", '"Unsigned Integer"'),
    "a word without a value": LABEL.replace(HEAD, HEAD + "NOTHING =\n"),
    "values on lines of their own": LABEL.replace("RECORD_BYTES =", "RECORD_BYTES =\n   "),
    "assignments in a text": LABEL.replace(HEAD, HEAD + 'NOTE = "\n  ^IMAGE = 3\nEND\n LINES = 5"\n'),
    "comments in texts": LABEL.replace(HEAD, HEAD + 'NOTE = "a /* b"\n').replace(
        IMAGE, 'MORE = "c */ d"\n' + IMAGE
    ),
    "brackets in a list": LABEL.replace(HEAD, HEAD + 'NAMES = ("RED (1)", "BLUE)")\n'),
    "lists of lists": LABEL.replace(HEAD, HEAD + "PAIRS = ((1, 2),\n (3, 4))\n"),
    "objects within": LABEL.replace(
        "END_OBJECT", "OBJECT = WINDOW\n LINES = 5\nEND_OBJECT = WINDOW\nEND_OBJECT", 1
    ),
}


@pytest.mark.parametrize("case", SAME)
def test_the_same_picture(tmp_path, case):
    path = tmp_path / "a.img"
    text = SAME[case].encode()
    path.write_bytes(text.ljust(SIZE) + PIXELS.astype(">u2").tobytes())
    picture = read_image(path, KEYWORDS)
    np.testing.assert_array_equal(picture.image_dn, PIXELS)
    assert (picture.utc, picture.exposure_s) == ("2010-01-01T00:00:00", 0.5)


def test_a_pointer_over_several_lines(tmp_path):
    (tmp_path / "pixels.dat").write_bytes(PIXELS.astype(">u2").tobytes())
    path = tmp_path / "a.lbl"
    path.write_text(LABEL.replace("^IMAGE = 41", '^IMAGE = (\n  "PIXELS.DAT",\n  1)'))
    np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, PIXELS)


@pytest.mark.parametrize(
    ("unit", "seconds"), [("MILLISECONDS", 0.5), ("ms", 0.5), ("SECOND", 500.0), ("FURLONG", 0.5)]
)
def test_a_label_s_own_unit_counts(tmp_path, unit, seconds):
    """The mission says that its labels have ms; a label that says otherwise is believed."""
    path = tmp_path / "a.img"
    text = LABEL.replace("DURATION = 0.5", f"DURATION = 500 <{unit}>").encode()
    path.write_bytes(text.ljust(SIZE) + PIXELS.astype(">u2").tobytes())
    keywords = KeywordMap(utc="IMAGE_TIME", exposure_s="EXPOSURE_DURATION", exposure_scale=1e-3)
    assert read_image(path, keywords).exposure_s == pytest.approx(seconds)


def test_vax_reals_of_pds3(tmp_path):
    path = tmp_path / "a.img"
    text = LABEL.replace("MSB_UNSIGNED_INTEGER", "VAX_REAL").replace("BITS = 16", "BITS = 32").encode()
    path.write_bytes(text.ljust(SIZE) + np.tile(np.array([0x4080, 0], "<u2"), PIXELS.size).tobytes())
    np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, np.ones(PIXELS.shape))


# ---- VICAR.

VICAR = (
    "FORMAT='HALF' TYPE='IMAGE' RECSIZE=40 ORG='BSQ' NL=12 NS=20 NB=1 N1=20 N2=12 N3=1 NBB=0 NLB=0 INTFMT='LOW' "
    "REALFMT='RIEEE' IMAGE_TIME='2010-01-01T00:00:00' EXPOSURE_DURATION=0.5"
)


def vicar(path, label, dtype="<i2", first="LBLSIZE=800 "):
    path.write_bytes((first + label).encode().ljust(800, b"\0") + PIXELS.astype(dtype).tobytes())
    return path


@pytest.mark.parametrize(
    "label",
    [
        VICAR.replace("RECSIZE=40", ""),
        VICAR.replace("NL=12 NS=20 NB=1", ""),
        VICAR.replace("ORG='BSQ'", ""),
        VICAR.replace("FORMAT='HALF'", "format='half'").replace("NL=12", "nl=12").replace("=", " = "),
    ],
)
def test_vicar_labels_that_lack_what_others_of_their_words_say(tmp_path, label):
    np.testing.assert_array_equal(read_image(vicar(tmp_path / "a.vic", label), KEYWORDS).image_dn, PIXELS)


def test_vicar_numbers_lie_as_the_format_says_where_the_label_does_not(tmp_path):
    """Little-endian: the specification's default, from when all files were written on one machine."""
    picture = read_image(vicar(tmp_path / "a.vic", VICAR.replace("INTFMT='LOW'", "")), KEYWORDS)
    np.testing.assert_array_equal(picture.image_dn, PIXELS)
    assert "has no INTFMT: taken as LOW" in str(picture.messages)
    bytes_alone = VICAR.replace("INTFMT='LOW'", "").replace("HALF", "BYTE").replace("RECSIZE=40", "")
    assert read_image(vicar(tmp_path / "b.vic", bytes_alone, "u1"), KEYWORDS).messages == ()


@pytest.mark.parametrize(
    ("label", "first", "said"),
    [
        (VICAR, "", "does not begin with LBLSIZE=..., the label's size"),
        (VICAR.replace("FORMAT='HALF'", ""), "LBLSIZE=800 ", "its VICAR label lacks FORMAT (BYTE, HALF"),
        (VICAR.replace("NL=12", "").replace("N2=12", ""), "LBLSIZE=800 ", "N2 is None"),
        (
            VICAR.replace("HALF", "DOUB").replace("REALFMT='RIEEE'", ""),
            "LBLSIZE=800 ",
            "of VAX reals no doubles",
        ),
    ],
)
def test_vicar_labels_that_lack_what_nothing_else_says(tmp_path, label, first, said):
    with pytest.raises(ImageError, match=r"^a\.vic: [^\n]*$") as caught:
        read_image(vicar(tmp_path / "a.vic", label, first=first), KEYWORDS)
    assert said in str(caught.value)


# ---- PDS4.


def pds4(tmp_path, axes, stored, *, start="", prefix=""):
    """A label whose axes are named, slowest first."""
    text = pds4_label("a.dat", tuple(size for _, size in axes), "UnsignedMSB2").decode()
    text = text.replace("<scaling_factor>0.5</scaling_factor><value_offset>10</value_offset>", "")
    for name, _ in axes:
        text = re.sub(
            r"<axis_name>[A-Z]\w*</axis_name>", f"<axis_name>{name.lower()}</axis_name>", text, count=1
        )
    assert text.count("<axis_name>") == len(axes)
    declaration, _, body = text.partition("?>")
    if prefix:
        body = re.sub(r"<(/?)(\w+)(?=[\s>])", rf"<\1{prefix}\2", body).replace(
            "xmlns=", f"xmlns:{prefix[:-1]}="
        )
    (tmp_path / "a.dat").write_bytes(stored.astype(">u2").tobytes())
    (tmp_path / "a.xml").write_text(f"{declaration}?>{start}{body}")
    return tmp_path / "a.xml"


BANDS = np.stack([PIXELS, PIXELS + 1, PIXELS + 2])
ORDERS = {
    "band, line, sample": ([("Band", 3), ("Line", 12), ("Sample", 20)], BANDS),
    "line, band, sample": ([("Line", 12), ("Band", 3), ("Sample", 20)], np.moveaxis(BANDS, 0, 1)),
    "line, sample, band": ([("Line", 12), ("Sample", 20), ("Band", 3)], np.moveaxis(BANDS, 0, 2)),
}


@pytest.mark.parametrize("order", ORDERS)
def test_axes_of_pds4_are_what_their_names_say(tmp_path, order):
    axes, stored = ORDERS[order]
    picture = read_image(pds4(tmp_path, axes, stored), KeywordMap(channel=2))
    np.testing.assert_array_equal(picture.image_dn, PIXELS + 1)


def test_a_pds4_picture_stored_by_columns_and_of_one_band(tmp_path):
    np.testing.assert_array_equal(
        read_image(pds4(tmp_path, [("Sample", 20), ("Line", 12)], PIXELS.T), KeywordMap()).image_dn, PIXELS
    )
    one = pds4(tmp_path, [("Line", 12), ("Sample", 20), ("Band", 1)], PIXELS)
    np.testing.assert_array_equal(read_image(one, KeywordMap()).image_dn, PIXELS)


def test_pds4_labels_with_name_spaces_and_long_comments(tmp_path):
    axes = [("Line", 12), ("Sample", 20)]
    for more in ({"prefix": "pds:"}, {"start": f"<!-- {'x' * 9000} -->"}):
        np.testing.assert_array_equal(
            read_image(pds4(tmp_path, axes, PIXELS, **more), KeywordMap()).image_dn, PIXELS
        )


# ---- Sidecars.

SIDECAR = {"utc": "2010-01-01T00:00:00", "exposure_s": 0.5}


def gray(tmp_path, text, suffix="json"):
    Image.fromarray(PIXELS.astype(np.uint16)).save(tmp_path / "a.png")
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return tmp_path / "a.png"


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        (json.dumps(SIDECAR).encode("utf-16"), "json"),
        ("file;utc;exposure_s\na.png;2010-01-01T00:00:00;0,5\n", "csv"),
        ("utc, exposure_s\n2010-01-01T00:00:00, 0.5\n", "csv"),
        ("file\tutc\texposure_s\na.png\t2010-01-01T00:00:00\t0.5\n", "csv"),
        ("UTC: 2010-01-01 00:00:00\nExposure_S: 0.5\n", "yaml"),
    ],
)
def test_sidecars_as_other_programs_write_them(tmp_path, text, suffix):
    picture = read_image(gray(tmp_path, text, suffix), KEYWORDS)
    assert (picture.utc[:19], picture.exposure_s) == ("2010-01-01T00:00:00", 0.5)


@pytest.mark.parametrize("kind", ["fits", "vic"])
def test_a_sidecar_beside_a_picture_whose_header_lost_its_words(tmp_path, kind):
    """As conversions leave them (GDAL's cubes and VICAR files); a header that tells a time is its own witness."""
    asked = KeywordMap(utc="DATE-AVG", exposure_s="EXPTIME")
    path = tmp_path / f"a.{kind}"
    if kind == "fits":
        fits.PrimaryHDU(PIXELS.astype(np.int16)).writeto(path)
    else:
        path.write_bytes(vicar_bytes(PIXELS.astype("<i2")))
    with pytest.raises(ImageError, match="no exposure time"):
        read_image(path, asked)
    (tmp_path / "a.json").write_text(json.dumps(SIDECAR))
    picture = read_image(path, asked)
    np.testing.assert_array_equal(picture.image_dn, PIXELS)
    assert (picture.utc[:19], picture.exposure_s) == ("2010-01-01T00:00:00", 0.5)
    if kind == "fits":
        fits.setval(path, "EXPTIME", value=20.0)
        fits.setval(path, "DATE-AVG", value="2011-01-01T00:00:00")
        assert read_image(path, asked).exposure_s == 20.0


def test_a_format_that_is_not_read_is_told_which_are(tmp_path):
    Image.fromarray(PIXELS.astype(np.uint8)).save(tmp_path / "a.bmp")
    (tmp_path / "a.json").write_text(json.dumps(SIDECAR))
    with pytest.raises(
        ImageError, match=r"is not a FITS, VICAR, PDS3, .* or JPEG file, and a.json does not say its lines"
    ):
        read_image(tmp_path / "a.bmp", KEYWORDS)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"utc": "2010-01-01T00:00:00", "exposure": 500}, "as exposure_s (seconds) instead of exposure"),
        (
            {"start_time": "2010-01-01T00:00:00", "exposure_s": 0.5},
            "as utc (the middle of the exposure) instead of start_time",
        ),
    ],
)
def test_words_that_look_like_those_of_a_sidecar_are_named(tmp_path, words, said):
    with pytest.raises(ImageError, match=re.escape(said)):
        read_image(gray(tmp_path, json.dumps(words)), KEYWORDS)


def test_an_attitude_under_another_word_is_not_passed_over_in_silence(tmp_path):
    path = gray(tmp_path, json.dumps({**SIDECAR, "quaternion": [1, 0, 0, 0]}))
    assert "its word quaternion is not read: attitude is the word" in str(read_image(path, KEYWORDS).messages)
    asked = KeywordMap(utc="IMAGE_TIME", exposure_s="EXPOSURE_DURATION", instrument="quaternion")
    assert "quaternion" not in str(read_image(path, asked).messages)


@pytest.mark.parametrize(
    ("layout", "dtype"),
    [
        ({"height": 12, "width": 20, "dtype": "uint16"}, "<u2"),
        ({"rows": 12, "columns": 20, "sample_type": ">u2"}, ">u2"),
        ({"lines": 12, "samples": 20, "sample_type": "UINT16", "byte_order": "MSB"}, ">u2"),
    ],
)
def test_layouts_in_other_words(tmp_path, layout, dtype):
    (tmp_path / "a.raw").write_bytes(PIXELS.astype(dtype).tobytes() + b"end")
    (tmp_path / "a.json").write_text(json.dumps(SIDECAR | layout))
    picture = read_image(tmp_path / "a.raw", KEYWORDS)
    np.testing.assert_array_equal(picture.image_dn, PIXELS)
    assert "3 bytes behind the samples" in str(picture.messages)


def test_packed_files_are_named(tmp_path):
    (tmp_path / "a.zip").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(ImageError, match=r"is packed \(ZIP\); unpack it"):
        read_image(tmp_path / "a.zip", KEYWORDS)
