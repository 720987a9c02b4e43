"""The score of a rehearsal: everything that a team delivered, held against the truth."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opnav_workbench.camera import Camera
from opnav_workbench.files import plain_values
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.rehearsal.ort_score_grade import RULE, Grade, center_scatter, grade
from opnav_workbench.rehearsal.ort_score_log import Delivery
from opnav_workbench.rehearsal.ort_score_pictures import PictureScore, score_picture
from opnav_workbench.rehearsal.ort_score_solution import SolutionScore, score_solution
from opnav_workbench.rehearsal.ort_solution import OrtSolution
from opnav_workbench.rehearsal.ort_solution_pictures import PictureResult, picture_results

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.ort_package import OrtPackage
    from opnav_workbench.rehearsal.ort_truth import OrtTruth

__all__ = ["OrtScore", "score_rehearsal"]


@dataclass(frozen=True, slots=True, eq=False)
class OrtScore:
    """The score of a rehearsal.

    Attributes
    ----------
    package, title : str
    perturbed : tuple of str
        What was wrong on purpose, in words.
    pictures : tuple of PictureScore
        In the order in which they were taken.
    solution : SolutionScore or None
    grade : Grade
    rule : str
    delivery : Delivery or None
        What had been delivered when the truth was opened.
    center_scatter : (float, float)
        Rms of the center errors in their own sigmas, and the probability of so much.
    altered_package : tuple of str
        Files of the package that are not as they were made.
    """

    package: str
    title: str
    perturbed: tuple[str, ...]
    pictures: tuple[PictureScore, ...]
    solution: SolutionScore | None
    grade: Grade
    delivery: Delivery | None
    center_scatter: tuple[float, float]
    altered_package: tuple[str, ...] = ()
    rule: str = field(default=RULE)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON; what is not known is None."""
        content: dict[str, Any] = plain_values(asdict(self))
        return content


def score_rehearsal(
    package: "OrtPackage",
    truth: "OrtTruth",
    results: str | Path,
    solution: OrtSolution | None,
    *,
    delivery: Delivery | None = None,
) -> OrtScore:
    """Hold what a team delivered against the truth, and grade it by `ort_score_grade.RULE`.

    Parameters
    ----------
    package : OrtPackage
    truth : OrtTruth
        From `reveal`.
    results : path
        Folder of the pictures' folders.
    solution : OrtSolution or None
    delivery : Delivery, optional
        What was written down before the truth was opened (`logged_delivery`).

    Raises
    ------
    SessionError
        The results cannot be read, or the solution is of another rehearsal.
    """
    mission = load_mission(package.mission)
    cameras: dict[str, Camera] = {c.name: c for c in _cameras(mission)}
    reported = picture_results((p.name for p in package.pictures), results)
    disk_sigma_px = 0.0 if solution is None else solution.disk_sigma_px
    pictures = tuple(
        _picture(package, truth, picture, found, cameras, disk_sigma_px)
        for picture, found in zip(package.pictures, reported, strict=True)
    )
    scored = None if solution is None else score_solution(package, truth, results, solution)
    altered = () if delivery is None else delivery.altered
    return OrtScore(
        package=package.name,
        title=package.title,
        perturbed=tuple(truth.words),
        pictures=pictures,
        solution=scored,
        grade=grade(pictures, scored, altered),
        delivery=delivery,
        center_scatter=center_scatter(pictures),
        altered_package=tuple(getattr(package, "altered", ())),
    )


def _cameras(mission: Mission) -> list[Camera]:
    return [Camera.from_yaml(choice.file) for choice in mission.cameras]


def _picture(
    package: "OrtPackage",
    truth: "OrtTruth",
    picture: Any,
    reported: PictureResult,
    cameras: Mapping[str, Camera],
    disk_sigma_px: float,
) -> PictureScore:
    true = truth.pictures.get(picture.name)
    return score_picture(
        reported,
        true,
        None if true is None else cameras.get(true.camera),
        package.targets,
        lost=truth.lost.get(picture.name, ""),
        utc=picture.utc,
        disk_sigma_px=disk_sigma_px,
    )
