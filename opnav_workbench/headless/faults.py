"""Faults: what went wrong with a picture, and whether another try may come to another result.

=========  ==========================================  ==============  =================================
fault      of what                                     tried again     the picture's folder and archive
=========  ==========================================  ==============  =================================
picture    the picture, or what it is processed with   once it is      a failed result
                                                       another one
notebook   a cell: a defect of program or notebook     once it is      a failed result
                                                       another one
limit      time or memory                              with a higher   a failed result
                                                       limit
machine    whatever the operating system refused: a    at once, and    an older result stays; the archive
           file, memory, a process, a worker           the next night  is told nothing
=========  ==========================================  ==============  =================================

What a file holds is the picture's matter; that it cannot be read is the machine's.  So an error with a number of the
operating system anywhere in its chain of causes is passing, whatever words it was given on its way up.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from opnav_workbench import errors

__all__ = ["FAULTS", "FaultPolicy", "fault_of_report", "is_raised"]


@dataclass(frozen=True, slots=True)
class FaultPolicy:
    """What is done about a kind of fault.

    Attributes
    ----------
    again_at_once
        Whether the same night tries again.
    again_next_night : {"changed", "raised", "always"}
        With other inputs only; also with a higher limit; in any case.
    is_result
        Whether it tells something of the picture, so that it stands in its folder and in the archive.
    """

    words: str
    again_at_once: bool
    again_next_night: str
    is_result: bool


FAULTS: Mapping[str, FaultPolicy] = {
    "": FaultPolicy("none", False, "changed", True),
    "picture": FaultPolicy("the picture or its inputs", False, "changed", True),
    "notebook": FaultPolicy("a cell of the notebook", False, "changed", True),
    "limit": FaultPolicy("a limit of time or memory", False, "raised", True),
    "machine": FaultPolicy("the machine", True, "always", False),
}

COLORS = re.compile(r"\x1b\[[0-9;]*m")
REFUSED = re.compile(r"\[Errno \d+\]")
NO_MEMORY = re.compile(r"^\S*MemoryError\b", re.MULTILINE)


def fault_of_report(report: Mapping[str, Any], executed: str) -> tuple[str, str]:
    """Return fault and reason from what `notebook_run` reports.

    Parameters
    ----------
    report : mapping
        ``ok``; else ``kind`` ("cell" or "machine"), ``ename``, ``evalue``, ``traceback`` (with the causes).
    executed
        Name of the executed notebook, for the reason.

    Examples
    --------
    >>> cell = {"ok": False, "kind": "cell", "ename": "ImageError", "evalue": "a.fit: truncated", "traceback": []}
    >>> fault_of_report(cell, "notebook.ipynb")
    ('picture', 'a.fit: truncated')
    >>> refused = "OSError: [Errno 116] Stale file handle: '/nfs/a.fit'"
    >>> fault_of_report({**cell, "evalue": "a.fit: cannot be read", "traceback": [refused]}, "notebook.ipynb")
    ('machine', 'a.fit: cannot be read')
    """
    if report["ok"]:
        return "", ""
    said = " ".join(str(report["evalue"]).split())
    if report["kind"] == "machine":
        return "machine", f"{report['ename']}: {said}"
    known = getattr(errors, report["ename"], None)
    ours = isinstance(known, type) and issubclass(known, errors.OpNavError)
    reason = said if ours else f"a cell raised {report['ename']}: {said} (see {executed})"
    if _is_passing(report):
        return "machine", reason
    return ("picture" if ours else "notebook"), reason


def _is_passing(report: Mapping[str, Any]) -> bool:
    told = COLORS.sub("", "\n".join([f"{report['ename']}: {report['evalue']}", *report.get("traceback", ())]))
    return bool(REFUSED.search(told) or NO_MEMORY.search(told))


def is_raised(before: Mapping[str, float], now: Mapping[str, float]) -> bool:
    """Tell whether a limit is higher than it was.

    Examples
    --------
    >>> is_raised({"time_limit_s": 300.0}, {"time_limit_s": 600.0})
    True
    """
    return any(value > before[name] for name, value in now.items() if name in before)
