"""Many pictures: their archive, their trends, and their stack.

archive     `Campaign`: one SQLite file of images, stars, pointings, bodies, observables, decisions and provenance
            (columns, schema, database, migrations, run_folder, observable_rows, ingest, queries, dump, attention, export)
trends      O-C, pointing error, star residuals and detections against time and magnitude (outliers, completeness)
queue_file  pictures that wait for an analyst
stacking    many pictures of a faint target as one
"""

from opnav_workbench.campaign.archive import ARCHIVE_FILE, Campaign, ImageEntry
from opnav_workbench.campaign.completeness import Completeness, completeness
from opnav_workbench.campaign.export import export_observables
from opnav_workbench.campaign.ingest import Ingested, IngestReport
from opnav_workbench.campaign.outliers import screen
from opnav_workbench.campaign.trends import Series, Trends, trends

__all__ = [
    "ARCHIVE_FILE",
    "Campaign",
    "Completeness",
    "ImageEntry",
    "IngestReport",
    "Ingested",
    "Series",
    "Trends",
    "completeness",
    "export_observables",
    "screen",
    "trends",
]
