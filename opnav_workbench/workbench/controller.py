"""The workbench without a browser: what the page reports goes in, the regions' HTML comes out.

Events are handled one at a time, under the runner's lock; whatever goes wrong appears in the status line. Tests drive
this class with a fake picture.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from opnav_workbench.errors import OpNavError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import (
    CIRCLE,
    NOTE_MENU,
    NUDGE,
    PLACES,
    REASON_MENU,
    TABS,
    WORKBENCH_ACTIONS,
    Action,
    ActionRegistry,
)
from opnav_workbench.workbench.bodies_tab import BodiesTab
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.workbench.markup import render
from opnav_workbench.workbench.observables_tab import ObservablesTab
from opnav_workbench.workbench.pointing_tab import PointingTab
from opnav_workbench.workbench.stars_tab import StarsTab
from opnav_workbench.workbench.status_line import Status
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab
from opnav_workbench.workbench.viewer import Layer, Viewer

__all__ = ["REGIONS", "WorkbenchController"]

TOOL_LAYERS = ("two stars", "limb scans")  # that the tabs draw
REGIONS = ("header", "queue", "panel", "status")


class WorkbenchController:
    """Takes events, calls session methods, renders.

    Parameters
    ----------
    out
        Where sessions without a folder of their own are exported to.
    status
        The status line, where it is shared with the picture.
    """

    def __init__(
        self, queue: ImageQueue, viewer: Viewer, out: Path | None = None, status: Status | None = None
    ) -> None:
        self.queue, self.viewer = queue, viewer
        self.registry = ActionRegistry([*WORKBENCH_ACTIONS, *viewer.actions])
        self.runner = StepRunner(queue, viewer, status or Status())
        self.stars = StarsTab(self.runner, self.registry)
        self.bodies = BodiesTab(self.runner, self.registry)
        self.tabs: dict[str, Tab] = {
            "stars": self.stars,
            "pointing": PointingTab(self.runner, self.registry),
            "bodies": self.bodies,
            "observables": ObservablesTab(self.runner, self.registry, out),
        }
        self.tab_name = "stars"
        self.keys_shown = False
        self._pictured: object = None  # the state that lies over the picture
        self.on_render: Callable[[Mapping[str, str]], None] = lambda _: None  # gets the regions' HTML
        self._handlers = self._own_handlers()
        for tab in self.tabs.values():
            self._handlers |= tab.handlers()
        self.runner.repaint = self.refresh
        self.runner.status.changed = self._status_changed
        queue.opening = self._opened
        viewer.listen(self._tapped, self._dragged)
        with self.runner.status.reporting():
            self._show_image()

    @property
    def current_tab(self) -> Tab:
        """The tab at hand."""
        return self.tabs[self.tab_name]

    # -- events ------------------------------------------------------------------------------------------------

    def handle(self, event: PageEvent) -> None:
        """Do what the page reports; whatever goes wrong appears in the status line."""
        with self.runner.handling():
            act = str(event["act"])
            if act == "key":
                action = self.meaning(str(event["arg"]))
                act = "" if action is None else action.name
            self.do(act, event)

    def do(self, name: str, event: PageEvent | None = None) -> None:
        """Carry out an action by its name."""
        if name in self._handlers:
            self._handlers[name](event or {})
        elif any(action.name == name for action in self.viewer.actions):
            said = self.viewer.do(name)
            if said:
                self.runner.status.say(said)

    def meaning(self, key: str) -> Action | None:
        """Return what a key means now: first for the open menu, then for the tool, then for the tab."""
        return self.registry.for_key(key, *self._places())

    def _places(self) -> list[str]:
        places = [REASON_MENU] if self.runner.menu == REASON_MENU else []
        if self.runner.tool == NUDGE:
            places.append(NUDGE)
        if self.tab_name == "bodies" and self.bodies.circle is not None and self.bodies.scans is None:
            places.append(CIRCLE)
        return [*places, self.tab_name, "view"]

    def _tapped(self, pixel: float, line: float) -> None:
        with self.runner.handling():
            self.current_tab.tapped(pixel, line)

    def _dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        with self.runner.handling():
            self.current_tab.dragged(pixel0, line0, pixel1, line1)

    # -- actions around the tabs ---------------------------------------------------------------------------------

    def _own_handlers(self) -> dict[str, Handler]:
        tabs: dict[str, Handler] = {f"tab_{name}": self._tab_handler(name) for name, _ in TABS}
        return tabs | {
            "undo": lambda _: self._undo(),
            "redo": lambda _: self.runner.redo(),
            "next_image": lambda _: self._go(self.queue.index + 1),
            "previous_image": lambda _: self._go(self.queue.index - 1),
            "go": lambda event: self._go(int(event["arg"])),
            "keys": lambda _: self._toggle_keys(),
            "escape": lambda _: self._escape(),
        }

    def _tab_handler(self, name: str) -> Handler:
        return lambda _: self.show_tab(name)

    def show_tab(self, name: str) -> None:
        """Show a tab; tools of the old one are put away."""
        self._leave_tools()
        self.tab_name = name
        self.current_tab.on_enter()

    def _go(self, index: int) -> None:
        if self.runner.running is not None:
            self.runner.status.say(f"still {self.runner.running.label}; Esc cancels it.", "busy")
            return
        self.queue.go(index)
        self._show_image()

    def _show_image(self) -> None:
        self._leave_tools()
        folder = self.queue.item.folder
        self.runner.status.log_folder = folder
        session = self.queue.session
        self.viewer.show(session)
        self._pictured = session.state
        for tab in self.tabs.values():
            tab.on_enter()
        if session.state.a_priori is None:
            session.predict()
        self.runner.status.say(
            f"{self.queue.item.name}: {len(session.standing)} steps. Press ? for the keys."
        )

    def _leave_tools(self) -> None:
        """Leave tools and menus, and take what the tab had drawn off the picture."""
        self.runner.tool = self.runner.menu = ""
        for layer in TOOL_LAYERS:
            self.viewer.layer(layer, Layer())
        self.viewer.circle(None)
        self.viewer.drag_mode(False)

    def _opened(self, session: ImageSession) -> None:
        session.on_change(lambda _: None if self.runner.running is not None else self.refresh())

    def _undo(self) -> None:
        if self.current_tab.drop_unfinished():
            self.runner.status.say("the shape begun was dropped.")
        else:
            self.stars.revisit(self.runner.undo())

    def _toggle_keys(self) -> None:
        self.keys_shown = not self.keys_shown

    def _escape(self) -> None:
        if self.runner.cancel():
            return
        if self.keys_shown or self.runner.menu or self.runner.tool:
            self.keys_shown = False
            self.current_tab.drop_unfinished()
            self.runner.menu = self.runner.tool = ""

    # -- rendering ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Render all regions and what lies over the picture."""
        with self.runner.lock:
            if self.queue.opened is not None:
                with self.runner.status.reporting():
                    self._refresh_picture(self.queue.opened)
                    self.current_tab.draw()
            self.on_render(self.regions())

    def _refresh_picture(self, session: ImageSession) -> None:
        if self._pictured is not session.state:
            self.viewer.refresh()
            self._pictured = session.state

    def _status_changed(self) -> None:
        if not self.runner.repainting:
            self.on_render({"status": self._status()})

    def regions(self) -> dict[str, str]:
        """Return the HTML of every region."""
        return {
            "header": self._header(),
            "queue": render("queue.html", items=self.queue.items, here=self.queue.index),
            "panel": self._panel(),
            "status": self._status(),
        }

    def _header(self) -> str:
        session, item = self.queue.opened, self.queue.item
        facts = ""
        if session is not None:
            picture = session.context.picture
            facts = f"{session.context.camera.name}, {session.inputs.utc} UTC, {picture.exposure_s:g} s"
        return render(
            "header.html",
            actions=self.registry,
            name=item.name,
            facts=facts,
            folder=item.folder,
            is_first=self.queue.index == 0,
            is_last=self.queue.index == len(self.queue.items) - 1,
            can_undo=session is not None and session.can_undo,
            can_redo=session is not None and session.can_redo,
            keys_shown=self.keys_shown,
        )

    def _panel(self) -> str:
        return render(
            "panel.html",
            tabs=[self.registry[f"tab_{name}"] for name, _ in TABS],
            shown=f"tab_{self.tab_name}",
            noting=self.runner.menu == NOTE_MENU,
            page=self._page(),
        )

    def _page(self) -> str:
        if self.keys_shown:
            return render("keys.html", groups=self.registry.groups(PLACES))
        if self.queue.opened is None:
            return render("message.html", message=self.queue.item.error or "The image is not open.")
        try:
            return self.current_tab.html()
        except OpNavError as error:
            return render("message.html", message=error)

    def _status(self) -> str:
        status, step = self.runner.status, self.runner.running
        return render(
            "status.html",
            kind=status.kind,
            message=status.message,
            progress=None if step is None else step.progress,
            elapsed_s=None if step is None else time.monotonic() - step.started_s,
        )
