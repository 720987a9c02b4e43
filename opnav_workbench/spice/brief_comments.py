"""What a kernel's makers say in it: the comment area of a binary kernel, the text above a text kernel's data."""

import re
from collections.abc import Iterable

import spiceypy

from opnav_workbench.spice.files import KernelFile, is_binary

__all__ = ["comment_head"]

LINES = 12  # that are looked at and not blank: a title and where it comes from
LINES_READ = 60
RULES = frozenset("-=*_#;")  # lines of these alone say nothing


def comment_head(file: KernelFile) -> tuple[str, ...]:
    """Return the first lines of a kernel's comments that say something; lock held."""
    lines = _binary_lines(file) if is_binary(file.path) else _text_lines(file)
    told = [" ".join(line.split()).removeprefix("; ") for line in lines if set(line.strip()) - RULES]
    return tuple(told[:LINES])


def _text_lines(file: KernelFile) -> list[str]:
    text = file.path.read_text(encoding="latin-1").partition("\\begindata")[0]
    text = re.sub(r"\\beginlabel.*?\\endlabel", "", text, flags=re.DOTALL)  # for the archive, not for people
    return [line for line in text.splitlines() if not line.startswith(("KPL/", "\\begintext"))]


def _binary_lines(file: KernelFile) -> Iterable[str]:
    das = file.kind in ("DSK", "EK")
    start, stop, read = (
        (spiceypy.dasopr, spiceypy.dascls, spiceypy.dasec)
        if das
        else (spiceypy.dafopr, spiceypy.dafcls, spiceypy.dafec)
    )
    handle = start(str(file.path))
    try:
        count, lines, _ = read(handle, LINES_READ)
        return list(lines)[:count]
    finally:
        stop(handle)
