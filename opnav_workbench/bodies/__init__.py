"""Targets of navigation pictures as values: where a body is, how large, how turned, how lit.

target      a body's state as the spacecraft sees it; a star taken as a target is one without radii
photometry  how bright it is, and how far its light lies from its center
"""

from opnav_workbench.bodies.photometry import center_of_light_radii, linear_phase_magnitude
from opnav_workbench.bodies.target import MIN_PARALLAX_RAD, TargetState, star_target

__all__ = [
    "MIN_PARALLAX_RAD",
    "TargetState",
    "center_of_light_radii",
    "linear_phase_magnitude",
    "star_target",
]
