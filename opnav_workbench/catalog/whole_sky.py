"""Whole catalogs fetched once over the network, and kept as records of our own: ``fetched:NAME``.

The files of a catalog's archive, or its answers for pieces of the sky, are fetched one by one; what is there stays for the
next attempt, after a cut or in another process. Each is checked to be whole before it counts. Once all are there, they are
converted (`cache`), to a magnitude limit if one is given, and removed. The catalog ``bundled`` adds by itself what was
fetched.
"""

import gzip
import re
import shutil
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opnav_workbench.catalog.cache import CachedStars, Progress, Records, cache_path, cached_stars
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.star_store import StoredCatalog
from opnav_workbench.errors import CatalogError, DownloadError
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.resources import cache_root

if TYPE_CHECKING:
    from opnav_workbench import downloads
    from opnav_workbench.catalog import gaia_archive, tycho2
else:  # which catalogs were fetched is asked at each start
    downloads = module_on_demand("opnav_workbench.downloads")
    gaia_archive = module_on_demand("opnav_workbench.catalog.gaia_archive")
    tycho2 = module_on_demand("opnav_workbench.catalog.tycho2")

__all__ = ["WHOLE_SKY", "fetch_whole_sky", "fetched_names", "fetched_state", "open_fetched"]


NO_LIMIT = 99.0  # magnitude in the name of a file that holds all


@dataclass(frozen=True, slots=True)
class WholeSky:
    """An archive that holds a whole catalog."""

    url: str  # of the folder, or of the service
    files: Callable[
        [float | None], tuple[tuple[str, str], ...]
    ]  # to a magnitude: names, addresses behind the url
    check: Callable[[Path], None]  # that a file is whole
    records: Callable[[Path, Progress | None], Records]  # of a folder with these files
    open: Callable[[str, Path, Mapping[str, object]], Catalog]
    rule: int


Stored = Callable[[str, CachedStars, Mapping[str, Any]], StoredCatalog]


def _stored(stored: Stored, name: str, path: Path, identity: Mapping[str, object]) -> StoredCatalog:
    def gone() -> Records:
        raise CatalogError(f"{path} is damaged; run: opnav catalog fetch {name}.")

    stars = cached_stars(path, identity, gone)
    limit = identity["mag_limit"]
    facts = {"mag_limit": None if limit == NO_LIMIT else limit, "cache": str(path)}
    return stored(f"fetched:{name}", stars, facts)


def _tycho2_files(_mag_limit: float | None) -> tuple[tuple[str, str], ...]:
    names = (*(f"{name}.gz" for name in tycho2.PARTS), f"{tycho2.SUPPLEMENT_FILE}.gz")
    return tuple((name, f"/{name}") for name in names)


def _check_packed(path: Path) -> None:
    """Read a packed file to its end: its checksum stands there."""
    try:
        with gzip.open(path) as stream:
            while stream.read(1 << 20):
                pass
    except (OSError, EOFError, zlib.error) as error:
        raise DownloadError(
            f"{path.name.removesuffix('.part')} came damaged ({error}); fetch it again."
        ) from error


WHOLE_SKY: Mapping[str, str] = {
    "tycho2": "2.5 million stars to magnitude 12",
    "gaia": "Gaia DR3 to a magnitude (--mag-limit, at most 15)",
}


def _archive(name: str) -> WholeSky:
    """Return one of `WHOLE_SKY`."""
    if name == "tycho2":
        return WholeSky(
            url="https://cdsarc.cds.unistra.fr/ftp/I/259/",
            files=_tycho2_files,
            check=_check_packed,
            records=tycho2.folder_records,
            open=partial(_stored, tycho2.stored_tycho2),
            rule=tycho2.RULE,
        )
    return WholeSky(
        url=gaia_archive.ARCHIVE,
        files=gaia_archive.archive_files,
        check=gaia_archive.check_piece,
        records=gaia_archive.piece_records,
        open=partial(_stored, gaia_archive.stored_gaia),
        rule=gaia_archive.RULE,
    )


STEM = "fetched-{name}-mag{limit:.2f}"
LIMIT = re.compile(r"-mag(\d+\.\d+)$")


def fetch_whole_sky(
    name: str,
    mag_limit: float | None = None,
    url: str | None = None,
    tell: Callable[[str, float], None] = lambda _what, _done: None,
) -> Catalog:
    """Fetch a whole catalog, or what is still missing of it, and return it as ``fetched:NAME`` opens it.

    Parameters
    ----------
    name
        One of `WHOLE_SKY`.
    mag_limit
        Fainter stars are left out; None: all, where the catalog may be had whole.
    url
        Another folder of the web that holds the same files, or another service that answers the same questions.
    tell : callable
        Told what is done, and the fraction of it.

    Raises
    ------
    CatalogError
        The catalog is unknown, or a file of it is damaged, or the limit is none of its.
    DownloadError
        A file cannot be had; those that were had are kept.
    """
    if name not in WHOLE_SKY:
        raise CatalogError(
            f"the whole sky of {name!r} cannot be fetched; fetch {', '.join(WHOLE_SKY)}, or a cone (--cone)."
        )
    source, limit = _archive(name), NO_LIMIT if mag_limit is None else float(mag_limit)
    files = source.files(mag_limit)
    folder = _fetching(name, files)
    for number, (file, address) in enumerate(files):
        tell(f"fetching {file}", number / len(files))
        if not (folder / file).is_file():
            downloads.download((url or source.url).rstrip("/") + address, folder / file, check=source.check)

    def build() -> Records:
        records = source.records(folder, lambda done: tell(f"reading {name}", done))
        kept = records[records["mag"] <= limit]
        if len(kept) == 0:
            raise CatalogError(f"{name} has no star to magnitude {limit:g}; give a fainter limit.")
        return kept

    path = _path(name, limit)
    cached_stars(path, _identity(name, source, limit), build)
    if not path.is_file():
        raise CatalogError(f"cannot write {path}; free some space or set OPNAV_CACHE, and fetch again.")
    shutil.rmtree(folder, ignore_errors=True)
    return open_fetched(name)


def _fetching(name: str, files: tuple[tuple[str, str], ...]) -> Path:
    """Return the folder where files wait for the others: those of other addresses (another limit) in another."""
    plain = all(address == f"/{file}" for file, address in files)
    mark = "" if plain else "-" + sha256(repr(files).encode()).hexdigest()[:12]
    return cache_root() / "catalogs" / f"fetching-{name}{mark}"


def open_fetched(name: str) -> Catalog:
    """Open the deepest of the catalogs of this name that were fetched.

    Raises
    ------
    CatalogError
        None was, or its file is damaged.
    """
    limits = _limits(name) if name in WHOLE_SKY else []
    if not limits:
        known = ", ".join(WHOLE_SKY)
        raise CatalogError(f"no catalog {name!r} was fetched; run: opnav catalog fetch {known}.")
    source, limit = _archive(name), max(limits)
    return source.open(name, _path(name, limit), _identity(name, source, limit))


def fetched_names() -> tuple[str, ...]:
    """Return the names of the whole catalogs that were fetched."""
    return tuple(name for name in WHOLE_SKY if _limits(name))


def fetched_state(name: str) -> str:
    """Return what of a catalog was fetched, in words that change when it does."""
    limits = _limits(name)
    if not limits:
        return "not fetched"
    size = _path(name, max(limits)).stat().st_size
    return f"to magnitude {max(limits):g}, {size} bytes"


def _limits(name: str) -> list[float]:
    found = _path(name, NO_LIMIT).parent.glob(f"fetched-{name}-mag*.stars")
    return [float(match.group(1)) for path in found if (match := LIMIT.search(path.stem))]


def _path(name: str, limit: float) -> Path:
    return cache_path(STEM.format(name=name, limit=limit))


def _identity(name: str, source: WholeSky, limit: float) -> dict[str, object]:
    return {"fetched": name, "mag_limit": limit, "rule": source.rule}
