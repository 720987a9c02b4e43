"""`format_version`: what files of each kind promise, and files of older versions read as those of today.

Version 0 is what was written before files said their version.  `PROMISE` holds for every kind.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from opnav_workbench.errors import OpNavError

__all__ = ["FORMAT_KEY", "PRESENT_VERSION", "PROMISE", "as_of_today", "stamped", "unstamped"]

FORMAT_KEY = "format_version"
PRESENT_VERSION: Mapping[str, int] = MappingProxyType(
    {
        "result": 1,
        "session": 1,
        "status": 1,
        "observables": 1,
        "body": 1,
        "maplets": 1,
        "effective_psf": 1,
        "yaml": 1,
    }
)
_COMMON = (
    "Within one format_version fields may be added, and nothing else: none is removed or renamed, none gets another "
    "unit, sign, frame or meaning. Any other change raises format_version by one; this program reads every version up "
    "to its own. "
)
# By whether people write the files (YAML) or the program does.
PROMISE: Mapping[bool, str] = MappingProxyType(
    {
        False: _COMMON + "Whoever reads these files passes over fields that he does not know.",
        True: _COMMON
        + "A file without format_version is of the newest; an unknown field is an error, for it is a misspelt one.",
    }
)


def stamped(kind: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a file's content with its version in front.

    Examples
    --------
    >>> stamped("result", {"image": "a.fit"})
    {'format_version': 1, 'image': 'a.fit'}
    """
    return {FORMAT_KEY: PRESENT_VERSION[kind]} | dict(content)


def unstamped(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a file's content without its version.

    Examples
    --------
    >>> unstamped({"format_version": 1, "image": "a.fit"})
    {'image': 'a.fit'}
    """
    return {key: value for key, value in content.items() if key != FORMAT_KEY}


def as_of_today(
    kind: str, content: Mapping[str, Any], label: str, failure: type[OpNavError]
) -> dict[str, Any]:
    """Return a file's content as a file of the present version has it.

    Parameters
    ----------
    kind
        One of `PRESENT_VERSION`.
    label
        The file, for the message.
    failure
        The error to raise.

    Raises
    ------
    OpNavError
        Of type `failure`: the version is none, or a newer one than this program knows.

    Examples
    --------
    >>> as_of_today("session", {"schema": 1, "image": "a.fit"}, "session.json", OpNavError)
    {'format_version': 1, 'image': 'a.fit'}
    """
    newest = PRESENT_VERSION[kind]
    version = content.get(FORMAT_KEY, 0)
    if isinstance(version, bool) or not isinstance(version, int) or version < 0:
        raise failure(
            f"{label}: {FORMAT_KEY}: {version!r} is no version; it is a whole number, now {newest}."
        )
    if version > newest:
        raise failure(
            f"{label}: {FORMAT_KEY}: {version} is newer than this program knows ({newest}); use the version that wrote it."
        )
    today = dict(content)
    for step in range(version, newest):
        today = STEPS.get((kind, step), _unchanged)(today, label, failure)
    return stamped(kind, unstamped(today))


# ---- From one version to the next: what changed.

FIRST_SCHEMA = 1  # version 0 of these kinds said "schema": 1


Step = Callable[[dict[str, Any], str, type[OpNavError]], dict[str, Any]]


def _unchanged(content: dict[str, Any], _label: str, _failure: type[OpNavError]) -> dict[str, Any]:
    return content


def _without_schema(content: dict[str, Any], label: str, failure: type[OpNavError]) -> dict[str, Any]:
    schema = content.pop("schema", None)
    if isinstance(schema, bool) or schema != FIRST_SCHEMA:
        raise failure(f"{label}: {FORMAT_KEY} is missing; give a file that this program wrote.")
    return content


STEPS: Mapping[tuple[str, int], Step] = MappingProxyType(
    {("session", 0): _without_schema, ("observables", 0): _without_schema}
)
