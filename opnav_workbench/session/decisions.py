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
        scans:
        - {body: PLUTO, numbers: [3, 4, 5, 20, 21], reason: even surface}

Methods
-------
        - {body: PLUTO, method: limb_scan}
        notes:
        - {text: stray light in the corner}

A file that `Decisions.from_session` wrote has the steps between the decisions too, and says with ``at`` in which order
all of it came; it is then carried out as it was made, to the same bits. Stars are named by catalog id, never by number.
See `opnav_workbench.session.decision_items` for all fields.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import BaseModel, ConfigDict, PrivateAttr, field_validator

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import write_text
from opnav_workbench.session.deciding import items_of, perform
from opnav_workbench.session.decision_items import Item, PictureDecisions
from opnav_workbench.session.settings import Settings
from opnav_workbench.yaml_file import line_of, read_model

if TYPE_CHECKING:
    from opnav_workbench.session.session import ImageSession

__all__ = ["Decisions", "load_decisions", "write_decisions"]

EVERY_IMAGE = "*"
SHA256 = re.compile(r"[0-9a-f]{64}")
HEAD = """# Decisions on pictures, by the SHA-256 of the picture; opnav process --decisions carries them out.
# "at" orders the steps of a session; decisions without it are made when the stars are found.
"""
# Sections that are carried out once the stars are found, in a file that has no order of its own.
BEFORE_STARS, AFTER_STARS = ("two_stars", "nudge"), ("place", "reject", "accept", "circles", "scans", "notes")


class Decisions(BaseModel):
    """Recorded decisions by picture."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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
        session : ImageSession
        who : str
            The analyst.
        """
        sections: dict[str, list[Item]] = {}
        for at, entry in enumerate(session.standing, start=1):
            for section, item in items_of(entry, at):
                sections.setdefault(section, []).append(item)
        own, usual = session.context.settings.to_dict(), Settings().to_dict()
        picture = PictureDecisions(
            name=session.context.frame.path.name,
            who=who,
            when=session.standing[-1].time_utc if session.standing else None,  # type: ignore[arg-type]
            mission=session.context.mission.name,
            catalog=session.source.catalog,
            attitude=session.inputs.attitude_source,  # type: ignore[arg-type]
            settings={key: value for key, value in own.items() if value != usual[key]},
            **{section: tuple(items) for section, items in sections.items()},  # type: ignore[arg-type]
        )
        return cls(images={session.context.frame.sha256: picture})

    def read_from(self, path: str | Path) -> "Decisions":
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
        methods are left to whoever looks for the bodies (see `method_of`).

        Raises
        ------
        SessionError
            A decision cannot be made (line and field are named), or the session was opened otherwise than the recorded
            one.
        """
        recorded = self.recorded(session.context.frame.sha256)
        if recorded is not None and not session.standing:
            self._replay(session, recorded)
            return
        for key, picture in self._of(session):
            for section in AFTER_STARS:
                for number, item in enumerate(getattr(picture, section)):
                    if key != EVERY_IMAGE or _concerns(session, item):
                        self._perform(session, key, section, number, [item])

    def apply_field(self, session: "ImageSession") -> bool:
        """Make the decisions on where the star field is (marked stars, nudges); tell whether there were any."""
        made = False
        for key, picture in self._of(session):
            for section in BEFORE_STARS:
                for number, item in enumerate(getattr(picture, section)):
                    self._perform(session, key, section, number, [item])
                    made = True
        return made

    def methods_of(self, session: "ImageSession", body: str) -> tuple[dict[str, Any], ...]:
        """Return how a body shall be found: arguments of `ImageSession.find_body`; none where nothing is said."""
        chosen = [m for _, picture in self._of(session) for m in picture.methods if m.body == body]
        last = {method.method: method for method in chosen}
        return tuple(m.model_dump(exclude={"at", "body"}) for m in last.values())

    def bodies_of(self, session: "ImageSession") -> tuple[str, ...]:
        """Return the bodies whose method is decided, in order."""
        methods = (m.body for _, picture in self._of(session) for m in picture.methods)
        return tuple(dict.fromkeys(methods))

    def _of(self, session: "ImageSession") -> list[tuple[str, PictureDecisions]]:
        """Return the entries that concern a picture, the most general first."""
        frame = session.context.frame
        keys = (EVERY_IMAGE, frame.path.name, frame.sha256)
        return [(key, self.images[key]) for key in dict.fromkeys(keys) if key in self.images]

    def _replay(self, session: "ImageSession", picture: PictureDecisions) -> None:
        key = session.context.frame.sha256
        _check_opened(session, picture)
        first = next((s.at for s in picture.steps if s.step == "find_stars" and s.at), 1)
        groups: dict[tuple[int, int, str, int], list[tuple[int, Item]]] = {}
        last = 1 + max((item.at or 0 for _, _, item in picture.items()), default=0)
        for order, (section, number, item) in enumerate(picture.items()):
            # What was added by hand follows the first search for stars; methods added by hand come last.
            added = last if section in ("methods", "together", "steps") else first
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


def _concerns(session: "ImageSession", item: Item) -> bool:
    """Whether an item is of a star of this field, or of no star at all."""
    star, stars = getattr(item, "star", None), session.state.a_priori
    return star is None or (stars is not None and star in stars.id.tolist())


def _check_opened(session: "ImageSession", picture: PictureDecisions) -> None:
    """Refuse to take a session again that was opened otherwise: other stars, another a priori pointing."""
    name = session.context.frame.path.name
    kind = picture.catalog.partition(":")[0]
    if kind and kind != session.source.catalog.partition(":")[0]:
        raise SessionError(
            f"the decisions on {name} were made with the catalog {picture.catalog!r}, this run has "
            f"{session.source.catalog!r}; give the same (--catalog)."
        )
    if picture.attitude and picture.attitude != session.inputs.attitude_source:
        raise SessionError(
            f"the decisions on {name} were made with the a priori attitude of the {picture.attitude}, this run has that "
            f"of the {session.inputs.attitude_source}; give the same (--kernels, --attitude)."
        )


def load_decisions(path: str | Path) -> Decisions:
    """Read a decisions file.

    Raises
    ------
    SessionError
        The file is missing, is not YAML, or breaks the layout (line and field are named).
    """
    decisions = read_model(path, Decisions, "decisions file", SessionError)
    return decisions.read_from(path)


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
