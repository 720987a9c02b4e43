"""Which star catalogs this installation can open, for ``opnav doctor``."""

from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.catalog.bundled import bundled_cache_path, bundled_versions
from opnav_workbench.catalog.specs import READERS
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
    special = {"bundled": _bundled, "astrometry-net": _astrometry_net}
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
