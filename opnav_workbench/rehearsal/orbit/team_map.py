"""What a team in orbit gets of the surface: maplets and a shape, made of the true surface and not quite true.

What is finer than the scenario's detail is smoothed away, of the albedo the wide part is known, the whole is
stretched along the body's axes, and each landmark stands a little beside its place.
"""

from pathlib import Path

import numpy as np
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import MissionError
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.geometry import unit
from opnav_workbench.landmarks import Maplets, ellipsoid_shape, make_maplets
from opnav_workbench.rehearsal.case import OrtCase, perturbation_random
from opnav_workbench.rehearsal.pictures import picture_scenario
from opnav_workbench.rehearsal.scenario import OrbitTask, OrtScenario
from opnav_workbench.render import AlbedoMap, ShapeModel
from opnav_workbench.simulation.surfaces import Surface, surface_of

__all__ = ["maplets_name", "shape_name", "smoothed_shape", "write_team_map"]

KNOWN_ALBEDO_CELLS = 3.0  # of the true map: what is narrower is not in the team's
MOST_PASSES = 200
SHAPE_STEP = 2.0  # width of the team's plates over its detail: maplets have what is finer
NEIGHBORS = 3


def maplets_name(body: str) -> str:
    """Return the name of the file of maplets."""
    return f"{body.replace(' ', '_')}.maplets.npz"


def shape_name(body: str) -> str:
    """Return the name of the shape's file."""
    return f"{body.replace(' ', '_')}.obj"


def write_team_map(
    scenario: OrtScenario, orbit: OrbitTask, case: OrtCase, folder: Path
) -> dict[str, FloatArray]:
    """Write maplets and shape; return the landmarks' true places (3,) km, body-fixed, by name.

    Raises
    ------
    MissionError
        The scenario does not say what the body looks like.
    SessionError, KernelError
        The folder cannot be written.
    """
    surface = _true_surface(scenario, orbit, case)
    assert surface.shape is not None
    factors = np.exp(case.map_log)
    smooth = smoothed_shape(surface.shape, orbit.detail_km)
    believed = ShapeModel(smooth.vertices_km * factors, smooth.plates)
    known = None
    if isinstance(surface.albedo, AlbedoMap):
        mean = ndimage.gaussian_filter(surface.albedo.values, KNOWN_ALBEDO_CELLS, mode=("nearest", "wrap"))
        known = AlbedoMap(
            mean, surface.albedo.first_longitude_deg, surface.albedo.east_positive, surface.albedo.north_first
        )
    maplets = make_maplets(
        orbit.body.upper(), believed, orbit.spacing_km, scale_km=orbit.sample_km, samples=orbit.samples,
        albedo=known, sigma_km=orbit.place_sigma_km, source="the rehearsal's map",
    )  # fmt: skip
    true = maplets.place_km / factors
    moved = perturbation_random(case.seed, "landmark_places").normal(size=true.shape) * orbit.place_sigma_km
    make_folder(folder)
    _moved(maplets, moved).write(folder / maplets_name(orbit.body))
    rough = coarse_shape(believed, SHAPE_STEP * orbit.detail_km)
    _write_obj(folder / shape_name(orbit.body), rough)
    return dict(zip(maplets.id.tolist(), true, strict=True))


def _moved(maplets: Maplets, by_km: FloatArray) -> Maplets:
    return Maplets(
        maplets.body, maplets.id, maplets.place_km + by_km, maplets.axes, maplets.scale_km, maplets.heights_km,
        maplets.albedo, maplets.sigma_km, maplets.source,
    )  # fmt: skip


def _write_obj(path: Path, shape: ShapeModel) -> None:
    corners = (f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in shape.vertices_km.tolist())
    plates = (f"f {a} {b} {c}\n" for a, b, c in (shape.plates + 1).tolist())
    write_text(path, "".join(("# The team's shape, km\n", *corners, *plates)))


def _true_surface(scenario: OrtScenario, orbit: OrbitTask, case: OrtCase) -> Surface:
    drawn = picture_scenario(scenario, case)
    for i, body in enumerate(drawn.bodies):
        if body.name.upper() == orbit.body.upper() and (body.terrain is not None or body.shape is not None):
            return surface_of(body, drawn, ("bodies", i))
    raise MissionError(
        f"rehearsal scenario: bodies: give {orbit.body} a shape or terrain; landmarks in orbit need a surface."
    )


def coarse_shape(shape: ShapeModel, step_km: float) -> ShapeModel:
    """Return a shape as seen from its center, with plates about a step wide: enough to tell what hides and shades."""
    radius = np.linalg.norm(shape.vertices_km, axis=1)
    plain = ellipsoid_shape([float(radius.mean())] * 3, step_km)
    toward = unit(plain.vertices_km)
    away, near = cKDTree(shape.vertices_km / radius[:, None]).query(toward, k=NEIGHBORS)
    weight = 1.0 / np.maximum(away, 1e-9)
    mean = (weight * radius[near]).sum(axis=1) / weight.sum(axis=1)
    return ShapeModel(toward * mean[:, None], plain.plates)


def smoothed_shape(shape: ShapeModel, width_km: float) -> ShapeModel:
    """Return a shape whose corners stand at the mean of their neighbors, repeated until a width (1 sigma) is smoothed.

    Examples
    --------
    >>> from opnav_workbench.landmarks import ellipsoid_shape
    >>> ball = ellipsoid_shape([1.0, 1.0, 1.0], 0.1)
    >>> bool(np.abs(smoothed_shape(ball, 0.1).radii_km - 1.0).max() < 0.02)
    True
    """
    edges = np.concatenate([shape.plates[:, [0, 1]], shape.plates[:, [1, 2]], shape.plates[:, [2, 0]]])
    count = len(shape.vertices_km)
    ends = np.concatenate([edges, edges[:, ::-1]])
    near = sparse.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    near.data[:] = 1.0
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1.0)
    steps = shape.vertices_km[edges[:, 0]] - shape.vertices_km[edges[:, 1]]
    # A step to a neighbor's place moves by its length in a plane: half of its square along each of two axes.
    one_pass = 0.5 * float(np.mean(np.sum(steps**2, axis=1)))
    wanted = width_km**2 / one_pass
    passes = int(np.clip(np.ceil(wanted), 1, MOST_PASSES))
    share = min(wanted / passes, 1.0)  # of the way to the mean
    vertices = shape.vertices_km
    for _ in range(passes):
        vertices = (1.0 - share) * vertices + share * (near @ vertices) / degree[:, None]
    return ShapeModel(vertices, shape.plates)
