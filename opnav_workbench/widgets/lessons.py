"""Lessons: notebooks with exercises, whose answers are judged without telling the right one.

A lesson's notebook makes one `Lesson`, shows its figures through it and has each answer judged:

    lesson = Lesson("1 Pixels and pointing", out)
    answer_1 = None  # the student's cell
    lesson.check("1.1", answer_1, expected=camera.pixel_scale_rad, relative=0.01, hint="...")

An unanswered exercise is a verdict, no exception, so that a lesson runs headless as it stands.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from opnav_workbench.files import atomic_path, make_folder, write_json
from opnav_workbench.report.png import png_bytes
from opnav_workbench.widgets.lesson_checks import (
    NOT_ANSWERED,
    RIGHT,
    Verdict,
    check,
    check_claim,
    check_function,
)
from opnav_workbench.widgets.lesson_pictures import Exploration, Picture, has_person
from opnav_workbench.widgets.workbench_html import text

__all__ = ["Lesson", "Verdict", "check", "check_claim", "check_function"]

VERDICTS_FILE = "verdicts.json"


class Lesson:
    """One lesson: its figures, its exercises and what was said of the answers.

    Parameters
    ----------
    title : str
    out : path-like
        Folder for figures and ``verdicts.json``; made where it does not stand.
    answers : mapping, optional
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
        self.verdicts: dict[str, Verdict] = {}

    def check(self, name: str, answer: Any, expected: Any, **options: Any) -> Verdict:
        """Judge a number, an array, a text or a bool; see `lesson_checks.check`."""
        return self._keep(check(name, self.answers.get(name, answer), expected, **options))

    def check_claim(self, name: str, answer: Any, judge: Callable[[Any], str], **options: Any) -> Verdict:
        """Judge an answer of which there are many right ones; see `lesson_checks.check_claim`."""
        return self._keep(check_claim(name, self.answers.get(name, answer), judge, **options))

    def check_function(
        self,
        name: str,
        function: Callable[..., Any],
        reference: Callable[..., Any],
        cases: Any,
        **options: Any,
    ) -> Verdict:
        """Judge a function; see `lesson_checks.check_function`."""
        if name in self.answers:
            function = _function(self.answers[name])
        return self._keep(check_function(name, function, reference, cases, **options))

    def figure(self, figure: Figure, name: str, caption: str) -> Picture:
        """Keep a figure as ``NAME.png`` and return it with its caption, to be displayed."""
        picture = Picture(png_bytes(figure), caption)
        self._write_png(name, picture)
        figure.clear()
        return picture

    def explore(
        self, draw: Callable[..., Figure], name: str, caption: str, *, live: bool | None = None, **values: Any
    ) -> Exploration:
        """Return a figure with a slider for each of `values` (choices, start), or the first figure headless.

        Parameters
        ----------
        draw : callable
            Takes the sliders' values by name, returns a figure.
        name, caption : str
            As in `figure`.
        live : bool, optional
            With sliders or without; by default whether a person sits there.
        """
        shown = Exploration(draw, caption, values, live=has_person() if live is None else live)
        self._write_png(name, shown.still)
        return shown

    def summary(self) -> "Summary":
        """Return the verdicts so far, to be displayed, and keep them in ``verdicts.json``."""
        made = Summary(self.title, tuple(self.verdicts.values()))
        rows = [{"exercise": v.name, "state": v.state, "message": v.message} for v in made.verdicts]
        write_json(self.out / VERDICTS_FILE, {"lesson": self.title, "right": made.right, "exercises": rows})
        return made

    def _keep(self, verdict: Verdict) -> Verdict:
        self.verdicts[verdict.name] = verdict
        return verdict

    def _write_png(self, name: str, picture: Picture) -> None:
        with atomic_path(self.out / f"{name}.png") as temporary:
            temporary.write_bytes(picture.png)


class Summary:
    """The verdicts of a lesson, as a notebook shows them."""

    def __init__(self, title: str, verdicts: tuple[Verdict, ...]) -> None:
        self.title, self.verdicts = title, verdicts

    @property
    def right(self) -> int:
        """How many answers are right."""
        return sum(verdict.state == RIGHT for verdict in self.verdicts)

    def __repr__(self) -> str:
        return f"{self.title}: {self.right} of {len(self.verdicts)} right"

    def _repr_html_(self) -> str:
        rows = "".join(f"<li>{text(v.name)}: {text(v.state)}</li>" for v in self.verdicts)
        open_ones = [v.name for v in self.verdicts if v.state == NOT_ANSWERED]
        left = f"<p>Not answered yet: {text(', '.join(open_ones))}</p>" if open_ones else ""
        return f"<p><b>{text(self)}</b></p><ul>{rows}</ul>{left}"


def _function(source: Any) -> Callable[..., Any]:
    """Return the function that a source text defines last; anything else answers nothing."""
    if callable(source):
        return source  # type: ignore[no-any-return]
    names: dict[str, Any] = {"np": np}
    exec(str(source), names)  # noqa: S102 - a teacher's own answer, in the teacher's own notebook
    made = [value for key, value in names.items() if callable(value) and not key.startswith("_")]
    return made[-1] if made else lambda *_: None
