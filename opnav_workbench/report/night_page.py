"""The page of a night: one file that opens anywhere, offline, with small pictures inside.

Every status has a sign and a word beside its color.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image

from opnav_workbench.report.page import figure_url, render_page

__all__ = ["night_page"]

THUMBNAIL_PX = 260
FIGURE_FILE = "summary.png"
SIGNS = {"ok": "✓", "partial": "!", "failed": "✕", "waiting": "…"}
STATES = {
    "done": "as before",
    "kept": "an analyst's session",
    "older": "as before (other inputs)",
    "now": "",
    "waiting": "",
}


def night_page(summary: Mapping[str, Any], out: Path) -> str:
    """Return the page.

    Parameters
    ----------
    summary : mapping
        See `opnav_workbench.headless.night_summary.summary_of`.
    out : path
        Folder of the pictures' folders; links are relative to it.

    Returns
    -------
    str
        HTML without a reference to the network.
    """
    pictures = {row["name"]: _thumbnail(out / row["name"] / FIGURE_FILE) for row in summary["images"]}
    return render_page(
        "night_page.html",
        {"signed": _signed, "plain": _plain, "linked": quote},
        night=summary,
        pictures=pictures,
        signs=SIGNS,
        states=STATES,
    )


def _thumbnail(path: Path) -> str:
    """Return a small copy of a figure as a data URL; empty where there is none."""
    try:
        with Image.open(path) as figure:
            figure.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
            return figure_url(figure)
    except OSError:
        return ""


def _signed(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:+.{digits}f}"


def _plain(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
