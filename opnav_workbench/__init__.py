"""opnav_workbench: optical navigation from spacecraft images.

Background stars give the camera's pointing, the pointing gives the direction of a target body, and that direction
goes to orbit determination with its covariance and partials.

    import opnav_workbench as opnav

    with opnav.KernelSet("approach.tm"):
        session = opnav.ImageSession.open("frame.fit", mission="new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO")
        table = session.observables()

Enter by `ImageSession` for one picture; what an analyst touches is in ``workbench``, what a shell calls in ``cli``.

``session``
    One picture, step by step, with its journal, its files and its undo.
``workbench``
    The workbench in JupyterLab.
``headless``
    What runs without a person: the automatic policy, nights of pictures, recorded decisions.
``cli``
    The ``opnav`` program.
``report``
    Figures and pages that a navigator shows.
``campaign``
    Many pictures: their archive, their trends and their stack.
``planning``
    What pictures will show, and which are worth taking.
``rehearsal``
    Simulated pictures whose truth is sealed, and the truth held beside the solution.
``simulation``
    What a flight camera would have sent.
``estimation``
    What many observables say of target and spacecraft; the B-plane; triangulation from stars.
``observables``
    O, C, O-C, covariances and partials of bodies' centers; their files.
``calibration``
    Optics, mounting and PSF of a camera from its own star frames.
``stars``
    Star centers, their identification, and the camera attitude from them.
``bodies``
    Centers of target bodies in a picture.
``render``
    Bodies as the camera sees them: light spread over pixels.
``scene``
    What the camera should see: predicted stars and bodies.
``image``
    Pictures read from files, with masks, time and header pointing; the sky's level and noise.
``camera``
    From directions to (pixel, line) and back, and what the camera makes of light.
``catalog``
    Star catalogs.
``targets``
    Targets as values: where a body is, how large, how turned, how lit.
``kernels``
    SPICE: kernels opened as a set or written; states, attitudes and times from them.
``photometry``
    From spectra and band passes to electrons and magnitudes.
``psf``
    Point spread functions.
``geometry``
    Directions, attitudes, aberration, space motion and conics; no state, no kernels.
``downloads``
    Files fetched over http and https, whole or not there.
``mission``
    A mission's spacecraft, cameras and header keywords.
``yaml_file``
    YAML files into validated models, with errors that name line and field.
``templating``
    HTML templates: one environment for each folder of them, everything escaped.
``files``
    Files written whole or not at all.
``processes``
    Many items on several processes, each of which opens what it needs once.
``resources``
    Where the package's own files and the user's cache stand.
``arrays``
    Read-only arrays inside frozen results.
``constants``
    Constants of nature, of the sky and of statistics, with their sources.
``errors``
    One root error, one leaf per thing that can be wrong.
``version``
    The package's version.
"""

from typing import TYPE_CHECKING, Any

from opnav_workbench.version import __version__

if TYPE_CHECKING:
    from opnav_workbench.camera import Camera
    from opnav_workbench.catalog import StarTable, open_catalog
    from opnav_workbench.errors import (
        CameraError,
        CatalogError,
        CenterfindingError,
        EstimationError,
        ImageError,
        KernelError,
        MissionError,
        OpNavError,
        PointingError,
        SelectionPending,
        SessionError,
    )
    from opnav_workbench.kernels import KernelSet
    from opnav_workbench.mission import Mission, load_mission
    from opnav_workbench.session import ImageSession, Settings

# Loaded on first use, so that a layer below may import the package's version without importing the layers above it.
_HOMES = {
    "Camera": "camera",
    "StarTable": "catalog",
    "open_catalog": "catalog",
    "Mission": "mission",
    "load_mission": "mission",
    "ImageSession": "session",
    "Settings": "session",
    "KernelSet": "kernels",
    "OpNavError": "errors",
    "KernelError": "errors",
    "CameraError": "errors",
    "CatalogError": "errors",
    "ImageError": "errors",
    "MissionError": "errors",
    "CenterfindingError": "errors",
    "EstimationError": "errors",
    "PointingError": "errors",
    "SelectionPending": "errors",
    "SessionError": "errors",
}

__all__ = [
    "Camera",
    "CameraError",
    "CatalogError",
    "CenterfindingError",
    "EstimationError",
    "ImageError",
    "ImageSession",
    "KernelError",
    "KernelSet",
    "Mission",
    "MissionError",
    "OpNavError",
    "PointingError",
    "SelectionPending",
    "SessionError",
    "Settings",
    "StarTable",
    "__version__",
    "load_mission",
    "open_catalog",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
