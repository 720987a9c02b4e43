"""From a session's steps to the items of a decisions file, and back: each kind of item names its `ImageSession` method."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from opnav_workbench.session.decision_items import (
    BodyCircle,
    Item,
    Method,
    Note,
    Nudge,
    PlacedStar,
    Scans,
    Step,
    Together,
    TwoStars,
    Verdict,
)
from opnav_workbench.session.journal import JournalEntry

if TYPE_CHECKING:
    from opnav_workbench.session.session import ImageSession

__all__ = ["items_of", "perform"]

Parameters = Mapping[str, Any]
Recorded = list[tuple[str, Item]]


def items_of(entry: JournalEntry, at: int) -> Recorded:
    """Return the items, with their sections, that one step becomes at place `at` of its session."""
    return RECORD[entry.step](entry.parameters, at)


def _verdicts(section: str) -> Callable[[Parameters, int], Recorded]:
    return lambda p, at: [(section, Verdict(star=s, reason=p["reason"], at=at)) for s in p["ids"]]


def _placed(p: Parameters, at: int) -> Recorded:
    return [("place", PlacedStar(star=p["id"], pixel=p["place"][0], line=p["place"][1], at=at))]


def _two_stars(p: Parameters, at: int) -> Recorded:
    return [("two_stars", TwoStars(places=p["places"], stars=p["ids"], at=at))]


def _nudge(p: Parameters, at: int) -> Recorded:
    values = {"pixel": p["delta_pixel"], "line": p["delta_line"], "twist_deg": p["delta_twist_deg"]}
    return [("nudge", Nudge(**values, at=at))]


def _circle(p: Parameters, at: int) -> Recorded:
    pixel, line = p["center_px"]
    return [("circles", BodyCircle(body=p["name"], pixel=pixel, line=line, radius_px=p["radius_px"], at=at))]


def _cleared(p: Parameters, at: int) -> Recorded:
    return [("circles", BodyCircle(body=p["name"], clear=True, at=at))]


def _scans(p: Parameters, at: int) -> Recorded:
    return [("scans", Scans(body=p["name"], numbers=p["numbers"], reason=p["reason"], at=at))]


def _method(p: Parameters, at: int) -> Recorded:
    options = {k: p[k] for k in ("method", "search_radius_px", "circle", "scans", "solve_range") if k in p}
    return [("methods", Method(body=p["name"], at=at, **options))]


def _together(p: Parameters, at: int) -> Recorded:
    return [("together", Together(bodies=p["names"], method=p["method"], at=at))]


def _note(p: Parameters, at: int) -> Recorded:
    return [("notes", Note(text=p["text"], at=at))]


def _step(name: str) -> Callable[[Parameters, int], Recorded]:
    def recorded(p: Parameters, at: int) -> Recorded:
        values = {"stars" if key == "ids" else key: value for key, value in p.items()}
        return [("steps", Step(step=name, at=at, **values))]  # type: ignore[arg-type]

    return recorded


RECORD: dict[str, Callable[[Parameters, int], Recorded]] = {
    "reject_stars": _verdicts("reject"),
    "accept_stars": _verdicts("accept"),
    "place_star": _placed,
    "two_star_pointing": _two_stars,
    "nudge": _nudge,
    "set_circle": _circle,
    "clear_circle": _cleared,
    "choose_scans": _scans,
    "find_body": _method,
    "find_bodies": _together,
    "note": _note,
    **{
        name: _step(name)
        for name in (
            "predict", "find_stars", "refit_stars", "repoint", "add_target", "skip_target", "observables"
        )
    },
}  # fmt: skip


def perform(session: "ImageSession", section: str, items: list[Any]) -> None:
    """Make the decision, or take the step, that items of one place stand for."""
    PERFORM[section](session, items)


def _decide(session: "ImageSession", items: list[Verdict], *, accept: bool) -> None:
    decide = session.accept_stars if accept else session.reject_stars
    reasons = {item.reason for item in items}
    if len(reasons) == 1:
        decide([item.star for item in items], items[0].reason)
        return
    for item in items:
        decide([item.star], item.reason)


def _set_circle(session: "ImageSession", items: list[BodyCircle]) -> None:
    for item in items:
        if item.clear:
            session.clear_circle(item.body)
        else:
            assert item.pixel is not None
            assert item.line is not None
            assert item.radius_px is not None
            session.set_circle(item.body, (item.pixel, item.line), item.radius_px)


def _find(session: "ImageSession", items: list[Method]) -> None:
    for item in items:
        session.find_body(
            item.body,
            item.method,
            item.search_radius_px,
            circle=item.circle,
            scans=item.scans,
            solve_range=item.solve_range,
        )


def _each(act: Callable[["ImageSession", Any], object]) -> Callable[["ImageSession", list[Any]], None]:
    def all_of(session: "ImageSession", items: list[Any]) -> None:
        for item in items:
            act(session, item)

    return all_of


def _take_step(session: "ImageSession", item: Step) -> None:
    search: dict[str, Any] = {
        "initial": item.initial,
        "final": item.final,
        "search_radius_px": item.search_radius_px,
    }
    given = {key: value for key, value in search.items() if value is not None}
    if item.step == "find_stars":
        session.find_stars(**given)
    elif item.step == "refit_stars":
        session.refit_stars(item.stars, template=item.template, **given)
    elif item.step == "repoint":
        session.repoint(item.model or "euler", a_priori=item.a_priori)
    elif item.step == "add_target":
        session.add_target(item.name or "")
    elif item.step == "skip_target":
        session.skip_target(item.name or "", item.reason)
    elif item.step == "predict":
        session.predict()
    else:
        session.observables()


PERFORM: dict[str, Callable[["ImageSession", list[Any]], None]] = {
    "reject": lambda s, items: _decide(s, items, accept=False),
    "accept": lambda s, items: _decide(s, items, accept=True),
    "place": _each(lambda s, i: s.place_star(i.star, (i.pixel, i.line))),
    "two_stars": _each(lambda s, i: s.two_star_pointing(i.places, i.stars, i.reason)),
    "nudge": _each(lambda s, i: s.nudge(i.pixel, i.line, i.twist_deg)),
    "circles": _set_circle,
    "scans": _each(lambda s, i: s.choose_scans(i.body, i.numbers, i.reason)),
    "methods": _find,
    "together": _each(lambda s, i: s.find_bodies(i.bodies, i.method)),
    "notes": _each(lambda s, i: s.note(i.text)),
    "steps": _each(_take_step),
}
