"""The tab of the stars: one extracted box after the other is accepted or rejected, by one key each; and its page.

Data, model and residual of one star are shown large, of the others small, or as a table; both in the order that the analyst
chooses, which the keys follow. Search radius (px, 1 to 80) and template (a
bright star, this star, the camera's Gaussian) are changed on the spot and all stars fitted again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from markupsafe import Markup

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession, JournalEntry, SessionState
from opnav_workbench.session.context import typical_noise_dn
from opnav_workbench.session.star_boxes import StarBox, StarRows, star_rows
from opnav_workbench.templating import png_url, words
from opnav_workbench.workbench.actions import PLACE_STAR, REASON_MENU, REJECT_REASONS, Action, ActionRegistry
from opnav_workbench.workbench.markup import PagePicture, render
from opnav_workbench.workbench.overlays import look_alike
from opnav_workbench.workbench.plots import ResidualPage, star_residuals
from opnav_workbench.workbench.recent import Recent
from opnav_workbench.workbench.stretch import RESIDUAL_SIGMAS, gray_png, residual_png
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab, next_of

__all__ = ["StarsTab"]


# ---- The page of the star boxes: data, model and residual of one star large, of the others small.

LARGE_PX, SMALL_PX = 104, 40
RESIDUAL_PLOT_PX = 222, 118
LOW_SIGMAS = -2.0  # the stretch begins below the background, so that its noise is seen
DECISION_SIGNS = {"accepted": "✓", "rejected": "✗", "": "?"}
STATUS_WORDS = {
    "used": "in use",
    "rejected": "not used",
    "not_detected": "not detected",
    "saturated": "saturated",
    "blended": "blended",
    "off_detector": "off the detector",
}


@dataclass(frozen=True, slots=True)
class LargePicture:
    """A picture of a star's box, with the predicted and the observed place (x, y) in it, px of the page."""

    picture: PagePicture
    predicted: tuple[float, float] | None
    observed: tuple[float, float] | None
    radius: float  # of the circle about the predicted place


@dataclass(frozen=True, slots=True)
class StarCard:
    """A star's box as the page shows it, and what the analyst decided on it."""

    box: StarBox
    decision: str = ""  # "accepted", "rejected", or none yet
    reason: str = ""
    short: str = ""  # the name, without what all of them begin with where it is long
    expected: str = ""  # what the expected place rests on; empty: nothing was looked for yet

    @property
    def id(self) -> str:
        """Catalog id."""
        return self.box.id

    @property
    def mag(self) -> float:
        """Magnitude."""
        return self.box.mag

    @property
    def sign(self) -> str:
        """Sign of the decision."""
        return DECISION_SIGNS[self.decision]

    @property
    def is_used(self) -> bool:
        """Whether the star is in use."""
        return self.box.status == "used"

    @property
    def state(self) -> str:
        """Its status in words."""
        if not self.expected and not self.box.method:
            return "not searched"
        return STATUS_WORDS.get(self.box.status, self.box.status)

    @property
    def snr(self) -> str:
        """Signal over noise in words."""
        return f"SNR {self.box.snr:.0f}" if np.isfinite(self.box.snr) else "no SNR"

    @property
    def hint(self) -> str:
        """One line on the star."""
        why = f"; {self.box.reason}" if self.box.reason else ""
        return f"{self.id}: {self.decision or 'undecided'}; {self.state}{why}"

    @property
    def facts(self) -> list[str]:
        """What is known of the star, a line each."""
        lines, box = [f"{self.mag:.1f} mag", self.snr], self.box
        if box.observed_px is not None:
            off = box.observed_px - box.predicted_px
            lines += [f"{off[0]:+.2f} px", f"{off[1]:+.2f} lines", f"from {self.expected}"]
        return [*lines, self.state]

    @property
    def flags(self) -> str:
        """Why it is not used, and what the fit says."""
        flags = "" if self.box.flags in ("", "ok") else self.box.flags
        return "; ".join(filter(None, (self.box.reason, flags))) if self.expected else ""

    @property
    def numbers(self) -> tuple[str, ...]:
        """Magnitude, SNR and observed minus expected (pixel, line, length), for the table."""
        seen_px = self.box.observed_px
        off = np.full(2, np.nan) if seen_px is None else seen_px - self.box.predicted_px
        snr = f"{self.box.snr:.0f}" if np.isfinite(self.box.snr) else "–"
        seen = (
            (f"{off[0]:+.2f}", f"{off[1]:+.2f}", f"{np.hypot(*off):.2f}")
            if np.isfinite(off).all()
            else ("–",) * 3
        )
        return f"{self.mag:.1f}", snr, *seen

    def small_pictures(self, noise_dn: float) -> list[tuple[str, PagePicture]]:
        """Return data, model and residual by name."""
        return [(name, PagePicture(url, SMALL_PX, SMALL_PX)) for name, url in self._pictures(noise_dn)]

    def large_pictures(self, noise_dn: float) -> list[tuple[str, LargePicture]]:
        """Return data, model and residual by name, large and with the star's places."""
        n_line, n_pixel = np.shape(self.box.data_dn)
        scale = LARGE_PX / max(n_line, n_pixel)
        predicted, observed = (
            self._place(place, scale) for place in (self.box.predicted_px, self.box.observed_px)
        )
        width, height, radius = round(n_pixel * scale), round(n_line * scale), 1.5 * scale
        return [
            (name, LargePicture(PagePicture(url, width, height), predicted, observed, radius))
            for name, url in self._pictures(noise_dn)
        ]

    def _place(self, place_px: FloatArray | None, scale: float) -> tuple[float, float] | None:
        if place_px is None or not np.isfinite(place_px).all():
            return None
        x, y = (np.asarray(place_px) - np.asarray(self.box.first_px) + 0.5) * scale
        return float(x), float(y)

    def _pictures(self, noise_dn: float) -> list[tuple[str, str]]:
        """Data, model and residual by name, as data URLs."""
        data, model = (np.asarray(part, dtype=float) for part in (self.box.data_dn, self.box.model_dn))
        urls = box_urls(data.tobytes(), model.tobytes(), np.shape(data)[1], noise_dn)
        return list(zip(("data", "model", "residual"), urls, strict=True))


@lru_cache(maxsize=256)
def box_urls(data_dn: bytes, model_dn: bytes, n_pixel: int, noise_dn: float) -> tuple[str, str, str]:
    """Return data and model in one stretch, and the residual in sigmas of the background's noise; kept, as keys ask again.

    Parameters
    ----------
    data_dn, model_dn
        float64, line by line.
    """
    data, model = (np.frombuffer(part).reshape(-1, n_pixel) for part in (data_dn, model_dn))
    finite = data[np.isfinite(data)]
    high, low = max(float(finite.max(initial=0.0)), 8.0 * noise_dn), LOW_SIGMAS * noise_dn
    residual = residual_png(data - model, RESIDUAL_SIGMAS * noise_dn)
    return png_url(gray_png(data, low, high)), png_url(gray_png(model, low, high)), png_url(residual)


@dataclass(frozen=True, slots=True)
class StarPage:
    """Everything that the page of the stars shows (templates/stars.html).

    Attributes
    ----------
    cards
        Those on the page.
    small
        The same as they are drawn, where they do not stand in a table.
    focus
        The star under decision.
    first, n_all, n_accepted, n_rejected
        Number of the first card; how many stars there are, and are decided.
    searched
        Whether the stars have been fitted.
    reasons_open, placing, examine_each
        The menu of reasons is open; a click places the star; each star must be decided on.
    table, columns
        Whether the others stand in a table; its columns: name of the order, heading, sign of the order.
    pointing
        One line.
    noise_dn
        Typical noise of the picture.
    """

    cards: tuple[StarCard, ...]
    small: Sequence[Markup]
    focus: StarCard
    first: int
    n_all: int
    n_accepted: int
    n_rejected: int
    searched: bool
    radius_px: float
    template: str
    reasons_open: bool
    reasons: tuple[Action, ...]
    placing: bool
    examine_each: bool
    table: bool
    columns: tuple[tuple[str, str, str], ...]
    pointing: str
    noise_dn: float
    residuals: Markup | None


# ---- The tab of the stars.

CLICK_RADIUS_SHARE = 0.02  # of the picture's longer side: a click so near to a star means it
MIN_CLICK_RADIUS_PX = 8.0
MIN_RING_PX = 6.0  # the ring about the star under decision stays clear of the star
BOXES_PER_PAGE = 24  # boxes on a page: what is seen at once, and quick to send
ROWS_PER_PAGE = 60  # of the table

_NONE, _NO_PLACES = np.empty(0), np.empty((0, 2))
NO_STARS = StarRows(np.empty(0, np.intp), (), _NONE, _NO_PLACES, _NO_PLACES, _NONE, (), ())

# What stars can be sorted by: heading in the table, and the key; the first is the catalog's order.
Order = Callable[[StarRows], Any]
ORDERS: Mapping[str, tuple[str, Order]] = MappingProxyType(
    {
        "catalog": ("star", lambda rows: np.arange(len(rows.ids))),
        "mag": ("mag", lambda rows: rows.mag),
        "snr": ("SNR", lambda rows: rows.snr),
        "pixel": ("Δ px", lambda rows: rows.off_px[:, 0]),
        "line": ("Δ line", lambda rows: rows.off_px[:, 1]),
        "off": ("O−C", lambda rows: np.hypot(*rows.off_px.T)),
        "status": ("status", lambda rows: list(map(" ".join, zip(rows.status, rows.verdict, strict=True)))),
    }
)
KEY_ORDERS = (
    ("catalog", False),
    ("mag", False),
    ("snr", True),
    ("off", True),
    ("status", False),
)  # of the key, in turn


def in_order(rows: StarRows, order: str, *, descending: bool) -> StarRows:
    """Return stars sorted; those without the number come last either way, equal ones stay as they are."""
    _, key = ORDERS[order]
    values, place = np.unique(np.asarray(key(rows)), return_inverse=True)
    known = np.array([value == value for value in values.tolist()], bool)[place]  # nan is not itself
    turn = np.where(known, -place if descending else place, len(values))
    return rows.taken(np.argsort(turn, kind="stable"))


NAME_LETTERS = 15  # that a small card has room for


def star_cards(
    boxes: Sequence[StarBox], decisions: Mapping[str, tuple[str, str]], expected: str
) -> tuple[StarCard, ...]:
    """Return the boxes with what the analyst decided on each; `expected`: what the expected places rest on."""
    return tuple(
        StarCard(box, *decisions.get(box.id, ("", "")), short=short_name(box.id), expected=expected)
        for box in boxes
    )


def short_name(name: str, letters: int = NAME_LETTERS) -> str:
    """Return the end of a long name: catalog numbers differ there.

    Examples
    --------
    >>> short_name("TYC 1234-567-1"), short_name("UCAC4 452-048216.7")
    ('TYC 1234-567-1', '…4 452-048216.7')
    """
    return name if len(name) <= letters else "…" + name[1 - letters :]


def expected_from(session: ImageSession) -> str:
    """Return what the expected places of stars rest on, in words; empty before any was looked for."""
    state = session.state
    if state.centers is None:
        return ""
    if state.pointing is not None:
        return "the solution"
    return "the a priori" if state.star_field is None else "the field found"


@dataclass(slots=True)
class _StarCache:
    """Stars as last asked for; they are the same as long as state and order are."""

    state: SessionState
    rows: StarRows
    order: tuple[str, bool] = ("", False)
    ordered: StarRows | None = None
    boxes: dict[str, StarBox] = field(default_factory=dict)  # of those that were shown
    drawn: dict[tuple[StarCard, bool], Markup] = field(
        default_factory=dict
    )  # cards, and whether under decision

    def take_over(self, before: "_StarCache") -> None:
        """Keep what was made of stars that look as before: a decision is on one of them."""
        decided = {star for star, _ in self.state.decisions.items() ^ before.state.decisions.items()}
        self.boxes |= {star: box for star, box in before.boxes.items() if star not in decided}
        self.drawn |= {of: card for of, card in before.drawn.items() if of[0].id not in decided}


class StarsTab(Tab):
    """The tab of the stars."""

    name = "stars"
    clicks_look = True

    def __init__(self, runner: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(runner, registry)
        self.focus_id = ""
        self.search = runner.search
        self.table = False
        self.order, self.descending = "catalog", False
        self._recent: Recent[_StarCache] = Recent()
        self._plots = ResidualPage(RESIDUAL_PLOT_PX)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def _cache(self) -> _StarCache:
        session = self.runner.session
        return self._recent.of((session.inputs, session.state), lambda: self._gathered(session))

    def _gathered(self, session: ImageSession) -> _StarCache:
        rows = NO_STARS
        if session.state.a_priori is not None:
            rows = star_rows(session.context, session.inputs, session.state)
            rows = rows.taken(np.flatnonzero([status != "off_detector" for status in rows.status]))
        gathered = _StarCache(session.state, rows)
        before = next(iter(self._recent), None)
        if before is not None and look_alike(before.state, session.state):
            gathered.take_over(before)
        return gathered

    @property
    def rows(self) -> StarRows:
        """All stars on the detector, in the order chosen."""
        cache, order = self._cache, (self.order, self.descending)
        if cache.ordered is None or cache.order != order:
            cache.order, cache.ordered = order, in_order(cache.rows, self.order, descending=self.descending)
        return cache.ordered

    @property
    def ids(self) -> tuple[str, ...]:
        """Their catalog ids."""
        return self.rows.ids

    def boxes(self, ids: Sequence[str]) -> tuple[StarBox, ...]:
        """Return the boxes of some stars."""
        made = self._cache.boxes
        missing = [star for star in ids if star not in made]
        if missing:
            made.update(zip(missing, self.runner.session.star_boxes(missing), strict=True))
        return tuple(made[star] for star in ids)

    @property
    def radius_px(self) -> float:
        """Search radius about the expected places."""
        return self.search.radius_px or self.runner.session.context.settings.search_radius_px

    @property
    def focused(self) -> StarBox | None:
        """The star under decision."""
        ids = self.ids
        star = self.focus_id if self.focus_id in ids else next(iter(ids), None)
        return None if star is None else self.boxes([star])[0]

    def on_enter(self) -> None:
        """Begin with the first undecided star."""
        if self.focus_id not in self.ids:
            undecided = self.runner.undecided()
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
            self.runner.viewer.focus(None)
            return
        self.runner.viewer.focus(box.place_px, max(self.radius_px, MIN_RING_PX))

    def look(self) -> None:
        """Bring the star under decision into the middle."""
        box = self.focused
        if box is not None:
            self.runner.viewer.look(box.place_px)

    def html(self) -> str:
        """Return the page: the star under decision large, the others as a grid, the pointing live."""
        session, focused = self.runner.session, self.focused
        if focused is None:
            predicted = session.state.a_priori is not None
            message = "No star is on the predicted field." if predicted else "Not predicted yet."
            return render("no_stars.html", message=message, actions=self.registry)
        return render("stars.html", page=self._page(session, focused.id), actions=self.registry)

    def _page(self, session: ImageSession, focus: str) -> StarPage:
        decisions = session.state.decisions
        place = self.ids.index(focus)
        room = ROWS_PER_PAGE if self.table else BOXES_PER_PAGE
        first = place // room * room
        shown = self.boxes(self.ids[first : first + room])
        cards = star_cards(shown, decisions, expected_from(session))
        verdicts = [decisions.get(star, ("",))[0] for star in self.ids]
        return StarPage(
            cards=cards,
            small=() if self.table else self._drawn(cards, focus, self._noise_dn()),
            focus=cards[place - first],
            first=first,
            n_all=len(self.ids),
            n_accepted=verdicts.count("accepted"),
            n_rejected=verdicts.count("rejected"),
            searched=session.state.centers is not None,
            radius_px=self.radius_px,
            template=self.search.template,
            reasons_open=self.runner.menu == REASON_MENU,
            reasons=tuple(action for action in self.registry if action.where == REASON_MENU),
            placing=self.runner.tool == PLACE_STAR,
            examine_each=self.runner.examine_each,
            table=self.table,
            columns=tuple((name, heading, self._sign(name)) for name, (heading, _) in ORDERS.items()),
            pointing=self.runner.pointing_line(),
            noise_dn=self._noise_dn(),
            residuals=self._plots.html(star_residuals(session), focus),
        )

    def _drawn(self, cards: Sequence[StarCard], focus: str, noise_dn: float) -> list[Markup]:
        """Return small cards as they stand in the page, each drawn once for what it shows."""
        kept, shown = self._cache.drawn, []
        for of in ((card, card.id == focus) for card in cards):
            if of not in kept:
                kept[of] = render("star_card.html", card=of[0], here=of[1], noise_dn=noise_dn)
            shown.append(kept[of])
        return shown

    def _sign(self, order: str) -> str:
        return "" if order != self.order else "▼" if self.descending else "▲"

    def _noise_dn(self) -> float:
        """Typical noise of the picture; 1 where none is known."""
        noise = typical_noise_dn(self.runner.session.context)
        return noise if np.isfinite(noise) else 1.0

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
            "repoint": lambda _: self.runner.repoint(),
            "place_star": lambda _: self._place_tool(),
            "smaller_radius": lambda _: self._refit(self.search.step_radius(self.radius_px, -1)),
            "larger_radius": lambda _: self._refit(self.search.step_radius(self.radius_px, +1)),
            "radius": lambda event: self._refit(self.search.type_radius(str(event["value"]))),
            "template": lambda _: self._refit(self.search.next_template(self._star_or_raise())),
            "examine": lambda _: self._toggle_examine(),
            "table": lambda _: self._toggle_table(),
            "sort": lambda _: self._next_order(),
            "sort_by": lambda event: self._sort_by(str(event["arg"])),
            "star": self._picked,
        }

    def find(self) -> None:
        """Find all stars, and begin with the first undecided one."""
        self.runner.find_stars(then=self.on_enter)

    def accept(self) -> None:
        """Accept the star under decision and go on."""
        star = self._star_or_raise()
        self.runner.decide(
            lambda: self.runner.session.accept_stars([star]),
            lambda: self._gone_on(star, "accepted"),
            quick=True,
        )

    def reject(self, reason: str) -> None:
        """Reject the star under decision and go on."""
        star = self._star_or_raise()
        self.runner.menu = ""
        self.runner.decide(
            lambda: self.runner.session.reject_stars([star], reason),
            lambda: self._gone_on(star, f"rejected ({reason})"),
            quick=True,
        )

    def _star_or_raise(self) -> str:
        box = self.focused
        if box is None:
            raise SessionError("no star is shown yet: F finds the stars.")
        return box.id

    def _gone_on(self, star: str, decision: str) -> str:
        left = self.runner.undecided()
        if left:
            self._go_undecided(star)
            return f"{star} {decision}; {len(left)} undecided."
        solved = self.runner.session.state.pointing is not None
        then = "" if solved else " P solves the pointing."
        return f"{star} {decision}; every star is decided.{then}"

    def _reason(self, reason: str) -> Handler:
        return lambda _: self.reject(reason)

    def _ask_reason(self) -> None:
        self._star_or_raise()
        self.runner.menu = "" if self.runner.menu == REASON_MENU else REASON_MENU

    def _go(self, step: int) -> None:
        ids = self.ids
        if ids:
            self.focus_id = ids[(ids.index(self._star_or_raise()) + step) % len(ids)]
            self.runner.menu = ""

    def _go_undecided(self, after: str | None = None) -> None:
        ids, undecided = self.ids, set(self.runner.undecided())
        if not ids:
            return
        found = next_of(ids, after if after in ids else self._star_or_raise(), undecided)
        if found is None:
            self.runner.status.say("no star is undecided.")
            return
        self.focus_id = found

    def _accept_rest(self) -> None:
        session = self.runner.session
        if self.runner.examine_each:
            raise SessionError("each star must be examined: accept them one by one (A), or switch that off.")
        status = dict(zip(self.ids, self.rows.status, strict=True))
        rest = [star for star in self.runner.undecided() if status.get(star) == "used"]
        if not rest:
            raise SessionError("no undecided star is in use.")
        self.runner.decide(lambda: session.accept_stars(rest), f"{len(rest)} stars accepted.", quick=True)

    def _toggle_examine(self) -> None:
        self.runner.examine_each = not self.runner.examine_each
        self.runner.status.say(
            "each star must be examined before repointing and export."
            if self.runner.examine_each
            else "undecided stars follow the automatic judgement."
        )

    def _toggle_table(self) -> None:
        self.table = not self.table

    def _next_order(self) -> None:
        now = (self.order, self.descending)
        turn = KEY_ORDERS.index(now) + 1 if now in KEY_ORDERS else 0
        self.order, self.descending = KEY_ORDERS[turn % len(KEY_ORDERS)]
        heading = "catalog" if self.order == "catalog" else ORDERS[self.order][0]
        self.runner.status.say(f"stars by {heading}{', largest first' if self.descending else ''}.")

    def _sort_by(self, order: str) -> None:
        """Sort by a column; once more: the other way around."""
        if order in ORDERS:
            self.order, self.descending = order, not self.descending if order == self.order else False

    def _refit(self, what: str) -> None:
        """Fit all stars again with another radius or template."""
        session = self.runner.session
        if session.state.centers is None:
            self.runner.status.say(f"{what}; F finds the stars with it.")
            return
        options = self.search.refit_options(self.radius_px)
        self.runner.decide(
            lambda: session.refit_stars(None, **options),
            lambda: f"{what}: {int(session.state.mask('used').sum())} of {len(self.ids)} stars in use.",
        )

    # -- the picture ------------------------------------------------------------------------------------------

    def _picked(self, event: PageEvent) -> None:
        self.focus_id = str(event["arg"])
        self.runner.menu = ""

    def _place_tool(self) -> None:
        self.runner.toggle_tool(PLACE_STAR, f"click in the picture where {self._star_or_raise()} is.")

    def tapped(self, pixel: float, line: float) -> None:
        """Place the star under decision, or go to the star that was clicked."""
        if self.runner.tool == PLACE_STAR:
            star = self._star_or_raise()
            self.runner.tool = ""
            self.runner.decide(
                lambda: self.runner.session.place_star(star, (pixel, line)),
                lambda: f"{star} placed at pixel {pixel:.1f}, line {line:.1f}: {self._status_of(star)}.",
            )
            return
        near = self._nearest(pixel, line)
        if near is not None:
            self.focus_id = near
            self.runner.status.say(f"{near}: A accepts, R rejects, I places it by click.")

    def _status_of(self, star: str) -> str:
        if star not in self.ids:
            return "not shown"
        (box,) = self.boxes([star])
        return f"{words(box.status)}, SNR {box.snr:.0f}"

    def _nearest(self, pixel: float, line: float) -> str | None:
        if not self.ids:
            return None
        distance = np.hypot(*(self.rows.place_px - (pixel, line)).T)
        distance = np.where(np.isfinite(distance), distance, np.inf)
        reach = max(
            MIN_CLICK_RADIUS_PX, CLICK_RADIUS_SHARE * max(self.runner.session.context.signal_dn.shape)
        )
        nearest = int(np.argmin(distance))
        return self.ids[nearest] if distance[nearest] <= reach else None
