"""The page of a night: one file that opens anywhere, offline, with small pictures inside.

Every status has a sign and a word beside its color.
"""

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment
from PIL import Image

__all__ = ["night_page"]

THUMBNAIL_PX = 260
THUMBNAIL_COLORS = 48  # a few kB each: a page of hundreds of pictures stays light
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
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"signed": _signed, "plain": _plain, "linked": quote}
    pictures = {row["name"]: _thumbnail(out / row["name"] / FIGURE_FILE) for row in summary["images"]}
    template = environment.from_string(
        Path(__file__).with_name("night_page.html").read_text(encoding="utf-8")
    )
    return template.render(night=summary, pictures=pictures, signs=SIGNS, states=STATES)


def _thumbnail(path: Path) -> str:
    """Return a small copy of a figure as a data URL; empty where there is none."""
    try:
        with Image.open(path) as figure:
            figure.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
            small = figure.convert("RGB").quantize(THUMBNAIL_COLORS)
    except OSError:
        return ""
    stream = io.BytesIO()
    small.save(stream, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def _signed(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:+.{digits}f}"


def _plain(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
