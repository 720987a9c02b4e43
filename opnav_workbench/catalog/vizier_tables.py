"""Tables of the VizieR service and how their rows become stars.

Column names are VizieR's; errors in RA contain cos(dec).

==========  ===============  ===========================================================================================
name        table            source
==========  ===============  ===========================================================================================
gaia-dr3    I/355/gaiadr3    Gaia DR3 (2023), A&A 674, A1; RUWE above 1.4: BAD_ASTROMETRY
tycho2      I/259/tyc2       Hog et al. (2000), A&A 355, L27; rows without a mean position are left out
ucac4       I/322A/out       Zacharias et al. (2013), AJ 145, 44
hip2        I/311/hip2       van Leeuwen (2007), A&A 474, 653
==========  ===============  ===========================================================================================
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog.johnson import (
    Johnson,
    johnson_from_gaia,
    johnson_from_hipparcos,
    johnson_from_standard,
    johnson_from_tycho,
    johnson_from_ucac,
)
from opnav_workbench.catalog.proper_motion import UNKNOWN_MOTION_MAS_YR, astrometry_columns
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.errors import CatalogError

if TYPE_CHECKING:
    from astropy.table import Table

__all__ = ["TABLES", "VizierTable", "stars_from_rows"]

RUWE_LIMIT = 1.4  # Lindegren et al. (2021), A&A 649, A2, section 5.3

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class VizierTable:
    """One table: which columns hold what.

    Attributes
    ----------
    table
        VizieR's name.
    position, position_sigma, motion, motion_sigma : (str, str)
        RA and Dec.
    mag, band
        Column of the magnitude, and what band it is.
    extra
        Further columns, for the functions below.
    name, johnson, flags
        From the columns to names, V and B-V, `StarQuality`.
    """

    table: str
    position: tuple[str, str]
    position_sigma: tuple[str, str]
    motion: tuple[str, str]
    motion_sigma: tuple[str, str]
    mag: str
    band: str
    epoch_jyear: float
    name: Callable[[Columns], NDArray[np.str_]]
    johnson: Callable[[Columns], Johnson]
    extra: tuple[str, ...]
    parallax: str | None = None
    parallax_sigma: str | None = None
    rv: str | None = None
    hip: str | None = None
    flags: Callable[[Columns], NDArray[np.int64]] | None = None

    @property
    def columns(self) -> list[str]:
        """Every column to ask for."""
        optional = [c for c in (self.parallax, self.parallax_sigma, self.rv, self.hip) if c is not None]
        wanted = [*self.position, *self.position_sigma, *self.motion, *self.motion_sigma, self.mag]
        return list(dict.fromkeys([*wanted, *optional, *self.extra]))


def _numbered(prefix: str, column: str) -> Callable[[Columns], NDArray[np.str_]]:
    return lambda rows: np.array([f"{prefix}{int(n)}" for n in rows[column]], dtype=np.str_)


def _tycho_names(rows: Columns) -> NDArray[np.str_]:
    parts = zip(rows["TYC1"], rows["TYC2"], rows["TYC3"], strict=True)
    return np.array([f"TYC {int(a)}-{int(b)}-{int(c)}" for a, b, c in parts], dtype=np.str_)


def _ucac_names(rows: Columns) -> NDArray[np.str_]:
    return np.array([f"UCAC4-{name}" for name in rows["UCAC4"]], dtype=np.str_)


def _unknown(values: NDArray[Any]) -> FloatArray:
    return np.full(values.shape, np.nan)


def _ucac_johnson(rows: Columns) -> Johnson:
    sigma = np.full(rows["Vmag"].shape, 0.05)  # APASS, typical
    measured = johnson_from_standard(rows["Bmag"], sigma, rows["Vmag"], sigma)
    return measured.or_else(
        johnson_from_ucac(rows["a.mag"], _unknown(rows["a.mag"]), rows["Jmag"], rows["Kmag"])
    )


def _ruwe_flags(rows: Columns) -> NDArray[np.int64]:
    return np.where(rows["RUWE"] > RUWE_LIMIT, int(StarQuality.BAD_ASTROMETRY), 0).astype(np.int64)


TABLES: Mapping[str, VizierTable] = {
    "gaia-dr3": VizierTable(
        table="I/355/gaiadr3",
        position=("RA_ICRS", "DE_ICRS"),
        position_sigma=("e_RA_ICRS", "e_DE_ICRS"),
        motion=("pmRA", "pmDE"),
        motion_sigma=("e_pmRA", "e_pmDE"),
        parallax="Plx",
        parallax_sigma="e_Plx",
        rv="RV",
        mag="Gmag",
        band="G",
        epoch_jyear=2016.0,
        extra=("Source", "BPmag", "RPmag", "RUWE"),
        name=_numbered("Gaia DR3 ", "Source"),
        johnson=lambda rows: johnson_from_gaia(rows["Gmag"], rows["BPmag"], rows["RPmag"]),
        flags=_ruwe_flags,
    ),
    "tycho2": VizierTable(
        table="I/259/tyc2",
        position=("RAmdeg", "DEmdeg"),
        position_sigma=("e_RAmdeg", "e_DEmdeg"),
        motion=("pmRA", "pmDE"),
        motion_sigma=("e_pmRA", "e_pmDE"),
        mag="VTmag",
        band="VT",
        epoch_jyear=2000.0,
        extra=("TYC1", "TYC2", "TYC3", "BTmag", "e_BTmag", "e_VTmag"),
        hip="HIP",
        name=_tycho_names,
        johnson=lambda rows: johnson_from_tycho(
            rows["BTmag"], rows["e_BTmag"], rows["VTmag"], rows["e_VTmag"]
        ),
    ),
    "ucac4": VizierTable(
        table="I/322A/out",
        position=("RAJ2000", "DEJ2000"),
        position_sigma=("ePos", "ePos"),
        motion=("pmRA", "pmDE"),
        motion_sigma=("e_pmRA", "e_pmDE"),
        mag="f.mag",
        band="UCAC",
        epoch_jyear=2000.0,
        extra=("UCAC4", "a.mag", "Jmag", "Kmag", "Bmag", "Vmag"),
        name=_ucac_names,
        johnson=_ucac_johnson,
    ),
    "hip2": VizierTable(
        table="I/311/hip2",
        position=("RArad", "DErad"),
        position_sigma=("e_RArad", "e_DErad"),
        motion=("pmRA", "pmDE"),
        motion_sigma=("e_pmRA", "e_pmDE"),
        parallax="Plx",
        parallax_sigma="e_Plx",
        mag="Hpmag",
        band="Hp",
        epoch_jyear=1991.25,
        hip="HIP",
        extra=("e_Hpmag", "B-V"),
        name=_numbered("HIP ", "HIP"),
        johnson=lambda rows: johnson_from_hipparcos(
            rows["Hpmag"], rows["e_Hpmag"], rows["B-V"], _unknown(rows["B-V"])
        ),
    ),
}


def plain_columns(rows: "Table", layout: VizierTable) -> dict[str, NDArray[Any]]:
    """Return the answer's columns as arrays without masks: text as it is, numbers as float64 with nan, angles in rad.

    Raises
    ------
    CatalogError
        A column that should be there is not.
    """
    missing = [name for name in layout.columns if name not in rows.colnames]
    if missing:
        raise CatalogError(
            f"VizieR's table {layout.table} came without {', '.join(missing)}; it may have changed: update opnav_workbench."
        )
    from astropy import units as u  # noqa: PLC0415 (a tenth of a short command; few fetch stars)

    plain = {name: _plain(rows, name, exact=name == "Source") for name in layout.columns}
    for name in layout.position:
        plain[name] = plain[name] * (rows[name].unit or u.deg).to(u.rad)
    return plain


def _plain(rows: "Table", name: str, *, exact: bool) -> NDArray[Any]:
    column = rows[name]
    if column.dtype.kind in "USO":
        return np.asarray(column.astype(str), dtype=np.str_)
    if exact:  # identifiers have more digits than a double
        return np.asarray(column, dtype=np.int64)
    values = np.ma.asarray(column, dtype=np.float64)
    return np.ma.filled(values, np.nan)


def stars_from_rows(rows: Columns, layout: VizierTable) -> StarTable:
    """Return the stars of `plain_columns`; rows without position or magnitude are left out."""
    whole = np.all([np.isfinite(rows[c]) for c in (*layout.position, layout.mag)], axis=0)
    kept = {name: column[whole] for name, column in rows.items()}
    mag = kept[layout.mag]
    motion, motion_sigma = _pair(kept, layout.motion), _pair(kept, layout.motion_sigma)
    parallax, parallax_sigma = (
        kept[name] if name else _unknown(mag) for name in (layout.parallax, layout.parallax_sigma)
    )
    return StarTable(
        id=layout.name(kept),
        ra_rad=kept[layout.position[0]],
        dec_rad=kept[layout.position[1]],
        rv_km_s=kept[layout.rv] if layout.rv else _unknown(mag),
        mag=mag,
        band=np.full(mag.shape, layout.band),
        epoch_jyear=np.full(mag.shape, layout.epoch_jyear),
        hip=np.nan_to_num(kept[layout.hip]).astype(np.int64) if layout.hip else np.zeros(mag.shape, np.int64),
        flags=layout.flags(kept) if layout.flags else np.zeros(mag.shape, np.int64),
        **astrometry_columns(
            mag,
            np.nan_to_num(_pair(kept, layout.position_sigma), nan=100.0),
            motion,
            np.where(np.isfinite(motion_sigma), motion_sigma, UNKNOWN_MOTION_MAS_YR),
            np.asarray(np.isfinite(motion).all(axis=1)),
            parallax,
            parallax_sigma,
        ),
        **layout.johnson(kept).columns(),
    )


def _pair(rows: Columns, names: tuple[str, str]) -> FloatArray:
    return np.stack([rows[name] for name in names], axis=-1)
