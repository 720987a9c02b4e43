"""Decisions: what an analyst decided on pictures, as a file (YAML) that headless runs carry out.

::

    images:
      8c2f...e1:                         # SHA-256 of the picture (or its file name, or "*" for every picture)
        name: lor_0299.fit
        who: M. Jones
        when: 2015-07-12T10:04:11+00:00
        reject:
        - {star: TYC 1234-567-1, reason: cosmic ray}
        accept:
        - {star: "row:17", reason: faint but clean}
        circles:
        - {body: PLUTO, pixel: 512.0, line: 488.5, radius_px: 95.0}
        bodies:
        - {body: COMET, pixel: 700.0, line: 91.5, radius_px: 40.0, radii_km: [2.0, 1.6, 1.5]}
        scans:
        - {body: PLUTO, numbers: [3, 4, 5, 20, 21], reason: even surface}

Methods
-------
        - {body: PLUTO, method: limb_scan}
        notes:
        - {text: stray light in the corner}

Every item may say ``at: N``, its place in the session it was recorded from.  A file that `Decisions.from_session` wrote
has the steps between the decisions too; ordered by ``at``, it is carried out as it was made, to the same bits.  A file
written by hand needs no ``at``.  Stars are named by catalog id, never by number.  Each kind of item names the
`ImageSession` method that it stands for.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PrivateAttr,
    field_validator,
    model_validator,
)

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import write_text
from opnav_workbench.session.history import JournalEntry
from opnav_workbench.session.inputs import AttitudeOrigin
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import BodyMethod
from opnav_workbench.stars.pointing import AttitudeMotion, SolvedAttitude
from opnav_workbench.yaml_file import StrictModel, line_of, read_model

if TYPE_CHECKING:
    from opnav_workbench.session.session import ImageSession

__all__ = ["Decisions", "load_decisions", "write_decisions"]


# ---- One picture: the fields, their types and their defaults.

NonEmptyText = Annotated[str, Field(min_length=1)]
StepNumber = Annotated[int, Field(ge=1)]
ScanNumber = Annotated[int, Field(ge=0)]


class DecisionItem(StrictModel):
    """One decision or step."""

    at: StepNumber | None = None


class StarDecision(DecisionItem):
    """A star accepted or rejected."""

    star: NonEmptyText
    reason: str = ""


class PlacedStar(DecisionItem):
    """Where the analyst saw a star."""

    star: NonEmptyText
    pixel: float
    line: float


class MarkedStars(DecisionItem):
    """Two stars marked, by name or not, from which the field follows."""

    places: tuple[tuple[float, float], tuple[float, float]]
    stars: tuple[NonEmptyText, NonEmptyText] | None = None
    reason: str = ""


class FieldNudge(DecisionItem):
    """How far the analyst moved the field."""

    pixel: float
    line: float
    twist_deg: float = 0.0


class BodyCircle(DecisionItem):
    """Where the analyst saw a body; ``clear: true`` takes its circle away."""

    body: NonEmptyText
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


class DescribedBody(DecisionItem):
    """A body as the analyst sees it, where no ephemeris knows it; see `ImageSession.describe_body`."""

    body: NonEmptyText
    pixel: float
    line: float
    radius_px: PositiveFloat | None = None
    radii_km: (
        PositiveFloat | Annotated[tuple[PositiveFloat, PositiveFloat, PositiveFloat], Field()] | None
    ) = None
    range_km: PositiveFloat | None = None
    phase_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    sun_deg: float | None = None
    lighting_sigma_deg: Annotated[float, Field(ge=0.0, le=57.0)] = 5.0
    north_deg: float | None = None
    sub_observer_deg: tuple[float, float] = (0.0, 0.0)
    reason: str = ""

    @model_validator(mode="after")
    def _size_or_range(self) -> "DescribedBody":
        if self.radius_px is None and self.range_km is None:
            raise ValueError("give radius_px or range_km")
        return self


class ScanSelection(DecisionItem):
    """Limb scans by number; without numbers they are automatic again."""

    body: NonEmptyText
    numbers: tuple[ScanNumber, ...] | None = None
    reason: str = ""


class BodySearch(DecisionItem):
    """How a body's center is found."""

    body: NonEmptyText
    method: BodyMethod = "auto"
    search_radius_px: PositiveFloat | None = None
    circle: tuple[float, float, PositiveFloat] | None = None  # pixel, line, radius of this search alone
    scans: tuple[ScanNumber, ...] | None = None
    solve_range: bool = False


class JointSearch(DecisionItem):
    """Bodies whose centers are found jointly."""

    bodies: Annotated[tuple[NonEmptyText, ...], Field(min_length=2)]
    method: Literal["least_squares"] = "least_squares"


class LandmarkSearch(DecisionItem):
    """A body whose landmarks are looked for; without a file of maplets, those of the mission."""

    body: NonEmptyText
    maplets: NonEmptyText | None = None
    search_radius_px: PositiveFloat | None = None
    position_sigma_km: PositiveFloat | None = None
    lost: bool = False


class LandmarkDecision(DecisionItem):
    """A landmark accepted or rejected."""

    body: NonEmptyText
    landmark: NonEmptyText
    reason: str = ""


class Remark(DecisionItem):
    """A remark."""

    text: NonEmptyText


Row3 = tuple[float, float, float]
Matrix3 = tuple[Row3, Row3, Row3]


class LentPointing(StrictModel):
    """A pointing that another picture's stars told; matrices as in `stars.pointing.SolvedAttitude`."""

    image: NonEmptyText
    et: float
    camera_from_j2000: Matrix3
    a_priori_camera_from_j2000: Matrix3
    covariance_rad2: Matrix3


class CarriedPointing(DecisionItem):
    """A pointing taken from other pictures, and how the error of a priori attitudes may have changed meanwhile."""

    neighbors: Annotated[tuple[LentPointing, ...], Field(min_length=1)]
    jitter_rad: float
    walk_rad: float = 0.0
    drift_rad_s: float = 0.0
    reason: str = ""


PlainStepName = Literal[
    "predict", "find_stars", "refit_stars", "repoint", "add_target", "skip_target", "observables"
]


class PlainStep(DecisionItem):
    """A step of the session that decides nothing; its parameters are those of the method of that name."""

    step: PlainStepName
    initial: str | None = None
    final: str | None = None
    search_radius_px: PositiveFloat | None = None
    stars: tuple[NonEmptyText, ...] | None = None
    template: NonEmptyText | None = None
    model: str | None = None
    a_priori: bool = False
    name: NonEmptyText | None = None
    reason: str = ""


def _known_settings(values: dict[str, Any]) -> dict[str, Any]:
    """Let `Settings` itself judge its names and values."""
    try:
        Settings.from_dict(values)
    except (SessionError, TypeError) as error:
        raise ValueError(str(error)) from error
    return values


class PictureDecisions(StrictModel):
    """The decisions on one picture.

    Attributes
    ----------
    name
        Its file name; the key of the entry, its SHA-256, is what counts.
    who, when
        Analyst, and when the last decision was made.
    mission, catalog, attitude : str
        What the session was opened with.
    settings
        Settings of the session that differ from the defaults.
    reject, accept, place, two_stars, nudge, bodies, circles, scans, methods, together : sequences
    carried, landmarks, reject_landmarks, accept_landmarks, notes, steps : sequences
        Items, see the classes above.
    """

    name: str = ""
    who: str = ""
    when: datetime | None = None
    mission: str = ""
    catalog: str = ""
    attitude: Literal["", AttitudeOrigin] = ""
    settings: Annotated[dict[str, int | float], AfterValidator(_known_settings)] = Field(default_factory=dict)
    reject: tuple[StarDecision, ...] = ()
    accept: tuple[StarDecision, ...] = ()
    place: tuple[PlacedStar, ...] = ()
    two_stars: tuple[MarkedStars, ...] = ()
    nudge: tuple[FieldNudge, ...] = ()
    bodies: tuple[DescribedBody, ...] = ()
    circles: tuple[BodyCircle, ...] = ()
    scans: tuple[ScanSelection, ...] = ()
    methods: tuple[BodySearch, ...] = ()
    together: tuple[JointSearch, ...] = ()
    carried: tuple[CarriedPointing, ...] = ()
    landmarks: tuple[LandmarkSearch, ...] = ()
    reject_landmarks: tuple[LandmarkDecision, ...] = ()
    accept_landmarks: tuple[LandmarkDecision, ...] = ()
    notes: tuple[Remark, ...] = ()
    steps: tuple[PlainStep, ...] = ()

    @model_validator(mode="after")
    def _places_once(self) -> "PictureDecisions":
        taken: dict[int, str] = {}
        for section, _, item in self.all_items():
            if item.at is not None and taken.setdefault(item.at, section) != section:
                raise ValueError(f"at: {item.at} stands in {taken[item.at]} and in {section}; it is one step")
        return self

    @property
    def recorded(self) -> bool:
        """Whether the whole session is recorded, so that it can be taken again step by step."""
        return any(item.at is not None for _, _, item in self.all_items())

    def all_items(self) -> Iterator[tuple[str, int, DecisionItem]]:
        """Yield every item with its section and its place there."""
        for section in SECTIONS:
            for number, item in enumerate(getattr(self, section)):
                yield section, number, item


SECTIONS = (
    "two_stars", "nudge", "place", "reject", "accept", "bodies", "circles", "scans", "methods", "together",
    "carried", "landmarks", "reject_landmarks", "accept_landmarks", "notes", "steps",
)  # fmt: skip


# ---- From a session's steps to items, and back.

Parameters = Mapping[str, Any]
RecordedItems = list[tuple[str, DecisionItem]]


def items_of(entry: JournalEntry, at: int) -> RecordedItems:
    """Return the items, with their sections, that one step becomes at place `at` of its session."""
    return ITEMS_OF_STEP[entry.step](entry.parameters, at)


def _star_decisions(section: str) -> Callable[[Parameters, int], RecordedItems]:
    return lambda p, at: [(section, StarDecision(star=s, reason=p["reason"], at=at)) for s in p["ids"]]


def _placed_star_items(p: Parameters, at: int) -> RecordedItems:
    return [("place", PlacedStar(star=p["id"], pixel=p["place"][0], line=p["place"][1], at=at))]


def _marked_star_items(p: Parameters, at: int) -> RecordedItems:
    return [("two_stars", MarkedStars(places=p["places"], stars=p["ids"], at=at))]


def _nudge_items(p: Parameters, at: int) -> RecordedItems:
    values = {"pixel": p["delta_pixel"], "line": p["delta_line"], "twist_deg": p["delta_twist_deg"]}
    return [("nudge", FieldNudge(**values, at=at))]


def _described_items(p: Parameters, at: int) -> RecordedItems:
    pixel, line = p["center_px"]
    other = {key: value for key, value in p.items() if key not in ("name", "center_px")}
    return [("bodies", DescribedBody(body=p["name"], pixel=pixel, line=line, at=at, **other))]


def _circle_items(p: Parameters, at: int) -> RecordedItems:
    pixel, line = p["center_px"]
    return [("circles", BodyCircle(body=p["name"], pixel=pixel, line=line, radius_px=p["radius_px"], at=at))]


def _cleared_circle_items(p: Parameters, at: int) -> RecordedItems:
    return [("circles", BodyCircle(body=p["name"], clear=True, at=at))]


def _scan_items(p: Parameters, at: int) -> RecordedItems:
    return [("scans", ScanSelection(body=p["name"], numbers=p["numbers"], reason=p["reason"], at=at))]


def _search_items(p: Parameters, at: int) -> RecordedItems:
    options = {k: p[k] for k in ("method", "search_radius_px", "circle", "scans", "solve_range") if k in p}
    return [("methods", BodySearch(body=p["name"], at=at, **options))]


def _joint_search_items(p: Parameters, at: int) -> RecordedItems:
    return [("together", JointSearch(bodies=p["names"], method=p["method"], at=at))]


def _landmark_search_items(p: Parameters, at: int) -> RecordedItems:
    options = {key: p.get(key) for key in ("search_radius_px", "position_sigma_km")}
    item = LandmarkSearch(body=p["name"], maplets=p["maplets"], lost=p.get("lost", False), at=at, **options)
    return [("landmarks", item)]


def _landmark_decisions(section: str) -> Callable[[Parameters, int], RecordedItems]:
    return lambda p, at: [
        (section, LandmarkDecision(body=p["name"], landmark=one, reason=p["reason"], at=at))
        for one in p["ids"]
    ]


def _carried_items(p: Parameters, at: int) -> RecordedItems:
    return [("carried", CarriedPointing(neighbors=p["neighbors"], **p["motion"], at=at))]


def _remark_items(p: Parameters, at: int) -> RecordedItems:
    return [("notes", Remark(text=p["text"], at=at))]


def _step_items(name: PlainStepName) -> Callable[[Parameters, int], RecordedItems]:
    def recorded(p: Parameters, at: int) -> RecordedItems:
        values = {"stars" if key == "ids" else key: value for key, value in p.items()}
        return [("steps", PlainStep(step=name, at=at, **values))]

    return recorded


ITEMS_OF_STEP: dict[str, Callable[[Parameters, int], RecordedItems]] = {
    "reject_stars": _star_decisions("reject"),
    "accept_stars": _star_decisions("accept"),
    "place_star": _placed_star_items,
    "two_star_pointing": _marked_star_items,
    "nudge": _nudge_items,
    "describe_body": _described_items,
    "set_circle": _circle_items,
    "clear_circle": _cleared_circle_items,
    "choose_scans": _scan_items,
    "find_body": _search_items,
    "find_bodies": _joint_search_items,
    "carry_pointing": _carried_items,
    "find_landmarks": _landmark_search_items,
    "reject_landmarks": _landmark_decisions("reject_landmarks"),
    "accept_landmarks": _landmark_decisions("accept_landmarks"),
    "note": _remark_items,
    **{name: _step_items(name) for name in get_args(PlainStepName)},
}


def perform(session: "ImageSession", section: str, items: list[Any]) -> None:
    """Make the decision, or take the step, that items of one place stand for."""
    METHOD_OF_SECTION[section](session, items)


def _decide_stars(session: "ImageSession", items: list[StarDecision], *, accept: bool) -> None:
    decide = session.accept_stars if accept else session.reject_stars
    reasons = {item.reason for item in items}
    if len(reasons) == 1:
        decide([item.star for item in items], items[0].reason)
        return
    for item in items:
        decide([item.star], item.reason)


def _decide_landmarks(session: "ImageSession", items: list[LandmarkDecision], *, accept: bool) -> None:
    decide = session.accept_landmarks if accept else session.reject_landmarks
    for body, reason in dict.fromkeys((item.body, item.reason) for item in items):
        ids = [item.landmark for item in items if (item.body, item.reason) == (body, reason)]
        decide(body, ids, reason)


def _describe_bodies(session: "ImageSession", items: list[DescribedBody]) -> None:
    for item in items:
        other = item.model_dump(exclude={"at", "body", "pixel", "line"})
        session.describe_body(item.body, (item.pixel, item.line), **other)


def _set_circle(session: "ImageSession", items: list[BodyCircle]) -> None:
    for item in items:
        if item.clear:
            session.clear_circle(item.body)
        else:
            assert item.pixel is not None
            assert item.line is not None
            assert item.radius_px is not None
            session.set_circle(item.body, (item.pixel, item.line), item.radius_px)


def _find_bodies(session: "ImageSession", items: list[BodySearch]) -> None:
    for item in items:
        session.find_body(
            item.body,
            item.method,
            item.search_radius_px,
            circle=item.circle,
            scans=item.scans,
            solve_range=item.solve_range,
        )


def _one_by_one(act: Callable[["ImageSession", Any], object]) -> Callable[["ImageSession", list[Any]], None]:
    def all_of(session: "ImageSession", items: list[Any]) -> None:
        for item in items:
            act(session, item)

    return all_of


def _take_step(session: "ImageSession", item: PlainStep) -> None:
    METHOD_OF_STEP[item.step](session, item)


def _carry_pointing(session: "ImageSession", item: CarriedPointing) -> None:
    neighbors = [
        SolvedAttitude(
            lent.image,
            lent.et,
            np.array(lent.camera_from_j2000),
            np.array(lent.a_priori_camera_from_j2000),
            np.array(lent.covariance_rad2),
        )
        for lent in item.neighbors
    ]
    motion = AttitudeMotion(item.jitter_rad, item.walk_rad, item.drift_rad_s)
    session.carry_pointing(neighbors, motion, item.reason)


def _search_options(item: PlainStep) -> dict[str, Any]:
    options = {"initial": item.initial, "final": item.final, "search_radius_px": item.search_radius_px}
    return {key: value for key, value in options.items() if value is not None}


METHOD_OF_STEP: dict[PlainStepName, Callable[["ImageSession", PlainStep], object]] = {
    "predict": lambda s, _: s.predict(),
    "find_stars": lambda s, i: s.find_stars(**_search_options(i)),
    "refit_stars": lambda s, i: s.refit_stars(i.stars, template=i.template, **_search_options(i)),
    "repoint": lambda s, i: s.repoint(i.model or "euler", a_priori=i.a_priori),
    "add_target": lambda s, i: s.add_target(i.name or ""),
    "skip_target": lambda s, i: s.skip_target(i.name or "", i.reason),
    "observables": lambda s, _: s.compute_observables(),
}
METHOD_OF_SECTION: dict[str, Callable[["ImageSession", list[Any]], None]] = {
    "reject": lambda s, items: _decide_stars(s, items, accept=False),
    "accept": lambda s, items: _decide_stars(s, items, accept=True),
    "place": _one_by_one(lambda s, i: s.place_star(i.star, (i.pixel, i.line))),
    "two_stars": _one_by_one(lambda s, i: s.two_star_pointing(i.places, i.stars, i.reason)),
    "nudge": _one_by_one(lambda s, i: s.nudge(i.pixel, i.line, i.twist_deg)),
    "bodies": _describe_bodies,
    "circles": _set_circle,
    "scans": _one_by_one(lambda s, i: s.choose_scans(i.body, i.numbers, i.reason)),
    "methods": _find_bodies,
    "together": _one_by_one(lambda s, i: s.find_bodies(i.bodies, i.method)),
    "carried": _one_by_one(_carry_pointing),
    "landmarks": _one_by_one(
        lambda s, i: s.find_landmarks(i.body, i.maplets, i.search_radius_px, i.position_sigma_km, lost=i.lost)
    ),
    "reject_landmarks": lambda s, items: _decide_landmarks(s, items, accept=False),
    "accept_landmarks": lambda s, items: _decide_landmarks(s, items, accept=True),
    "notes": _one_by_one(lambda s, i: s.note(i.text)),
    "steps": _one_by_one(_take_step),
}


# ---- The file of many pictures.

EVERY_IMAGE = "*"
HEAD = """# Decisions on pictures, by the SHA-256 of the picture; opnav process --decisions carries them out.
# "at" orders the steps of a session; decisions without it are made when the stars are found.
"""
# Sections that are carried out once the stars are found, in a file that has no order of its own.
ADDED_LAST = ("carried", "methods", "together", "landmarks", "reject_landmarks", "accept_landmarks", "steps")
BEFORE_STARS, AFTER_STARS = ("two_stars", "nudge"), ("place", "reject", "accept", "circles", "scans", "notes")


class Decisions(BaseModel):
    """Recorded decisions by picture."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    images: dict[str, PictureDecisions] = {}
    _path: Path | None = PrivateAttr(None)

    def __eq__(self, other: object) -> bool:
        """Tell whether the same is decided, wherever it was read from."""
        return isinstance(other, Decisions) and self.images == other.images

    __hash__ = None  # type: ignore[assignment]

    @field_validator("images", mode="before")
    @classmethod
    def _keys_as_text(cls, images: Any) -> Any:
        return {str(key): value for key, value in images.items()} if isinstance(images, dict) else images

    # -- of sessions -------------------------------------------------------------------------------------------

    @classmethod
    def from_session(cls, session: "ImageSession", who: str = "") -> "Decisions":
        """Return the decisions of a session, and the steps between them; what was undone is left out.

        Parameters
        ----------
        who
            The analyst.
        """
        sections: dict[str, list[DecisionItem]] = {}
        for at, entry in enumerate(session.standing, start=1):
            for section, item in items_of(entry, at):
                sections.setdefault(section, []).append(item)
        own, usual = session.context.settings.to_dict(), Settings().to_dict()
        picture = PictureDecisions(
            name=session.context.picture.name,
            who=who,
            when=session.standing[-1].time_utc if session.standing else None,  # type: ignore[arg-type]
            mission=session.context.mission.name,
            catalog=session.source.catalog,
            attitude=session.inputs.attitude_source,
            settings={key: value for key, value in own.items() if value != usual[key]},
            **{section: tuple(items) for section, items in sections.items()},  # type: ignore[arg-type]
        )
        return cls(images={session.context.picture.sha256: picture})

    def with_path(self, path: str | Path) -> "Decisions":
        """Remember the file, so that errors name its lines; return the decisions themselves."""
        self._path = Path(path)
        return self

    def merged(self, *others: "Decisions") -> "Decisions":
        """Return these decisions with those of others; for the same picture the last given count."""
        images = dict(self.images)
        for other in others:
            images |= other.images
        return Decisions(images=images)

    def recorded(self, sha256: str) -> PictureDecisions | None:
        """Return the recorded session of a picture, known by its SHA-256; None where there is none."""
        found = self.images.get(sha256)
        return found if found is not None and found.recorded else None

    # -- made in a session -------------------------------------------------------------------------------------

    def apply(self, session: "ImageSession") -> None:
        """Make the decisions that concern the session's picture.

        In a session without any step, a recorded session of the picture is taken again whole. Else the decisions on
        stars, circles, scans and notes are made; those for every picture skip stars that are not in its field, and
        methods are left to whoever looks for the bodies (see `methods_of`).

        Raises
        ------
        SessionError
            A decision cannot be made (line and field are named), or the session was opened otherwise than the recorded
            one.
        """
        recorded = self.recorded(session.context.picture.sha256)
        if recorded is not None and not session.standing:
            self._replay(session, recorded)
            return
        for key, picture in self._entries_for(session):
            for section in AFTER_STARS:
                for number, item in enumerate(getattr(picture, section)):
                    if key != EVERY_IMAGE or _concerns(session, item):
                        self._perform(session, key, section, number, [item])

    def apply_field(self, session: "ImageSession") -> bool:
        """Make the decisions on where the star field is (marked stars, nudges); tell whether there were any."""
        made = False
        for key, picture in self._entries_for(session):
            for section in BEFORE_STARS:
                for number, item in enumerate(getattr(picture, section)):
                    self._perform(session, key, section, number, [item])
                    made = True
        return made

    def apply_bodies(self, session: "ImageSession") -> None:
        """Describe the bodies that were described by hand; one that the session has stays as it is.

        Raises
        ------
        SessionError
            As `apply`.
        """
        for key, picture in self._entries_for(session):
            for number, item in enumerate(picture.bodies):
                if item.body not in session.state.assisted:
                    self._perform(session, key, "bodies", number, [item])

    def apply_landmarks(self, session: "ImageSession", body: str) -> None:
        """Make the decisions on landmarks of a body that were looked for; those not in this picture are passed over.

        Raises
        ------
        SessionError
            As `apply`.
        """
        found = next(one for one in session.state.landmarks if one.centers.body == body)
        there = set(found.centers.id.tolist())
        for key, picture in self._entries_for(session):
            for section in ("reject_landmarks", "accept_landmarks"):
                for number, item in enumerate(getattr(picture, section)):
                    if item.body == body and item.landmark in there:
                        self._perform(session, key, section, number, [item])

    def methods_of(self, session: "ImageSession", body: str) -> tuple[dict[str, Any], ...]:
        """Return how a body shall be found: arguments of `ImageSession.find_body`; none where nothing is said."""
        chosen = [m for _, picture in self._entries_for(session) for m in picture.methods if m.body == body]
        last = {method.method: method for method in chosen}
        return tuple(m.model_dump(exclude={"at", "body"}) for m in last.values())

    def bodies_of(self, session: "ImageSession") -> tuple[str, ...]:
        """Return the bodies that are described or whose method is decided, in order."""
        entries = [picture for _, picture in self._entries_for(session)]
        described = [item.body for picture in entries for item in picture.bodies]
        return tuple(dict.fromkeys((*described, *(m.body for picture in entries for m in picture.methods))))

    def describe_bodies(self, path: Path, sha256: str) -> bool:
        """Whether bodies of a picture are described by hand."""
        keys = (EVERY_IMAGE, path.name, sha256)
        return any(self.images[key].bodies for key in keys if key in self.images)

    def _entries_for(self, session: "ImageSession") -> list[tuple[str, PictureDecisions]]:
        """Return the entries that concern a picture, the most general first."""
        frame = session.context.picture
        keys = (EVERY_IMAGE, frame.name, frame.sha256)
        return [(key, self.images[key]) for key in dict.fromkeys(keys) if key in self.images]

    def _replay(self, session: "ImageSession", picture: PictureDecisions) -> None:
        key = session.context.picture.sha256
        _check_opened(session, picture)
        first = next((s.at for s in picture.steps if s.step == "find_stars" and s.at), 1)
        groups: dict[tuple[int, int, str, int], list[tuple[int, DecisionItem]]] = {}
        last = 1 + max((item.at or 0 for _, _, item in picture.all_items()), default=0)
        for order, (section, number, item) in enumerate(picture.all_items()):
            # What was added by hand follows the first search for stars; methods added by hand come last.
            added = last if section in ADDED_LAST else first
            place = (item.at, 0, section, 0) if item.at is not None else (added, 1, section, order)
            groups.setdefault(place, []).append((number, item))
        for place in sorted(groups, key=lambda place: (place[0], place[1], place[3])):
            numbers, items = zip(*groups[place], strict=True)
            self._perform(session, key, place[2], numbers[0], list(items))

    def _perform(
        self, session: "ImageSession", key: str, section: str, number: int, items: list[Any]
    ) -> None:
        try:
            perform(session, section, items)
        except OpNavError as error:
            raise SessionError(f"{self._place(key, section, number)}: {error}") from error

    def _place(self, key: str, section: str, number: int) -> str:
        field = f"images.{key}.{section}.{number}"
        if self._path is None:
            return field
        line = line_of(self._path, ("images", key, section, number))
        return f"decisions file {self._path}: line {line}: {field}"


def _concerns(session: "ImageSession", item: DecisionItem) -> bool:
    """Whether an item is of a star of this field, or of no star at all."""
    star, stars = getattr(item, "star", None), session.state.a_priori
    return star is None or (stars is not None and star in stars.id.tolist())


def _check_opened(session: "ImageSession", picture: PictureDecisions) -> None:
    """Refuse to take a session again that was opened otherwise: other stars, another a priori pointing."""
    name = session.context.picture.name
    kind = picture.catalog.partition(":")[0]
    if kind and kind != session.source.catalog.partition(":")[0]:
        raise SessionError(
            f"the decisions on {name} were made with the catalog {picture.catalog!r}, this run has "
            f"{session.source.catalog!r}; give the same (--catalog)."
        )
    if picture.attitude and picture.attitude != session.inputs.attitude_source:
        raise SessionError(
            f"the decisions on {name} were made with the a priori attitude of the {_told_by(picture.attitude)}, this run "
            f"has that of the {_told_by(session.inputs.attitude_source)}; give the same (--kernels, --attitude)."
        )


def _told_by(origin: AttitudeOrigin) -> str:
    return "stars" if origin == "none" else origin


def load_decisions(path: str | Path) -> Decisions:
    """Read a decisions file.

    Raises
    ------
    SessionError
        The file is missing, is not YAML, or breaks the layout (line and field are named).
    """
    decisions = read_model(path, Decisions, "decisions file", SessionError)
    return decisions.with_path(path)


def write_decisions(path: str | Path, decisions: Decisions | Iterable[Decisions]) -> Path:
    """Write decisions, of several pictures if wanted, as a file that `load_decisions` reads; return its path.

    Raises
    ------
    SessionError
        The file cannot be written; an older one is unchanged.
    """
    several = [decisions] if isinstance(decisions, Decisions) else list(decisions)
    images = {
        key: picture.model_dump(mode="json", exclude_defaults=True)
        for key, picture in Decisions().merged(*several).images.items()
    }
    text = yaml.safe_dump(
        {"images": images}, sort_keys=False, allow_unicode=True, default_flow_style=None, width=1000
    )
    write_text(path, HEAD + text)
    return Path(path)
