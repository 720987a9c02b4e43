"""Catalog specs: one line of text that says which star catalog to use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from opnav_workbench.catalog.astrometry_net import open_astrometry_net
from opnav_workbench.catalog.bundled import open_bundled
from opnav_workbench.catalog.cache import Progress
from opnav_workbench.catalog.combined import CombinedCatalog, split_specs
from opnav_workbench.catalog.hip2 import open_hip2
from opnav_workbench.catalog.interface import Catalog
from opnav_workbench.catalog.npz import open_npz
from opnav_workbench.catalog.tycho2 import open_tycho2
from opnav_workbench.catalog.ucac2 import open_ucac2
from opnav_workbench.catalog.ucac4 import open_ucac4
from opnav_workbench.catalog.vizier import open_vizier
from opnav_workbench.errors import CatalogError

__all__ = ["READERS", "Reader", "open_catalog"]


@dataclass(frozen=True, slots=True)
class Reader:
    """How one kind of spec is written and opened."""

    form: str  # as shown to the user; "KIND:ARGUMENT" where it takes an argument
    open: Callable[[str, Progress | None], Catalog]


# A new catalog is one more line here.
READERS: Mapping[str, Reader] = {
    "bundled": Reader("bundled", lambda _argument, progress: open_bundled(progress)),
    "tycho2": Reader("tycho2:DIR", open_tycho2),
    "ucac2": Reader("ucac2:DIR", lambda argument, _progress: open_ucac2(argument)),
    "ucac4": Reader("ucac4:DIR", lambda argument, _progress: open_ucac4(argument)),
    "hip2": Reader("hip2:DIR", open_hip2),
    "npz": Reader("npz:FILE", lambda argument, _progress: open_npz(argument)),
    "vizier": Reader("vizier:NAME", lambda argument, _progress: open_vizier(argument)),
    "astrometry-net": Reader(
        "astrometry-net:GLOB", lambda argument, _progress: open_astrometry_net(argument)
    ),
}


def open_catalog(spec: str, progress: Progress | None = None) -> Catalog:
    """Open a star catalog.

    Parameters
    ----------
    spec : str
        ``bundled`` (490,000 stars to magnitude 10, comes with pip); the original distributions of Tycho-2, UCAC2,
        UCAC4 and Hipparcos-2 in a folder: ``tycho2:DIR``, ``ucac2:DIR``, ``ucac4:DIR``, ``hip2:DIR`` (or the file);
        ``npz:FILE`` (see `catalog.npz` for its arrays); ``astrometry-net:GLOB`` (index files, optionally with
        ``?epoch=JYEAR``); ``vizier:NAME`` (asked over the network, kept on disk). Specs joined by ``+`` are one
        catalog, see `catalog.combine`.
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
    opnav_workbench.errors.CatalogError: unknown catalog 'sao'; use bundled, tycho2:DIR,
    ucac2:DIR, ucac4:DIR, hip2:DIR, npz:FILE, vizier:NAME or astrometry-net:GLOB.
    """
    parts = split_specs(spec, tuple(READERS))
    if len(parts) > 1:
        return CombinedCatalog([open_catalog(part, progress) for part in parts])
    kind, colon, argument = spec.strip().partition(":")
    reader = READERS.get(kind)
    if reader is None:
        raise CatalogError(f"unknown catalog {spec!r}; use {_forms()}.")
    takes_argument = ":" in reader.form
    if takes_argument != bool(argument) or (colon and not takes_argument):
        raise CatalogError(f"catalog {spec!r} is not of the form {reader.form}; use {_forms()}.")
    return reader.open(argument, progress)


def _forms() -> str:
    *others, last = (reader.form for reader in READERS.values())
    return f"{', '.join(others)} or {last}"
