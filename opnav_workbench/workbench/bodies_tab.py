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
from opnav_workbench.session import BODY_METHODS
from opnav_workbench.templating import png_url, words
from opnav_workbench.workbench.actions import (
    BOX_SCANS,
    CIRCLE,
    LIMB_POINTS,
    SUN,
    TERMINATOR,
    ActionRegistry,
)
from opnav_workbench.workbench.circle_tool import CircleControl, DrawnCircle
from opnav_workbench.workbench.description import (
    DescriptionControl,
    DescriptionField,
    description_fields,
)
from opnav_workbench.workbench.limb_scan_choice import (
    ScanPage,
    chosen_scans,
    parse_scan_numbers,
    scan_at,
    scan_layer,
    scan_page,
    scans_crossing,
    scans_of,
)
from opnav_workbench.workbench.markup import PagePicture, render
from opnav_workbench.workbench.overlays import body_marks, predicted_body
from opnav_workbench.workbench.plots import SvgPlot
from opnav_workbench.workbench.stretch import gray_png, residual_png
from opnav_workbench.workbench.tabs import FOLLOWS_CENTER, Handler, PageEvent, StepRunner, Tab
from opnav_workbench.workbench.viewer import Layer

__all__ = ["BodiesTab"]


# ---- The page of the bodies: list, method, circle, the center with its covariance ellipse, and the pictures.

LARGE_PX, SMALL_PX = 138, 96
ELLIPSE_POINTS = 60


@dataclass(frozen=True, slots=True)
class BodyChip:
    """A body of the list: how it was found, in words, and whether it was."""

    name: str
    how: str
    found: bool


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where a body is predicted with the best known pointing, and how large, px."""

    pixel: float
    line: float
    diameter_px: float
    is_on_detector: bool

    @property
    def is_sized(self) -> bool:
        """Whether it has a diameter: a star has none."""
        return bool(np.isfinite(self.diameter_px))


@dataclass(frozen=True, slots=True)
class EllipseShown:
    """The covariance ellipse, 1 sigma; the plot reaches so far from its center."""

    plot: SvgPlot
    reach_px: float


@dataclass(frozen=True, slots=True)
class BodyPictureShown:
    """Data, model or difference of a body, with its caption."""

    picture: PagePicture
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class SecondShown:
    """Another reading of the same pixels: its name, how far it lies from the first, and values for the first rows."""

    method: str
    apart: str
    values: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CenterShown:
    """A center as the page shows it: numbers as texts, covariance ellipse, pictures."""

    method: str
    status: str
    messages: str
    rows: list[tuple[str, str]]
    second: SecondShown | None
    ellipse: EllipseShown | None
    pictures: list[BodyPictureShown]


@dataclass(frozen=True, slots=True)
class BodyPage:
    """Everything that the page of the bodies shows (templates/bodies.html).

    Attributes
    ----------
    chosen
        The body at hand; empty: none is expected.
    method
        Chosen among `methods`.
    circle
        The analyst's.
    described
        What can be typed of a body that the analyst describes; nothing of others.
    tool
        What is being drawn.
    center
        Found last.
    scans
        The limb scans of the body; they leave little room for what stands above them.
    offered
        Bodies of the mission that can be added.
    """

    bodies: list[BodyChip]
    chosen: str
    method: str
    methods: tuple[str, ...]
    solve_range: bool
    prediction: Prediction | None
    circle: DrawnCircle | None
    described: list[DescriptionField]
    tool: str
    center: CenterShown | None
    scans: ScanPage | None
    offered: tuple[str, ...]


def name_and_radii(typed: str) -> tuple[str, list[float]]:
    """Return a body's name and the radii (km) typed after it; none without the unit, since names end in numbers, too.

    Examples
    --------
    >>> name_and_radii("nix 22 km"), name_and_radii("eros 17, 5.5, 5.5km"), name_and_radii("Wolf 359")
    (('NIX', [22.0, 22.0, 22.0]), ('EROS', [17.0, 5.5, 5.5]), ('WOLF 359', []))
    """
    words = typed.upper().replace(",", " ").split()
    if not words or not words[-1].endswith("KM"):
        return typed.strip().upper(), []
    words = [*words[:-1], *filter(None, [words[-1].removesuffix("KM")])]
    for count in (3, 1):
        try:
            radii = [float(word) for word in words[-count:]]
        except ValueError:
            continue
        if len(words) > count and np.isfinite(radii).all() and min(radii) > 0.0:
            return " ".join(words[:-count]), 3 * radii if count == 1 else radii
    raise SessionError(f"{typed!r}: write a name and its radius (NIX 22 km), or three semi-axes.")


def body_chip(name: str, centers: Sequence[BodyCenter]) -> BodyChip:
    """Return a body of the list with what was found of it."""
    how = ", ".join(f"{words(c.method)}: {words(c.status)}" for c in centers)
    return BodyChip(name, how or "not sought yet", any(c.pixel_line is not None for c in centers))


def center_shown(center: BodyCenter, prediction: Prediction | None, *, short: bool) -> CenterShown:
    """Return a center as the page shows it; `short` leaves room for the scans below, which say the same as messages."""
    messages = "" if short and center.status == "ok" else "; ".join(center.messages)
    if center.pixel_line is None:
        return CenterShown(center.method, center.status, messages, [], None, None, [])
    size_px, names = (SMALL_PX, ["difference"]) if short else (LARGE_PX, ["data", "model", "difference"])
    return CenterShown(
        center.method,
        center.status,
        messages,
        _center_rows(center, center.pixel_line, prediction),
        _second_shown(center, prediction),
        ellipse_shown(center.covariance_px2),
        _pictures_shown(center, size_px, names),
    )


def _second_shown(center: BodyCenter, prediction: Prediction | None) -> SecondShown | None:
    second = center.second
    if second is None or center.pixel_line is None:
        return None
    rows = _place_rows(second.pixel_line, second.covariance_px2, prediction)
    off = second.pixel_line - center.pixel_line
    apart = f"{off[0]:+.2f} px, {off[1]:+.2f} lines apart: {second.difference_sigmas:.1f} sigma"
    return SecondShown(second.method, apart, tuple(value for _, value in rows))


def _center_rows(
    center: BodyCenter, pixel_line: FloatArray, prediction: Prediction | None
) -> list[tuple[str, str]]:
    rows = _place_rows(pixel_line, center.covariance_px2, prediction)
    if np.isfinite(center.diameter_px):
        rows.append(("diameter", f"{center.diameter_px:.2f} px"))
    return rows


def _place_rows(
    pixel_line: FloatArray, covariance_px2: FloatArray, prediction: Prediction | None
) -> list[tuple[str, str]]:
    """Names and values of a measured place; of another reading of the same pixels the values stand beside these."""
    sigma = np.sqrt(np.diag(covariance_px2))
    rows = [
        ("pixel", f"{pixel_line[0]:.3f} ± {sigma[0]:.3f}"),
        ("line", f"{pixel_line[1]:.3f} ± {sigma[1]:.3f}"),
        ("correlation", f"{covariance_px2[0, 1] / (sigma[0] * sigma[1]):+.2f}"),
    ]
    if prediction is not None:
        rows.append(("O − C pixel", f"{pixel_line[0] - prediction.pixel:+.3f}"))
        rows.append(("O − C line", f"{pixel_line[1] - prediction.line:+.3f}"))
    return rows


def ellipse_points(covariance_px2: FloatArray, sigmas: float = 1.0) -> FloatArray:
    """Return points (n, 2) on the ellipse of a covariance, closed, about the origin."""
    values, axes = np.linalg.eigh(covariance_px2)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(sigmas * (circle * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def ellipse_shown(covariance_px2: FloatArray) -> EllipseShown | None:
    """Return the plot of a covariance's ellipse; None where the covariance is not finite."""
    if not np.isfinite(covariance_px2).all():
        return None
    points = ellipse_points(covariance_px2)
    reach = 1.3 * float(np.abs(points).max()) or 1.0
    plot = SvgPlot(SMALL_PX, SMALL_PX, (-reach, reach), (reach, -reach), bare=True)
    plot.add_curve([0.0, 0.0], [-reach, reach], "axis").add_curve([-reach, reach], [0.0, 0.0], "axis")
    plot.add_curve(points[:, 0], points[:, 1], "data")
    return EllipseShown(plot, reach)


def _pictures_shown(center: BodyCenter, size_px: int, wanted: Sequence[str]) -> list[BodyPictureShown]:
    pictures = center.pictures
    if pictures is None:
        return []
    data = np.asarray(pictures.data_dn, dtype=float)
    scale = size_px / max(data.shape)
    width, height = max(round(data.shape[1] * scale), 1), max(round(data.shape[0] * scale), 1)
    low, high = np.percentile(data[np.isfinite(data)], (1.0, 99.8)) if np.isfinite(data).any() else (0.0, 1.0)
    difference = np.where(pictures.mask, pictures.difference_dn, np.nan)
    off = np.abs(difference[np.isfinite(difference)])
    full = float(np.percentile(off, 99.0)) if off.size else 1.0
    shown = []
    for name in wanted:
        if name == "difference":
            png, title = residual_png(difference, full), f"data − model, ±{_dn_text(full)} DN"
        else:
            dn = data if name == "data" else np.asarray(pictures.model_dn, dtype=float)
            if name == "model":  # none was made where no pixel was used
                dn = np.where(pictures.mask | (dn != 0.0), dn, np.nan)
            png, title = gray_png(dn, min(float(low), 0.0), float(high)), name
        caption = title if len(wanted) > 1 else title.split(",")[0]  # alone it stands beside other things
        shown.append(BodyPictureShown(PagePicture(png_url(png), width, height), title, caption))
    return shown


def _dn_text(dn: float) -> str:
    return f"{dn:.0f}" if dn >= 10.0 else f"{dn:.2g}"


# ---- The tab of the bodies: circles by click, centers by every method, limb scans chosen and judged.

DRAG_SHAPES = {CIRCLE: "circle", BOX_SCANS: "box", SUN: "line"}  # what a drag draws
CIRCLE_LAYER = "limb points"
SCANS_LAYER = "limb scans"
# Of the picture when the tab is opened: diameters, and px for a small body
BODY_SPAN, LEAST_SPAN_PX = 1.8, 48.0


class BodiesTab(Tab):
    """The tab of the bodies."""

    name = "bodies"

    def __init__(self, runner: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(runner, registry)
        self.body = ""
        self._by_hand_km: dict[str, list[float]] = {}  # bodies that wait for their circle
        self.method = "auto"
        self.solve_range = False
        self.focus_scan = 0
        self._sought = False  # the center at hand was just found, and may be out of sight
        self.circle_control = CircleControl(runner, self._body_or_raise, self._by_hand_km.get)
        self.description = DescriptionControl(runner, self._body_or_raise, self.circle_control.of)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Bodies expected in the picture, and those measured."""
        state = self.runner.session.state
        return list(
            dict.fromkeys((*state.targets, *(center.name for center in state.bodies), *self._by_hand_km))
        )

    @property
    def chosen(self) -> str:
        """The body at hand; empty where none is expected."""
        names = self.names
        return self.body if self.body in names else next(iter(names), "")

    @property
    def scans(self) -> LimbScans | None:
        """The limb scans of the body at hand."""
        return scans_of(self.runner.session, self.chosen)

    @property
    def circle(self) -> DrawnCircle | None:
        """The analyst's circle of the body at hand."""
        return self.circle_control.of(self.chosen)

    @property
    def moves_circle(self) -> bool:
        """Whether the arrow keys move the circle: where there are scans, they go from one to the next."""
        return self.circle is not None and self.scans is None

    def on_enter(self) -> None:
        """Begin with the first scan, and no shape half drawn."""
        self.circle_control.tool.drop()
        self.focus_scan = 0
        self._sought = False

    def draw(self) -> None:
        """Draw the circle and the scans of the body at hand; bring what was just found into sight."""
        if self._sought:
            self._sought = False
            self.look(unless_seen=True)
        viewer, circle, scans = self.runner.viewer, self.circle, self.scans
        viewer.focus(None)
        viewer.circle(
            None if circle is None else np.array(circle.center_px),
            0.0 if circle is None else circle.radius_px,
        )
        if scans is None:
            viewer.layer(SCANS_LAYER, Layer())
        else:
            picture_px = float(max(self.runner.session.context.signal_dn.shape))
            layer = scan_layer(scans.places_px, scans.status, self.focus_scan, picture_px)
            viewer.layer(SCANS_LAYER, layer)
        drawing = self.runner.tool in (CIRCLE, LIMB_POINTS)
        viewer.layer(CIRCLE_LAYER, self.circle_control.tool.layer() if drawing else Layer())
        viewer.drag_mode(self.runner.tool in DRAG_SHAPES, DRAG_SHAPES.get(self.runner.tool, "box"))

    def look(self, *, unless_seen: bool = False) -> None:
        """Bring the body at hand into the middle, as large as it is judged best."""
        marks = {mark.name: mark for mark in body_marks(self.runner.session)}
        mark = marks.get(self.chosen)
        if mark is not None and self._is_on_detector(mark.center_px, mark.radius_px):
            span_px = max(BODY_SPAN * 2.0 * mark.radius_px, LEAST_SPAN_PX)
            self.runner.viewer.look(mark.center_px, span_px, unless_seen=unless_seen)

    def html(self) -> str:
        """Return the page."""
        return render("bodies.html", page=self._page(), actions=self.registry)

    def _page(self) -> BodyPage:
        session, name, scans = self.runner.session, self.chosen, self.scans
        by_name = {n: [c for c in session.state.bodies if c.name == n] for n in self.names}
        centers, prediction = by_name.get(name, []), self._prediction(name)
        by_hand = session.state.scan_choices.get(name) is not None
        boxing = self.runner.tool == BOX_SCANS
        expected = None if name in session.state.assisted else prediction  # of no ephemeris: no residual
        return BodyPage(
            bodies=[body_chip(n, found) for n, found in by_name.items()],
            chosen=name,
            method=self.method,
            methods=BODY_METHODS,
            solve_range=self.solve_range,
            prediction=prediction,
            circle=self.circle,
            described=description_fields(session, name),
            tool=self.runner.tool,
            center=center_shown(centers[-1], expected, short=scans is not None) if centers else None,
            scans=None
            if scans is None
            else scan_page(scans, self.focus_scan, by_hand=by_hand, boxing=boxing),
            offered=tuple(t for t in session.context.mission.default_targets if t not in self.names),
        )

    def _prediction(self, name: str) -> Prediction | None:
        session = self.runner.session
        target = session.inputs.targets.get(name)
        if target is None:
            return None
        seen = predicted_body(session, target)
        pixel, line = map(float, seen.pixel_line)
        on = self._is_on_detector(seen.pixel_line, 0.5 * float(np.nan_to_num(seen.diameter_px)))
        return Prediction(pixel, line, float(seen.diameter_px), on)

    def _is_on_detector(self, center_px: FloatArray, radius_px: float) -> bool:
        """Whether any of a body may be seen."""
        n_line, n_pixel = self.runner.session.context.picture.image_dn.shape
        last = np.array([n_pixel, n_line]) - 0.5
        return bool(np.all((center_px > -0.5 - radius_px) & (center_px < last + radius_px)))

    # -- actions -----------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return (
            self.circle_control.handlers()
            | self.description.handlers()
            | {
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
        )

    def _body_or_raise(self) -> str:
        if not self.chosen:
            raise SessionError("no body is expected in this picture; add one by its name.")
        return self.chosen

    def find(self) -> None:
        """Find the center of the body at hand."""
        name, session = self._body_or_raise(), self.runner.session
        if name in self._by_hand_km and name not in session.state.targets:
            raise SessionError(f"{name} is described by its circle: K, then two clicks.")

        def work() -> None:
            session.find_body(name, self.method, solve_range=self.solve_range)
            session.observables(FOLLOWS_CENTER)

        def found() -> str:
            self._sought = name == self.chosen
            return self.center_line(name)

        self.runner.run(f"finding {name}", work, found)

    def center_line(self, name: str) -> str:
        """One line on the center found last."""
        centers = [center for center in self.runner.session.state.bodies if center.name == name]
        if not centers:
            return f"{name}: nothing found."
        center = centers[-1]
        place = ""
        if center.pixel_line is not None:
            sigma = np.sqrt(np.diag(center.covariance_px2))
            pixel, line = center.pixel_line
            place = f"pixel {pixel:.3f} ± {sigma[0]:.3f}, line {line:.3f} ± {sigma[1]:.3f}, "
        found = f"{name}, {words(center.method)}: {place}{words(center.status)}"
        return "; ".join([found, *center.messages])

    def _next_body(self) -> None:
        names = self.names
        if names:
            self.body = names[(names.index(self._body_or_raise()) + 1) % len(names)]
            self.focus_scan = 0
            self.look()

    def _picked(self, event: PageEvent) -> None:
        self.body, self.focus_scan = str(event["arg"]), 0
        self.look()

    def _add(self, event: PageEvent) -> None:
        name, radii = name_and_radii(str(event.get("value") or event.get("arg") or ""))
        if radii:
            self._begin_by_hand(name, radii)
        elif name:
            self.body = name
            self.runner.run(
                f"adding {name}", lambda: self.runner.session.add_target(name), f"{name} is expected."
            )

    def _begin_by_hand(self, name: str, radii_km: list[float]) -> None:
        """Take the circle that describes a body which no ephemeris knows."""
        self.body = name
        self._by_hand_km[name] = radii_km
        self.runner.tool = ""
        self.circle_control.take_tool()
        self.runner.status.say(f"{name}: {self.circle_control.tool.prompt}")

    def _choose_method(self, event: PageEvent) -> None:
        value = event.get("value")
        methods: list[str] = list(BODY_METHODS)
        self.method = value if value in methods else methods[(methods.index(self.method) + 1) % len(methods)]

    def _toggle_range(self) -> None:
        self.solve_range = not self.solve_range

    # -- the picture ------------------------------------------------------------------------------------------

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click: for the circle, or on a scan."""
        if self.runner.tool in (CIRCLE, LIMB_POINTS):
            self.circle_control.tapped(pixel, line)
            return
        if self.runner.tool in (SUN, TERMINATOR):
            self.description.tapped(pixel, line)
            return
        scans = self.scans
        number = None if scans is None else scan_at(scans.places_px, pixel, line)
        if number is not None:
            self._toggle_scan(number)

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag: a circle from its center to its limb, or a box over scans."""
        if self.runner.tool == CIRCLE:
            self.circle_control.dragged(pixel0, line0, pixel1, line1)
        elif self.runner.tool == SUN:
            self.description.dragged(pixel0, line0, pixel1, line1)
        elif self.runner.tool == BOX_SCANS:
            self.runner.tool = ""
            places = self._scans().places_px
            self._choose(scans_crossing(places, pixel0, line0, pixel1, line1), "box in the picture")

    def drop_unfinished(self) -> bool:
        """Drop places that make no circle yet."""
        return self.circle_control.tool.drop()

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
        used = set(chosen_scans(self._scans().status))
        self._choose(sorted(used ^ {number}), "by click")

    def _typed_scans(self, event: PageEvent) -> None:
        typed = str(event["value"])
        self._choose(parse_scan_numbers(typed, len(self._scans().status)), "typed")

    def _box_tool(self) -> None:
        self._scans()
        self.runner.toggle_tool(BOX_SCANS, "drag a box in the picture over the scans that shall be used.")

    def _choose(self, numbers: list[int] | None, reason: str) -> None:
        name, session = self._body_or_raise(), self.runner.session
        self._scans()
        if numbers is not None and not numbers:
            raise SessionError("no scan is in the box; nothing was changed.")

        def work() -> None:
            session.choose_scans(name, numbers, reason)
            if session.state.observables:
                session.observables(FOLLOWS_CENTER)

        self.runner.run("choosing scans", work, lambda: self.center_line(name))
