"""HTML pages that open anywhere, offline: one style for all, small figures inside; and the page of a night.

Templates are jinja2's. Figures are quantised to few colours and stand in the page as data URLs. Every status of the
night's page has a sign and a word beside its colour.
"""

import base64
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader
from PIL import Image

__all__ = ["figure_url", "night_page", "render_page"]


# ---- HTML pages that open anywhere, offline: one style for all, small figures inside.

N_COLORS = 48  # enough for charts; a page of hundreds of them stays light


def render_page(template: str, filters: dict[str, Callable[..., str]], **content: Any) -> str:
    """Return a page from a template of this folder, which includes ``page_style.css``."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters
    return environment.get_template(template).render(**content)


def figure_url(picture: Image.Image) -> str:
    """Return a figure with few colors as a data URL."""
    stream = io.BytesIO()
    picture.convert("RGB").quantize(N_COLORS).save(stream, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


# ---- The page of a night: one file that opens anywhere, offline, with small pictures inside.

THUMBNAIL_PX = 260
FIGURE_FILE = "summary.png"
STATUS_MARKS = {"ok": "✓", "partial": "!", "failed": "✕", "waiting": "…"}
STATE_WORDS = {
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
        See `opnav_workbench.headless.night_summary.night_summary_dict`.
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
        signs=STATUS_MARKS,
        states=STATE_WORDS,
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
