"""What every tab of the workbench has: its page and actions, and the runner that all tabs share.

The runner holds the session at hand, the picture, the status line and the tool in use, and runs steps: a quick one at
once, a longer one in a thread, with progress and a way to cancel that records nothing; what the analyst asks for meanwhile
waits in line. A decision on stars is followed by a repointing where a pointing stands, a center by its observables; undo
takes both back.
"""

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession, JournalEntry
from opnav_workbench.templating import words
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.workbench.status_line import Status
from opnav_workbench.workbench.viewer import Viewer

__all__ = [
    "ARROW_STEPS",
    "FOLLOWS_CENTER",
    "Handler",
    "PageEvent",
    "StarSearch",
    "StepRunner",
    "Tab",
    "entry_words",
    "giving_way",
    "next_of",
    "typed_number",
]


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
    template
        One of `TEMPLATES`.
    template_star
        Catalog id of the star that is the template.
    radius_px
        None: as the settings say.
    """

    template: str = TEMPLATES[0]
    template_star: str | None = None
    radius_px: float | None = None

    @property
    def method(self) -> str:
        """Method of the first search."""
        return "cross_correlation" if self.template == "Gaussian" else "matched_filter"

    def next_template(self, star: str) -> str:
        """Take the next template; return what to say.  `star` is the one under decision.

        Examples
        --------
        >>> search = StarSearch()
        >>> search.next_template("HIP 1"), search.next_template("HIP 1"), search.method
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
        radius = typed_number(typed)
        if radius is None:
            raise SessionError(f"the search radius is a number of pixels, not {typed!r}.")
        return self.set_radius(radius)

    def refit_options(self, present_px: float) -> dict[str, Any]:
        """Return the arguments of `ImageSession.refit_stars`."""
        return {"initial": self.method, "search_radius_px": present_px, "template": self.template_star}


def typed_number(typed: str) -> float | None:
    """Return the finite number that a person typed; None where it is none.

    Examples
    --------
    >>> typed_number(" 3.5"), typed_number("inf"), typed_number("wide")
    (3.5, None, None)
    """
    try:
        number = float(typed)
    except ValueError:
        return None
    return number if np.isfinite(number) else None


# ---- Threads that work, and the analyst's keys.

# A thread that works gives way to the others so often; Python's own 5 ms add up to a tenth of a second for a key, which
# waits for its turn at each message, lock and file.
GIVE_WAY_S = 0.0005


class GivingWay:
    """Lets the analyst's keys come first as long as any thread works: ``with giving_way: ...``."""

    def __init__(self) -> None:
        self._lock, self._working, self._usual_s = threading.Lock(), 0, 0.0

    def __enter__(self) -> None:
        with self._lock:
            if not self._working:
                self._usual_s = sys.getswitchinterval()
                sys.setswitchinterval(min(self._usual_s, GIVE_WAY_S))
            self._working += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._working -= 1
            if not self._working:
                sys.setswitchinterval(self._usual_s)


giving_way = GivingWay()  # one for all, as the interpreter has one interval


# ---- The runner: the session at hand, the picture, the status line and the tool in use; and how steps are run.

AT_ONCE_S = 0.15  # a step that takes less is simply done; a longer one shows progress and can be cancelled
AFTER_PAINT_S = (
    0.05  # until what follows by itself begins: the page draws first, which wants the processor, too
)
TICK_S = 1.0
# Reasons of steps that follow another by themselves: a repointing after a decision on stars, observables after a center.
# Undo takes both back, redo takes both again.
FOLLOWS_DECISION, FOLLOWS_CENTER = "follows the stars", "follows the center"
FOLLOWING = (FOLLOWS_DECISION, FOLLOWS_CENTER)
DECISIONS_ON_STARS = ("accept_stars", "reject_stars", "place_star", "refit_stars")


class StepCancelledError(SessionError):
    """The analyst stopped a step before its outcome was recorded."""


@dataclass(slots=True)
class RunningStep:
    """Work under way in a thread of its own; one that is `leavable` goes on for itself when the analyst goes elsewhere."""

    label: str
    message: str | Callable[[], str] = ""
    started_s: float = field(default_factory=time.monotonic)
    progress: float | None = None  # 0..1, None where a step cannot tell
    finished: threading.Event = field(default_factory=threading.Event)
    concluding: threading.Lock = field(default_factory=threading.Lock)
    due: bool = False  # it is to begin after the paint
    background: bool = False  # nobody waits for it any more: its own thread reports
    leavable: bool = False
    gives_way: bool = False  # a decision takes its place, and begins it anew
    then: Callable[[BaseException | None], None] | None = None  # says what became of it
    follow: "RunningStep | None" = None  # begins by itself once this one went well and is painted
    work: Callable[[], object] = lambda: None
    cancelled: bool = False
    error: BaseException | None = None


class StepRunner:
    """What the tabs work with.

    Attributes
    ----------
    tool : str
        What a click or a drag in the picture means, one of the tools in `actions`; empty: nothing.
    menu : str
        The menu that is open.
    examine_each : bool
        The paper's "forces the user to manually examine each extracted area".
    search : StarSearch
    model : str
        Of the pointing.
    running : RunningStep or None
    line : deque of callable
        What the analyst asked for while a step was running, in order.
    repaint : callable
        Set by the workbench.
    repainting : int
        Everything is painted when this is 0 again: the status line waits for it.
    """

    def __init__(self, queue: ImageQueue, viewer: Viewer, status: Status) -> None:
        self.queue = queue
        self.viewer = viewer
        self.status = status
        self.tool = self.menu = ""
        self.examine_each = False
        self.search = StarSearch()
        self.model = "euler"
        self.lock = viewer.lock
        self.running: RunningStep | None = None
        self.line: deque[Callable[[], None]] = deque()
        self.repaint: Callable[[], None] = lambda: None
        self.repainting = 0
        self._thread = threading.local()  # the step that the present thread works for

    @property
    def session(self) -> ImageSession:
        """The session of the image at hand."""
        return self.queue.session

    # -- running -----------------------------------------------------------------------------------------------

    def run(
        self,
        label: str,
        work: Callable[[], object],
        done: str | Callable[[], str] = "",
        *,
        then: Callable[[BaseException | None], None] | None = None,
        leavable: bool = False,
        quick: bool = False,
        follow: RunningStep | None = None,
    ) -> None:
        """Run a step: at once if it is quick, else on with progress while the page stays alive.

        What goes wrong appears in the status line; nothing is raised.

        Parameters
        ----------
        done
            What to say when it went well; a function is called then.
        then
            Called at the end whether it went well or not, and says itself what became of it.
        leavable
            It goes on for itself when the analyst goes elsewhere: the opening of an image.
        quick
            It takes no time, as putting down a verdict does: no thread is begun for it.
        follow
            Begins once this step went well and its outcome is painted.
        """
        if self.running is not None and quick and self.running.gives_way:
            self.running.cancelled = True  # of a state that is none any more: nothing of it is recorded
        elif self.running is not None:
            self.status.say(f"still {self.running.label}; Esc cancels it.", "busy")
            return
        step = self.running = RunningStep(label, done, then=then, leavable=leavable, follow=follow, work=work)
        if quick:
            self._work(step)
        else:
            threading.Thread(target=self._work, args=(step,), daemon=True).start()
        step.finished.wait(AT_ONCE_S)
        with step.concluding:
            step.background = not step.finished.is_set()
        if step.background:
            self.status.say(f"{label} ...", "busy")
            threading.Thread(target=self._tick, args=(step,), daemon=True).start()
        else:
            self._conclude(step)

    def _begin_follower(self) -> None:
        step = self.running
        if step is None or not step.due:
            return
        step.due, step.background, step.started_s = False, True, time.monotonic()
        threading.Thread(target=self._follow, args=(step,), daemon=True).start()

    def _follow(self, step: RunningStep) -> None:
        time.sleep(AFTER_PAINT_S)
        if not step.cancelled:
            threading.Thread(target=self._tick, args=(step,), daemon=True).start()
            self._work(step)

    def _work(self, step: RunningStep) -> None:
        self._thread.step = step
        session = self.queue.opened
        try:
            if session is not None:
                session.checkpoint = self.checkpoint
            with giving_way:
                step.work()
        except Exception as error:  # shown in the status line, whatever it is
            step.error = error
        finally:
            self._thread.step = None
        with step.concluding:
            step.finished.set()
        if step.background and not step.cancelled:
            with self.lock, self.painting():
                self._conclude(step)
                self._serve_line()

    def _conclude(self, step: RunningStep) -> None:
        if self.running is not step:
            return  # cancelled meanwhile
        self.running = None
        if step.then is not None:
            with self.status.reporting():
                step.then(step.error)
        elif step.error is not None:
            dropped = len(self.line)
            self.line.clear()
            self.status.fail(step.error)
            if dropped:
                self.status.say(f"{self.status.message} What waited ({dropped}) was dropped.", "error")
        else:
            with self.status.reporting():
                message = step.message() if callable(step.message) else step.message
                self.status.say(message or f"{step.label}: done.", "done")
            if step.follow is not None:
                self.running = step.follow
                self.running.due = True  # begins after the paint
                if not self.repainting:
                    self._begin_follower()

    def wait_in_line(self, task: Callable[[], None]) -> None:
        """Have `task` carried out when the running step, and what waits already, is through."""
        self.line.append(task)
        if self.running is not None:
            self.status.say(f"{self.running.label} ...", "busy")

    def _serve_line(self) -> None:
        while self.line and self.running is None:
            with self.status.reporting():
                self.line.popleft()()

    def leave(self) -> bool:
        """Let a step that may be left go on for itself; False where another one is running."""
        if self.running is not None and not self.running.leavable:
            return False
        self.running = None
        return True

    def _tick(self, step: RunningStep) -> None:
        while not step.finished.wait(TICK_S) and self.running is step:
            self.repaint()

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until nothing runs: for scripts and tests, which have no page to keep alive."""
        deadline = time.monotonic() + timeout_s
        while (self.running is not None or self.line) and time.monotonic() < deadline:
            time.sleep(0.005)
        with self.lock:
            return  # what was concluded is told, too

    @contextmanager
    def painting(self) -> Iterator[None]:
        """Paint everything once when the block is through; what the status line tells is then shown already."""
        self.repainting += 1
        try:
            with self.viewer.batch():
                try:
                    yield
                finally:
                    self.repainting -= 1
                    if not self.repainting:
                        self.repaint()
        finally:
            if not self.repainting:
                self._begin_follower()

    @contextmanager
    def handling(self) -> Iterator[None]:
        """Handle what the page reports: one event at a time; then paint, and tell what went wrong."""
        with self.lock, self.painting(), self.status.reporting():
            yield

    def toggle_tool(self, tool: str, prompt: str) -> None:
        """Take a tool and say what to do with it, or put it away."""
        self.tool = "" if self.tool == tool else tool
        if self.tool:
            self.status.say(prompt)

    def checkpoint(self) -> None:
        """Stop a cancelled step before anything of it is recorded."""
        step: RunningStep | None = getattr(self._thread, "step", None)
        if step is not None and step.cancelled:
            raise StepCancelledError(f"{step.label} was cancelled; nothing was changed.")

    def cancel(self) -> bool:
        """Cancel what is running; False where nothing is.  Its thread ends by itself and records nothing."""
        with self.lock:
            step = self.running
            if step is None:
                return False
            step.cancelled = True
            self.running = None
            self.line.clear()
            self.status.say(f"{step.label} cancelled; nothing was changed.", "info")
        return True

    # -- undo --------------------------------------------------------------------------------------------------

    def undo(self) -> JournalEntry:
        """Take back the last step and return it; what followed it by itself goes with it."""
        taken = self.session.undo()
        while taken.reason in FOLLOWING:
            taken = self.session.undo()
        standing, solved = self.session.standing, self.session.state.pointing is not None
        left = solved and standing and standing[-1].step in DECISIONS_ON_STARS
        hint = "; the pointing is of before the last decision: P solves it again" if left else ""
        self.status.say(f"undone: {entry_words(taken)}{hint}", "done")
        return taken

    def redo(self) -> None:
        """Do again what was undone, with what followed it."""
        entry = self.session.redo()
        while (undone := self.session.undone) and undone[0].reason in FOLLOWING:
            self.session.redo()
        self.status.say(f"done again: {entry_words(entry)}", "done")

    # -- stars and pointing, used by two tabs -----------------------------------------------------------------

    def find_stars(self, then: Callable[[], None] = lambda: None) -> None:
        """Predict if need be, then find all stars as `search` says."""

        def work() -> None:
            session = self.session
            if session.state.a_priori is None:
                session.predict()
            session.find_stars(self.search.method, search_radius_px=self.search.radius_px)
            then()

        self.run("finding stars", work, self.found_line)

    def found_line(self) -> str:
        """One line on the stars found last."""
        state = self.session.state
        used, on_detector = int(state.mask("used").sum()), int((~state.mask("off_detector")).sum())
        return "; ".join([f"{used} of {on_detector} stars found", *state.notes.get("stars", ())])

    def decide(
        self, decision: Callable[[], object], done: str | Callable[[], str], *, quick: bool = False
    ) -> None:
        """Take a decision on stars, shown at once; where a pointing stands, solve it again with what is then in use."""
        session, told = self.session, ""

        def say() -> str:
            nonlocal told
            told = done() if callable(done) else done
            return told

        def followed() -> str:  # not over what the analyst has asked for meanwhile
            message = self.status.message
            return f"{told} {self.pointing_line()}" if message == told else message

        follow = None
        if session.state.pointing is not None:
            follow = RunningStep(
                "solving the pointing",
                followed,
                gives_way=True,
                work=lambda: session.repoint(self.model, reason=FOLLOWS_DECISION, gives_way=True),
            )
        self.run("deciding", decision, say, quick=quick, follow=follow)

    def undecided(self) -> list[str]:
        """Return the ids of the stars on the detector that nobody has decided on."""
        state = self.session.state
        if state.a_priori is None:
            return []
        rows = zip(state.a_priori.id.tolist(), state.status, strict=True)
        return [
            star for star, status in rows if status.status != "off_detector" and star not in state.decisions
        ]

    def examined(self) -> None:
        """Hold the gate of `examine_each`.

        Raises
        ------
        SessionError
            Stars are undecided, and each must be examined.
        """
        missing = self.undecided() if self.examine_each else []
        if missing:
            raise SessionError(
                f"{len(missing)} stars are undecided, and each must be examined; U goes to the next."
            )

    def repoint(self) -> None:
        """Solve the attitude with the chosen model."""

        def work() -> None:
            self.examined()
            self.session.repoint(self.model)

        self.run("solving the pointing", work, self.pointing_line)

    def pointing_line(self) -> str:
        """One line on the pointing as it stands."""
        pointing = self.session.state.pointing
        if pointing is None:
            return "no pointing is solved: the a priori one stands."
        return f"pointing: {pointing.rests_on}; moved {pointing.delta_pixel:+.2f} px, {pointing.delta_line:+.2f} lines."


def next_of(ids: Sequence[str], here: str, wanted: Collection[str]) -> str | None:
    """Return the next wanted one after `here`, from the end on to the beginning; None without one."""
    start = ids.index(here) + 1
    return next((one for one in (*ids[start:], *ids[:start]) if one in wanted), None)


def entry_words(entry: JournalEntry) -> str:
    """Return a step of the journal as a person reads it."""
    return words(entry.step) + (f" ({entry.outcome})" if entry.outcome else "")


# ---- What every tab offers: its page, its actions, and what it draws over the picture.

PageEvent = Mapping[str, Any]  # what the page reports: act, arg, value, picks, shift
Handler = Callable[[PageEvent], None]
# Steps (pixel, line) of the arrow keys, as the actions name them.
ARROW_STEPS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}


class Tab:
    """A tab.  Each public attribute is for the workbench that holds it."""

    name = ""
    clicks_look = False  # whether a click without a tool only looks around

    def __init__(self, runner: StepRunner, registry: ActionRegistry) -> None:
        self.runner = runner
        self.registry = registry

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {}

    def html(self) -> str:
        """Return its page."""
        raise NotImplementedError

    def on_enter(self) -> None:
        """Take note that the tab, or another image, is shown now."""

    def draw(self) -> None:
        """Draw over the picture what belongs to this tab."""

    def look(self) -> None:
        """Bring into view what this tab is about."""

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click in the picture."""

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag in the picture."""

    def drop_unfinished(self) -> bool:
        """Drop a shape that is half drawn; False where there is none."""
        return False
