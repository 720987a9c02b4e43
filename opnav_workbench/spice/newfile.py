"""What all writers of binary kernels share: input checks, and new files that are whole or not there."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.spice.guard import spice_call
from opnav_workbench.spice.text_kernels import comment_lines

__all__ = ["as_kernel_error", "check_epochs", "check_finite", "new_daf", "new_das", "require_frame"]

TITLE_CHARS = 60  # DAF internal file name
NEWLINE = 1  # SPICE stores one mark at each end of line in the comment area


def check_epochs(et: FloatArray, least: int) -> None:
    """Raise ValueError unless there are enough epochs, finite and increasing."""
    if len(et) < least:
        raise ValueError(f"{len(et)} epochs, at least {least} are needed")
    check_finite(et, "et")
    late = np.flatnonzero(np.diff(et) <= 0.0)
    if len(late):
        i = int(late[0])
        raise ValueError(f"epochs must increase: number {i + 1} is {et[i + 1]}, after {et[i]}; sort them")


def check_finite(values: FloatArray, name: str) -> None:
    """Raise ValueError naming the first value that is not finite."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"{name}{bad[0].tolist()} is not finite ({len(bad)} such values)")


def require_frame(frame: str) -> None:
    """Raise KernelError unless SPICE knows the frame."""
    with spice_call(f"frame {frame}"):
        known = spiceypy.namfrm(frame) != 0
    if not known:
        raise KernelError(f"frame {frame!r} is unknown to SPICE; load the FK that defines it, or use J2000.")


@contextlib.contextmanager
def as_kernel_error(label: str) -> Iterator[None]:
    """Turn the ValueError of a check into a KernelError that says which file it is about."""
    try:
        yield
    except ValueError as error:
        raise KernelError(f"{label}: {error}.") from error


@contextlib.contextmanager
def new_daf(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
) -> Iterator[int]:
    """Yield the handle of a new DAF (SPK, CK) under a temporary name; leave no open handle, no half file."""
    with _new_file(path, start, finish, comment, spiceypy.dafac, spiceypy.dafcls) as handle:
        yield handle


@contextlib.contextmanager
def new_das(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
) -> Iterator[int]:
    """Yield the handle of a new DAS file (DSK) as `new_daf` does."""
    with _new_file(path, start, finish, comment, _add_das_comment, spiceypy.dascls) as handle:
        yield handle


def _add_das_comment(handle: int, lines: Sequence[str]) -> None:
    spiceypy.dasac(handle, list(lines))


@contextlib.contextmanager
def _new_file(
    path: str | os.PathLike[str],
    start: Callable[[str, str, int], int],
    finish: Callable[[int], None],
    comment: str,
    add_comment: Callable[[int, Sequence[str]], None],
    abandon: Callable[[int], None],
) -> Iterator[int]:
    lines = comment_lines(comment)
    final = Path(path)
    try:
        with atomic_path(final) as temporary, spice_call(f"writing {final}"):
            temporary.unlink()  # SPICE makes the file itself, and refuses one that exists
            size = sum(len(line) + NEWLINE for line in lines)
            handle = start(str(temporary), final.name[:TITLE_CHARS], size)
            try:
                if lines:
                    add_comment(handle, lines)
                yield handle
                finish(handle)
            except BaseException:
                with contextlib.suppress(spiceypy.SpiceyError):
                    abandon(handle)
                raise
    except SessionError as error:
        raise KernelError(str(error)) from error
