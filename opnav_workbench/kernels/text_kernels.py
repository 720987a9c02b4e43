"""SPICE text kernels: assignments as lines that every reader of them accepts, written whole or not at all.

Source: NAIF, Kernel Required Reading, "Text Kernel Specifications": 132 characters a line, 32 a name, 80 a string;
strings in quotes, quotes inside doubled; metakernel strings continued with ``+``.
"""

import math
import os
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np

from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import write_text

__all__ = ["metakernel_assignments", "write_text_kernel"]

TextKind = Literal["FK", "IK", "SCLK", "PCK", "MK"]
KINDS = ("FK", "IK", "SCLK", "PCK", "MK")
LINE_CHARS = 80  # SPICE allows 132; 80 is what people's screens and NAIF's own files have
NAME_CHARS = 32
STRING_CHARS = 80
INDENT = "    "
ALIGN_CHARS = 28
EXACT_INTEGER = 2**53  # SPICE keeps every number as a double
FORBIDDEN_IN_NAMES = frozenset("=()',")
# Several kernels add to these; "=" would throw away what the kernels loaded before have put there.
ACCUMULATED = frozenset({"NAIF_BODY_NAME", "NAIF_BODY_CODE", "TEXT_KERNEL_ID"})
MARKERS = ("\\begindata", "\\begintext")


def write_text_kernel(
    path: str | os.PathLike[str], kind: TextKind, assignments: Mapping[str, Any], comment: str = ""
) -> None:
    r"""Write a SPICE text kernel.

    Parameters
    ----------
    path : path
        An older file of that name is replaced once the new one is whole.
    kind : {"FK", "IK", "SCLK", "PCK", "MK"}
        Goes into the ``KPL/`` line, by which SPICE and people know the file.
    assignments
        Pool variables: a number, a string, or a sequence of either alone. Numbers are written with 17 digits
        (SPICE's reader gives them back to 1e-15 relative).
    comment
        Text for people, above the data; it is wrapped, and characters that are not ASCII become ``?``.

    Raises
    ------
    KernelError
        A name or value that no text kernel can hold, or a folder that cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "moon.tpc")
    ...     write_text_kernel(path, "PCK", {"BODY901_RADII": (606.0, 606.0, 606.0)}, "Nimmo et al. (2017).")
    ...     print(path.read_text(), end="")
    KPL/PCK
    <BLANKLINE>
    Nimmo et al. (2017).
    <BLANKLINE>
    \begindata
    <BLANKLINE>
    BODY901_RADII                = ( 606.0, 606.0, 606.0 )
    <BLANKLINE>
    \begintext
    """
    if kind not in KINDS:
        raise KernelError(f"{kind!r} is not a kind of text kernel; choose one of {', '.join(KINDS)}.")
    data = [line for name, value in assignments.items() for line in _assignment(name, value, kind)]
    if not data:
        raise KernelError(f"{path}: no assignments; a kernel without data is of no use.")
    lines = [f"KPL/{kind}", "", *comment_lines(comment), "", MARKERS[0], "", *data, "", MARKERS[1]]
    try:
        write_text(path, "\n".join(lines) + "\n")
    except SessionError as error:
        raise KernelError(str(error)) from error


def comment_lines(comment: str) -> list[str]:
    """Return a comment as ASCII lines of at most 80 characters; paragraphs and indented lines are kept."""
    lines: list[str] = []
    for line in comment.encode("ascii", "replace").decode().expandtabs().splitlines():
        if line.strip().startswith(MARKERS):
            raise KernelError(f"comment line {line.strip()!r} would switch data on or off; reword it.")
        lines += textwrap.wrap(line, LINE_CHARS, drop_whitespace=True) or [""]
    return lines


def metakernel_assignments(files: Iterable[str]) -> dict[str, Any]:
    """Return the assignments of a metakernel for files that stand beside it, in loading order.

    Examples
    --------
    >>> metakernel_assignments(["naif.tls"])["KERNELS_TO_LOAD"]
    ('$KERNELS/naif.tls',)
    """
    return {
        "PATH_VALUES": (".",),
        "PATH_SYMBOLS": ("KERNELS",),
        "KERNELS_TO_LOAD": tuple(f"$KERNELS/{name}" for name in files),
    }


def _assignment(name: str, value: Any, kind: str) -> Iterator[str]:
    _check_name(name)
    items = list(_texts(name, value, kind))
    sign = "+=" if name in ACCUMULATED else "="
    head = f"{name:<{ALIGN_CHARS}} {sign}"
    if isinstance(value, str) or np.ndim(value) == 0:
        items_line = f"{head} {items[0]}"
    else:
        items_line = f"{head} ( {', '.join(items)} )"
    if len(items) == 1 or len(items_line) <= LINE_CHARS:
        yield items_line
        return
    yield f"{head} ("
    yield from _packed(items)
    yield INDENT + ")"


def _packed(items: list[str]) -> Iterator[str]:
    """Put as many values on a line as fit, three of them at most: vectors, matrix rows and clock triplets."""
    row: list[str] = []
    for item in items:
        if len(row) == 3 or (row and len(", ".join([*row, item])) + len(INDENT) >= LINE_CHARS):
            yield INDENT + ", ".join(row) + ","
            row = []
        row.append(item)
    yield INDENT + ", ".join(row)


def _check_name(name: str) -> None:
    bad = not name or len(name) > NAME_CHARS or not name.isascii() or not name.isprintable()
    if bad or " " in name or FORBIDDEN_IN_NAMES & set(name):
        raise KernelError(
            f"{name!r} is no name for a kernel variable: 1 to {NAME_CHARS} ASCII characters, "
            "no blanks, brackets, commas, quotes or equals signs."
        )


def _texts(name: str, value: Any, kind: str) -> Iterator[str]:
    values = [value] if isinstance(value, str) or np.ndim(value) == 0 else list(value)
    if not values:
        raise KernelError(f"{name}: an empty list; leave the variable out.")
    if len({isinstance(v, str) for v in values}) > 1:
        raise KernelError(f"{name}: strings and numbers mixed; SPICE keeps variables of one kind only.")
    for v in values:
        if isinstance(v, str):
            yield from _string(name, v, kind)
        else:
            yield _number(name, v)


def _string(name: str, value: str, kind: str) -> Iterator[str]:
    if not value or not value.isascii() or not value.isprintable():
        raise KernelError(f"{name}: {value!r} is empty or not all printable ASCII.")
    if len(value) > STRING_CHARS and kind != "MK":
        raise KernelError(
            f"{name}: a string of {len(value)} characters; SPICE keeps {STRING_CHARS}. Shorten it."
        )
    while len(value) > STRING_CHARS:
        yield _quoted(value[: STRING_CHARS - 1] + "+")
        value = value[STRING_CHARS - 1 :]
    yield _quoted(value)


def _quoted(value: str) -> str:
    return "'" + value.replace("'", "''") + "'"


def _number(name: str, value: Any) -> str:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise KernelError(f"{name}: {value!r} is neither a number nor a string; SPICE knows nothing else.")
    if isinstance(value, int | np.integer):
        if abs(int(value)) > EXACT_INTEGER:
            raise KernelError(f"{name}: {value} is beyond 2^53, SPICE's largest exact whole number.")
        return str(int(value))
    if not math.isfinite(value):
        raise KernelError(f"{name}: {value} is not finite; leave the variable out or give a number.")
    return repr(float(value))
