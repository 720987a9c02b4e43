"""The grade of a rehearsal: points by section, and faults that no points make good.

The rule, in the words of the report, is `RULE`; the numbers in it are the constants below.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from opnav_workbench.rehearsal.ort_score_check import GOOD_SIGMAS, WRONG_SIGMAS, Check
from opnav_workbench.rehearsal.ort_score_pictures import PictureScore
from opnav_workbench.rehearsal.ort_score_solution import SolutionScore

__all__ = ["RULE", "SECTIONS", "Fault", "Grade", "Section", "grade"]

LETTERS = {"A": 90.0, "B": 80.0, "C": 70.0, "D": 60.0, "F": 0.0}
SECTIONS = {
    "pictures": 15.0,
    "pointing": 15.0,
    "stars": 10.0,
    "centers": 20.0,
    "estimate": 20.0,
    "B-plane": 20.0,
}
# Claimed sigma over the one that the pictures support, in the worst direction.
OVERCONFIDENT, BOLD = 0.5, 0.25
TIMID = 3.0  # the same, the other way: a solution that hides behind its sigmas
FIT_PROBABILITY = 1e-3
SMALL_CENTER_SIGMAS, CENTER_PROBABILITY = (
    2.0,
    1e-4,
)  # rms of center errors in sigmas, and that it is no chance
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


@dataclass(frozen=True, slots=True)
class Section:
    """Points of one section: `earned` of `possible`, and what cost the others."""

    name: str
    earned: float
    possible: float
    losses: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Fault:
    """What caps the grade at `letter`, whatever the points."""

    letter: str
    words: str


@dataclass(frozen=True, slots=True)
class Grade:
    """The grade: letter, points out of 100, how they come about."""

    letter: str
    points: float
    sections: tuple[Section, ...]
    faults: tuple[Fault, ...]

    @property
    def passed(self) -> bool:
        """Whether it is C or better."""
        return self.letter in ("A", "B", "C")


def grade(pictures: Sequence[PictureScore], solution: SolutionScore | None, altered: Sequence[str]) -> Grade:
    """Grade a rehearsal by `RULE`.

    Parameters
    ----------
    pictures : sequence of PictureScore
    solution : SolutionScore or None
        None: none was delivered.
    altered : sequence of str
        Files that were changed after the truth was opened.
    """
    sections = (
        _pictures(pictures),
        _pointing(pictures),
        _stars(pictures),
        _centers(pictures),
        *_solution(solution),
    )
    faults = (*_picture_faults(pictures), *_solution_faults(solution), *_altered(altered))
    points = sum(section.earned for section in sections)
    letter = next(name for name, least in LETTERS.items() if points >= least)
    letter = max([letter, *(fault.letter for fault in faults)])  # later in the alphabet is worse
    return Grade(letter, points, sections, faults)


def _section(name: str, good: Sequence[bool], losses: Sequence[str]) -> Section:
    share = float(np.mean(good)) if len(good) else 0.0
    return Section(name, SECTIONS[name] * share, SECTIONS[name], tuple(losses))


def _pictures(pictures: Sequence[PictureScore]) -> Section:
    good = [p.verdict in ("good", "lost, named") for p in pictures]
    losses = [f"{p.name}: {p.verdict}" for p, fine in zip(pictures, good, strict=True) if not fine]
    return _section("pictures", good, losses)


def _usable(pictures: Sequence[PictureScore]) -> list[PictureScore]:
    return [p for p in pictures if not p.lost]


def _pointing(pictures: Sequence[PictureScore]) -> Section:
    usable = _usable(pictures)
    good = [p.pointing is not None and p.pointing.verdict == "good" for p in usable]
    losses = [
        f"{p.name}: " + ("no pointing" if p.pointing is None else f"{p.pointing.sigmas:.1f} sigma off")
        for p, fine in zip(usable, good, strict=True)
        if not fine
    ]
    return _section("pointing", good, losses)


def _stars(pictures: Sequence[PictureScore]) -> Section:
    usable = _usable(pictures)
    losses = [
        f"{p.name}: {p.stars.found} found, {len(p.stars.missed)} missed, {len(p.stars.false)} false"
        for p in usable
        if not p.stars.good
    ]
    return _section("stars", [p.stars.good for p in usable], losses)


def _centers(pictures: Sequence[PictureScore]) -> Section:
    counted, losses = [], []
    for picture in _usable(pictures):
        for center in picture.centers:
            if center.verdict == "absent":
                continue
            counted.append(center.verdict == "good")
            if not counted[-1]:
                off = "" if center.check is None else f", {center.check.sigmas:.1f} sigma off"
                losses.append(f"{center.body} in {picture.name}: {center.verdict}{off}")
    return _section("centers", counted, losses)


def _solution(solution: SolutionScore | None) -> tuple[Section, Section]:
    if solution is None:
        nothing = ("no solution delivered",)
        return _section("estimate", [], nothing), _section("B-plane", [], nothing)
    least, largest = solution.sigma_ratio
    checks = [(c.verdict == "good", _off(c)) for c in solution.parameters]
    fit = solution.solution.probability
    checks.append((fit >= FIT_PROBABILITY, f"chi-squared of the fit has a probability of {fit:.1g}"))
    believable = bool(least >= OVERCONFIDENT and largest <= TIMID)
    words = f"claimed sigmas are {least:.2g} to {largest:.2g} times what the pictures support"
    checks.append((believable, solution.remark or words))
    before = np.diag(solution.solution.b_plane_covariance_before)
    sharper = bool(np.prod(np.diag(solution.solution.b_plane_covariance) / before) < 1.0)
    flight = [(c.verdict == "good", _off(c)) for c in (solution.b_plane, solution.arrival)]
    flight.append((sharper, "B-plane no sharper than before"))
    return _listed("estimate", checks), _listed("B-plane", flight)


def _listed(name: str, checks: Sequence[tuple[bool, str]]) -> Section:
    return _section(name, [good for good, _ in checks], [words for good, words in checks if not good])


def _off(check: Check) -> str:
    return f"{check.name.replace('_', ' ')} is {check.sigmas:.1f} sigma off"


def _picture_faults(pictures: Sequence[PictureScore]) -> list[Fault]:
    faults = [
        Fault("D", f"{p.name} is lost ({p.lost}), and a result is claimed of it")
        for p in pictures
        if p.verdict == "claimed though lost"
    ]
    for p in pictures:
        if p.pointing is not None and p.pointing.verdict == "wrong":
            off = float(np.hypot(*p.pointing.error[:2]))
            if off > BLUNDER_PX:
                faults.append(
                    Fault("D", f"{p.name}: pointing {off:.1f} px off, {p.pointing.sigmas:.0f} sigma")
                )
    rms, probability = center_scatter(pictures)
    if rms > SMALL_CENTER_SIGMAS and probability < CENTER_PROBABILITY:
        faults.append(
            Fault("D", f"center errors are {rms:.1f} of their sigmas in the mean: sigmas far too small")
        )
    return faults


def center_scatter(pictures: Sequence[PictureScore]) -> tuple[float, float]:
    """Return the rms of all center errors in their own sigmas, and the probability of so much; nan without centers."""
    errors = [c.check.component_sigmas for p in pictures for c in p.centers if c.check is not None]
    if not errors:
        return float("nan"), float("nan")
    squares = np.concatenate(errors) ** 2
    return float(np.sqrt(squares.mean())), float(chdtrc(len(squares), squares.sum()))


def _solution_faults(solution: SolutionScore | None) -> list[Fault]:
    if solution is None:
        return [Fault("F", "no solution delivered")]
    faults = [
        Fault("F" if c.verdict == "wrong" else "C", _off(c))
        for c in (*solution.parameters, solution.b_plane, solution.arrival)
        if c.verdict != "good"
    ]
    least, largest = solution.sigma_ratio
    if least < OVERCONFIDENT:
        letter = "F" if least < BOLD else "D"
        faults.append(Fault(letter, f"claimed sigmas are down to {least:.2g} of what the pictures support"))
    if largest > TIMID:
        faults.append(Fault("C", f"claimed sigmas are up to {largest:.2g} times what the pictures support"))
    return faults


def _altered(files: Sequence[str]) -> list[Fault]:
    return [Fault("F", f"changed after the truth was opened: {', '.join(files)}")] if files else []
