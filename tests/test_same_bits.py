"""What hardening leaves as it was: good inputs give the same bits as plain libraries do, and after and among bad ones."""

import gzip
import io
import sys
from pathlib import Path

import numpy as np
import pytest
import spiceypy
import yaml
from astropy.io import fits
from PIL import Image

from opnav_workbench.errors import OpNavError
from opnav_workbench.files import json_text
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.processing import process
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_PICTURES
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.yaml_nodes import compose, plain_value

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent / "image"))

from hostile import mutant
from picture_bytes import vicar_bytes

PIXELS = np.random.default_rng(5).normal(500.0, 90.0, (41, 67))
COUNTS = PIXELS.astype(np.uint16)


# ---- Pictures, against the library, or the numbers, alone.


def hdus(*parts) -> bytes:
    stream = io.BytesIO()
    fits.HDUList(list(parts)).writeto(stream)
    return stream.getvalue()


def shown(kind: str) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(COUNTS if kind != "JPEG" else COUNTS.astype(np.uint8)).save(stream, kind)
    return stream.getvalue()


def by_astropy(data: bytes) -> np.ndarray:
    with fits.open(io.BytesIO(data)) as parts:
        return next(part.data for part in parts if part.is_image and part.data is not None)


def by_pillow(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as picture:
        return np.asarray(picture)


FLOATS, WHOLE = PIXELS.astype(">f4"), PIXELS.astype(">i2")
SCALED = fits.PrimaryHDU(COUNTS)  # unsigned, stored with BZERO
GOOD = {
    "fits": (hdus(fits.PrimaryHDU(FLOATS)), by_astropy),
    "fits unsigned": (hdus(SCALED), by_astropy),
    "fits zipped": (gzip.compress(hdus(fits.PrimaryHDU(FLOATS))), lambda data: by_astropy(gzip.decompress(data))),
    "fits rice": (hdus(fits.PrimaryHDU(), fits.CompImageHDU(WHOLE)), by_astropy),
    "fits gzip tiles": (
        hdus(fits.PrimaryHDU(), fits.CompImageHDU(FLOATS, compression_type="GZIP_2", quantize_level=0.0)), by_astropy,
    ),
    "vicar": (vicar_bytes(WHOLE), lambda _: WHOLE),
    "vicar floats": (vicar_bytes(FLOATS), lambda _: FLOATS),
    "png": (shown("PNG"), by_pillow),
    "tiff": (shown("TIFF"), by_pillow),
    "jpeg": (shown("JPEG"), by_pillow),
}  # fmt: skip


@pytest.mark.parametrize("case", GOOD)
def test_pictures_are_what_the_library_reads(case, tmp_path):
    data, alone = GOOD[case]
    path = tmp_path / "good.img"
    path.write_bytes(data)
    np.testing.assert_array_equal(read_image(path, KeywordMap()).image_dn, alone(data).astype(np.float64))


# ---- YAML, against PyYAML's own safe reader without its dates.


class Plain(yaml.SafeLoader):
    yaml_implicit_resolvers = {
        first: [known for known in all_known if not known[0].endswith(":timestamp")]
        for first, all_known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


@pytest.mark.slow
def test_yaml_is_what_its_library_reads():
    paths = sorted(kernels_meta_dir().rglob("*.yaml"))
    assert len(paths) > 50
    for path in paths:
        text = path.read_text()
        ours, theirs = plain_value(compose(text)), yaml.load(text, Plain)
        assert repr(ours) == repr(theirs), path  # types and bits of numbers, order of keys


# ---- Kernels: what SPICE answers, before and after bad ones were tried.


def spice_answers() -> list[bytes]:
    """Return bits of states, an attitude, and every variable of the pool."""
    et = et_from_utc(DEMO_PICTURES[0].utc)
    answers = [
        np.asarray(spiceypy.spkezr(body, et, "J2000", "LT+S", "NEW HORIZONS")[0]) for body in ("PLUTO", "SUN")
    ]
    answers.append(np.asarray(spiceypy.pxform("J2000", "NH_LORRI", et)))
    numbers = [name for name in spiceypy.gnpool("*", 0, 100_000) if spiceypy.dtpool(name)[1] == "N"]
    answers += [np.asarray(spiceypy.gdpool(name, 0, 10_000)) for name in sorted(numbers)]
    return [np.ascontiguousarray(answer).tobytes() for answer in answers]


def test_kernels_answer_alike_after_bad_ones(tmp_path, fuzz):
    with KernelSet(DEMO_KERNELS) as kernels:
        before = spice_answers()
        files = [Path(file.path) for file in kernels.kernels()]
        whole = {path.suffix: path.read_bytes() for path in files if path.suffix in (".bsp", ".bc", ".tpc")}
        assert {".bsp", ".bc", ".tpc"} <= set(whole)
        assert len(before) > 100
    rng, refused = fuzz.random("same bits"), 0
    for number in range(fuzz.count(60)):
        suffix = sorted(whole)[number % len(whole)]
        path = tmp_path / f"bad{suffix}"
        path.write_bytes(mutant(whole[suffix], rng, text=suffix == ".tpc"))
        try:
            with KernelSet(path):
                pass
        except OpNavError:
            refused += 1
    assert refused > 0
    assert spiceypy.ktotal("ALL") == 0
    with KernelSet(DEMO_KERNELS):
        assert spice_answers() == before


# ---- Results: a picture alone, and among bad ones.


def test_results_are_the_same_among_bad_pictures(demo_truths, tmp_path, fuzz):
    picture, rng = demo_truths[0].picture, fuzz.random("neighbours")
    how = {"mission": "new_horizons", "kernels": DEMO_KERNELS, "targets": "none"}
    bad = []
    for number, damaged in enumerate(
        (b"", picture.read_bytes()[:5000], GOOD["fits rice"][0][:-2880], rng.bytes(5760))
    ):
        bad.append(tmp_path / f"{number}.fit")
        bad[-1].write_bytes(damaged)
    (alone,) = process([picture], **how)
    *others, last = process([*bad, picture], **how)
    assert [outcome.result["status"] for outcome in others] == ["failed"] * len(bad)
    assert alone.result["status"] == "ok"
    assert json_text(last.result) == json_text(alone.result)
