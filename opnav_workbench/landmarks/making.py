"""Maplets made from a shape model or an ellipsoid, with an albedo map where there is one.

Places are spread over the surface by area, none nearer to another than the spacing. A maplet's plane is the mean of the
surface under it; heights are where lines across that plane first meet the surface from outside.

Frame  body-fixed
Units  km
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import unit
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.render import AlbedoMap, ShapeModel
from opnav_workbench.render.shape import MIRROR, NO_PLATE, parallel_view

__all__ = ["ellipsoid_shape", "make_maplets"]

DEFAULT_SAMPLES = 49
# Of a sample: what the shape itself is off by is the user's to say; scatter among landmarks shows in the pose's excess.
DEFAULT_SIGMA = 0.1
OVERLAP = 1.5  # width of a maplet over the spacing, where no scale is given
CANDIDATES = 12  # places tried for each that may find room: the spacing is filled to a few percent
MOST_MAPLETS = 200_000
MOST_SAMPLES = 60_000_000  # of all grids together: 1 GB in memory
FINEST = 5  # parts of a sample
LEAST_KNOWN = 0.9  # of a maplet's samples; else it hangs over an edge
CORNER = 1.7  # of half a maplet's width: its corners, and what lies below or above them
STEEPEST = 0.5  # cosine between a plate and a maplet's plane: what is steeper is another side of the body
SEED = 20131018


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """The plates of a shape, ready to be asked for those near a place."""

    shape: ShapeModel
    middle: FloatArray = field(repr=False)  # (m, 3)
    area: FloatArray = field(repr=False)  # (m,)
    reach: float  # from a plate's middle to its farthest corner, the largest
    side: float  # of a plate, typical
    tree: cKDTree

    @classmethod
    def of(cls, shape: ShapeModel) -> "_Ground":
        corners = shape.vertices_km[shape.plates]
        middle = corners.mean(axis=1)
        area = 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        reach = float(np.linalg.norm(corners - middle[:, None], axis=2).max())
        return cls(shape, middle, area, reach, float(np.sqrt(2.0 * np.median(area))), cKDTree(middle))

    def near(self, place: FloatArray, radius: float) -> IntArray:
        """Return the plates that may reach within a radius of a place."""
        return np.asarray(self.tree.query_ball_point(place, radius + self.reach), dtype=np.int64)


def make_maplets(
    body: str,
    shape: ShapeModel,
    spacing_km: float,
    *,
    scale_km: float | None = None,
    samples: int = DEFAULT_SAMPLES,
    albedo: AlbedoMap | None = None,
    sigma_km: float | None = None,
    source: str = "",
) -> Maplets:
    """Cover a body with maplets.

    Parameters
    ----------
    body
        SPICE name.
    shape
        Its surface; `ellipsoid_shape` makes one of radii.
    spacing_km
        Least distance between landmarks.
    scale_km
        Between samples; by default so that a maplet is 1.5 spacings wide. Best near the size of a pixel on the surface.
    samples
        Along a side, odd.
    albedo
        Without one the surface is uniform.
    sigma_km
        1 sigma of each coordinate of a place; by default a tenth of a sample.
    source
        For the record.

    Raises
    ------
    MissionError
        Numbers that make no maplets, or more than memory holds.

    Examples
    --------
    >>> maplets = make_maplets("BENNU", ellipsoid_shape([0.28, 0.27, 0.25], 0.01), 0.2, samples=9)
    >>> bool(len(maplets) > 10), maplets.heights_km.shape[1:]
    (True, (9, 9))
    """
    if not spacing_km > 0.0 or (scale_km is not None and not scale_km > 0.0):
        raise MissionError(f"spacing {spacing_km} km and scale {scale_km} km: give positive numbers.")
    if samples < 5 or samples % 2 == 0:
        raise MissionError(f"{samples} samples along a side: give an odd number of 5 or more.")
    scale = OVERLAP * spacing_km / (samples - 1) if scale_km is None else scale_km
    ground = _Ground.of(shape)
    places, normals = _spread(ground, spacing_km, samples)
    patches = [
        _patch(ground, place, normal, scale, samples) for place, normal in zip(places, normals, strict=True)
    ]
    kept = [patch for patch in patches if patch is not None]
    if not kept:
        raise MissionError(
            f"no maplet {scale * (samples - 1):.4g} km wide fits on {body}; give a smaller --spacing or --scale."
        )
    place, axes, heights = (np.array([patch[k] for patch in kept]) for k in range(3))
    grey = np.ones_like(heights)
    whole = Maplets(
        body,
        np.array(_names(place)),
        place,
        axes,
        np.full(len(kept), scale),
        heights,
        grey,
        np.full((len(kept), 3), DEFAULT_SIGMA * scale if sigma_km is None else sigma_km),
        source,
    )
    if albedo is None:
        return whole
    return _with_albedo(whole, albedo)


def _names(place: FloatArray) -> list[str]:
    """Return ids by longitude and latitude, the like told apart by a letter's number."""
    lon = np.degrees(np.arctan2(place[:, 1], place[:, 0])) % 360.0
    lat = np.degrees(np.arctan2(place[:, 2], np.hypot(place[:, 0], place[:, 1])))
    names: dict[str, int] = {}
    out = []
    for x, y in zip(lon, lat, strict=True):
        name = f"{'N' if y >= 0 else 'S'}{abs(y):04.1f}E{x:05.1f}"
        names[name] = names.get(name, 0) + 1
        out.append(name if names[name] == 1 else f"{name}-{names[name]}")
    return out


def _spread(ground: _Ground, spacing_km: float, samples: int) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 3) on the plates, none nearer to another than the spacing, and the plates' normals."""
    room = float(ground.area.sum()) / spacing_km**2
    if room > MOST_MAPLETS or room * samples**2 > MOST_SAMPLES:
        raise MissionError(
            f"a spacing of {spacing_km:.4g} km makes some {room:.0f} maplets of {samples} x {samples} samples; "
            "give a larger --spacing or fewer --samples."
        )
    random = np.random.default_rng(SEED)
    count = max(int(CANDIDATES * room), 100)
    plate = random.choice(len(ground.area), size=count, p=ground.area / ground.area.sum())
    u, v = random.random((2, count))
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    a, b, c = (ground.shape.vertices_km[ground.shape.plates[plate, k]] for k in range(3))
    places = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    free, kept = np.ones(count, dtype=bool), []
    tree = cKDTree(places)
    for row in range(count):
        if free[row]:
            kept.append(row)
            free[tree.query_ball_point(places[row], spacing_km)] = False
    return places[kept], ground.shape.normals[plate[kept]]


def _patch(
    ground: _Ground, place: FloatArray, normal: FloatArray, scale: float, samples: int
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return place, axes and heights of a maplet; None where the surface under it is not one sheet."""
    half = 0.5 * (samples - 1) * scale
    near = ground.near(place, CORNER * half)
    normals, area = ground.shape.normals[near], ground.area[near]
    same_side = normals @ normal > 0.0
    up = unit((normals[same_side] * area[same_side, None]).sum(axis=0))
    same_side = normals @ up > STEEPEST / 2.0
    axes = _local_axes(up)
    # Lines across the plane come from outside: of the plates under a place the outermost is the surface.
    used, back = np.unique(ground.shape.plates[near[same_side]], return_inverse=True)
    corners = ground.shape.vertices_km[used] - place
    view = parallel_view(corners, back.reshape(-1, 3), axes.T)
    fine = _odd(scale / ground.side)
    at = (np.arange(fine * samples) - 0.5 * (fine * samples - 1)) * scale / fine
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    plate, height = view.first_met(np.stack([x, y]) * MIRROR)
    height = np.where(plate == NO_PLATE, np.nan, height)
    heights = _sampled(height.reshape(fine * samples, fine * samples), fine)
    middle = heights[samples // 2, samples // 2]
    if not np.isfinite(middle) or np.isfinite(heights).mean() < LEAST_KNOWN:
        return None
    return place + middle * up, axes, heights - middle


def _sampled(height: FloatArray, fine: int) -> FloatArray:
    """Return the heights (m, m) of samples, of a grid `fine` times as fine; nan where part of a sample is not known.

    Between samples a maplet is read by cubic splines: these are the ones that lie nearest to the terrain. Heights met by
    chance would show relief that is not there; means over samples would flatten what two or three samples can tell.
    """
    if fine == 1:
        return height
    m = len(height) // fine
    known = np.isfinite(height)
    if not known.any():
        return np.full((m, m), np.nan)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    rows = _nearest_spline(m, fine)
    heights = rows @ height[tuple(nearest)] @ rows.T
    whole = known.reshape(m, fine, m, fine).all(axis=(1, 3))
    return np.where(whole, heights, np.nan)


@lru_cache(maxsize=8)
def _nearest_spline(m: int, fine: int) -> FloatArray:
    """Return what turns values on a grid `fine` times as fine into samples of the nearest spline (m, fine m)."""
    at = (np.arange(fine * m) - 0.5 * (fine - 1)) / fine
    return np.asarray(np.linalg.pinv(CubicSpline(np.arange(m), np.eye(m))(at)))


def _odd(ratio: float) -> int:
    """Return into how many parts a sample is divided, odd: as many as plates fit along it."""
    return int(np.clip(np.ceil(ratio) // 2 * 2 + 1, 1, FINEST)) if ratio > 1.0 else 1


def _local_axes(up: FloatArray) -> FloatArray:
    """Return east, north and up in rows; at the poles east is along +y."""
    east = np.cross([0.0, 0.0, 1.0], up)
    if np.linalg.norm(east) < 1e-6:
        east = np.array([0.0, 1.0, 0.0])
    east = unit(east - (east @ up) * up)
    return np.stack([east, np.cross(up, east), up])


def _with_albedo(maplets: Maplets, albedo: AlbedoMap) -> Maplets:
    """Return the maplets with the albedo of a map, whose cells are averaged to a sample where they are finer."""
    points = np.nan_to_num(maplets.points_km()).reshape(-1, 3).T
    radius = float(np.linalg.norm(maplets.place_km, axis=1).mean())
    seen = albedo.coarsened(float(maplets.scale_km.mean()) / radius)
    values = seen.sample_points(points).reshape(maplets.heights_km.shape)
    return Maplets(
        maplets.body, maplets.id, maplets.place_km, maplets.axes, maplets.scale_km, maplets.heights_km,
        values, maplets.sigma_km, maplets.source,
    )  # fmt: skip


MOST_STEPS = 1200  # of an ellipsoid's mesh between the poles: 3 million plates


def ellipsoid_shape(radii_km: FloatArray | list[float], step_km: float) -> ShapeModel:
    """Return an ellipsoid as plates whose sides are about a step long.

    Raises
    ------
    MissionError
        Radii or step are not positive.
    """
    radii = np.asarray(radii_km, dtype=np.float64)
    if radii.shape != (3,) or not np.all(radii > 0.0) or not step_km > 0.0:
        raise MissionError(
            f"an ellipsoid of radii {radii.tolist()} km in steps of {step_km} km: give positive numbers."
        )
    rows = int(np.clip(np.ceil(np.pi * radii.max() / step_km), 8, MOST_STEPS))
    columns = 2 * rows
    lat = np.pi * (np.arange(1, rows) / rows - 0.5)
    lon = 2.0 * np.pi * np.arange(columns) / columns
    ring = np.stack(
        [
            np.outer(np.cos(lat), np.cos(lon)),
            np.outer(np.cos(lat), np.sin(lon)),
            np.outer(np.sin(lat), np.ones(columns)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]]) * radii
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rows - 2), np.arange(columns), indexing="ij"))
    right = (j + 1) % columns
    a, b, c, d = i * columns + j, i * columns + right, (i + 1) * columns + right, (i + 1) * columns + j
    j = np.arange(columns)
    right, top, south = (j + 1) % columns, (rows - 2) * columns, (rows - 1) * columns
    caps = [np.stack([np.full(columns, south), right, j], axis=-1)]
    caps.append(np.stack([np.full(columns, south + 1), top + j, top + right], axis=-1))
    sides = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return ShapeModel(vertices, np.concatenate([*sides, *caps]))
