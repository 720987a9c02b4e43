"""What a team delivered, held against the truth: quantities, stars, pictures, and the solution.

A quantity's error is told in the sigmas that its own covariance gives it. Of a picture: was it lost, where did it
point, what was found, missed, invented. Of the solution: parameters, flyby, fit, and whether the pictures support
its sigmas.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation.parameters import parse_groups
from opnav_workbench.geometry import matrix_from_quaternion, vector_from_rotation
from opnav_workbench.rehearsal.comparison import compare
from opnav_workbench.rehearsal.results import SURFACE_FROM_PX, PictureResult
from opnav_workbench.rehearsal.solution import (
    DISK_SIGMA_PX,
    OrtSolution,
    PredictedFlyby,
    predicted_flyby,
    solve_rehearsal,
)
from opnav_workbench.robust import equal_sigmas
from opnav_workbench.simulation import Truth

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrtPackage
    from opnav_workbench.rehearsal.sealed_truth import OrtTruth

__all__ = [
    "GOOD_SIGMAS",
    "WRONG_SIGMAS",
    "LandmarkScore",
    "PictureScore",
    "SolutionScore",
    "TruthCheck",
    "check_against_truth",
    "check_attitude",
    "score_picture",
    "score_solution",
    "score_stars",
    "sigma_ratios",
]


# ---- One quantity against its truth, with the sigmas that its own covariance gives the error.

GOOD_SIGMAS = 3.0  # an honest sigma is left behind once in 370 times
WRONG_SIGMAS = 5.0  # once in 1.7 million times


@dataclass(frozen=True, slots=True, eq=False)
class TruthCheck:
    """A quantity of k components; arrays (k,) are read-only.

    Attributes
    ----------
    labels, units
        Of the components.
    solved, truth, error, sigma : arrays
        Error: solved minus true.
    sigmas
        Of the normal error that is as improbable as all components together.
    """

    name: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    solved: FloatArray
    truth: FloatArray
    error: FloatArray
    sigma: FloatArray
    sigmas: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def verdict(self) -> str:
        """Return ``good``, ``poor`` or ``wrong``."""
        if self.sigmas <= GOOD_SIGMAS:
            return "good"
        return "poor" if self.sigmas <= WRONG_SIGMAS else "wrong"

    @property
    def component_sigmas(self) -> FloatArray:
        """Return each component's error over its own sigma (k,)."""
        return np.asarray(self.error / self.sigma)


def check_against_truth(
    name: str,
    labels: tuple[str, ...],
    units: tuple[str, ...],
    solved: ArrayLike,
    truth: ArrayLike,
    covariance: ArrayLike,
) -> TruthCheck:
    """Hold a quantity against its truth.

    Parameters
    ----------
    solved, truth : (k,) array_like
    covariance : (k, k) array_like
        Of the solved values.

    Examples
    --------
    >>> check = check_against_truth("center", ("pixel", "line"), ("px", "px"), [10.1, 20.0], [10.0, 20.0], np.eye(2) * 0.01)
    >>> round(check.sigmas, 2), check.verdict
    (0.52, 'good')
    """
    values, true, matrix = (np.asarray(v, dtype=np.float64) for v in (solved, truth, covariance))
    error = values - true
    square = _squared_sigmas(error, matrix)
    sigma = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    return TruthCheck(name, labels, units, values, true, error, sigma, equal_sigmas(square, len(error)))


def _squared_sigmas(error: FloatArray, covariance: FloatArray) -> float:
    """Return the squared error in sigmas; a matrix that is no covariance gives no error any credit."""
    try:
        return float(np.sum(np.linalg.solve(np.linalg.cholesky(covariance), error) ** 2))
    except np.linalg.LinAlgError:
        return np.inf if error.any() else 0.0


def sigma_ratios(claimed: ArrayLike, supported: ArrayLike) -> tuple[float, float]:
    """Return least and largest ratio of claimed to supported sigma over all directions; (k, k) covariances.

    Examples
    --------
    >>> sigma_ratios(np.diag([1.0, 4.0]), np.eye(2))
    (1.0, 2.0)
    """
    factor = np.linalg.inv(np.linalg.cholesky(np.asarray(supported, float)))
    values = np.linalg.eigvalsh(factor @ np.asarray(claimed, float) @ factor.T)
    least, largest = (float(np.sqrt(max(v, 0.0))) for v in values[[0, -1]])
    return least, largest


# ---- The stars of a picture against its truth: found, missed, false.

MISSED_SNR = 10.0  # a lone star as bright as this is found always
FALSE_SIGMAS, FALSE_PX = 5.0, 1.0  # a used star farther from its true place than both is something else


@dataclass(frozen=True, slots=True)
class StarScore:
    """The stars of a picture.

    Attributes
    ----------
    found
        Used for the pointing, at their true place.
    missed
        Reported as not detected, though bright, on the detector and not hidden.
    false
        Used, though there is no such star there.
    set_aside
        Measured but not used: rejected, blended, saturated.
    rms_sigmas
        Of the found stars' errors in their own sigmas; nan without.
    """

    found: int = 0
    missed: tuple[str, ...] = ()
    false: tuple[str, ...] = ()
    set_aside: int = 0
    rms_sigmas: float = float("nan")

    @property
    def good(self) -> bool:
        """Whether no star is false, and at most one in ten is missed."""
        return not self.false and self.found > 0 and len(self.missed) <= 0.1 * self.found


def score_stars(result: Mapping[str, Any], truth: Truth) -> StarScore:
    """Hold the stars of a ``result.json`` against the truth's table."""
    rows = result.get("stars") or ()
    objects = truth.objects[truth.objects["kind"] == "star"]
    index = {str(name): i for i, name in enumerate(objects["id"])}
    place = np.column_stack([objects["pixel"].value, objects["line"].value])
    flux = np.asarray(objects["flux"].value, float)
    shown = np.asarray(objects["on_detector"], bool) & ~np.asarray(objects["occulted"], bool)
    used = [row for row in rows if row["status"] == "used" and row["observed"] is not None]
    errors = {row["id"]: _star_sigmas(row, place[index[row["id"]]]) for row in used if row["id"] in index}
    false = [row["id"] for row in used if row["id"] not in errors or _is_false_star(row, place, index)]
    per_electron = [row["snr"] / flux[index[row["id"]]] for row in used if row["id"] in index and row["snr"]]
    faint = float(np.median(per_electron)) if per_electron else 0.0
    missed = [
        row["id"]
        for row in rows
        if row["status"] == "not_detected"
        and row["id"] in index
        and shown[index[row["id"]]]
        and faint * flux[index[row["id"]]] >= MISSED_SNR
    ]
    good = np.array([e for name, e in errors.items() if name not in false]).reshape(-1, 2)
    return StarScore(
        found=len(good),
        missed=tuple(missed),
        false=tuple(false),
        set_aside=sum(row["status"] in ("rejected", "blended", "saturated") for row in rows),
        rms_sigmas=float(np.sqrt(np.mean(good**2))) if len(good) else float("nan"),
    )


def _star_sigmas(row: Mapping[str, Any], true: FloatArray) -> FloatArray:
    return np.asarray((np.asarray(row["observed"], float) - true) / np.asarray(row["sigma_px"], float))


def _is_false_star(row: Mapping[str, Any], place: FloatArray, index: Mapping[str, int]) -> bool:
    true = place[index[row["id"]]]
    off = float(np.hypot(*(np.asarray(row["observed"], float) - true)))
    return off > FALSE_PX and float(np.abs(_star_sigmas(row, true)).max()) > FALSE_SIGMAS


# ---- One picture of a rehearsal against its truth.

FEWEST_LANDMARKS, MOST_FALSE_LANDMARKS = 4, 0.01
LANDMARK_SIGMAS = 2.0  # rms of their errors: more, and the sigmas are far too small


@dataclass(frozen=True, slots=True, eq=False)
class CenterScore:
    """A body in a picture.

    Attributes
    ----------
    body, method, status
        As the team reports it; the last of several methods that is sure.
    visible
        Whether it truly is on the detector, and not hidden.
    check
        None: no center was claimed.
    verdict : {"good", "poor", "wrong", "unsure", "missed", "false", "absent"}
        unsure: reported as uncertain; false: claimed where there is none; absent: rightly not claimed.
    """

    body: str
    method: str
    status: str
    visible: bool
    check: TruthCheck | None
    verdict: str


@dataclass(frozen=True, slots=True)
class LandmarkScore:
    """The landmarks of a picture in orbit.

    Attributes
    ----------
    asked
        Whether the picture was taken for the surface.
    accepted, false
        How many the team accepted, and how many of them are not where they truly are.
    rms_sigmas, rms_px
        Of the errors of the others, each coordinate; nan without.
    """

    asked: bool
    accepted: int = 0
    false: int = 0
    rms_sigmas: float = float("nan")
    rms_px: float = float("nan")

    @property
    def good(self) -> bool:
        """Whether there are enough, hardly one is false, and their sigmas hold."""
        few_false = self.false <= MOST_FALSE_LANDMARKS * self.accepted
        return self.accepted >= FEWEST_LANDMARKS and few_false and self.rms_sigmas <= LANDMARK_SIGMAS


@dataclass(frozen=True, slots=True, eq=False)
class PictureScore:
    """A picture.

    Attributes
    ----------
    status
        As the team reports it.
    lost
        Why it holds nothing usable; empty where it does.
    verdict : {"good", "not solved", "lost, named", "claimed though lost", "not reported"}
    messages
        Of the team.
    landmarks
        In orbit.
    stars_asked
        Whether it shows stars that the team should have found.
    """

    name: str
    utc: str
    et: float
    status: str
    lost: str
    verdict: str
    pointing: TruthCheck | None
    centers: tuple[CenterScore, ...]
    stars: StarScore
    messages: tuple[str, ...]
    landmarks: LandmarkScore | None = None
    stars_asked: bool = True


def score_picture(
    reported: PictureResult,
    truth: Truth | None,
    camera: Camera | None,
    targets: Sequence[str],
    *,
    lost: str = "",
    utc: str = "",
    disk_sigma_px: float = 0.0,
) -> PictureScore:
    """Hold what a team says of a picture against its truth.

    Parameters
    ----------
    truth
        None: the picture was never taken.
    camera
        None where there is no truth.
    targets
        Bodies that the team is to find.
    lost
        Why the picture holds nothing usable; empty where it does.
    disk_sigma_px
        What the team adds (in squares) to the sigmas of disks.
    """
    pointing: TruthCheck | None = None
    centers: tuple[CenterScore, ...] = ()
    stars = StarScore()
    if truth is not None and camera is not None and not lost:
        pointing = check_attitude(reported.result["pointing"], truth, camera) if reported.solved else None
        centers = _center_scores(reported, truth, targets, disk_sigma_px)
        stars = score_stars(reported.result, truth)
    return PictureScore(
        name=reported.name,
        utc=utc,
        et=np.nan if truth is None else truth.et,
        status=reported.status,
        lost=lost,
        verdict=_picture_verdict(reported, lost),
        pointing=pointing,
        centers=centers,
        stars=stars,
        messages=reported.messages,
    )


def _picture_verdict(reported: PictureResult, lost: str) -> str:
    if reported.status == "missing":
        return "not reported"
    if lost:
        return "claimed though lost" if _claims(reported) else "lost, named"
    return "good" if reported.solved else "not solved"


def _claims(reported: PictureResult) -> bool:
    """Whether a team claims anything of a picture: a pointing, or a body's center."""
    bodies = reported.result.get("bodies") or ()
    return reported.status != "failed" and (reported.solved or any(_is_claimed(b) for b in bodies))


def _is_claimed(body: Mapping[str, Any]) -> bool:
    return body.get("status") == "ok" and body.get("observed") is not None


def check_attitude(pointing: Mapping[str, Any], truth: Truth, camera: Camera) -> TruthCheck:
    """Return a pointing's check: values as the sky's shift on the detector, sigmas of the rotation itself.

    Parameters
    ----------
    pointing
        ``quaternion_camera_from_j2000`` and ``covariance_rad2``.
    """
    rows = compare(truth, {"pointing": pointing}, camera)
    solved = matrix_from_quaternion(np.asarray(pointing["quaternion_camera_from_j2000"], float))
    rotation = vector_from_rotation(solved @ truth.camera_from_j2000.T)
    whole = check_against_truth("", (), (), rotation, np.zeros(3), pointing["covariance_rad2"])
    names, units = tuple(row.name for row in rows), tuple(row.unit for row in rows)
    solved_values, true, error, sigma = (
        np.array([getattr(row, name) for row in rows]) for name in ("solved", "truth", "error", "sigma")
    )
    return TruthCheck("pointing", names, units, solved_values, true, error, sigma, whole.sigmas)


def _center_scores(
    reported: PictureResult, truth: Truth, targets: Sequence[str], disk_sigma_px: float
) -> tuple[CenterScore, ...]:
    true = {name.upper(): place for name, place in truth.bodies.items()}
    visible = _visible(truth)
    entries = reported.result.get("bodies") or ()
    return tuple(
        _center_score(
            name, [b for b in entries if str(b["name"]).upper() == name.upper()], true, visible, disk_sigma_px
        )
        for name in targets
    )


def _visible(truth: Truth) -> frozenset[str]:
    rows = truth.objects[truth.objects["kind"] == "body"]
    seen = np.asarray(rows["on_detector"], bool) & ~np.asarray(rows["occulted"], bool)
    return frozenset(str(name).upper() for name in rows["id"][seen])


def _center_score(
    name: str,
    entries: Sequence[Mapping[str, Any]],
    true: Mapping[str, FloatArray],
    visible: frozenset[str],
    disk_sigma_px: float,
) -> CenterScore:
    seen = name.upper() in visible
    claimed = [entry for entry in entries if _is_claimed(entry)]
    if not claimed:
        status = str(entries[-1]["status"]) if entries else "not looked for"
        method = str(entries[-1]["method"]) if entries else ""
        missed = "unsure" if status == "uncertain" else "missed"
        return CenterScore(name, method, status, seen, None, missed if seen else "absent")
    entry = claimed[-1]
    if name.upper() not in true:
        return CenterScore(name, str(entry["method"]), "ok", seen, None, "false")
    check = check_against_truth(
        name,
        ("pixel", "line"),
        ("px", "px"),
        entry["observed"],
        true[name.upper()],
        np.asarray(entry["covariance_px2"], float) + _disk_covariance_px2(entry, disk_sigma_px),
    )
    # A body just off the detector shows part of its disk: found there within its sigmas, it is no invention.
    verdict = check.verdict if seen or check.verdict == "good" else "false"
    return CenterScore(name, str(entry["method"]), "ok", seen, check, verdict)


def _disk_covariance_px2(entry: Mapping[str, Any], sigma_px: float) -> FloatArray:
    wide = float(entry.get("diameter_px") or 0.0) > SURFACE_FROM_PX
    return np.asarray(sigma_px**2 * wide * np.eye(2))


# ---- The delivered solution against the truth.


@dataclass(frozen=True, slots=True, eq=False)
class SolutionScore:
    """The solution held against the truth.

    Attributes
    ----------
    flyby
        As predicted.
    parameters
        One a group.
    all_parameters, b_plane, arrival
        All groups together; (B.T, B.R); linearised time of flight.
    b_plane_true : (3,) array
    sigma_ratio : (float, float)
        Least and largest ratio of the claimed sigma of a direction to the one that the delivered pictures support; nan where
        they support none.
    remark
        Why the ratio is not known.
    """

    solution: OrtSolution
    flyby: PredictedFlyby
    parameters: tuple[TruthCheck, ...]
    all_parameters: TruthCheck
    b_plane: TruthCheck
    arrival: TruthCheck
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
    true_values = flyby.corrected(np.asarray(truth.relative_state_km) - flyby.state)
    ratios, remark = _supported_sigmas(package, results, solution)
    groups = parse_groups(solution.parameters)
    true = np.concatenate([np.atleast_1d(truth.parameters[group.name]) for group in groups])
    checks = tuple(
        check_against_truth(
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
        all_parameters=check_against_truth(
            "all parameters", solution.labels, solution.units, solution.correction, true, solution.covariance
        ),
        b_plane=check_against_truth(
            "B-plane", ("B·T", "B·R"), ("km", "km"), after[:2], true_values[:2], covariance[:2, :2]
        ),
        arrival=check_against_truth(
            "arrival", ("time",), ("s",), after[2:], true_values[2:], covariance[2:, 2:]
        ),
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


def _supported_sigmas(
    package: "OrtPackage", results: str | Path, solution: OrtSolution
) -> tuple[tuple[float, float], str]:
    """Compare the claimed covariance with the one that the delivered pictures give."""
    try:
        again = solve_rehearsal(package, results, disk_sigma_px=min(solution.disk_sigma_px, DISK_SIGMA_PX))
        return sigma_ratios(solution.covariance, again.covariance), ""
    except EstimationError as error:
        return (float("nan"), float("nan")), f"the delivered pictures give no solution: {error}"
