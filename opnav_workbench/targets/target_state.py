"""A target as the spacecraft sees it, with everything that predicting and measuring its picture needs.

Frame  J2000; the body-fixed frame enters through ``body_from_j2000`` only
Units  km, km/s, km^2, rad, mag
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.constants import ARCSEC_PER_RAD, AU_KM
from opnav_workbench.errors import CatalogError, KernelError
from opnav_workbench.geometry import (
    radec_from_unit,
    rotation_from_vector,
    tangent_basis,
    vector_from_rotation,
)

__all__ = ["MIN_PARALLAX_RAD", "TargetState", "star_target"]

# A star whose parallax is unknown or not positive is put at 1 Mpc (1 microarcsecond): its partials with respect
# to the spacecraft's position then vanish, as they should, and stay finite.
MIN_PARALLAX_RAD = 1e-6 / ARCSEC_PER_RAD
ROTATION_TOLERANCE = 1e-6  # a matrix this far from orthonormal turns a limb by less than a microradian
SYMMETRY_TOLERANCE = 1e-9  # relative; what is left of rounding when a covariance is propagated


@dataclass(frozen=True, slots=True, eq=False)
class TargetState:
    """A body, or a star used as a target, seen from the spacecraft at mid-exposure; arrays are read-only.

    Attributes
    ----------
    position_km : (3,) array
        From the spacecraft to where the body's center was when the light left, J2000, stellar aberration not applied.
    radii_km : (3,) array or None
        Semi-axes along the body's x, y, z; None for a star or a body of unknown size.
    body_from_j2000 : (3, 3) array or None
        Rotation to the body-fixed frame when the light left, ``v_body = body_from_j2000 @ v_j2000``.
    sun_position_km : (3,) array or None
        Body to Sun, J2000.
    covariance_km2 : (3, 3) array or None
        A priori covariance of `position_km`, J2000.
    magnitude
        Expected V magnitude.
    is_star
        True for a star used as a target.
    velocity_km_s : (3,) array or None
        With respect to the solar-system barycenter when the light left, J2000; what partials with solved light time
        need.
    course_s : (k,) array or None
        Times, s from mid-exposure, at which it is told how the body moves and turns while lines are exposed one after the
        other; ascending, four at least.
    course_km : (k, 3) array or None
        Where it is seen from the spacecraft of each of those times, light time applied, J2000, from `position_km`.
    course_turn_rad : (k, 3) array or None
        Rotation vectors, J2000, of how it has turned since `epoch_s`; None: as far as is known it does not turn.
    epoch_s
        Time, s from mid-exposure, for which place and orientation are given.

    Raises
    ------
    KernelError
        A field of the wrong shape or not finite, a body at the spacecraft, a negative radius, a matrix that does
        not rotate, a covariance that is none.

    Examples
    --------
    >>> TargetState("PLUTO", [0.0, 3e6, 4e6], radii_km=[1188.3, 1188.3, 1188.3]).range_km
    5000000.0
    """

    name: str
    position_km: FloatArray
    radii_km: FloatArray | None = None
    body_from_j2000: FloatArray | None = None
    sun_position_km: FloatArray | None = None
    covariance_km2: FloatArray | None = None
    magnitude: float | None = None
    is_star: bool = False
    velocity_km_s: FloatArray | None = None
    course_s: FloatArray | None = None
    course_km: FloatArray | None = None
    course_turn_rad: FloatArray | None = None
    epoch_s: float = 0.0

    def __post_init__(self) -> None:
        count = 0 if self.course_s is None else len(self.course_s)
        shapes: dict[str, tuple[int, ...]] = {
            "position_km": (3,),
            "radii_km": (3,),
            "body_from_j2000": (3, 3),
            "sun_position_km": (3,),
            "covariance_km2": (3, 3),
            "velocity_km_s": (3,),
            "course_s": (count,),
            "course_km": (count, 3),
            "course_turn_rad": (count, 3),
        }
        for field, shape in shapes.items():
            value = getattr(self, field)
            if value is not None:
                object.__setattr__(self, field, _finite(self.name, field, value, shape))
        self._check_values()
        freeze_arrays(self, in_file_order=True)

    def _check_values(self) -> None:
        if not self.name:
            raise KernelError("a target needs a name; give the body's SPICE name or the star's designation")
        if not self.range_km > 0.0:
            raise KernelError(
                f"{self.name} is at the spacecraft (range 0 km); choose another target or observer"
            )
        if self.radii_km is not None and np.any(self.radii_km < 0.0):
            raise KernelError(
                f"{self.name} has a negative radius, {self.radii_km.tolist()} km; check its PCK"
            )
        if self.body_from_j2000 is not None:
            _check_rotation(self.name, self.body_from_j2000)
        if self.covariance_km2 is not None:
            _check_covariance(self.name, self.covariance_km2)

    @property
    def range_km(self) -> float:
        """Distance from the spacecraft to the body's center."""
        return float(np.linalg.norm(self.position_km))

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,) toward the body, J2000, without stellar aberration."""
        return np.asarray(self.position_km / self.range_km)

    def standing_at(self, position_km: FloatArray) -> "TargetState":
        """Return the target at another place (3,) from the spacecraft, km, under the same Sun."""
        sun = self.sun_position_km
        moved = None if sun is None else sun + self.position_km - position_km
        return replace(self, position_km=position_km, sun_position_km=moved)

    def along_course(self, time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return place (n, 3), km, and turn since `epoch_s` (n, 3), rotation vectors in J2000, at times (n,) of the picture.

        Before and after the times of `course_s` it stays as it is at the first and the last of them.
        """
        if self.course_s is None or self.course_km is None:
            raise KernelError(
                f"{self.name}: nothing is known of its course; give kernels that cover the picture"
            )
        time = np.clip(np.asarray(time_s, dtype=np.float64), self.course_s[0], self.course_s[-1])
        places = self.position_km + scipy.interpolate.CubicSpline(self.course_s, self.course_km)(time)
        if self.course_turn_rad is None:
            return places, np.zeros_like(places)
        return places, scipy.interpolate.CubicSpline(self.course_s, self.course_turn_rad)(time)

    def at_time(self, time_s: float) -> "TargetState":
        """Return the target as it stands at a time, s from mid-exposure, by its course; itself where it has none."""
        if self.course_s is None or self.course_km is None or time_s == self.epoch_s:
            return self
        place, turned = (value[0] for value in self.along_course([time_s]))
        turn, attitude, turns = rotation_from_vector(turned), self.body_from_j2000, self.course_turn_rad
        if turns is not None:
            turns = vector_from_rotation(rotation_from_vector(turns) @ turn.T)
        return replace(
            self.standing_at(place),
            body_from_j2000=None if attitude is None else attitude @ turn.T,
            course_km=self.course_km - (place - self.position_km),
            course_turn_rad=turns,
            epoch_s=time_s,
        )


def star_target(
    name: str,
    direction: ArrayLike,
    parallax_rad: float,
    *,
    covariance_rad2: ArrayLike | None = None,
    magnitude: float | None = None,
) -> TargetState:
    """Return a star as a target: at the distance of its parallax, so that its partials are finite.

    Parameters
    ----------
    name
        The star's designation.
    direction : (3,) array_like
        Toward the star as seen from the spacecraft, J2000, of any length: space motion and parallax applied,
        stellar aberration not (`opnav_workbench.geometry.propagate` gives it).
    parallax_rad
        Annual parallax; unknown (nan), zero and negative ones count as `MIN_PARALLAX_RAD`.
    covariance_rad2 : (2, 2) array_like, optional
        Covariance of the direction toward east and north.

    Raises
    ------
    CatalogError
        The direction is zero or not finite, or the covariance is not (2, 2).

    Examples
    --------
    >>> star = star_target("Proxima Cen", [0.0, 0.0, 2.0], np.radians(0.7685 / 3600.0))
    >>> print(f"{star.range_km / 3.0857e13:.3f} pc")
    1.301 pc
    """
    vector = np.asarray(direction, float)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not (np.isfinite(length) and length > 0.0):
        raise CatalogError(
            f"{name}: direction {vector.tolist()} is none; give three finite numbers, not all zero"
        )
    unit = vector / length
    range_km = AU_KM / (parallax_rad if parallax_rad > MIN_PARALLAX_RAD else MIN_PARALLAX_RAD)
    return TargetState(
        name=name,
        position_km=unit * range_km,
        covariance_km2=None
        if covariance_rad2 is None
        else _sky_covariance(name, unit, range_km, covariance_rad2),
        magnitude=magnitude,
        is_star=True,
    )


def _sky_covariance(name: str, unit: FloatArray, range_km: float, covariance_rad2: ArrayLike) -> FloatArray:
    sky = np.asarray(covariance_rad2, float)
    if sky.shape != (2, 2):
        raise CatalogError(
            f"{name}: covariance of the direction has shape {sky.shape}, expected (2, 2) east, north"
        )
    tangent = np.stack(tangent_basis(*radec_from_unit(unit)), axis=-1) * range_km
    return symmetric(tangent @ sky @ tangent.T)


def _finite(name: str, field: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, float)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise KernelError(f"{name}: {field} is {array.tolist()}; expected {shape} finite numbers")
    return array


def _check_rotation(name: str, matrix: FloatArray) -> None:
    error = float(np.max(np.abs(matrix @ matrix.T - np.eye(3))))
    determinant = float(np.linalg.det(matrix))
    if error > ROTATION_TOLERANCE or determinant < 0.0:
        raise KernelError(
            f"{name}: body_from_j2000 is no rotation (off by {error:.3g}, determinant {determinant:.6g}); "
            "check the PCK or frame kernel"
        )


def _check_covariance(name: str, matrix: FloatArray) -> None:
    scale = float(np.max(np.abs(matrix)))
    lowest = float(np.linalg.eigvalsh(symmetric(matrix))[0])
    if np.max(np.abs(matrix - matrix.T)) > SYMMETRY_TOLERANCE * scale or lowest < -SYMMETRY_TOLERANCE * scale:
        raise KernelError(
            f"{name}: covariance_km2 is not symmetric or has a negative eigenvalue ({lowest:.3g} km^2); "
            "give a covariance matrix in J2000"
        )
