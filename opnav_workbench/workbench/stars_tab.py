"""The tab of the stars: one extracted box after the other is accepted or rejected, by one key each; and its page.

Data, model and residual of one star are shown large, of the others small. Search radius (px, 1 to 80) and template (a
bright star, this star, the camera's Gaussian) are changed on the spot and all stars fitted again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession, JournalEntry
from opnav_workbench.session.star_boxes import StarBox
from opnav_workbench.workbench.actions import REASON_MENU, REJECT_REASONS, ActionRegistry
from opnav_workbench.workbench.markup import button, image, text
from opnav_workbench.workbench.plots import small_residual_plots, star_residuals
from opnav_workbench.workbench.stretch import RESIDUAL_SIGMAS, gray_png, residual_png
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab

__all__ = ["StarsTab"]


# ---- How stars are searched: radius and template, changed on the spot.

# Star template of the search: a well-exposed star of the picture, the star under decision, or the camera's Gaussian.
TEMPLATES = ("a bright star", "this star", "Gaussian")
RADIUS_STEP = 1.5  # factor of one key press
MIN_RADIUS_PX, MAX_RADIUS_PX = 1.0, 80.0


@dataclass(slots=True)
class StarSearch:
    """What the analyst chose.

    Attributes
    ----------
    template : str
        One of `TEMPLATES`.
    template_star : str or None
        Catalog id of the star that is the template.
    radius_px : float or None
        None: as the settings say.
    """

    template: str = TEMPLATES[0]
    template_star: str | None = None
    radius_px: float | None = None

    @property
    def initial(self) -> str:
        """Method of the first search."""
        return "cross_correlation" if self.template == "Gaussian" else "matched_filter"

    def next_template(self, star: str) -> str:
        """Take the next template; return what to say.  `star` is the one under decision.

        Examples
        --------
        >>> search = StarSearch()
        >>> search.next_template("HIP 1"), search.next_template("HIP 1"), search.initial
        ('template: HIP 1', 'template: Gaussian', 'cross_correlation')
        """
        self.template = TEMPLATES[(TEMPLATES.index(self.template) + 1) % len(TEMPLATES)]
        self.template_star = star if self.template == "this star" else None
        return f"template: {self.template_star or self.template}"

    def set_radius(self, radius_px: float) -> str:
        """Take another radius, within the limits; return what to say."""
        self.radius_px = round(float(np.clip(radius_px, MIN_RADIUS_PX, MAX_RADIUS_PX)), 2)
        return f"search radius {self.radius_px:g} px"

    def step_radius(self, present_px: float, steps: int) -> str:
        """Take a radius some key presses larger (or smaller) than the present one."""
        return self.set_radius(present_px * RADIUS_STEP**steps)

    def type_radius(self, typed: str) -> str:
        """Take a radius typed by the analyst.

        Raises
        ------
        SessionError
            It is no number.
        """
        try:
            radius = float(typed)
        except ValueError:
            radius = float("nan")
        if not np.isfinite(radius):
            raise SessionError(f"the search radius is a number of pixels, not {typed!r}.")
        return self.set_radius(radius)

    def refit_options(self, present_px: float) -> dict[str, Any]:
        """Return the arguments of `ImageSession.refit_stars`."""
        return {"initial": self.initial, "search_radius_px": present_px, "template": self.template_star}


# ---- The page of the star boxes: data, model and residual of one star large, of the others small.

LARGE_PX, SMALL_PX = 104, 40
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
class StarCard:
    """A star's box and the analyst's verdict on it."""

    box: StarBox
    verdict: str = ""  # "accepted", "rejected", or none yet
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StarPage:
    """Everything that the page of the stars shows."""

    cards: tuple[StarCard, ...]
    focus: StarCard | None
    first: int
    n_all: int
    n_accepted: int
    n_rejected: int
    searched: bool
    radius_px: float
    template: str
    menu: bool
    placing: bool
    examine_each: bool
    pointing: str
    noise_dn: float


def star_page_html(page: StarPage, session: ImageSession, registry: ActionRegistry) -> str:
    """Return the page of the stars."""
    if page.focus is None:
        empty = (
            "No star is on the predicted field."
            if session.state.a_priori is not None
            else "Not predicted yet."
        )
        return f'<div class="page"><p class="hint">{empty}</p>{button(registry["find_stars"])}</div>'
    return (
        f'<div class="page stars">{_tools(page, registry)}{_focus(page, registry)}{_counts(page, registry)}'
        f'<div class="grid">{"".join(_card(card, page) for card in page.cards)}</div>'
        f'<p class="solution">{text(page.pointing)}</p>{small_residual_plots(star_residuals(session))}</div>'
    )


def _tools(page: StarPage, registry: ActionRegistry) -> str:
    radius = (
        f'<label title="How far from its expected place a star is searched">radius '
        f'<input data-act="radius" value="{page.radius_px:g}" size="3" inputmode="decimal"> px</label>'
    )
    return (
        '<div class="tools">'
        + button(registry["find_stars"])
        + button(registry["repoint"], enabled=page.searched)
        + f'<span class="join">{button(registry["smaller_radius"])}{radius}{button(registry["larger_radius"])}</span>'
        + button(registry["template"], label=f"Template: {page.template}")
        + button(registry["examine"], on=page.examine_each)
        + "</div>"
    )


def _focus(page: StarPage, registry: ActionRegistry) -> str:
    card = page.focus
    assert card is not None
    names = ("data", "model", "residual")
    pictures = "".join(
        f"<figure>{_marked(png, card.box, name)}<figcaption>{name}</figcaption></figure>"
        for png, name in zip(_pngs(card.box, page.noise_dn), names, strict=True)
    )
    asked = (
        '<div class="menu" role="menu">Reject as '
        + "".join(button(action) for action in registry if action.where == REASON_MENU)
        + "</div>"
        if page.menu
        else '<div class="tools">'
        + button(registry["accept"])
        + button(registry["reject"])
        + button(registry["next_undecided"])
        + button(registry["place_star"], on=page.placing)
        + "</div>"
    )
    return (
        f'<section class="focus {card.verdict or "open"}">{_head(card)}'
        f'<div class="pictures">{pictures}{_facts(card.box)}</div>{asked}</section>'
    )


def _head(card: StarCard) -> str:
    why = f": {card.reason}" if card.reason else ""
    verdict = f"{DECISION_SIGNS[card.verdict]} {card.verdict or 'undecided'}{text(why)}"
    return (
        f'<header><b class="id">{text(card.box.id)}</b>'
        f'<span class="verdict {card.verdict or "open"}">{verdict}</span></header>'
    )


def _facts(box: StarBox) -> str:
    """What is known of the star, beside its pictures."""
    lines = [f"{box.mag:.1f} mag", _snr(box)]
    if box.observed_px is not None:
        off = box.observed_px - box.predicted_px
        lines += [f"{off[0]:+.2f} px", f"{off[1]:+.2f} lines"]
    state = STATUS_WORDS.get(box.status, box.status)
    said = "; ".join(filter(None, (box.reason, "" if box.flags in ("", "ok") else box.flags)))
    hint = "observed − predicted, in pixels and lines"
    rows = "".join(f"<div>{text(line)}</div>" for line in [*lines, state])
    flags = f'<div class="flags" title="{text(said)}">{text(said)}</div>'
    return f'<div class="beside-pictures" title="{hint}">{rows}{flags}</div>'


def _snr(box: StarBox) -> str:
    return f"SNR {box.snr:.0f}" if np.isfinite(box.snr) else "no SNR"


def _pngs(box: StarBox, noise_dn: float) -> tuple[str, str, str]:
    """Data and model in one stretch; the residual in sigmas of the background's noise."""
    data = np.asarray(box.data_dn, dtype=float)
    finite = data[np.isfinite(data)]
    high = max(float(finite.max(initial=0.0)), 8.0 * noise_dn)
    low = LOW_SIGMAS * noise_dn
    return (
        gray_png(data, low, high),
        gray_png(np.asarray(box.model_dn, dtype=float), low, high),
        residual_png(np.asarray(box.residual_dn, dtype=float), RESIDUAL_SIGMAS * noise_dn),
    )


def _marked(png: str, box: StarBox, name: str) -> str:
    """Return a large picture with the predicted place (dashed circle) and the observed one (cross)."""
    n_line, n_pixel = np.shape(box.data_dn)
    scale = LARGE_PX / max(n_line, n_pixel)
    width, height = round(n_pixel * scale), round(n_line * scale)

    def place(point: np.ndarray) -> tuple[float, float]:
        x, y = (np.asarray(point) - np.asarray(box.first_px) + 0.5) * scale
        return float(x), float(y)

    marks = ""
    if np.isfinite(box.predicted_px).all():
        x, y = place(box.predicted_px)
        marks += f'<circle class="predicted" cx="{x:.1f}" cy="{y:.1f}" r="{1.5 * scale:.1f}"/>'
    if box.observed_px is not None:
        x, y = place(box.observed_px)
        marks += f'<path class="observed" d="M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12"/>'
    over = f'<svg class="over" width="{width}" height="{height}">{marks}</svg>'
    return f'<div class="marked">{image(png, width, height, f"{box.id}: {name}")}{over}</div>'


def _counts(page: StarPage, registry: ActionRegistry) -> str:
    left = page.n_all - page.n_accepted - page.n_rejected
    shown = f"{page.first + 1} to {page.first + len(page.cards)} of {page.n_all}"
    return (
        f'<div class="counts"><span>{shown}</span><span class="accepted" title="accepted">✓ {page.n_accepted}</span>'
        f'<span class="rejected" title="rejected">✗ {page.n_rejected}</span>'
        f'<span class="open" title="undecided">? {left} undecided</span>{button(registry["accept_rest"])}</div>'
    )


def _card(card: StarCard, page: StarPage) -> str:
    box = card.box
    assert page.focus is not None
    pictures = "".join(
        image(png, SMALL_PX, SMALL_PX, name)
        for png, name in zip(_pngs(box, page.noise_dn), ("data", "model", "residual"), strict=True)
    )
    state = STATUS_WORDS.get(box.status, box.status)
    here = " here" if box.id == page.focus.box.id else ""
    hint = f"{box.id}: {card.verdict or 'undecided'}; {state}{'; ' + box.reason if box.reason else ''}"
    number = _snr(box) if box.status == "used" else state
    return (
        f'<article class="card {card.verdict or "open"}{here}" data-act="star" data-arg="{text(box.id)}"'
        f' data-star="{text(box.id)}"{" data-reveal" if here else ""} title="{text(hint)}">'
        f'<div class="name"><span class="sign">{DECISION_SIGNS[card.verdict]}</span>{text(box.id)}</div>'
        f'<div class="strip">{pictures}</div>'
        f'<div class="numbers"><span>{box.mag:.1f} mag</span><span>{text(number)}</span></div></article>'
    )


# ---- Star-box confirmation: one extracted box after the other is accepted or rejected, by one key each.

CLICK_RADIUS_SHARE = 0.02  # of the picture's longer side: a click so near to a star means it
MIN_CLICK_RADIUS_PX = 8.0
MIN_RING_PX = 6.0  # the ring about the star under decision stays clear of the star
BOXES_PER_PAGE = 24  # boxes on a page: what is seen at once, and quick to send


def star_cards(boxes: tuple[StarBox, ...], decisions: dict[str, tuple[str, str]]) -> tuple[StarCard, ...]:
    """Return the boxes with what the analyst decided on each."""
    return tuple(StarCard(box, *decisions.get(box.id, ("", ""))) for box in boxes)


@dataclass(slots=True)
class _BoxCache:
    """Boxes as last asked for; they are the same as long as the state is."""

    state: object = None
    boxes: tuple[StarBox, ...] = ()


class StarsTab(Tab):
    """The tab of the stars."""

    name = "stars"

    def __init__(self, bench: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(bench, registry)
        self.focus_id = ""
        self.search = StarSearch()
        self._kept = _BoxCache()
        self._noise: tuple[object, float] = (None, 1.0)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def boxes(self) -> tuple[StarBox, ...]:
        """Boxes of all stars on the detector, in the catalog's order of the prediction."""
        state = self.bench.session.state
        if self._kept.state is not state:
            boxes = self.bench.session.star_boxes() if state.a_priori is not None else ()
            self._kept = _BoxCache(state, tuple(b for b in boxes if b.status != "off_detector"))
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
        first = place // BOXES_PER_PAGE * BOXES_PER_PAGE
        page = StarPage(
            cards=cards[first : first + BOXES_PER_PAGE],
            focus=cards[place] if cards else None,
            first=first,
            n_all=len(cards),
            n_accepted=sum(card.verdict == "accepted" for card in cards),
            n_rejected=sum(card.verdict == "rejected" for card in cards),
            searched=session.state.centers is not None,
            radius_px=self.radius_px,
            template=self.search.template,
            menu=self.bench.menu == REASON_MENU,
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
        self.bench.menu = "" if self.bench.menu == REASON_MENU else REASON_MENU

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

    def _picked(self, event: PageEvent) -> None:
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
