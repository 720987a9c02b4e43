"""All observables of a campaign as one file."""

from collections.abc import Callable, Sequence
from pathlib import Path

from opnav_workbench.campaign.archive import Campaign
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.observables import (
    Observable,
    table_observables,
    write_csv,
    write_observables_json,
    write_tdm,
)

__all__ = ["EXPORT_FORMATS", "export_observables"]

WRITERS: dict[str, Callable[[Sequence[Observable], Path], None]] = {
    "csv": write_csv,
    "json": write_observables_json,
    "tdm": write_tdm,
}
EXPORT_FORMATS = ("ecsv", *WRITERS)


def export_observables(
    campaign: Campaign, path: str | Path, format_name: str | None = None, **filters: str | None
) -> int:
    """Write the observables of a campaign, whole or not at all; return how many.

    Parameters
    ----------
    campaign : Campaign
    path : path
    format_name : {"ecsv", "csv", "json", "tdm"}, optional
        By default the ending of `path`. ECSV holds every column that the runs' own files have.
    filters
        As of `Campaign.observables`.

    Raises
    ------
    SessionError
        An unknown format or filter, nothing to export, or the file cannot be written.
    """
    target = Path(path)
    name = (format_name or target.suffix.removeprefix(".")).lower()
    if name not in EXPORT_FORMATS:
        what = f"unknown format {name!r}" if name else "no format given"
        raise SessionError(
            f"{what}; choose --format {' | '.join(EXPORT_FORMATS)}, or a file name that ends so."
        )
    table = campaign.observables(**filters)
    if not len(table):
        raise SessionError("no observable to export; `opnav campaign query bodies` shows what there is.")
    if name == "ecsv":
        with atomic_path(target) as temporary:
            table.write(temporary, format="ascii.ecsv", overwrite=True)
    else:
        WRITERS[name](table_observables(table), target)
    return len(table)
