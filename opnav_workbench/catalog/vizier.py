"""Catalogs of the VizieR service, kept cone by cone on disk: what was asked once works without a network.

A cone is answered from disk where one was fetched that contains it, to at least its magnitude. Each answer is a file
``vizier/NAME/RA_DEC_RADIUS_MAG.npz`` in the cache folder; deleting it is harmless.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from opnav_workbench.catalog.interface import Catalog, check_cone, select
from opnav_workbench.catalog.proper_motion import with_mean_motion
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.region import Region
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.catalog.vizier_tables import TABLES, VizierTable, plain_columns, stars_from_rows
from opnav_workbench.constants import FASTEST_STAR_RAD_YR
from opnav_workbench.errors import CatalogError
from opnav_workbench.files import atomic_path
from opnav_workbench.geometry import angle_between, jyear_from_et, radec_from_unit, unit_from_radec
from opnav_workbench.npz_file import read_npz
from opnav_workbench.parts import install_command
from opnav_workbench.resources import cache_root

__all__ = ["VizierCatalog", "open_vizier"]

# Added to a cone that is fetched, so that the next pictures of a sequence are served by it too.
FETCH_MARGIN = 1.1
TIMEOUT_S = 120.0
REASON_CHARS = 120  # of what went wrong in the network, in a message
CONE_MEMBER = "__cone__"
# What reading a damaged file may raise; it counts as none, and its cone will be fetched again.
DAMAGED_FILE_ERRORS = (OSError, ValueError, KeyError, TypeError)

AskService = Callable[[VizierTable, "FetchedCone"], Table]


@dataclass(frozen=True, slots=True)
class FetchedCone:
    """A cone that was asked for, in degrees, and the faintest magnitude in it (None: no limit)."""

    ra_deg: float
    dec_deg: float
    radius_deg: float
    mag_limit: float | None

    @property
    def stem(self) -> str:
        """File name."""
        limit = "all" if self.mag_limit is None else f"{self.mag_limit:.2f}"
        return f"{self.ra_deg:.5f}_{self.dec_deg:+.5f}_{self.radius_deg:.5f}_{limit}"

    def contains(self, other: "FetchedCone") -> bool:
        """Tell whether every star of another cone stands in this one."""
        apart = angle_between(self.center, other.center)
        room = self.radius_deg - other.radius_deg - math.degrees(float(apart))
        if self.mag_limit is None:
            return room >= 0.0
        return room >= 0.0 and other.mag_limit is not None and other.mag_limit <= self.mag_limit

    @property
    def center(self) -> NDArray[np.float64]:
        """Unit vector (3,), J2000."""
        return unit_from_radec(math.radians(self.ra_deg), math.radians(self.dec_deg))


def ask_vizier(layout: VizierTable, cone: FetchedCone) -> Table:
    """Ask the service; needs the ``online`` extra and a network.

    Raises
    ------
    CatalogError
        astroquery is not installed, or the service did not answer.
    """
    try:
        from astropy import units as u  # noqa: PLC0415 (only here, with astroquery)
        from astropy.coordinates import SkyCoord  # noqa: PLC0415
        from astroquery.vizier import Vizier  # noqa: PLC0415
    except ImportError as error:
        raise CatalogError(f"catalogs of VizieR need astroquery; {install_command('online')}.") from error
    filters = {} if cone.mag_limit is None else {layout.mag: f"<={cone.mag_limit}"}
    service = Vizier(columns=layout.columns, column_filters=filters, row_limit=-1, timeout=TIMEOUT_S)
    center = SkyCoord(cone.ra_deg, cone.dec_deg, unit="deg", frame="icrs")
    try:
        answer = service.query_region(
            center, radius=cone.radius_deg * u.deg, catalog=layout.table, cache=False
        )
    except Exception as error:  # every kind of network failure, and what astroquery makes of it
        raise CatalogError(
            f"VizieR did not answer ({_reason(error)}); check the network and try again."
        ) from error
    return answer[0] if len(answer) else Table({name: np.empty(0) for name in layout.columns})


def _reason(error: Exception) -> str:
    """Return the innermost cause in a few words; what wraps it repeats the address and names classes."""
    while error.__context__ is not None and isinstance(error.__context__, Exception):
        error = error.__context__
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= REASON_CHARS else f"{words[:REASON_CHARS]}..."


class VizierCatalog(Catalog):
    """One catalog of VizieR with its cones on disk.

    Parameters
    ----------
    kind
        A name of `vizier_tables.TABLES`.
    ask : callable
        Asks the service.
    """

    __slots__ = ("_ask", "_kind", "_layout")

    def __init__(self, kind: str, ask: AskService = ask_vizier) -> None:
        self._kind, self._layout, self._ask = kind, TABLES[kind], ask
        self.name = f"vizier:{kind}"

    @property
    def folder(self) -> Path:
        """Where the cones are kept."""
        return cache_root() / "vizier" / self._kind

    def describe(self) -> Mapping[str, Any]:
        """Return what the catalog is, and the cones on disk."""
        kept = list(self.fetched())
        return {
            "name": self.name,
            "source": f"VizieR table {self._layout.table}",
            "bands": [self._layout.band],
            "n_stars": sum(n for _, n in kept),
            "brightest_mag": math.nan,
            "faintest_mag": math.nan,
            "first_epoch_jyear": self._layout.epoch_jyear,
            "last_epoch_jyear": self._layout.epoch_jyear,
            "cones_on_disk": [{**asdict(cone), "n_stars": n} for cone, n in kept],
            "folder": str(self.folder),
        }

    def fetched(self) -> Iterator[tuple[FetchedCone, int]]:
        """Return the cones on disk and how many stars each has; a damaged file counts for none."""
        for path in sorted(self.folder.glob("*.npz")):
            cone, rows = _cone_of(path), _rows_of(path)
            if cone is not None and rows is not None:
                yield cone, len(rows[self._layout.mag])

    def fetch(self, ra_deg: float, dec_deg: float, radius_deg: float, mag_limit: float | None) -> int:
        """Ask the service for a cone and keep it; return the number of rows.

        Raises
        ------
        CatalogError
            The cone is none, or the service cannot be asked.
        """
        check_cone(math.radians(ra_deg), math.radians(dec_deg), math.radians(radius_deg))
        cone = FetchedCone(ra_deg % 360.0, dec_deg, radius_deg, mag_limit)
        rows = plain_columns(self._ask(self._layout, cone), self._layout)
        _write(self.folder / f"{cone.stem}.npz", cone, rows)
        return len(rows[self._layout.mag])

    def search(
        self, region: Region, mag_limit: float, et_s: float | None, exclude_flags: StarQuality
    ) -> StarTable:
        """Return the stars within a region, brightest first.

        Raises
        ------
        CatalogError
            The cone is not on disk and the service cannot be asked; the message has the command to fetch it.
        """
        years = 0.0 if et_s is None else abs(float(jyear_from_et(et_s)) - self._layout.epoch_jyear)
        reach = min(region.radius_rad + years * FASTEST_STAR_RAD_YR, math.pi)
        ra, dec = (math.degrees(float(angle)) for angle in radec_from_unit(region.center))
        limit = None if math.isinf(mag_limit) else mag_limit
        stars = stars_from_rows(self._rows(FetchedCone(ra, dec, math.degrees(reach), limit)), self._layout)
        return select(with_mean_motion(stars), region, mag_limit, et_s, exclude_flags)

    def _rows(self, wanted: FetchedCone) -> Mapping[str, NDArray[Any]]:
        kept = self._kept(wanted)
        if kept is not None:
            return kept
        wider = FETCH_MARGIN * wanted.radius_deg
        try:
            self.fetch(wanted.ra_deg, wanted.dec_deg, wider, wanted.mag_limit)
        except CatalogError as error:
            limit = "" if wanted.mag_limit is None else f" --mag {wanted.mag_limit:g}"
            raise CatalogError(
                f"{self.name}: the cone at RA {wanted.ra_deg:.4f}, Dec {wanted.dec_deg:.4f} deg, radius "
                f"{wanted.radius_deg:.4f} deg is not on disk, and {error} Where there is a network, run: opnav catalog "
                f"fetch {self._kind} --cone {wanted.ra_deg:.4f} {wanted.dec_deg:.4f} {wider:.4f}{limit}"
            ) from error
        fetched = self._kept(wanted)
        if fetched is None:
            raise CatalogError(
                f"{self.folder} does not keep what is written to it; name another cache folder."
            )
        return fetched

    def _kept(self, wanted: FetchedCone) -> dict[str, NDArray[Any]] | None:
        for path in sorted(self.folder.glob("*.npz")):
            cone = _cone_of(path)
            rows = _rows_of(path) if cone is not None and cone.contains(wanted) else None
            if rows is not None:
                return rows
        return None


def open_vizier(kind: str) -> VizierCatalog:
    """Open a catalog of VizieR.

    Raises
    ------
    CatalogError
        The name is unknown.

    Examples
    --------
    >>> open_vizier("gaia-dr3").name
    'vizier:gaia-dr3'
    """
    if kind not in TABLES:
        raise CatalogError(f"unknown VizieR catalog {kind!r}; use {', '.join(TABLES)}.")
    return VizierCatalog(kind)


def _write(path: Path, cone: FetchedCone, rows: Mapping[str, NDArray[Any]]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CatalogError(
            f"cannot make {path.parent}: {error.strerror or error}; name another cache folder."
        ) from error
    members: dict[str, Any] = {_member_name(name): column for name, column in rows.items()}
    members[CONE_MEMBER] = json.dumps(asdict(cone))
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **members)


def _cone_of(path: Path) -> FetchedCone | None:
    try:
        content = read_npz(path, {CONE_MEMBER})
        return FetchedCone(**json.loads(str(content[CONE_MEMBER])))
    except DAMAGED_FILE_ERRORS:
        return None


def _rows_of(path: Path) -> dict[str, NDArray[Any]] | None:
    try:
        return {_column_name(k): column for k, column in read_npz(path).items() if k != CONE_MEMBER}
    except DAMAGED_FILE_ERRORS:
        return None


def _member_name(column: str) -> str:
    """Return a column name without characters that a member of an archive should not have."""
    return re.sub(r"[^A-Za-z0-9_]", lambda found: f"%{ord(found[0]):02x}", column)


def _column_name(member: str) -> str:
    return re.sub(r"%([0-9a-f]{2})", lambda found: chr(int(found[1], 16)), member)
