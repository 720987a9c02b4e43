"""The score of a rehearsal: everything that a team delivered, held against the truth, and the grade.

The grade has points by section, and faults that no points make good. The rule, in the words of the report, is
`RULE`; the numbers in it are the constants below.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import SessionError
from opnav_workbench.files import plain_values
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal.orbit.scoring import OrbitScore, pictures_in_orbit, score_orbit
from opnav_workbench.rehearsal.orbit.solution import OrbitSolution
from opnav_workbench.rehearsal.results import PictureResult, picture_results
from opnav_workbench.rehearsal.sealed_truth import Delivery
from opnav_workbench.rehearsal.solution import OrtSolution
from opnav_workbench.rehearsal.truth_checks import (
    GOOD_SIGMAS,
    WRONG_SIGMAS,
    PictureScore,
    SolutionScore,
    TruthCheck,
    score_picture,
    score_solution,
)

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrtPackage
    from opnav_workbench.rehearsal.sealed_truth import OrtTruth

__all__ = ["RULE", "SECTIONS", "OrtScore", "grade_rehearsal", "score_rehearsal"]


# ---- The grade of a rehearsal: points by section, and faults that no points make good.

LETTERS = {"A": 90.0, "B": 80.0, "C": 70.0, "D": 60.0, "F": 0.0}
SECTIONS = {
    "pictures": 15.0,
    "pointing": 15.0,
    "stars": 10.0,
    "centers": 20.0,
    "estimate": 20.0,
    "B-plane": 20.0,
}
# In orbit, in place of centers and B-plane.
ORBIT_SECTIONS = {"landmarks": 20.0, "prediction": 20.0}
# Claimed sigma over the one that the pictures support, in the worst direction.
OVERCONFIDENT, BOLD = 0.5, 0.25
TIMID = 3.0  # the same, the other way: a solution that hides behind its sigmas
FIT_PROBABILITY = 1e-3
# rms of center errors in sigmas, and that it is no chance
SMALL_CENTER_SIGMAS, CENTER_PROBABILITY = 2.0, 1e-4
BLUNDER_PX = 1.0  # a pointing off by more, and by more than WRONG_SIGMAS, is another star field

RULE = (
    "Points: pictures 15 (lost ones named, the others solved); pointing 15 (share of usable pictures whose attitude lies "
    f"within {GOOD_SIGMAS:g} sigma of the truth); stars 10 (share of usable pictures without a false star and with at most "
    "one bright star in ten missed); centers 20 (share of visible bodies found within "
    f"{GOOD_SIGMAS:g} sigma); estimate 20 (each parameter group within {GOOD_SIGMAS:g} sigma; chi-squared of the fit with "
    f"a probability above {FIT_PROBABILITY:g}; claimed sigmas between {OVERCONFIDENT:g} and {TIMID:g} times what the "
    f"delivered pictures support); B-plane 20 (place and time of arrival within {GOOD_SIGMAS:g} sigma; sharper). "
    "A from 90 points, B 80, C 70, D 60, else F. Whatever the points: at most C when a parameter group or the flyby is more "
    f"than {GOOD_SIGMAS:g} sigma off, or the claimed sigmas are more than {TIMID:g} times too large; at most D when "
    f"anything is claimed of a lost picture, when claimed sigmas are less than {OVERCONFIDENT:g} of what the pictures "
    f"support, when a pointing is off by more than {WRONG_SIGMAS:g} sigma and {BLUNDER_PX:g} px, or when center "
    f"errors are more than {SMALL_CENTER_SIGMAS:g} of their sigmas in the mean; F when a parameter group or the flyby is "
    f"more than {WRONG_SIGMAS:g} sigma off, the claimed sigmas are less than {BOLD:g} of what the pictures support, no "
    "solution is delivered, or a file was changed after the truth was opened."
)

RULE_IN_ORBIT = (
    "In orbit landmarks stand in place of centers and the prediction in place of the B-plane. A picture without stars is "
    "solved where four landmarks or more, or a neighbor's stars, tell its pointing; stars are asked for where eight or more "
    "show. Landmarks 20 (share of the surface's pictures with four or more, at most one in a hundred of them false, their "
    "errors at most twice their sigmas in the mean); prediction 20 (the spacecraft's place at the time asked for within "
    f"{GOOD_SIGMAS:g} sigma; sharper than before). The rest is as of a flyby: "
) + RULE


@dataclass(frozen=True, slots=True)
class GradeSection:
    """Points of one section: `earned` of `possible`, and what cost the others."""

    name: str
    earned: float
    possible: float
    losses: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class GradeCap:
    """What caps the grade at `letter`, whatever the points."""

    letter: str
    words: str


@dataclass(frozen=True, slots=True)
class Grade:
    """The grade: letter, points out of 100, how they come about."""

    letter: str
    points: float
    sections: tuple[GradeSection, ...]
    faults: tuple[GradeCap, ...]

    @property
    def passed(self) -> bool:
        """Whether it is C or better."""
        return self.letter in ("A", "B", "C")


def grade_rehearsal(
    pictures: Sequence[PictureScore],
    solution: SolutionScore | OrbitScore | None,
    altered: Sequence[str],
    *,
    in_orbit: bool = False,
) -> Grade:
    """Grade a rehearsal by `RULE`.

    Parameters
    ----------
    solution
        None: none was delivered.
    altered
        Files that were changed after the truth was opened.
    """
    sections = (
        _picture_section(pictures),
        _pointing_section(pictures),
        _star_section(pictures),
        _landmark_section(pictures) if in_orbit else _center_section(pictures),
        *_solution_sections(solution, "prediction" if in_orbit else "B-plane"),
    )
    faults = (*_picture_faults(pictures), *_solution_faults(solution), *_altered(altered))
    points = sum(section.earned for section in sections)
    letter = next(name for name, least in LETTERS.items() if points >= least)
    letter = max([letter, *(fault.letter for fault in faults)])  # later in the alphabet is worse
    return Grade(letter, points, sections, faults)


def _share_section(name: str, good: Sequence[bool], losses: Sequence[str]) -> GradeSection:
    share = float(np.mean(good)) if len(good) else 0.0
    possible = (SECTIONS | ORBIT_SECTIONS)[name]
    return GradeSection(name, possible * share, possible, tuple(losses))


def _picture_section(pictures: Sequence[PictureScore]) -> GradeSection:
    good = [p.verdict in ("good", "lost, named") for p in pictures]
    losses = [f"{p.name}: {p.verdict}" for p, fine in zip(pictures, good, strict=True) if not fine]
    return _share_section("pictures", good, losses)


def _usable(pictures: Sequence[PictureScore]) -> list[PictureScore]:
    return [p for p in pictures if not p.lost]


def _pointing_section(pictures: Sequence[PictureScore]) -> GradeSection:
    usable = _usable(pictures)
    good = [p.pointing is not None and p.pointing.verdict == "good" for p in usable]
    losses = [
        f"{p.name}: " + ("no pointing" if p.pointing is None else f"{p.pointing.sigmas:.1f} sigma off")
        for p, fine in zip(usable, good, strict=True)
        if not fine
    ]
    return _share_section("pointing", good, losses)


def _star_section(pictures: Sequence[PictureScore]) -> GradeSection:
    usable = [p for p in _usable(pictures) if p.stars_asked]
    if not usable and _usable(pictures):
        return GradeSection("stars", SECTIONS["stars"], SECTIONS["stars"])  # nothing was asked
    losses = [
        f"{p.name}: {p.stars.found} found, {len(p.stars.missed)} missed, {len(p.stars.false)} false"
        for p in usable
        if not p.stars.good
    ]
    return _share_section("stars", [p.stars.good for p in usable], losses)


def _center_section(pictures: Sequence[PictureScore]) -> GradeSection:
    counted, losses = [], []
    for picture in _usable(pictures):
        for center in picture.centers:
            if center.verdict == "absent":
                continue
            counted.append(center.verdict == "good")
            if not counted[-1]:
                off = "" if center.check is None else f", {center.check.sigmas:.1f} sigma off"
                losses.append(f"{center.body} in {picture.name}: {center.verdict}{off}")
    return _share_section("centers", counted, losses)


def _landmark_section(pictures: Sequence[PictureScore]) -> GradeSection:
    asked = [p for p in _usable(pictures) if p.landmarks is not None and p.landmarks.asked]
    good = [p.landmarks is not None and p.landmarks.good for p in asked]
    losses = [
        f"{p.name}: {p.landmarks.accepted} landmarks, {p.landmarks.false} false, errors {p.landmarks.rms_sigmas:.1f} sigma"
        for p, fine in zip(asked, good, strict=True)
        if p.landmarks is not None and not fine
    ]
    return _share_section("landmarks", good, losses)


def _solution_sections(
    solution: SolutionScore | OrbitScore | None, last: str
) -> tuple[GradeSection, GradeSection]:
    if solution is None:
        nothing = ("no solution delivered",)
        return _share_section("estimate", [], nothing), _share_section(last, [], nothing)
    least, largest = solution.sigma_ratio
    checks = [(c.verdict == "good", _off(c)) for c in solution.parameters]
    fit = solution.solution.probability
    checks.append((fit >= FIT_PROBABILITY, f"chi-squared of the fit has a probability of {fit:.1g}"))
    believable = bool(least >= OVERCONFIDENT and largest <= TIMID)
    words = f"claimed sigmas are {least:.2g} to {largest:.2g} times what the pictures support"
    checks.append((believable, solution.remark or words))
    after, before = (np.diag(matrix) for matrix in _sharpened(solution))
    sharper = bool(np.prod(after / before) < 1.0)
    flight = [(c.verdict == "good", _off(c)) for c in _asked_of(solution)]
    flight.append((sharper, f"{last} no sharper than before"))
    return _listed_section("estimate", checks), _listed_section(last, flight)


def _asked_of(solution: SolutionScore | OrbitScore) -> tuple[TruthCheck, ...]:
    """Return what the parameters are for: flyby, or place at a later time."""
    return (
        (solution.b_plane, solution.arrival)
        if isinstance(solution, SolutionScore)
        else (solution.prediction,)
    )


def _sharpened(solution: SolutionScore | OrbitScore) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of that, after and before."""
    if isinstance(solution, SolutionScore):
        return solution.solution.b_plane_covariance, solution.solution.b_plane_covariance_before
    return solution.solution.place_covariance_km2, solution.solution.place_covariance_before_km2


def _listed_section(name: str, checks: Sequence[tuple[bool, str]]) -> GradeSection:
    return _share_section(name, [good for good, _ in checks], [words for good, words in checks if not good])


def _off(check: TruthCheck) -> str:
    return f"{check.name.replace('_', ' ')} is {check.sigmas:.1f} sigma off"


def _picture_faults(pictures: Sequence[PictureScore]) -> list[GradeCap]:
    faults = [
        GradeCap("D", f"{p.name} is lost ({p.lost}), and a result is claimed of it")
        for p in pictures
        if p.verdict == "claimed though lost"
    ]
    for p in pictures:
        if p.pointing is not None and p.pointing.verdict == "wrong":
            off = float(np.hypot(*p.pointing.error[:2]))
            if off > BLUNDER_PX:
                faults.append(
                    GradeCap("D", f"{p.name}: pointing {off:.1f} px off, {p.pointing.sigmas:.0f} sigma")
                )
    rms, probability = center_scatter(pictures)
    if rms > SMALL_CENTER_SIGMAS and probability < CENTER_PROBABILITY:
        faults.append(
            GradeCap("D", f"center errors are {rms:.1f} of their sigmas in the mean: sigmas far too small")
        )
    return faults


def center_scatter(pictures: Sequence[PictureScore]) -> tuple[float, float]:
    """Return the rms of all center errors in their own sigmas, and the probability of so much; nan without centers."""
    errors = [c.check.component_sigmas for p in pictures for c in p.centers if c.check is not None]
    if not errors:
        return float("nan"), float("nan")
    squares = np.concatenate(errors) ** 2
    return float(np.sqrt(squares.mean())), float(chdtrc(len(squares), squares.sum()))


def _solution_faults(solution: SolutionScore | OrbitScore | None) -> list[GradeCap]:
    if solution is None:
        return [GradeCap("F", "no solution delivered")]
    faults = [
        GradeCap("F" if c.verdict == "wrong" else "C", _off(c))
        for c in (*solution.parameters, *_asked_of(solution))
        if c.verdict != "good"
    ]
    least, largest = solution.sigma_ratio
    if least < OVERCONFIDENT:
        letter = "F" if least < BOLD else "D"
        faults.append(
            GradeCap(letter, f"claimed sigmas are down to {least:.2g} of what the pictures support")
        )
    if largest > TIMID:
        faults.append(
            GradeCap("C", f"claimed sigmas are up to {largest:.2g} times what the pictures support")
        )
    return faults


def _altered(files: Sequence[str]) -> list[GradeCap]:
    return [GradeCap("F", f"changed after the truth was opened: {', '.join(files)}")] if files else []


# ---- The score of a rehearsal: everything that a team delivered, held against the truth.


@dataclass(frozen=True, slots=True, eq=False)
class OrtScore:
    """The score of a rehearsal.

    Attributes
    ----------
    perturbed
        What was wrong on purpose, in words.
    pictures
        In the order in which they were taken.
    delivery
        What had been delivered when the truth was opened.
    center_scatter : (float, float)
        Rms of the center errors in their own sigmas, and the probability of so much.
    altered_package
        Empty: `open_rehearsal` refuses a package that is not as it was made. The score's file has the field.
    """

    package: str
    title: str
    perturbed: tuple[str, ...]
    pictures: tuple[PictureScore, ...]
    solution: SolutionScore | OrbitScore | None
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
    solution: OrtSolution | OrbitSolution | None,
    *,
    delivery: Delivery | None = None,
) -> OrtScore:
    """Hold what a team delivered against the truth, and grade it by `RULE` (in orbit by `RULE_IN_ORBIT`).

    Parameters
    ----------
    truth
        From `reveal`.
    results
        Folder of the pictures' folders.
    delivery
        What was written down before the truth was opened (`logged_delivery`).

    Raises
    ------
    SessionError
        The results cannot be read, or the solution is of another rehearsal.
    """
    mission = load_mission(package.mission)
    cameras = {c.name: c for c in (Camera.from_yaml(choice.file) for choice in mission.cameras)}
    reported = picture_results((p.name for p in package.pictures), results)
    flyby = solution if isinstance(solution, OrtSolution) else None
    disk_sigma_px = 0.0 if flyby is None else flyby.disk_sigma_px
    pictures = tuple(
        _score_one_picture(package, truth, picture, found, cameras, disk_sigma_px)
        for picture, found in zip(package.pictures, reported, strict=True)
    )
    in_orbit = package.orbit is not None
    if solution is not None and in_orbit == (flyby is not None):
        raise SessionError(
            f"{package.name}: the solution is of a rehearsal of another kind, a flyby or an orbit."
        )
    scored: SolutionScore | OrbitScore | None = None
    if in_orbit:
        orbit = solution if not isinstance(solution, OrtSolution) else None
        pictures = pictures_in_orbit(package, truth, reported, pictures, orbit)
        scored = None if orbit is None else score_orbit(package, truth, results, orbit)
    elif flyby is not None:
        scored = score_solution(package, truth, results, flyby)
    altered = () if delivery is None else delivery.altered
    return OrtScore(
        package=package.name,
        title=package.title,
        perturbed=tuple(truth.words),
        pictures=pictures,
        solution=scored,
        grade=grade_rehearsal(pictures, scored, altered, in_orbit=in_orbit),
        delivery=delivery,
        center_scatter=center_scatter(pictures),
        rule=RULE_IN_ORBIT if in_orbit else RULE,
    )


def _score_one_picture(
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
