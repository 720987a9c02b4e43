"""Pages about a campaign, made when they are asked for: `opnav campaign serve` shows them.

A page holds some hundred pictures and the numbers of all; what costs more (trends) has a page of its own.  Counts and
causes are asked for once, until the archive changes.
"""

import re
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from opnav_workbench.campaign import Campaign, Trends, trends
from opnav_workbench.campaign.browsing import Overview
from opnav_workbench.errors import SessionError
from opnav_workbench.files import inside, json_value, text_of
from opnav_workbench.report.campaign import trends_figure
from opnav_workbench.report.drawing import png_bytes
from opnav_workbench.report.pages import STATUS_MARKS, NightCause, night_causes, render_template

__all__ = ["PICTURE_FILES", "CampaignPages"]

ROWS_A_PAGE = 100
CAUSES_SHOWN = 20
WORDS, WORDS_ASKED = re.compile(r"(?<![\w.])[A-Za-z_]{3,}(?![\w.])"), 8  # of a reason: those without numbers
STATUS_FILE = "status.json"  # of the night that fills the archive, beside it
# What of a picture's folder is shown, and nothing else of it.
PICTURE_FILES = (
    "summary.png",
    "notebook.html",
    "notebook.ipynb",
    "result.json",
    "observables.ecsv",
    "notebook.log",
)


class CampaignPages:
    """The pages of one archive.

    Parameters
    ----------
    campaign
        Open as long as pages are asked for.
    """

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._known: tuple[Any, Overview, tuple[NightCause, ...]] | None = None
        self._trends: tuple[Any, Trends, bytes] | None = None

    def pictures(self, page: int = 1, status: str = "", words: str = "") -> str:
        """Return a page of pictures, by time, with counts and causes of all."""
        numbers, causes = self._overview()
        found = self._campaign.pictures_page(
            start=(max(page, 1) - 1) * ROWS_A_PAGE, count=ROWS_A_PAGE, status=status, words=words
        )
        return self._page(
            "campaign_pictures.html",
            "pictures",
            counts=numbers.counts,
            flagged=len(numbers.reasons),
            causes=causes[:CAUSES_SHOWN],
            searches=[_search(cause) for cause in causes[:CAUSES_SHOWN]],
            more_causes=len(causes) - CAUSES_SHOWN if len(causes) > CAUSES_SHOWN else 0,
            rows=found.rows,
            found=found.total,
            page=max(page, 1),
            pages=-(-found.total // ROWS_A_PAGE),
            status=status,
            words=words,
            query=urlencode({"status": status, "q": words}),
        )

    def picture(self, number: int) -> str | None:
        """Return the page of one picture; None where there is none of that number."""
        row = self._campaign.picture(number)
        if row is None:
            return None
        files = [name for name in PICTURE_FILES if self.file(number, name) is not None]
        if "notebook.ipynb" in files and "notebook.html" not in files:
            files.insert(0, "notebook.html")  # made when it is asked for
        return self._page("campaign_others.html", "picture", picture=row, files=files)

    def file(self, number: int, name: str) -> Path | None:
        """Return where a file of a picture's folder is; None where it is none of those that are shown, or not there."""
        row = self._campaign.picture(number)
        if row is None or name not in PICTURE_FILES:
            return None
        try:
            path = inside(row["folder"], name)
        except SessionError:  # a link that leads out of the folder
            return None
        return path if path.is_file() else None

    def trends(self) -> str:
        """Return the page of trends and outliers."""
        return self._page("campaign_others.html", "trends", outliers=self._drawn()[0].outliers())

    def trends_png(self) -> bytes:
        """Return the figure of the trends."""
        return self._drawn()[1]

    def made_with(self) -> str:
        """Return the page of versions, catalogs and kernels."""
        return self._page("campaign_others.html", "made with", made=self._campaign.made_with())

    def changes(self) -> str:
        """Return the page of what was processed again."""
        return self._page("campaign_others.html", "changes", changes=self._campaign.changes())

    def _page(self, template: str, shown: str, **content: Any) -> str:
        numbers, _ = self._overview()
        return render_template(
            template,
            **{"picture": None, **content},
            shown=shown,
            archive=str(self._campaign.path),
            total=sum(numbers.counts.values()),
            first_utc=numbers.first_utc,
            last_utc=numbers.last_utc,
            night=_night_beside(self._campaign.path),
            signs=STATUS_MARKS,
        )

    def _overview(self) -> tuple[Overview, tuple[NightCause, ...]]:
        state = _state(self._campaign.path)
        if self._known is None or self._known[0] != state:
            numbers = self._campaign.overview()
            self._known = (state, numbers, night_causes(numbers.reasons))
        return self._known[1], self._known[2]

    def _drawn(self) -> tuple[Trends, bytes]:
        state = _state(self._campaign.path)
        if self._trends is None or self._trends[0] != state:
            found = trends(self._campaign)
            self._trends = (state, found, png_bytes(trends_figure(found, self._campaign.path.name)))
        return self._trends[1], self._trends[2]


def _search(cause: NightCause) -> str:
    """Return the query that finds the pictures of a cause: by the words that their reasons have in common."""
    words = WORDS.findall(cause.reason.replace(cause.rows[0]["name"], " "))
    return urlencode({"status": "attention", "q": " ".join(words[:WORDS_ASKED])})


def _state(archive: Path) -> tuple[tuple[int, int], ...]:
    """Return what changes when the archive is written."""
    found = []
    for path in (archive, archive.with_name(archive.name + "-wal")):
        try:
            status = path.stat()
            found.append((status.st_mtime_ns, status.st_size))
        except OSError:
            found.append((0, 0))
    return tuple(found)


def _night_beside(archive: Path) -> dict[str, Any] | None:
    """Return how the night that fills an archive goes; None where none does."""
    try:
        status: dict[str, Any] = json_value(text_of(archive.with_name(STATUS_FILE)))
        needed = (
            status["state"],
            status["updated_utc"],
            status["pictures_per_minute"],
            status["disk_free_mb"],
        )
        return (
            status if {"processed", "to_process", "failed"} <= status["pictures"].keys() and needed else None
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
