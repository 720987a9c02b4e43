"""Pages about a campaign, made when they are asked for: `opnav campaign serve` shows them.

A page holds some hundred pictures and the numbers of all; what costs more (trends) has a page of its own, which says so
while it is being drawn.  Counts and causes are asked for once, until the archive changes.  Many threads may ask.
"""

import re
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock
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
PATIENCE_S = 2.0  # of a browser for trends; then it is told to ask again
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
        self._asking = Lock()
        self._drawing = ThreadPoolExecutor(1)  # figures one after the other
        self._trends: tuple[Any, Future[tuple[Trends, bytes]]] | None = None

    def close(self) -> None:
        """Begin no figure any more."""
        self._drawing.shutdown(wait=True, cancel_futures=True)

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
        """Return the page of trends and outliers; one that asks again soon while they are not drawn yet."""
        try:
            found: Trends | None = self._drawn().result(PATIENCE_S)[0]
        except TimeoutError:
            found = None
        return self._page(
            "campaign_others.html",
            "trends",
            drawn=found is not None,
            outliers=() if found is None else found.outliers(),
        )

    def trends_png(self) -> bytes:
        """Return the figure of the trends."""
        return self._drawn().result()[1]

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
        with self._asking:
            state = _state(self._campaign.path)
            if self._known is None or self._known[0] != state:
                numbers = self._campaign.overview()
                self._known = (state, numbers, night_causes(numbers.reasons))
            return self._known[1], self._known[2]

    def _drawn(self) -> "Future[tuple[Trends, bytes]]":
        """Return the trends, which may be in the making: of the archive as it is, or as it was when that began."""
        with self._asking:
            state = _state(self._campaign.path)
            if self._trends is None or (self._trends[1].done() and self._trends[0] != state):
                self._trends = (state, self._drawing.submit(self._draw))
            return self._trends[1]

    def _draw(self) -> tuple[Trends, bytes]:
        found = trends(self._campaign)
        return found, png_bytes(trends_figure(found, self._campaign.path.name))


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
