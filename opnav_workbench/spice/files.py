"""One kernel file: its kind by its content, its wholeness, its checksum; each found once per file state."""

import functools
import re
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.errors import KernelError
from opnav_workbench.files import sha256_of
from opnav_workbench.spice.daf import RECORD_BYTES, Segment, read_segments

__all__ = ["KINDS", "KernelFile", "is_binary", "kernel_file", "looks_like_kernel", "segments"]

KINDS = (
    "LSK",
    "SCLK",
    "PCK",
    "FK",
    "IK",
    "SPK",
    "CK",
    "DSK",
    "EK",
    "TEXT",
    "META",
)  # a folder's loading order
BINARY_KINDS = {b"DAF/SPK": "SPK", b"DAF/CK": "CK", b"DAF/PCK": "PCK", b"DAS/DSK": "DSK", b"DAS/EK": "EK"}
TEXT_KINDS = {f"KPL/{k}".encode(): k for k in ("LSK", "SCLK", "PCK", "FK", "IK")} | {b"KPL/MK": "META"}
# Text kernels need no identification word; the suffix then tells the kind.
SUFFIX_KINDS = {
    ".tls": "LSK", ".tsc": "SCLK", ".tpc": "PCK", ".tf": "FK", ".ti": "IK",
    ".bsp": "SPK", ".bc": "CK", ".bpc": "PCK", ".bds": "DSK", ".tm": "META", ".mk": "META", ".furnsh": "META",
}  # fmt: skip
LISTS_KERNELS = re.compile(rb"^\s*KERNELS_TO_LOAD\s*\+?=", re.MULTILINE)
TRANSFER_WORDS = (b"DAFETF", b"DASETF")
LARGEST_TEXT_BYTES = 1 << 28  # a text kernel beyond this is no text kernel
SHOWN_BYTES = 24


@dataclass(frozen=True, slots=True)
class KernelFile:
    """A kernel: its absolute path, and its kind as its content says."""

    path: Path
    kind: str  # SPK, CK, PCK, IK, FK, LSK, SCLK, DSK, EK, META, or TEXT where nothing tells more

    @property
    def sha256(self) -> str:
        """SHA-256 in hexadecimal, computed when first asked for and again only if the file has changed."""
        return _sha256(str(self.path), *_state(self.path))


def kernel_file(path: Path) -> KernelFile:
    """Look at a kernel file before SPICE does.

    Raises
    ------
    KernelError
        The file cannot be read, is not a kernel, or is a binary kernel cut short or damaged.
    """
    kind, _ = _inspect(str(path), *_state(path))
    return KernelFile(path, kind)


def segments(path: Path) -> tuple[Segment, ...]:
    """Return the segment summaries of a binary SPK, CK or PCK; none for other kernels."""
    return _inspect(str(path), *_state(path))[1]


def is_binary(path: Path) -> bool:
    """Tell a binary kernel from a text kernel, by its first word."""
    with path.open("rb") as stream:
        return stream.read(8).rstrip(b" \x00") in BINARY_KINDS


def looks_like_kernel(path: Path) -> bool:
    """Tell whether a file of a folder is meant as a kernel, by suffix or content; labels, notes are not."""
    if path.suffix.lower() in SUFFIX_KINDS:
        return True
    with path.open("rb") as stream:
        word = stream.read(SHOWN_BYTES)
    return any(word.startswith(known) for known in (*BINARY_KINDS, *TEXT_KINDS))


def _state(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}; check the path.") from error
    return status.st_mtime_ns, status.st_size


@functools.lru_cache(maxsize=1024)
def _sha256(path: str, mtime_ns: int, size: int) -> str:  # noqa: ARG001 (the file's state is the cache's key)
    return sha256_of(path)


@functools.lru_cache(maxsize=1024)
def _inspect(path: str, mtime_ns: int, size: int) -> tuple[str, tuple[Segment, ...]]:  # noqa: ARG001
    file = Path(path)
    try:
        with file.open("rb") as stream:
            start = stream.read(RECORD_BYTES)
            word = start[:8].rstrip(b" \x00")
            if word in BINARY_KINDS:
                return _inspect_binary(file, word, size)
            text = start + stream.read(LARGEST_TEXT_BYTES)
    except OSError as error:
        raise KernelError(f"cannot read {path}: {error.strerror or error}; check its permissions.") from error
    return _text_kind(file, text), ()


def _inspect_binary(file: Path, word: bytes, size: int) -> tuple[str, tuple[Segment, ...]]:
    kind = BINARY_KINDS[word]
    if word.startswith(b"DAF"):
        return kind, read_segments(file, kind)
    if size % RECORD_BYTES:
        raise KernelError(
            f"{file} is not a whole kernel: {size} bytes are no multiple of {RECORD_BYTES}; fetch it again."
        )
    return kind, ()


def _text_kind(file: Path, text: bytes) -> str:
    if text.startswith(TRANSFER_WORDS):
        raise KernelError(f"{file} is a kernel in transfer format; make it binary with NAIF's TOBIN first.")
    if b"\x00" in text or b"\\begindata" not in text:
        shown = text[:SHOWN_BYTES].decode("ascii", "backslashreplace").split("\n")[0]
        reason = "zero bytes within text" if b"\\begindata" in text else f"it starts with {shown!r}"
        if text.startswith(b"KPL/") and b"\x00" not in text:
            reason = f"it says {shown!r} but has no \\begindata and so no data"
        raise KernelError(
            f"{file} is not a SPICE kernel: {reason} ({len(text)} bytes); fetch it again or give another."
        )
    if any(LISTS_KERNELS.search(part.split(b"\\begintext")[0]) for part in text.split(b"\\begindata")[1:]):
        return "META"
    named = next((kind for word, kind in TEXT_KINDS.items() if text.startswith(word)), None)
    return named or SUFFIX_KINDS.get(file.suffix.lower(), "TEXT")
