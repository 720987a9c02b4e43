"""What isolation costs a run: ``python tests/benchmarks/isolation.py``, a table; ``test_isolation_cost`` holds it.

A run is a program from its start: it reads pictures, or solves them as `opnav process` does, once as the package does it
and once without asking the supervised process. What counts is processor time, of the run and of all that it started, which
a busy machine leaves as it is, as a ratio of runs taken by turns.

Compressed FITS and PNG are decoded by compiled code that trusts the file: they are tried first. Plain FITS is proven
harmless by its header, and never tried.
"""

import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from astropy.io import fits
from PIL import Image

SIZE, PICTURES, ROUNDS = 1024, 20, 3
KINDS = ("plain.fit", "squeezed.fits", "display.png")
RUNS = {
    "read": """
for _ in range(int(number)):
    read_image(path, KeywordMap())
""",
    "solve": """
from opnav_workbench.processing import process
paths = sorted(Path(path).glob("*.fits"))[:int(number)]
solved = [o.result["status"] for o in process(paths, mission="new_horizons", attitude="header", targets="none")]
assert solved == ["ok"] * int(number), solved
""",
}
START = """
import sys
from pathlib import Path
from opnav_workbench import supervised
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.formats import display_picture, fits_picture
isolated, path, number = sys.argv[1:]
if isolated == "no":
    display_picture.tried = fits_picture.tried = lambda *_: None
"""
END = """
supervised._CHILD.close()  # it is waited for, so that its time is known
"""


def write_pictures(folder: Path) -> None:
    pixels = np.random.default_rng(1).normal(500.0, 20.0, (SIZE, SIZE)).astype(np.int16)
    fits.PrimaryHDU(pixels).writeto(folder / KINDS[0])
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(pixels)]).writeto(folder / KINDS[1])
    Image.fromarray(pixels.astype(np.uint16)).save(folder / KINDS[2])


def squeezed(picture: Path) -> bytes:
    """Return a flight file with its image compressed without loss, and the header's words where they were."""
    stream = io.BytesIO()
    with fits.open(picture) as hdus:
        words = hdus[0].header.copy(strip=True)
        tiles = fits.CompImageHDU(hdus[0].data, header=words, compression_type="GZIP_2", quantize_level=0.0)
        fits.HDUList([fits.PrimaryHDU(header=words), tiles, *hdus[1:]]).writeto(stream)
    return stream.getvalue()


def processor_s(run: str, path: Path, number: int, *, isolated: bool) -> float:
    """Return the processor time of a run, with that of what it started."""
    told = [
        sys.executable,
        "-c",
        START + RUNS[run] + END,
        "yes" if isolated else "no",
        str(path),
        str(number),
    ]
    with subprocess.Popen(told) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return used.ru_utime + used.ru_stime


def cost(run: str, path: Path, number: int = PICTURES, rounds: int = ROUNDS) -> tuple[float, float]:
    """Return the medians of the processor times of a run with isolation and without, in seconds.

    One that a busy machine has counted wrong, as too short as well as too long, is none of them.
    """
    times = [
        [processor_s(run, path, number, isolated=isolated) for isolated in (True, False)]
        for _ in range(rounds)
    ]
    isolated, bare = (float(np.median(column)) for column in zip(*times, strict=True))
    return isolated, bare


def demo_pictures(folder: Path, number: int = PICTURES) -> None:
    from opnav_workbench.kernels import KernelSet
    from opnav_workbench.mission import load_mission
    from opnav_workbench.rehearsal import (
        DEMO_CATALOG,
        DEMO_KERNELS,
        DEMO_MISSION,
        DEMO_PICTURES,
        simulate_picture,
    )

    mission, made = load_mission(DEMO_MISSION), folder / "made"
    made.mkdir()
    with KernelSet(DEMO_KERNELS):
        picture = simulate_picture(DEMO_PICTURES[0], mission, DEMO_CATALOG, made).picture
    copies(picture, folder, number)


def copies(picture: Path, folder: Path, number: int) -> None:
    (folder / "00.fits").write_bytes(squeezed(picture))
    for copy in range(1, number):
        shutil.copy(folder / "00.fits", folder / f"{copy:02d}.fits")


def main() -> None:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write_pictures(folder)
        (folder / "demo").mkdir()
        demo_pictures(folder / "demo")
        runs = [(f"reads {name}, {SIZE} x {SIZE}", "read", folder / name) for name in KINDS]
        runs.append(("solves compressed FITS, 256 x 256", "solve", folder / "demo"))
        sys.stdout.write(f"processor seconds of a run of {PICTURES}: with isolation, without, ratio\n")
        for what, run, path in runs:
            isolated, bare = cost(run, path)
            sys.stdout.write(f"{what:34} {isolated:.2f} {bare:.2f} {isolated / bare:.3f}\n")


if __name__ == "__main__":
    main()
