"""Predicted and true attitude of a picture: what the header says, and how the camera really stood."""

import math
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import (
    camera_from_j2000,
    matrix_from_quaternion,
    pointing_angles,
    rotation_from_vector,
    unit_from_radec,
)
from opnav_workbench.simulation.randomness import picture_random
from opnav_workbench.simulation.scenario_file import beside
from opnav_workbench.simulation.scenario_parts import ActualAttitude, PredictedAttitude
from opnav_workbench.spice import KernelSet, camera_attitude
from opnav_workbench.spice.aiming import aim

__all__ = ["flown_kernels", "predicted_attitude", "true_attitude"]


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
    plan : ActualAttitude
    predicted : (3, 3) array
    camera : Camera
    et : float
    seed : int
        Of the picture.
    folder : Path
        Where relative paths of kernels count from.

    Raises
    ------
    KernelError
        The plan takes it from other kernels, and they do not have it.
    """
    if plan.source == "random":
        return misaligned(predicted, camera, picture_random(seed, "attitude_error"))
    if plan.source == "error":
        return shifted(predicted, camera, plan.shift_px, plan.twist_deg)
    if plan.source == "kernels":
        with flown_kernels(plan, folder):
            return camera_attitude(camera.frame, et)
    return predicted


def flown_kernels(plan: ActualAttitude, folder: Path) -> AbstractContextManager[object]:
    """Return a context in which the kernels of the attitude as flown are open; nothing where the plan names none."""
    return nullcontext() if plan.kernels is None else KernelSet(beside(plan.kernels, folder))


def misaligned(predicted: FloatArray, camera: Camera, rng: np.random.Generator) -> FloatArray:
    """Turn an attitude by a random error about the pixel, line and boresight axes, of the camera's a priori size."""
    sigma = camera.attitude_sigma
    cross = sigma.cross_px * camera.pixel_scale_rad
    error = rng.normal(0.0, [cross, cross, math.radians(sigma.twist_deg)])
    return rotation_from_vector(camera.focal_from_camera.T @ error) @ predicted


def shifted(
    predicted: FloatArray, camera: Camera, shift_px: tuple[float, float], twist_deg: float
) -> FloatArray:
    """Move the boresight's sky on the detector, and add to the twist; see `delta_pixel, delta_line, delta_twist`."""
    ra, dec, twist = pointing_angles(predicted, camera.focal_from_camera)
    pixel, line = (shift * camera.pixel_scale_rad for shift in shift_px)
    turned = twist + math.radians(twist_deg)
    return aim(unit_from_radec(ra, dec), turned, camera.focal_from_camera, (pixel, line))
