"""Predicted and true state: what header, kernels and catalog say, and how camera, spacecraft, bodies, stars really are.

The kernels that the navigator has are wrong by a known amount. An offset of a barycenter moves everything that
belongs to it. Light then takes longer or shorter, and the body is seen where it was at that other time.
"""

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable, unknown_motion_mixture
from opnav_workbench.constants import (
    LAST_BARYCENTER_ID,
    SOLAR_SYSTEM_BARYCENTER_ID,
    SPEED_OF_LIGHT_KM_S,
    SUN_ID,
)
from opnav_workbench.geometry import (
    camera_from_j2000,
    matrix_from_quaternion,
    pointing_angles,
    rotation_from_vector,
    unit,
    unit_from_radec,
)
from opnav_workbench.geometry.aiming import aim
from opnav_workbench.kernels import KernelSet, body_id, camera_attitude, state
from opnav_workbench.scene import Observer, body_target, observer_from_kernels
from opnav_workbench.simulation.randomness import picture_random, seed_of_name
from opnav_workbench.simulation.scenario import ActualAttitude, BodyOffset, Perturbations, PredictedAttitude
from opnav_workbench.simulation.scenario_file import path_beside
from opnav_workbench.targets import TargetState

__all__ = [
    "flown_kernels",
    "predicted_attitude",
    "true_attitude",
    "true_observer",
    "true_stars",
    "true_target",
]


# ---- Predicted and true attitude of a picture: what the header says, and how the camera really stood.


def predicted_attitude(plan: PredictedAttitude, camera: Camera, et: float) -> FloatArray:
    """Return ``camera_from_j2000`` (3, 3) as the header will have it.

    Raises
    ------
    KernelError
        The plan takes it from the kernels, and they have no CK for the camera then.
    """
    if plan.quaternion_camera_from_j2000 is not None:
        return matrix_from_quaternion(plan.quaternion_camera_from_j2000)
    if plan.ra_deg is not None and plan.dec_deg is not None:
        ra, dec, twist = (math.radians(a) for a in (plan.ra_deg, plan.dec_deg, plan.twist_deg))
        return camera_from_j2000(ra, dec, twist, camera.focal_from_camera)
    return camera_attitude(camera.frame, et)


def true_attitude(
    plan: ActualAttitude, predicted: FloatArray, camera: Camera, et: float, seed: int, folder: Path
) -> FloatArray:
    """Return ``camera_from_j2000`` (3, 3) as the camera really stands at mid-exposure.

    Parameters
    ----------
    predicted : (3, 3) array
    seed
        Of the picture.
    folder
        Where relative paths of kernels count from.

    Raises
    ------
    KernelError
        The plan takes it from other kernels, and they do not have it.
    """
    if plan.source == "random":
        return misaligned_attitude(predicted, camera, picture_random(seed, "attitude_error"))
    if plan.source == "error":
        return shifted_attitude(predicted, camera, plan.shift_px, plan.twist_deg)
    if plan.source == "kernels":
        with flown_kernels(plan, folder):
            return camera_attitude(camera.frame, et)
    return predicted


def flown_kernels(plan: ActualAttitude, folder: Path) -> AbstractContextManager[object]:
    """Return a context in which the kernels of the attitude as flown are open; nothing where the plan names none."""
    return nullcontext() if plan.kernels is None else KernelSet(path_beside(plan.kernels, folder))


def misaligned_attitude(predicted: FloatArray, camera: Camera, rng: np.random.Generator) -> FloatArray:
    """Turn an attitude by a random error about the pixel, line and boresight axes, of the camera's a priori size."""
    error = rng.normal(0.0, camera.a_priori_sigma_rad)
    return rotation_from_vector(camera.focal_from_camera.T @ error) @ predicted


def shifted_attitude(
    predicted: FloatArray, camera: Camera, shift_px: tuple[float, float], twist_deg: float
) -> FloatArray:
    """Move the boresight's sky on the detector, and add to the twist; see `delta_pixel, delta_line, delta_twist`."""
    ra, dec, twist = pointing_angles(predicted, camera.focal_from_camera)
    pixel, line = (shift * camera.pixel_scale_rad for shift in shift_px)
    turned = twist + math.radians(twist_deg)
    return aim(unit_from_radec(ra, dec), turned, camera.focal_from_camera, (pixel, line))


# ---- Where spacecraft and bodies truly are.

SYSTEM_SIZE = 100  # NAIF: 901..999 belong to barycenter 9


def true_observer(spacecraft: int, et: float, truth: Perturbations) -> Observer:
    """Return the spacecraft's true barycentric state.

    Raises
    ------
    KernelError
        The active kernels do not cover the spacecraft.
    """
    known = observer_from_kernels(spacecraft, et)
    offset = truth.spacecraft
    return replace(
        known,
        position_km=known.position_km + np.array(offset.position_km),
        velocity_km_s=known.velocity_km_s + np.array(offset.velocity_km_s),
    )


def true_target(name: str, spacecraft: int, et: float, truth: Perturbations) -> TargetState:
    """Return a body's true state as the spacecraft truly sees it: where its light left it.

    Raises
    ------
    KernelError
        A body is unknown or not covered by the active kernels.
    """
    known = _turned(body_target(name, spacecraft, et), truth.bodies)
    body = body_offset_km(name, et, truth.bodies)
    moved = known.position_km + body - np.array(truth.spacecraft.position_km)
    if not (body.any() or any(truth.spacecraft.position_km)):
        return known
    later_s = (np.linalg.norm(moved) - known.range_km) / SPEED_OF_LIGHT_KM_S
    moved = moved - later_s * state(name, et, SOLAR_SYSTEM_BARYCENTER_ID).velocity_km_s
    sun = None if known.sun_position_km is None else known.sun_position_km - body
    return replace(known, position_km=moved, sun_position_km=sun)


def _turned(target: TargetState, offsets: tuple[BodyOffset, ...]) -> TargetState:
    """Return a body as it is truly oriented."""
    if target.body_from_j2000 is None:
        return target
    turn = target.body_from_j2000
    for offset in offsets:
        if any(offset.turned_rad) and body_id(offset.name) == body_id(target.name):
            turn = rotation_from_vector(np.array(offset.turned_rad)) @ turn
    return target if turn is target.body_from_j2000 else replace(target, body_from_j2000=turn)


def body_offset_km(name: str, et: float, offsets: tuple[BodyOffset, ...]) -> FloatArray:
    """Return the sum (3,) of all offsets that move a body, J2000."""
    number = body_id(name)
    moving = [offset for offset in offsets if _moves(body_id(offset.name), number)]
    return np.asarray(np.sum([np.zeros(3), *(_vector_km(offset, et) for offset in moving)], axis=0))


def _moves(moved: int, body: int) -> bool:
    return moved == body or (0 < moved <= LAST_BARYCENTER_ID and body // SYSTEM_SIZE == moved)


def _vector_km(offset: BodyOffset, et: float) -> FloatArray:
    along_sun = np.zeros(3)
    if offset.toward_sun_km:
        along_sun = offset.toward_sun_km * unit(state(SUN_ID, et, offset.name).position_km)
    return np.asarray(np.array(offset.offset_km) + along_sun)


def true_stars(stars: StarTable, seed: int) -> StarTable:
    """Return stars as they may truly be: off by what their catalog leaves open, the same way in every picture.

    Parameters
    ----------
    stars
        As the catalog has them; sigmas are kept.
    seed
        Not negative. Each star's errors follow from it and its designation: Gaussian by its covariance, an unknown motion by
        `unknown_motion_mixture`.
    """
    if not len(stars):
        return stars
    draws = np.array(
        [np.random.default_rng([seed, seed_of_name(name)]).standard_normal(6) for name in stars.id.tolist()]
    )
    values, vectors = np.linalg.eigh(stars.covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(vectors, 1, 2)
    off = (root @ draws[:, :5, None])[..., 0]
    shares, sigmas = unknown_motion_mixture(stars.ra_rad, stars.dec_rad, stars.mag)
    part = (np.cumsum(shares, axis=1) < ndtr(draws[:, 5:])).sum(axis=1).clip(max=shares.shape[1] - 1)
    unknown = np.take_along_axis(sigmas, part[:, None], axis=1) * draws[:, 3:5]
    motion = np.where(stars.motion_known[:, None], off[:, 3:], unknown)
    return replace(
        stars.take(slice(None)),  # a table whose columns are built on demand becomes one
        ra_rad=stars.ra_rad + off[:, 0] / np.cos(stars.dec_rad),
        dec_rad=stars.dec_rad + off[:, 1],
        parallax_rad=stars.parallax_rad + off[:, 2],
        pmra_rad_yr=stars.pmra_rad_yr + motion[:, 0],
        pmdec_rad_yr=stars.pmdec_rad_yr + motion[:, 1],
    )
