"""HTML pages that open anywhere, offline: one style for all, small figures inside; and the page of a night.

Templates are jinja2's, in ``templates/``. Figures are quantised to few colours and stand in the page as data URLs.
Every status of the night's page has a sign and a word beside its colour.
"""

import io
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image

from opnav_workbench.templating import environment, png_url

__all__ = ["NightCause", "few_colors", "night_causes", "night_pages", "render_template"]


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


# ---- The pages of a night: they open anywhere, offline.

THUMBNAIL_PX = 260
FIGURE_FILE = "summary.png"
FIRST_PAGE = "summary.html"
ROWS_A_PAGE = 500  # a megabyte; a browser shows it at once
MOST_INSIDE = 200  # small pictures that stand in the page itself; of more they come from their folders when they are seen
OUTLIERS_SHOWN = 50
NAMES_SHOWN = 1000  # of the pictures of one cause
STATUS_MARKS = {"ok": "✓", "partial": "!", "failed": "✕", "waiting": "…"}
STATE_WORDS = {
    "done": "as before",
    "kept": "an analyst's session",
    "older": "as before (other inputs)",
    "now": "",
    "waiting": "",
}
NUMBERS = re.compile(r"[+-]?\d[\d.,:TZ+-]*")


@dataclass(frozen=True, slots=True)
class NightCause:
    """A reason to look at pictures, and all pictures that have it: they differ in numbers and names only.

    Attributes
    ----------
    reason
        As the first of them says it.
    rows
        Of the summary.
    """

    reason: str
    rows: tuple[Mapping[str, Any], ...]


def night_causes(rows: Iterable[Mapping[str, Any]]) -> tuple[NightCause, ...]:
    """Return why pictures need an analyst, the most frequent cause first.

    Parameters
    ----------
    rows
        Images of a night's summary.

    Examples
    --------
    >>> gap = "no attitude at {} (NH_LORRI); add a CK"
    >>> times = {"lor_1": "2015-04-09T01:02", "lor_2": "2015-04-10T03:04"}
    >>> rows = [{"name": name, "attention": [gap.format(time)]} for name, time in times.items()]
    >>> [(cause.reason, len(cause.rows)) for cause in night_causes(rows)]
    [('no attitude at 2015-04-09T01:02 (NH_LORRI); add a CK', 2)]
    """
    found: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for row in rows:
        for reason in row["attention"]:
            named = row["name"] in reason  # most reasons do not name their picture
            kind = NUMBERS.sub(
                "#", re.sub(rf"\b{re.escape(row['name'])}\b", "*", reason) if named else reason
            )
            found.setdefault(kind, []).append((reason, row))
    causes = [NightCause(same[0][0], tuple(row for _, row in same)) for same in found.values()]
    return tuple(sorted(causes, key=lambda cause: -len(cause.rows)))


def night_pages(summary: Mapping[str, Any], out: Path) -> dict[str, str]:
    """Return the pages by the names of their files.

    Parameters
    ----------
    summary
        See `opnav_workbench.headless.night_summary.night_summary_dict`.
    out
        Folder of the pictures' folders; links are relative to it.

    Returns
    -------
    dict of str to str
        HTML without a reference to the network: causes and counts on the first page, on each some hundred pictures.
    """
    rows, causes = summary["images"], night_causes(summary["images"])
    parts = [rows[start : start + ROWS_A_PAGE] for start in range(0, len(rows), ROWS_A_PAGE)] or [[]]
    names = [FIRST_PAGE, *(f"summary-{number}.html" for number in range(2, len(parts) + 1))]
    where = {row["name"]: name for name, part in zip(names, parts, strict=True) for row in part}
    numbers = {row["name"]: k for k, cause in reversed(list(enumerate(causes))) for row in cause.rows}
    inside = len(rows) <= MOST_INSIDE
    return {
        name: render_template(
            "night_page.html",
            night=summary,
            rows=part,
            causes=causes if name == FIRST_PAGE else (),
            cause_numbers=numbers,
            n_names=NAMES_SHOWN,
            n_outliers=OUTLIERS_SHOWN,
            names={Path(row.get("path", row["name"])).name: row["name"] for row in rows}
            if name == FIRST_PAGE
            else {},
            where=where,
            page=name,
            pages=names,
            first=FIRST_PAGE,
            pictures={row["name"]: _figure(out, row["name"], inside=inside) for row in part},
            signs=STATUS_MARKS,
            states=STATE_WORDS,
        )
        for name, part in zip(names, parts, strict=True)
    }


def _figure(out: Path, name: str, *, inside: bool) -> str:
    """Return where a browser finds a picture's figure; empty where there is none."""
    path = out / name / FIGURE_FILE
    if inside:
        return _thumbnail(path)
    return quote(f"{name}/{FIGURE_FILE}") if path.is_file() else ""


def _thumbnail(path: Path) -> str:
    """Return a small copy of a figure as a data URL; empty where there is none."""
    try:
        return png_url(few_colors(path.read_bytes(), THUMBNAIL_PX))
    except OSError:
        return ""
