"""ImageSession: one picture, one analyst's (or one night's) way through it.

Every method is one step: a pure function makes a new frozen state, the journal gains an entry, and the older state
stays for `undo`.  Widgets, notebooks and the command line call these same methods.
"""

from pathlib import Path
from typing import Any

from opnav_workbench.catalog import Catalog
from opnav_workbench.files import json_text
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.session.body_methods import BodyMethods
from opnav_workbench.session.context import open_context
from opnav_workbench.session.file_methods import FileMethods
from opnav_workbench.session.gather import InputSource, gather
from opnav_workbench.session.result import result_dict
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.star_methods import StarMethods

__all__ = ["ImageSession"]


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
        return cls(context, source, gather(context, source, opened_catalog), opened_catalog)

    def result(self) -> dict[str, Any]:
        """Return everything found so far as plain values, in the layout of ``result.json``."""
        return result_dict(self.context, self.source, self.inputs, self.state)

    def to_json(self) -> str:
        """Return `result` as JSON text."""
        return json_text(self.result())
