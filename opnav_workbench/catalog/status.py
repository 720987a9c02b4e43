"""Which star catalogs this installation can open, for ``opnav doctor``."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.catalog.bundled import bundled_cache_path, bundled_versions
from opnav_workbench.catalog.specs import READERS
from opnav_workbench.catalog.vizier import VizierCatalog
from opnav_workbench.catalog.vizier_tables import TABLES
from opnav_workbench.errors import CatalogError

__all__ = ["CatalogStatus", "catalog_status"]

INDEX_FOLDER = Path("/usr/share/astrometry")  # where Debian's packages astrometry-data-* put them


@dataclass(frozen=True, slots=True)
class CatalogStatus:
    """One kind of catalog: whether it can be opened here, and what there is to know."""

    form: str  # how its spec is written
    available: bool
    detail: str
    versions: tuple[tuple[str, str], ...] = ()  # (data package, version)
    cache_path: Path | None = None
    cache_built: bool = False


def catalog_status() -> tuple[CatalogStatus, ...]:
    """Return the state of every kind of catalog, without opening any.

    Examples
    --------
    >>> [status.form for status in catalog_status()][:3]
    ['bundled', 'tycho2:DIR', 'ucac2:DIR']
    """
    special = {"bundled": _bundled, "astrometry-net": _astrometry_net, "vizier": _vizier}
    plain = "needs files of yours"
    return tuple(
        special[kind]() if kind in special else CatalogStatus(reader.form, available=True, detail=plain)
        for kind, reader in READERS.items()
    )


def _bundled() -> CatalogStatus:
    try:
        versions, path = bundled_versions(), bundled_cache_path()
    except CatalogError as error:
        return CatalogStatus("bundled", available=False, detail=str(error))
    built = path.is_file()
    return CatalogStatus(
        form="bundled",
        available=True,
        detail=f"cache {'at' if built else 'will be built at first use:'} {path}",
        versions=tuple(versions.items()),
        cache_path=path,
        cache_built=built,
    )


def _astrometry_net() -> CatalogStatus:
    files = list(INDEX_FOLDER.glob("index-*.fits"))
    return CatalogStatus(
        form="astrometry-net:GLOB",
        available=True,
        detail=f"{len(files)} index files in {INDEX_FOLDER}; give a GLOB for other folders",
    )


def _vizier() -> CatalogStatus:
    kept = sum(1 for kind in TABLES for _ in VizierCatalog(kind).folder.glob("*.npz"))
    online = importlib.util.find_spec("astroquery") is not None
    ask = "" if online else '; to ask the service: pip install "opnav_workbench[online]"'
    names = ", ".join(TABLES)
    return CatalogStatus("vizier:NAME", available=True, detail=f"{names}; {kept} cones on disk{ask}")
