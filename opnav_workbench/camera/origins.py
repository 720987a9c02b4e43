"""Where the values of a camera come from: known from a source, derived from what it says, or guessed."""

from dataclasses import dataclass
from typing import Literal

__all__ = ["How", "Origin"]

How = Literal["known", "derived", "guessed"]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where one field of a camera comes from.

    Attributes
    ----------
    field
        Of `opnav_workbench.camera.Camera`.
    how
        ``known``: a source states it. ``derived``: it follows from what sources state, `text` says how. ``guessed``: no
        source states it, `text` says what was assumed; a picture must show whether it is right.
    text
        For a person: the value and why.
    """

    field: str
    how: How
    text: str

    def __str__(self) -> str:
        return f"{self.how:8} {self.field}: {self.text}"
