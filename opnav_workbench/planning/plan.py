"""A whole sequence planned: its pictures one by one, and its approach searches."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from opnav_workbench.errors import MissionError
from opnav_workbench.planning.approach import Approach, search_approach
from opnav_workbench.planning.bodies import natural_bodies
from opnav_workbench.planning.opened_sequence import open_sequence
from opnav_workbench.planning.picture import PicturePlan, plan_picture
from opnav_workbench.planning.sequence import PictureSequence
from opnav_workbench.version import __version__

__all__ = ["Plan", "plan_sequence"]

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A planned sequence.

    Attributes
    ----------
    catalog
        What the catalog says of itself.
    version
        Of opnav_workbench.
    """

    sequence: PictureSequence
    pictures: tuple[PicturePlan, ...]
    searches: tuple[Approach, ...]
    catalog: Mapping[str, Any]
    version: str = __version__

    def count(self, grade: str) -> int:
        """Return how many pictures have a grade."""
        return sum(picture.verdict.grade == grade for picture in self.pictures)

    def picture(self, name: str) -> PicturePlan:
        """Return a picture by its name.

        Raises
        ------
        MissionError
            There is none of that name.
        """
        for picture in self.pictures:
            if picture.name == name:
                return picture
        known = ", ".join(picture.name for picture in self.pictures) or "none"
        raise MissionError(f"no picture {name!r} in this plan; it has {known}.")


def _no_progress(_done: int, _total: int, _name: str) -> None:
    """Say nothing."""


def plan_sequence(
    sequence: PictureSequence,
    *,
    only: Sequence[str] = (),
    exposures: bool = True,
    done: Progress = _no_progress,
) -> Plan:
    """Plan a sequence: predict and judge every picture, and search first detections.

    Opens the kernels that the sequence names, else uses those that are active.

    Parameters
    ----------
    only
        Names of pictures (of a cadence: its name, or that of one of its pictures) or searches; none: all.
    exposures
        Search the best exposure of every picture, which takes about half of the time.
    done : callable
        Called with the number done, the number in all and the name of what comes next.

    Raises
    ------
    OpNavError
        The sequence as a whole cannot be planned: kernels, mission, catalog or a body's name are not there. What
        concerns single pictures is in their verdicts.
    """
    pictures = [
        picture
        for index, picture in sequence.expanded()
        if not only or {sequence.pictures[index].name, picture.name} & set(only)
    ]
    searches = [search for search in sequence.search if not only or search.name in only]
    _check_only(sequence, only)
    with open_sequence(sequence) as opened:
        others = natural_bodies()
        total = len(pictures) + len(searches)
        plans, found = [], []
        for number, picture in enumerate(pictures):
            done(number, total, picture.name)
            plans.append(plan_picture(opened, picture, others=others, exposures=exposures))
        for number, search in enumerate(searches, len(pictures)):
            done(number, total, search.name)
            found.append(search_approach(opened, search))
        done(total, total, "")
        return Plan(sequence, tuple(plans), tuple(found), dict(opened.opened_scenario.catalog.describe()))


def _check_only(sequence: PictureSequence, only: Sequence[str]) -> None:
    known = {search.name for search in sequence.search}
    known |= {
        name for i, picture in sequence.expanded() for name in (sequence.pictures[i].name, picture.name)
    }
    unknown = [name for name in only if name not in known]
    if unknown:
        offered = ", ".join(
            dict.fromkeys([p.name for p in sequence.pictures] + [s.name for s in sequence.search])
        )
        raise MissionError(
            f"no picture or search named {', '.join(unknown)} in this sequence; it has {offered}."
        )
