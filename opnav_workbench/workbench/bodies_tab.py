"""The tab of the bodies: circles by click, centers by every method, limb scans chosen and judged; and its page.

The page shows the list of bodies, method, circle, the center with its 1-sigma covariance ellipse, and data, model and
difference. The prediction beside it is with the best known pointing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.bodies.results import LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import predict_body
from opnav_workbench.session import BODY_METHODS, ImageSession
from opnav_workbench.workbench import limb_scan_choice
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.circle_tool import CIRCLE_TOOL, CircleControl, DrawnCircle
from opnav_workbench.workbench.limb_scan_choice import scans_html, scans_of
from opnav_workbench.workbench.markup import button, image, text
from opnav_workbench.workbench.plots import SvgPlot
from opnav_workbench.workbench.stretch import gray_png, residual_png
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab
from opnav_workbench.workbench.viewer import Layer

__all__ = ["BodiesTab"]


# ---- The page of the bodies: list, method, circle, the center with its covariance ellipse, and the ...

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
    plot = SvgPlot(SMALL_PX, SMALL_PX, (-reach, reach), (reach, -reach), bare=True)
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


# ---- The tab of the bodies: circles by click, centers by every method, limb scans chosen and judged.

DRAG_SHAPES = {CIRCLE_TOOL: "circle", "box_scans": "box"}  # what a drag draws
SCANS_LAYER = "limb scans"


class BodiesTab(Tab):
    """The tab of the bodies."""

    name = "bodies"

    def __init__(self, bench: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(bench, registry)
        self.body = ""
        self.method = "auto"
        self.solve_range = False
        self.focus_scan = 0
        self.hand = CircleControl(bench, self._one)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Bodies expected in the picture, and those measured."""
        state = self.bench.session.state
        return list(dict.fromkeys((*state.targets, *(center.name for center in state.bodies))))

    @property
    def chosen(self) -> str:
        """The body at hand; empty where none is expected."""
        names = self.names
        return self.body if self.body in names else next(iter(names), "")

    @property
    def scans(self) -> LimbScans | None:
        """The limb scans of the body at hand."""
        return limb_scan_choice.scans_of(self.bench.session, self.chosen)

    @property
    def circle(self) -> DrawnCircle | None:
        """The analyst's circle of the body at hand."""
        return self.hand.of(self.chosen)

    def entered(self) -> None:
        """Begin with the first scan, and no shape half drawn."""
        self.hand.tool.drop()
        self.focus_scan = 0

    def draw(self) -> None:
        """Draw the circle and the scans of the body at hand."""
        viewer, circle, scans = self.bench.viewer, self.circle, self.scans
        viewer.focus(None)
        viewer.circle(
            None if circle is None else np.array(circle.center_px),
            0.0 if circle is None else circle.radius_px,
        )
        if scans is None:
            viewer.layer(SCANS_LAYER, Layer())
        else:
            frame_px = float(max(self.bench.session.context.signal_dn.shape))
            layer = limb_scan_choice.scan_layer(scans.places_px, scans.status, self.focus_scan, frame_px)
            viewer.layer(SCANS_LAYER, layer)
        viewer.drag_mode(self.bench.tool in DRAG_SHAPES, DRAG_SHAPES.get(self.bench.tool, "box"))

    def html(self) -> str:
        """Return the page."""
        session, name = self.bench.session, self.chosen
        page = BodyPage(
            names=tuple(self.names),
            chosen=name,
            method=self.method,
            methods=BODY_METHODS,
            solve_range=self.solve_range,
            prediction=None if not name else self._prediction(name),
            circle=self.circle,
            tool=self.bench.tool,
            focus_scan=self.focus_scan,
            offered=tuple(t for t in session.context.mission.default_targets if t not in self.names),
        )
        return body_page_html(page, session, self.registry)

    def _prediction(self, name: str) -> tuple[float, float, float] | None:
        session = self.bench.session
        target = session.inputs.targets.get(name)
        if target is None:
            return None
        seen = predict_body(
            target, session.inputs.observer, session.context.camera, session.camera_from_j2000
        )
        return float(seen.pixel_line[0]), float(seen.pixel_line[1]), float(seen.diameter_px)

    # -- actions -----------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return self.hand.handlers() | {
            "find_body": lambda _: self.find(),
            "next_body": lambda _: self._next_body(),
            "body": self._picked,
            "add_body": self._add,
            "method": self._choose_method,
            "solve_range": lambda _: self._toggle_range(),
            "next_scan": lambda _: self._go_scan(+1),
            "previous_scan": lambda _: self._go_scan(-1),
            "look_scan": self._look_scan,
            "scan": lambda event: self._toggle_scan(int(event["arg"])),
            "toggle_scan": lambda _: self._toggle_scan(self.focus_scan),
            "box_scans": lambda _: self._box_tool(),
            "pick_scans": lambda event: self._choose([int(n) for n in event["picks"]], "box"),
            "scans": self._typed_scans,
            "automatic_scans": lambda _: self._choose(None, ""),
        }

    def _one(self) -> str:
        if not self.chosen:
            raise SessionError("no body is expected in this picture; add one by its name.")
        return self.chosen

    def find(self) -> None:
        """Find the center of the body at hand."""
        name, session = self._one(), self.bench.session

        def work() -> None:
            session.find_body(name, self.method, solve_range=self.solve_range)
            session.observables()

        self.bench.run(f"finding {name}", work, lambda: self.center_line(name))

    def center_line(self, name: str) -> str:
        """One line on the center found last."""
        found = [center for center in self.bench.session.state.bodies if center.name == name]
        if not found:
            return f"{name}: nothing found."
        center = found[-1]
        said = "; ".join(center.messages)
        if center.pixel_line is None:
            return f"{name}, {center.method.replace('_', ' ')}: {center.status.replace('_', ' ')}. {said}"
        sigma = np.sqrt(np.diag(center.covariance_px2))
        return (
            f"{name}, {center.method.replace('_', ' ')}: pixel {center.pixel_line[0]:.3f} ± {sigma[0]:.3f}, "
            f"line {center.pixel_line[1]:.3f} ± {sigma[1]:.3f}, {center.status}. {said}"
        ).strip()

    def _next_body(self) -> None:
        names = self.names
        if names:
            self.body = names[(names.index(self._one()) + 1) % len(names)]
            self.focus_scan = 0

    def _picked(self, event: PageEvent) -> None:
        self.body, self.focus_scan = str(event["arg"]), 0

    def _add(self, event: PageEvent) -> None:
        name = str(event.get("value") or event.get("arg") or "").strip().upper()
        if name:
            self.body = name
            self.bench.run(
                f"adding {name}", lambda: self.bench.session.add_target(name), f"{name} is expected."
            )

    def _choose_method(self, event: PageEvent) -> None:
        value = event.get("value")
        methods: list[str] = list(BODY_METHODS)
        self.method = value if value in methods else methods[(methods.index(self.method) + 1) % len(methods)]

    def _toggle_range(self) -> None:
        self.solve_range = not self.solve_range

    # -- the picture ------------------------------------------------------------------------------------------

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click: for the circle, or on a scan."""
        if self.bench.tool == CIRCLE_TOOL:
            self.hand.tapped(pixel, line)
            return
        scans = self.scans
        number = None if scans is None else limb_scan_choice.scan_at(scans.places_px, pixel, line)
        if number is not None:
            self._toggle_scan(number)

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag: a circle from its center to its limb, or a box over scans."""
        if self.bench.tool == CIRCLE_TOOL:
            self.hand.dragged(pixel0, line0, pixel1, line1)
        elif self.bench.tool == "box_scans":
            self.bench.tool = ""
            places = self._scans().places_px
            self._choose(
                limb_scan_choice.scans_crossing(places, pixel0, line0, pixel1, line1), "box in the picture"
            )

    def abandon(self) -> bool:
        """Drop a center without a radius."""
        return self.hand.tool.drop()

    # -- scans -------------------------------------------------------------------------------------------------

    def _scans(self) -> LimbScans:
        scans = self.scans
        if scans is None:
            raise SessionError("no limb scans yet: choose the method limb scan, then F.")
        return scans

    def _go_scan(self, step: int) -> None:
        self.focus_scan = (self.focus_scan + step) % len(self._scans().status)

    def _look_scan(self, event: PageEvent) -> None:
        self.focus_scan = int(event["arg"])

    def _toggle_scan(self, number: int) -> None:
        self.focus_scan = number
        used = set(limb_scan_choice.chosen_scans(self._scans().status))
        self._choose(sorted(used ^ {number}), "by click")

    def _typed_scans(self, event: PageEvent) -> None:
        typed = str(event["value"])
        self._choose(limb_scan_choice.parse_scan_numbers(typed, len(self._scans().status)), "typed")

    def _box_tool(self) -> None:
        self._scans()
        self.bench.tool = "" if self.bench.tool == "box_scans" else "box_scans"
        if self.bench.tool:
            self.bench.status.say("drag a box in the picture over the scans that shall be used.")

    def _choose(self, numbers: list[int] | None, reason: str) -> None:
        name, session = self._one(), self.bench.session
        self._scans()
        if numbers is not None and not numbers:
            raise SessionError("no scan is in the box; nothing was changed.")

        def work() -> None:
            session.choose_scans(name, numbers, reason)
            if session.state.observables:
                session.observables()

        self.bench.run("choosing scans", work, lambda: self.center_line(name))
