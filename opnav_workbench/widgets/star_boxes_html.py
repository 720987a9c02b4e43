"""The page of the star boxes: data, model and residual of one star large, of the others small."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.session import ImageSession
from opnav_workbench.session.star_boxes import StarBox
from opnav_workbench.widgets.actions import MENU, ActionRegistry
from opnav_workbench.widgets.residual_plots import residual_rows, small_residual_plots
from opnav_workbench.widgets.workbench_html import (
    RESIDUAL_SIGMAS,
    button,
    gray_png,
    image,
    residual_png,
    text,
)

__all__ = ["StarCard", "StarPage", "star_page_html"]

LARGE_PX, SMALL_PX = 104, 40
LOW_SIGMAS = -2.0  # the stretch begins below the background, so that its noise is seen
VERDICT_SIGNS = {"accepted": "✓", "rejected": "✗", "": "?"}
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
        f'<p class="solution">{text(page.pointing)}</p>{small_residual_plots(residual_rows(session))}</div>'
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
        + "".join(button(action) for action in registry if action.where == MENU)
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
    verdict = f"{VERDICT_SIGNS[card.verdict]} {card.verdict or 'undecided'}{text(why)}"
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
        f'<div class="name"><span class="sign">{VERDICT_SIGNS[card.verdict]}</span>{text(box.id)}</div>'
        f'<div class="strip">{pictures}</div>'
        f'<div class="numbers"><span>{box.mag:.1f} mag</span><span>{text(number)}</span></div></article>'
    )
