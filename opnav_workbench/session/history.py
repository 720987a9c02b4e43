"""The history of a session: its states, its journal, and how steps are taken, taken back, repeated and replayed.

A state follows from the steps before it, so that only the journal has to be kept: states of a session read from a file,
and old ones that were dropped to save memory, are made again when they are asked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.session.context import Context
from opnav_workbench.session.journal import JournalEntry, entry
from opnav_workbench.session.snapshot import KeptState
from opnav_workbench.session.state import Inputs, SessionState
from opnav_workbench.session.steps import STEPS, outcome_of

__all__ = ["History"]

KEPT_STATES = 60  # each holds the pictures of its bodies: up to 10 MB for a body of 600 px


@dataclass(slots=True)
class _Taken:
    """A step that was taken, and the state after it; None: not made yet."""

    entry: JournalEntry
    state: SessionState | None


class History:
    """States, oldest first, and the journal that made them; every step appends to both.

    Parameters
    ----------
    context : Context
        The picture that the steps work on.
    inputs : Inputs
        What kernels, header and catalog gave; replaced when a step needs more of them.
    """

    def __init__(self, context: Context, inputs: Inputs) -> None:
        self.inputs = inputs
        self._context = context
        self._first = SessionState()
        self._standing: list[_Taken] = []
        self._undone: list[_Taken] = []  # the next to be repeated is the last
        self._journal: list[JournalEntry] = []

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

    def tried(self, step: str, parameters: dict[str, Any]) -> SessionState:
        """Return the state that a step would lead to, without taking it."""
        return STEPS[step](self._context, self.inputs, self.state, parameters)

    def record(self, step: str, parameters: dict[str, Any], state: SessionState, reason: str = "") -> None:
        """Take a step whose outcome is known; what was undone cannot be repeated after it."""
        made = entry(step, parameters, reason, outcome_of(step, state, parameters))
        self._standing.append(_Taken(made, state))
        self._undone.clear()
        self._journal.append(made)
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
        return self._moved("undo")

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
            taken.state = self._made(self.state, taken.entry)
        return self._moved("redo")

    def _moved(self, how: str) -> JournalEntry:
        """Move one step from those that stand to those that are undone, or back."""
        came, went = (self._standing, self._undone) if how == "undo" else (self._undone, self._standing)
        taken = came.pop()
        went.append(taken)
        step = taken.entry.step
        self._journal.append(
            entry(how, {"step": step}, "", f"{step} {'undone' if how == 'undo' else 'redone'}")
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
        journal : sequence of JournalEntry
        source : str
            What it was read from.
        kept : callable
            Gives a state that was kept after the first of the standing steps, if there is one.

        Raises
        ------
        SessionError
            The journal names an unknown step, or cannot be carried out.
        """
        for item in journal:
            self._take_stored(item, source)
        self._journal = list(journal)
        known = kept(self.standing)
        if known is not None:
            self._standing[known.count - 1].state = known.state
        try:
            self._state_after(len(self._standing))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise SessionError(f"{source} is damaged ({error!r}); process the picture again.") from error

    def _take_stored(self, item: JournalEntry, source: str) -> None:
        if item.step in ("undo", "redo"):
            came, went = (
                (self._standing, self._undone) if item.step == "undo" else (self._undone, self._standing)
            )
            if not came:
                raise SessionError(
                    f"{source} is damaged: it {item.step}es more than was done; process the picture again."
                )
            went.append(came.pop())
            return
        if item.step not in STEPS:
            raise SessionError(
                f"{source} names an unknown step {item.step!r}; it was written by a newer version."
            )
        self._standing.append(_Taken(item, None))
        self._undone.clear()

    def _state_after(self, count: int) -> SessionState:
        """Return the state after the first `count` steps that stand, making those that are not kept."""
        known = count
        while known > 0 and self._standing[known - 1].state is None:
            known -= 1
        state = self._standing[known - 1].state if known else self._first
        assert state is not None
        for taken in self._standing[known:count]:
            state = taken.state = self._made(state, taken.entry)
        return state

    def _made(self, state: SessionState, item: JournalEntry) -> SessionState:
        return STEPS[item.step](self._context, self.inputs, state, dict(item.parameters))
