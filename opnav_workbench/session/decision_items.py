"""What a decisions file says of one picture: the fields, their types and their defaults.

Every item may say ``at: N``, its place in the session it was recorded from. Items of one session, ordered by it, are that
session; a file written by hand needs no ``at``.
"""

from collections.abc import Iterator
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from opnav_workbench.errors import SessionError
from opnav_workbench.session.body_finding import BodyMethod
from opnav_workbench.session.settings import Settings

__all__ = ["Item", "PictureDecisions"]

Text = Annotated[str, Field(min_length=1)]
Place = Annotated[int, Field(ge=1)]
Number = Annotated[int, Field(ge=0)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Item(_Strict):
    """One decision or step."""

    at: Place | None = None


class Verdict(Item):
    """A star accepted or rejected."""

    star: Text
    reason: str = ""


class PlacedStar(Item):
    """Where the analyst saw a star."""

    star: Text
    pixel: float
    line: float


class TwoStars(Item):
    """Two stars marked, by name or not, from which the field follows."""

    places: tuple[tuple[float, float], tuple[float, float]]
    stars: tuple[Text, Text] | None = None
    reason: str = ""


class Nudge(Item):
    """How far the analyst moved the field."""

    pixel: float
    line: float
    twist_deg: float = 0.0


class BodyCircle(Item):
    """Where the analyst saw a body; ``clear: true`` takes its circle away."""

    body: Text
    pixel: float | None = None
    line: float | None = None
    radius_px: PositiveFloat | None = None
    clear: bool = False

    @model_validator(mode="after")
    def _circle_or_none(self) -> "BodyCircle":
        given = [self.pixel is not None, self.line is not None, self.radius_px is not None]
        if any(given) if self.clear else not all(given):
            raise ValueError("give pixel, line and radius_px, or clear: true")
        return self


class Scans(Item):
    """Limb scans by number; without numbers they are automatic again."""

    body: Text
    numbers: tuple[Number, ...] | None = None
    reason: str = ""


class Method(Item):
    """How a body's center is found."""

    body: Text
    method: BodyMethod = "auto"
    search_radius_px: PositiveFloat | None = None
    circle: tuple[float, float, PositiveFloat] | None = None  # pixel, line, radius of this search alone
    scans: tuple[Number, ...] | None = None
    solve_range: bool = False


class Together(Item):
    """Bodies whose centers are found jointly."""

    bodies: Annotated[tuple[Text, ...], Field(min_length=2)]
    method: Literal["least_squares"] = "least_squares"


class Note(Item):
    """A remark."""

    text: Text


class Step(Item):
    """A step of the session that decides nothing; its parameters are those of the method of that name."""

    step: Literal[
        "predict", "find_stars", "refit_stars", "repoint", "add_target", "skip_target", "observables"
    ]
    initial: str | None = None
    final: str | None = None
    search_radius_px: PositiveFloat | None = None
    stars: tuple[Text, ...] | None = None
    template: Text | None = None
    model: str | None = None
    a_priori: bool = False
    name: Text | None = None
    reason: str = ""


def _known_settings(values: dict[str, Any]) -> dict[str, Any]:
    """Let `Settings` itself judge its names and values."""
    try:
        Settings.from_dict(values)
    except (SessionError, TypeError) as error:
        raise ValueError(str(error)) from error
    return values


class PictureDecisions(_Strict):
    """The decisions on one picture.

    Attributes
    ----------
    name : str
        Its file name; the key of the entry, its SHA-256, is what counts.
    who, when
        Analyst, and when the last decision was made.
    mission, catalog, attitude : str
        What the session was opened with.
    settings : mapping
        Settings of the session that differ from the defaults.
    reject, accept, place, two_stars, nudge, circles, scans, methods, together, notes, steps : sequences
        Items, see the classes above.
    """

    name: str = ""
    who: str = ""
    when: datetime | None = None
    mission: str = ""
    catalog: str = ""
    attitude: Literal["", "kernels", "header"] = ""
    settings: Annotated[dict[str, int | float], AfterValidator(_known_settings)] = {}
    reject: tuple[Verdict, ...] = ()
    accept: tuple[Verdict, ...] = ()
    place: tuple[PlacedStar, ...] = ()
    two_stars: tuple[TwoStars, ...] = ()
    nudge: tuple[Nudge, ...] = ()
    circles: tuple[BodyCircle, ...] = ()
    scans: tuple[Scans, ...] = ()
    methods: tuple[Method, ...] = ()
    together: tuple[Together, ...] = ()
    notes: tuple[Note, ...] = ()
    steps: tuple[Step, ...] = ()

    @model_validator(mode="after")
    def _places_once(self) -> "PictureDecisions":
        taken: dict[int, str] = {}
        for section, _, item in self.items():
            if item.at is not None and taken.setdefault(item.at, section) != section:
                raise ValueError(f"at: {item.at} stands in {taken[item.at]} and in {section}; it is one step")
        return self

    @property
    def recorded(self) -> bool:
        """Whether the whole session is recorded, so that it can be taken again step by step."""
        return any(item.at is not None for _, _, item in self.items())

    def items(self) -> Iterator[tuple[str, int, Item]]:
        """Yield every item with its section and its place there."""
        for section in SECTIONS:
            for number, item in enumerate(getattr(self, section)):
                yield section, number, item


SECTIONS = (
    "two_stars", "nudge", "place", "reject", "accept", "circles", "scans", "methods", "together", "notes", "steps"
)  # fmt: skip
