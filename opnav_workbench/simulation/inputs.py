"""Everything one picture is made of, as values: from here on no kernels and no files are needed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel
from opnav_workbench.scene import Observer
from opnav_workbench.simulation.attitude_path import AttitudePath
from opnav_workbench.simulation.detector_values import Level
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario_parts import Switches

__all__ = ["PictureInputs"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PictureInputs:
    """What is true of one picture, and what its header will say.

    Attributes
    ----------
    name : str
        File name stem.
    camera : Camera
    et : float
        Mid-exposure, TDB s past J2000.
    exposure_s : float
    observer : Observer
        True barycentric state of the spacecraft.
    predicted_camera_from_j2000 : (3, 3) array
        What the header says.
    path : AttitudePath
        How the camera really stood during the exposure.
    stars : StarTable
        Catalog stars around the field.
    bodies : tuple of BodyModel
        True states of the bodies, and how they look.
    body_tracks_px : tuple of (k, 2) array or None
        For each body how it moves on the detector in equal parts of the exposure, from mid-exposure; None: as
        `path` moves the sky. Empty: that for all.
    psf : Psf
    effects : DetectorEffects
    switches : Switches
    level : {"calibrated", "raw"}
    dark_columns : int
        Covered columns that a raw picture has at its right end.
    seed : int
        Of this picture.
    header : mapping
        Further header cards.
    """

    name: str
    camera: Camera
    et: float
    exposure_s: float
    observer: Observer
    predicted_camera_from_j2000: FloatArray
    path: AttitudePath
    stars: StarTable
    psf: Psf
    bodies: tuple[BodyModel, ...] = ()
    body_tracks_px: tuple[FloatArray | None, ...] = ()
    effects: DetectorEffects = field(default_factory=DetectorEffects)
    switches: Switches = field(default_factory=Switches)
    level: Level = "calibrated"
    dark_columns: int = 0
    seed: int = 0
    header: Mapping[str, str | int | float] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        freeze_arrays(self)
