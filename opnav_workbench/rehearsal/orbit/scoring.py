"""Landmarks, pointings and the solution of a rehearsal in orbit, held against the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation.body import BodyRotation
from opnav_workbench.kernels import KernelSet, body_attitude, et_from_utc, state
from opnav_workbench.landmarks.prediction import landmark_places
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.rehearsal.orbit.solution import GROUPS, OrbitSolution, solve_orbit_rehearsal
from opnav_workbench.rehearsal.results import PictureResult
from opnav_workbench.rehearsal.truth_checks import (
    LandmarkScore,
    PictureScore,
    TruthCheck,
    check_against_truth,
    check_attitude,
    sigma_ratios,
)
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.simulation import Truth

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrtPackage, OrtPicture
    from opnav_workbench.rehearsal.sealed_truth import OrtTruth

__all__ = ["OrbitScore", "pictures_in_orbit", "score_orbit"]

LEAST_LANDMARKS = 4  # that a picture's place and pointing may rest on
FALSE_SIGMAS, FALSE_PX = 5.0, 1.0  # a landmark farther from its true place than both is something else
ASKED_STARS, ASKED_SNR = 8, 20.0  # a picture that shows so many such stars is one whose stars are asked for
PSF_AREA = 4.0 * np.pi  # of a Gaussian, in squares of its sigma: the pixels whose noise a fit takes in


@dataclass(frozen=True, slots=True, eq=False)
class OrbitScore:
    """The solution of a rehearsal in orbit against the truth.

    Attributes
    ----------
    parameters
        One a group of `opnav_workbench.rehearsal.orbit.solution.GROUPS`.
    all_parameters, prediction
        All groups together; the spacecraft's place at the time of the prediction.
    sigma_ratio : (float, float)
        Least and largest ratio of the claimed sigma of a direction to the one that the delivered pictures support; nan where
        they support none.
    remark
        Why the ratio is not known.
    """

    solution: OrbitSolution
    parameters: tuple[TruthCheck, ...]
    all_parameters: TruthCheck
    prediction: TruthCheck
    sigma_ratio: tuple[float, float]
    remark: str = ""


def score_orbit(
    package: "OrtPackage", truth: "OrtTruth", results: str | Path, solution: OrbitSolution
) -> OrbitScore:
    """Hold a solution against the truth.

    Raises
    ------
    SessionError
        It is of another rehearsal or another time.
    """
    asked = (package.name, package.epoch_utc, package.orbit and package.orbit.predict_utc)
    if (solution.package, solution.epoch_utc, solution.predict_utc) != asked:
        raise SessionError(
            f"the solution is of another rehearsal: {solution.package} at {solution.epoch_utc}, not {package.name} at "
            f"{package.epoch_utc}."
        )
    true = np.concatenate(
        [
            truth.parameters["spacecraft_position"],
            truth.parameters["spacecraft_velocity"],
            truth.orbit["body_step"],
            truth.orbit["map_log"],
        ]
    )
    checks = tuple(
        check_against_truth(
            group.name,
            group.labels,
            (group.unit,) * len(group.labels),
            solution.correction[group.columns],
            true[group.columns],
            solution.covariance[group.columns, group.columns],
        )
        for group in GROUPS
    )
    ratios, remark = _supported(package, results, solution)
    whole = (solution.labels, solution.units, solution.correction, true, solution.covariance)
    place = truth.orbit["predicted_place_km"]
    return OrbitScore(
        solution,
        checks,
        check_against_truth("all parameters", *whole),
        check_against_truth(
            "predicted place",
            tuple("xyz"),
            ("km",) * 3,
            solution.place_km,
            place,
            solution.place_covariance_km2,
        ),
        ratios,
        remark,
    )


def _supported(
    package: "OrtPackage", results: str | Path, solution: OrbitSolution
) -> tuple[tuple[float, float], str]:
    """Compare the claimed covariance with the one that the delivered pictures give."""
    try:
        again = solve_orbit_rehearsal(package, results)
    except EstimationError as error:
        return (float("nan"), float("nan")), f"the delivered pictures give no solution: {error}"
    scale = again.sigma
    return sigma_ratios(*(one.covariance / np.outer(scale, scale) for one in (solution, again))), ""


# ---- Pictures.


def pictures_in_orbit(
    package: "OrtPackage",
    truth: "OrtTruth",
    reported: Sequence[PictureResult],
    scores: Sequence[PictureScore],
    solution: OrbitSolution | None,
) -> tuple[PictureScore, ...]:
    """Return the pictures' scores as they count in orbit: pointing of any source, landmarks in place of centers.

    A picture without stars is solved where landmarks tell its pointing; stars are asked for where they show.
    """
    mission = load_mission(package.mission)
    attitudes = {} if solution is None else solution.attitudes
    with KernelSet(package.metakernel):
        return tuple(
            _in_orbit(package, truth, picture, found, score, mission, attitudes.get(picture.name))
            for picture, found, score in zip(package.pictures, reported, scores, strict=True)
        )


def _in_orbit(
    package: "OrtPackage",
    truth: "OrtTruth",
    picture: "OrtPicture",
    found: PictureResult,
    score: PictureScore,
    mission: Mission,
    attitude: Mapping[str, Any] | None,
) -> PictureScore:
    true, camera = truth.pictures.get(picture.name), mission.camera_named(picture.camera)
    score = replace(score, centers=())
    if true is None or score.lost:
        return replace(score, stars_asked=False)
    landmarks = _landmark_score(package, truth, picture, found, mission, true, camera)
    enough = landmarks.accepted >= LEAST_LANDMARKS
    # What the batch made of the attitude is the better of two.
    pointing = score.pointing if attitude is None else check_attitude(attitude, true, camera)
    verdict = score.verdict
    if verdict == "not solved" and enough and pointing is not None:
        verdict = "good"
    return replace(
        score, verdict=verdict, pointing=pointing, landmarks=landmarks, stars_asked=_shows_stars(true, camera)
    )


def _shows_stars(true: Truth, camera: Camera) -> bool:
    rows = true.objects[true.objects["kind"] == "star"]
    seen = np.asarray(rows["on_detector"], bool) & ~np.asarray(rows["occulted"], bool)
    read_e = (camera.gain_e_per_dn or 1.0) * (camera.read_noise_dn or 0.0)
    noise = np.sqrt(PSF_AREA) * camera.psf.sigma_px * read_e
    flux = np.asarray(rows["flux"].value, float)
    return bool(
        (seen & (flux > ASKED_SNR * np.hypot(noise, np.sqrt(np.maximum(flux, 0.0))))).sum() >= ASKED_STARS
    )


def _landmark_score(
    package: "OrtPackage",
    truth: "OrtTruth",
    picture: "OrtPicture",
    found: PictureResult,
    mission: Mission,
    true: Truth,
    camera: Camera,
) -> LandmarkScore:
    assert package.orbit is not None
    body, known = package.orbit.body, truth.orbit["places_km"]
    asked = body in picture.targets
    looked = [one for one in found.result.get("landmarks") or () if str(one["body"]).upper() == body.upper()]
    points = [p for one in looked for p in one["points"] if p["status"] == "accepted"]
    strange = [p for p in points if p["id"] not in known]
    points = [p for p in points if p["id"] in known]
    if not points:
        return LandmarkScore(asked, 0, len(strange))
    places = _true_places(
        package, truth, picture, mission, true, camera, np.array([known[p["id"]] for p in points])
    )
    common = np.asarray(looked[0]["common_covariance_px2"], float)
    errors = np.array([p["observed"] for p in points], float) - places
    covariance = np.array([p["covariance_px2"] for p in points], float) + common
    square = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    false = (square > FALSE_SIGMAS**2) & (np.hypot(*errors.T) > FALSE_PX)
    sound = square[~false]
    rms = float(np.sqrt(sound.mean() / 2.0)) if len(sound) else float("nan")
    off = float(np.sqrt((errors[~false] ** 2).mean())) if len(sound) else float("nan")
    return LandmarkScore(asked, len(points), int(false.sum()) + len(strange), rms, off)


def _true_places(
    package: "OrtPackage",
    truth: "OrtTruth",
    picture: "OrtPicture",
    mission: Mission,
    true: Truth,
    camera: Camera,
    place_km: FloatArray,
) -> FloatArray:
    """Return where landmarks (n, 3) truly are in a picture, (n, 2) px."""
    assert package.orbit is not None
    body, craft = package.orbit.body, mission.spacecraft_id
    seen = body_target(body, craft, true.et)
    believed = state(craft, true.et, body).position_km
    position = seen.position_km - (np.asarray(truth.states_km[picture.name])[:3] - believed)
    epoch = et_from_utc(package.epoch_utc)
    rotation = BodyRotation.from_attitudes(lambda et: body_attitude(body, et), epoch).turned(
        np.asarray(truth.orbit["body_step"])
    )
    turn = rotation.body_from_j2000(true.et - float(np.linalg.norm(position)) / SPEED_OF_LIGHT_KM_S)
    target = replace(seen, position_km=position, body_from_j2000=turn)
    velocity = observer_from_kernels(craft, true.et).velocity_km_s
    return landmark_places(place_km, target, camera, true.camera_from_j2000, velocity)
