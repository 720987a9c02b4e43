"""What every tab of the workbench has: its page and actions, and the runner that all tabs share.

The runner holds the session at hand, the picture, the status line and the tool in use, and runs steps: a quick one at
once, a longer one in a thread, with progress and a way to cancel that records nothing. A decision on stars is followed by
a repointing where a pointing stands; undo takes both back.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession, JournalEntry
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.image_queue import ImageQueue
from opnav_workbench.workbench.markup import button
from opnav_workbench.workbench.status_line import Status
from opnav_workbench.workbench.viewer import Viewer

__all__ = ["ARROW_STEPS", "Handler", "PageEvent", "StepRunner", "Tab"]


# ---- The bench that the desks (tabs) share: the session at hand, the picture, the status line, and how steps ...

AT_ONCE_S = 0.15  # a step that takes less is simply done; a longer one shows progress and can be cancelled
TICK_S = 1.0
# Reason of a repointing that follows a decision on stars by itself; undo takes both back.
FOLLOWS_DECISION = "follows the stars"


class StepCancelledError(SessionError):
    """The analyst stopped a step before its outcome was recorded."""


@dataclass(slots=True)
class RunningStep:
    """Work under way in a thread of its own."""

    label: str
    said: str | Callable[[], str] = ""
    started_s: float = field(default_factory=time.monotonic)
    progress: float | None = None  # 0..1, None where a step cannot tell
    finished: threading.Event = field(default_factory=threading.Event)
    handover: threading.Lock = field(default_factory=threading.Lock)
    background: bool = False  # nobody waits for it any more: its own thread reports
    cancelled: bool = False
    error: BaseException | None = None


class StepRunner:
    """What the tabs work with.

    Parameters
    ----------
    queue : ImageQueue
    viewer : Viewer
    status : Status
    """

    def __init__(self, queue: ImageQueue, viewer: Viewer, status: Status) -> None:
        self.queue = queue
        self.viewer = viewer
        self.status = status
        self.tool = ""  # what a click in the picture means; empty: look
        self.menu = ""  # the menu that is open
        self.examine_each = False  # the paper's "forces the user to manually examine each extracted area"
        self.model = "euler"
        self.lock = threading.RLock()
        self.job: RunningStep | None = None
        self.changed: Callable[[], None] = lambda: None  # repaints; set by the workbench
        self.repainting = 0  # everything is painted when this is 0 again: the status line waits for it
        self._mine = threading.local()  # the job that the present thread works for

    @property
    def session(self) -> ImageSession:
        """The session of the image at hand."""
        return self.queue.session

    # -- running -----------------------------------------------------------------------------------------------

    def run(self, label: str, work: Callable[[], object], done: str | Callable[[], str] = "") -> None:
        """Run a step: at once if it is quick, else on with progress while the page stays alive.

        What goes wrong appears in the status line; nothing is raised.
        """
        if self.job is not None:
            self.status.say(f"still {self.job.label}; Esc cancels it.", "busy")
            return
        job = self.job = RunningStep(label, done)
        threading.Thread(target=self._work, args=(job, work), daemon=True).start()
        job.finished.wait(AT_ONCE_S)
        with job.handover:
            job.background = not job.finished.is_set()
        if job.background:
            self.status.say(f"{label} ...", "busy")
            threading.Thread(target=self._tick, args=(job,), daemon=True).start()
        else:
            self._conclude(job)

    def _work(self, job: RunningStep, work: Callable[[], object]) -> None:
        self._mine.job = job
        session = self.queue.opened
        try:
            if session is not None:
                session.checkpoint = self.checkpoint
            work()
        except Exception as error:  # shown in the status line, whatever it is
            job.error = error
        with job.handover:
            job.finished.set()
        if job.background:
            with self.lock, self.painting():
                self._conclude(job)

    def _conclude(self, job: RunningStep) -> None:
        if self.job is not job:
            return  # cancelled meanwhile
        self.job = None
        if job.error is not None:
            self.status.fail(job.error)
            return
        with self.status.reporting():
            message = job.said() if callable(job.said) else job.said
            self.status.say(message or f"{job.label}: done.", "done")

    def _tick(self, job: RunningStep) -> None:
        while not job.finished.wait(TICK_S) and self.job is job:
            self.changed()

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until nothing runs: for scripts and tests, which have no page to keep alive."""
        deadline = time.monotonic() + timeout_s
        while self.job is not None and time.monotonic() < deadline:
            time.sleep(0.005)
        with self.lock:
            return  # what was concluded is told, too

    @contextmanager
    def painting(self) -> Iterator[None]:
        """Paint everything once when the block is through; what the status line tells is then shown already."""
        self.repainting += 1
        try:
            yield
        finally:
            self.repainting -= 1
            if not self.repainting:
                self.changed()

    def checkpoint(self) -> None:
        """Stop a cancelled step before anything of it is recorded."""
        job: RunningStep | None = getattr(self._mine, "job", None)
        if job is not None and job.cancelled:
            raise StepCancelledError(f"{job.label} was cancelled; nothing was changed.")

    def cancel(self) -> bool:
        """Cancel what is running; False where nothing is.  Its thread ends by itself and records nothing."""
        with self.lock:
            job = self.job
            if job is None:
                return False
            job.cancelled = True
            self.job = None
            self.status.say(f"{job.label} cancelled; nothing was changed.", "info")
        return True

    # -- undo --------------------------------------------------------------------------------------------------

    def undo(self) -> JournalEntry:
        """Take back the last step and return it; a repointing that followed a star decision goes with it."""
        taken = self.session.undo()
        if taken.reason == FOLLOWS_DECISION:
            taken = self.session.undo()
        self.status.say(f"undone: {_entry_words(taken)}", "done")
        return taken

    def redo(self) -> None:
        """Do again what was undone, with the repointing that followed it."""
        entry = self.session.redo()
        undone = self.session.undone
        if undone and undone[0].reason == FOLLOWS_DECISION:
            self.session.redo()
        self.status.say(f"done again: {_entry_words(entry)}", "done")

    # -- stars and pointing, used by two tabs -----------------------------------------------------------------

    def decide(self, decision: Callable[[], object], done: str | Callable[[], str]) -> None:
        """Take a decision on stars; where a pointing stands, solve it again with what is then in use."""

        def work() -> None:
            session = self.session
            solved = session.state.pointing is not None
            decision()
            if solved:
                session.repoint(self.model, reason=FOLLOWS_DECISION)

        self.run("deciding", work, done)

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
        return (
            f"pointing: {pointing.n_stars} stars, moved {pointing.delta_pixel:+.2f} px, {pointing.delta_line:+.2f} lines, "
            f"rms {pointing.rms_px:.3f} px."
        )


def _entry_words(entry: JournalEntry) -> str:
    return entry.step.replace("_", " ") + (f" ({entry.outcome})" if entry.outcome else "")


# ---- What every tab of the workbench offers: its page, its actions, and what it draws over the picture.

PageEvent = Mapping[str, Any]  # what the page reports: act, arg, value, picks, shift
Handler = Callable[[PageEvent], None]
# Steps (pixel, line) of the arrow keys, as the actions name them.
ARROW_STEPS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}


class Tab:
    """A tab.  Each public attribute is for the workbench that holds it.

    Parameters
    ----------
    bench : Bench
    registry : ActionRegistry
    """

    name = ""

    def __init__(self, bench: StepRunner, registry: ActionRegistry) -> None:
        self.bench = bench
        self.registry = registry

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {}

    def html(self) -> str:
        """Return its page."""
        raise NotImplementedError

    def entered(self) -> None:
        """Take note that the tab, or another image, is shown now."""

    def draw(self) -> None:
        """Draw over the picture what belongs to this tab."""

    def tapped(self, pixel: float, line: float) -> None:
        """Take a click in the picture."""

    def dragged(self, pixel0: float, line0: float, pixel1: float, line1: float) -> None:
        """Take a drag in the picture."""

    def abandon(self) -> bool:
        """Drop a shape that is half drawn; False where there is none."""
        return False

    def button(self, name: str, **options: Any) -> str:
        """Return the button of an action."""
        return button(self.registry[name], **options)
