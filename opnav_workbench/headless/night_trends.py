"""What a night's page says of trends: a figure beside it, and the pictures that are off theirs."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from opnav_workbench import report
from opnav_workbench.campaign import Campaign, trends
from opnav_workbench.errors import OpNavError

__all__ = ["TRENDS_FIGURE", "write_night_trends"]

TRENDS_FIGURE = "trends.png"
# Of fewer pictures no outlier is known; more take longer to draw than a night shall wait
FEWEST, MOST = 6, 20_000


def write_night_trends(archive: Path | None, out: Path) -> dict[str, Any]:
    """Draw the trends of an archive into ``OUT/trends.png``, and return what to say of them.

    Parameters
    ----------
    archive
        None where the night has none.
    out
        The night's folder.

    Returns
    -------
    dict
        ``figure`` (name of the file, or None), ``outliers`` (``image``, ``series``, ``deviation`` in robust sigmas) and
        ``why_not``: why nothing is drawn, empty where something is.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    why_not, found = _found(archive)
    if found is None:
        with suppress(OSError):  # a folder that cannot be written says so with the summary
            (out / TRENDS_FIGURE).unlink(missing_ok=True)
        return {"figure": None, "outliers": [], "why_not": why_not}
    report.write_png(report.trends_figure(found), out / TRENDS_FIGURE)
    rows = [{"image": i, "series": s, "deviation": d} for i, s, d in found.outliers()]
    rows.sort(key=lambda row: -abs(float(row["deviation"])))
    return {"figure": TRENDS_FIGURE, "outliers": rows, "why_not": ""}


def _found(archive: Path | None) -> tuple[str, Any]:
    if archive is None:
        return "there is no archive", None
    try:
        with Campaign(archive, create=False) as campaign:
            solved = len(campaign.query("pointings", ("image",)))
            if solved < FEWEST:
                return f"{solved} pictures with a pointing in the archive; {FEWEST} are the least", None
            if solved > MOST:
                return f"{solved:,} pictures: opnav campaign serve draws them when they are asked for", None
            return "", trends(campaign)
    except OpNavError as error:
        return str(error), None
