"""Where a spacecraft is, from the directions in which it sees stars whose places in space are known.

    e = T n / (n . u),   n = unit(s - x - d)          predicted minus measured direction, on the plane that touches the
                                                      sky at the measured direction u; T its east and north
    x: Gauss-Newton on e' W^-1 e,   W = C + H S H'    C directions, S places of the stars, H = de/ds

s is a star's place and d how far the spacecraft is from x when it sees it, for pictures taken one after the other. W
follows the solution, so that catalog errors are weighted as measured ones. The iteration starts from the position in
closed form, linear optimal sine triangulation (LOST):

    sum_i w_i (1 - u_i u_i') (s_i - x) = 0,   w_i = 1 / (sigma_i distance_i)^2

The distance, on which the weight depends, comes from the law of sines in the triangle of the spacecraft and two stars:
distance_i = |u_j x (s_i - s_j)| / |u_i x u_j|. With weights that are all one this is the midpoint between the lines of
sight.

Aberration must be gone from the directions: 10 arcsec at 14.5 km/s, which for the nearest star is 13 au. Directions
measured from catalog stars in the same picture nearly lose it by themselves, for it moves target and reference stars alike;
what is left over a field of 0.3 degrees is 0.05 arcsec. Other directions need the velocity, by `geometric_direction`.

Sources: Lauer et al. (2025), AJ 170, 22, doi:10.3847/1538-3881/addabe, section 3; Henry & Christian (2023), JGCD 46, 21,
doi:10.2514/1.G006989, equation 20 and section 5.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, readonly, symmetric
from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import radec_from_unit, tangent_basis, tangent_offset, unit, unit_from_radec

__all__ = ["Triangulation", "triangulate"]


# ---- What a triangulation is made of, checked and in one form.

NOT_UNIT = 1e-3  # a direction whose length differs by more is a position given by mistake
MIN_STARS = 2


@dataclass(frozen=True, slots=True, eq=False)
class StarSightings:
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


def checked_sightings(
    directions: ArrayLike,
    star_positions_km: ArrayLike,
    direction_covariance_rad2: ArrayLike,
    *,
    star_covariance_km2: ArrayLike | None = None,
    stars: ArrayLike | None = None,
    displacement_km: ArrayLike | None = None,
) -> StarSightings:
    """Check what `triangulate` is given, and bring it to one form.

    Raises
    ------
    EstimationError
        Shapes that do not fit, values that are not finite, a covariance that is not positive, or fewer than two stars.
    """
    lines = _unit_vectors(directions)
    n = len(lines)
    places = _finite_array("star_positions_km", star_positions_km, (None, 3))
    m = len(places)
    spread = np.zeros((m, 3, 3)) if star_covariance_km2 is None else star_covariance_km2
    moved = np.zeros((n, 3)) if displacement_km is None else displacement_km
    which = _star_numbers(stars, n, m)
    if len(np.unique(which)) < MIN_STARS:
        raise EstimationError(
            f"{n} directions to {len(np.unique(which))} star: a line, not a point; measure a second star, far from it on "
            "the sky."
        )
    return StarSightings(
        directions=lines,
        tangent=np.stack(tangent_basis(*radec_from_unit(lines)), axis=1),
        covariance_rad2=_direction_covariance(direction_covariance_rad2, n),
        star_positions_km=places,
        star_covariance_km2=_finite_array("star_covariance_km2", spread, (m, 3, 3)),
        stars=which,
        displacement_km=_finite_array("displacement_km", moved, (n, 3)),
    )


def _unit_vectors(directions: ArrayLike) -> FloatArray:
    given = np.asarray(directions, float)
    if given.ndim == 2 and given.shape[1] == 2:
        given = unit_from_radec(given[:, 0], given[:, 1])
    given = _finite_array("directions", given, (None, 3))
    length = np.linalg.norm(given, axis=1)
    if not (np.abs(length - 1.0) < NOT_UNIT).all():
        raise EstimationError(
            f"a direction has length {length[np.argmax(np.abs(length - 1.0))]:.6g}; give unit vectors, or RA and Dec in rad."
        )
    return unit(given)


def _star_numbers(stars: ArrayLike | None, n: int, m: int) -> IntArray:
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


def _direction_covariance(given: ArrayLike, n: int) -> FloatArray:
    """Return any of the accepted forms as one matrix (2 n, 2 n)."""
    values = np.asarray(given, float)
    if values.ndim == 0:
        values = values * np.eye(2 * n)
    elif values.shape == (2, 2):
        values = np.kron(np.eye(n), values)
    elif values.shape == (n, 2, 2):
        values = np.asarray(block_diag(*values))
    values = symmetric(_finite_array("direction_covariance_rad2", values, (2 * n, 2 * n)))
    if not np.linalg.eigvalsh(values)[0] > 0.0:
        raise EstimationError(
            "direction_covariance_rad2 is not positive definite; give each direction an error larger than zero."
        )
    return values


def _finite_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    try:
        array = readonly(values, shape, name)
    except ValueError as error:
        raise EstimationError(f"{error}.") from error
    if not np.isfinite(array).all():
        raise EstimationError(
            f"{name} holds values that are not finite; leave out stars that were not measured."
        )
    return array


# ---- A position from directions in closed form.

# Directions closer to parallel than this many of their sigmas do not cross anywhere in particular.
PARALLEL_SIGMAS = 5.0


def start_position(given: StarSightings) -> FloatArray:
    """Return the position (3,), km.

    Raises
    ------
    EstimationError
        All lines of sight are parallel within their errors.
    """
    u, s = given.directions, given.targets_km
    companion, sine = _widest_companions(given)
    distance = np.linalg.norm(np.cross(u[companion], s - s[companion]), axis=1) / sine
    weight = given.sigma_rad * np.maximum(distance, np.finfo(float).tiny)
    normal = dilution_matrix(u, weight)
    center = s.mean(axis=0)  # far from the barycenter the differences keep their digits
    projected = _across_projection(u) @ (s - center)[:, :, None]
    right = np.sum(projected[:, :, 0] / weight[:, None] ** 2, axis=0)
    return np.asarray(center + np.linalg.solve(normal, right))


def dilution_matrix(directions: FloatArray, distance_km: FloatArray) -> FloatArray:
    """Return the information (..., 3, 3) on a position in directions (..., n, 3) that are known to 1 rad."""
    return np.asarray(
        np.sum(_across_projection(directions) / np.asarray(distance_km)[..., None, None] ** 2, axis=-3)
    )


def _across_projection(directions: FloatArray) -> FloatArray:
    """Return the projections (..., 3, 3) onto the planes across directions (..., 3)."""
    return np.asarray(np.eye(3) - directions[..., :, None] * directions[..., None, :])


def _widest_companions(given: StarSightings) -> tuple[IntArray, FloatArray]:
    """Return for each direction the one that makes the largest angle with it, and the sine of that angle."""
    u = given.directions
    sines = np.linalg.norm(np.cross(u[:, None], u[None]), axis=2)
    widest = float(sines.max())
    least = PARALLEL_SIGMAS * float(given.sigma_rad.max())
    if not widest > least:
        raise EstimationError(
            f"the directions are parallel within {widest * ARCSEC_PER_RAD:.3g} arcsec, that is "
            f"{widest / least * PARALLEL_SIGMAS:.1f} sigmas; lines of sight must cross: take stars far apart on the sky, "
            "and not opposite."
        )
    companion = np.argmax(sines, axis=1)
    return companion, sines[np.arange(len(u)), companion]


# ---- Where a spacecraft is, from the directions in which it sees stars whose places in space are known.

MAX_ITERATIONS = 20
# A step below this share of sigma does not matter; each step is about |x| / distance of the last one, 1e-4 for stars.
CONVERGED_SIGMAS = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """A position fix; arrays are read-only.

    Attributes
    ----------
    position_km : (3,) array
        Spacecraft, in the frame and from the origin of the stars' places (J2000, solar-system barycenter).
    covariance_km2 : (3, 3) array
        From measurement and catalog errors.
    residual_rad : (n, 2) array
        Measured minus computed direction toward east and north.
    residual_covariance_rad2 : (2 n, 2 n) array
        Of the errors that the fix was weighted with: directions, and places of the stars.
    chi2
        Residuals squared, weighted with that covariance.
    degrees_of_freedom
        2 n - 3.
    distance_km : (n,) array
        To the stars.
    dilution_km_per_rad : (3,) array
        Semi-axes, largest first, of the error ellipsoid for directions that are all known to 1 rad an axis: what the
        geometry alone does to an error.
    start_km : (3,) array
        Closed-form position that the iteration started from.
    """

    position_km: FloatArray
    covariance_km2: FloatArray
    residual_rad: FloatArray
    residual_covariance_rad2: FloatArray
    chi2: float
    degrees_of_freedom: int
    distance_km: FloatArray
    dilution_km_per_rad: FloatArray
    start_km: FloatArray
    iterations: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sigma_km(self) -> FloatArray:
        """Return the standard deviations (3,) along x, y and z."""
        return np.asarray(np.sqrt(np.diag(self.covariance_km2)))

    @property
    def semi_axes_km(self) -> FloatArray:
        """Return the semi-axes (3,) of the one-sigma ellipsoid, largest first."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.covariance_km2)[::-1]))

    def sigmas_from(self, position_km: ArrayLike) -> float:
        """Return how far another position lies from this one, in the metric of the covariance.

        Three-dimensional: a sound fix lies within 1.88 of the truth in two cases of three, within 3.8 nearly always.
        """
        off = np.asarray(position_km, float) - self.position_km
        return float(np.sqrt(off @ np.linalg.solve(self.covariance_km2, off)))


def triangulate(
    directions: ArrayLike,
    star_positions_km: ArrayLike,
    direction_covariance_rad2: ArrayLike,
    *,
    star_covariance_km2: ArrayLike | None = None,
    stars: ArrayLike | None = None,
    displacement_km: ArrayLike | None = None,
) -> Triangulation:
    """Fix a spacecraft's position from measured directions to stars.

    Parameters
    ----------
    directions : (n, 3) or (n, 2) array_like
        Measured unit vectors, or right ascension and declination (rad), J2000, n >= 2; aberration removed.
    star_positions_km : (m, 3) array_like
        Places of the stars at the epoch, J2000, from the barycenter: see `star_positions`.
    direction_covariance_rad2 : float, (2, 2), (n, 2, 2) or (2 n, 2 n) array_like
        Of the directions toward east and north: one variance for all, one matrix for all or for each, or one with all
        correlations (rows east 0, north 0, east 1, ...).
    star_covariance_km2 : (m, 3, 3) array_like, optional
        Of the places; zero if left out.
    stars : (n,) array_like of int, optional
        Which star each direction belongs to, where one was measured several times; its catalog error is then shared.
        Left out: m = n, each direction its own star.
    displacement_km : (n, 3) array_like, optional
        Where the spacecraft was at each measurement, minus where it was at the epoch of the fix.

    Raises
    ------
    EstimationError
        Shapes that do not fit, fewer than two stars, directions that are parallel within their errors, or directions
        and places that do not belong together.

    References
    ----------
    Henry & Christian (2023), doi:10.2514/1.G006989 (start); Lauer et al. (2025), doi:10.3847/1538-3881/addabe.

    Examples
    --------
    Two stars at 1.3 and 2.4 parsecs, seen from 47 au with errors of 0.1 arcsec:

    >>> from opnav_workbench.constants import AU_KM
    >>> parsec, arcsec = 3.0857e13, 1.0 / ARCSEC_PER_RAD
    >>> stars = np.array([[1.3, 0.0, 0.0], [0.0, 2.4, 0.0]]) * parsec
    >>> truth = np.array([13.5, -42.0, -16.5]) * AU_KM
    >>> fix = triangulate(unit(stars - truth), stars, (0.1 * arcsec) ** 2)
    >>> print((fix.position_km / AU_KM).round(6), (fix.sigma_km / AU_KM).round(3))
    [ 13.5 -42.  -16.5] [0.24  0.13  0.114]
    """
    given = checked_sightings(
        directions,
        star_positions_km,
        direction_covariance_rad2,
        star_covariance_km2=star_covariance_km2,
        stars=stars,
        displacement_km=displacement_km,
    )
    start = position = start_position(given)
    for iteration in range(1, MAX_ITERATIONS + 1):
        fit = _LinearizedSightings.at(given, position)
        information = fit.jacobian.T @ np.linalg.solve(fit.weighing, fit.jacobian)
        covariance = symmetric(np.linalg.inv(information))
        step = -covariance @ fit.jacobian.T @ np.linalg.solve(fit.weighing, fit.offset)
        position = position + step
        if step @ information @ step < CONVERGED_SIGMAS**2:
            return _result(given, position, covariance, start, iteration)
    raise EstimationError(
        f"no position after {MAX_ITERATIONS} iterations; the last step was {np.linalg.norm(step):.3g} km. The directions "
        "do not belong to these stars, or the geometry is too weak."
    )


class _LinearizedSightings(NamedTuple):
    """Predicted minus measured directions about a position."""

    offset: FloatArray  # (2 n,)
    jacobian: FloatArray  # (2 n, 3) of the offset with respect to the position
    weighing: FloatArray  # (2 n, 2 n) covariance of the offset
    distance_km: FloatArray  # (n,)

    @classmethod
    def at(cls, given: StarSightings, position_km: FloatArray) -> "_LinearizedSightings":
        line = given.seen_from(position_km)
        depth = np.sum(line * given.directions, axis=1)
        _check_ahead(depth, given)
        offset, by_star = tangent_offset(line, given.directions, given.tangent)
        n = len(depth)
        return cls(
            offset.reshape(2 * n),
            -by_star.reshape(2 * n, 3),
            given.covariance_rad2 + _star_place_covariance(by_star, given.star_covariance_km2, given.stars),
            np.asarray(np.linalg.norm(line, axis=1)),
        )


def _star_place_covariance(by_star: FloatArray, covariance_km2: FloatArray, stars: IntArray) -> FloatArray:
    """Return the covariance (2 n, 2 n) of directions that comes from the stars' places; one star errs as one."""
    n = len(stars)
    same = (stars[:, None] == stars[None]).astype(float)
    blocks = np.einsum("iak,ikl,jbl,ij->iajb", by_star, covariance_km2[stars], by_star, same)
    return symmetric(blocks.reshape(2 * n, 2 * n))


def _check_ahead(depth_km: FloatArray, given: StarSightings) -> None:
    behind = np.flatnonzero(~(depth_km > 0.0))
    if behind.size:
        raise EstimationError(
            f"direction {behind[0]} points away from its star {given.stars[behind[0]]}; check the order of directions "
            "and stars, and that both are from the spacecraft in one frame."
        )


def _result(
    given: StarSightings, position: FloatArray, covariance: FloatArray, start: FloatArray, iterations: int
) -> Triangulation:
    fit = _LinearizedSightings.at(given, position)
    return Triangulation(
        position_km=position,
        covariance_km2=covariance,
        residual_rad=-fit.offset.reshape(-1, 2),
        residual_covariance_rad2=fit.weighing,
        chi2=float(fit.offset @ np.linalg.solve(fit.weighing, fit.offset)),
        degrees_of_freedom=len(fit.offset) - 3,
        distance_km=fit.distance_km,
        dilution_km_per_rad=np.sqrt(
            1.0 / np.linalg.eigvalsh(dilution_matrix(unit(given.seen_from(position)), fit.distance_km))
        ),
        start_km=start,
        iterations=iterations,
    )
