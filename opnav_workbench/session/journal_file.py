"""journal.jsonl: the steps since session.json was written, one line each, on disk before the step's method returns.

A line holds the entry, its place in the journal, a check of the entry before it, and what kernels and catalog gave for
this step. A line that a crash cut short is not read; what follows a line that does not fit is not read either.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opnav_workbench.files import plain_values
from opnav_workbench.session.journal import JournalEntry

__all__ = ["JOURNAL_FILE", "JournalTail", "journal_line", "read_tail"]

JOURNAL_FILE = "journal.jsonl"
CHECK_DIGITS = 12


@dataclass(frozen=True, slots=True, eq=False)
class JournalTail:
    """What a journal file adds to a session.

    Attributes
    ----------
    entries : tuple of JournalEntry
    inputs : tuple of mapping
        What the steps added to the inputs, as `storage` writes them.
    length : int
        Bytes of the file that are whole and belong to the session.
    note : str
        What was left out, and why; empty as a rule.
    """

    entries: tuple[JournalEntry, ...]
    inputs: tuple[Mapping[str, Any], ...]
    length: int
    note: str = ""


def journal_line(
    session: str, number: int, before: JournalEntry | None, item: JournalEntry, inputs: Mapping[str, Any]
) -> bytes:
    """Return the line of the entry at place `number` (from 0) of the journal."""
    data = {"session": session, "n": number, "after": _check(before), "entry": item.to_dict()}
    if inputs:
        data["inputs"] = inputs
    text = json.dumps(plain_values(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.encode() + b"\n"


def _check(item: JournalEntry | None) -> str:
    """Return a short check of an entry, so that a line is read after no other than the one it was written after."""
    if item is None:
        return ""
    text = json.dumps(plain_values(item.to_dict()), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:CHECK_DIGITS]


def read_tail(path: Path, session: str, journal: Sequence[JournalEntry]) -> JournalTail:
    """Read what a journal file adds to the `journal` of session.json.

    Raises
    ------
    OSError
        It is there, but cannot be read.
    """
    if not path.exists():
        return JournalTail((), (), 0)
    content, known = path.read_bytes(), list(journal)
    inputs: list[Mapping[str, Any]] = []
    length = 0
    for number, raw in enumerate(content.splitlines(keepends=True), start=1):
        line = _parsed(raw)
        if line is None:
            what = "the last line" if length + len(raw) == len(content) else f"line {number} and what follows"
            note = f"{path.name}: {what} was cut short by a crash and is left out"
            return JournalTail(tuple(known[len(journal) :]), tuple(inputs), length, note)
        if line["session"] != session or line["n"] > len(known):
            return JournalTail(
                tuple(known[len(journal) :]), tuple(inputs), length, _foreign(path, number, len(content))
            )
        if line["n"] == len(known):
            if line["after"] != _check(known[-1] if known else None):
                note = _foreign(path, number, len(content))
                return JournalTail(tuple(known[len(journal) :]), tuple(inputs), length, note)
            known.append(JournalEntry(**line["entry"]))
            inputs.append(line.get("inputs", {}))
        length += len(raw)
    return JournalTail(tuple(known[len(journal) :]), tuple(inputs), length)


def _foreign(path: Path, number: int, _size: int) -> str:
    return f"{path.name}: from line {number} on it belongs to another session and is left out"


def _parsed(raw: bytes) -> dict[str, Any] | None:
    """Return a line's content; None for one that is not whole."""
    if not raw.endswith(b"\n"):
        return None
    try:
        line = json.loads(raw)
        entry = line["entry"]
        whole = isinstance(line["n"], int) and {"session", "after"} <= set(line) and isinstance(entry, dict)
        JournalEntry(**entry)
    except (ValueError, KeyError, TypeError):
        return None
    return line if whole else None
