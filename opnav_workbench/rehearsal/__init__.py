"""Rehearsals: simulated pictures whose truth is sealed, and the truth held beside the solution.

approach, demo_pictures, score   single pictures with their truth, as ``opnav demo`` has them
ort_scenario, ort_perturb*       operational readiness tests: scenario files, and the case that a seed draws
ort_package*, ort_briefing*      the package that a team gets
ort_truth*                       what is sealed in it, and the reveal
ort_solution*, ort_score*        the team's estimate, and its grade
"""

from typing import TYPE_CHECKING, Any

from opnav_workbench.rehearsal.approach import PictureRequest, simulate_picture
from opnav_workbench.rehearsal.center_errors import center_errors
from opnav_workbench.rehearsal.demo_pictures import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    DEMO_TARGETS,
)
from opnav_workbench.rehearsal.score import Comparison, compare
from opnav_workbench.simulation import Truth

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.ort_package import OrtPackage, OrtPicture, new_rehearsal, open_rehearsal
    from opnav_workbench.rehearsal.ort_scenario import OrtScenario, load_ort_scenario, ort_scenario_names
    from opnav_workbench.rehearsal.ort_score import OrtScore, score_rehearsal
    from opnav_workbench.rehearsal.ort_score_log import logged_delivery
    from opnav_workbench.rehearsal.ort_solution import OrtSolution, solve_rehearsal
    from opnav_workbench.rehearsal.ort_truth import OrtTruth, reveal

__all__ = [
    "DEMO_CATALOG",
    "DEMO_KERNELS",
    "DEMO_MISSION",
    "DEMO_PICTURES",
    "DEMO_TARGETS",
    "Comparison",
    "OrtPackage",
    "OrtPicture",
    "OrtScenario",
    "OrtScore",
    "OrtSolution",
    "OrtTruth",
    "PictureRequest",
    "Truth",
    "center_errors",
    "compare",
    "load_ort_scenario",
    "logged_delivery",
    "new_rehearsal",
    "open_rehearsal",
    "ort_scenario_names",
    "reveal",
    "score_rehearsal",
    "simulate_picture",
    "solve_rehearsal",
]

# Loaded when first used: encryption and estimation are no part of a demonstration.
_HOMES = {
    "OrtPackage": "ort_package",
    "OrtPicture": "ort_package",
    "OrtScenario": "ort_scenario",
    "OrtScore": "ort_score",
    "OrtSolution": "ort_solution",
    "OrtTruth": "ort_truth",
    "load_ort_scenario": "ort_scenario",
    "logged_delivery": "ort_score_log",
    "new_rehearsal": "ort_package",
    "open_rehearsal": "ort_package",
    "ort_scenario_names": "ort_scenario",
    "reveal": "ort_truth",
    "score_rehearsal": "ort_score",
    "solve_rehearsal": "ort_solution",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
