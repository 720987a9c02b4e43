"""Targets of navigation pictures as values: where a body is, how large, how turned, how lit.

target   a body's state as the spacecraft sees it; a star taken as a target is one without radii
"""

from opnav_workbench.bodies.target import MIN_PARALLAX_RAD, TargetState, star_target

__all__ = ["MIN_PARALLAX_RAD", "TargetState", "star_target"]
