"""Hostile inputs without end: every reader is given mutants of good files; what it takes is sound, the rest is one line.

19,360, which with those of commands (``cli/test_fuzz_commands.py``) are 20,300: half a minute of processor time, in the
short run too. For more, from another seed: ``pytest tests/test_fuzz.py --fuzz 3000 --fuzz-seed 7`` gives each reader 3000.
What is found becomes a case of its own beside the reader's tests.
"""

import gzip
import io
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import open_catalog
from opnav_workbench.catalog.user_files import read_star_list
from opnav_workbench.constants import RAD_PER_DEG
from opnav_workbench.errors import OpNavError
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.making.scenario import load_scenario
from opnav_workbench.kernels.shape_files import read_shape
from opnav_workbench.mission import load_mission
from opnav_workbench.planning.sequence import load_sequence
from opnav_workbench.rehearsal.scenario import load_ort_scenario
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session.decisions import load_decisions
from opnav_workbench.session.history import read_journal_file
from opnav_workbench.simulation import load_picture_scenario

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent / "image"))

from hostile import GROWTH_MB, LONGEST_LINE, SECONDS, LateError, mutant, peak_mb, within
from picture_bytes import isis_bytes, pds4_label, vicar_bytes, voyager_bytes

META = kernels_meta_dir()
KEYWORDS = KeywordMap(
    exposure_s="EXPTIME", utc="UTC", sclk="SCLK", quaternion=("QA", "QX", "QY", "QZ"), bits="BITS"
)
RNG = np.random.default_rng(3)
PIXELS = RNG.normal(20.0, 2.0, (12, 20)).astype(">f4")


# ---- Good files, from which the mutants come.


def fits_bytes(*more: Any) -> bytes:
    header = fits.Header()
    for keyword, value in {
        "EXPTIME": 0.5, "UTC": "2020-04-22T10:06:52.348", "SCLK": "3/0449855929:36485", "BITS": 12,
        "QA": 0.5, "QX": 0.5, "QY": -0.5, "QZ": 0.5,
    }.items():  # fmt: skip
        header[keyword] = value
    stream = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(PIXELS, header), *more]).writeto(stream)
    return stream.getvalue()


def image_bytes(kind: str) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(PIXELS.astype(np.uint16 if kind != "JPEG" else np.uint8)).save(stream, kind)
    return stream.getvalue()


def with_beside(folder: Path, name: str, beside: bytes, good: bytes) -> bytes:
    """Write what lies beside the file that is changed."""
    (folder / name).write_bytes(beside)
    return good


SIDECAR = b"""{"utc": "2030-01-01T00:00:00", "exposure_s": 2.0, "attitude": [0.5, 0.5, -0.5, 0.5], "lines": 12,
"samples": 20, "sample_type": "int16", "byte_order": "big", "position_km": [1.5e8, 0, 0],
"file": "raw.dat", "EXPTIME": 3, "x": {"y": [1]}}
"""
VICAR_WORDS = {"EXPTIME": 1200.0, "UTC": "2005-068T04:09:08.968Z"}
RAW = PIXELS.astype(">i2").tobytes()


PDS = """PDS_VERSION_ID = PDS3
/* made for a test */
RECORD_BYTES = 64
^IMAGE = 17
UTC = 2000-02-25T05:16:12.656
EXPTIME = 90.00 <ms>
FILTER_NAME = ("CL1",
 "IR3")
OBJECT = IMAGE
 LINES = 12
 LINE_SAMPLES = 20
 SAMPLE_TYPE = MSB_INTEGER
 SAMPLE_BITS = 16
 LINE_PREFIX_BYTES = 0
 SCALING_FACTOR = 1.5
END_OBJECT = IMAGE
END
"""


def pds_bytes() -> bytes:
    return PDS.replace("\n", "\r\n").encode().ljust(1024) + PIXELS.astype(">i2").tobytes()


def npz_bytes() -> bytes:
    stream = io.BytesIO()
    np.savez(
        stream, ra_deg=np.linspace(0, 359, 30), dec_deg=np.linspace(-80, 80, 30), mag=np.linspace(1, 9, 30),
        id=np.array([f"s{i}".encode() for i in range(30)]), parallax_mas=np.full(30, np.nan), epoch_jyear=2000.0,
    )  # fmt: skip
    return stream.getvalue()


STARS = b"stars:\n- {name: a, ra_deg: 1.5, dec_deg: -2, epoch_jyear: 2016.0, mag: 5.5, parallax_mas: 3}\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
DECISIONS = b"""images:
  "*":
    name: lor_0299.fit
    who: M. Jones
    when: 2015-07-12T10:04:11+00:00
    reject:
    - {star: TYC 1234-567-1, reason: cosmic ray}
    circles:
    - {body: PLUTO, pixel: 512.0, line: 488.5, radius_px: 95.0}
"""
ENTRY = {"step": "note", "parameters": {"text": "x"}, "reason": "", "outcome": "", "time_utc": ""}
JOURNAL = json.dumps({"session": "s", "n": 0, "after": "", "entry": ENTRY}).encode() + b"\n"
KERNEL = b"""KPL/PCK
\\begindata
BODY999_RADII = ( 1188.3 1188.3 1188.3 )
BODY999_POLE_RA = ( 132.993 0. 0. )
\\begintext
"""


# ---- Readers: what they are given, how they are asked, and what must be true of what they take.


def bare_picture(path: Path) -> None:
    sound_picture(path, KeywordMap())


def sound_picture(path: Path, keywords: KeywordMap = KEYWORDS) -> None:
    picture = read_image(path, keywords)
    assert np.isfinite(picture.image_dn).all()
    assert picture.image_dn.ndim == 2
    assert picture.image_dn.shape == picture.bad.shape == picture.saturated.shape
    assert np.isnan(picture.exposure_s) or 0.0 < picture.exposure_s < np.inf
    assert picture.et is None or np.isfinite(picture.et)
    turn = None if picture.header_geometry is None else picture.header_geometry.camera_from_j2000
    if turn is not None:  # a header may tell a place alone
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turn) > 0.0


def sound_catalog(path: Path) -> None:
    stars = open_catalog(f"npz:{path}").cone(0.0, 0.0, 180.0 * RAD_PER_DEG, 99.0)
    for column in (stars.ra_rad, stars.dec_rad, stars.mag, stars.epoch_jyear, stars.sigma):
        assert np.isfinite(column).all()
    assert (np.abs(stars.dec_rad) <= np.pi / 2 + 1e-9).all()


def sound_stars(path: Path) -> None:
    stars = read_star_list(path)
    assert np.isfinite(stars.mag).all()
    assert np.isfinite(stars.ra_rad).all()


def sound_camera(path: Path) -> None:
    camera = Camera.from_yaml(path)
    assert camera.n_pixel * camera.n_line <= 1 << 28
    assert np.isfinite(camera.pixel_scale_rad)


def sound_shape(path: Path) -> None:
    vertices, plates = read_shape(path)
    assert np.isfinite(vertices).all()
    assert plates.min() >= 0
    assert plates.max() < len(vertices)


def sound_kernel(path: Path) -> None:
    with KernelSet(path) as kernels:
        kernels.kernels()


def sound_journal(path: Path) -> None:
    for entry in read_journal_file(path, "s", ()).entries:
        assert isinstance(entry.step, str)
        assert isinstance(entry.parameters, dict)


@dataclass(frozen=True)
class Reader:
    good: Callable[[Path], bytes]
    suffix: str
    ask: Callable[[Path], Any]
    text: bool = False
    inputs: int = 1350  # of a run; fewer where one takes longer
    packed: Callable[[bytes], bytes] | None = (
        None  # how the good file is packed: it is damaged before that, or after
    )


def meta(name: str) -> Callable[[Path], bytes]:
    return lambda _: (META / name).read_bytes()


READERS = {
    "fits": Reader(
        lambda _: fits_bytes(fits.ImageHDU(PIXELS, name="ERR")), ".fit", sound_picture, inputs=120
    ),
    "fits squeezed": Reader(
        lambda _: fits_bytes(fits.CompImageHDU(PIXELS.astype(np.int16))), ".fits", sound_picture, inputs=100
    ),
    "fits zipped": Reader(lambda _: fits_bytes(), ".fit.gz", sound_picture, packed=gzip.compress),
    "vicar": Reader(
        lambda _: vicar_bytes(PIXELS.astype(np.int16), later={"A": 1}, **VICAR_WORDS), ".img", sound_picture
    ),
    "voyager": Reader(lambda _: voyager_bytes(PIXELS.astype(np.uint8)), ".imq", bare_picture, inputs=500),
    "isis": Reader(lambda _: isis_bytes(PIXELS[None], "Real", (5, 8)), ".cub", bare_picture),
    "pds4": Reader(
        lambda folder: with_beside(folder, "a.dat", RAW, pds4_label("a.dat", (12, 20), "SignedMSB2")),
        ".xml",
        bare_picture,
        text=True,
    ),
    "png": Reader(lambda _: image_bytes("PNG"), ".png", bare_picture, inputs=500),
    "tiff": Reader(lambda _: image_bytes("TIFF"), ".tif", bare_picture, inputs=500),
    "jpeg": Reader(lambda _: image_bytes("JPEG"), ".jpg", bare_picture, inputs=500),
    "sidecar": Reader(
        lambda folder: with_beside(folder, "raw.dat", RAW, SIDECAR),
        ".json",
        sound_picture,
        text=True,
    ),
    "sidecar table": Reader(
        lambda folder: with_beside(
            folder,
            "raw.dat",
            RAW,
            b"file,raw.dat\nlines,12\nsamples,20\nEXPTIME,2\nUTC,2030-01-01T00:00:00\n",
        ),
        ".csv",
        sound_picture,
        text=True,
    ),
    "pds": Reader(lambda _: pds_bytes(), ".lbl", sound_picture, text=True),
    "npz": Reader(lambda _: npz_bytes(), ".npz", sound_catalog),
    "star list": Reader(lambda _: STARS, ".yaml", sound_stars, text=True),
    "camera": Reader(
        meta("new_horizons/cameras/lorri_4x4.yaml"), ".yaml", sound_camera, text=True, inputs=120
    ),
    "mission": Reader(meta("new_horizons/mission.yaml"), ".yaml", load_mission, text=True, inputs=120),
    "kernel scenario": Reader(
        meta("new_horizons/pluto_opnav.yaml"), ".yaml", load_scenario, text=True, inputs=60
    ),
    "picture scenario": Reader(
        meta("new_horizons/pictures/pluto_limb.yaml"), ".yaml", load_picture_scenario, text=True, inputs=200
    ),
    "sequence": Reader(
        meta("new_horizons/sequences/pluto_approach.yaml"), ".yaml", load_sequence, text=True, inputs=120
    ),
    "rehearsal": Reader(
        meta("new_horizons/rehearsals/pluto_flyby_targeting.yaml"),
        ".yaml",
        load_ort_scenario,
        text=True,
        inputs=120,
    ),
    "decisions": Reader(lambda _: DECISIONS, ".yaml", load_decisions, text=True),
    "journal": Reader(lambda _: JOURNAL * 3, ".jsonl", sound_journal, text=True),
    "shape": Reader(lambda _: OBJ, ".obj", sound_shape, text=True),
    "text kernel": Reader(lambda _: KERNEL, ".tpc", sound_kernel, text=True, inputs=200),
}


# ---- Exams.


@pytest.mark.parametrize("name", READERS)
def test_reader(name, fuzz, tmp_path):
    reader, rng = READERS[name], fuzz.random(name)
    good, pack = reader.good(tmp_path), reader.packed or bytes
    path = tmp_path / f"mutant{reader.suffix}"
    path.write_bytes(pack(good))
    reader.ask(path)
    before, taken, said = peak_mb(), 0, list[str]()
    for number in range(fuzz.count(reader.inputs)):
        bare = reader.packed is None or rng.random() < 0.5
        damaged = mutant(good if bare else pack(good), rng, text=reader.text)
        path.write_bytes(pack(damaged) if bare else damaged)
        try:
            with within(SECONDS):
                reader.ask(path)
            taken += 1
        except OpNavError as error:
            said.append(str(error))
        except (Exception, LateError) as error:  # a finding: the file is kept
            kept = path.rename(tmp_path / f"finding{reader.suffix}")
            raise AssertionError(f"{name}, input {number}, kept as {kept}: {error!r}") from error
    assert peak_mb() - before < GROWTH_MB
    assert all(line.isprintable() and len(line) < LONGEST_LINE for line in said)
    assert taken + len(said) == number + 1
