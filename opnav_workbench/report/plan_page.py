"""The page of a picture plan: one file that opens anywhere, offline, with its figures inside.

Every verdict has a sign and a word beside its color.
"""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from opnav_workbench.files import write_text
from opnav_workbench.planning import PicturePlan, Plan, catalog_words
from opnav_workbench.report.page import figure_url, render_page
from opnav_workbench.report.plan_figure import field_chart, timeline_figure
from opnav_workbench.report.plan_figure_search import exposure_figure, search_figure
from opnav_workbench.report.png import png_bytes

__all__ = ["plan_page", "write_plan_page"]

SIGNS = {"good": "✓", "marginal": "!", "bad": "✕"}
MEANING = {"good": "as it stands", "marginal": "usable, with reservations", "bad": "not worth taking"}
MOST_CURVES = 6


def plan_page(plan: Plan, charts: Mapping[str, bytes] | None = None) -> str:
    """Return the page: HTML without a reference to the network.

    Parameters
    ----------
    plan : Plan
    charts : mapping of str to bytes, optional
        Charts of the fields as PNG, by picture, where they are drawn already.
    """
    drawn = {p.name: png_bytes(field_chart(p)) for p in plan.pictures} if charts is None else charts
    return render_page(
        "plan_page.html",
        {"number": _number},
        plan=plan,
        charts={name: _data_url(png) for name, png in drawn.items()},
        signs=SIGNS,
        meaning=MEANING,
        catalog=catalog_words(plan),
        timeline=_data_url(png_bytes(timeline_figure(plan.pictures))) if plan.pictures else "",
        exposures=_data_url(png_bytes(exposure_figure(curves))) if (curves := _shown_curves(plan)) else "",
        searches=[(approach, _data_url(png_bytes(search_figure(approach)))) for approach in plan.searches],
    )


def write_plan_page(plan: Plan, path: Path, charts: Mapping[str, bytes] | None = None) -> None:
    """Write the page, whole or not at all."""
    write_text(path, plan_page(plan, charts))


def _shown_curves(plan: Plan) -> list[PicturePlan]:
    """Return pictures spread over the sequence whose exposure was searched."""
    known = [
        p for p in plan.pictures if p.prospect and p.prospect.best and np.isfinite(p.prospect.best.best_s)
    ]
    if len(known) <= MOST_CURVES:
        return known
    return [known[i] for i in np.linspace(0, len(known) - 1, MOST_CURVES).astype(int)]


def _data_url(png: bytes) -> str:
    with Image.open(io.BytesIO(png)) as picture:
        return figure_url(picture)


def _number(value: float | None, pattern: str = "%.3g") -> str:
    return "–" if value is None or not np.isfinite(value) else pattern % value
