"""The bytes of a picture file, bounded: no device, no endless file, no archive that unpacks beyond all memory.

Every failure is one `ImageError` line that begins with the file's name.
"""

import gzip
import io
import stat
import zlib
from pathlib import Path

from opnav_workbench.errors import ImageError
from opnav_workbench.fits_layout import MOST_PIXELS

__all__ = [
    "GZIP_START",
    "LARGEST_FILE_BYTES",
    "check_size",
    "file_bytes",
    "image_error",
    "truncated_error",
    "unpacked",
]

GZIP_START = b"\x1f\x8b"
# A file, and what a gzipped one unpacks to: four planes of 4096 x 4096 float64 fit, or one of 8192 x 8192.
LARGEST_FILE_BYTES = 1 << 29


def image_error(name: str, text: str) -> ImageError:
    """Return an `ImageError` of one line that begins with the file's name."""
    return ImageError(" ".join(f"{name}: {text}".split()))


def truncated_error(name: str, what: str, present: int, needed: int) -> ImageError:
    """Return the error of a file that ends too early."""
    return image_error(
        name, f"truncated: {what} has {present} of {needed} bytes; copy or download the file again."
    )


def check_size(name: str, pixels: int) -> None:
    """Refuse more pixels than memory is meant for, before any are made numbers of eight bytes."""
    if pixels > MOST_PIXELS:
        raise image_error(
            name, f"holds {pixels} pixels, more than {MOST_PIXELS}; save what is to be measured alone."
        )


def file_bytes(file: Path) -> bytes:
    """Return the content of a picture file.

    Raises
    ------
    ImageError
        It is missing, a folder, no regular file, larger than `LARGEST_FILE_BYTES`, empty, or cannot be read.
    """
    try:
        status = file.stat()
        if stat.S_ISDIR(status.st_mode):
            raise image_error(str(file), "is a folder; give an image file in it.")
        if not stat.S_ISREG(status.st_mode):  # a pipe would block, a device never end
            raise image_error(str(file), "is a pipe or device, no file; give an image file.")
        if status.st_size > LARGEST_FILE_BYTES:
            raise image_error(
                str(file),
                f"has {status.st_size} bytes, more than {LARGEST_FILE_BYTES}; give one picture alone.",
            )
        data = file.read_bytes()
    except FileNotFoundError as error:
        raise image_error(str(file), "no such file; check the name and the folder.") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise image_error(str(file), f"cannot be read: {reason}; check its name and permissions.") from error
    if not data:
        raise image_error(str(file), "is empty (0 bytes); copy or download it again.")
    return data


def unpacked(name: str, data: bytes) -> bytes:
    """Return the content of a gzipped file, of which no more than `LARGEST_FILE_BYTES` is unpacked.

    Raises
    ------
    ImageError
        It is damaged, or unpacks to more.
    """
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            plain = stream.read(LARGEST_FILE_BYTES + 1)
    except (EOFError, OSError, zlib.error) as error:
        raise image_error(name, f"damaged gzip file ({error}); copy or download it again.") from error
    if len(plain) > LARGEST_FILE_BYTES:
        raise image_error(
            name,
            f"unpacks from {len(data)} to more than {LARGEST_FILE_BYTES} bytes; unpack it by hand and look.",
        )
    return plain
