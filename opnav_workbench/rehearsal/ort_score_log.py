"""The log of reveals: what stood in a team's files when the truth was opened, so that a later change shows as such.

It is the director's: a file beside the key, a line of JSON a reveal.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import sha256_of, write_text

__all__ = ["Delivery", "log_path", "logged_delivery"]

SUFFIX = ".reveals.jsonl"
COUNTED = ("result.json", "observables.ecsv")


@dataclass(frozen=True, slots=True)
class Delivery:
    """What a team had delivered when the truth was opened for it.

    Attributes
    ----------
    utc : str
        Of this reveal.
    files : mapping of str to str
        SHA-256 by path in the team's folder.
    altered : tuple of str
        Files that differ from those at the first reveal for this folder.
    opened_before : tuple of str
        UTC of earlier reveals, for any folder.
    """

    utc: str
    files: Mapping[str, str]
    altered: tuple[str, ...]
    opened_before: tuple[str, ...]


def log_path(key: str | Path) -> Path:
    """Return the log that belongs to a key file."""
    return Path(key).with_name(Path(key).name + SUFFIX)


@contextmanager
def logged_delivery(
    key: str | Path, package: str, run: str | Path, names: Sequence[str], solution: Path
) -> Iterator[Delivery]:
    """Write down what a team has delivered; the truth is opened inside. If that fails, the line is taken back.

    Parameters
    ----------
    key : path
        Key file of the package; the log stands beside it.
    package : str
    run : path
        The team's folder.
    names : sequence of str
        Of the pictures.
    solution : Path
        The team's solution file.

    Raises
    ------
    SessionError
        There is no such key, or the log cannot be read or written: then the truth must not be opened.
    """
    if not Path(key).is_file():
        raise SessionError(f"no key {key}; the director of the rehearsal has it. Give it with --key.")
    folder, path = Path(run).resolve(), log_path(key)
    files = {
        str(f.relative_to(folder) if f.is_relative_to(folder) else f): sha256_of(f)
        for f in [solution.resolve(), *(folder / name / counted for name in names for counted in COUNTED)]
        if f.is_file()
    }
    earlier = _read(path)
    first = next((entry["files"] for entry in earlier if entry["run"] == str(folder)), files)
    altered = tuple(sorted(name for name in {*first, *files} if first.get(name) != files.get(name)))
    now = datetime.now(UTC).isoformat(timespec="seconds")
    entry = {"utc": now, "package": package, "run": str(folder), "files": files}
    _write(path, [*earlier, entry])
    try:
        yield Delivery(now, files, altered, tuple(str(line["utc"]) for line in earlier))
    except OpNavError:
        _write(path, earlier)
        raise


def _write(path: Path, entries: Sequence[Mapping[str, Any]]) -> None:
    write_text(path, "".join(json.dumps(entry) + "\n" for entry in entries))


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    try:
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise SessionError(
            f"the log of reveals {path} cannot be read ({error}); without it nobody can tell what was delivered blind."
        ) from error
