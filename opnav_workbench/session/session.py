"""ImageSession: one picture, one analyst's (or one night's) way through it.

Every method is one step: a pure function makes a new frozen state, the journal gains an entry, and the older state
stays for `undo`.  Widgets, notebooks and the command line call these same methods.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from astropy.table import QTable

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import Catalog
from opnav_workbench.errors import CatalogError, SessionError
from opnav_workbench.files import json_text
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.observables import observables_table
from opnav_workbench.scene import StarPrediction
from opnav_workbench.session import steps_bodies, storage
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.gather import InputSource, gather, gather_target, gather_wide
from opnav_workbench.session.history import History
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.marking import unknown_stars
from opnav_workbench.session.reconstruction import Reconstruction, write_reconstructed_ck
from opnav_workbench.session.result import result_dict
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import Inputs, SessionState

__all__ = ["ImageSession"]


class ImageSession:
    """One picture and all that is done with it.

    Build it with `open` or `resume`.  Read `state`, `journal` and `result()` at any time.

    Examples
    --------
    ::

        with opnav.KernelSet("approach.tm"):
            s = opnav.ImageSession.open("lor_0299.fit", mission="new_horizons")
            s.predict()
            s.find_stars()
            s.repoint(model="euler")
            s.find_body("PLUTO", method="unresolved")
            s.observables()
            s.save("run/lor_0299")
    """

    def __init__(
        self, context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
    ) -> None:
        self._catalog = catalog
        self._context = context
        self._source = source
        self._inputs = inputs
        self._history = History(context)

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
        return cls(context, source, gather(context, source, opened_catalog), opened_catalog)

    # -- what stands -------------------------------------------------------------------------------------------

    @property
    def context(self) -> Context:
        """The picture, its camera, background and settings."""
        return self._context

    @property
    def inputs(self) -> Inputs:
        """What kernels, header and catalog gave."""
        return self._inputs

    @property
    def state(self) -> SessionState:
        """The present, immutable state."""
        return self._history.state

    @property
    def journal(self) -> tuple[JournalEntry, ...]:
        """All steps and decisions in order, undone ones and the undoing included."""
        return self._history.journal

    @property
    def camera_from_j2000(self) -> FloatArray:
        """Best known attitude (3, 3): solved, else a priori."""
        return steps_bodies.attitude(self._inputs, self.state)

    # -- steps -------------------------------------------------------------------------------------------------

    def predict(self) -> StarPrediction:
        """Predict catalog stars around the a priori field; drops what was found before."""
        self._step("predict", {})
        assert self.state.a_priori is not None
        return self.state.a_priori

    def add_target(self, name: str) -> None:
        """Take a body or target star into the predicted scene, so that identification expects it there.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.

        Raises
        ------
        KernelError
            Neither kernels nor the star list know it.
        """
        self._gather_target(name)
        if name not in self.state.targets:
            self._step("add_target", {"name": name})

    def _gather_target(self, name: str) -> None:
        if name not in self._inputs.targets:
            self._inputs = gather_target(self._context, self._source, self._inputs, name)

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
        state = self._history.tried(self._inputs, "find_stars", parameters)
        if (state.star_field is None or not state.star_field.sure) and self._widen():
            state = self._history.tried(self._inputs, "find_stars", parameters)
        self._history.record("find_stars", parameters, state)

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
        if names is None or unknown_stars(self._inputs, names):
            self._widen()
        self._step("two_star_pointing", {"places": marks, "ids": names}, reason)

    def _widen(self) -> bool:
        """Fetch the stars that a wide search needs; False where there are none to fetch."""
        if self._inputs.wide_stars is not None or not self._context.settings.wide_searches:
            return False
        try:
            self._inputs = gather_wide(self._context, self._source, self._inputs, self._catalog)
        except CatalogError:
            return False  # the catalog is not on this machine; what is not identified says so
        return True

    def reject_stars(self, ids: Sequence[str], reason: str) -> None:
        """Reject stars by catalog id; the reason stands in the journal and in the result.

        Raises
        ------
        SessionError
            No stars are predicted yet, or there is no star of that id.
        """
        self._decide("reject_stars", ids, reason)

    def accept_stars(self, ids: Sequence[str], reason: str = "") -> None:
        """Accept stars by catalog id, outranking any automatic rejection; raises as `reject_stars`."""
        self._decide("accept_stars", ids, reason)

    def _decide(self, step: str, ids: Sequence[str], reason: str) -> None:
        # A single name is a sequence too, of letters; nobody means those.
        names = [ids] if isinstance(ids, str) else [str(star) for star in ids]
        self._step(step, {"ids": names, "reason": reason}, reason)

    def repoint(self, model: str = "euler", *, a_priori: bool = False) -> None:
        """Solve the camera attitude from the stars in use.

        Parameters
        ----------
        model : {"euler", "image_plane"}
        a_priori : bool
            Take the a priori attitude as a measurement too, with the camera's ``attitude_sigma``; where the field was
            found far from it, it does not count.
        """
        self._step("repoint", {"model": model} | ({"a_priori": True} if a_priori else {}))

    def find_body(self, name: str, method: str = "unresolved", search_radius_px: float | None = None) -> None:
        """Find a body's center.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.
        method : {"unresolved"}
        search_radius_px : float, optional
            Default from the predicted uncertainty.
        """
        self._gather_target(name)
        parameters = {"name": name, "method": method, "search_radius_px": search_radius_px}
        self._step("find_body", parameters)

    def skip_target(self, name: str, reason: str) -> None:
        """Record that a requested target is left out, and why; the result's status then is ``partial``."""
        self._step("skip_target", {"name": name, "reason": reason}, reason)

    def observables(self) -> QTable:
        """Compute the observables of all bodies found so far.

        Returns
        -------
        astropy.table.QTable
            One row a body and method: O, C, O-C, sigmas, partials, with units and descriptions.
        """
        self._step("observables", {})
        return observables_table(self.state.observables)

    def undo(self) -> JournalEntry:
        """Take back the last step and return its journal entry; the journal keeps both.

        Raises
        ------
        SessionError
            Nothing is left to undo.
        """
        return self._history.undo()

    def _step(self, name: str, parameters: dict[str, Any], reason: str = "") -> None:
        self._history.take(self._inputs, name, parameters, reason)

    # -- files -------------------------------------------------------------------------------------------------

    def result(self) -> dict[str, Any]:
        """Return everything found so far as plain values, in the layout of ``result.json``."""
        return result_dict(self._context, self._source, self._inputs, self.state)

    def save(self, folder: str | Path) -> Path:
        """Write ``result.json``, ``observables.ecsv`` and ``session.json`` into `folder`, and return it.

        Raises
        ------
        SessionError
            The folder cannot be written; older files in it are unchanged.
        """
        saved = storage.session_dict(self._context, self._source, self._inputs, self._history.journal)
        return storage.write_session(folder, self.result(), self.state.observables, saved)

    def write_ck(self, path: str | Path, *, without_twist: bool = False) -> Reconstruction:
        """Write the solved pointing as a CK; see `opnav_workbench.session.reconstruction`.

        Raises
        ------
        SessionError, KernelError
            No pointing is solved yet; or LSK and SCLK are not open.
        """
        return write_reconstructed_ck(
            [self.result()], path, self._context.mission, without_twist=without_twist
        )

    @classmethod
    def resume(cls, folder: str | Path, image: str | Path | None = None) -> "ImageSession":
        """Continue a saved session: the journal's steps are replayed on the picture; kernels are not needed.

        Parameters
        ----------
        folder : path that `save` wrote
        image : path, optional
            Where the picture is now, if it has moved.

        Raises
        ------
        SessionError
            No readable ``session.json``, or the picture is missing or another one (SHA-256 differs).
        """
        saved = storage.load_session(Path(folder) / storage.SESSION_FILE, image)
        session = cls(saved.context, saved.source, saved.inputs)
        session._history.replay(saved.inputs, saved.journal, storage.SESSION_FILE)
        return session

    def to_json(self) -> str:
        """Return `result` as JSON text."""
        return json_text(self.result())
