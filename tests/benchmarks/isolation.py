"""What isolation costs in one run: ``python tests/benchmarks/isolation.py``; by hand, on a quiet machine.

Pictures whose decoding is tried in the supervised process first (compressed FITS, PNG), the same pictures without that, and
plain FITS, which are proven harmless by their headers and never tried.
"""

import io
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from astropy.io import fits
from PIL import Image

from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.formats import display_picture, fits_picture

SIZE, TIMES = 1024, 15


def pictures(folder: Path) -> dict[str, Path]:
    pixels = np.random.default_rng(1).normal(500.0, 20.0, (SIZE, SIZE)).astype(np.int16)
    plain, squeezed = io.BytesIO(), io.BytesIO()
    fits.PrimaryHDU(pixels).writeto(plain)
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(pixels)]).writeto(squeezed)
    (folder / "plain.fit").write_bytes(plain.getvalue())
    (folder / "squeezed.fits").write_bytes(squeezed.getvalue())
    Image.fromarray(pixels.astype(np.uint16)).save(folder / "display.png")
    return {path.stem: path for path in sorted(folder.iterdir())}


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """The first call, and the median of the others; what the child does is waited for."""
    taken = []
    for _ in range(TIMES):
        begun = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begun)
    return taken[0], float(np.median(taken[1:]))


def tell(line: str) -> None:
    sys.stdout.write(line + "\n")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        tell(f"{SIZE} x {SIZE} pixels, seconds to read: the first, and the median of {TIMES - 1} more")
        for tried in (True, False):
            if not tried:
                display_picture.tried = fits_picture.tried = lambda *_: None
            for name, path in pictures(Path(folder)).items():
                first, others = seconds(lambda path=path: read_image(path, KeywordMap()))
                tell(f"{name:9} {'with' if tried else 'without'} isolation: {first:.3f} {others:.3f}")


if __name__ == "__main__":
    main()
