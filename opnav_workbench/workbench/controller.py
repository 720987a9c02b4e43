"""The workbench without a browser: what the page reports goes in, the regions' HTML comes out.

Events are handled one at a time, under the runner's lock; whatever goes wrong appears in the status line. Tests drive
this class with a fake picture.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from opnav_workbench.errors import OpNavError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import (
    CIRCLE,
    NUDGE,
    PLACES,
    REASON_MENU,
    TABS,
    WORKBENCH_ACTIONS,
    Action,
    ActionRegistry,
    shown_key,
)
from opnav_workbench.workbench.bodies_tab import BodiesTab
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.workbench.markup import button, text
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
    queue : ImageQueue
    viewer : Viewer
    out : Path, optional
        Where sessions without a folder of their own are exported to.
    status : Status, optional
        The status line, where it is shared with the picture.
    """

    def __init__(
        self, queue: ImageQueue, viewer: Viewer, out: Path | None = None, status: Status | None = None
    ) -> None:
        self.queue, self.viewer = queue, viewer
        self.registry = ActionRegistry([*WORKBENCH_ACTIONS, *viewer.actions])
        self.bench = StepRunner(queue, viewer, status or Status())
        self.stars = StarsTab(self.bench, self.registry)
        self.bodies = BodiesTab(self.bench, self.registry)
        self.desks: dict[str, Tab] = {
            "stars": self.stars,
            "pointing": PointingTab(self.bench, self.registry),
            "bodies": self.bodies,
            "observables": ObservablesTab(self.bench, self.registry, out),
        }
        self.tab = "stars"
        self.keys_shown = False
        self._pictured: object = None  # the state that lies over the picture
        self.painted: Callable[[Mapping[str, str]], None] = lambda _: None  # gets the regions' HTML
        self._handlers = self._own_handlers()
        for desk in self.desks.values():
            self._handlers |= desk.handlers()
        self.bench.changed = self.refresh
        self.bench.status.changed = self._status_changed
        queue.opening = self._opened
        viewer.listen(self._tapped, self._dragged)
        with self.bench.status.reporting():
            self._show_image()

    @property
    def desk(self) -> Tab:
        """The tab at hand."""
        return self.desks[self.tab]

    # -- events ------------------------------------------------------------------------------------------------

    def handle(self, event: PageEvent) -> None:
        """Do what the page reports; whatever goes wrong appears in the status line."""
        with self.bench.lock, self.bench.painting(), self.bench.status.reporting():
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
                self.bench.status.say(said)

    def meaning(self, key: str) -> Action | None:
        """Return what a key means now: first for the open menu, then for the tool, then for the tab."""
        return self.registry.for_key(key, *self._places())

    def _places(self) -> list[str]:
        places = [REASON_MENU] if self.bench.menu == REASON_MENU else []
        if self.bench.tool == "nudge":
            places.append(NUDGE)
        if self.tab == "bodies" and self.bodies.circle is not None and self.bodies.scans is None:
            places.append(CIRCLE)
        return [*places, self.tab, "view"]

    def _tapped(self, pixel: float, line: float) -> None:
        with self.bench.lock, self.bench.painting(), self.bench.status.reporting():
            self.desk.tapped(pixel, line)

    def _dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        with self.bench.lock, self.bench.painting(), self.bench.status.reporting():
            self.desk.dragged(pixel0, line0, pixel1, line1)

    # -- actions of the frame around the tabs ---------------------------------------------------------------------

    def _own_handlers(self) -> dict[str, Handler]:
        tabs: dict[str, Handler] = {f"tab_{name}": self._tab_handler(name) for name, _ in TABS}
        return tabs | {
            "undo": lambda _: self._undo(),
            "redo": lambda _: self.bench.redo(),
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
        self._put_away()
        self.tab = name
        self.desk.entered()

    def _go(self, index: int) -> None:
        if self.bench.job is not None:
            self.bench.status.say(f"still {self.bench.job.label}; Esc cancels it.", "busy")
            return
        self.queue.go(index)
        self._show_image()

    def _show_image(self) -> None:
        self._put_away()
        folder = self.queue.item.folder
        self.bench.status.log_folder = folder
        session = self.queue.session
        self.viewer.show(session)
        self._pictured = session.state
        for desk in self.desks.values():
            desk.entered()
        if session.state.a_priori is None:
            session.predict()
        self.bench.status.say(f"{self.queue.item.name}: {len(session.standing)} steps. Press ? for the keys.")

    def _put_away(self) -> None:
        """Leave tools and menus, and take what the tab had drawn off the picture."""
        self.bench.tool = self.bench.menu = ""
        for layer in TOOL_LAYERS:
            self.viewer.layer(layer, Layer())
        self.viewer.circle(None)
        self.viewer.drag_mode(False)

    def _opened(self, session: ImageSession) -> None:
        session.on_change(lambda _: None if self.bench.job is not None else self.refresh())

    def _undo(self) -> None:
        if self.desk.abandon():
            self.bench.status.say("the shape begun was dropped.")
        else:
            self.stars.revisit(self.bench.undo())

    def _toggle_keys(self) -> None:
        self.keys_shown = not self.keys_shown

    def _escape(self) -> None:
        if self.bench.cancel():
            return
        if self.keys_shown or self.bench.menu or self.bench.tool:
            self.keys_shown = False
            self.desk.abandon()
            self.bench.menu = self.bench.tool = ""

    # -- rendering ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Render all regions and what lies over the picture."""
        with self.bench.lock:
            if self.queue.opened is not None:
                with self.bench.status.reporting():
                    self._refresh_picture(self.queue.opened)
                    self.desk.draw()
            self.painted(self.regions())

    def _refresh_picture(self, session: ImageSession) -> None:
        if self._pictured is not session.state:
            self.viewer.refresh()
            self._pictured = session.state

    def _status_changed(self) -> None:
        if not self.bench.repainting:
            self.painted({"status": self._status()})

    def regions(self) -> dict[str, str]:
        """Return the HTML of every region."""
        return {
            "header": self._header(),
            "queue": self.queue.html(),
            "panel": self._panel(),
            "status": self._status(),
        }

    def _button(self, name: str, **options: bool) -> str:
        return button(self.registry[name], **options)  # type: ignore[arg-type]

    def _header(self) -> str:
        session, item = self.queue.opened, self.queue.item
        facts = ""
        if session is not None:
            frame = session.context.frame
            facts = f"{session.context.camera.name}, {session.inputs.utc} UTC, {frame.exposure_s:g} s"
        saved = "saved at each step" if item.folder is not None else "not saved by itself"
        last = len(self.queue.items) - 1
        return (
            f'<div class="left">{self._button("previous_image", enabled=self.queue.index > 0)}'
            f"{self._button('next_image', enabled=self.queue.index < last)}"
            f"<b>{text(item.name)}</b><span>{text(facts)}</span></div>"
            f'<div class="right"><span class="saved" title="{text(item.folder or "")}">{saved}</span>'
            f"{self._button('undo', enabled=session is not None and session.can_undo)}"
            f"{self._button('redo', enabled=session is not None and session.can_redo)}"
            f"{self._button('note')}{self._button('export')}{self._button('keys', on=self.keys_shown)}</div>"
        )

    def _panel(self) -> str:
        tabs = "".join(button(self.registry[f"tab_{name}"], on=name == self.tab) for name, _ in TABS)
        with_note = (
            '<div class="tool"><b>Note</b> <input data-act="note_text" size="40" '
            'placeholder="what you saw; Enter keeps it"></div>'
            if self.bench.menu == "note"
            else ""
        )
        page = self._keys_list() if self.keys_shown else self._page()
        return f'<nav class="tabs" role="tablist">{tabs}</nav>{with_note}{page}'

    def _page(self) -> str:
        if self.queue.opened is None:
            return f'<div class="page"><p class="hint">{text(self.queue.item.error or "The image is not open.")}</p></div>'
        try:
            return self.desk.html()
        except OpNavError as error:
            return f'<div class="page"><p class="hint">{text(error)}</p></div>'

    def _keys_list(self) -> str:
        groups = []
        for title, actions in self.registry.groups(PLACES):
            rows = "".join(
                f"<tr><td>{' '.join(f'<kbd>{text(shown_key(k))}</kbd>' for k in a.keys)}</td><td>{text(a.tooltip)}</td></tr>"
                for a in actions
            )
            if rows:
                groups.append(f"<h4>{text(title)}</h4><table>{rows}</table>")
        return f'<div class="page keys">{"".join(groups)}</div>'

    def _status(self) -> str:
        job = self.bench.job
        if job is None:
            return self.bench.status.html()
        return self.bench.status.html(job.progress, job.started_s)
