"""Targets of navigation pictures as values: where a body is, how large, how turned, how lit.

target           a body's state as the spacecraft sees it; a star taken as a target is one without radii
phase_functions  how its light falls with the phase angle
photometry       how bright it is, and how far its light lies from its center
brightness       what a mission file says of that
"""

from opnav_workbench.bodies.brightness import EarthApparent, Photometry
from opnav_workbench.bodies.phase_functions import (
    hg_phase_function,
    lambert_phase_function,
    lommel_seeliger_phase_function,
)
from opnav_workbench.bodies.photometry import (
    absolute_magnitude,
    center_of_light_radii,
    diameter_km,
    disk_magnitude,
    distance_magnitude,
    hg_magnitude,
    linear_phase_magnitude,
)
from opnav_workbench.bodies.target import MIN_PARALLAX_RAD, TargetState, star_target

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
