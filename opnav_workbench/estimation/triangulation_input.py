"""What a triangulation is made of, checked and in one form."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, readonly, symmetric
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import radec_from_unit, tangent_basis, unit, unit_from_radec

__all__ = ["Sightings", "sightings"]

NOT_UNIT = 1e-3  # a direction whose length differs by more is a position given by mistake
MIN_STARS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """n directions to m stars; arrays are read-only.

    Attributes
    ----------
    directions : (n, 3) array
        Measured unit vectors.
    tangent : (n, 2, 3) array
        East and north there.
    covariance_rad2 : (2 n, 2 n) array
    star_positions_km, star_covariance_km2 : (m, 3), (m, 3, 3) arrays
    stars : (n,) array of int
        Star of each direction.
    displacement_km : (n, 3) array
    """

    directions: FloatArray
    tangent: FloatArray
    covariance_rad2: FloatArray
    star_positions_km: FloatArray
    star_covariance_km2: FloatArray
    stars: IntArray
    displacement_km: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def targets_km(self) -> FloatArray:
        """Places (n, 3) that an observer at the epoch of the fix would see in the measured directions."""
        return np.asarray(self.star_positions_km[self.stars] - self.displacement_km)

    @property
    def sigma_rad(self) -> FloatArray:
        """Standard deviation (n,) of each direction, mean of both axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2).reshape(-1, 2).mean(axis=1)))

    def seen_from(self, position_km: FloatArray) -> FloatArray:
        """Return the vectors (n, 3), km, from the spacecraft to the stars."""
        return np.asarray(self.targets_km - position_km)


def sightings(
    directions: ArrayLike,
    star_positions_km: ArrayLike,
    direction_covariance_rad2: ArrayLike,
    *,
    star_covariance_km2: ArrayLike | None = None,
    stars: ArrayLike | None = None,
    displacement_km: ArrayLike | None = None,
) -> Sightings:
    """Check what `triangulate` is given, and bring it to one form.

    Raises
    ------
    EstimationError
        Shapes that do not fit, values that are not finite, a covariance that is not positive, or fewer than two stars.
    """
    lines = _unit_vectors(directions)
    n = len(lines)
    places = _array("star_positions_km", star_positions_km, (None, 3))
    m = len(places)
    spread = np.zeros((m, 3, 3)) if star_covariance_km2 is None else star_covariance_km2
    moved = np.zeros((n, 3)) if displacement_km is None else displacement_km
    which = _which(stars, n, m)
    if len(np.unique(which)) < MIN_STARS:
        raise EstimationError(
            f"{n} directions to {len(np.unique(which))} star: a line, not a point; measure a second star, far from it on "
            "the sky."
        )
    return Sightings(
        directions=lines,
        tangent=np.stack(tangent_basis(*radec_from_unit(lines)), axis=1),
        covariance_rad2=_covariance(direction_covariance_rad2, n),
        star_positions_km=places,
        star_covariance_km2=_array("star_covariance_km2", spread, (m, 3, 3)),
        stars=which,
        displacement_km=_array("displacement_km", moved, (n, 3)),
    )


def _unit_vectors(directions: ArrayLike) -> FloatArray:
    given = np.asarray(directions, float)
    if given.ndim == 2 and given.shape[1] == 2:
        given = unit_from_radec(given[:, 0], given[:, 1])
    given = _array("directions", given, (None, 3))
    length = np.linalg.norm(given, axis=1)
    if not (np.abs(length - 1.0) < NOT_UNIT).all():
        raise EstimationError(
            f"a direction has length {length[np.argmax(np.abs(length - 1.0))]:.6g}; give unit vectors, or RA and Dec in rad."
        )
    return unit(given)


def _which(stars: ArrayLike | None, n: int, m: int) -> IntArray:
    if stars is None:
        if n != m:
            raise EstimationError(
                f"{n} directions but {m} stars; say with `stars` which star each belongs to."
            )
        return np.arange(n)
    which = np.asarray(stars)
    if (
        which.shape != (n,)
        or which.dtype.kind not in "iu"
        or which.min(initial=0) < 0
        or which.max(initial=0) >= m
    ):
        raise EstimationError(
            f"`stars` must hold {n} numbers 0 to {m - 1}, one for each direction; got {which.tolist()}."
        )
    return which.astype(np.int64)


def _covariance(given: ArrayLike, n: int) -> FloatArray:
    """Return any of the accepted forms as one matrix (2 n, 2 n)."""
    values = np.asarray(given, float)
    if values.ndim == 0:
        values = values * np.eye(2 * n)
    elif values.shape == (2, 2):
        values = np.kron(np.eye(n), values)
    elif values.shape == (n, 2, 2):
        values = np.asarray(block_diag(*values))
    values = symmetric(_array("direction_covariance_rad2", values, (2 * n, 2 * n)))
    if not np.linalg.eigvalsh(values)[0] > 0.0:
        raise EstimationError(
            "direction_covariance_rad2 is not positive definite; give each direction an error larger than zero."
        )
    return values


def _array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    try:
        array = readonly(values, shape, name)
    except ValueError as error:
        raise EstimationError(f"{error}.") from error
    if not np.isfinite(array).all():
        raise EstimationError(
            f"{name} holds values that are not finite; leave out stars that were not measured."
        )
    return array
