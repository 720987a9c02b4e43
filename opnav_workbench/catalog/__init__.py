"""Star catalogs: opened by a one-line spec, asked for the stars within a cone or a polygon.

Enter by `open_catalog`, which returns a `Catalog`; a star list of one's own is read by `read_star_list`.

Answers are `StarTable`s in J2000 (ICRS), each star at its own epoch, with sigmas, Johnson V and B-V, and
`StarQuality` flags.

``specs``
    Spec to catalog, and what is available here.
``interface``
    `Catalog`, and what all of them do alike with a question.
``region``
    Cones and convex polygons on the sky.
``star_table``
    The stars themselves.
``quality``
    Flags of what may be wrong with a star.
``johnson``
    V and B-V from the catalogs' passbands.
``proper_motion``
    Motions and parallaxes that a catalog does not give.
``star_store``
    The one search, the stores that it asks, and the index of the sky.
``cache``
    Converted catalogs as memory-mapped records.
``cds_text``
    Text files with fixed columns.
``zones``
    Binary zone files, and what UCAC2 and UCAC4 have in common.
``bundled``
    Hipparcos merged with Gaia DR3, from two data packages.
``gaia_archive``
    Gaia DR3 of the whole sky to a magnitude, asked of a TAP service in pieces.
``hipparcos``
    The new reduction of Hipparcos: hip2.dat.
``tycho2``
    Tycho-2 of the CDS.
``ucac2``
    UCAC2 zone files.
``ucac4``
    UCAC4 zone files.
``astrometry_net``
    Index files of Astrometry.net.
``user_files``
    An npz file of the user's own arrays, and star lists.
``vizier``
    Cones of the VizieR service, kept on disk.
``vizier_tables``
    VizieR's tables and how their rows become stars.
``whole_sky``
    Whole catalogs fetched once over the network.
``combined``
    Several catalogs asked as one.
``deeper``
    What a deeper catalog would bring into a field.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.catalog.deeper import deeper_catalogs
    from opnav_workbench.catalog.interface import Catalog
    from opnav_workbench.catalog.proper_motion import UNKNOWN_MOTION_MAS_YR, unknown_motion_mixture
    from opnav_workbench.catalog.quality import StarQuality
    from opnav_workbench.catalog.specs import (
        CatalogStatus,
        catalog_contents,
        catalog_files,
        catalog_status,
        open_catalog,
    )
    from opnav_workbench.catalog.star_table import StarTable
    from opnav_workbench.catalog.user_files import read_star_list
    from opnav_workbench.catalog.vizier import VizierCatalog, open_vizier
    from opnav_workbench.catalog.whole_sky import fetch_whole_sky
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "Catalog": "interface",
            "deeper_catalogs": "deeper",
            "UNKNOWN_MOTION_MAS_YR": "proper_motion",
            "unknown_motion_mixture": "proper_motion",
            "StarQuality": "quality",
            "CatalogStatus": "specs",
            "catalog_contents": "specs",
            "catalog_files": "specs",
            "catalog_status": "specs",
            "open_catalog": "specs",
            "StarTable": "star_table",
            "read_star_list": "user_files",
            "VizierCatalog": "vizier",
            "open_vizier": "vizier",
            "fetch_whole_sky": "whole_sky",
        },
    )

__all__ = [
    "UNKNOWN_MOTION_MAS_YR",
    "Catalog",
    "CatalogStatus",
    "StarQuality",
    "StarTable",
    "VizierCatalog",
    "catalog_contents",
    "catalog_files",
    "catalog_status",
    "deeper_catalogs",
    "fetch_whole_sky",
    "open_catalog",
    "open_vizier",
    "read_star_list",
    "unknown_motion_mixture",
]
