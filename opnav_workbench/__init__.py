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
    from opnav_workbench.mission import Mission, load_mission
    from opnav_workbench.session import ImageSession, Settings
    from opnav_workbench.spice import KernelSet

# Loaded on first use, so that a layer below may import the package's version without importing the layers above it.
_HOMES = {
    "Camera": "camera",
    "StarTable": "catalog",
    "open_catalog": "catalog",
    "Mission": "mission",
    "load_mission": "mission",
    "ImageSession": "session",
    "Settings": "session",
    "KernelSet": "spice",
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
