"""Headers and labels of pictures that lie: one line, no hang, no memory, before a library believes them."""

import gzip
import io
import os
import time

import numpy as np
import pytest
from astropy.io import fits
from picture_bytes import isis_bytes, vicar_bytes
from PIL import Image

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.pds_label import parse_pds_label

KEYWORDS = KeywordMap()
PICTURE = np.random.default_rng(1).normal(20.0, 2.0, (30, 40)).astype(">f4")
SECONDS = 2.0  # of processor time; what hung did so for hours


def card(keyword: str, value: object) -> bytes:
    return f"{keyword:<8}= {value:>20}".ljust(80).encode()


def stored(*hdus) -> bytes:
    stream = io.BytesIO()
    fits.HDUList(list(hdus)).writeto(stream)
    return stream.getvalue()


PLAIN = stored(fits.PrimaryHDU(PICTURE))
SQUEEZED = stored(fits.PrimaryHDU(), fits.CompImageHDU(PICTURE.astype(np.int16)))


def changed(data: bytes, keyword: str, value: object) -> bytes:
    start = data.index(f"{keyword:<8}=".encode())
    return data[:start] + card(keyword, value) + data[start + 80 :]


def extensions(count: int) -> bytes:
    cards = (
        card("XTENSION", "'IMAGE   '"),
        card("BITPIX", 8),
        card("NAXIS", 0),
        card("PCOUNT", 0),
        card("GCOUNT", 1),
    )
    return (b"".join(cards) + b"END").ljust(2880) * count


HOSTILE = {
    "axes": (changed(PLAIN, "NAXIS", 999999999), "NAXIS = 999999999, expected 0 to 999"),
    "axes below 0": (changed(PLAIN, "NAXIS", -1), "NAXIS = -1"),
    "an axis below 0": (changed(PLAIN, "NAXIS1", -40), "NAXIS1 = -40, expected none below 0"),
    "an axis missing": (changed(PLAIN, "NAXIS", 3), "NAXIS = 3 but no NAXIS3"),
    "a long axis": (changed(PLAIN, "NAXIS1", 10**12), "truncated"),
    "a longer axis": (changed(PLAIN, "NAXIS1", 10**18), "damaged|truncated"),
    "bits": (changed(PLAIN, "BITPIX", 7), "BITPIX = 7"),
    "no number": (changed(PLAIN, "NAXIS2", "'many'"), "NAXIS2 = 'many', expected one whole number"),
    "twice": (PLAIN[:400] + card("NAXIS1", 7) + PLAIN[480:], "NAXIS1 = 7, expected one"),
    "fields": (changed(SQUEEZED, "TFIELDS", 999999999), "TFIELDS = 999999999"),
    "parameters": (changed(SQUEEZED, "PCOUNT", -5000), "PCOUNT = -5000"),
    "a bomb of tiles": (changed(SQUEEZED, "ZNAXIS1", 10**9), "compressed image of 30000000000 pixels"),
    "tiles of nothing": (changed(SQUEEZED, "ZTILE1", 0), "ZTILE1 = 0"),
    "axes of a compressed image": (changed(SQUEEZED, "ZNAXIS", 999999999), "ZNAXIS = 999999999"),
    "thousands of headers": (PLAIN + extensions(3000), "more than 1000 FITS headers"),
    "a long header": (PLAIN[:400] + card("K", 1) * 60_000 + b"END".ljust(80), "more than 50000 cards"),
    "a label of many digits": (b"LBLSIZE=" + b"9" * 5000, "LBLSIZE of 5000 digits"),
    "a long label": (b"LBLSIZE=1000000 NL=1 " + b" " * 1_000_000, "VICAR label of more than"),
    "records of many digits": (b"LBLSIZE=500 NL=" + b"9" * 480 + bytes(500), "NL of 48. digits"),
    "a pointer of many digits": (b"PDS_VERSION_ID = PDS3\n^IMAGE = " + b"9" * 5000 + b"\nEND\n", "pointer"),
    "lines of many digits": (
        b"PDS_VERSION_ID = PDS3\n^IMAGE = 1\nOBJECT = IMAGE\nLINES = " + b"9" * 4200 + b"\nLINE_SAMPLES = 3\nEND\n",
        "LINES = ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_one_line_at_once(tmp_path, case):
    data, words = HOSTILE[case]
    path = tmp_path / "hostile.img"
    path.write_bytes(data)
    began = time.process_time()
    with pytest.raises(ImageError, match=words) as caught:
        read_image(path, KEYWORDS)
    assert time.process_time() - began < SECONDS
    assert str(caught.value).isprintable()
    assert "hostile.img" in str(caught.value)
    assert len(str(caught.value)) < 2100


@pytest.mark.parametrize(
    "line",
    [
        "A=(\n",
        'A="\n',
        "A={\n",
        "A=((\n",
        "A=('\n",
        "A=\n",
        "/* \n",
        "A=<<<<\n",
        "A= \n",
        "A" * 50 + "\n",
        "A=1 <\n",
    ],
)
def test_labels_are_read_in_one_pass(line):
    """Brackets that never close; with a search to the label's end for each line it took minutes."""
    label = b"PDS_VERSION_ID = PDS3\n" + line.encode() * ((1 << 18) // len(line))
    began = time.process_time()
    parse_pds_label(label)
    assert time.process_time() - began < SECONDS


def test_a_value_of_many_units_is_read_in_one_pass():
    began = time.process_time()
    label = parse_pds_label(b'PDS_VERSION_ID = PDS3\nA = "' + b"<" * 500_000 + b'"\nB = 1.5 <KM/S>\nEND\n')
    assert time.process_time() - began < SECONDS
    assert label.values["B"] == 1.5


def test_labels_close_where_they_closed():
    text = b'PDS_VERSION_ID = PDS3\nA = (1,\n 2)\nB = "a\n b" <KM>\nC = {X\nD = 4 /* four */\nE = "open\nF = 7 <s>\n'
    values = parse_pds_label(text).values
    assert values == {
        "PDS_VERSION_ID": "PDS3",
        "A": "1, 2",
        "B": "a b",
        "C": "X",
        "D": 4,
        "E": "open",
        "F": 7,
        "B <UNIT>": "KM",
        "F <UNIT>": "s",
    }


def test_a_label_that_says_there_are_no_lines(tmp_path):
    path = tmp_path / "none.img"
    path.write_bytes(vicar_bytes(np.zeros((4, 6), np.int16)))
    for item in (b"NL=4", b"N2=4"):
        path.write_bytes(path.read_bytes().replace(item, item[:3] + b"0", 1))
    with pytest.raises(ImageError, match="damaged VICAR file"):
        read_image(path, KEYWORDS)


def test_pipes_devices_and_circles_are_no_pictures(tmp_path):
    pipe, circle, huge = tmp_path / "pipe.fit", tmp_path / "circle.fit", tmp_path / "huge.fit"
    os.mkfifo(pipe)
    circle.symlink_to(circle)
    with huge.open("wb") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(ImageError, match="pipe or device"):
        read_image(pipe, KEYWORDS)
    with pytest.raises(ImageError, match="symbolic links"):
        read_image(circle, KEYWORDS)
    with pytest.raises(ImageError, match="more than 536870912"):
        read_image(huge, KEYWORDS)


def test_a_compressed_picture_is_read(tmp_path):
    path = tmp_path / "good.fits"
    for size in (1, 12):  # the larger is stored in fewer bytes than it has
        pixels = np.tile(PICTURE.astype(np.int16), (size, size))
        whole = stored(fits.PrimaryHDU(), fits.CompImageHDU(pixels))
        path.write_bytes(whole)
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, pixels)
    path.write_bytes(whole[: -4 * 2880])
    with pytest.raises(ImageError, match=r"truncated: extension 1|cannot be unpacked"):
        read_image(path, KEYWORDS)
    path.write_bytes(gzip.compress(PLAIN))
    np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, PICTURE)


def test_labels_are_called_what_they_are(tmp_path):
    """A label of ISIS was said to be one of PDS3."""
    path = tmp_path / "a.cub"
    path.write_bytes(
        isis_bytes(PICTURE[None], "Real", (10, 10)).replace(b"  Lines   = 30", b"  Lines   = xx", 1)
    )
    with pytest.raises(ImageError, match=r"a\.cub: label with LINES = 'xx', expected a whole number"):
        read_image(path, KEYWORDS)


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_gzipped_pictures_of_displays(tmp_path, kind):
    """They were called damaged."""
    stream = io.BytesIO()
    Image.fromarray(PICTURE.astype(np.uint16)).save(stream, kind)
    path = tmp_path / f"a.{kind.lower()}.gz"
    path.write_bytes(gzip.compress(stream.getvalue()))
    np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, PICTURE.astype(np.uint16))


def test_a_gzipped_file_unpacks_no_farther_than_pictures_go(tmp_path, monkeypatch):
    """3.3 MB became 6.9 GB; here the limit is a megabyte, and four times as much is packed."""
    limit = 1 << 20
    monkeypatch.setattr("opnav_workbench.image.file_bytes.LARGEST_FILE_BYTES", limit)
    asked = list[int]()
    read = gzip.GzipFile.read
    monkeypatch.setattr(
        gzip.GzipFile, "read", lambda stream, size=-1: asked.append(size) or read(stream, size)
    )
    path = tmp_path / "bomb.fit.gz"
    path.write_bytes(gzip.compress(PLAIN + bytes(4 * limit)))
    with pytest.raises(ImageError, match=rf"bomb\.fit\.gz: unpacks from \d+ to more than {limit} bytes"):
        read_image(path, KEYWORDS)
    assert asked == [limit + 1]


def test_a_plane_of_errors_is_never_the_picture(tmp_path):
    """Of a file whose picture is lost, the error plane was measured in its place."""
    path = tmp_path / "lost.fit"
    path.write_bytes(stored(fits.PrimaryHDU(PICTURE.ravel()), fits.ImageHDU(PICTURE, name="ERR")))
    assert read_image(path, KEYWORDS).image_dn.shape == PICTURE.shape  # nobody says what ERR is
    with pytest.raises(ImageError, match="no two-dimensional picture among its extensions"):
        read_image(path, KeywordMap(error_extension="ERR"))


@pytest.mark.parametrize("word", ["ET", "QX", "SUNX"])
def test_words_that_are_no_numbers_are_told(word, tmp_path):
    """They were passed over in silence."""
    facts = {"UTC": "2015-04-09T12:00:00", "ET": 481852867.186, "QA": 1.0, "QX": 0.0, "QY": 0.0, "QZ": 0.0}
    header = fits.Header(facts | {"SUNX": 1.5e8, "SUNY": 0.0, "SUNZ": 0.0} | {word: "abc"})
    path = tmp_path / "words.fit"
    path.write_bytes(stored(fits.PrimaryHDU(PICTURE, header)))
    named = {"quaternion": ("QA", "QX", "QY", "QZ"), "sun_position": ("SUNX", "SUNY", "SUNZ")}
    picture = read_image(path, KeywordMap(et="ET", utc="UTC", **named))
    assert f"{word} = 'abc' is no number; it is not used" in picture.contradictions
    assert picture.et is not None
