"""A sequence's own pointing: where the commanded attitudes put the target, written as a CK over the other kernels."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.ort_package_kernels import NOTE
from opnav_workbench.rehearsal.ort_scenario import OrtEntry, OrtScenario
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.spice import KernelSet, ck_structure, et_from_utc, rotation, write_ck, write_text_kernel
from opnav_workbench.spice.aiming import aim
from opnav_workbench.spice.text_kernels import metakernel_assignments

__all__ = ["add_pointing"]

HOLD_S = 2.0  # the attitude is held so long before and after an exposure
NAME = "sequence_predicted.bc"


def add_pointing(
    scenario: OrtScenario, mission: Mission, cameras: Mapping[str, Camera], metakernel: Path
) -> None:
    """Write the commanded attitudes of the pictures that have a pointing of their own, and add them to the metakernel.

    Raises
    ------
    MissionError
        Two of them overlap, or a target cannot be held there.
    KernelError
        The kernels do not know spacecraft, target or frame.
    """
    pictures = [picture for picture in scenario.sequence() if picture.pointing is not None]
    if not pictures:
        return
    with KernelSet(metakernel) as kernels:
        held = [_held(picture, scenario, mission, cameras[picture.name]) for picture in pictures]
        _write(metakernel.with_name(NAME), held, mission)
        names = [path.name for path in kernels.paths if path != metakernel]
    write_text_kernel(metakernel, "MK", metakernel_assignments([*names, NAME]), NOTE)


def _held(
    picture: OrtEntry, scenario: OrtScenario, mission: Mission, camera: Camera
) -> tuple[FloatArray, FloatArray]:
    """Return begin and end of an attitude (2,), and ``bus_from_j2000`` (3, 3)."""
    assert picture.pointing is not None
    et = et_from_utc(picture.time)
    body = (
        (picture.targets or scenario.targets)[0]
        if picture.pointing.target is None
        else picture.pointing.target
    )
    seen = body_target(body, mission.spacecraft_id, et).direction
    apparent = apparent_direction(seen, observer_from_kernels(mission.spacecraft_id, et).velocity_km_s)
    pixel, line = (offset * camera.pixel_scale_rad for offset in picture.pointing.offset_px)
    try:
        attitude = aim(
            apparent, math.radians(picture.pointing.twist_deg), camera.focal_from_camera, (pixel, line)
        )
    except ValueError as error:
        raise MissionError(f"rehearsal scenario: pictures: {picture.name}: pointing: {error}.") from error
    half = 0.5 * picture.exposure_s + HOLD_S
    return np.array([et - half, et + half]), rotation(camera.frame, mission.bus_frame, et) @ attitude


def _write(path: Path, held: list[tuple[FloatArray, FloatArray]], mission: Mission) -> None:
    times = np.concatenate([window for window, _ in held])
    if (np.diff(times) <= 0.0).any():
        raise MissionError(
            f"rehearsal scenario: pictures: two with a pointing of their own are less than {2.0 * HOLD_S:g} s apart; give "
            "them more time."
        )
    structure = ck_structure(mission.bus_frame)
    if structure is None:
        raise MissionError(
            f"rehearsal scenario: no CK orients the frame {mission.bus_frame} in these kernels."
        )
    write_ck(
        path,
        structure[0],
        mission.clock_id,
        times,
        np.repeat(np.stack([attitude for _, attitude in held]), 2, axis=0),
        np.zeros((len(times), 3)),
        interval_starts=range(0, len(times), 2),
        comment="Commanded attitudes of a rehearsal's picture sequence, written by opnav_workbench.\n",
    )
