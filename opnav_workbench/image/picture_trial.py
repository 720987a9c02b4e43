"""Files with compressed images tried out: FITS, PNG, TIFF, JPEG.

`opnav_workbench.supervised` calls it in a process of its own, which loads this file and little else of the package; the
reader proper has looked at the file's headers and its size.
"""

import gzip
import io
import warnings
from pathlib import Path

__all__ = ["try_display", "try_fits"]


def try_fits(path: str) -> None:
    """Read the data of every image of a FITS file.

    Raises
    ------
    Exception
        Whatever the library says of a file that is damaged.
    """
    # A third of a second that the process which tries other pictures shall not wait for, and the other way round.
    from astropy.io import fits  # noqa: PLC0415

    data = _unpacked(path)
    with warnings.catch_warnings(), fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=False) as hdus:
        warnings.simplefilter("ignore")  # the reader proper tells them
        for hdu in hdus:
            if hdu.is_image:
                _ = hdu.data


def try_display(path: str) -> None:
    """Decode a PNG, TIFF or JPEG file.

    Raises
    ------
    Exception
        Whatever the library says of a file that is damaged.
    """
    from PIL import Image  # noqa: PLC0415

    data = io.BytesIO(_unpacked(path))
    with warnings.catch_warnings(), Image.open(data, formats=("PNG", "TIFF", "JPEG")) as picture:
        warnings.simplefilter("ignore")
        picture.load()


def _unpacked(path: str) -> bytes:
    data = Path(path).read_bytes()
    return gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data
