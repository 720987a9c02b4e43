"""Lessons: notebooks with exercises, whose answers are judged without telling the right one.

A lesson's notebook makes one `Lesson`, shows its figures through it and has each answer judged:

    lesson = Lesson("1 Pixels and pointing", out)
    answer_1 = None  # the student's cell
    lesson.check("1.1", answer_1, expected=camera.pixel_scale_rad, relative=0.01, hint="...")

An answer is right, not yet right (with a hint: sign, order, a mixed-up unit, a mistake often made), or not answered. Not
answered is a judgement, no exception, so that a lesson runs headless as it stands. Figures follow sliders where a person
sits at the front end; headless they are still pictures.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.files import atomic_path, make_folder, write_json
from opnav_workbench.report.drawing import png_bytes
from opnav_workbench.templating import png_url
from opnav_workbench.workbench.markup import render

__all__ = ["NOT_ANSWERED", "NOT_YET", "RIGHT", "Lesson", "check", "check_claim", "check_function"]


# ---- Answers of students judged: right, not yet with a hint, or not answered; the expected value is never told.

RIGHT, NOT_YET, NOT_ANSWERED = "right", "not yet", "not answered"
ROUNDING = 1e-9  # relative; a tolerance of 0 still means equal numbers
# Colours of Okabe & Ito with a sign each, so that colour is never the only sign.
FEEDBACK_STYLES = {RIGHT: ("#009E73", "✓"), NOT_YET: ("#D55E00", "✗"), NOT_ANSWERED: ("#8FA3B5", "○")}
# Units that are mixed up most often; an answer off by such a factor is told so.
UNIT_FACTORS = (
    (np.degrees(1.0), "radians and degrees"),
    (np.degrees(1.0) * 3600.0, "radians and arcseconds"),
    (3600.0, "degrees and arcseconds"),
    (60.0, "minutes and seconds"),
    (1e3, "a prefix of 1000 (m and km, mm and µm)"),
    (1e6, "a prefix of a million (µrad and rad)"),
)

CommonMistake = tuple[Any, str]  # a wrong answer that is often given, and the hint it deserves


@dataclass(frozen=True, slots=True)
class Feedback:
    """What is said of an answer; a notebook shows it as a coloured line.

    Attributes
    ----------
    name
        Of the exercise.
    state : {"right", "not yet", "not answered"}
    message
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
        color, sign = FEEDBACK_STYLES[self.state]
        return render("lesson_feedback.html", feedback=self, color=color, sign=sign)


def check(
    name: str,
    answer: Any,
    expected: ArrayLike | str | bool,
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    hint: str = "",
    slips: Iterable[CommonMistake] = (),
    why: str = "",
) -> Feedback:
    """Compare an answer with the expected one.

    Parameters
    ----------
    name
        Of the exercise, such as ``1.2``.
    answer : number, array, text, bool or None
        None, or an array with None in it, is not answered.
    expected : number, array, text or bool
        Texts are compared without case and surrounding blanks.
    tolerance
        Largest absolute difference of any element, in the unit of the answer.
    relative
        The same as a share of the largest expected element; the wider of both counts.
    hint
        Said of a wrong answer that explains itself in no other way.
    slips : iterable of (wrong answer, hint)
        Mistakes that are often made.
    why
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
        return Feedback(name, NOT_ANSWERED, "Put your answer in place of None and run both cells.")
    if isinstance(expected, str | bool):
        return _check_word(name, answer, expected, hint, slips, why)
    wanted = np.asarray(expected, dtype=np.float64)
    given, fault = _numbers(answer, wanted)
    if given is None:
        return Feedback(name, NOT_YET, fault)
    allowed = _allowed(wanted, tolerance, relative)
    if _agree(given, wanted, allowed):
        return Feedback(name, RIGHT, why)
    for value, words in slips:
        mistaken = np.asarray(value, dtype=np.float64)
        if _agree(given, mistaken, _allowed(mistaken, tolerance, relative)):
            return Feedback(name, NOT_YET, words)
    return Feedback(name, NOT_YET, _diagnosis(given, wanted, allowed) or hint or "Look again.")


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
) -> Feedback:
    """Run a student's function on several inputs and compare it with a reference.

    Parameters
    ----------
    name, tolerance, relative, hint, why
        As in `check`.
    function
        The student's; one that returns None is not answered, one that raises is told its exception.
    reference
        Takes the same arguments.
    cases
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
            return Feedback(name, NOT_YET, f"The function raises {type(error).__name__}: {error}")
        if _is_missing(answer):
            return Feedback(
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
            return Feedback(name, NOT_YET, f"Call {number} of {len(cases)}: {verdict.message}")
    return Feedback(name, RIGHT, why)


def check_claim(name: str, answer: Any, judge: Callable[[Any], str], *, why: str = "") -> Feedback:
    """Judge an answer of which there are many right ones.

    Parameters
    ----------
    judge
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
    return Feedback(name, NOT_YET, words) if words else Feedback(name, RIGHT, why)


def _is_missing(answer: Any) -> bool:
    if isinstance(answer, dict):
        return any(_is_missing(value) for value in answer.values())
    if isinstance(answer, list | tuple):
        return any(_is_missing(value) for value in answer)
    return answer is None or answer is Ellipsis


def _check_word(
    name: str, answer: Any, expected: str | bool, hint: str, slips: Iterable[CommonMistake], why: str
) -> Feedback:
    def plain(value: Any) -> str:
        return str(value).strip().casefold()

    if plain(answer) == plain(expected):
        return Feedback(name, RIGHT, why)
    told = [words for value, words in slips if plain(value) == plain(answer)]
    return Feedback(name, NOT_YET, told[0] if told else hint or "Look again.")


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


# ---- Figures of lessons with their captions, and figures that follow sliders where a person can move them.

SliderValues = Mapping[str, tuple[Sequence[Any], Any]]  # by name: what a slider may take, and where it starts


@dataclass(frozen=True, slots=True)
class LessonFigure:
    """A figure with its caption, as a notebook shows it."""

    png: bytes
    caption: str

    def __repr__(self) -> str:
        return f"[figure] {self.caption}"

    def _repr_html_(self) -> str:
        return render("lesson_figure.html", picture=png_url(self.png), caption=self.caption)


class SliderFigure:
    """A figure that is drawn anew when a slider moves; without a person it is the first figure.

    Parameters
    ----------
    draw
        Takes the sliders' values by name, returns a matplotlib figure.
    values : mapping of str to (choices, start)
        What each slider may take, and where it starts.
    live
        With sliders; a still picture without.
    """

    def __init__(
        self, draw: Callable[..., Figure], caption: str, values: SliderValues, *, live: bool
    ) -> None:
        for name, (choices, start) in values.items():
            if start not in list(choices):
                raise ValueError(f"slider {name!r} starts at {start}, which is not among its choices")
        self._draw, self.values = draw, values
        self.still = LessonFigure(self.png(**{name: start for name, (_, start) in values.items()}), caption)
        self.sliders: dict[str, Any] = {}
        self._widget = self._make_widget() if live else None

    def png(self, **values: Any) -> bytes:
        """Draw the figure for given values."""
        figure = self._draw(**values)
        picture = png_bytes(figure)
        figure.clear()
        return picture

    def _make_widget(self) -> Any:
        import ipywidgets  # noqa: PLC0415 - only where there is a person

        shown = ipywidgets.Image(value=self.still.png, format="png", layout={"max_width": "1000px"})
        for name, (choices, start) in self.values.items():
            options = [(_label(choice), choice) for choice in choices]
            self.sliders[name] = ipywidgets.SelectionSlider(
                options=options,
                value=start,
                description=name.replace("_", " "),
                continuous_update=False,
                style={"description_width": "initial"},
                layout={"width": "420px"},
            )

        def redraw(_: Any) -> None:
            shown.value = self.png(**{name: slider.value for name, slider in self.sliders.items()})

        for slider in self.sliders.values():
            slider.observe(redraw, names="value")
        caption = ipywidgets.HTML(Markup("<em>{}</em>").format(self.still.caption))
        return ipywidgets.VBox([*self.sliders.values(), shown, caption])

    def __repr__(self) -> str:
        return repr(self.still)

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        still = {"text/plain": repr(self.still), "text/html": self.still._repr_html_()}
        if self._widget is None:
            return still
        bundle = self._widget._repr_mimebundle_(**kwargs)
        data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
        return dict(data) | still, metadata


def is_attended() -> bool:
    """Tell whether a person sits at the front end of this kernel.

    JupyterLab and its like let a running cell ask its user for input and say so in every request; papermill and
    nbconvert do not.
    """
    from IPython import get_ipython  # noqa: PLC0415 - only in a notebook

    shell = get_ipython()
    request = shell.get_parent() if hasattr(shell, "get_parent") else None
    return bool(((request or {}).get("content") or {}).get("allow_stdin", False))


def _label(choice: Any) -> str:
    # + 0 makes a negative zero an ordinary one
    return f"{choice + 0:g}" if isinstance(choice, int | float | np.number) else str(choice)


# ---- The lesson: its figures, its exercises and what was said of the answers.

VERDICTS_FILE = "verdicts.json"


class Lesson:
    """One lesson: its figures, its exercises and what was said of the answers.

    Parameters
    ----------
    out : path-like
        Folder for figures and ``verdicts.json``; made where it does not stand.
    answers
        Answers by the exercise's name, which come before the student's: a teacher runs the lesson headless with them.
        The answer to an exercise that asks for a function is the source text of one.

    Raises
    ------
    SessionError
        The folder cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> lesson = Lesson("2 + 2", tempfile.mkdtemp())
    >>> lesson.check("1", 5, 4, hint="Count with your fingers.")
    Exercise 1: not yet. Count with your fingers.
    >>> lesson.check("1", 4, 4)
    Exercise 1: right.
    >>> lesson.summary()
    2 + 2: 1 of 1 right
    """

    def __init__(self, title: str, out: str | Path, answers: Mapping[str, Any] | None = None) -> None:
        self.title, self.out = title, make_folder(out)
        self.answers = dict(answers or {})
        self.verdicts: dict[str, Feedback] = {}

    def check(self, name: str, answer: Any, expected: Any, **options: Any) -> Feedback:
        """Judge a number, an array, a text or a bool; see `lessons.check`."""
        return self._keep(check(name, self.answers.get(name, answer), expected, **options))

    def check_claim(self, name: str, answer: Any, judge: Callable[[Any], str], **options: Any) -> Feedback:
        """Judge an answer of which there are many right ones; see `lessons.check_claim`."""
        return self._keep(check_claim(name, self.answers.get(name, answer), judge, **options))

    def check_function(
        self,
        name: str,
        function: Callable[..., Any],
        reference: Callable[..., Any],
        cases: Any,
        **options: Any,
    ) -> Feedback:
        """Judge a function; see `lessons.check_function`."""
        if name in self.answers:
            function = _function(self.answers[name])
        return self._keep(check_function(name, function, reference, cases, **options))

    def figure(self, figure: Figure, name: str, caption: str) -> LessonFigure:
        """Keep a figure as ``NAME.png`` and return it with its caption, to be displayed."""
        picture = LessonFigure(png_bytes(figure), caption)
        self._write_png(name, picture)
        figure.clear()
        return picture

    def explore(
        self, draw: Callable[..., Figure], name: str, caption: str, *, live: bool | None = None, **values: Any
    ) -> SliderFigure:
        """Return a figure with a slider for each of `values` (choices, start), or the first figure headless.

        Parameters
        ----------
        draw
            Takes the sliders' values by name, returns a figure.
        name, caption
            As in `figure`.
        live
            With sliders or without; by default whether a person sits there.
        """
        shown = SliderFigure(draw, caption, values, live=is_attended() if live is None else live)
        self._write_png(name, shown.still)
        return shown

    def summary(self) -> "Summary":
        """Return the verdicts so far, to be displayed, and keep them in ``verdicts.json``."""
        made = Summary(self.title, tuple(self.verdicts.values()))
        rows = [{"exercise": v.name, "state": v.state, "message": v.message} for v in made.verdicts]
        write_json(self.out / VERDICTS_FILE, {"lesson": self.title, "right": made.right, "exercises": rows})
        return made

    def _keep(self, verdict: Feedback) -> Feedback:
        self.verdicts[verdict.name] = verdict
        return verdict

    def _write_png(self, name: str, picture: LessonFigure) -> None:
        with atomic_path(self.out / f"{name}.png") as temporary:
            temporary.write_bytes(picture.png)


class Summary:
    """The verdicts of a lesson, as a notebook shows them."""

    def __init__(self, title: str, verdicts: tuple[Feedback, ...]) -> None:
        self.title, self.verdicts = title, verdicts

    @property
    def right(self) -> int:
        """How many answers are right."""
        return sum(verdict.state == RIGHT for verdict in self.verdicts)

    def __repr__(self) -> str:
        return f"{self.title}: {self.right} of {len(self.verdicts)} right"

    def _repr_html_(self) -> str:
        not_answered = [verdict.name for verdict in self.verdicts if verdict.state == NOT_ANSWERED]
        return render("lesson_summary.html", title=self, verdicts=self.verdicts, not_answered=not_answered)


def _function(source: Any) -> Callable[..., Any]:
    """Return the function that a source text defines last; anything else answers nothing."""
    if callable(source):
        return source  # type: ignore[no-any-return]
    names: dict[str, Any] = {"np": np}
    exec(str(source), names)  # noqa: S102 - a teacher's own answer, in the teacher's own notebook
    made = [value for key, value in names.items() if callable(value) and not key.startswith("_")]
    return made[-1] if made else lambda *_: None
