"""Answers of students judged: right, not yet with a hint, or not answered; the expected value is never shown."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.widgets.workbench_html import text

__all__ = ["NOT_ANSWERED", "NOT_YET", "RIGHT", "Slip", "Verdict", "check", "check_claim", "check_function"]

RIGHT, NOT_YET, NOT_ANSWERED = "right", "not yet", "not answered"
ROUNDING = 1e-9  # relative; a tolerance of 0 still means equal numbers
# Colours of Okabe & Ito with a sign each, so that colour is never the only sign.
LOOKS = {RIGHT: ("#009E73", "✓"), NOT_YET: ("#D55E00", "✗"), NOT_ANSWERED: ("#8FA3B5", "○")}
# Units that are mixed up most often; an answer off by such a factor is told so.
UNIT_FACTORS = (
    (np.degrees(1.0), "radians and degrees"),
    (np.degrees(1.0) * 3600.0, "radians and arcseconds"),
    (3600.0, "degrees and arcseconds"),
    (60.0, "minutes and seconds"),
    (1e3, "a prefix of 1000 (m and km, mm and µm)"),
    (1e6, "a prefix of a million (µrad and rad)"),
)

Slip = tuple[Any, str]  # a wrong answer that is often given, and the hint it deserves


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is said of an answer; a notebook shows it as a coloured line.

    Attributes
    ----------
    name : str
        Of the exercise.
    state : {"right", "not yet", "not answered"}
    message : str
        A hint, or why the answer is right.
    """

    name: str
    state: str
    message: str = ""

    @property
    def is_right(self) -> bool:
        """True for a right answer."""
        return self.state == RIGHT

    def __str__(self) -> str:
        return f"Exercise {self.name}: {self.state}. {self.message}".rstrip()

    __repr__ = __str__

    def _repr_html_(self) -> str:
        color, sign = LOOKS[self.state]
        return (
            f'<div style="border-left:5px solid {color};background:{color}1c;padding:0.5em 0.9em;margin:0.3em 0" '
            f'role="status"><b>{sign} Exercise {text(self.name)}: {self.state}.</b> {text(self.message)}</div>'
        )


def check(
    name: str,
    answer: Any,
    expected: ArrayLike | str | bool,
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    hint: str = "",
    slips: Iterable[Slip] = (),
    why: str = "",
) -> Verdict:
    """Compare an answer with the expected one.

    Parameters
    ----------
    name : str
        Of the exercise, such as ``1.2``.
    answer : number, array, text, bool or None
        None, or an array with None in it, is not answered.
    expected : number, array, text or bool
        Texts are compared without case and surrounding blanks.
    tolerance : float
        Largest absolute difference of any element, in the unit of the answer.
    relative : float
        The same as a share of the largest expected element; the wider of both counts.
    hint : str
        Said of a wrong answer that explains itself in no other way.
    slips : iterable of (wrong answer, hint)
        Mistakes that are often made.
    why : str
        Said of a right answer.

    Examples
    --------
    >>> check("1.1", None, 4.1)
    Exercise 1.1: not answered. Put your answer in place of None and run both cells.
    >>> check("1.1", 4.095, 4.1, tolerance=0.01)
    Exercise 1.1: right.
    >>> check("1.1", -4.1, 4.1, tolerance=0.01, hint="Divide by the focal length.")
    Exercise 1.1: not yet. The size is right, the sign is not.
    """
    if _is_missing(answer):
        return Verdict(name, NOT_ANSWERED, "Put your answer in place of None and run both cells.")
    if isinstance(expected, str | bool):
        return _check_word(name, answer, expected, hint, slips, why)
    wanted = np.asarray(expected, dtype=np.float64)
    given, fault = _numbers(answer, wanted)
    if given is None:
        return Verdict(name, NOT_YET, fault)
    allowed = _allowed(wanted, tolerance, relative)
    if _agree(given, wanted, allowed):
        return Verdict(name, RIGHT, why)
    for value, words in slips:
        mistaken = np.asarray(value, dtype=np.float64)
        if _agree(given, mistaken, _allowed(mistaken, tolerance, relative)):
            return Verdict(name, NOT_YET, words)
    return Verdict(name, NOT_YET, _diagnosis(given, wanted, allowed) or hint or "Look again.")


def check_function(
    name: str,
    function: Callable[..., Any],
    reference: Callable[..., Any],
    cases: Sequence[tuple[Any, ...]],
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    hint: str = "",
    slips: Iterable[tuple[Callable[..., Any], str]] = (),
    why: str = "",
) -> Verdict:
    """Run a student's function on several inputs and compare it with a reference.

    Parameters
    ----------
    name, tolerance, relative, hint, why
        As in `check`.
    function : callable
        The student's; one that returns None is not answered, one that raises is told its exception.
    reference : callable
        Takes the same arguments.
    cases : sequence of tuple
        Arguments of each call.
    slips : iterable of (callable, hint)
        Functions that are often written in place of the right one.

    Examples
    --------
    >>> cases = [(1.0,), (2.0,)]
    >>> check_function("1.2", lambda x: x + x, lambda x: 2 * x, cases)
    Exercise 1.2: right.
    >>> check_function("1.2", lambda x: x**3, lambda x: 2 * x, cases, hint="A straight line.")
    Exercise 1.2: not yet. Call 1 of 2: A straight line.
    """
    wrong = tuple(slips)
    for number, case in enumerate(cases, start=1):
        try:
            answer = function(*case)
        except Exception as error:  # whatever a student's function raises is for the student to read
            return Verdict(name, NOT_YET, f"The function raises {type(error).__name__}: {error}")
        if _is_missing(answer):
            return Verdict(
                name, NOT_ANSWERED, "The function returns None: write its body and run both cells."
            )
        told = [(slip(*case), words) for slip, words in wrong]
        verdict = check(
            name,
            answer,
            reference(*case),
            tolerance=tolerance,
            relative=relative,
            hint=hint,
            slips=told,
        )
        if not verdict.is_right:
            return Verdict(name, NOT_YET, f"Call {number} of {len(cases)}: {verdict.message}")
    return Verdict(name, RIGHT, why)


def check_claim(name: str, answer: Any, judge: Callable[[Any], str], *, why: str = "") -> Verdict:
    """Judge an answer of which there are many right ones.

    Parameters
    ----------
    judge : callable
        Takes the answer and returns the hint, "" if it is right; what it raises is told as a hint, too.

    Examples
    --------
    >>> check_claim("4.2", [1, 2], lambda scans: "" if len(scans) > 2 else "Three at least.")
    Exercise 4.2: not yet. Three at least.
    """
    if _is_missing(answer):
        return check(name, None, 0.0)
    try:
        words = judge(answer)
    except Exception as error:  # an answer of the wrong kind, in whatever way
        words = f"That cannot be judged ({type(error).__name__}: {error})."
    return Verdict(name, NOT_YET, words) if words else Verdict(name, RIGHT, why)


def _is_missing(answer: Any) -> bool:
    if isinstance(answer, dict):
        return any(_is_missing(value) for value in answer.values())
    if isinstance(answer, list | tuple):
        return any(_is_missing(value) for value in answer)
    return answer is None or answer is Ellipsis


def _check_word(
    name: str, answer: Any, expected: str | bool, hint: str, slips: Iterable[Slip], why: str
) -> Verdict:
    def plain(value: Any) -> str:
        return str(value).strip().casefold()

    if plain(answer) == plain(expected):
        return Verdict(name, RIGHT, why)
    told = [words for value, words in slips if plain(value) == plain(answer)]
    return Verdict(name, NOT_YET, told[0] if told else hint or "Look again.")


def _numbers(answer: Any, wanted: FloatArray) -> tuple[FloatArray | None, str]:
    """Return the answer as an array of the wanted shape, or None and what is wrong with it."""
    try:
        given = np.asarray(getattr(answer, "value", answer), dtype=np.float64)
    except (TypeError, ValueError):
        kind = "a number" if wanted.ndim == 0 else "numbers"
        return None, f"Give {kind}, not {type(answer).__name__}."
    if wanted.ndim == 0 and given.size == 1:
        given = given.reshape(())
    if given.shape != wanted.shape:
        return None, f"The answer has shape {given.shape}, asked for is {wanted.shape or 'one number'}."
    if not np.isfinite(given).all():
        return None, "The answer holds values that are not finite."
    return given, ""


def _allowed(wanted: FloatArray, tolerance: float, relative: float) -> float:
    size = float(np.max(np.abs(wanted), initial=0.0))
    return max(tolerance, max(relative, ROUNDING) * size)


def _agree(given: FloatArray, wanted: FloatArray, allowed: float) -> bool:
    return wanted.shape == given.shape and bool(np.all(np.abs(given - wanted) <= allowed))


def _diagnosis(given: FloatArray, wanted: FloatArray, allowed: float) -> str:
    """Return what explains the difference, "" if nothing does."""
    if _agree(-given, wanted, allowed):
        return "The size is right, the sign is not."
    if wanted.shape == (2,) and _agree(given[::-1], wanted, allowed):
        return "Both numbers are right, but in the other order."
    for factor, units in UNIT_FACTORS:
        if _agree(given * factor, wanted, allowed) or _agree(given / factor, wanted, allowed):
            return f"Off by the factor between {units}."
    return ""
