"""Rehearsals: simulated pictures with a known truth, for teams that practise and for tests."""

from opnav_workbench.rehearsal.approach import PictureRequest, Truth, simulate_picture
from opnav_workbench.rehearsal.demo_pictures import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    DEMO_TARGETS,
)
from opnav_workbench.rehearsal.picture import render_picture
from opnav_workbench.rehearsal.score import Comparison, compare

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
    "render_picture",
    "simulate_picture",
]
