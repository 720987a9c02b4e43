"""Shapes made from a seed, for tests and rehearsals, where no published shape may be copied.

A surface of small asteroids: an ellipsoid with a ridge along its equator, hills of every size, and boulders. Hills are
noise of octaves on lattices in space, each octave half as wide as the one before and turned at random, so that there is no
seam and no crowding at the poles. Boulders are caps whose number above a size falls with a power of it; the
default density and power are those counted on Bennu (DellaGiustina et al. 2019, doi:10.1038/s41550-019-0731-1: some 200
wider than 10 m, power -2.9).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import unit
from opnav_workbench.landmarks import ellipsoid_shape
from opnav_workbench.render import ShapeModel

__all__ = ["Terrain", "rough_shape"]

LATTICE = 48  # cells of a period: octaves repeat only along lines
RIDGE_WIDTH = 0.17  # of the equatorial ridge, sine of the latitude (1 sigma): 10 deg
MOST_BOULDERS = 40_000
LARGEST_BOULDER = 0.2  # of the mean radius
BOULDERS_COUNTED, COUNTED_SIZE = 200.0, 10.0 / 245.0  # on Bennu, size in its mean radii


@dataclass(frozen=True, slots=True)
class Terrain:
    """How rough a made surface is; lengths as parts of the mean radius.

    Attributes
    ----------
    hills
        Root mean square of all hills together.
    falloff
        Height of an octave over that of the one before, which is twice as wide.
    ridge
        Height of the ridge along the equator.
    boulders
        How many there are, over those of Bennu.
    boulder_power
        Of their number above a size.
    """

    hills: float = 0.02
    falloff: float = 0.5
    ridge: float = 0.04
    boulders: float = 1.0
    boulder_power: float = 2.9


def rough_shape(
    radii_km: FloatArray | list[float], step_km: float, seed: int, terrain: Terrain | None = None
) -> ShapeModel:
    """Return a shape whose plates are about a step wide.

    Parameters
    ----------
    radii_km : (3,) array_like
        Semi-axes of the ellipsoid that it roughens.
    seed
        The same seed gives the same surface, at whatever step.

    Raises
    ------
    MissionError
        Radii or step are not positive.

    Examples
    --------
    >>> shape = rough_shape([0.28, 0.27, 0.25], 0.02, 4)
    >>> bool(np.all(np.abs(shape.radii_km / [0.28, 0.27, 0.25] - 1.0) < 0.2))
    True
    """
    how = terrain or Terrain()
    plain = ellipsoid_shape(radii_km, step_km)
    directions = unit(plain.vertices_km)
    finest = step_km / float(np.mean(radii_km))
    height = _hills(directions, how, finest, seed)
    height += how.ridge * np.exp(-0.5 * (directions[:, 2] / RIDGE_WIDTH) ** 2)
    height += _boulders(directions, how, finest, seed)
    return ShapeModel(plain.vertices_km * (1.0 + height)[:, None], plain.plates)


def _hills(directions: FloatArray, how: Terrain, finest: float, seed: int) -> FloatArray:
    """Return noise (n,) of octaves from half of the body down to two plates."""
    out, square, weight = np.zeros(len(directions)), 0.0, 1.0
    for octave in range(1, 12):
        if 2.0**-octave < finest:
            break
        random = np.random.default_rng([seed, octave])
        grid = random.standard_normal((LATTICE,) * 3)
        turned = directions @ Rotation.random(random_state=random).as_matrix().T
        at = (2.0**octave * turned + random.uniform(0.0, LATTICE, 3)).T
        noise = ndimage.map_coordinates(grid, at, order=3, mode="grid-wrap", prefilter=False)
        out += weight * noise / float(noise.std())
        square += weight**2
        weight *= how.falloff
    return np.asarray(how.hills * out / np.sqrt(square)) if square > 0.0 else out


def _boulders(directions: FloatArray, how: Terrain, finest: float, seed: int) -> FloatArray:
    """Return the height of caps, the highest where they overlap."""
    out = np.zeros(len(directions))
    least = 2.0 * finest
    count = int(
        min(how.boulders * BOULDERS_COUNTED * (least / COUNTED_SIZE) ** -how.boulder_power, MOST_BOULDERS)
    )
    # Drawn from the largest down, so that a finer mesh has the same ones and smaller ones more.
    random = np.random.default_rng([seed, 1000])
    arrivals = np.cumsum(random.exponential(size=count)) / max(how.boulders * BOULDERS_COUNTED, 1e-9)
    wide = np.minimum(COUNTED_SIZE * arrivals ** (-1.0 / how.boulder_power), LARGEST_BOULDER)
    places, flat = unit(random.normal(size=(count, 3))), random.uniform(0.2, 0.6, count)
    tree = cKDTree(directions)
    for row in np.flatnonzero(wide > least):
        near = tree.query_ball_point(places[row], 0.5 * wide[row])
        away = np.sum((directions[near] - places[row]) ** 2, axis=1) / (0.5 * wide[row]) ** 2
        cap = flat[row] * wide[row] * np.sqrt(np.maximum(1.0 - away, 0.0))
        out[near] = np.maximum(out[near], cap)
    return out
