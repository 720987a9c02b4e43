"""What every part of `ImageSession` stands on: one history, its undo and redo, listeners, and the file that follows it."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import Catalog
from opnav_workbench.errors import CatalogError, SelectionPending, SessionError
from opnav_workbench.session.autosave import Autosave
from opnav_workbench.session.context import Context
from opnav_workbench.session.gather import InputSource, gather_target, gather_wide
from opnav_workbench.session.history import History
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.observing import attitude
from opnav_workbench.session.requirements import pending
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["SessionCore"]


class SessionCore:
    """State, journal, undo and redo of a session.

    Attributes
    ----------
    lock : threading.RLock
        Held while a step is carried out: front ends call from several threads.
    checkpoint : callable or None
        Called in the thread of a step when its outcome is known, before it is recorded; if it raises, nothing is
        recorded. A front end's way to cancel.
    """

    def __init__(
        self, context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
    ) -> None:
        self.lock = threading.RLock()
        self.checkpoint: Callable[[], None] | None = None
        self._catalog = catalog
        self._context = context
        self._source = source
        self._history = History(context, inputs)
        self._autosave: Autosave | None = None
        self._listeners: list[Callable[[Any], None]] = []

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def context(self) -> Context:
        """The picture, its camera, background and settings."""
        return self._context

    @property
    def inputs(self) -> Inputs:
        """What kernels, header and catalog gave."""
        return self._history.inputs

    @property
    def source(self) -> InputSource:
        """Where the inputs come from: catalog, target stars, attitude."""
        return self._source

    @property
    def state(self) -> SessionState:
        """The present, immutable state; that before a step which is being carried out."""
        return self._history.state

    @property
    def journal(self) -> tuple[JournalEntry, ...]:
        """All steps and decisions in order, undone ones and the undoing included."""
        return self._history.journal

    @property
    def standing(self) -> tuple[JournalEntry, ...]:
        """The steps and decisions whose effect stands."""
        return self._history.standing

    @property
    def undone(self) -> tuple[JournalEntry, ...]:
        """What `redo` would take again, the next one first."""
        return self._history.undone

    @property
    def camera_from_j2000(self) -> FloatArray:
        """Best known attitude (3, 3): solved, else where the analyst put the field, else a priori."""
        return attitude(self.inputs, self.state)

    # -- undo and redo -----------------------------------------------------------------------------------------

    @property
    def can_undo(self) -> bool:
        """Whether a step is there to take back."""
        return bool(self._history.standing)

    @property
    def can_redo(self) -> bool:
        """Whether an undone step is there to take again."""
        return bool(self._history.undone)

    def undo(self) -> JournalEntry:
        """Take back the last step and return its journal entry; the journal keeps both.

        Raises
        ------
        SessionError
            Nothing is left to undo.
        """
        with self.lock:
            undone = self._history.undo()
            self._changed()
        return undone

    def redo(self) -> JournalEntry:
        """Take the last undone step again and return its journal entry.

        Raises
        ------
        SessionError
            Nothing was undone since the last step.
        """
        with self.lock:
            redone = self._history.redo()
            self._changed()
        return redone

    # -- for people and front ends -----------------------------------------------------------------------------

    def note(self, text: str) -> None:
        """Keep a remark; it stands in the journal, in the result and in the decisions.

        Raises
        ------
        SessionError
            The remark is empty.
        """
        if not text.strip():
            raise SessionError("an empty note says nothing; give its text.")
        self._step("note", {"text": text.strip()})

    def on_change(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        """Call `callback` with the session after every step, undo and redo.

        Returns
        -------
        callable
            Call it to be left alone again.
        """
        self._listeners.append(callback)

        def forget() -> None:
            with suppress(ValueError):
                self._listeners.remove(callback)

        return forget

    def require(self, *needs: str) -> None:
        """Stop where a decision is still to be made, so that a notebook does not run past it.

        Parameters
        ----------
        *needs : {"stars_confirmed", "pointing", "bodies", "observables"}
            Every star in use confirmed by the analyst; the pointing solved; every target looked for; the observables
            computed.

        Raises
        ------
        SelectionPending
            One line: what is missing, and what to do.
        SessionError
            An unknown need (the known are listed).
        """
        missing = pending(self.state, needs)
        if missing:
            raise SelectionPending("; ".join(missing) + ".")

    # -- taking steps ------------------------------------------------------------------------------------------

    def _step(self, name: str, parameters: dict[str, Any], reason: str = "") -> None:
        """Carry out a step; one that fails leaves neither state nor entry."""
        with self.lock:
            began = time.perf_counter()
            state = self._history.tried(name, parameters)
            self._record(name, parameters, state, reason, cost_s=time.perf_counter() - began)

    def _record(
        self,
        name: str,
        parameters: dict[str, Any],
        state: SessionState,
        reason: str = "",
        cost_s: float = 0.0,
    ) -> None:
        if self.checkpoint is not None:
            self.checkpoint()
        self._history.record(name, parameters, state, reason)
        self._changed(cost_s)

    def _changed(self, cost_s: float = 0.0) -> None:
        """Write the new entries down, then tell the listeners; a disk that is full does not keep it from them."""
        try:
            if self._autosave is not None:
                self._autosave.follow(self._history, cost_s)
        finally:
            for listener in tuple(self._listeners):
                listener(self)

    def _gather_target(self, name: str) -> None:
        if name not in self.inputs.targets:
            self._history.inputs = gather_target(self._context, self._source, self.inputs, name)

    def _widen(self) -> bool:
        """Fetch the stars that a wide search needs; False where there are none to fetch."""
        if self.inputs.wide_stars is not None or not self._context.settings.wide_searches:
            return False
        try:
            self._history.inputs = gather_wide(self._context, self._source, self.inputs, self._catalog)
        except CatalogError:
            return False  # the catalog is not on this machine; what is not identified says so
        return True
