"""What a single kernel holds, as NAIF's brief, ckbrief and dskbrief tell it: who, when, of which type, and why.

The last is what its makers say in it: the first lines of the comment area of a binary kernel, or of the text above the
data of a text kernel.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import spiceypy

from opnav_workbench.kernels import pool
from opnav_workbench.kernels.calls import spice_call, time_text
from opnav_workbench.kernels.dsk_files import dla_segments
from opnav_workbench.kernels.files import KernelFile, is_binary, kernel_file, segments
from opnav_workbench.kernels.loading import listed_files
from opnav_workbench.kernels.time import packaged_leap_seconds

__all__ = ["BriefRow", "BriefVariable", "KernelBrief", "brief"]


# ---- What a kernel's makers say in it.

COMMENT_LINES = 12  # that are looked at and not blank: a title and where it comes from
COMMENT_LINES_READ = 60
RULE_CHARS = frozenset("-=*_#;")  # lines of these alone say nothing


def comment_head(file: KernelFile) -> tuple[str, ...]:
    """Return the first lines of a kernel's comments that say something; lock held."""
    lines = _binary_lines(file) if is_binary(file.path) else _text_lines(file)
    told = [" ".join(line.split()).removeprefix("; ") for line in lines if set(line.strip()) - RULE_CHARS]
    return tuple(told[:COMMENT_LINES])


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
        count, lines, _ = read(handle, COMMENT_LINES_READ)
        return list(lines)[:count]
    finally:
        stop(handle)


# ---- What a single kernel holds, as NAIF's brief, ckbrief and dskbrief tell it.

TOUCHING_S = 1e-6  # segments nearer than this are told as one; ticks of flight clocks are longer


@dataclass(frozen=True, slots=True)
class BriefRow:
    """What one body, structure or surface has in a kernel.

    Attributes
    ----------
    number, name
        Of body (SPK, DSK), structure (CK) or frame class (PCK).
    relative_to
        Center (SPK), reference frame (CK, PCK) or body-fixed frame (DSK).
    frame
        Of an SPK's states; empty elsewhere.
    data_type
        Of the segments, such as 13.
    spans : tuple of (str, str)
        Disjoint stretches, UTC; a CK's in clock ticks while its clock is not at hand. A DSK has none.
    note
        Angular rates of a CK; size and surface of a DSK.
    """

    number: int
    name: str
    relative_to: str
    frame: str
    data_type: int
    n_segments: int
    spans: tuple[tuple[str, str], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class BriefVariable:
    """A variable of a text kernel."""

    name: str
    count: int
    first: str  # its first value


@dataclass(frozen=True, slots=True)
class KernelBrief:
    """What a kernel holds.

    Attributes
    ----------
    size
        Bytes.
    comments
        First lines of its comment area, or of the text above the data; blank ones left out.
    rows
        Of a binary kernel.
    variables
        Of a text kernel.
    listed
        Files that a metakernel lists.
    """

    file: KernelFile
    size: int
    comments: tuple[str, ...]
    rows: tuple[BriefRow, ...] = ()
    variables: tuple[BriefVariable, ...] = ()
    listed: tuple[Path, ...] = ()


def brief(path: str | PathLike[str], extra: Sequence[str | PathLike[str]] = ()) -> KernelBrief:
    """Tell what a kernel holds.

    Parameters
    ----------
    path : path-like
    extra
        Kernels that help to read it: the SCLK of a CK, the FK that names its frames. Leap seconds are at hand.

    Raises
    ------
    KernelError
        The file is no whole kernel.

    Examples
    --------
    >>> with packaged_leap_seconds() as lsk:
    ...     told = brief(lsk)
    >>> told.file.kind, [v.name for v in told.variables][:2]
    ('LSK', ['DELTET/DELTA_AT', 'DELTET/DELTA_T_A'])
    """
    file = kernel_file(Path(path).absolute())
    helpers = [kernel_file(Path(name).absolute()) for name in extra]
    with spice_call(f"looking into {file.path}"), pool.isolated():
        size, comments = file.path.stat().st_size, comment_head(file)
        if file.kind == "META":
            return KernelBrief(file, size, comments, listed=tuple(listed_files(file.path, here_first=True)))
        with packaged_leap_seconds() as lsk:
            for helper in (lsk, *(h.path for h in helpers if h.kind not in ("META", "EK"))):
                spiceypy.furnsh(str(helper))
        if file.kind in ROW_READERS and is_binary(file.path):
            return KernelBrief(file, size, comments, ROW_READERS[file.kind](file.path))
        return KernelBrief(file, size, comments, variables=_variables(file.path))


def _variables(path: Path) -> tuple[BriefVariable, ...]:
    spiceypy.clpool()
    spiceypy.ldpool(str(path))
    values = {name: pool.pool_value(name) or () for name in sorted(pool.pool_names("*"))}
    return tuple(BriefVariable(name, len(v), str(v[0]).strip() if v else "") for name, v in values.items())


def _grouped(path: Path) -> list[tuple[tuple[int, ...], list[tuple[float, float]]]]:
    """Return the time spans of segments that differ in nothing else but their place in the file."""
    groups: dict[tuple[int, ...], list[tuple[float, float]]] = {}
    for segment in segments(path):
        groups.setdefault(segment.integers[:-2], []).append(segment.doubles)
    return sorted(groups.items())


def _spk_rows(path: Path) -> tuple[BriefRow, ...]:
    return tuple(
        BriefRow(
            body,
            _body_name(body),
            _body_name(center),
            _frame_name(frame),
            data_type,
            len(times),
            _utc_spans(times),
        )
        for (body, center, frame, data_type), times in _grouped(path)
    )


def _ck_rows(path: Path) -> tuple[BriefRow, ...]:
    return tuple(
        BriefRow(
            structure, _frame_name(structure), _frame_name(frame), "", data_type, len(ticks), _clock_spans(structure, ticks),
            "with rates" if rates else "no rates",
        )
        for (structure, frame, data_type, rates), ticks in reversed(_grouped(path))
    )  # fmt: skip


def _pck_rows(path: Path) -> tuple[BriefRow, ...]:
    return tuple(
        BriefRow(number, str(number), _frame_name(frame), "", data_type, len(times), _utc_spans(times))
        for (number, frame, data_type), times in _grouped(path)
    )


def _dsk_rows(path: Path) -> tuple[BriefRow, ...]:
    handle = spiceypy.dasopr(str(path))
    try:
        return tuple(_dsk_row(handle, segment) for segment in dla_segments(handle))
    finally:
        spiceypy.dascls(handle)


def _dsk_row(handle: int, segment: spiceypy.utils.support_types.SpiceDLADescr) -> BriefRow:
    d = spiceypy.dskgd(handle, segment)
    note = f"surface {d.surfce}"
    if d.dtype == 2:  # a plate model
        vertices, plates = spiceypy.dskz02(handle, segment)
        note += f", {vertices} vertices, {plates} plates"
    return BriefRow(d.center, _body_name(d.center), _frame_name(d.frmcde), "", d.dtype, 1, (), note)


ROW_READERS = {"SPK": _spk_rows, "CK": _ck_rows, "PCK": _pck_rows, "DSK": _dsk_rows}


def _body_name(number: int) -> str:
    return str(spiceypy.bodc2s(number))


def _frame_name(number: int) -> str:
    return str(spiceypy.frmnam(number) or number)


def _utc_spans(times: list[tuple[float, float]]) -> tuple[tuple[str, str], ...]:
    return tuple((time_text(start), time_text(stop)) for start, stop in _joined_spans(times))


def _clock_spans(structure: int, ticks: list[tuple[float, float]]) -> tuple[tuple[str, str], ...]:
    clock = spiceypy.ckmeta(structure, "SCLK")
    if not pool.has_clock(clock):
        return tuple((f"tick {start:.0f}", f"tick {stop:.0f}") for start, stop in _joined_spans(ticks))
    return _utc_spans([(spiceypy.sct2e(clock, start), spiceypy.sct2e(clock, stop)) for start, stop in ticks])


def _joined_spans(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    joined: list[tuple[float, float]] = []
    for start, stop in sorted(spans):
        if joined and start <= joined[-1][1] + TOUCHING_S:
            joined[-1] = (joined[-1][0], max(stop, joined[-1][1]))
        else:
            joined.append((start, stop))
    return joined
