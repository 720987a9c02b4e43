"""The journal: every step and decision with its time, parameters, reason and outcome, in order."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

__all__ = ["JournalEntry", "entry"]


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One step of a session.

    Attributes
    ----------
    step : str
        The `ImageSession` method called.
    parameters : mapping
        Its arguments as plain values; replaying them reproduces the state.
    reason : str
        Why, in the analyst's words.
    outcome : str
        One line of what came out.
    time_utc : str
        When, ISO 8601.
    """

    step: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    outcome: str = ""
    time_utc: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain values."""
        return asdict(self)


def entry(step: str, parameters: Mapping[str, Any], reason: str, outcome: str) -> JournalEntry:
    """Return a journal entry stamped with the present time."""
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    return JournalEntry(step, dict(parameters), reason, outcome, now)
