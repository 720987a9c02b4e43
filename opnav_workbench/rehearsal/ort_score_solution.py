"""The delivered solution against the truth: parameters, flyby, fit, and whether the pictures support its sigmas."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation.parameters import parse_groups
from opnav_workbench.rehearsal.ort_score_check import Check, checked, sigma_ratios
from opnav_workbench.rehearsal.ort_solution import DISK_SIGMA_PX, OrtSolution, solve_rehearsal
from opnav_workbench.rehearsal.ort_solution_flyby import Flyby, predicted_flyby

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.ort_package import OrtPackage
    from opnav_workbench.rehearsal.ort_truth import OrtTruth

__all__ = ["SolutionScore", "score_solution"]


@dataclass(frozen=True, slots=True, eq=False)
class SolutionScore:
    """The solution held against the truth.

    Attributes
    ----------
    solution : OrtSolution
    flyby : Flyby
        As predicted.
    parameters : tuple of Check
        One a group.
    all_parameters, b_plane, arrival : Check
        All groups together; (B.T, B.R); linearised time of flight.
    b_plane_true : (3,) array
    sigma_ratio : (float, float)
        Least and largest ratio of the claimed sigma of a direction to the one that the delivered pictures support; nan where
        they support none.
    remark : str
        Why the ratio is not known.
    """

    solution: OrtSolution
    flyby: Flyby
    parameters: tuple[Check, ...]
    all_parameters: Check
    b_plane: Check
    arrival: Check
    b_plane_true: FloatArray
    sigma_ratio: tuple[float, float]
    remark: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


def score_solution(
    package: "OrtPackage", truth: "OrtTruth", results: str | Path, solution: OrtSolution
) -> SolutionScore:
    """Hold a solution against the truth.

    Raises
    ------
    SessionError
        It is of another rehearsal, or of other parameters or another epoch than the package asks for.
    """
    _require_same(package, solution)
    flyby = predicted_flyby(package)
    true_values = flyby.moved(np.asarray(truth.relative_state_km) - flyby.state)
    ratios, remark = _support(package, results, solution)
    groups = parse_groups(solution.parameters)
    true = np.concatenate([np.atleast_1d(truth.parameters[group.name]) for group in groups])
    checks = tuple(
        checked(
            group.name,
            tuple("xyz") if group.size == 3 else ("",),
            (group.unit,) * group.size,
            solution.correction[group.columns],
            true[group.columns],
            solution.covariance[group.columns, group.columns],
        )
        for group in groups
    )
    after, covariance = solution.b_plane_after, solution.b_plane_covariance
    return SolutionScore(
        solution=solution,
        flyby=flyby,
        parameters=checks,
        all_parameters=checked(
            "all parameters", solution.labels, solution.units, solution.correction, true, solution.covariance
        ),
        b_plane=checked(
            "B-plane", ("B·T", "B·R"), ("km", "km"), after[:2], true_values[:2], covariance[:2, :2]
        ),
        arrival=checked("arrival", ("time",), ("s",), after[2:], true_values[2:], covariance[2:, 2:]),
        b_plane_true=true_values,
        sigma_ratio=ratios,
        remark=remark,
    )


def _require_same(package: "OrtPackage", solution: OrtSolution) -> None:
    asked = (package.name, tuple(package.parameters), package.epoch_utc)
    given = (solution.package, solution.parameters, solution.epoch_utc)
    names = ("rehearsal", "parameters", "epoch")
    wrong = [
        f"{name} {theirs} instead of {ours}"
        for name, ours, theirs in zip(names, asked, given, strict=True)
        if ours != theirs
    ]
    if wrong:
        raise SessionError(f"the solution is of another rehearsal: {'; '.join(wrong)}.")


def _support(
    package: "OrtPackage", results: str | Path, solution: OrtSolution
) -> tuple[tuple[float, float], str]:
    """Compare the claimed covariance with the one that the delivered pictures give."""
    try:
        again = solve_rehearsal(package, results, disk_sigma_px=min(solution.disk_sigma_px, DISK_SIGMA_PX))
        return sigma_ratios(solution.covariance, again.covariance), ""
    except EstimationError as error:
        return (float("nan"), float("nan")), f"the delivered pictures give no solution: {error}"
