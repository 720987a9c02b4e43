"""Star catalogs: opened by a one-line spec, asked for the stars within a cone or a polygon.

table, quality  the stars themselves, with sigmas, Johnson V and B-V, and flags
specs           spec -> catalog
indexed         the one search; `region` says where, a `store` holds the stars: in memory, as mapped `records` of a
                `cache` file, or in `zones`; `sky` orders them
bands           V and B-V from the catalogs' passbands
bundled         Hipparcos and Gaia DR3 from two data packages, merged by `merge`
tycho2, hip2    text catalogs of the CDS, converted once into a cache file
ucac2, ucac4    binary zone files, read where they stand
npz             a file of the user's own arrays
astrometry_net  index files
status          what is available here
"""

from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.priors import UNKNOWN_MOTION_MAS_YR
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.specs import open_catalog
from opnav_workbench.catalog.star_list import read_star_list
from opnav_workbench.catalog.status import CatalogStatus, catalog_status
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.catalog.vizier import VizierCatalog, open_vizier

__all__ = [
    "UNKNOWN_MOTION_MAS_YR",
    "Catalog",
    "CatalogStatus",
    "StarQuality",
    "StarTable",
    "VizierCatalog",
    "catalog_status",
    "open_catalog",
    "open_vizier",
    "read_star_list",
]
