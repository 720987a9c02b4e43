"""The tab of the stars: one extracted box after the other is accepted or rejected, by one key each; and its page.

Data, model and residual of one star are shown large, of the others small, or as a table; both in the order that the analyst
chooses, which the keys follow. Search radius (px, 1 to 80) and template (a
bright star, this star, the camera's Gaussian) are changed on the spot and all stars fitted again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession, JournalEntry
from opnav_workbench.session.context import typical_noise_dn
from opnav_workbench.session.star_boxes import StarBox
from opnav_workbench.templating import png_url, words
from opnav_workbench.workbench.actions import PLACE_STAR, REASON_MENU, REJECT_REASONS, Action, ActionRegistry
from opnav_workbench.workbench.markup import PagePicture, render
from opnav_workbench.workbench.plots import ResidualPlots, StarResiduals, residual_plots, star_residuals
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
        off = off_px(self.box)
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
        """Data and model in one stretch; the residual in sigmas of the background's noise."""
        data = np.asarray(self.box.data_dn, dtype=float)
        model = np.asarray(self.box.model_dn, dtype=float)
        finite = data[np.isfinite(data)]
        high = max(float(finite.max(initial=0.0)), 8.0 * noise_dn)
        low = LOW_SIGMAS * noise_dn
        residual = np.asarray(self.box.residual_dn, dtype=float)
        pngs = (
            gray_png(data, low, high),
            gray_png(model, low, high),
            residual_png(residual, RESIDUAL_SIGMAS * noise_dn),
        )
        return list(zip(("data", "model", "residual"), map(png_url, pngs), strict=True))


def off_px(box: StarBox) -> FloatArray:
    """Return observed minus expected (2,), px; nan where nothing was observed."""
    return np.full(2, np.nan) if box.observed_px is None else np.asarray(box.observed_px - box.predicted_px)


@dataclass(frozen=True, slots=True)
class StarPage:
    """Everything that the page of the stars shows (templates/stars.html).

    Attributes
    ----------
    cards
        Those on the page.
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
    residuals: ResidualPlots | None


# ---- The tab of the stars.

CLICK_RADIUS_SHARE = 0.02  # of the picture's longer side: a click so near to a star means it
MIN_CLICK_RADIUS_PX = 8.0
MIN_RING_PX = 6.0  # the ring about the star under decision stays clear of the star
BOXES_PER_PAGE = 24  # boxes on a page: what is seen at once, and quick to send
ROWS_PER_PAGE = 60  # of the table

# What stars can be sorted by: heading in the table, and the key; the first is the catalog's order.
Order = Callable[[StarBox], Any]
ORDERS: Mapping[str, tuple[str, Order]] = MappingProxyType(
    {
        "catalog": ("star", lambda _: 0),
        "mag": ("mag", lambda box: box.mag),
        "snr": ("SNR", lambda box: box.snr),
        "pixel": ("Δ px", lambda box: off_px(box)[0]),
        "line": ("Δ line", lambda box: off_px(box)[1]),
        "off": ("O−C", lambda box: np.hypot(*off_px(box))),
        "status": ("status", lambda box: (box.status, box.verdict)),
    }
)
KEY_ORDERS = (
    ("catalog", False),
    ("mag", False),
    ("snr", True),
    ("off", True),
    ("status", False),
)  # of the key, in turn


def in_order(boxes: Sequence[StarBox], order: str, *, descending: bool) -> tuple[StarBox, ...]:
    """Return boxes sorted; those without the number come last either way."""
    if order == "catalog":
        return tuple(reversed(boxes)) if descending else tuple(boxes)
    _, key = ORDERS[order]
    keys = [(key(box), box) for box in boxes]
    known = [pair for pair in keys if pair[0] == pair[0]]  # nan is not itself
    known.sort(key=itemgetter(0), reverse=descending)
    return tuple(box for _, box in (*known, *(pair for pair in keys if pair[0] != pair[0])))


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
class _BoxCache:
    """Boxes as last asked for; they are the same as long as state and order are."""

    state: object = None
    boxes: tuple[StarBox, ...] = ()
    order: tuple[str, bool] = ("", False)
    ordered: tuple[StarBox, ...] = ()
    ids: tuple[str, ...] = ()
    by_id: Mapping[str, StarBox] = field(default_factory=dict)
    residuals: StarResiduals | None = None


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
        self._box_cache = _BoxCache()

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def boxes(self) -> tuple[StarBox, ...]:
        """Boxes of all stars on the detector, in the order chosen."""
        state = self.runner.session.state
        if self._box_cache.state is not state:
            boxes = self.runner.session.star_boxes() if state.a_priori is not None else ()
            self._box_cache = _BoxCache(state, tuple(b for b in boxes if b.status != "off_detector"))
        cache, order = self._box_cache, (self.order, self.descending)
        if cache.order != order:
            cache.order, cache.ordered = order, in_order(cache.boxes, self.order, descending=self.descending)
            cache.ids = tuple(box.id for box in cache.ordered)
            cache.by_id = {box.id: box for box in cache.ordered}
        return cache.ordered

    @property
    def ids(self) -> tuple[str, ...]:
        """Catalog ids in the order of the boxes."""
        _ = self.boxes  # of the present state
        return self._box_cache.ids

    @property
    def radius_px(self) -> float:
        """Search radius about the expected places."""
        return self.search.radius_px or self.runner.session.context.settings.search_radius_px

    @property
    def focused(self) -> StarBox | None:
        """The star under decision."""
        boxes = self.boxes
        return self._box_cache.by_id.get(self.focus_id) or next(iter(boxes), None)

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
        boxes, decisions = self.boxes, session.state.decisions
        place = self.ids.index(focus)
        room = ROWS_PER_PAGE if self.table else BOXES_PER_PAGE
        first = place // room * room
        cards = star_cards(boxes[first : first + room], decisions, expected_from(session))
        verdicts = [decisions.get(star, ("",))[0] for star in self.ids]
        return StarPage(
            cards=cards,
            focus=cards[place - first],
            first=first,
            n_all=len(boxes),
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
            residuals=residual_plots(self._residuals(session), RESIDUAL_PLOT_PX, focus),
        )

    def _residuals(self, session: ImageSession) -> StarResiduals:
        """Residuals of the stars in use, found once for each state."""
        if self._box_cache.residuals is None:
            self._box_cache.residuals = star_residuals(session)
        return self._box_cache.residuals

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
            lambda: self.runner.session.accept_stars([star]), lambda: self._gone_on(star, "accepted")
        )

    def reject(self, reason: str) -> None:
        """Reject the star under decision and go on."""
        star = self._star_or_raise()
        self.runner.menu = ""
        self.runner.decide(
            lambda: self.runner.session.reject_stars([star], reason),
            lambda: self._gone_on(star, f"rejected ({reason})"),
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
        then = self.runner.pointing_line() if solved else "P solves the pointing."
        return f"{star} {decision}; every star is decided. {then}"

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
        status = dict(zip((s.id for s in self.boxes), (s.status for s in self.boxes), strict=True))
        rest = [star for star in self.runner.undecided() if status.get(star) == "used"]
        if not rest:
            raise SessionError("no undecided star is in use.")
        self.runner.decide(lambda: session.accept_stars(rest), f"{len(rest)} stars accepted.")

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
            lambda: f"{what}: {int(session.state.mask('used').sum())} of {len(self.boxes)} stars in use.",
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
        box = next((b for b in self.boxes if b.id == star), None)
        return "not shown" if box is None else f"{words(box.status)}, SNR {box.snr:.0f}"

    def _nearest(self, pixel: float, line: float) -> str | None:
        if not self.boxes:
            return None
        places = np.array([box.place_px for box in self.boxes])
        distance = np.hypot(*(places - (pixel, line)).T)
        distance = np.where(np.isfinite(distance), distance, np.inf)
        reach = max(
            MIN_CLICK_RADIUS_PX, CLICK_RADIUS_SHARE * max(self.runner.session.context.signal_dn.shape)
        )
        nearest = int(np.argmin(distance))
        return self.boxes[nearest].id if distance[nearest] <= reach else None
