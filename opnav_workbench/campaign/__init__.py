"""Many pictures: their archive, their trends, and their stack.

Enter by `Campaign`: one SQLite file of images, stars, pointings, bodies, observables, decisions and provenance, filled from
run folders; then `trends` over it, `export_observables` from it, and ``stacking`` for faint targets.

``archive``
    `Campaign`: open, ingest, ask, export.
``schema``
    Tables and columns of the archive, with units.
``database``
    The SQLite file: transactions of many processes, older schemas brought to the present one.
``run_folder``
    A run folder read and checked, as rows; why an analyst should look at a picture.
``ingest``
    Runs into the archive, each content once.
``queries``
    Questions answered as tables with units.
``trend_series``
    O-C, pointing error, star residuals and detections over time.
``browsing``
    What a page about a campaign shows, asked for a page at a time.
``comparison``
    Two archives of the same pictures: how far the answers moved, in sigmas.
``detection_curve``
    Completeness: detections against magnitude.
``outliers``
    Robust outliers of a series, with a stated rate of false alarms.
``stacking``
    Many pictures of a faint target as one.
"""

from opnav_workbench.campaign.archive import Campaign, ImageEntry, export_observables
from opnav_workbench.campaign.comparison import Comparison, Difference, compare
from opnav_workbench.campaign.database import ARCHIVE_FILE, ArchiveBusy, ArchiveDamaged
from opnav_workbench.campaign.detection_curve import Completeness, completeness
from opnav_workbench.campaign.ingest import Ingested, IngestReport, KnownRun
from opnav_workbench.campaign.outliers import screen
from opnav_workbench.campaign.run_folder import find_runs
from opnav_workbench.campaign.trend_series import Series, Trends, trends

__all__ = [
    "ARCHIVE_FILE",
    "ArchiveBusy",
    "ArchiveDamaged",
    "Campaign",
    "Comparison",
    "Completeness",
    "Difference",
    "ImageEntry",
    "IngestReport",
    "Ingested",
    "KnownRun",
    "Series",
    "Trends",
    "compare",
    "completeness",
    "export_observables",
    "find_runs",
    "screen",
    "trends",
]
