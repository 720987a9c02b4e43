"""A night's summary as it is written: ``summary.json`` and the pages for the analyst."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opnav_workbench import report
from opnav_workbench.files import inside, json_value, text_of, write_json, write_text
from opnav_workbench.version import __version__

__all__ = ["SUMMARY_FILE", "SUMMARY_PAGE", "forget_missing_files", "write_pages"]

SUMMARY_FILE, SUMMARY_PAGE = "summary.json", "summary.html"


def write_pages(summary: Mapping[str, Any], out: Path) -> None:
    """Write the summary and its pages; pages of a night of more pictures go."""
    write_json(out / SUMMARY_FILE, summary)
    pages = report.night_pages(summary, out)
    for name, page in pages.items():
        write_text(out / name, page)
    for left in out.glob("summary-*.html"):  # of a night of more pictures
        if left.name not in pages:
            left.unlink(missing_ok=True)


def forget_missing_files(out: Path) -> bool:
    """Write a night's summary and pages anew without the files that have gone since; they link to nothing that is not there.

    Returns
    -------
    bool
        Whether that was done: not where there is no summary, or one of another version, which the next night writes anew.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    try:
        written = text_of(out / SUMMARY_FILE)
        summary: dict[str, Any] = json_value(written)
        for row in summary["images"]:
            folder = inside(out, row["name"])
            row["files"] = [name for name in row["files"] if (folder / name).is_file()]
        if summary["version"] != __version__ or text_of(out / SUMMARY_FILE) != written:
            return False
    except (OSError, ValueError, KeyError, TypeError):
        return False
    write_pages(summary, out)
    return True
