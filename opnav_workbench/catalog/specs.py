"""Catalog specs: one line of text that says which star catalog to use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from opnav_workbench.catalog.astrometry_net import open_astrometry_net
from opnav_workbench.catalog.bundled import open_bundled
from opnav_workbench.catalog.indexed import Catalog
from opnav_workbench.catalog.npz import open_npz
from opnav_workbench.errors import CatalogError

__all__ = ["READERS", "Reader", "open_catalog"]


@dataclass(frozen=True, slots=True)
class Reader:
    """How one kind of spec is written and opened."""

    form: str  # as shown to the user; "KIND:ARGUMENT" where it takes an argument
    open: Callable[[str], Catalog]


# A new catalog is one more line here.
READERS: Mapping[str, Reader] = {
    "bundled": Reader("bundled", lambda _argument: open_bundled()),
    "npz": Reader("npz:FILE", open_npz),
    "astrometry-net": Reader("astrometry-net:GLOB", open_astrometry_net),
}


def open_catalog(spec: str) -> Catalog:
    """Open a star catalog.

    Parameters
    ----------
    spec : str
        ``bundled`` (490,000 stars to magnitude 10, comes with pip), ``npz:FILE`` (see `catalog.npz` for its
        arrays) or ``astrometry-net:GLOB`` (index files, optionally with ``?epoch=JYEAR``).

    Returns
    -------
    Catalog
        Ask it with ``cone``.

    Raises
    ------
    CatalogError
        The spec is unknown, or its file is missing or malformed.

    Examples
    --------
    >>> open_catalog("sao")
    Traceback (most recent call last):
    opnav_workbench.errors.CatalogError: unknown catalog 'sao'; use bundled, npz:FILE or astrometry-net:GLOB.
    """
    kind, colon, argument = spec.strip().partition(":")
    reader = READERS.get(kind)
    if reader is None:
        raise CatalogError(f"unknown catalog {spec!r}; use {_forms()}.")
    takes_argument = ":" in reader.form
    if takes_argument != bool(argument) or (colon and not takes_argument):
        raise CatalogError(f"catalog {spec!r} is not of the form {reader.form}; use {_forms()}.")
    return reader.open(argument)


def _forms() -> str:
    *others, last = (reader.form for reader in READERS.values())
    return f"{', '.join(others)} or {last}"
