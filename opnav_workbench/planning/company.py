"""Bodies that enter the field beside the targets: everything whose position the open kernels know."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import OpNavError
from opnav_workbench.planning.desk import Desk
from opnav_workbench.scene import Observer, predict_body
from opnav_workbench.spice import KernelSet, body_id, body_name

__all__ = ["Visitor", "natural_bodies", "visitors"]

LAST_BARYCENTER = 9  # NAIF: 0..9 are barycenters, where nothing is to be seen


@dataclass(frozen=True, slots=True)
class Visitor:
    """A body in the field that is no target.

    Attributes
    ----------
    name : str
    pixel, line : float
        Its center, perhaps just off the detector.
    diameter_px : float
        0 where its size is not known.
    mag : float
        V where the mission file knows it, else nan.
    drawn : bool
        Its light is part of the prediction.
    """

    name: str
    pixel: float
    line: float
    diameter_px: float
    mag: float
    drawn: bool


def natural_bodies() -> tuple[str, ...]:
    """Return the names of the bodies, no spacecraft and no barycenters, that the active kernels have positions of."""
    active = KernelSet.active()
    numbers = [] if active is None else [cover.body for cover in active.coverage("SPK")]
    return tuple(body_name(number) for number in sorted(set(numbers)) if number > LAST_BARYCENTER)


def visitors(
    desk: Desk,
    names: Sequence[str],
    targets: Sequence[str],
    drawn: Sequence[str],
    camera: Camera,
    attitude: FloatArray,
    observer: Observer,
    et: float,
) -> tuple[Visitor, ...]:
    """Return the bodies of `names` that are in the field, or whose disk reaches into it, and are no targets."""
    own, shown = ({body_id(name) for name in group} for group in (targets, drawn))
    found = []
    for name in names:
        if body_id(name) in own:
            continue
        try:
            state = desk.workshop.mission.with_magnitude(desk.target(name, et))
        except OpNavError:  # the kernels do not have it then
            continue
        seen = predict_body(state, observer, camera, attitude)
        size = float(np.nan_to_num(seen.diameter_px))
        if not camera.on_detector(seen.pixel_line, 0.5 * size):
            continue
        mag = np.nan if state.magnitude is None else state.magnitude
        pixel, line = (float(p) for p in seen.pixel_line)
        found.append(Visitor(name, pixel, line, size, mag, body_id(name) in shown))
    return tuple(found)
