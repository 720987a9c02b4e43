"""ImageSession: one picture, one analyst's (or one night's) way through it.

Every method is one step: a pure function makes a new frozen state, the journal gains an entry, and the older state
stays for `undo`.  Workbench, notebooks and the command line call these same methods.  Steps of stars and pointing come
first, then bodies and observables, then files: autosave, save, resume, CK.
"""

import threading
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Self

from astropy.table import QTable

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import Catalog
from opnav_workbench.errors import CatalogError, OpNavError, SelectionPending, SessionError
from opnav_workbench.files import json_text, sha256_of, write_json
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.observables import observables_table
from opnav_workbench.scene import BodyPrediction, StarPrediction, predict_body
from opnav_workbench.session import storage
from opnav_workbench.session.autosave import Autosave, read_state
from opnav_workbench.session.body_steps import target_with_shape
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions
from opnav_workbench.session.folder_lock import check_unlocked
from opnav_workbench.session.history import JOURNAL_FILE, History, JournalEntry
from opnav_workbench.session.inputs import Inputs, InputSource, collect_inputs, with_target, with_wide_stars
from opnav_workbench.session.pointing import attitude
from opnav_workbench.session.reconstruction import Reconstruction, write_reconstructed_ck
from opnav_workbench.session.result import result_dict
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.star_boxes import StarBox, star_boxes
from opnav_workbench.session.star_field import catalog_stars, nudge_reach_px, unknown_star_ids
from opnav_workbench.session.state import SessionState, open_decisions
from opnav_workbench.session.storage import SessionOnDisk, load_session, session_on_disk

__all__ = ["ImageSession"]


# ---- What every part of `ImageSession` stands on: one history, its undo and redo, listeners, and the file ...


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
        missing = open_decisions(self.state, needs)
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
            self._history.inputs = with_target(self._context, self._source, self.inputs, name)

    def _widen(self) -> bool:
        """Fetch the stars that a wide search needs; False where there are none to fetch."""
        if self.inputs.wide_stars is not None or not self._context.settings.wide_searches:
            return False
        try:
            self._history.inputs = with_wide_stars(self._context, self._source, self.inputs, self._catalog)
        except CatalogError:
            return False  # the catalog is not on this machine; what is not identified says so
        return True


# ---- The part of `ImageSession` that deals with stars and the pointing.


def _id_list(ids: Sequence[str]) -> list[str]:
    # A single name is a sequence too, of letters; nobody means those.
    return [ids] if isinstance(ids, str) else [str(star) for star in ids]


class StarMethods(SessionCore):
    """Steps with stars: predict, find, decide, move the field, repoint."""

    def predict(self) -> StarPrediction:
        """Predict catalog stars around the a priori field; drops what was found before, but no decision."""
        self._step("predict", {})
        assert self.state.a_priori is not None
        return self.state.a_priori

    def find_stars(
        self,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
    ) -> None:
        """Identify the field and fit the star centers; with a solved pointing the search is around it.

        A field that is not identified for sure within the limits of the a priori pointing is searched farther out
        (see `Settings`), in a cone of the catalog that grows with it.

        Parameters
        ----------
        initial : {"matched_filter", "cross_correlation"}
        final : {"least_squares", "psf_fit", "matched_filter", "cross_correlation"}
            ``psf_fit`` takes the camera's own PSF, such as one of ``opnav calibrate psf``.
        search_radius_px : float, optional
            How far from its expected place a star may lie; default from the settings.
        """
        parameters = {"initial": initial, "final": final, "search_radius_px": search_radius_px}
        with self.lock:
            began = time.perf_counter()
            state = self._history.tried("find_stars", parameters)
            if (state.star_field is None or not state.star_field.sure) and self._widen():
                state = self._history.tried("find_stars", parameters)
            self._record("find_stars", parameters, state, cost_s=time.perf_counter() - began)

    def refit_stars(
        self,
        ids: Sequence[str] | None = None,
        *,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
        template: str | None = None,
    ) -> None:
        """Fit some stars again at once, or all, without identifying the field again.

        Parameters
        ----------
        ids : sequence of str, optional
            Catalog ids; None: all.
        initial, final, search_radius_px
            As in `find_stars`.
        template : str, optional
            The star whose image is the template of the matched filter; by default a well-exposed one.

        Raises
        ------
        SessionError
            No stars are found yet, an unknown star or method.
        """
        parameters = {
            "ids": None if ids is None else _id_list(ids),
            "initial": initial,
            "final": final,
            "search_radius_px": search_radius_px,
            "template": template,
        }
        self._step("refit_stars", parameters)

    def place_star(self, star_id: str, pixel_line: Sequence[float]) -> None:
        """Fit a catalog star where the analyst sees it, and accept it.

        Parameters
        ----------
        star_id : str
            A predicted star, or any other of the catalog around the field.
        pixel_line : (float, float)
            Where it is seen; the fit looks within a few pixels.

        Raises
        ------
        SessionError
            No stars are predicted yet, an unknown star, or a place off the detector.
        """
        place = [float(value) for value in pixel_line]
        if len(place) != 2:
            raise SessionError(f"a place is (pixel, line), got {place}.")
        self._step("place_star", {"id": str(star_id), "place": place})

    def reject_stars(self, ids: Sequence[str], reason: str) -> None:
        """Reject stars by catalog id; the reason stands in the journal and in the result.

        Raises
        ------
        SessionError
            No stars are predicted yet, or there is no star of that id.
        """
        self._step("reject_stars", {"ids": _id_list(ids), "reason": reason}, reason)

    def accept_stars(self, ids: Sequence[str], reason: str = "") -> None:
        """Accept stars by catalog id, outranking any automatic rejection; raises as `reject_stars`."""
        self._step("accept_stars", {"ids": _id_list(ids), "reason": reason}, reason)

    def star_boxes(self, ids: Sequence[str] | None = None) -> tuple[StarBox, ...]:
        """Return what a person looks at to judge the stars: data, model and residual around each.

        Parameters
        ----------
        ids : sequence of str, optional
            By default all stars expected on the detector, in the order of `state.a_priori`.

        Raises
        ------
        SessionError
            No stars are predicted yet, or there is no star of that id.
        """
        return star_boxes(self.context, self.inputs, self.state, None if ids is None else _id_list(ids))

    # -- the field ---------------------------------------------------------------------------------------------

    def two_star_pointing(
        self, places: Sequence[Sequence[float]], ids: Sequence[str] | None = None, reason: str = ""
    ) -> None:
        """Solve shift and twist of the field from two stars that the analyst marks; go on with `find_stars`.

        Parameters
        ----------
        places : two (pixel, line)
            Marked places; each means the nearest detection, or itself where there is none.
        ids : two str, optional
            Catalog ids of the marked stars; without them they are looked for among the stars around the field, any
            twist.
        reason : str
            For the journal.

        Raises
        ------
        SessionError, CenterfindingError
            No stars are predicted yet, an id is unknown, the places do not fit the stars' separation, or stars that
            are not named cannot be told from others.
        """
        marks = [[float(value) for value in place] for place in places]
        names = None if ids is None else [str(star) for star in ids]
        if len(marks) != 2 or (names is not None and len(set(names)) != 2):
            raise SessionError(f"two stars must be marked, got {len(marks)} places and ids {names}.")
        with self.lock:
            if names is None or unknown_star_ids(self.inputs, names):
                self._widen()
            self._step("two_star_pointing", {"places": marks, "ids": names}, reason)

    def nudge(self, delta_pixel: float, delta_line: float, delta_twist_deg: float = 0.0) -> None:
        """Move the predicted field by hand; nudges add up, and `find_stars` then searches there.

        Centers and pointing found before are dropped.

        Parameters
        ----------
        delta_pixel, delta_line : float
            How far the field moves on the detector, px.
        delta_twist_deg : float
            How far it turns about the boresight, from +pixel toward +line.

        Raises
        ------
        SessionError
            No stars are predicted yet, or the field would leave what the camera model covers.
        """
        parameters = {
            "delta_pixel": float(delta_pixel),
            "delta_line": float(delta_line),
            "delta_twist_deg": float(delta_twist_deg),
        }
        with self.lock:
            if (
                nudge_reach_px(self.context, self.inputs, self.state, parameters)
                > self.context.settings.max_shift_px
            ):
                self._widen()
            self._step("nudge", parameters)

    def repoint(self, model: str = "euler", *, a_priori: bool = False, reason: str = "") -> None:
        """Solve the camera attitude from the stars in use.

        Parameters
        ----------
        model : {"euler", "image_plane"}
        a_priori : bool
            Take the a priori attitude as a measurement too, with the camera's ``attitude_sigma``; where the field was
            found far from it, it does not count.
        reason : str
            For the journal.
        """
        self._step("repoint", {"model": model} | ({"a_priori": True} if a_priori else {}), reason)

    def known_stars(self) -> tuple[str, ...]:
        """Return the ids of all catalog stars at hand, predicted in the picture or not."""
        return tuple(catalog_stars(self.inputs).id.tolist())


# ---- The part of `ImageSession` that deals with target bodies and their observables.

PLACE_NUMBERS = 2  # numbers of a place


class BodyMethods(SessionCore):
    """Steps with bodies: expect, circle, find, choose scans, observables."""

    def add_target(self, name: str) -> None:
        """Take a body or target star into the predicted scene, so that identification expects it there.

        Bodies found before are found again with its light and shadow.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.

        Raises
        ------
        KernelError
            Neither kernels nor the star list know it.
        """
        with self.lock:
            self._gather_target(name)
            if name not in self.state.targets:
                self._step("add_target", {"name": name})

    def predict_body(self, name: str) -> BodyPrediction:
        """Return where and how large a target is expected with the best known pointing; no step of the session.

        Raises
        ------
        KernelError
            Neither kernels nor the star list know it.
        """
        with self.lock:
            self._gather_target(name)
        target = target_with_shape(self.context, self.inputs, name)
        return predict_body(target, self.inputs.observer, self.context.camera, self.camera_from_j2000)

    def skip_target(self, name: str, reason: str) -> None:
        """Record that a requested target is left out, and why; the result's status then is ``partial``."""
        self._step("skip_target", {"name": name, "reason": reason}, reason)

    def find_body(
        self,
        name: str,
        method: str = "auto",
        search_radius_px: float | None = None,
        *,
        circle: Sequence[float] | None = None,
        scans: Sequence[int] | None = None,
        solve_range: bool = False,
    ) -> None:
        """Find a body's center.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.
        method : {"auto", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"}
            ``auto`` takes what suits the body's size and what is known of its surface.
        search_radius_px : float, optional
            How far from its expected place it may be; default from the predicted uncertainty and its size.
        circle : (pixel, line, radius), optional
            Where it is seen, for this search; default the analyst's circle (`set_circle`), else the predicted one.
        scans : sequence of int, optional
            Numbers of the limb scans to use; default the analyst's choice (`choose_scans`), else automatic.
        solve_range : bool
            Solve for the range (apparent size), too, where the method can.
        """
        parameters: dict[str, Any] = {
            "name": name,
            "method": method,
            "search_radius_px": search_radius_px,
        }
        if circle is not None:
            parameters["circle"] = _circle_numbers(circle)
        if scans is not None:
            parameters["scans"] = [int(number) for number in scans]
        if solve_range:
            parameters["solve_range"] = True
        with self.lock:
            self._gather_target(name)
            self._step("find_body", parameters | self._scene())

    def find_bodies(self, names: Sequence[str], method: str = "least_squares") -> None:
        """Find several bodies at once, with the correlation of their centers.

        Parameters
        ----------
        names : sequence of str
        method : {"least_squares"}
        """
        if isinstance(names, str) or len(set(names)) < 2:
            raise SessionError(f"name two bodies or more, got {names!r}.")
        with self.lock:
            for name in names:
                self._gather_target(name)
            self._step("find_bodies", {"names": [str(n) for n in names], "method": method} | self._scene())

    def set_circle(self, name: str, center_px: Sequence[float], radius_px: float) -> None:
        """Say where a body is seen, and how large: every method for extended bodies starts from there.

        Parameters
        ----------
        name : str
        center_px : (float, float)
            (pixel, line); it may lie off the detector.
        radius_px : float
        """
        pixel, line, radius = _circle_numbers([*center_px, radius_px])
        with self.lock:
            self._gather_target(name)
            self._step("set_circle", {"name": name, "center_px": [pixel, line], "radius_px": radius})

    def clear_circle(self, name: str) -> None:
        """Forget the circle of a body: the predicted one counts again.

        Raises
        ------
        SessionError
            It has none.
        """
        if name not in self.state.circles:
            raise SessionError(f"{name} has no circle to clear; set_circle() gives it one.")
        self._step("clear_circle", {"name": name})

    def choose_scans(self, name: str, numbers: Sequence[int] | None, reason: str = "") -> None:
        """Choose the limb scans of a body by their numbers; a limb-scan center that stands is made anew.

        Parameters
        ----------
        name : str
        numbers : sequence of int or None
            None: automatic again.
        reason : str
            For the journal and the decisions.
        """
        chosen = None if numbers is None else sorted({int(number) for number in numbers})
        with self.lock:
            self._gather_target(name)
            self._step("choose_scans", {"name": name, "numbers": chosen, "reason": reason}, reason)

    def observables(self) -> QTable:
        """Compute the observables of all bodies found so far.

        Returns
        -------
        astropy.table.QTable
            One row a body and method: O, C, O-C, sigmas, partials, with units and descriptions.
        """
        self._step("observables", {})
        return observables_table(self.state.observables)

    def _scene(self) -> dict[str, Any]:
        """Name the mission's bodies that may hide, shade or outshine the one that is looked for."""
        names = []
        for name in self.context.mission.default_targets:
            if name not in self.inputs.targets and KernelSet.active() is not None:
                try:
                    self._gather_target(name)
                except OpNavError:
                    continue  # nothing is known of it: it is not in the scene
            if name in self.inputs.targets:
                names.append(name)
        return {"scene": names} if names else {}


def _circle_numbers(values: Sequence[float]) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != PLACE_NUMBERS + 1:
        raise SessionError(f"a circle is (pixel, line, radius), got {numbers}.")
    return numbers


# ---- The part of `ImageSession` that deals with files: autosave, save, resume, CK.

ID_DIGITS = 16


class FileMethods(SessionCore):
    """Saving and resuming.

    Attributes
    ----------
    id : str
        Names this session in its files.
    resume_note : str
        What `resume` had to leave out, such as a line that a crash cut short; empty as a rule.
    """

    def __init__(
        self, context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
    ) -> None:
        super().__init__(context, source, inputs, catalog)
        self.id = uuid.uuid4().hex[:ID_DIGITS]
        self.resume_note = ""

    @property
    def folder(self) -> Path | None:
        """Where every step is saved; None without autosave."""
        return None if self._autosave is None else self._autosave.folder

    def autosave(self, folder: str | Path | None) -> None:
        """From now on have every step on disk when its method returns: ``session.json`` and ``journal.jsonl``.

        Parameters
        ----------
        folder : path or None
            None: no longer.

        Raises
        ------
        SessionError
            The folder cannot be written, another process writes into it, or it holds another session or newer steps of
            this one (resume it instead).
        """
        with self.lock:
            if self._autosave is not None:
                self._autosave.close()
                self._autosave = None
            if folder is not None:
                self._autosave = self._started(Autosave(Path(folder), self.id, self.context.frame.sha256))

    def _started(self, writer: Autosave) -> Autosave:
        try:
            stored = session_on_disk(writer.folder)
            if stored is None or (stored.sha256 == self.context.frame.sha256 and not stored.journal):
                write_json(writer.folder / storage.SESSION_FILE, self._dict())
                writer.start(self._history, len(self.journal), 0)
            else:
                self._check_mine(stored, writer.folder)
                writer.start(self._history, len(stored.journal), stored.tail_bytes)
                writer.follow(self._history)
        except BaseException:
            writer.close()
            raise
        return writer

    def _check_mine(self, stored: SessionOnDisk, folder: Path) -> None:
        """Refuse a folder whose session is not this one, or knows more."""
        count = len(stored.journal)
        if stored.session == self.id and stored.journal == self.journal[:count]:
            return
        what = "newer steps of this session" if stored.session == self.id else "another session"
        raise SessionError(
            f"{folder} holds {what} ({count} entries in its journal); continue it with ImageSession.resume, or choose "
            "another folder."
        )

    def _dict(self) -> dict[str, Any]:
        return storage.session_dict(self.context, self.source, self.inputs, self.journal, self.id)

    def save(self, folder: str | Path) -> Path:
        """Write ``result.json``, ``observables.ecsv`` and ``session.json`` into `folder`, and return it.

        Raises
        ------
        SessionError
            The folder cannot be written, or another process writes into it; older files in it are unchanged.
        """
        target = Path(folder)
        with self.lock:
            own = self._autosave is not None and target.resolve() == self._autosave.folder
            if not own:
                check_unlocked(target)
            result = result_dict(self.context, self.source, self.inputs, self.state)
            storage.write_session(target, result, self.state.observables, self._dict())
            if own:
                assert self._autosave is not None
                self._autosave.start(self._history, len(self.journal), 0)
            else:
                (target / JOURNAL_FILE).unlink(missing_ok=True)  # session.json holds the whole journal
        return target

    def write_decisions(self, path: str | Path, who: str = "") -> Path:
        """Write the decisions of this session as a file that headless runs carry out; return its path.

        Decisions on other pictures that the file holds stay there.

        Parameters
        ----------
        path : path
        who : str
            The analyst.

        Raises
        ------
        SessionError
            The file cannot be written, or what is there is no decisions file.
        """
        older = [load_decisions(path)] if Path(path).exists() else []
        return write_decisions(path, [*older, Decisions.from_session(self, who)])  # type: ignore[arg-type]

    def write_ck(self, path: str | Path, *, without_twist: bool = False) -> Reconstruction:
        """Write the solved pointing as a CK; see `opnav_workbench.session.reconstruction`.

        Raises
        ------
        SessionError, KernelError
            No pointing is solved yet; or LSK and SCLK are not open.
        """
        result = result_dict(self.context, self.source, self.inputs, self.state)
        return write_reconstructed_ck([result], path, self.context.mission, without_twist=without_twist)

    @classmethod
    def resume(cls, folder: str | Path, image: str | Path | None = None) -> Self:
        """Continue a saved session: the steps that stand are taken again on the picture; kernels are not needed.

        Parameters
        ----------
        folder : path that `save` or `autosave` wrote
        image : path, optional
            Where the picture is now, if it has moved.

        Raises
        ------
        SessionError
            No readable ``session.json``, or the picture is missing or another one (SHA-256 differs).
        """
        saved = load_session(Path(folder), image)
        session = cls(saved.context, saved.source, saved.inputs)
        session.id = saved.session or session.id
        kept = partial(read_state, Path(folder), saved.context.frame.sha256)
        session._history.load(saved.journal, storage.SESSION_FILE, kept)
        session.resume_note = saved.tail.note
        return session

    @classmethod
    def open_or_resume(
        cls, folder: str | Path, path: str | Path, mission: str | Path | Mission, **options: Any
    ) -> Self:
        """Continue the session of a picture that `folder` holds, else open the picture; autosave there in both cases.

        Parameters
        ----------
        folder : path
        path, mission, **options
            As `open` takes them; options of a session that is continued stay as they were.

        Raises
        ------
        SessionError
            The folder holds a session of another picture, or another process writes into it.
        """
        stored = session_on_disk(Path(folder))
        if stored is None:
            session: Self = cls.open(path, mission, **options)  # type: ignore[attr-defined]
        elif stored.sha256 != sha256_of(path):
            raise SessionError(
                f"{folder} holds the session of another picture than {path}; choose another folder."
            )
        else:
            session = cls.resume(folder, image=path)
        session.autosave(folder)
        return session


# ---- ImageSession: one picture, one analyst's (or one night's) way through it.


class ImageSession(StarMethods, BodyMethods, FileMethods):
    """One picture and all that is done with it.

    Build it with `open` or `resume`.  Read `state`, `journal` and `result()` at any time.

    Examples
    --------
    ::

        with opnav.KernelSet("approach.tm"):
            s = opnav.ImageSession.open("lor_0299.fit", mission="new_horizons")
            s.autosave("run/lor_0299")
            s.predict()
            s.find_stars()
            s.repoint(model="euler")
            s.find_body("PLUTO")
            s.observables()
            s.save("run/lor_0299")
    """

    @classmethod
    def open(
        cls,
        path: str | Path,
        mission: str | Path | Mission,
        *,
        catalog: str = "bundled",
        opened_catalog: Catalog | None = None,
        target_stars: str | Path | None = None,
        attitude: str = "auto",
        settings: Settings | None = None,
    ) -> "ImageSession":
        """Open a picture.

        Parameters
        ----------
        path : path to a FITS or VICAR/PDS3 picture
        mission : str, path or Mission
            Mission name (``new_horizons``) or path of a mission YAML.
        catalog : str
            Catalog spec: ``bundled``, ``npz:FILE``, ``astrometry-net:GLOB``.
        opened_catalog : Catalog, optional
            The same catalog, already open: for many pictures one after the other.
        target_stars : path, optional
            YAML star list whose stars can be targets; default the mission's own list.
        attitude : {"auto", "kernels", "header"}
            Where the a priori attitude comes from; ``auto`` takes the kernels where the active `KernelSet` has a CK
            for the camera, else the header.
        settings : Settings, optional

        Raises
        ------
        ImageError, MissionError, CameraError, CatalogError, KernelError
            One line that says what is wrong and what to do.
        """
        mission = mission if isinstance(mission, Mission) else load_mission(mission)
        context = open_context(path, mission, settings or Settings())
        source = InputSource(catalog, None if target_stars is None else Path(target_stars), attitude)
        return cls(context, source, collect_inputs(context, source, opened_catalog), opened_catalog)

    def result(self) -> dict[str, Any]:
        """Return everything found so far as plain values, in the layout of ``result.json``."""
        return result_dict(self.context, self.source, self.inputs, self.state)

    def to_json(self) -> str:
        """Return `result` as JSON text."""
        return json_text(self.result())
