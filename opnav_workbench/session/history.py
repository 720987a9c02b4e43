"""The history of a session: its states, its journal, and how steps are taken, taken back and replayed."""

from collections.abc import Callable, Iterable
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.session import marking, steps_bodies, steps_stars
from opnav_workbench.session.context import Context
from opnav_workbench.session.journal import JournalEntry, entry
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["STEPS", "History"]

Step = Callable[[Context, Inputs, SessionState, dict[str, Any]], SessionState]

STEPS: dict[str, Step] = {
    "predict": steps_stars.predict,
    "two_star_pointing": marking.two_star_pointing,
    "find_stars": steps_stars.find_stars,
    "reject_stars": steps_stars.reject_stars,
    "accept_stars": steps_stars.accept_stars,
    "repoint": steps_bodies.repoint,
    "add_target": steps_bodies.add_target,
    "find_body": steps_bodies.find_body,
    "skip_target": steps_bodies.skip_target,
    "observables": steps_bodies.observables,
}

# One line of what came out of a step, for the journal.
OUTCOMES: dict[str, Callable[[SessionState, dict[str, Any]], str]] = {
    "predict": lambda s, _: f"{0 if s.a_priori is None else len(s.a_priori)} stars on or near the detector",
    "two_star_pointing": lambda s, _: marking.outcome(s),
    "find_stars": lambda s, _: f"{int(s.mask('used').sum())} stars found",
    "reject_stars": lambda _, p: f"{len(p['ids'])} rejected",
    "accept_stars": lambda _, p: f"{len(p['ids'])} accepted",
    "repoint": lambda s, _: _pointing_line(s),
    "add_target": lambda _, p: f"{p['name']} expected",
    "find_body": lambda s, p: f"{p['name']}: {s.bodies[-1].status}",
    "skip_target": lambda _, p: f"{p['name']} left out",
    "observables": lambda s, _: f"{len(s.observables)} observables",
}


class History:
    """States, oldest first, and the journal that made them; every step appends to both.

    Parameters
    ----------
    context : Context
        The picture that the steps work on.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: list[SessionState] = [SessionState()]
        self._journal: list[JournalEntry] = []

    @property
    def state(self) -> SessionState:
        """The present, immutable state."""
        return self._states[-1]

    @property
    def journal(self) -> tuple[JournalEntry, ...]:
        """All entries in order, undone ones and the undoing included."""
        return tuple(self._journal)

    def take(self, inputs: Inputs, step: str, parameters: dict[str, Any], reason: str = "") -> None:
        """Carry out a step; a step that fails leaves neither state nor entry."""
        self.record(step, parameters, self.tried(inputs, step, parameters), reason)

    def tried(self, inputs: Inputs, step: str, parameters: dict[str, Any]) -> SessionState:
        """Return the state that a step would lead to, without taking it."""
        return STEPS[step](self._context, inputs, self.state, parameters)

    def record(self, step: str, parameters: dict[str, Any], state: SessionState, reason: str = "") -> None:
        """Take a step whose outcome is known."""
        self._states.append(state)
        self._journal.append(entry(step, parameters, reason, OUTCOMES[step](state, parameters)))

    def undo(self) -> JournalEntry:
        """Take back the last step and return its entry; the journal keeps both.

        Raises
        ------
        SessionError
            Nothing is left to undo.
        """
        undone = self._standing()
        if not undone:
            raise SessionError("nothing to undo: no step has been taken yet.")
        self._states.pop()
        self._journal.append(entry("undo", {"step": undone[-1].step}, "", f"{undone[-1].step} undone"))
        return undone[-1]

    def _standing(self) -> list[JournalEntry]:
        """Journal entries whose effect still stands."""
        standing: list[JournalEntry] = []
        for item in self._journal:
            if item.step == "undo":
                standing.pop()
            else:
                standing.append(item)
        return standing

    def replay(self, inputs: Inputs, journal: Iterable[JournalEntry], source: str) -> None:
        """Take all steps of a stored journal again, undone ones too.

        Raises
        ------
        SessionError
            The journal, read from `source`, names an unknown step or cannot be carried out.
        """
        for item in journal:
            if item.step != "undo" and item.step not in STEPS:
                raise SessionError(
                    f"{source} names an unknown step {item.step!r}; it was written by a newer version."
                )
            if item.step == "undo" and len(self._states) == 1:
                raise SessionError(
                    f"{source} is damaged: it undoes more than was done; process the picture again."
                )
            self._repeat(inputs, item, source)

    def _repeat(self, inputs: Inputs, item: JournalEntry, source: str) -> None:
        if item.step == "undo":
            self._states.pop()
        else:
            try:
                state = STEPS[item.step](self._context, inputs, self.state, dict(item.parameters))
            except (KeyError, TypeError, ValueError) as error:
                raise SessionError(
                    f"{source} is damaged (step {item.step}: {error!r}); process the picture again."
                ) from error
            self._states.append(state)
        self._journal.append(item)


def _pointing_line(state: SessionState) -> str:
    pointing = state.pointing
    if pointing is None:
        return "pointing not determined"
    return (
        f"pointing moved by {pointing.delta_pixel:+.2f} px, {pointing.delta_line:+.2f} lines; "
        f"rms {pointing.rms_px:.3f} px with {pointing.n_stars} stars"
    )
