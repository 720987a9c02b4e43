"""Rehearsals: simulated pictures whose truth is sealed, and the truth held beside the solution."""

from opnav_workbench.rehearsal.approach import PictureRequest, simulate_picture
from opnav_workbench.rehearsal.demo_pictures import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    DEMO_TARGETS,
)
from opnav_workbench.rehearsal.score import Comparison, compare
from opnav_workbench.simulation import Truth

__all__ = [
    "DEMO_CATALOG",
    "DEMO_KERNELS",
    "DEMO_MISSION",
    "DEMO_PICTURES",
    "DEMO_TARGETS",
    "Comparison",
    "PictureRequest",
    "Truth",
    "compare",
    "simulate_picture",
]
