"""Solved pictures as image support data of the Community Sensor Model, so that mapping programs take their pointing."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.camera.support_data import SupportData, support_data
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.kernels import KernelSet, body_id, state
from opnav_workbench.mission import Mission
from opnav_workbench.scene import body_target
from opnav_workbench.session.context import with_focal_scale

__all__ = ["support_data_of_result"]


def support_data_of_result(result: Mapping[str, Any], mission: Mission, target: str) -> dict[str, Any]:
    """Return image support data of a solved picture, as ALE writes them; states and rotation of the target from kernels.

    The spacecraft stands where the target's apparent place is: light time and stellar aberration are in its position, since
    mapping programs apply neither.

    Parameters
    ----------
    result
        As `ImageSession.result` returns it and ``result.json`` holds it.
    target
        Body on which the picture shall be mapped.

    Raises
    ------
    SessionError
        The picture has no solved pointing, or is a raw vidicon one: it bends by its own marks, more than polynomials of a
        Community Sensor Model can (4.4 px of c4400436).
    KernelError
        No kernels are open, or they do not know the target's place, size or rotation.
    CameraError
        The camera's distortion is none that a Community Sensor Model knows.
    """
    pointing, name = result.get("pointing"), str(result.get("image", "the picture"))
    if not pointing:
        raise SessionError(f"{name}: no pointing solved; image support data need one.")
    if KernelSet.active() is None:
        raise KernelError(
            "image support data need the target's place: open kernels with SPK and PCK (--kernels)."
        )
    et, craft = float(result["et"]), mission.spacecraft_id
    seen = body_target(target, craft, et)
    apparent = state(target, et, craft, correction="CN+S")
    if seen.radii_km is None or seen.body_from_j2000 is None or seen.sun_position_km is None:
        raise KernelError(
            f"the kernels do not give {target}'s size, rotation and light; load a PCK that does."
        )
    radii, seen_since_s = np.asarray(seen.radii_km), apparent.light_time_s
    data = SupportData(
        camera=_camera(result, mission),
        et=et,
        camera_from_j2000=matrix_from_quaternion(pointing["quaternion_camera_from_j2000"]),
        position_km=-apparent.position_km,
        velocity_km_s=-apparent.velocity_km_s,
        sun_position_km=np.asarray(seen.sun_position_km),
        sun_velocity_km_s=np.asarray(state("SUN", et - seen_since_s, target).velocity_km_s),
        body_from_j2000=np.asarray(seen.body_from_j2000),
        radii_km=radii[[0, 2]],
        spacecraft=mission.spacecraft_name,
    )
    return support_data(data, body_id(target))


def _camera(result: Mapping[str, Any], mission: Mission) -> Camera:
    """Return the camera that the picture was solved with: its window and binning, and its settled focal length."""
    camera = mission.camera_as_read(str(result["camera"]), result.get("readout"))
    if camera.reseau is not None:
        raise SessionError(
            f"{result.get('image', 'the picture')}: raw pictures of {camera.name} bend as their reseau marks tell, which no "
            "Community Sensor Model holds; process the picture that is corrected by them."
        )
    settings = (result.get("provenance") or {}).get("settings") or {}
    return with_focal_scale(camera, float(settings.get("focal_scale", 1.0)))
