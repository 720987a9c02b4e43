"""ImageSession: one picture, one analyst's (or one night's) way through it.

Every method that changes something is one step: `history` calls the pure function of the step's name, which makes a new
frozen state; the journal gains an entry, and the older state stays for `undo`.  Workbench, notebooks and the command line
call these same methods.  The first line of a step says in brackets where its work is done.
"""

import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import Catalog
from opnav_workbench.errors import CatalogError, KernelError, SelectionPending, SessionError
from opnav_workbench.files import json_text, make_folder, plain_values, sha256_of
from opnav_workbench.kernels import body_radii_km
from opnav_workbench.kernels.shape_files import ShapeFile
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.observables import Observable, observables_table
from opnav_workbench.paths import exists
from opnav_workbench.scene import BodyPrediction, StarPrediction, predict_body
from opnav_workbench.session import inputs as input_values
from opnav_workbench.session import storage
from opnav_workbench.session.autosave import Autosave, read_state, start_autosave, write_state
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions
from opnav_workbench.session.folder_lock import FolderLock
from opnav_workbench.session.history import JOURNAL_FILE, History, JournalEntry
from opnav_workbench.session.inputs import Inputs, InputSource, LostField
from opnav_workbench.session.lost import asked_field, lost_field, open_inputs
from opnav_workbench.session.pointing import (
    best_attitude,
    current_observables,
    is_without_sky,
    solved_attitude,
)
from opnav_workbench.session.result import origin_of, result_dict
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.star_boxes import StarBox, star_boxes
from opnav_workbench.session.star_field import catalog_stars, nudge_reach_px, unknown_star_ids
from opnav_workbench.session.state import SessionState, open_decisions
from opnav_workbench.stars.pointing import AttitudeMotion, SolvedAttitude

if TYPE_CHECKING:
    from astropy.table import QTable

    from opnav_workbench.landmarks import LandmarkPatch
    from opnav_workbench.session import body_steps, landmark_steps, reconstruction
else:  # a picture of stars needs nothing that finds bodies or writes kernels
    body_steps = module_on_demand("opnav_workbench.session.body_steps")
    landmark_steps = module_on_demand("opnav_workbench.session.landmark_steps")
    reconstruction = module_on_demand("opnav_workbench.session.reconstruction")

__all__ = ["ImageSession"]

ID_DIGITS = 16
# Steps that took longer have their state saved with them: stars and disks are soon found again, landmarks are not.
SAVE_KEEPS_AFTER_S = 5.0
PLACE_NUMBERS, CIRCLE_NUMBERS = 2, 3


class ImageSession:
    """One picture and all that is done with it.

    Build it with `open` or `resume`.  Read `state`, `journal` and `result()` at any time.  A step that fails leaves
    neither state nor journal entry behind.

    Attributes
    ----------
    lock : threading.RLock
        Held while a step is carried out: front ends call from several threads.
    checkpoint : callable or None
        Called in the thread of a step when its outcome is known, before it is recorded; if it raises, nothing is
        recorded. A front end's way to cancel.
    id : str
        Names this session in its files.
    resume_note : str
        What `resume` had to leave out, such as a line that a crash cut short; empty as a rule.
    put_away : Path or None
        Where the last `save` has put an analyst's session that it found in the folder.
    context
        The picture, its camera, background and settings.
    source
        Where the inputs come from: catalog, target stars, attitude.

    Raises
    ------
    SessionError
        By any step: what it needs is not there yet (stars predicted, centers found), a star or method is unknown, a place
        is off the detector; the message says what to do.
    KernelError
        By steps that name a body: neither kernels nor the star list know it.

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

    def __init__(
        self, context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
    ) -> None:
        self.lock = threading.RLock()
        self.checkpoint: Callable[[], None] | None = None
        self.id = uuid.uuid4().hex[:ID_DIGITS]
        self.resume_note = ""
        self.put_away: Path | None = None
        self.context: Final = context
        self.source: Final = source
        self._catalog = catalog
        self._history = History(context, inputs)
        self._steps_s = 0.0  # what its steps took
        self._autosave: Autosave | None = None
        self._listeners: list[Callable[[Any], None]] = []

    # -- open ----------------------------------------------------------------------------------------------------

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
        shapes: Mapping[str, ShapeFile] | None = None,
        settings: Settings | None = None,
        by_hand: bool = False,
    ) -> Self:
        """Open a picture (`context.open_context`) and what kernels and catalog say of it (`inputs.collect_inputs`).

        Parameters
        ----------
        path
            A picture of any format of `opnav_workbench.image.formats`.
        mission
            Mission name (``new_horizons``) or path of a mission YAML.
        catalog
            Catalog spec: ``bundled``, ``npz:FILE``, ``astrometry-net:GLOB``.
        opened_catalog
            The same catalog, already open: for many pictures one after the other.
        target_stars
            YAML star list whose stars can be targets; default the mission's own list.
        attitude : {"auto", "kernels", "header", "none", "unknown"}
            Where the a priori attitude comes from; ``auto`` takes the kernels where the active `KernelSet` has a CK
            for the camera, else the header, and where these are silent the stars, as ``none`` does at once (`lost`).
            ``unknown``: from nowhere; bodies described by hand (`describe_body`) are measured in the picture alone.
        shapes : mapping of str to ShapeFile, optional
            Shape models by body; they outrank those of kernels and mission.
        settings
            Thresholds; default those of `Settings`.
        by_hand
            The picture's bodies will be described by hand: where nothing tells attitude or spacecraft state, the picture
            is opened without.

        Raises
        ------
        ImageError, MissionError, CameraError, CatalogError, KernelError
            One line that says what is wrong and what to do.
        """
        mission = mission if isinstance(mission, Mission) else load_mission(mission)
        context = open_context(path, mission, settings or Settings())
        stars = None if target_stars is None else Path(target_stars)
        source = InputSource(catalog, stars, attitude, MappingProxyType(dict(shapes or {})), by_hand)
        context, inputs = open_inputs(context, source, opened_catalog)
        return cls(context, source, inputs, opened_catalog)

    @classmethod
    def resume(cls, folder: str | Path, image: str | Path | None = None) -> Self:
        """Continue a saved session; kernels are not needed (`storage.load_session`, then `History.load`).

        The steps that stand are taken again on the picture, from the kept state on (`autosave.read_state`).

        Parameters
        ----------
        folder
            Where `save` or `autosave` wrote.
        image
            Where the picture is now, if it has moved.

        Raises
        ------
        SessionError
            No readable ``session.json``, or the picture is missing or another one (SHA-256 differs).
        """
        saved = storage.load_session(Path(folder), image)
        session = cls(saved.context, saved.source, saved.inputs)
        session.id = saved.session or session.id
        kept = partial(read_state, Path(folder), saved.context.picture.sha256)
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
        folder
            Where the session is, or shall be.
        path, mission, **options
            As `open` takes them; options of a session that is continued stay as they were.

        Raises
        ------
        SessionError
            The folder holds a session of another picture, or another process writes into it.
        """
        stored = storage.session_on_disk(Path(folder))
        if stored is not None and stored.sha256 != sha256_of(path):
            raise SessionError(
                f"{folder} holds the session of another picture than {path}; choose another folder."
            )
        session = cls.open(path, mission, **options) if stored is None else cls.resume(folder, image=path)
        session.autosave(folder)
        return session

    # -- what stands ---------------------------------------------------------------------------------------------

    @property
    def inputs(self) -> Inputs:
        """What kernels, header and catalog gave, and the bodies that the analyst described."""
        return self._history.seen_inputs

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
    def can_undo(self) -> bool:
        """Whether a step is there to take back."""
        return bool(self._history.standing)

    @property
    def can_redo(self) -> bool:
        """Whether an undone step is there to take again."""
        return bool(self._history.undone)

    @property
    def camera_from_j2000(self) -> FloatArray:
        """Best known attitude (3, 3): solved, else where the analyst put the field, else a priori."""
        return best_attitude(self.inputs, self.state)

    @property
    def is_without_sky(self) -> bool:
        """Whether no attitude is known at all, so that nothing in the picture has a right ascension."""
        return is_without_sky(self.inputs, self.state) and self.state.star_field is None

    @property
    def current_observables(self) -> tuple[Observable, ...]:
        """Observables of all centers found so far, without a step: what `result` and `save` give out."""
        return current_observables(self.context, self.inputs, self.state)

    @property
    def landmark_observables(self) -> tuple[Observable, ...]:
        """Every accepted landmark as the observable of a point."""
        if not self.state.landmarks:
            return ()
        return landmark_steps.landmark_observables(self.context, self.inputs, self.state)

    @property
    def folder(self) -> Path | None:
        """Where every step is saved; None without autosave."""
        return None if self._autosave is None else self._autosave.folder

    @property
    def is_on_disk(self) -> bool:
        """Whether it could be closed now and resumed without loss: every step is in its folder."""
        return self._autosave is not None and self._autosave.holds(self._history)

    def result(self) -> dict[str, Any]:
        """Return everything found so far as plain values, in the layout of ``result.json`` (`result.result_dict`)."""
        return result_dict(self.context, self.source, self.inputs, self.state)

    def to_json(self) -> str:
        """Return `result` as JSON text."""
        return json_text(self.result())

    def require(self, *needs: str) -> None:
        """Stop where a decision is still to be made (`state.open_decisions`), so that a notebook does not run past it.

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

    # -- steps back and forth ------------------------------------------------------------------------------------

    def undo(self) -> JournalEntry:
        """Take back the last step and return its journal entry; the journal keeps both (`History.undo`).

        Raises
        ------
        SessionError
            Nothing is left to undo.
        """
        with self.lock:
            undone = self._history.undo()
            self._save_and_notify()
        return undone

    def redo(self) -> JournalEntry:
        """Take the last undone step again and return its journal entry (`History.redo`).

        Raises
        ------
        SessionError
            Nothing was undone since the last step.
        """
        with self.lock:
            redone = self._history.redo()
            self._save_and_notify()
        return redone

    def note(self, text: str) -> None:
        """Keep a remark; it stands in the journal, in the result and in the decisions (`history.note`)."""
        if not text.strip():
            raise SessionError("an empty note says nothing; give its text.")
        self._step("note", {"text": text.strip()})

    # -- steps: stars --------------------------------------------------------------------------------------------

    def predict(self) -> StarPrediction:
        """Predict catalog stars around the a priori field; what was found before is dropped (`star_steps.predict`)."""
        self._step("predict", {})
        assert self.state.a_priori is not None
        return self.state.a_priori

    def find_stars(
        self,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
    ) -> None:
        """Identify the field (`star_field`) and fit the star centers (`star_measurement`): `star_steps.find_stars`.

        With a solved pointing the search is around it.  A field that is not identified for sure within the limits of the
        a priori pointing is searched farther out (see `Settings`), in a cone of the catalog that grows with it, and at last
        on the whole sky (`lost`).

        Parameters
        ----------
        initial : {"matched_filter", "cross_correlation"}
        final : {"least_squares", "psf_fit", "matched_filter", "cross_correlation"}
            ``psf_fit`` takes the camera's own PSF, such as one of ``opnav calibrate psf``.
        search_radius_px
            How far from its expected place a star may lie; default from the settings.
        """
        parameters = {"initial": initial, "final": final, "search_radius_px": search_radius_px}
        with self.lock:
            began = time.perf_counter()
            state = self._history.state_after_step("find_stars", parameters)
            if (state.star_field is None or not state.star_field.sure) and self._fetch_wide_stars():
                state = self._history.state_after_step("find_stars", parameters)
            if self._is_lost(state) and self._search_sky():
                state = self._history.state_after_step("find_stars", parameters)
            self._record("find_stars", parameters, state, cost_s=time.perf_counter() - began)

    def search_sky(self) -> str:
        """Search the whole sky for this picture's stars; where nothing is nearer, `find_stars` then begins there.

        Returns
        -------
        str
            What was found, in words.

        Raises
        ------
        SessionError, CatalogError
            The stars do not tell it, and why; or the catalog has not the whole sky.
        """
        with self.lock:
            found = asked_field(self.context, self.source, self.inputs, self._catalog)
            self._take_lost_field(found)
        return found.message

    def search_sky_where_lost(self) -> bool:
        """Search the whole sky where `find_stars` did not, for want of an index, and wait for that to be made.

        Returns
        -------
        bool
            Whether there is something new for `find_stars` to begin with; False where nothing was found, or no need.
        """
        with self.lock:
            return self._is_lost(self.state) and self._search_sky(patient=True)

    def refit_stars(
        self,
        ids: Sequence[str] | None = None,
        *,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
        template: str | None = None,
    ) -> None:
        """Fit some stars again at once, or all, without identifying the field again (`star_steps.refit_stars`).

        Parameters
        ----------
        ids
            Catalog ids; None: all.
        initial, final, search_radius_px
            As in `find_stars`.
        template
            The star whose image is the template of the matched filter; by default a well-exposed one.
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
        """Fit a catalog star where the analyst sees it, and accept it (`star_steps.place_star`).

        Parameters
        ----------
        star_id
            A predicted star, or any other of the catalog around the field.
        pixel_line : (float, float)
            Where it is seen; the fit looks within a few pixels.
        """
        place = [float(value) for value in pixel_line]
        if len(place) != PLACE_NUMBERS:
            raise SessionError(f"a place is (pixel, line), got {place}.")
        self._step("place_star", {"id": str(star_id), "place": place})

    def reject_stars(self, ids: Sequence[str], reason: str) -> None:
        """Reject stars by catalog id; the reason stands in journal and result (`state.decide_stars`)."""
        self._step("reject_stars", {"ids": _id_list(ids), "reason": reason}, reason)

    def accept_stars(self, ids: Sequence[str], reason: str = "") -> None:
        """Accept stars by catalog id, outranking any automatic rejection (`state.decide_stars`)."""
        self._step("accept_stars", {"ids": _id_list(ids), "reason": reason}, reason)

    def star_boxes(self, ids: Sequence[str] | None = None) -> tuple[StarBox, ...]:
        """Return what a person looks at to judge the stars: data, model, residual of each (`star_boxes.star_boxes`).

        Parameters
        ----------
        ids
            By default all stars expected on the detector, in the order of `state.a_priori`.
        """
        return star_boxes(self.context, self.inputs, self.state, None if ids is None else _id_list(ids))

    def known_stars(self) -> tuple[str, ...]:
        """Return the ids of all catalog stars at hand, predicted in the picture or not: `place_star` takes them."""
        return tuple(catalog_stars(self.inputs).id.tolist())

    # -- steps: the field and the pointing -----------------------------------------------------------------------

    def two_star_pointing(
        self, places: Sequence[Sequence[float]], ids: Sequence[str] | None = None, reason: str = ""
    ) -> None:
        """Solve shift and twist of the field from two stars that the analyst marks (`star_field.two_star_pointing`).

        Centers and pointing found before are dropped; go on with `find_stars`.

        Parameters
        ----------
        places : two (pixel, line)
            Marked places; each means the nearest detection, or itself where there is none.
        ids : two str, optional
            Catalog ids of the marked stars; without them they are looked for among the stars around the field, any
            twist.
        reason
            For the journal.

        Raises
        ------
        CenterfindingError
            The places do not fit the stars' separation.
        """
        marks = [[float(value) for value in place] for place in places]
        names = None if ids is None else [str(star) for star in ids]
        if len(marks) != 2 or (names is not None and len(set(names)) != 2):
            raise SessionError(f"two stars must be marked, got {len(marks)} places and ids {names}.")
        with self.lock:
            if names is None or unknown_star_ids(self.inputs, names):
                self._fetch_wide_stars()
            self._step("two_star_pointing", {"places": marks, "ids": names}, reason)

    def nudge(self, delta_pixel: float, delta_line: float, delta_twist_deg: float = 0.0) -> None:
        """Move the predicted field by hand (`star_field.nudge`); nudges add up, and `find_stars` then searches there.

        Centers and pointing found before are dropped.

        Parameters
        ----------
        delta_pixel, delta_line
            How far the field moves on the detector, px.
        delta_twist_deg
            How far it turns about the boresight, from +pixel toward +line.
        """
        parameters = {
            "delta_pixel": float(delta_pixel),
            "delta_line": float(delta_line),
            "delta_twist_deg": float(delta_twist_deg),
        }
        with self.lock:
            reach_px = nudge_reach_px(self.context, self.inputs, self.state, parameters)
            if reach_px > self.context.settings.max_shift_px:
                self._fetch_wide_stars()
            self._step("nudge", parameters)

    def repoint(
        self, model: str = "euler", *, a_priori: bool = False, reason: str = "", gives_way: bool = False
    ) -> None:
        """Solve the camera attitude from the stars in use (`pointing.repoint`); observables computed before follow.

        Parameters
        ----------
        model : {"euler", "image_plane"}
        a_priori
            Take the a priori attitude as a measurement too, with the camera's ``attitude_sigma``; where the field was
            found far from it, it does not count.
        reason
            For the journal.
        gives_way
            Others may take steps while it is solved; where one was taken, this one is not recorded.
        """
        step = self._step_unless_overtaken if gives_way else self._step
        step("repoint", {"model": model} | ({"a_priori": True} if a_priori else {}), reason)

    # -- steps: bodies and observables ---------------------------------------------------------------------------

    def solved_attitude(self) -> SolvedAttitude:
        """Return this picture's solved attitude for others to carry (`carry_pointing`); no step of the session.

        Raises
        ------
        SessionError
            The pointing is not solved for sure from stars, or nothing but the stars tells the attitude.
        """
        return solved_attitude(self.context, self.inputs, self.state)

    def carry_pointing(
        self, neighbors: Sequence[SolvedAttitude], motion: AttitudeMotion, reason: str = ""
    ) -> None:
        """Take the pointing from the stars of pictures taken shortly before or after (`pointing.carry_pointing`).

        What the a priori attitude is off by is theirs, and what may have changed since is in the covariance. Stars of
        this picture count with it, where its own pointing is solved and sure. Observables computed before follow.

        Parameters
        ----------
        neighbors
            As their sessions' `solved_attitude` says; their a priori attitudes come from the same source as this one's.
        motion
            How much the error of a priori attitudes may change between pictures.
        reason
            For the journal.

        Raises
        ------
        SessionError
            Neither kernels nor header tell this picture's attitude.
        PointingError
            No neighbor.
        """
        parameters = {
            "neighbors": [plain_values(asdict(n)) for n in neighbors],
            "motion": asdict(motion),
        }
        self._step("carry_pointing", parameters, reason)

    def add_target(self, name: str) -> None:
        """Expect a body or target star in the picture, in identification too (`body_steps.add_target`).

        Bodies found before are found again with its light and shadow.

        Parameters
        ----------
        name
            SPICE body name, or a star of the target list.
        """
        with self.lock:
            self._know_target(name)
            if name not in self.state.targets:
                self._step("add_target", {"name": name})

    def describe_body(
        self,
        name: str,
        center_px: Sequence[float],
        radius_px: float | None = None,
        *,
        phase_deg: float | None = None,
        sun_deg: float | None = None,
        lighting_sigma_deg: float = 5.0,
        radii_km: ArrayLike | None = None,
        range_km: float | None = None,
        north_deg: float | None = None,
        sub_observer_deg: Sequence[float] = (0.0, 0.0),
        reason: str = "",
    ) -> None:
        """Describe a body as it is seen in the picture, where no ephemeris knows it (`body_steps.describe_body`).

        It is then found and measured as any other; described again, it is found again. A body that kernels know stands
        where the description has it.

        Parameters
        ----------
        name
            Any.
        center_px : (float, float)
            (pixel, line), on the detector or off it.
        radius_px
            How large it looks; needed without `range_km`.
        phase_deg
            Angle Sun - body - camera, deg; default what the disk in the circle tells (`fit_lighting`).
        sun_deg
            Direction toward the Sun in the picture, deg from +pixel toward +line; default what the disk tells.
        lighting_sigma_deg
            How far the Sun may stand from there: what a center moves by is in its covariance.
        radii_km
            Three semi-axes, or the radius of a sphere; default those of the kernels.
        range_km
            From the camera to the body's center.
        north_deg
            Direction of the north pole in the picture, deg from +pixel toward +line (-90: up); default: not known.
        sub_observer_deg : (float, float)
            East longitude and latitude of the camera as seen from the body.

        Raises
        ------
        SessionError
            A value that cannot be, neither radius nor range, or radii that nobody knows.
        """
        parameters: dict[str, Any] = {
            "name": name,
            "center_px": [float(x) for x in center_px],
            "radius_px": radius_px,
            "range_km": range_km,
            "radii_km": _three_radii_km(name, radii_km),
            "phase_deg": phase_deg,
            "sun_deg": sun_deg,
            "lighting_sigma_deg": lighting_sigma_deg,
            "north_deg": north_deg,
            "sub_observer_deg": [float(x) for x in sub_observer_deg],
        }
        with self.lock:
            self._know_shape(name)
            self._step("describe_body", parameters, reason)

    def describe_again(self, name: str, *, reason: str = "", **changed: Any) -> None:
        """Describe a body again that was described; what else was said of it stays.

        Parameters
        ----------
        changed
            Arguments of `describe_body`: another circle, the Sun, the phase, the range.

        Raises
        ------
        SessionError
            It was not described, or what is said cannot be.
        """
        said = next(
            (
                e.parameters
                for e in reversed(self.standing)
                if e.step == "describe_body" and e.parameters["name"] == name
            ),
            None,
        )
        if said is None:
            raise SessionError(f"{name} was not described by hand; describe_body() does so.")
        self.describe_body(**dict(said) | changed, reason=reason)

    def skip_target(self, name: str, reason: str) -> None:
        """Leave a requested target out, and say why; the result then is ``partial`` (`body_steps.skip_target`)."""
        self._step("skip_target", {"name": name, "reason": reason}, reason)

    def predict_body(self, name: str) -> BodyPrediction:
        """Return where and how large a target is expected with the best known pointing; no step of the session."""
        with self.lock:
            self._know_target(name)
        target = body_steps.target_with_shape(self.context, self.inputs, name)
        return predict_body(target, self.inputs.observer, self.context.camera, self.camera_from_j2000)

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
        """Find a body's center with the method asked for, or the one that suits (`body_steps.find_body`).

        Parameters
        ----------
        name
            SPICE body name, or a star of the target list.
        method : {"auto", "disk", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"}
            ``auto`` takes what suits the body's size and what is known of its surface.
        search_radius_px
            How far from its expected place it may be; default from the predicted uncertainty and its size.
        circle : (pixel, line, radius), optional
            Where it is seen, for this search; default the analyst's circle (`set_circle`), else the predicted one.
        scans
            Numbers of the limb scans to use; default the analyst's choice (`choose_scans`), else automatic.
        solve_range
            Solve for the range (apparent size), too, where the method can.
        """
        parameters: dict[str, Any] = {"name": name, "method": method, "search_radius_px": search_radius_px}
        if circle is not None:
            parameters["circle"] = _circle_numbers(circle)
        if scans is not None:
            parameters["scans"] = [int(number) for number in scans]
        if solve_range:
            parameters["solve_range"] = True
        with self.lock:
            self._know_target(name)
            self._step("find_body", parameters | self._bodies_in_scene())

    def find_bodies(self, names: Sequence[str], method: str = "least_squares") -> None:
        """Find several bodies at once, with the correlation of their centers (`body_steps.find_bodies`).

        Parameters
        ----------
        names
            Two bodies or more.
        method : {"least_squares"}
        """
        if isinstance(names, str) or len(set(names)) < 2:
            raise SessionError(f"name two bodies or more, got {names!r}.")
        with self.lock:
            for name in names:
                self._know_target(name)
            parameters = {"names": [str(n) for n in names], "method": method}
            self._step("find_bodies", parameters | self._bodies_in_scene())

    def set_circle(self, name: str, center_px: Sequence[float], radius_px: float) -> None:
        """Say where a body is seen (pixel, line), on the detector or off it, and how large (`body_steps.set_circle`).

        Every method for extended bodies starts from there.
        """
        pixel, line, radius = _circle_numbers([*center_px, radius_px])
        with self.lock:
            self._know_target(name)
            self._step("set_circle", {"name": name, "center_px": [pixel, line], "radius_px": radius})

    def clear_circle(self, name: str) -> None:
        """Forget the circle of a body: the predicted one counts again (`body_steps.clear_circle`)."""
        if name not in self.state.circles:
            raise SessionError(f"{name} has no circle to clear; set_circle() gives it one.")
        self._step("clear_circle", {"name": name})

    def choose_scans(self, name: str, numbers: Sequence[int] | None, reason: str = "") -> None:
        """Choose the limb scans of a body by their numbers, None: automatic again (`body_steps.choose_scans`).

        A limb-scan center that stands is made anew; the reason stands in journal and decisions.
        """
        chosen = None if numbers is None else sorted({int(number) for number in numbers})
        with self.lock:
            self._know_target(name)
            self._step("choose_scans", {"name": name, "numbers": chosen, "reason": reason}, reason)

    def find_landmarks(
        self,
        name: str,
        maplets: str | Path | None = None,
        search_radius_px: float | None = None,
        position_sigma_km: float | None = None,
        *,
        lost: bool = False,
    ) -> None:
        """Find the landmarks of a body, and the camera's pose from them (`landmark_steps.find_body_landmarks`).

        Parameters
        ----------
        name
            SPICE body name.
        maplets
            File that ``opnav landmarks make`` wrote; default the mission's.
        search_radius_px
            How far from its prediction a landmark may lie; default from what attitude and position allow.
        position_sigma_km
            1 sigma of each axis of the spacecraft's place relative to the body: it sets how far is looked, and takes part in
            the pose. Default the body's own covariance, where one is known.
        lost
            Nobody knows where the body is: begin with its lit silhouette, which must be whole in the picture, in place of
            its believed position and of both options above.
        """
        with self.lock:
            self._know_target(name)
            path, digest = landmark_steps.maplets_file(self.context, name, maplets)
            parameters: dict[str, Any] = {"name": name, "maplets": str(path), "sha256": digest}
            if search_radius_px is not None:
                parameters["search_radius_px"] = float(search_radius_px)
            if position_sigma_km is not None:
                parameters["position_sigma_km"] = _sigma_km(position_sigma_km)
            if lost and (search_radius_px is not None or position_sigma_km is not None):
                raise SessionError(
                    "a lost body has no place to search about; give neither radius nor position sigma."
                )
            if lost:
                parameters["lost"] = True
            self._step("find_landmarks", parameters | self._bodies_in_scene())

    def reject_landmarks(self, name: str, ids: Sequence[str], reason: str) -> None:
        """Leave landmarks of a body out of its pose, and say why (`landmark_steps.reject_landmarks`)."""
        parameters = {"name": name, "ids": _id_list(ids), "reason": reason}
        self._step("reject_landmarks", parameters, reason)

    def accept_landmarks(self, name: str, ids: Sequence[str], reason: str = "") -> None:
        """Take measured landmarks of a body, whatever the others say (`landmark_steps.accept_landmarks`)."""
        parameters = {"name": name, "ids": _id_list(ids), "reason": reason}
        self._step("accept_landmarks", parameters, reason)

    def landmark_patches(self, name: str, ids: Sequence[str]) -> "tuple[LandmarkPatch, ...]":
        """Return patch, drawing and correlation of landmarks that were found (`landmark_steps.body_landmark_patches`)."""
        steps = [e for e in self.standing if e.step == "find_landmarks" and e.parameters["name"] == name]
        if not steps:
            raise SessionError(f"no landmarks of {name} were looked for yet: call find_landmarks() first.")
        return landmark_steps.body_landmark_patches(
            self.context, self.inputs, self.state, dict(steps[-1].parameters), ids
        )

    def compute_observables(self, reason: str = "") -> None:
        """Compute the observables of all bodies found so far (`pointing.observables`); they stand in `state`."""
        self._step("observables", {}, reason)

    def observables(self, reason: str = "") -> "QTable":
        """Compute the observables of all bodies found so far (`pointing.with_observables`); `reason` for the journal.

        Returns
        -------
        astropy.table.QTable
            One row a body and method, and one an accepted landmark: O, C, O-C, sigmas, partials, with units and
            descriptions.
        """
        self.compute_observables(reason)
        return observables_table(
            (*self.state.observables, *self.landmark_observables), (origin_of(self.context, self.source),)
        )

    # -- files ---------------------------------------------------------------------------------------------------

    def autosave(self, folder: str | Path | None) -> None:
        """From now on have every step on disk when its method returns (`autosave.start_autosave`); None: no longer.

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
                self._autosave = start_autosave(Path(folder), self._history, self._stored_values())

    def save(self, folder: str | Path) -> Path:
        """Write ``result.json``, ``observables.ecsv``, ``session.json`` into `folder`; return it (`storage.write_session`).

        Raises
        ------
        SessionError
            The folder cannot be written, or another process writes into it; older files in it are unchanged.

        Notes
        -----
        Another session in the folder that holds an analyst's decisions is put away, and `put_away` says where. After steps
        that took long the state is kept beside, so that `resume` need not take them again.
        """
        target = Path(folder)
        with self.lock:
            if self._autosave is not None and self.folder == target.resolve():
                self._write(target)
                self._autosave.start(self._history, len(self.journal), 0)
            else:
                with FolderLock(make_folder(target)):
                    self.put_away = storage.set_aside(target, self.id, self.standing)
                    self._write(target)
                    (target / JOURNAL_FILE).unlink(missing_ok=True)  # session.json holds the whole journal
                    if self._steps_s > SAVE_KEEPS_AFTER_S:
                        write_state(target, self.context.picture.sha256, self.standing, self.state)
        return target

    def _write(self, target: Path) -> None:
        observed = (*self.current_observables, *self.landmark_observables)
        storage.write_session(target, self.result(), observed, self._stored_values())

    def write_decisions(self, path: str | Path, who: str = "") -> Path:
        """Write the decisions of this session, made by `who`, as a file that headless runs carry out (`decisions`).

        Decisions on other pictures that the file holds stay there.  Its path is returned.

        Raises
        ------
        SessionError
            The file cannot be written, or what is there is no decisions file.
        """
        older = [load_decisions(path)] if exists(path) else []
        return write_decisions(path, [*older, Decisions.from_session(self, who)])

    def write_ck(self, path: str | Path, *, without_twist: bool = False) -> "reconstruction.Reconstruction":
        """Write the solved pointing as a CK (`reconstruction.write_reconstructed_ck`).

        A pointing whose stars did not determine the twist is written `without_twist` only: it keeps the a priori one.

        Raises
        ------
        SessionError, KernelError
            No pointing is solved yet; or LSK and SCLK are not open, or the file cannot be written.
        """
        results = [self.result()]
        return reconstruction.write_reconstructed_ck(
            results, path, self.context.mission, without_twist=without_twist
        )

    # -- how a step is taken -------------------------------------------------------------------------------------

    def _step(self, name: str, parameters: dict[str, Any], reason: str = "") -> None:
        """Carry out a step; one that fails leaves neither state nor entry."""
        with self.lock:
            began = time.perf_counter()
            state = self._history.state_after_step(name, parameters)
            self._record(name, parameters, state, reason, cost_s=time.perf_counter() - began)

    def _step_unless_overtaken(self, name: str, parameters: dict[str, Any], reason: str = "") -> None:
        """Carry out a step that keeps nobody from his; it is dropped where the state that it began with is gone."""
        before, began = self.state, time.perf_counter()
        state = self._history.state_after_step(name, parameters)
        with self.lock:
            if self.state is before:
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
        self._steps_s += cost_s
        self._save_and_notify(cost_s)

    def _save_and_notify(self, cost_s: float = 0.0) -> None:
        """Write the new entries down, then tell the listeners; a disk that is full does not keep it from them."""
        try:
            if self._autosave is not None:
                self._autosave.append_new(self._history, cost_s)
        finally:
            for listener in tuple(self._listeners):
                listener(self)

    def _stored_values(self) -> dict[str, Any]:
        return storage.session_dict(self.context, self.source, self._history.inputs, self.journal, self.id)

    # -- inputs that a step asks for -----------------------------------------------------------------------------

    def _know_target(self, name: str) -> None:
        if name not in self.state.assisted:
            self._history.inputs = input_values.with_target(
                self.context, self.source, self._history.inputs, name
            )

    def _know_shape(self, name: str) -> None:
        self._history.inputs = input_values.with_shape(
            self._history.inputs, name, self.source.shapes.get(name)
        )

    def _fetch_wide_stars(self) -> bool:
        """Fetch the stars that a wide search needs; False where there are none to fetch."""
        before = self._history.inputs
        with suppress(CatalogError):  # the catalog is not on this machine; what is not identified says so
            self._history.inputs = input_values.with_wide_stars(
                self.context, self.source, before, self._catalog
            )
        return self._history.inputs is not before

    def _is_lost(self, state: SessionState) -> bool:
        """Whether not even a proposal says where the field is."""
        return state.pointing is None and state.star_field is None

    def _search_sky(self, *, patient: bool = False) -> bool:
        """Search the whole sky for the picture, once; False where nothing is found that was not known."""
        if self.inputs.lost is not None:
            return False
        lost = lost_field(self.context, self.source, self.inputs, self._catalog, patient=patient)
        if lost is not None:
            self._take_lost_field(lost)
        return lost is not None

    def _take_lost_field(self, lost: LostField) -> None:
        self._history.inputs = input_values.with_lost_field(
            self.context, self.source, self._history.inputs, lost, self._catalog
        )

    def _bodies_in_scene(self) -> dict[str, Any]:
        """Name the mission's bodies that may hide, shade or outshine the one that is looked for."""
        self._history.inputs, names = input_values.with_scene(
            self.context, self.source, self._history.inputs, tuple(self.state.assisted)
        )
        return {"scene": names} if names else {}


def _sigma_km(value: float) -> float:
    """Return the sigma of a place; refuse what is none."""
    if not 0.0 < value < np.inf:
        raise SessionError(f"a position sigma of {value} km; give a number above zero.")
    return float(value)


def _id_list(ids: Sequence[str]) -> list[str]:
    # A single name is a sequence too, of letters; nobody means those.
    return [ids] if isinstance(ids, str) else [str(star) for star in ids]


def _three_radii_km(name: str, radii_km: ArrayLike | None) -> list[float]:
    """Return semi-axes as plain numbers: three, those of a sphere, or those that the kernels have."""
    if radii_km is None:
        try:
            radii_km = body_radii_km(name)
        except KernelError as error:
            raise SessionError(f"how large {name} is, nobody tells ({error}) Give radii_km.") from error
    radii = [float(radius) for radius in np.atleast_1d(np.asarray(radii_km, dtype=np.float64))]
    return 3 * radii if len(radii) == 1 else radii


def _circle_numbers(values: Sequence[float]) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != CIRCLE_NUMBERS:
        raise SessionError(f"a circle is (pixel, line, radius), got {numbers}.")
    return numbers
