"""Stars from files of the user's own: a catalog in one npz file, and a list of a few stars in YAML.

``read_star_list`` is for stars that are themselves targets, such as Proxima Centauri seen from New Horizons: by
name, with full astrometry. ``npz:FILE`` is a catalog of arrays:

==================  ======================================================================================
array               meaning; (n,) unless said otherwise
==================  ======================================================================================
ra_deg, dec_deg     required; ICRS at the epoch, 0..360 and -90..90
mag                 required
id                  names; absent: ``row:N`` with N the row of the file, counted from 0
pmra_mas_yr         motion in RA with cos(dec); together with pmdec_mas_yr; nan: this star's is unknown
pmdec_mas_yr        motion in dec
parallax_mas        nan: this star's is unknown
rv_km_s             nan: unknown
sigma_mas           (n,) or scalar; 1 sigma an axis of the position; absent: 100 mas
epoch_jyear         (n,) or scalar; absent: 2000.0
band                (n,) or scalar text; absent: ``V``; V is made of it (see `johnson.johnson_from_bands`)
==================  ======================================================================================

Every optional array but ``id`` may be a scalar that holds for all stars. Other arrays are left alone.
"""

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.johnson import johnson_from_bands
from opnav_workbench.catalog.proper_motion import (
    astrometry_columns,
    unstated_motion_sigma_mas_yr,
    unstated_parallax_sigma_mas,
)
from opnav_workbench.catalog.star_store import IndexedCatalog, MotionBound
from opnav_workbench.catalog.star_table import EPOCHS_JYEAR, StarTable
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.npz_file import NpzDamage, read_npz
from opnav_workbench.yaml_file import StrictModel, read_model

__all__ = ["open_npz", "read_star_list"]


# ---- Catalogs in one npz file: arrays ``ra_deg dec_deg mag`` and whatever else the user has of the stars.

REQUIRED = ("ra_deg", "dec_deg", "mag")
# Optional arrays, the value where absent, and whether nan may say "unknown" for a single star.
OPTIONAL: dict[str, tuple[float, bool]] = {
    "pmra_mas_yr": (np.nan, True),
    "pmdec_mas_yr": (np.nan, True),
    "parallax_mas": (np.nan, True),
    "rv_km_s": (np.nan, True),
    "sigma_mas": (100.0, False),  # ground-based catalogs of the last century; says "not better than this"
    "epoch_jyear": (2000.0, False),
}
RANGES = {
    "ra_deg": (0.0, 360.0, "wrap right ascension into 0..360 degrees"),
    "dec_deg": (-90.0, 90.0, "declination runs from -90 to 90 degrees"),
    "mag": (-30.0, 60.0, "magnitudes lie between the Sun's and what no telescope sees"),
    "pmra_mas_yr": (-1e6, 1e6, "no star moves a hundred times as fast as Barnard's"),
    "pmdec_mas_yr": (-1e6, 1e6, "no star moves a hundred times as fast as Barnard's"),
    "parallax_mas": (-1e5, 1e5, "no star is a hundred times as near as Proxima"),
    "rv_km_s": (-3e5, 3e5, "nothing is faster than light"),
    "sigma_mas": (0.0, 1e8, "a sigma is not negative, nor a day's motion of the sky"),
    "epoch_jyear": (*EPOCHS_JYEAR, "give Julian years such as 2016.0"),
}
NpzColumns = Mapping[str, NDArray[Any]]


def open_npz(path: str | Path) -> IndexedCatalog:
    """Open an npz file as a catalog; see the head of this module for its arrays.

    Parameters
    ----------
    path
        The file; ``~`` stands for the home folder.

    Raises
    ------
    CatalogError
        The file is missing or damaged, an array is missing, of wrong length or kind, not finite or out of
        range.
    """
    file = Path(path).expanduser()
    columns = _checked_columns(_load(file), file.name)
    motion = np.hypot(columns["pmra_mas_yr"], columns["pmdec_mas_yr"]) * RAD_PER_MAS
    epochs = columns["epoch_jyear"]
    return IndexedCatalog(
        name=f"npz:{path}",
        facts={"file": str(file), "bands": sorted(set(np.unique(columns["band"]).tolist()))},
        ra_rad=np.asarray(columns["ra_deg"], dtype=np.float64) * RAD_PER_DEG,
        dec_rad=np.asarray(columns["dec_deg"], dtype=np.float64) * RAD_PER_DEG,
        mag=columns["mag"],
        build=partial(_table_of_rows, columns),
        motion=MotionBound(float(np.max(np.nan_to_num(motion))), float(epochs.min()), float(epochs.max())),
    )


def _load(file: Path) -> dict[str, NDArray[Any]]:
    try:
        return read_npz(file, {*REQUIRED, *OPTIONAL, "id", "band"})
    except FileNotFoundError as error:
        raise CatalogError(f"star catalog {file} does not exist; check the path after npz:.") from error
    except OSError as error:
        raise CatalogError(f"cannot read {file}: {error.strerror or error}; give an npz file.") from error
    except NpzDamage as error:
        raise CatalogError(f"star catalog {file}: {error}; write it with numpy.savez.") from error


def _checked_columns(data: NpzColumns, name: str) -> dict[str, NDArray[Any]]:
    """Return every column, absent ones filled, all of one length (scalars as views), rows as in the file."""
    missing = [key for key in REQUIRED if key not in data]
    if missing:
        raise CatalogError(
            f"{name} lacks {', '.join(missing)}; a catalog needs the arrays {', '.join(REQUIRED)}."
        )
    n = data["ra_deg"].size
    if n == 0 or data["ra_deg"].ndim != 1:
        raise CatalogError(f"{name}: ra_deg has shape {data['ra_deg'].shape}; give one value a star.")
    if ("pmra_mas_yr" in data) != ("pmdec_mas_yr" in data):
        raise CatalogError(
            f"{name} gives motion along one axis only; give both pmra_mas_yr and pmdec_mas_yr."
        )
    columns = {key: _number(data[key], key, n, name, nan_allowed=False) for key in REQUIRED}
    for key, (default, nan_allowed) in OPTIONAL.items():
        columns[key] = _number(data.get(key, np.array(default)), key, n, name, nan_allowed=nan_allowed)
    columns["band"] = _text(data.get("band", np.array("V")), "band", n, name)
    if "id" in data:
        columns["id"] = _text(data["id"], "id", n, name)
    return columns


def _number(values: NDArray[Any], key: str, n: int, name: str, *, nan_allowed: bool) -> NDArray[Any]:
    if values.dtype.kind not in "fiu":
        raise CatalogError(f"{name}: {key} has type {values.dtype}; store it as numbers.")
    column = _one_each(values, key, n, name)
    bad = np.isinf(values) if nan_allowed else ~np.isfinite(values)
    if np.any(bad):
        row = int(np.argmax(bad))
        raise CatalogError(f"{name}: {key} is {values.flat[row]} in row {row}; drop or mend such rows.")
    if key in RANGES:
        _check_range(values, key, name)
    return column


def _check_range(values: NDArray[Any], key: str, name: str) -> None:
    low, high, remedy = RANGES[key]
    known = values[~np.isnan(values)]
    if known.size and (known.min() < low or known.max() > high):
        raise CatalogError(
            f"{name}: {key} runs from {known.min():.6g} to {known.max():.6g}, outside {low:g}..{high:g}; "
            f"{remedy}."
        )


def _text(values: NDArray[Any], key: str, n: int, name: str) -> NDArray[Any]:
    if values.dtype.kind not in ("USiu" if key == "id" else "US"):
        raise CatalogError(f"{name}: {key} has type {values.dtype}; store it as numpy strings.")
    if key == "id" and values.ndim == 0:
        raise CatalogError(f"{name}: id is a single name for {n} stars; give one a star, or leave it out.")
    if values.dtype.kind == "S":
        try:
            np.char.decode(values, "utf-8")
        except UnicodeDecodeError as error:
            raise CatalogError(
                f"{name}: {key} holds bytes that are no UTF-8 ({error}); store it as text."
            ) from error
    return _one_each(values, key, n, name)


def _one_each(values: NDArray[Any], key: str, n: int, name: str) -> NDArray[Any]:
    if values.shape not in ((), (n,)):
        raise CatalogError(f"{name}: {key} has shape {values.shape} for {n} stars; give ({n},) or a scalar.")
    return np.broadcast_to(values, (n,))


def _table_of_rows(columns: NpzColumns, rows: IntArray) -> StarTable:
    """Build the table of some rows: unknown motion and parallax become 0 with the sigma of such stars."""
    column = {key: _float_rows(values, rows) for key, values in columns.items() if key not in ("id", "band")}
    position, band = column["sigma_mas"], _texts(columns["band"][rows])
    motion = np.stack([column["pmra_mas_yr"], column["pmdec_mas_yr"]], axis=-1)
    both = np.stack([position, position], axis=-1)
    return StarTable(
        id=_names(columns, rows),
        ra_rad=column["ra_deg"] * RAD_PER_DEG,
        dec_rad=column["dec_deg"] * RAD_PER_DEG,
        rv_km_s=column["rv_km_s"],
        mag=column["mag"],
        band=band,
        epoch_jyear=column["epoch_jyear"],
        **astrometry_columns(
            column["mag"],
            both,
            motion,
            unstated_motion_sigma_mas_yr(both),
            np.asarray(np.isfinite(motion).all(axis=1)),
            column["parallax_mas"],
            unstated_parallax_sigma_mas(position),
        ),
        **johnson_from_bands(column["mag"], band).columns(),
    )


def _float_rows(values: NDArray[Any], rows: IntArray) -> FloatArray:
    return np.asarray(values[rows], dtype=np.float64)


def _names(columns: NpzColumns, rows: IntArray) -> NDArray[np.str_]:
    if "id" in columns:
        return _texts(columns["id"][rows])
    width = len(str(rows.max(initial=0)))
    return np.char.add("row:", rows.astype(f"<U{width}"))  # of 100,000 stars names one by one would cost most


def _texts(values: NDArray[Any]) -> NDArray[np.str_]:
    return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values.astype(np.str_)


# ---- Star lists: a few stars by name with full astrometry, as a person writes them down (YAML).


class _Star(StrictModel):
    """One star as written in the file; motions include cos(dec) as catalogs give them."""

    name: str
    ra_deg: float = Field(ge=0.0, lt=360.0)
    dec_deg: float = Field(ge=-90.0, le=90.0)
    epoch_jyear: float
    pmra_mas_yr: float = 0.0
    pmdec_mas_yr: float = 0.0
    parallax_mas: float = Field(default=0.0, ge=0.0)
    rv_km_s: float | None = None
    mag: float
    band: str = "V"
    sigma_position_mas: float = Field(default=0.1, ge=0.0)
    sigma_parallax_mas: float = Field(default=0.1, ge=0.0)
    sigma_motion_mas_yr: float = Field(default=0.1, ge=0.0)
    source: str = ""


class StarList(StrictModel):
    stars: list[_Star] = Field(min_length=1)


def read_star_list(path: str | Path) -> StarTable:
    """Read a YAML star list (key ``stars``: name, ra_deg, dec_deg, epoch_jyear, mag and optional astrometry).

    Parameters
    ----------
    path : path to a YAML file

    Returns
    -------
    StarTable
        One row a star, ``id`` its name.

    Raises
    ------
    CatalogError
        The file is missing, is not YAML, or a value is absent or out of range (named).
    """
    try:
        status = Path(path).stat()
    except (OSError, ValueError):  # what is wrong with it, the reader tells
        return _star_list(path)
    return _star_list_once(path, (status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns))


@lru_cache(maxsize=8)
def _star_list_once(path: str | Path, _state: tuple[int, ...]) -> StarTable:
    """Return a star list, read anew once the file has changed: every star of it may be a target, and asks for it."""
    return _star_list(path)


def _star_list(path: str | Path) -> StarTable:
    return _table_of_stars(read_model(path, StarList, "star list", CatalogError).stars)


def _table_of_stars(stars: list[_Star]) -> StarTable:
    def column(name: str) -> FloatArray:
        return np.array([getattr(star, name) for star in stars], dtype=np.float64)

    position, parallax, motion = (
        column(f"sigma_{name}") * RAD_PER_MAS for name in ("position_mas", "parallax_mas", "motion_mas_yr")
    )
    return StarTable(
        id=np.array([star.name for star in stars]),
        ra_rad=column("ra_deg") * RAD_PER_DEG,
        dec_rad=column("dec_deg") * RAD_PER_DEG,
        pmra_rad_yr=column("pmra_mas_yr") * RAD_PER_MAS,
        pmdec_rad_yr=column("pmdec_mas_yr") * RAD_PER_MAS,
        parallax_rad=column("parallax_mas") * RAD_PER_MAS,
        rv_km_s=column("rv_km_s"),
        mag=column("mag"),
        band=np.array([star.band for star in stars]),
        epoch_jyear=column("epoch_jyear"),
        sigma=np.stack([position, position, parallax, motion, motion], axis=-1),
        motion_known=np.ones(len(stars), dtype=bool),
    )
