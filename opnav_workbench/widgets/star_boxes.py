"""Star-box confirmation: one extracted box after the other is accepted or rejected, by one key each."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.session import JournalEntry
from opnav_workbench.session.star_boxes import StarBox
from opnav_workbench.widgets.actions import MENU, REJECT_REASONS, ActionRegistry
from opnav_workbench.widgets.star_boxes_html import StarCard, StarPage, star_page_html
from opnav_workbench.widgets.star_boxes_search import StarSearch
from opnav_workbench.widgets.workbench_bench import Bench
from opnav_workbench.widgets.workbench_desk import Desk, Event, Handler

__all__ = ["StarsDesk", "star_cards"]

CLICK_RADIUS_SHARE = 0.02  # of the picture's longer side: a click so near to a star means it
MIN_CLICK_RADIUS_PX = 8.0
MIN_RING_PX = 6.0  # the ring about the star under decision stays clear of the star
PAGE = 24  # boxes on a page: what is seen at once, and quick to send


def star_cards(boxes: tuple[StarBox, ...], decisions: dict[str, tuple[str, str]]) -> tuple[StarCard, ...]:
    """Return the boxes with what the analyst decided on each."""
    return tuple(StarCard(box, *decisions.get(box.id, ("", ""))) for box in boxes)


@dataclass(slots=True)
class _Kept:
    """Boxes as last asked for; they are the same as long as the state is."""

    state: object = None
    boxes: tuple[StarBox, ...] = ()


class StarsDesk(Desk):
    """The tab of the stars."""

    name = "stars"

    def __init__(self, bench: Bench, registry: ActionRegistry) -> None:
        super().__init__(bench, registry)
        self.focus_id = ""
        self.search = StarSearch()
        self._kept = _Kept()
        self._noise: tuple[object, float] = (None, 1.0)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def boxes(self) -> tuple[StarBox, ...]:
        """Boxes of all stars on the detector, in the catalog's order of the prediction."""
        state = self.bench.session.state
        if self._kept.state is not state:
            boxes = self.bench.session.star_boxes() if state.a_priori is not None else ()
            self._kept = _Kept(state, tuple(b for b in boxes if b.status != "off_detector"))
        return self._kept.boxes

    @property
    def ids(self) -> list[str]:
        """Catalog ids in the order of the boxes."""
        return [box.id for box in self.boxes]

    @property
    def radius_px(self) -> float:
        """Search radius about the expected places."""
        return self.search.radius_px or self.bench.session.context.settings.search_radius_px

    @property
    def focused(self) -> StarBox | None:
        """The star under decision."""
        by_id = {box.id: box for box in self.boxes}
        return by_id.get(self.focus_id) or next(iter(by_id.values()), None)

    def entered(self) -> None:
        """Begin with the first undecided star."""
        if self.focus_id not in self.ids:
            undecided = self.bench.undecided()
            self.focus_id = next((star for star in self.ids if star in undecided), "")

    def revisit(self, undone: JournalEntry) -> None:
        """Go back to the star whose decision was undone."""
        ids = undone.parameters.get("ids") or [undone.parameters.get("id")]
        if len(ids) == 1 and ids[0] in self.ids:
            self.focus_id = ids[0]

    def draw(self) -> None:
        """Ring the star under decision."""
        box = self.focused
        if box is None:
            self.bench.viewer.focus(None)
            return
        place = box.predicted_px if box.observed_px is None else box.observed_px
        self.bench.viewer.focus(place, max(self.radius_px, MIN_RING_PX))

    def html(self) -> str:
        """Return the page: the star under decision large, the others as a grid, the pointing live."""
        session, focused = self.bench.session, self.focused
        cards = star_cards(self.boxes, dict(session.state.decisions))
        place = self.ids.index(focused.id) if focused is not None else 0
        first = place // PAGE * PAGE
        page = StarPage(
            cards=cards[first : first + PAGE],
            focus=cards[place] if cards else None,
            first=first,
            n_all=len(cards),
            n_accepted=sum(card.verdict == "accepted" for card in cards),
            n_rejected=sum(card.verdict == "rejected" for card in cards),
            searched=session.state.centers is not None,
            radius_px=self.radius_px,
            template=self.search.template,
            menu=self.bench.menu == MENU,
            placing=self.bench.tool == "place_star",
            examine_each=self.bench.examine_each,
            pointing=self.bench.pointing_line(),
            noise_dn=self._noise_dn(),
        )
        return star_page_html(page, session, self.registry)

    def _noise_dn(self) -> float:
        """Typical noise of the picture: computed once, as it is asked for at each key."""
        noise = self.bench.session.context.noise_dn
        if self._noise[0] is not noise:
            finite = noise[np.isfinite(noise)]
            self._noise = (noise, float(np.median(finite)) if finite.size else 1.0)
        return self._noise[1]

    # -- actions -----------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        reasons = {
            f"reason_{number}": self._reason(reason) for number, reason in enumerate(REJECT_REASONS, 1)
        }
        return reasons | {
            "find_stars": lambda _: self.find(),
            "accept": lambda _: self.accept(),
            "reject": lambda _: self._ask_reason(),
            "next": lambda _: self._go(+1),
            "previous": lambda _: self._go(-1),
            "next_undecided": lambda _: self._go_undecided(),
            "accept_rest": lambda _: self._accept_rest(),
            "repoint": lambda _: self.bench.repoint(),
            "place_star": lambda _: self._place_tool(),
            "smaller_radius": lambda _: self._refit(self.search.step_radius(self.radius_px, -1)),
            "larger_radius": lambda _: self._refit(self.search.step_radius(self.radius_px, +1)),
            "radius": lambda event: self._refit(self.search.type_radius(str(event["value"]))),
            "template": lambda _: self._refit(self.search.next_template(self._one())),
            "examine": lambda _: self._toggle_examine(),
            "star": self._picked,
        }

    def find(self) -> None:
        """Predict if need be, then find all stars."""

        def work() -> None:
            session = self.bench.session
            if session.state.a_priori is None:
                session.predict()
            session.find_stars(self.search.initial, search_radius_px=self.search.radius_px)
            self.entered()

        self.bench.run("finding stars", work, self._found_line)

    def _found_line(self) -> str:
        session = self.bench.session
        used, boxes = int(session.state.mask("used").sum()), len(self.boxes)
        said = session.state.notes.get("stars", ())
        return f"{used} of {boxes} stars found. {' '.join(said)}".strip()

    def accept(self) -> None:
        """Accept the star under decision and go on."""
        star = self._one()
        self.bench.decide(
            lambda: self.bench.session.accept_stars([star]), lambda: self._gone_on(star, "accepted")
        )

    def reject(self, reason: str) -> None:
        """Reject the star under decision and go on."""
        star = self._one()
        self.bench.menu = ""
        self.bench.decide(
            lambda: self.bench.session.reject_stars([star], reason),
            lambda: self._gone_on(star, f"rejected ({reason})"),
        )

    def _one(self) -> str:
        box = self.focused
        if box is None:
            raise SessionError("no star is shown yet: F finds the stars.")
        return box.id

    def _gone_on(self, star: str, verdict: str) -> str:
        left = self.bench.undecided()
        if left:
            self._go_undecided(star)
            return f"{star} {verdict}; {len(left)} undecided."
        solved = self.bench.session.state.pointing is not None
        then = self.bench.pointing_line() if solved else "P solves the pointing."
        return f"{star} {verdict}; every star is decided. {then}"

    def _reason(self, reason: str) -> Handler:
        return lambda _: self.reject(reason)

    def _ask_reason(self) -> None:
        self._one()
        self.bench.menu = "" if self.bench.menu == MENU else MENU

    def _go(self, step: int) -> None:
        ids = self.ids
        if ids:
            self.focus_id = ids[(ids.index(self._one()) + step) % len(ids)]
            self.bench.menu = ""

    def _go_undecided(self, after: str | None = None) -> None:
        ids, undecided = self.ids, set(self.bench.undecided())
        if not ids:
            return
        start = ids.index(after if after in ids else self._one())
        order = ids[start + 1 :] + ids[: start + 1]
        found = next((star for star in order if star in undecided), None)
        if found is None:
            self.bench.status.say("no star is undecided.")
            return
        self.focus_id = found

    def _accept_rest(self) -> None:
        session = self.bench.session
        if self.bench.examine_each:
            raise SessionError("each star must be examined: accept them one by one (A), or switch that off.")
        status = dict(zip((s.id for s in self.boxes), (s.status for s in self.boxes), strict=True))
        rest = [star for star in self.bench.undecided() if status.get(star) == "used"]
        if not rest:
            raise SessionError("no undecided star is in use.")
        self.bench.decide(lambda: session.accept_stars(rest), f"{len(rest)} stars accepted.")

    def _toggle_examine(self) -> None:
        self.bench.examine_each = not self.bench.examine_each
        self.bench.status.say(
            "each star must be examined before repointing and export."
            if self.bench.examine_each
            else "undecided stars follow the automatic judgement."
        )

    def _refit(self, what: str) -> None:
        """Fit all stars again with another radius or template."""
        session = self.bench.session
        if session.state.centers is None:
            self.bench.status.say(f"{what}; F finds the stars with it.")
            return
        options = self.search.refit_options(self.radius_px)
        self.bench.decide(
            lambda: session.refit_stars(None, **options),
            lambda: f"{what}: {int(session.state.mask('used').sum())} of {len(self.boxes)} stars in use.",
        )

    # -- the picture ------------------------------------------------------------------------------------------

    def _picked(self, event: Event) -> None:
        self.focus_id = str(event["arg"])
        self.bench.menu = ""

    def _place_tool(self) -> None:
        star = self._one()
        self.bench.tool = "" if self.bench.tool == "place_star" else "place_star"
        if self.bench.tool:
            self.bench.status.say(f"click in the picture where {star} is.")

    def tapped(self, pixel: float, line: float) -> None:
        """Place the star under decision, or go to the star that was clicked."""
        if self.bench.tool == "place_star":
            star = self._one()
            self.bench.tool = ""
            self.bench.decide(
                lambda: self.bench.session.place_star(star, (pixel, line)),
                lambda: f"{star} placed at pixel {pixel:.1f}, line {line:.1f}: {self._status_of(star)}.",
            )
            return
        near = self._nearest(pixel, line)
        if near is not None:
            self.focus_id = near
            self.bench.status.say(f"{near}: A accepts, R rejects, I places it by click.")

    def _status_of(self, star: str) -> str:
        box = next((b for b in self.boxes if b.id == star), None)
        return "not shown" if box is None else f"{box.status.replace('_', ' ')}, SNR {box.snr:.0f}"

    def _nearest(self, pixel: float, line: float) -> str | None:
        if not self.boxes:
            return None
        places = np.array([b.predicted_px if b.observed_px is None else b.observed_px for b in self.boxes])
        distance = np.hypot(*(places - (pixel, line)).T)
        distance = np.where(np.isfinite(distance), distance, np.inf)
        reach = max(MIN_CLICK_RADIUS_PX, CLICK_RADIUS_SHARE * max(self.bench.session.context.signal_dn.shape))
        nearest = int(np.argmin(distance))
        return self.boxes[nearest].id if distance[nearest] <= reach else None
