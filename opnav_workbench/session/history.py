"""The history of a session: its states and its journal, and how steps are taken, taken back, repeated and replayed.

`STEPS` names every step, the pure function that carries it out, and what the journal says of it.  A state follows from
the steps before it, so that only the journal has to be kept: states of a session read from a file, and old ones that were
dropped to save memory, are made again when they are asked for.

``journal.jsonl`` holds the steps since session.json was written, one line each, on disk before the step's method returns.
A line holds the entry, its place in the journal, a check of the entry before it, and what kernels and catalog gave for
this step.  A line that a crash cut short is not read; what follows a line that does not fit is not read either.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import digest, plain_values
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.session import pointing, star_field, star_steps
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.state import HEADER_TOPIC, SessionState
from opnav_workbench.threads import one_thread

if TYPE_CHECKING:
    from opnav_workbench.session import body_steps, landmark_steps
else:  # a picture of stars needs nothing that finds bodies or landmarks
    body_steps = module_on_demand("opnav_workbench.session.body_steps")
    landmark_steps = module_on_demand("opnav_workbench.session.landmark_steps")

__all__ = [
    "JOURNAL_FILE",
    "STEPS_BY_HAND",
    "History",
    "JournalEntry",
    "JournalTail",
    "KeptState",
    "journal_line",
    "note",
    "read_journal_file",
    "stored_entry",
]


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One step of a session.

    Attributes
    ----------
    step
        The `ImageSession` method called.
    parameters
        Its arguments as plain values; replaying them reproduces the state.
    reason
        Why, in the analyst's words.
    outcome
        One line of what came out.
    time_utc
        When, ISO 8601.
    """

    step: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    outcome: str = ""
    time_utc: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain values."""
        return asdict(self)


def stored_entry(values: Any) -> JournalEntry:
    """Return the entry that a file holds as plain values.

    Raises
    ------
    TypeError
        They are none of an entry: a step that is no text, parameters that are no mapping, unknown names.
    """
    entry = JournalEntry(**values)
    texts = (entry.step, entry.reason, entry.outcome, entry.time_utc)
    if not (all(isinstance(text, str) for text in texts) and isinstance(entry.parameters, Mapping)):
        raise TypeError(f"{values!r:.80} is no step of a session")
    return entry


def stamped_entry(step: str, parameters: Mapping[str, Any], reason: str, outcome: str) -> JournalEntry:
    """Return a journal entry stamped with the present time."""
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    return JournalEntry(step, dict(parameters), reason, outcome, now)


# ---- journal.jsonl: the steps since session.json was written.

JOURNAL_FILE = "journal.jsonl"
CHECK_DIGITS = 12


@dataclass(frozen=True, slots=True, eq=False)
class JournalTail:
    """What a journal file adds to a session.

    Attributes
    ----------
    inputs
        What the steps added to the inputs, as `inputs_added` gives them.
    length
        Bytes of the file that are whole and belong to the session.
    note
        What was left out, and why; empty as a rule.
    """

    entries: tuple[JournalEntry, ...]
    inputs: tuple[Mapping[str, Any], ...]
    length: int
    note: str = ""


def journal_line(
    session: str, number: int, before: JournalEntry | None, entry: JournalEntry, inputs: Mapping[str, Any]
) -> bytes:
    """Return the line of the entry at place `number` (from 0) of the journal."""
    data = {"session": session, "n": number, "after": _entry_check(before), "entry": entry.to_dict()}
    if inputs:
        data["inputs"] = inputs
    text = json.dumps(plain_values(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.encode(errors="backslashreplace") + b"\n"


def _entry_check(entry: JournalEntry | None) -> str:
    """Return a short check of an entry, so that a line is read after no other than the one it was written after."""
    return "" if entry is None else digest(entry.to_dict())[:CHECK_DIGITS]


def read_journal_file(path: Path, session: str, journal: Sequence[JournalEntry]) -> JournalTail:
    """Read what a journal file adds to the `journal` of session.json.

    Raises
    ------
    OSError
        It is there, but cannot be read.
    """
    if not path.exists():
        return JournalTail((), (), 0)
    content, known = path.read_bytes(), list(journal)
    inputs: list[Mapping[str, Any]] = []
    length, message = 0, ""
    for number, raw in enumerate(content.splitlines(keepends=True), start=1):
        line = _parsed_line(raw)
        if line is None:
            what = "the last line" if length + len(raw) == len(content) else f"line {number} and what follows"
            message = f"{path.name}: {what} was cut short by a crash and is left out"
            break
        if not _belongs(line, session, known):
            message = f"{path.name}: from line {number} on it belongs to another session and is left out"
            break
        if line["n"] == len(known):
            known.append(stored_entry(line["entry"]))
            inputs.append(line.get("inputs", {}))
        length += len(raw)
    return JournalTail(tuple(known[len(journal) :]), tuple(inputs), length, message)


def _belongs(line: Mapping[str, Any], session: str, known: Sequence[JournalEntry]) -> bool:
    """Whether a line is one of the entries known, or the very next one."""
    if line["session"] != session or line["n"] > len(known):
        return False
    return bool(line["n"] < len(known) or line["after"] == _entry_check(known[-1] if known else None))


def _parsed_line(raw: bytes) -> dict[str, Any] | None:
    """Return a line's content; None for one that is not whole."""
    if not raw.endswith(b"\n"):
        return None
    try:
        line = json.loads(raw)
        entry = line["entry"]
        whole = isinstance(line["n"], int) and {"session", "after"} <= set(line) and isinstance(entry, dict)
        stored_entry(entry)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return line if whole else None


@dataclass(frozen=True, slots=True, eq=False)
class KeptState:
    """The state after the first `count` standing steps of a session."""

    count: int
    state: SessionState


# ---- The table of steps: the pure function behind every `ImageSession` method that changes the state, and the line that
# the journal says of what came out.

Step = Callable[[Context, Inputs, SessionState, dict[str, Any]], SessionState]
OutcomeText = Callable[[SessionState, dict[str, Any]], str]


def note(context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]) -> SessionState:
    """Keep a remark of the analyst."""
    return state.replace(user_notes=(*state.user_notes, parameters["text"]))


def _then_judged(step: Step) -> Step:
    """Return a step after which landmarks are judged anew, where it has changed the attitude."""

    def taken(
        context: Context, inputs: Inputs, state: SessionState, parameters: dict[str, Any]
    ) -> SessionState:
        after = step(context, inputs, state, parameters)
        if not after.landmarks or (
            after.pointing is state.pointing
            and np.array_equal(pointing.best_attitude(inputs, after), pointing.best_attitude(inputs, state))
        ):
            return after
        return landmark_steps.judged(context, inputs, after)

    return taken


def _on_demand(module: Any, name: str) -> Callable[..., Any]:
    """Return a function of a module that is loaded at the call."""
    return partial(_called, module, name)


def _called(module: Any, name: str, *given: Any) -> Any:
    return getattr(module, name)(*given)


STEPS: dict[str, tuple[Step, OutcomeText]] = {
    "predict": (_then_judged(star_steps.predict), star_steps.predict_outcome),
    "two_star_pointing": (_then_judged(star_field.two_star_pointing), star_field.two_star_outcome),
    "nudge": (_then_judged(star_field.nudge), star_field.nudge_outcome),
    "find_stars": (
        _then_judged(star_steps.find_stars),
        lambda s, _: f"{int(s.mask('used').sum())} stars found",
    ),
    "refit_stars": (star_steps.refit_stars, star_steps.refit_outcome),
    "place_star": (star_steps.place_star, star_steps.place_outcome),
    "reject_stars": (star_steps.reject_stars, lambda _, p: f"{len(p['ids'])} rejected"),
    "accept_stars": (star_steps.accept_stars, lambda _, p: f"{len(p['ids'])} accepted"),
    "repoint": (_then_judged(pointing.repoint), pointing.repoint_outcome),
    "carry_pointing": (_then_judged(pointing.carry_pointing), pointing.carried_outcome),
    "add_target": (_on_demand(body_steps, "add_target"), lambda _, p: f"{p['name']} expected"),
    "describe_body": (
        _on_demand(body_steps, "describe_body"),
        lambda _, p: f"{p['name']} described by hand",
    ),
    "skip_target": (_on_demand(body_steps, "skip_target"), lambda _, p: f"{p['name']} left out"),
    "set_circle": (
        _on_demand(body_steps, "set_circle"),
        lambda _, p: f"{p['name']}: circle of radius {p['radius_px']:.1f} px",
    ),
    "clear_circle": (_on_demand(body_steps, "clear_circle"), lambda _, p: f"{p['name']}: no circle"),
    "choose_scans": (
        _on_demand(body_steps, "choose_scans"),
        _on_demand(body_steps, "scans_outcome"),
    ),
    "find_body": (_on_demand(body_steps, "find_body"), _on_demand(body_steps, "body_outcome")),
    "find_bodies": (
        _on_demand(body_steps, "find_bodies"),
        _on_demand(body_steps, "bodies_outcome"),
    ),
    "find_landmarks": (
        _on_demand(landmark_steps, "find_body_landmarks"),
        _on_demand(landmark_steps, "landmarks_outcome"),
    ),
    "reject_landmarks": (
        _on_demand(landmark_steps, "reject_landmarks"),
        _on_demand(landmark_steps, "landmarks_outcome"),
    ),
    "accept_landmarks": (
        _on_demand(landmark_steps, "accept_landmarks"),
        _on_demand(landmark_steps, "landmarks_outcome"),
    ),
    "observables": (pointing.observables, lambda s, _: f"{len(s.observables)} observables"),
    "note": (note, lambda s, _: f"note {len(s.user_notes)}"),
}


# What a person says; the other steps any program takes again.
STEPS_BY_HAND = frozenset(
    {
        "two_star_pointing",
        "nudge",
        "place_star",
        "reject_stars",
        "accept_stars",
        "reject_landmarks",
        "accept_landmarks",
        "describe_body",
        "set_circle",
        "clear_circle",
        "choose_scans",
        "note",
    }
)


# ---- The history itself.

KEPT_STATES = 60  # each holds the pictures of its bodies: up to 10 MB for a body of 600 px


@dataclass(slots=True)
class _StepTaken:
    """A step that was taken, and the state after it; None: not made yet."""

    entry: JournalEntry
    state: SessionState | None


class History:
    """States, oldest first, and the journal that made them; every step appends to both.

    Parameters
    ----------
    context
        The picture that the steps work on.
    inputs
        What kernels, header and catalog gave; replaced when a step needs more of them.
    """

    def __init__(self, context: Context, inputs: Inputs) -> None:
        self.inputs = inputs
        self._context = context
        self._first = SessionState().with_notes(HEADER_TOPIC, *inputs.contradictions)
        self._standing: list[_StepTaken] = []
        self._undone: list[_StepTaken] = []  # the next to be repeated is the last
        self._journal: list[JournalEntry] = []

    @property
    def seen_inputs(self) -> Inputs:
        """The inputs with what the analyst described in the picture."""
        return pointing.with_assisted(self._context, self.inputs, self.state)

    @property
    def state(self) -> SessionState:
        """The present, immutable state."""
        return self._state_after(len(self._standing))

    @property
    def journal(self) -> tuple[JournalEntry, ...]:
        """All entries in order, undone ones and the undoing included."""
        return tuple(self._journal)

    @property
    def standing(self) -> tuple[JournalEntry, ...]:
        """Entries whose effect stands."""
        return tuple(taken.entry for taken in self._standing)

    @property
    def undone(self) -> tuple[JournalEntry, ...]:
        """Entries that `redo` would repeat, the next one first."""
        return tuple(taken.entry for taken in reversed(self._undone))

    @one_thread()
    def state_after_step(self, step: str, parameters: dict[str, Any]) -> SessionState:
        """Return the state that a step would lead to, without taking it."""
        carry_out, _ = STEPS[step]
        return carry_out(self._context, self.seen_inputs, self.state, parameters)

    def record(self, step: str, parameters: dict[str, Any], state: SessionState, reason: str = "") -> None:
        """Take a step whose outcome is known; what was undone cannot be repeated after it."""
        _, outcome = STEPS[step]
        entry = stamped_entry(step, parameters, reason, outcome(state, parameters))
        self._standing.append(_StepTaken(entry, state))
        self._undone.clear()
        self._journal.append(entry)
        if len(self._standing) > KEPT_STATES:
            self._standing[-KEPT_STATES - 1].state = None

    def undo(self) -> JournalEntry:
        """Take back the last step and return its entry; the journal keeps both.

        Raises
        ------
        SessionError
            Nothing is left to undo.
        """
        if not self._standing:
            raise SessionError("nothing to undo: no step has been taken yet.")
        self._state_after(len(self._standing) - 1)  # before anything changes: it may have to be made again
        return self._undo_or_redo("undo")

    def redo(self) -> JournalEntry:
        """Take the last undone step again and return its entry.

        Raises
        ------
        SessionError
            Nothing was undone since the last step.
        """
        if not self._undone:
            raise SessionError("nothing to redo: no step has been undone since the last one was taken.")
        taken = self._undone[-1]
        if taken.state is None:
            taken.state = self._replayed(self.state, taken.entry)
        return self._undo_or_redo("redo")

    def _undo_or_redo(self, how: str) -> JournalEntry:
        """Move one step from those that stand to those that are undone, or back."""
        origin, goal = (self._standing, self._undone) if how == "undo" else (self._undone, self._standing)
        taken = origin.pop()
        goal.append(taken)
        step = taken.entry.step
        self._journal.append(
            stamped_entry(how, {"step": step}, "", f"{step} {'undone' if how == 'undo' else 'redone'}")
        )
        return taken.entry

    # -- from a file -------------------------------------------------------------------------------------------

    def load(
        self,
        journal: Sequence[JournalEntry],
        source: str,
        kept: Callable[[Sequence[JournalEntry]], KeptState | None] = lambda _: None,
    ) -> None:
        """Take the steps of a stored journal; those that stand are carried out, the undone ones only when redone.

        Parameters
        ----------
        source
            What it was read from.
        kept
            Gives a state that was kept after the first of the standing steps, if there is one.

        Raises
        ------
        SessionError
            The journal names an unknown step, or cannot be carried out.
        """
        for entry in journal:
            self._take_stored(entry, source)
        self._journal = list(journal)
        known = kept(self.standing)
        if known is not None:
            self._standing[known.count - 1].state = known.state
        try:
            self._state_after(len(self._standing))
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            raise SessionError(f"{source} is damaged ({error!r}); process the picture again.") from error

    def _take_stored(self, entry: JournalEntry, source: str) -> None:
        if entry.step in ("undo", "redo"):
            undo = entry.step == "undo"
            origin, goal = (self._standing, self._undone) if undo else (self._undone, self._standing)
            if not origin:
                raise SessionError(
                    f"{source} is damaged: it {entry.step}es more than was done; process the picture again."
                )
            goal.append(origin.pop())
            return
        if entry.step not in STEPS:
            raise SessionError(
                f"{source} names an unknown step {entry.step!r}; it was written by a newer version."
            )
        self._standing.append(_StepTaken(entry, None))
        self._undone.clear()

    def _state_after(self, count: int) -> SessionState:
        """Return the state after the first `count` steps that stand, making those that are not kept."""
        known = count
        while known > 0 and self._standing[known - 1].state is None:
            known -= 1
        state = self._standing[known - 1].state if known else self._first
        assert state is not None
        for taken in self._standing[known:count]:
            state = taken.state = self._replayed(state, taken.entry)
        return state

    @one_thread()
    def _replayed(self, state: SessionState, entry: JournalEntry) -> SessionState:
        carry_out, _ = STEPS[entry.step]
        inputs = pointing.with_assisted(self._context, self.inputs, state)
        return carry_out(self._context, inputs, state, dict(entry.parameters))
