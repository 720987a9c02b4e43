"""Plain FITS files are read as astropy reads them, to the type and the bit; all others are left to it."""

import io
import warnings

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from opnav_workbench.image.formats.fits_picture import _header_of
from opnav_workbench.image.formats.plain_fits import plain_hdus

PIXELS = np.random.default_rng(8).normal(0.0, 900.0, (5, 7))


def stored(*hdus) -> bytes:
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # long keywords become HIERARCH cards
        fits.HDUList([*hdus]).writeto(stream)
    return stream.getvalue()


def with_cards(*cards: str, data=None) -> bytes:
    """A file whose header has these cards as they are, before END."""
    whole = stored(fits.PrimaryHDU(PIXELS.astype(">f4") if data is None else data))
    end = next(at for at in range(0, 2880, 80) if whole[at : at + 3] == b"END")
    lines = b"".join(card.encode("latin-1").ljust(80) for card in cards)
    head = (whole[:end] + lines + b"END".ljust(80)).ljust(2880 * (1 + (end + len(lines)) // 2880))
    return head + whole[2880:]


def assert_as_astropy(data: bytes) -> None:
    found = plain_hdus(data)
    assert found is not None
    with warnings.catch_warnings(), fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
        warnings.simplefilter("error")  # a reader's warnings are the picture's messages
        assert len(found) == len(hdus)
        for ours, theirs in zip(found, hdus, strict=True):
            assert (ours.name, ours.is_image) == (theirs.name, theirs.is_image)
            messages: list[str] = []
            repeated = {}
            header = _header_of(theirs, messages, repeated)
            assert repeated == ours.repeated
            assert not messages
            assert list(map(repr, ours.header.items())) == list(map(repr, header.items()))
            if theirs.is_image:
                assert ours.shape == theirs.shape
                assert (ours.data is None) == (theirs.data is None)
                if ours.data is not None:
                    assert ours.data.dtype == theirs.data.dtype
                    assert ours.data.tobytes() == theirs.data.tobytes()
        for name in ("ERR", " err ", "primary", 1, "none"):
            try:
                expected = int(hdus.index_of(name))
            except KeyError:
                expected = None
            try:
                assert found.index_of(name) == expected
            except KeyError:
                assert expected is None


@pytest.mark.parametrize("kind", ["u1", ">i2", ">i4", ">i8", ">f4", ">f8", ">u2", ">u4", ">u8"])
def test_pixels_of_every_type(kind):
    assert_as_astropy(stored(fits.PrimaryHDU(np.abs(PIXELS).astype(kind))))


def test_extensions_images_and_tables():
    table = fits.BinTableHDU.from_columns([fits.Column("a", "J", array=np.arange(4))], name="rows")
    error, cube = fits.ImageHDU(PIXELS, name="Err"), fits.ImageHDU(np.zeros((2, 3, 4), ">i2"))
    assert_as_astropy(stored(fits.PrimaryHDU(), error, table, cube, fits.ImageHDU(name="ERR")))


TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="'"), max_size=150)
VALUES = st.one_of(
    st.booleans(),
    st.integers(-(10**18), 10**18),
    st.floats(allow_nan=False, allow_infinity=False),
    TEXT,
    st.none(),
)
KEYWORDS = st.from_regex(r"[A-Z][A-Z0-9_]{0,7}", fullmatch=True).filter(
    lambda k: (
        k not in {"END", "COMMENT", "HISTORY", "CONTINUE", "BLANK", "GROUPS", "BSCALE", "BZERO", "EXTNAME"}
    )
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(KEYWORDS, VALUES, TEXT), max_size=12))
def test_headers_as_astropy_writes_them(cards):
    hdu = fits.PrimaryHDU(PIXELS.astype(">i2"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # comments that are cut
        for keyword, value, comment in cards:
            try:
                hdu.header.append((keyword, value, comment), end=True)
            except ValueError:  # a comment that has no place
                continue
        hdu.header["HISTORY"] = "made here"
        data = stored(hdu)
    if plain_hdus(data) is None:  # a text that may be a record: see below
        assert any(isinstance(value, str) and ": " in value for _, value, _ in cards)
    else:
        assert_as_astropy(data)


CARDS = {
    "fixed": (
        "A       =                    7 / whole",
        "B       =                 -.5E3",
        "C       = +00012",
    ),
    "free": (
        "A       = T",
        "B       =1.D-3/none",
        "C       =   'it  '  /  'x'",
        "D       =",
        "E       = / none",
    ),
    "twice": ("A       =                    1", "A       =                    2"),
    "long": ("A       = 'one &'", "CONTINUE  'two&'", "CONTINUE  ' three' / far", "B       = 'x&'"),
}


@pytest.mark.parametrize("name", CARDS)
def test_cards_of_the_standard(name):
    data = with_cards(*CARDS[name])
    if name == "free":  # there is no blank behind the equals sign
        assert plain_hdus(data) is None
        data = with_cards(*(card.replace("=1", "= 1") for card in CARDS[name]))
    assert_as_astropy(data)


OTHERS = {
    "quotes": ("A       = 'it''s'",),
    "record": ("A       = 'AXIS.1: 2.5'",),
    "lower case": ("abc     =                    7",),
    "hierarch": ("HIERARCH ESO DET = 7",),
    "complex": ("A       = (1.0, 2.0)",),
    "no sign": ("WHATEVER 7",),
    "not closed": ("A       = 'open",),
    "two values": ("A       = 7 8",),
    "no ascii": ("A       = 'caf\xe9'",),
    "control": ("A       = 'a\tb'",),
    "scaled": ("BSCALE  =                  0.5",),
    "shifted": ("BZERO   =                  100",),
    "blank": ("BLANK   =                   -1",),
    "continued number": ("A       = 7", "CONTINUE  'x'"),
    "continued comment": ("COMMENT x", "CONTINUE  'x'"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_cards_are_left_to_astropy(name):
    assert plain_hdus(with_cards(*OTHERS[name], data=PIXELS.astype(">i2"))) is None


def test_other_files_are_left_to_astropy():
    whole = stored(fits.PrimaryHDU(PIXELS))
    assert plain_hdus(whole) is not None
    assert plain_hdus(whole[: 2880 + PIXELS.nbytes]) is None  # a short last block is told
    assert plain_hdus(whole[: 2880 + PIXELS.nbytes - 1]) is None
    assert plain_hdus(whole + b"and more") is None
    assert (
        plain_hdus(whole.replace(b"SIMPLE  =                    T", b"SIMPLE  =                    F"))
        is None
    )
    assert plain_hdus(b"SIMPLE  =") is None
    assert plain_hdus(stored(fits.PrimaryHDU(), fits.CompImageHDU(PIXELS.astype(">i2")))) is None
