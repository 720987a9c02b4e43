"""An attitude carried from pictures with stars to one without: a pair's long exposure beside its short one.

Kernels or headers give every picture an attitude, a priori, and what it is off by hardly changes from one picture to the
next: it is the gyro's, the star tracker's or the prediction's error. The stars of neighbors measure it, and it is carried to
the picture's own time with what may have happened between. As a small rotation about the axes of J2000,

    d_i = error of the a priori attitude at t_i, as the stars found it  =  d + r (t_i - t) + w(t_i) - w(t) + j_i - j + e_i

    d   what is asked for, unknown                      r  drift, constant over the pictures: drift_rad_s
    w   random walk of the gyro: walk_rad per sqrt(s)   j  jitter, of every picture its own: jitter_rad
    e_i error of the stars' solution, its covariance

and d is the best linear estimate from all neighbors: before and after, near and far, each by what it is worth. Several
neighbors also tell whether they agree; where they do not, what they differ by goes into the covariance.

References: generalized least squares as in Aitken (1936), Proc. Roy. Soc. Edinburgh 55, 42; gyro noise as in Lefferts,
Markley & Shuster (1982), J. Guidance 5, 417, doi:10.2514/3.56190.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import pointing_angles, rotation_from_vector, vector_from_rotation
from opnav_workbench.stars.pointing.solution import PointingSolution, steps_between

__all__ = [
    "CARRIED",
    "AttitudeMotion",
    "CarriedAttitude",
    "SolvedAttitude",
    "carried_pointing",
    "carry_attitude",
    "moved_from",
]

CARRIED = "carried"  # the model of a pointing that rests on no star of its own picture
# Neighbors that chance alone makes differ so much once in a thousand times do not agree: their differences count in full.
LEAST_PROBABILITY = 1e-3
NAMED_NEIGHBORS = 3  # in a message


@dataclass(frozen=True, slots=True)
class AttitudeMotion:
    """How the error of a priori attitudes may change between pictures; 1 sigma about each axis.

    Attributes
    ----------
    jitter_rad
        Of every picture its own: what the a priori attitude does not follow at all.
    walk_rad
        Random walk, rad per square root of a second.
    drift_rad_s
        Constant rate, rad/s.
    """

    jitter_rad: float
    walk_rad: float = 0.0
    drift_rad_s: float = 0.0

    def __post_init__(self) -> None:
        values = np.array([self.jitter_rad, self.walk_rad, self.drift_rad_s])
        if not np.isfinite(values).all() or (values < 0.0).any() or not values.any():
            raise PointingError(
                f"attitude motion with jitter {self.jitter_rad:g} rad, walk {self.walk_rad:g} rad/sqrt(s) and drift "
                f"{self.drift_rad_s:g} rad/s; give sigmas of zero or more, at least one of them greater."
            )


@dataclass(frozen=True, slots=True, eq=False)
class SolvedAttitude:
    """An attitude solved from stars, and what was believed before; arrays are read-only.

    Attributes
    ----------
    image
        Name of the picture.
    et
        Mid-exposure, TDB seconds past J2000.
    camera_from_j2000, a_priori_camera_from_j2000 : (3, 3) arrays
    covariance_rad2 : (3, 3) array
        Of the solved one: small rotation vector about the camera frame's axes.
    """

    image: str
    et: float
    camera_from_j2000: FloatArray
    a_priori_camera_from_j2000: FloatArray
    covariance_rad2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def error_rad(self) -> FloatArray:
        """Return the rotation (3,) about J2000 axes that takes the a priori attitude to the solved one."""
        turned = vector_from_rotation(self.camera_from_j2000 @ self.a_priori_camera_from_j2000.T)
        return np.asarray(self.a_priori_camera_from_j2000.T @ turned)

    @property
    def error_covariance_rad2(self) -> FloatArray:
        """Return its covariance (3, 3) about J2000 axes."""
        axes = self.camera_from_j2000
        return symmetric(axes.T @ self.covariance_rad2 @ axes)


@dataclass(frozen=True, slots=True, eq=False)
class CarriedAttitude:
    """An attitude carried from neighbors; arrays are read-only.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
    covariance_rad2 : (3, 3) array
        About the camera frame's axes.
    images
        Neighbors, the nearest in time first.
    after_s
        How long after each of them the picture was taken.
    chi2, degrees_of_freedom
        How well the neighbors agree; 0 of a single one.
    """

    camera_from_j2000: FloatArray
    covariance_rad2: FloatArray
    images: tuple[str, ...]
    after_s: FloatArray
    chi2: float
    degrees_of_freedom: int

    def __post_init__(self) -> None:
        freeze_arrays(self)


def carry_attitude(
    a_priori_camera_from_j2000: ArrayLike,
    et: float,
    neighbors: Sequence[SolvedAttitude],
    motion: AttitudeMotion,
) -> CarriedAttitude:
    """Return the attitude of a picture from its neighbors' stars.

    Parameters
    ----------
    a_priori_camera_from_j2000 : (3, 3) array_like
        Of the picture, from the same source as the neighbors': kernels with kernels, header with header.
    et
        Of the picture.

    Raises
    ------
    PointingError
        No neighbor.

    Examples
    --------
    A long exposure ten seconds earlier found its attitude off by 40 microradians; the short one has it too.

    >>> turned = rotation_from_vector([0.0, 0.0, 4e-5])
    >>> pair = SolvedAttitude("long", 0.0, turned, np.eye(3), 1e-12 * np.eye(3))
    >>> carried = carry_attitude(np.eye(3), 10.0, [pair], AttitudeMotion(jitter_rad=2e-6))
    >>> print(vector_from_rotation(carried.camera_from_j2000).round(9), np.sqrt(carried.covariance_rad2[0, 0]).round(7))
    [0.e+00 0.e+00 4.e-05] 3e-06
    """
    if not neighbors:
        raise PointingError("no picture with stars to carry the pointing from; widen the time, or solve one.")
    ordered = sorted(neighbors, key=lambda n: (abs(n.et - et), n.image))
    axes = np.asarray(a_priori_camera_from_j2000, float)
    after_s = np.array([et - n.et for n in ordered])
    errors = np.concatenate([n.error_rad for n in ordered])
    covariance = _joint_covariance(ordered, -after_s, motion)
    all_axes = np.tile(np.eye(3), (len(ordered), 1))
    weighted = np.linalg.solve(covariance, np.column_stack([all_axes, errors]))
    spread = np.linalg.inv(all_axes.T @ weighted[:, :3])
    error = spread @ (all_axes.T @ weighted[:, 3])
    left = errors - all_axes @ error
    chi2, freedom = float(left @ np.linalg.solve(covariance, left)), 3 * (len(ordered) - 1)
    if freedom and chdtrc(freedom, chi2) < LEAST_PROBABILITY:
        apart = left.reshape(-1, 3)
        spread = spread * (chi2 / freedom) + apart.T @ apart / len(apart)
    found = rotation_from_vector(axes @ error) @ axes
    return CarriedAttitude(
        camera_from_j2000=found,
        covariance_rad2=symmetric(found @ spread @ found.T),
        images=tuple(n.image for n in ordered),
        after_s=after_s,
        chi2=chi2,
        degrees_of_freedom=freedom,
    )


def _joint_covariance(
    neighbors: Sequence[SolvedAttitude], later_s: FloatArray, motion: AttitudeMotion
) -> FloatArray:
    """Covariance (3 m, 3 m) of the neighbors' errors about the picture's: those of one side share their way to it."""
    same_side = np.outer(later_s, later_s) > 0.0
    shared_s = np.where(same_side, np.minimum.outer(np.abs(later_s), np.abs(later_s)), 0.0)
    times = (
        motion.walk_rad**2 * shared_s
        + motion.drift_rad_s**2 * np.outer(later_s, later_s)
        + motion.jitter_rad**2 * (1.0 + np.eye(len(later_s)))
    )
    covariance = np.asarray(np.kron(times, np.eye(3)), dtype=np.float64)
    for k, neighbor in enumerate(neighbors):
        block = slice(3 * k, 3 * k + 3)
        covariance[block, block] += neighbor.error_covariance_rad2
    return symmetric(covariance)


# ---- As a pointing of the picture.


def carried_pointing(
    carried: CarriedAttitude, camera: Camera, a_priori_camera_from_j2000: FloatArray, stars: int
) -> PointingSolution:
    """Return the pointing of a picture of whose stars (`stars` predicted ones) none is used."""
    attitude = carried.camera_from_j2000
    steps = steps_between(camera, (a_priori_camera_from_j2000, attitude))
    ra, dec, twist = pointing_angles(attitude, camera.focal_from_camera)
    about = float(np.sqrt(camera.boresight @ carried.covariance_rad2 @ camera.boresight))
    return PointingSolution(
        camera_from_j2000=attitude,
        covariance_rad2=carried.covariance_rad2,
        formal_covariance_rad2=carried.covariance_rad2,
        ra_rad=ra,
        dec_rad=dec,
        twist_rad=twist,
        delta_pixel=steps[0].delta_pixel,
        delta_line=steps[0].delta_line,
        delta_twist_rad=steps[0].delta_twist_rad,
        iterations=steps,
        rms_px=0.0,
        n_stars=0,
        used=np.zeros(stars, dtype=bool),
        reasons=("the pointing is carried from other pictures",) * stars,
        residual_px=np.full((stars, 2), np.nan),
        excess_sigma_px=0.0,
        chi2_reduced=carried.chi2 / carried.degrees_of_freedom
        if carried.degrees_of_freedom
        else float("nan"),
        model=CARRIED,
        twist_solved=about < float(camera.a_priori_sigma_rad[2]),
        messages=(carried_words(carried, camera),),
    )


def moved_from(
    solution: PointingSolution, camera: Camera, a_priori_camera_from_j2000: FloatArray, words: str
) -> PointingSolution:
    """Return a pointing solved from the picture's own stars about a carried one, told against the a priori attitude."""
    (step,) = steps_between(camera, (a_priori_camera_from_j2000, solution.camera_from_j2000))
    return replace(
        solution,
        delta_pixel=step.delta_pixel,
        delta_line=step.delta_line,
        delta_twist_rad=step.delta_twist_rad,
        iterations=(step,),
        messages=(words, *solution.messages),
    )


def carried_words(carried: CarriedAttitude, camera: Camera) -> str:
    """Say in one line from where a pointing is carried, and how well."""
    told = [
        f"{image} ({abs(after):.4g} s {'before' if after >= 0.0 else 'after'} it)"
        for image, after in zip(carried.images, carried.after_s, strict=True)
    ]
    others = len(told) - NAMED_NEIGHBORS
    named = ", ".join(told[:NAMED_NEIGHBORS]) + (f" and {others} more" if others > 0 else "")
    across = np.eye(3) - np.outer(camera.boresight, camera.boresight)
    sigma = np.sqrt(0.5 * np.trace(across @ carried.covariance_rad2)) / camera.pixel_scale_rad
    return f"the pointing is carried from the stars of {named}, to {sigma:.2g} px"
