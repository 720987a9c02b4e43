"""Targets of navigation pictures as values: where a body is, how large, how turned, how lit.

Enter by `TargetState`, or `star_target` for a star taken as a target (one without radii); `Photometry` is what a
mission file says of a target's brightness.

``target_state``
    A body's state as the spacecraft sees it.
``brightness``
    How bright it is at which phase angle, and how far its light lies from its center.
"""

from opnav_workbench.targets.brightness import (
    EarthApparent,
    Photometry,
    absolute_magnitude,
    center_of_light_radii,
    diameter_km,
    disk_magnitude,
    distance_magnitude,
    hg_magnitude,
    hg_phase_function,
    lambert_phase_function,
    linear_phase_magnitude,
    lommel_seeliger_phase_function,
)
from opnav_workbench.targets.target_state import MIN_PARALLAX_RAD, TargetState, star_target

__all__ = [
    "MIN_PARALLAX_RAD",
    "EarthApparent",
    "Photometry",
    "TargetState",
    "absolute_magnitude",
    "center_of_light_radii",
    "diameter_km",
    "disk_magnitude",
    "distance_magnitude",
    "hg_magnitude",
    "hg_phase_function",
    "lambert_phase_function",
    "linear_phase_magnitude",
    "lommel_seeliger_phase_function",
    "star_target",
]
