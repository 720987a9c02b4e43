"""Answers judged, functions called, figures kept: what a lesson's notebook relies on."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from opnav_workbench.errors import SessionError
from opnav_workbench.workbench import lessons
from opnav_workbench.workbench.lessons import (
    NOT_ANSWERED,
    NOT_YET,
    RIGHT,
    Lesson,
    check,
    check_claim,
    check_function,
)

ARCSEC_PER_RAD = 206_264.806


@pytest.mark.parametrize(
    ("answer", "expected", "state"),
    [
        (None, 4.1, NOT_ANSWERED),
        (..., 4.1, NOT_ANSWERED),
        ((1.0, None), [1.0, 2.0], NOT_ANSWERED),
        ({"A": None}, [1.0], NOT_ANSWERED),
        (4.14, 4.1, RIGHT),
        (4.16, 4.1, NOT_YET),
        (np.array([4.1]), 4.1, RIGHT),
        ([1.0, 2.04], [1.0, 2.0], RIGHT),
        ([1.0, 2.06], [1.0, 2.0], NOT_YET),
        ("4.1", 4.1, RIGHT),
        ("four", 4.1, NOT_YET),
        ([1.0, 2.0, 3.0], [1.0, 2.0], NOT_YET),
        ([[1.0], [2.0, 3.0]], [1.0, 2.0], NOT_YET),
        (np.nan, 4.1, NOT_YET),
        (np.inf, 4.1, NOT_YET),
        ("  Distortion ", "distortion", RIGHT),
        ("twist", "distortion", NOT_YET),
        (True, True, RIGHT),
        (False, True, NOT_YET),
    ],
)
def test_answers_are_judged_by_value_and_shape(answer, expected, state):
    assert check("1", answer, expected, tolerance=0.05).state == state


def test_the_wider_of_both_tolerances_counts():
    assert check("1", 105.0, 100.0, tolerance=1.0, relative=0.06).is_right
    assert check("1", 105.0, 100.0, tolerance=6.0, relative=0.01).is_right
    assert not check("1", 105.0, 100.0, tolerance=1.0, relative=0.01).is_right
    assert check("1", 0.1 + 0.2, 0.3).is_right  # without any tolerance: equal but for rounding


@pytest.mark.parametrize(
    ("answer", "expected", "words"),
    [
        (-3.0, 3.0, "sign"),
        ([2.0, 1.0], [1.0, 2.0], "other order"),
        (np.radians(30.0), 30.0, "radians and degrees"),
        (np.degrees(0.5), 0.5, "radians and degrees"),
        (1.0 / ARCSEC_PER_RAD, 1.0, "radians and arcseconds"),
        (3.0e3, 3.0, "1000"),
        ([1.0, 2.0, 3.0], 7.0, "shape (3,)"),
        ("seven", 7.0, "Give a number, not str"),
        (np.nan, 7.0, "not finite"),
        (14.0, 7.0, "Half of it."),
        (11.0, 7.0, "Think again."),
    ],
)
def test_wrong_answers_get_the_hint_they_deserve_and_never_the_solution(answer, expected, words):
    verdict = check("1", answer, expected, relative=0.001, hint="Think again.", slips=[(14.0, "Half of it.")])
    assert verdict.state == NOT_YET
    assert words in verdict.message
    assert words in verdict._repr_html_()
    if np.ndim(expected) == 0 and expected == 7.0:
        assert "7" not in verdict.message


def test_a_slip_that_is_within_tolerance_of_the_right_answer_is_right():
    assert check("1", 1.0, 1.0, tolerance=0.5, slips=[(1.2, "never said")]).is_right


def test_functions_are_called_and_compared():
    cases = [(2.0,), (3.0,)]
    assert check_function("1", lambda x: None, np.square, cases).state == NOT_ANSWERED
    assert check_function("1", lambda x: x * x, np.square, cases).state == RIGHT
    partly = check_function("1", lambda x: 2.0 * x, np.square, cases, hint="Square it.")
    assert partly.state == NOT_YET
    assert partly.message == "Call 2 of 2: Square it."
    known = check_function("1", lambda x: -x, np.square, cases, slips=[(lambda x: -x, "Minus?")])
    assert known.message == "Call 1 of 2: Minus?"
    raised = check_function("1", lambda x: x.missing, np.square, cases)
    assert raised.state == NOT_YET
    assert "AttributeError" in raised.message
    assert (
        check_function("1", lambda x, y: x, np.square, cases).state == NOT_YET
    )  # TypeError of the call itself


def test_claims_are_judged_by_their_own_rule():
    def judge(vector):
        return "" if vector[0] > vector[1] else "The first must be larger."

    assert check_claim("1", None, judge).state == NOT_ANSWERED
    assert check_claim("1", (2, 1), judge, why="Yes.").message == "Yes."
    assert check_claim("1", (1, 2), judge).message == "The first must be larger."
    assert "TypeError" in check_claim("1", 5, judge).message


def test_verdicts_are_shown_with_a_sign_and_without_breaking_the_page():
    verdict = check("<b>1</b>", "x", "y", hint="a < b & c")
    page = verdict._repr_html_()
    assert "<b>1" not in page.replace("<b>✗", "")
    assert "a &lt; b &amp; c" in page
    assert "✗" in page
    assert "✓" in check("1", 1.0, 1.0)._repr_html_()


def test_a_lesson_counts_what_was_said_last(tmp_path):
    lesson = Lesson("Sums", tmp_path / "deep/out")
    lesson.check("1", 5, 4)
    lesson.check("2", None, 4)
    lesson.check("1", 4, 4)
    summary = lesson.summary()
    assert str(summary) == "Sums: 1 of 2 right"
    assert "Not answered yet: 2" in summary._repr_html_()
    kept = json.loads((tmp_path / "deep/out/verdicts.json").read_text())
    assert kept["right"] == 1
    assert [row["state"] for row in kept["exercises"]] == [RIGHT, NOT_ANSWERED]


def test_a_teachers_answers_come_before_the_students(tmp_path):
    answers = {
        "1": 4,
        "2": "def g(x):\n    return 1 + x\n\ndef f(x):\n    return np.sqrt(g(x))",
        "3": [1],
        "4": "x = 1",
    }
    lesson = Lesson("Sums", tmp_path, answers)
    assert lesson.check("1", None, 4).is_right
    assert lesson.check_function("2", lambda x: None, lambda x: np.sqrt(1 + x), [(3.0,)]).is_right
    assert lesson.check_claim("3", None, lambda a: "").is_right
    assert lesson.check_function("4", lambda x: x, lambda x: x, [(3.0,)]).state == NOT_ANSWERED
    assert lesson.check("5", None, 4).state == NOT_ANSWERED


def test_a_folder_that_cannot_be_written_is_one_clear_message(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="cannot write into"):
        Lesson("Sums", tmp_path / "file")


def _line(slope=1.0):
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0.0, slope])
    return figure


def test_figures_are_kept_with_their_caption(tmp_path):
    lesson = Lesson("Lines", tmp_path)
    shown = lesson.figure(_line(), "line", "A line, x < y")
    assert (tmp_path / "line.png").read_bytes() == shown.png
    assert shown.png.startswith(b"\x89PNG")
    assert 'alt="A line, x &lt; y"' in shown._repr_html_()
    assert "A line" in repr(shown)


def test_without_a_person_an_exploration_is_its_first_figure(tmp_path):
    shown = Lesson("Lines", tmp_path).explore(_line, "line", "A line", slope=((1.0, 2.0), 2.0))
    assert shown.sliders == {}
    assert set(shown._repr_mimebundle_()) == {"text/plain", "text/html"}
    assert (tmp_path / "line.png").read_bytes() == shown.png(slope=2.0)


def test_sliders_redraw_the_figure(tmp_path):
    shown = Lesson("Lines", tmp_path).explore(_line, "line", "A line", live=True, slope=((1.0, 2.0), 1.0))
    data, _ = shown._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in data
    assert "<img" in data["text/html"]  # for a front end without a kernel
    image = shown._widget.children[1]
    assert image.value == shown.png(slope=1.0)
    shown.sliders["slope"].value = 2.0
    assert image.value == shown.png(slope=2.0) != shown.png(slope=1.0)


def test_a_slider_must_start_at_one_of_its_choices(tmp_path):
    with pytest.raises(ValueError, match="starts at 3"):
        Lesson("Lines", tmp_path).explore(_line, "line", "A line", slope=((1.0, 2.0), 3.0))


@pytest.mark.parametrize(
    ("request_", "person"),
    [
        ({"content": {"allow_stdin": True}}, True),
        ({"content": {"allow_stdin": False}}, False),
        ({"content": {}}, False),
        (None, False),
    ],
)
def test_a_person_is_there_if_the_front_end_lets_cells_ask(monkeypatch, request_, person):
    class Shell:
        def get_parent(self):
            return request_

    monkeypatch.setattr("IPython.get_ipython", Shell)
    assert lessons.is_attended() is person
    monkeypatch.setattr("IPython.get_ipython", lambda: None)
    assert lessons.is_attended() is False
