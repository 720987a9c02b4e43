"""The page of the bodies: list, method, circle, the center with its covariance ellipse, and the difference picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.session import ImageSession
from opnav_workbench.widgets.actions import ActionRegistry
from opnav_workbench.widgets.limb_scans import scans_of
from opnav_workbench.widgets.limb_scans_html import scans_html
from opnav_workbench.widgets.target_circle import DrawnCircle
from opnav_workbench.widgets.workbench_html import button, gray_png, image, residual_png, text
from opnav_workbench.widgets.workbench_svg import Plot

__all__ = ["BodyPage", "body_page_html", "ellipse_points"]

LARGE_PX, SMALL_PX = 138, 96
ELLIPSE_POINTS = 60


@dataclass(frozen=True, slots=True)
class BodyPage:
    """Everything that the page of the bodies shows beside the session."""

    names: tuple[str, ...]
    chosen: str
    method: str
    methods: tuple[str, ...]
    solve_range: bool
    prediction: tuple[float, float, float] | None  # pixel, line, diameter
    circle: DrawnCircle | None
    tool: str
    focus_scan: int
    offered: tuple[str, ...]


def body_page_html(page: BodyPage, session: ImageSession, registry: ActionRegistry) -> str:
    """Return the page of the bodies."""
    if not page.chosen:
        empty = '<p class="hint">No body is expected in this picture.</p>'
        return f'<div class="page">{empty}<div class="tools">{_adder(page)}</div></div>'
    centers = [center for center in session.state.bodies if center.name == page.chosen]
    scans = scans_of(session, page.chosen)
    parts = [_list(page, session), _tools(page, registry), _circle(page, short=scans is not None)]
    if centers:
        parts.append(_center(centers[-1], page, short=scans is not None))
    if scans is not None:
        by_hand = session.state.scan_choices.get(page.chosen) is not None
        parts.append(scans_html(scans, page.focus_scan, by_hand, registry, page.tool == "box_scans"))
    return f'<div class="page bodies">{"".join(parts)}</div>'


def _words(name: str) -> str:
    return text(name.replace("_", " "))


def _list(page: BodyPage, session: ImageSession) -> str:
    chips = []
    for name in page.names:
        found = [c for c in session.state.bodies if c.name == name]
        how = ", ".join(f"{_words(c.method)}: {_words(c.status)}" for c in found) or "not sought yet"
        on = "true" if name == page.chosen else "false"
        sign = "●" if any(c.pixel_line is not None for c in found) else "○"
        chips.append(
            f'<button type="button" data-act="body" data-arg="{text(name)}" aria-pressed="{on}"'
            f' title="{text(name)}: {how}">{sign} {text(name)}</button>'
        )
    return f'<div class="tools">{"".join(chips)}{_adder(page)}</div>'


def _adder(page: BodyPage) -> str:
    offered = "".join(
        f'<button type="button" data-act="add_body" data-arg="{text(name)}">Add {text(name)}</button>'
        for name in page.offered
    )
    hint = "SPICE name, or a star of the target list"
    return f'{offered}<input data-act="add_body" size="9" placeholder="add a body" title="{hint}">'


def _tools(page: BodyPage, registry: ActionRegistry) -> str:
    options = "".join(
        f'<option value="{method}"{" selected" if method == page.method else ""}>{_words(method)}</option>'
        for method in page.methods
    )
    solve = (
        '<label title="Solve for the range (the apparent size) too, where the method can">'
        f'<input type="checkbox" data-act="solve_range"{" checked" if page.solve_range else ""}> range</label>'
    )
    return (
        f'<div class="tools">{button(registry["find_body"])}'
        f'<select data-act="method" title="{text(registry["method"].hint)}">{options}</select>{solve}'
        f"{button(registry['circle'], on=page.tool == 'circle')}"
        f"{button(registry['clear_circle'], enabled=page.circle is not None)}</div>"
    )


def _circle(page: BodyPage, *, short: bool) -> str:
    predicted = ""
    if page.prediction is not None and not short:
        pixel, line, diameter = page.prediction
        size = f", diameter {diameter:.1f} px" if np.isfinite(diameter) else ""
        predicted = f'<p class="facts">predicted: pixel {pixel:.1f}, line {line:.1f}{size}</p>'
    if page.circle is None:
        return predicted
    circle = page.circle
    fields = "".join(
        f'<label>{name} <input data-act="circle_field" data-arg="{name}" size="6" value="{value:.1f}"></label>'
        for name, value in (("pixel", circle.pixel), ("line", circle.line), ("radius", circle.radius_px))
    )
    return f'{predicted}<div class="tools circle"><b>Circle</b>{fields}</div>'


def _center(center: BodyCenter, page: BodyPage, *, short: bool) -> str:
    """The center: numbers, covariance ellipse and pictures; `short` leaves room for the scans below."""
    head = f"<b>{_words(center.method)}: {_words(center.status)}</b>"
    told = () if short and center.status == "ok" else center.messages  # the scans below say the same
    said = f'<p class="hint">{text("; ".join(told))}</p>' if told else ""
    if center.pixel_line is None:
        return f'<section class="center">{head}{said}</section>'
    table = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in _rows(center, page))
    ellipse = _ellipse_plot(center.covariance_px2)
    beside = _pictures(center, SMALL_PX, ("difference",)) if short else ""
    below = "" if short else _pictures(center, LARGE_PX, ("data", "model", "difference"))
    return (
        f'<section class="center">{head}<div class="beside"><table>{table}</table>{ellipse}{beside}</div>'
        f"{said}{below}</section>"
    )


def _rows(center: BodyCenter, page: BodyPage) -> list[tuple[str, str]]:
    pixel_line, sigma = center.pixel_line, np.sqrt(np.diag(center.covariance_px2))
    assert pixel_line is not None
    rows = [
        ("pixel", f"{pixel_line[0]:.3f} ± {sigma[0]:.3f}"),
        ("line", f"{pixel_line[1]:.3f} ± {sigma[1]:.3f}"),
        ("correlation", f"{center.covariance_px2[0, 1] / (sigma[0] * sigma[1]):+.2f}"),
    ]
    if page.prediction is not None:
        off = pixel_line - np.array(page.prediction[:2])
        rows += [("O − C pixel", f"{off[0]:+.3f}"), ("O − C line", f"{off[1]:+.3f}")]
    if np.isfinite(center.diameter_px):
        rows.append(("diameter", f"{center.diameter_px:.2f} px"))
    return rows


def ellipse_points(covariance_px2: FloatArray, sigmas: float = 1.0) -> FloatArray:
    """Return points (n, 2) on the ellipse of a covariance, closed, about the origin."""
    values, axes = np.linalg.eigh(covariance_px2)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(sigmas * (circle * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def _ellipse_plot(covariance_px2: FloatArray) -> str:
    if not np.isfinite(covariance_px2).all():
        return ""
    points = ellipse_points(covariance_px2)
    reach = 1.3 * float(np.abs(points).max()) or 1.0
    plot = Plot(SMALL_PX, SMALL_PX, (-reach, reach), (reach, -reach), bare=True)
    plot.line([0.0, 0.0], [-reach, reach], "axis").line([-reach, reach], [0.0, 0.0], "axis")
    plot.line(points[:, 0], points[:, 1], "data")
    return f"<figure>{plot.svg()}<figcaption>1 sigma, frame ±{reach:.2g} px</figcaption></figure>"


def _pictures(center: BodyCenter, size_px: int, wanted: Sequence[str]) -> str:
    pictures = center.pictures
    if pictures is None:
        return ""
    data = np.asarray(pictures.data_dn, dtype=float)
    scale = size_px / max(data.shape)
    width, height = max(round(data.shape[1] * scale), 1), max(round(data.shape[0] * scale), 1)
    low, high = np.percentile(data[np.isfinite(data)], (1.0, 99.8)) if np.isfinite(data).any() else (0.0, 1.0)
    difference = np.where(pictures.mask, pictures.difference_dn, np.nan)
    off = np.abs(difference[np.isfinite(difference)])
    full = float(np.percentile(off, 99.0)) if off.size else 1.0
    figures = []
    for name in wanted:
        if name == "difference":
            png, words = residual_png(difference, full), f"data − model, ±{_shown_dn(full)} DN"
        else:
            dn = data if name == "data" else np.asarray(pictures.model_dn, dtype=float)
            png, words = gray_png(dn, min(float(low), 0.0), float(high)), name
        shown = image(png, width, height, words)
        caption = words if len(wanted) > 1 else words.split(",")[0]  # alone it stands beside other things
        figures.append(f"<figure>{shown}<figcaption>{caption}</figcaption></figure>")
    return f'<div class="pictures">{"".join(figures)}</div>'


def _shown_dn(dn: float) -> str:
    return f"{dn:.0f}" if dn >= 10.0 else f"{dn:.2g}"
