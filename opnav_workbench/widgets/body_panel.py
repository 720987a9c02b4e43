"""The tab of the bodies: circles by click, centers by every method, limb scans chosen and judged."""

import numpy as np

from opnav_workbench.bodycenters.limb_scan_results import LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.scene import predict_body
from opnav_workbench.session import BODY_METHODS
from opnav_workbench.widgets import limb_scans
from opnav_workbench.widgets.actions import ActionRegistry
from opnav_workbench.widgets.body_panel_html import BodyPage, body_page_html
from opnav_workbench.widgets.target_circle import DrawnCircle
from opnav_workbench.widgets.target_circle_hand import TOOL, CircleHand
from opnav_workbench.widgets.workbench_bench import Bench
from opnav_workbench.widgets.workbench_desk import Desk, Event, Handler
from opnav_workbench.widgets.workbench_viewer import Layer

__all__ = ["BodiesDesk"]

SHAPES = {TOOL: "circle", "box_scans": "box"}  # what a drag draws
LAYER = "limb scans"


class BodiesDesk(Desk):
    """The tab of the bodies."""

    name = "bodies"

    def __init__(self, bench: Bench, registry: ActionRegistry) -> None:
        super().__init__(bench, registry)
        self.body = ""
        self.method = "auto"
        self.solve_range = False
        self.focus_scan = 0
        self.hand = CircleHand(bench, self._one)

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
        return limb_scans.scans_of(self.bench.session, self.chosen)

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
            viewer.layer(LAYER, Layer())
        else:
            frame_px = float(max(self.bench.session.context.signal_dn.shape))
            layer = limb_scans.scan_layer(scans.places_px, scans.status, self.focus_scan, frame_px)
            viewer.layer(LAYER, layer)
        viewer.drag_mode(self.bench.tool in SHAPES, SHAPES.get(self.bench.tool, "box"))

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

    def _picked(self, event: Event) -> None:
        self.body, self.focus_scan = str(event["arg"]), 0

    def _add(self, event: Event) -> None:
        name = str(event.get("value") or event.get("arg") or "").strip().upper()
        if name:
            self.body = name
            self.bench.run(
                f"adding {name}", lambda: self.bench.session.add_target(name), f"{name} is expected."
            )

    def _choose_method(self, event: Event) -> None:
        value = event.get("value")
        methods: list[str] = list(BODY_METHODS)
        self.method = value if value in methods else methods[(methods.index(self.method) + 1) % len(methods)]

    def _toggle_range(self) -> None:
        self.solve_range = not self.solve_range

    # -- the picture ------------------------------------------------------------------------------------------

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click: for the circle, or on a scan."""
        if self.bench.tool == TOOL:
            self.hand.tapped(pixel, line)
            return
        scans = self.scans
        number = None if scans is None else limb_scans.scan_at(scans.places_px, pixel, line)
        if number is not None:
            self._toggle_scan(number)

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag: a circle from its center to its limb, or a box over scans."""
        if self.bench.tool == TOOL:
            self.hand.dragged(pixel0, line0, pixel1, line1)
        elif self.bench.tool == "box_scans":
            self.bench.tool = ""
            places = self._scans().places_px
            self._choose(
                limb_scans.scans_crossing(places, pixel0, line0, pixel1, line1), "box in the picture"
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

    def _look_scan(self, event: Event) -> None:
        self.focus_scan = int(event["arg"])

    def _toggle_scan(self, number: int) -> None:
        self.focus_scan = number
        used = set(limb_scans.used_scans(self._scans().status))
        self._choose(sorted(used ^ {number}), "by click")

    def _typed_scans(self, event: Event) -> None:
        typed = str(event["value"])
        self._choose(limb_scans.parsed_scans(typed, len(self._scans().status)), "typed")

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
