"""The pages of a rehearsal: what a team delivers, and how it was scored; one file each that opens anywhere, offline.

Every verdict has a word beside its color; figures come on a light and on a dark ground.
"""

import base64
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from opnav_workbench.rehearsal.ort_score import OrtScore
from opnav_workbench.rehearsal.ort_solution import OrtSolution
from opnav_workbench.report.ort_figure import center_error_figure, flyby_figure, residual_figure
from opnav_workbench.report.page import render_page
from opnav_workbench.report.png import png_bytes

__all__ = ["score_page", "solution_page"]


def score_page(score: OrtScore) -> str:
    """Return the report of a scored rehearsal as HTML without a reference to the network."""
    found = score.solution
    figures = {"errors": _both(lambda dark: center_error_figure(score.pictures, dark=dark))}
    if found is not None:
        figures |= _solution_figures(found.solution, found.b_plane_true)
    return _render(
        score=score,
        solution=None if found is None else found.solution,
        figures=figures,
        heading=f"Score of {score.title or score.package}",
    )


def solution_page(solution: OrtSolution, title: str = "") -> str:
    """Return the overview of a solution, before the truth is opened, as HTML without a reference to the network."""
    return _render(
        score=None,
        solution=solution,
        figures=_solution_figures(solution, None),
        heading=f"Solution of {title or solution.package}",
    )


def _solution_figures(solution: OrtSolution, true: Any) -> dict[str, Markup]:
    return {
        "flyby": _both(lambda dark: flyby_figure(solution, true, dark=dark)),
        "residuals": _both(lambda dark: residual_figure(solution, dark=dark)),
    }


def _both(draw: Callable[[bool], Figure]) -> Markup:
    """Return a figure on light ground, and on dark ground where the reader's screen is dark."""
    light, dark = (base64.b64encode(png_bytes(draw(ground))).decode() for ground in (False, True))
    return Markup(
        '<picture><source media="(prefers-color-scheme: dark)" srcset="data:image/png;base64,{}">'
        '<img src="data:image/png;base64,{}" alt=""></picture>'
    ).format(dark, light)


def _render(**content: Any) -> str:
    return render_page("ort_page.html", {"signed": _signed, "plain": _plain}, **content)


def _signed(value: float | None, digits: int = 2) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:+,.{digits}f}"


def _plain(value: float | None, least: float | None = None) -> str:
    """Return a number with digits that fit the size of `least` (its sigma), or its own."""
    if value is None or not np.isfinite(value):
        return "–"
    size = abs(value if least is None else least) or 1.0
    digits = int(np.clip(2 - np.floor(np.log10(size)), 0, 8))
    return f"{value:,.{digits}f}"
