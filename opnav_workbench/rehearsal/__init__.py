"""Rehearsals: simulated pictures whose truth is sealed, and the truth held beside the solution.

Enter by `simulate_picture` and `compare` for single pictures with their truth, as ``opnav demo`` has them.
Operational readiness tests (ORT) go `new_rehearsal` -> `open_rehearsal` -> `solve_rehearsal` -> `logged_delivery`,
`reveal` -> `score_rehearsal`.

``demo``
    The pictures of the demonstration, simulated with the active kernels.
``comparison``
    Solved attitude and centers against the truth, in sigmas.
``scenario``
    Scenario files of rehearsals, and how they state their perturbations.
``case``
    The case that a seed draws from a scenario, in the parameters that the team estimates.
``pictures``
    Pictures of a case: what is true is drawn, what was predicted is written.
``package``
    The folder that a team gets, and its ``ort.yaml``.
``making``
    A package in the making: kernels, commanded attitudes, pictures, checksums.
``briefing``
    What the team is told, as text and as a page.
``truth_content``
    What is true of a case, as plain values and in words.
``sealed_truth``
    The truth encrypted, the reveal with the director's key, and the log of reveals.
``results``
    What a team made of the pictures, and the observables that count.
``filtering``
    What the filter allows for in a flyby's estimate, and what passes through it as rows.
``solution``
    The team's estimate of states and flyby, and its file.
``orbit``
    In orbit: the team's map of the body, its estimate from landmarks, and how both are scored.
``truth_checks``
    What was delivered held against the truth: quantities, stars, pictures, the solution.
``score``
    The score of a rehearsal and its grade.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand
from opnav_workbench.rehearsal.comparison import Comparison, center_errors, compare
from opnav_workbench.rehearsal.demo import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    DEMO_TARGETS,
    PictureRequest,
    simulate_picture,
)
from opnav_workbench.simulation import Truth

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.making import new_rehearsal
    from opnav_workbench.rehearsal.package import OrtPackage, OrtPicture, open_rehearsal
    from opnav_workbench.rehearsal.scenario import OrtScenario, load_ort_scenario, ort_scenario_names
    from opnav_workbench.rehearsal.score import OrtScore, score_rehearsal
    from opnav_workbench.rehearsal.sealed_truth import OrtTruth, logged_delivery, reveal
    from opnav_workbench.rehearsal.solution import OrtSolution, solve_rehearsal

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
    "OrtPackage": "package",
    "OrtPicture": "package",
    "OrtScenario": "scenario",
    "OrtScore": "score",
    "OrtSolution": "solution",
    "OrtTruth": "sealed_truth",
    "load_ort_scenario": "scenario",
    "logged_delivery": "sealed_truth",
    "new_rehearsal": "making",
    "open_rehearsal": "package",
    "ort_scenario_names": "scenario",
    "reveal": "sealed_truth",
    "score_rehearsal": "score",
    "solve_rehearsal": "solution",
}
__getattr__ = names_on_demand(__name__, _HOMES)
