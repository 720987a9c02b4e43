"""Albedo maps made from a seed: mottled surfaces for tests and rehearsals, where no published map may be copied.

A random field on the sphere is the sum of many round patches: centers spread evenly over the sphere, widths
log-uniform between two sizes, weights normal; as wide patches overlap more than narrow ones, large regions differ more
than small ones, as on maps of Pluto. The field is then brought to an even spread of albedos between `dark` and `bright`
through its own normal distribution. The defaults give about the contrast of the maps that Buie et al. (2010, AJ 139,
1128, doi:10.1088/0004-6256/139/3/1128) made of Pluto. There is no seam at the edges of the map and no crowding at the
poles.
"""

import numpy as np
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import unit, unit_from_radec

__all__ = ["mottled_map"]

ROWS = 180  # one degree: far below the smallest patch


def mottled_map(
    seed: int,
    dark: float = 0.15,
    bright: float = 0.80,
    features: int = 300,
    smallest_deg: float = 4.0,
    largest_deg: float = 30.0,
    rows: int = ROWS,
) -> FloatArray:
    """Return albedos (rows, 2 rows) in equirectangular cells.

    Row 0 is the northernmost, column 0 the one east of longitude 0, and longitude grows eastward; values belong to the
    middles of cells.

    Parameters
    ----------
    seed : int
        The same seed gives the same map, bit for bit.
    dark, bright : float
        Limits of the albedo.
    features : int
        Number of patches.
    smallest_deg, largest_deg : float
        Their angular radii (1 sigma).
    rows : int

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
    field = _field(_cell_directions(rows), centers, width, weight)
    latitude = np.radians(_latitudes_deg(rows))
    share = np.cos(latitude)[:, None] / np.cos(latitude).sum() / field.shape[1]  # of the sphere's area
    mean = float((share * field).sum())
    spread = float(np.sqrt((share * (field - mean) ** 2).sum()))
    return np.asarray(dark + (bright - dark) * ndtr((field - mean) / spread))


def _field(
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
