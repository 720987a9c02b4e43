"""The workbench without a browser: what the page reports goes in, the regions' HTML comes out.

Events are handled one at a time, under the runner's lock; while a step is running, what only looks around is done at once
and the rest waits in line. Images are opened by the runner too, and the neighbors of the one at hand ahead. Whatever goes
wrong appears in the status line. Tests drive this class with a fake picture.
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from weakref import WeakSet

from opnav_workbench.errors import OpNavError
from opnav_workbench.session import ImageSession, SessionState
from opnav_workbench.session.context import typical_noise_dn
from opnav_workbench.workbench.actions import (
    CIRCLE,
    LANDMARK_MENU,
    LOOKING,
    NOTE_MENU,
    NUDGE,
    PLACES,
    REASON_MENU,
    REJECT_REASONS,
    TABS,
    WORKBENCH_ACTIONS,
    Action,
    ActionRegistry,
)
from opnav_workbench.workbench.bodies_tab import BodiesTab
from opnav_workbench.workbench.image_queue import ORDERS, SHOWN, ImageQueue, QueueItem
from opnav_workbench.workbench.landmarks_tab import LandmarksTab
from opnav_workbench.workbench.markup import prepare_templates, render
from opnav_workbench.workbench.observables_tab import ObservablesTab
from opnav_workbench.workbench.overlays import look_alike
from opnav_workbench.workbench.pointing_tab import PointingTab
from opnav_workbench.workbench.stars_tab import StarsTab
from opnav_workbench.workbench.status_line import Status
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab, giving_way
from opnav_workbench.workbench.viewer import Layer, Viewer

__all__ = ["REGIONS", "WorkbenchController"]

TOOL_LAYERS = ("two stars", "limb points", "limb scans", "landmarks")  # that the tabs draw
GOING = ("next_image", "previous_image", "go", "open_again")  # to another image
LISTING = ("list_words", "list_shown", "list_order")  # choose what is listed
# Decisions on stars, which the solution that follows them gives way to.
VERDICTS = frozenset({"accept", "accept_rest", *(f"reason_{n}" for n, _ in enumerate(REJECT_REASONS, 1))})
WITHOUT_IMAGE = frozenset({*GOING, *LISTING, *(f"tab_{name}" for name, _ in TABS), "keys", "escape"})
REGIONS = ("header", "queue", "panel", "status")


class WorkbenchController:
    """Takes events, calls session methods, renders.

    Parameters
    ----------
    out
        Where sessions without a folder of their own are exported to.
    status
        The status line, where it is shared with the picture.
    ahead
        Open the neighbors of the image at hand while nothing else is to be done.
    """

    def __init__(
        self,
        queue: ImageQueue,
        viewer: Viewer,
        out: Path | None = None,
        status: Status | None = None,
        *,
        ahead: bool = False,
    ) -> None:
        self.queue, self.viewer = queue, viewer
        self.ahead = ahead
        self._works_ahead = False  # one thread does
        self._templates_ready = False
        self._prepared: WeakSet[ImageSession] = WeakSet()  # what showing them costs is done
        self.registry = ActionRegistry([*WORKBENCH_ACTIONS, *viewer.actions])
        self.runner = StepRunner(queue, viewer, status or Status())
        self.stars = StarsTab(self.runner, self.registry)
        self.bodies = BodiesTab(self.runner, self.registry)
        self.tabs: dict[str, Tab] = {
            "stars": self.stars,
            "pointing": PointingTab(self.runner, self.registry),
            "bodies": self.bodies,
            "observables": ObservablesTab(self.runner, self.registry, out),
            "landmarks": LandmarksTab(self.runner, self.registry),
        }
        self.tab_name = "stars"
        self.keys_shown = False
        self._view_actions = frozenset(action.name for action in viewer.actions)
        self._shown: ImageSession | None = None  # the session in the picture
        self._pictured: SessionState | None = None  # the state that lies over it
        self._compared: list[tuple[str, ImageSession]] = []  # other images that it can be compared with
        self.on_render: Callable[[Mapping[str, str]], None] = lambda _: None  # gets the regions' HTML
        self._handlers = self._own_handlers()
        for tab in self.tabs.values():
            self._handlers |= tab.handlers()
        self.runner.repaint = self.refresh
        self.runner.status.changed = self._status_changed
        queue.opening = self._opened
        viewer.listen(self._tapped, self._dragged)
        with self.runner.handling():
            self._show_image()

    @property
    def current_tab(self) -> Tab:
        """The tab at hand."""
        return self.tabs[self.tab_name]

    # -- events ------------------------------------------------------------------------------------------------

    def handle(self, event: PageEvent) -> None:
        """Do what the page reports; whatever goes wrong appears in the status line."""
        with self.runner.handling():
            act = self._act(event)
            if self._waits(act):
                self.runner.wait_in_line(lambda: self.do(self._act(event), event))  # what a key means by then
            else:
                self.do(act, event)

    def _act(self, event: PageEvent) -> str:
        """Return what an event means now: the action of its key, or what it says itself."""
        if event["act"] != "key":
            return str(event["act"])
        action = self.meaning(str(event["arg"]))
        return "" if action is None else action.name

    def _waits(self, act: str) -> bool:
        """Whether an action has to wait for the running step, and for what waits already."""
        runner = self.runner
        if runner.running is None or act in ("", "escape") or act in self._view_actions:
            return False
        if runner.running.leavable and act in GOING:
            return False
        if runner.running.gives_way and act in VERDICTS:
            return bool(runner.line)
        return bool(runner.line) or act not in (*LOOKING, *LISTING)

    def do(self, name: str, event: PageEvent | None = None) -> None:
        """Carry out an action by its name."""
        if self.queue.opened is None and name in self._handlers and name not in WITHOUT_IMAGE:
            self.runner.status.say(f"{self.queue.item.name} is not open.")
        elif name in self._handlers:
            self._handlers[name](event or {})
        elif name in self._view_actions:
            said = self.viewer.do(name)
            if said:
                self.runner.status.say(said)

    def meaning(self, key: str) -> Action | None:
        """Return what a key means now: first for the open menu, then for the tool, then for the tab."""
        return self.registry.for_key(key, *self._places())

    def _places(self) -> list[str]:
        places = [self.runner.menu] if self.runner.menu in (REASON_MENU, LANDMARK_MENU) else []
        if self.runner.tool == NUDGE:
            places.append(NUDGE)
        if self.tab_name == "bodies" and self.queue.opened is not None and self.bodies.moves_circle:
            places.append(CIRCLE)
        return [*places, self.tab_name, "view"]

    def _tapped(self, pixel: float, line: float) -> None:
        self._in_turn(lambda: self.current_tab.tapped(pixel, line))

    def _dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        self._in_turn(lambda: self.current_tab.dragged(pixel0, line0, pixel1, line1))

    def _in_turn(self, task: Callable[[], None]) -> None:
        """Take what was done in the picture: now, or when the running step is through."""
        with self.runner.handling():
            if self.queue.opened is None:
                return
            if self.runner.running is not None and (
                self.runner.line or self.runner.tool or not self.current_tab.clicks_look
            ):
                self.runner.wait_in_line(task)
            else:
                task()

    # -- actions around the tabs ---------------------------------------------------------------------------------

    def _own_handlers(self) -> dict[str, Handler]:
        tabs: dict[str, Handler] = {f"tab_{name}": self._tab_handler(name) for name, _ in TABS}
        return tabs | {
            "undo": lambda _: self._undo(),
            "redo": lambda _: self.runner.redo(),
            "next_image": lambda _: self._go(self.queue.step(+1)),
            "previous_image": lambda _: self._go(self.queue.step(-1)),
            "list_words": lambda event: self._list(words=str(event["value"])),
            "list_shown": lambda event: self._list(shown_kind=str(event["value"])),
            "list_order": lambda event: self._list(order=str(event["value"])),
            "go": lambda event: self._go(int(event["arg"])),
            "keys": lambda _: self._toggle_keys(),
            "escape": lambda _: self._escape(),
            "open_again": lambda _: self._open_again(),
        }

    def _tab_handler(self, name: str) -> Handler:
        return lambda _: self.show_tab(name)

    def show_tab(self, name: str) -> None:
        """Show a tab; tools of the old one are put away."""
        self._leave_tools()
        self.tab_name = name
        if self.queue.opened is not None:
            self.current_tab.on_enter()
            self.current_tab.look()

    # -- images: opened by the runner, shown, and their neighbors opened ahead --------------------------------------

    def _go(self, index: int) -> None:
        if not self.runner.leave():
            assert self.runner.running is not None
            self.runner.status.say(f"still {self.runner.running.label}; Esc cancels it.", "busy")
            return
        self.queue.go(index)
        self._show_image()

    def _list(self, **chosen: str) -> None:
        """Choose what is listed, and in which order."""
        for name, value in chosen.items():
            setattr(self.queue, name, value)
        self._open_ahead()

    def _open_again(self) -> None:
        self.queue.item.error = ""
        self._show_image()

    def _show_image(self) -> None:
        """Show the image at hand: at once if it is open, else when it is; why it cannot be opened is shown too."""
        self._leave_tools()
        item = self.queue.item
        self.runner.status.log_folder = item.folder
        if item.error:
            self._show_failure(item)
        elif item.session is not None and item.session.state.a_priori is not None:
            self._show_session(item, item.session)
        else:
            self._blank(f"opening {item.name}")
            self.refresh()  # told at once
            self.runner.run(
                f"opening {item.name}",
                lambda: self._open(item),
                then=lambda error: self._arrived(item, error),
                leavable=True,
            )

    def _open(self, item: QueueItem) -> None:
        """Open an image, predict its stars where nothing was done yet, and do what showing it costs."""
        session = self.queue.open(item)
        self._prepare(session)
        if session.state.a_priori is None:
            session.predict()

    def _prepare(self, session: ImageSession) -> None:
        """Do what showing an image costs: its picture, and the noise that panels tell, a median of all pixels."""
        self.viewer.prepare(session)
        typical_noise_dn(session.context)
        self._prepared.add(session)

    def _arrived(self, item: QueueItem, error: BaseException | None) -> None:
        """Show an image whose opening has ended, if the analyst still waits for it."""
        if item is not self.queue.item:
            return
        if item.session is not None:
            self._show_session(item, item.session)
            if error is not None:
                self.runner.status.fail(error)
        else:
            if error is not None:
                self.runner.status.fail(error)  # the log has the traceback of an unforeseen one
            self._show_failure(item)

    def _show_session(self, item: QueueItem, session: ImageSession) -> None:
        item.seen_s = time.monotonic()
        self.queue.close_far()
        self.viewer.show(session)
        self._compared = []
        self._shown, self._pictured = session, session.state
        for tab in self.tabs.values():
            tab.on_enter()
        self.runner.status.say(f"{item.name}: {len(session.standing)} steps. Press ? for the keys.")
        self.current_tab.look()
        self._open_ahead()

    def _show_failure(self, item: QueueItem) -> None:
        self._blank(f"{item.name} cannot be opened")
        self.runner.status.say(f"{item.name} cannot be opened.", "error")
        self._open_ahead()

    def _blank(self, message: str) -> None:
        self._shown, self._pictured = None, None
        self.viewer.blank(message)

    def _open_ahead(self) -> None:
        """Send the neighbors of the image at hand ahead; those that are not ready a thread opens, one after the other."""
        with self.runner.lock:
            near = self._neighbors()
            self.viewer.send_ahead(near)
            done = self.queue.next_to_open() is None and all(one in self._prepared for one in near)
            if self.ahead and not self._works_ahead and not (done and self._templates_ready):
                self._works_ahead = True
                threading.Thread(target=self._work_ahead, daemon=True).start()

    def _work_ahead(self) -> None:
        near: list[ImageSession] = []
        with giving_way:
            while not self._is_ahead_of(near):
                self._open_next()
                near = self._neighbors()
                for session in near:
                    with suppress(Exception):  # told when its turn comes
                        self._prepare(session)
            prepare_templates()
            self._templates_ready = True

    def _is_ahead_of(self, prepared: list[ImageSession]) -> bool:
        """Whether nothing is left to be done ahead; then what is prepared goes to the pages."""
        with self.runner.lock:
            if self.queue.next_to_open() is not None or self._neighbors() != prepared:
                return False
            self.viewer.send_ahead(prepared)
            self._works_ahead = False
            return True

    def _open_next(self) -> None:
        """Open one neighbor that is not."""
        if (item := self.queue.next_to_open()) is None:
            return
        with suppress(Exception):  # the list shows that it failed; the page says why when its turn comes
            self._open(item)
        with self.runner.lock:
            self.queue.close_far()
        self.refresh()

    def _neighbors(self) -> list[ImageSession]:
        """The neighbors' sessions that are open."""
        sessions = (self.queue.items[number].session for number in self.queue.neighbors())
        return [session for session in sessions if session is not None]

    def _leave_tools(self) -> None:
        """Leave tools and menus, and take what the tab had drawn off the picture."""
        self.runner.tool = self.runner.menu = ""
        for layer in TOOL_LAYERS:
            self.viewer.layer(layer, Layer())
        self.viewer.circle(None)
        self.viewer.drag_mode(False)

    def _opened(self, session: ImageSession) -> None:
        def changed(_: ImageSession) -> None:
            # What is handled now is painted once, at its end: an undo may take back several steps.
            waits = self.runner.running is not None or self.runner.repainting
            if not waits and session is self.queue.opened:
                self.refresh()

        session.on_change(changed)

    def _undo(self) -> None:
        if self.current_tab.drop_unfinished():
            self.runner.status.say("the shape begun was dropped.")
        else:
            self.stars.revisit(self.runner.undo())

    def _toggle_keys(self) -> None:
        self.keys_shown = not self.keys_shown

    def _escape(self) -> None:
        if self.runner.cancel():
            if self.queue.opened is None:
                self._blank(f"{self.queue.item.name} is not open")
            return
        if self.keys_shown or self.runner.menu or self.runner.tool:
            self.keys_shown = False
            self.current_tab.drop_unfinished()
            self.runner.menu = self.runner.tool = ""
        else:
            self.viewer.do("put_away")  # what the picture's own tools show

    # -- rendering ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Render all regions and what lies over the picture."""
        with self.runner.lock:
            if self._shown is not None and self._shown is self.queue.opened:
                with self.runner.status.reporting():
                    self._refresh_picture(self._shown)
                    self.current_tab.draw()
            self.on_render(self.regions())

    def _refresh_picture(self, session: ImageSession) -> None:
        if not look_alike(self._pictured, session.state):
            self.viewer.refresh()
        self._pictured = session.state
        others = [
            (item.name, item.session)
            for item in self.queue.items
            if item.session not in (None, session) and item.session.state.a_priori is not None
        ]
        if others != self._compared:
            self._compared = others
            self.viewer.compare_with(others)

    def _status_changed(self) -> None:
        if not self.runner.repainting:
            self.on_render({"status": self._status()})

    def regions(self) -> dict[str, str]:
        """Return the HTML of every region."""
        return {
            "header": self._header(),
            "queue": self._queue(),
            "panel": self._panel(),
            "status": self._status(),
        }

    def _queue(self) -> str:
        queue, listed = self.queue, self.queue.listed()
        items = [(number, queue.items[number]) for number in listed]
        return render("queue.html", items=items, queue=queue, kinds=SHOWN, orders=ORDERS)

    def _header(self) -> str:
        session, item = self.queue.opened, self.queue.item
        facts = ""
        if session is not None:
            picture = session.context.picture
            utc = session.inputs.utc.removesuffix(".000")  # the rest has room in a narrow window then
            facts = f"{session.context.camera.name}, {picture.exposure_s:g} s, {utc} UTC"
        return render(
            "header.html",
            actions=self.registry,
            name=item.name,
            facts=facts,
            folder=item.folder,
            is_open=session is not None,
            **self._ends(),
            can_undo=session is not None and session.can_undo,
            can_redo=session is not None and session.can_redo,
            keys_shown=self.keys_shown,
        )

    def _ends(self) -> dict[str, bool]:
        """Whether the image at hand is the first, the last of those listed."""
        listed = self.queue.listed()
        return {"is_first": self.queue.index == listed[0], "is_last": self.queue.index == listed[-1]}

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
            item, running = self.queue.item, self.runner.running
            busy = running is not None
            return render("not_open.html", item=item, busy=busy, actions=self.registry, **self._ends())
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
            waiting=len(self.runner.line),
        )
