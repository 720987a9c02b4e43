"""HTML pages that open anywhere, offline: one style for all, small figures inside; and the page of a night.

Templates are jinja2's, in ``templates/``. Figures are quantised to few colours and stand in the page as data URLs.
Every status of the night's page has a sign and a word beside its colour.
"""

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image

from opnav_workbench.templating import environment, png_url

__all__ = ["few_colors", "night_page", "render_template"]


# ---- HTML pages that open anywhere, offline: one style for all, small figures inside.

TEMPLATES = Path(__file__).parent / "templates"
N_COLORS = 48  # enough for charts; a page of hundreds of them stays light


def render_template(name: str, **content: Any) -> str:
    """Return what a template of ``templates/`` makes of the content; pages extend ``page.html``."""
    return environment(TEMPLATES).get_template(name).render(**content)


def few_colors(png: bytes, most_px: int | None = None) -> bytes:
    """Return a figure with few colors, and no larger than `most_px` on either side.

    Raises
    ------
    OSError
        It is no whole picture.
    """
    stream = io.BytesIO()
    with Image.open(io.BytesIO(png)) as figure:
        if most_px is not None:
            figure.thumbnail((most_px, most_px))
        figure.convert("RGB").quantize(N_COLORS).save(stream, "png", optimize=True)
    return stream.getvalue()


def _rounded(value: float | None, sigma: float | None = None) -> str:
    """A number with three digits of its sigma, or of its own; a dash where there is none.

    Examples
    --------
    >>> _rounded(1234.5678, 0.0321), _rounded(0.0321), _rounded(math.nan)
    ('1,234.5678', '0.0321', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    size = abs(value if sigma is None else sigma) or 1.0
    digits = min(max(2 - math.floor(math.log10(size)), 0), 8) if math.isfinite(size) else 0
    return f"{value:,.{digits}f}"


environment(TEMPLATES).filters |= {"rounded": _rounded, "linked": quote}


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
    summary
        See `opnav_workbench.headless.night_summary.night_summary_dict`.
    out
        Folder of the pictures' folders; links are relative to it.

    Returns
    -------
    str
        HTML without a reference to the network.
    """
    pictures = {row["name"]: _thumbnail(out / row["name"] / FIGURE_FILE) for row in summary["images"]}
    return render_template(
        "night_page.html",
        night=summary,
        pictures=pictures,
        signs=STATUS_MARKS,
        states=STATE_WORDS,
    )


def _thumbnail(path: Path) -> str:
    """Return a small copy of a figure as a data URL; empty where there is none."""
    try:
        return png_url(few_colors(path.read_bytes(), THUMBNAIL_PX))
    except OSError:
        return ""
