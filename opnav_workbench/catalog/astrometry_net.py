"""Index files of Astrometry.net as a star catalog, as Debian's packages astrometry-data-* install them.

An index file is a FITS file. Its star tree stores unit vectors as opaque bytes in the byte order that the header
card ENDIAN tells: the table ``kdtree_data_stars`` has n rows of three numbers, and ``kdtree_range_stars`` seven
doubles: lower corner (3), upper corner (3) and the number of tree units per data unit. Integer rows decode as
``lower + row / scale``; ``KDT_DATA`` names the type (double, float, u32, u16). The FITS table of AN_FILE 'TAGALONG'
has one row a star, in the order of the tree: magnitudes, and in the Gaia series also motions; columns are known by
their names, whatever else is there:

======================================  ======================================================================
column                                  meaning
======================================  ======================================================================
MAG_VT, MAG_BT, phot_g_mean_mag, *mag*  magnitude, the first of these that is there
phot_bp_mean_mag, phot_rp_mean_mag      for Johnson V and B-V, as MAG_BT beside MAG_VT
ra, dec                                 degrees; they replace the rounded directions of the tree
pmra, pmdec, parallax, and *_error      mas, mas/yr
source_id, ref_epoch                    Gaia's number of the star, Julian year
======================================  ======================================================================

Series 4100 and the Debian packages hold Tycho-2 (epoch J2000.0, no motions); series 5000 and 5200-HEAVY hold all
columns of Gaia DR2 (J2015.5), 5200-LITE neither magnitudes nor motions. A star that several files share
(neighboring tiles, scales) counts once.

Source: the README of series 5000 and the file headers themselves (program build-astrometry-index).
"""

import glob
import mmap
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.cache import (
    TABLE_COLUMNS,
    Records,
    RecordStore,
    cache_name,
    cache_path,
    cached_stars,
    source_identity,
    star_records,
)
from opnav_workbench.catalog.johnson import Johnson, johnson_from_bands, johnson_from_gaia, johnson_from_tycho
from opnav_workbench.catalog.proper_motion import astrometry_columns
from opnav_workbench.catalog.star_store import IndexedCatalog, MotionBound, StoredCatalog
from opnav_workbench.catalog.star_table import EPOCHS_JYEAR, StarTable
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.fits_layout import check_fits_layout, fits_malformed
from opnav_workbench.geometry import angle_between, radec_from_unit, unit_from_radec
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import regular_size

if TYPE_CHECKING:
    from astropy.io import fits
else:  # for files that are not converted yet
    fits = module_on_demand("astropy.io.fits")

__all__ = ["open_astrometry_net", "open_tycho2_index"]

RULE = 1  # raise it whenever an index file would make other records
TYCHO_BAND = "VT"


# ---- Index files of Astrometry.net: the directions of their stars and the columns beside them.

TREE_TYPES = {"double": "f8", "float": "f4", "u32": "u4", "u16": "u2"}
BYTE_ORDERS = {"04:03:02:01": "<", "01:02:03:04": ">"}
UNIT_TOLERANCE = 1e-3  # a direction decoded from 16 bit integers has a length within 3e-5 of one
RANGE_DOUBLES = 7

FitsHeader = Mapping[str, Any]


def read_index(file: Path) -> tuple[FloatArray, float, dict[str, NDArray[Any]]]:
    """Return unit vectors (n, 3), the step of their storage in mas, and the columns beside them by name.

    Raises
    ------
    CatalogError
        The file is no whole index file.
    """
    try:
        regular_size(file)
        with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            check_fits_layout(content)
        with warnings.catch_warnings(), fits.open(file, memmap=True) as hdus:
            warnings.simplefilter("ignore")  # a shortened file warns first and is refused below
            tables = {hdu.header.get("TTYPE1", hdu.name): hdu for hdu in hdus[1:]}
            tags = [hdu for hdu in hdus[1:] if hdu.header.get("AN_FILE") == "TAGALONG"]
            xyz, quantum_mas = _directions(file, hdus[0].header, tables)
            columns = {} if not tags else {c.name: np.asarray(tags[0].data[c.name]) for c in tags[0].columns}
    except fits_malformed() as error:
        reason = " ".join(str(error).split())
        raise CatalogError(
            f"{file} is not a whole Astrometry.net index file ({reason}); copy it again or narrow the glob."
        ) from error
    return xyz, quantum_mas, columns


def _directions(file: Path, primary: FitsHeader, tables: Mapping[str, Any]) -> tuple[FloatArray, float]:
    """Return the stars' unit vectors (n, 3) and the step of their storage in mas."""
    data, limits = tables["kdtree_data_stars"], tables["kdtree_range_stars"]
    tree = tables["kdtree_header_stars"].header if "kdtree_header_stars" in tables else {}
    order = BYTE_ORDERS[str(tree.get("ENDIAN", primary.get("ENDIAN", "04:03:02:01"))).strip()]
    kind = str(tree.get("KDT_DATA", "")).strip() or {24: "double", 12: "u32", 6: "u16"}[data.header["NAXIS1"]]
    rows = _bytes_as(file, data, order + TREE_TYPES[kind]).reshape(-1, 3)
    box = _bytes_as(file, limits, order + "f8")
    if box.size != RANGE_DOUBLES:
        raise ValueError(f"kdtree_range_stars holds {box.size} numbers, not {RANGE_DOUBLES}")
    integers = rows.dtype.kind == "u"
    xyz = box[:3] + rows / box[6] if integers else rows.astype(np.float64)
    length = np.linalg.norm(xyz, axis=1)
    if not np.all(np.abs(length - 1.0) < UNIT_TOLERANCE):
        raise ValueError(
            f"its star vectors have lengths from {length.min():.4g} to {length.max():.4g}, not 1"
        )
    step = 1.0 / float(box[6]) if integers else float(np.finfo(rows.dtype).eps)
    return xyz / length[:, None], step / RAD_PER_MAS


def _bytes_as(file: Path, hdu: Any, dtype: str) -> NDArray[Any]:
    """Return the bytes of a one-column table as numbers; astropy would take them for text."""
    size = int(hdu.header["NAXIS1"]) * int(hdu.header["NAXIS2"])
    with file.open("rb") as stream:
        stream.seek(hdu.fileinfo()["datLoc"])
        content = stream.read(size)
    if len(content) != size or size == 0:
        raise ValueError(f"{hdu.header['TTYPE1']} has {len(content)} of {size} bytes")
    return np.frombuffer(content, dtype=dtype)


# ---- Index files of Astrometry.net as a star catalog, as Debian's packages astrometry-data-* install them.


@dataclass(frozen=True, slots=True)
class MagnitudeColumn:
    """What a magnitude column says of the catalog that an index was made from."""

    name: str
    epoch_jyear: float
    sigma_mas: float  # position, one axis, at the epoch


# Columns in order of preference. Tycho-2: 60 mas over all stars (Hog et al. 2000, A&A 355, L27); Gaia DR2:
# below 0.1 mas at G < 17 (Lindegren et al. 2018, A&A 616, A2). Any other column says nothing of its catalog.
MAGNITUDE_COLUMNS = {
    "phot_g_mean_mag": MagnitudeColumn("G", 2015.5, 0.1),
    "MAG_VT": MagnitudeColumn("VT", 2000.0, 60.0),
    "MAG_BT": MagnitudeColumn("BT", 2000.0, 60.0),
}
OTHER_MAGNITUDE = MagnitudeColumn("", 2000.0, 100.0)
RELEASES = {2015.0: "Gaia DR1", 2015.5: "Gaia DR2", 2016.0: "Gaia DR3"}  # by reference epoch
TYCHO_MAG_SIGMA = 0.1  # not in the files; Tycho-2 has 0.013 to magnitude 9, 0.1 over all (Hog et al. 2000)
MOTION_COLUMNS = ("pmra", "pmra_error", "pmdec", "pmdec_error", "parallax", "parallax_error")
COLOR_COLUMNS = ("phot_bp_mean_mag", "phot_rp_mean_mag", "MAG_BT")
TREE_STEPS, SAME_MAS = 2.0, 1.0  # how far a direction of the tree may be from the star's own
OPTION = re.compile(r"\?(\w+)=([^?]*)$")


@dataclass(frozen=True, slots=True)
class _IndexStars:
    """The stars of index files; arrays of n rows, astrometry in mas, nan where unknown."""

    xyz: FloatArray
    mag: FloatArray
    band: NDArray[np.str_]
    epoch_jyear: FloatArray
    sigma_mas: FloatArray
    source: IntArray  # Gaia source id, 0 where there is none
    astrometry: FloatArray  # (n, 6) in the order of MOTION_COLUMNS
    colors: FloatArray  # (n, 3) BP, RP, BT magnitudes


def open_astrometry_net(argument: str) -> IndexedCatalog:
    """Open index files as a catalog.

    Parameters
    ----------
    argument
        A glob pattern of index files, then optionally ``?epoch=JYEAR`` for positions of another epoch
        than the files say: ``/usr/share/astrometry/index-tycho2-07.*.fits?epoch=2000``.

    Raises
    ------
    CatalogError
        No file matches, or one is not an index file or tells no magnitudes.
    """
    files, stars, ra, dec = _read(argument)
    known = _motion_known(stars)
    speed = np.where(known, np.hypot(stars.astrometry[:, 0], stars.astrometry[:, 2]), 0.0)
    return IndexedCatalog(
        name=f"astrometry-net:{argument}",
        facts={
            "files": [str(file) for file in files],
            "bands": sorted(set(np.unique(stars.band).tolist())),
            "n_with_motion": int(np.count_nonzero(known)),
        },
        ra_rad=ra,
        dec_rad=dec,
        mag=stars.mag,
        build=partial(_table_of_rows, stars, ra, dec),
        motion=MotionBound(
            float(speed.max()) * RAD_PER_MAS, float(stars.epoch_jyear.min()), float(stars.epoch_jyear.max())
        ),
    )


def open_tycho2_index(file: Path) -> StoredCatalog:
    """Open an index file of Tycho-2 from a cache in our own layout, which is there at once and reads what is asked for.

    Raises
    ------
    CatalogError
        As `open_astrometry_net`.
    """

    def build() -> Records:
        _, stars, ra, dec = _read(str(file))
        rows = np.arange(len(ra))
        table = _table_of_rows(stars, ra, dec, rows)
        return star_records(len(ra), number=rows, **{name: getattr(table, name) for name in TABLE_COLUMNS})

    identity = {"rule": RULE, **source_identity([file])}
    stars = cached_stars(cache_path(cache_name("astrometry-net", file)), identity, build)
    return StoredCatalog(
        name=f"astrometry-net:{file}",
        facts={"files": [str(file)], "bands": [TYCHO_BAND], "n_with_motion": stars.n_with_motion},
        store=RecordStore(
            stars.records, stars.keys, [TYCHO_BAND], _names_of_rows, stars.limits, stars.checks
        ),
        motion=MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear),
    )


def _names_of_rows(records: Records) -> list[str]:
    return [f"row:{number}" for number in records["number"].tolist()]


def _read(argument: str) -> tuple[list[Path], _IndexStars, FloatArray, FloatArray]:
    """Return files, their stars, right ascensions and declinations."""
    pattern, epoch = _options(argument)
    names = glob.glob(str(Path(pattern).expanduser()))  # noqa: PTH207 - Path.glob takes no absolute pattern
    files = [Path(name) for name in sorted(names)]
    if not files:
        raise CatalogError(
            f"no file matches {pattern}; give index files, such as those that Debian's package "
            "astrometry-data-tycho2-07 puts into /usr/share/astrometry."
        )
    stars = _distinct([_read_stars(file, epoch) for file in files])
    return files, stars, *radec_from_unit(stars.xyz)


def _options(argument: str) -> tuple[str, float | None]:
    found = OPTION.search(argument)
    if found is None:
        return argument, None
    key, value = found.groups()
    try:
        epoch = float(value)
    except ValueError:
        epoch = np.nan
    if key != "epoch" or not np.isfinite(epoch):
        raise CatalogError(
            f"unknown option {found.group()} in {argument}; write ?epoch=2000.0 (a Julian year)."
        )
    return argument[: found.start()], epoch


def _read_stars(file: Path, epoch: float | None) -> _IndexStars:
    index = read_index(file)
    try:
        stars = _stars_of_columns(file, *index, epoch)
    except fits_malformed() as error:  # columns of another length or kind
        reason = " ".join(str(error).split())
        raise CatalogError(f"{file} contradicts itself ({reason}); copy it again.") from error
    first, last = EPOCHS_JYEAR
    timely = (stars.epoch_jyear >= first) & (stars.epoch_jyear <= last)
    bad = np.isinf(stars.mag) | ~(np.isnan(stars.mag) | (timely & np.isfinite(stars.xyz).all(axis=1)))
    if bad.any():
        row = int(np.argmax(bad))
        raise CatalogError(
            f"{file}: star {row} has magnitude {stars.mag[row]:g} and epoch {stars.epoch_jyear[row]:g}; copy it again."
        )
    return stars


def _stars_of_columns(
    file: Path, xyz: FloatArray, quantum_mas: float, columns: Mapping[str, NDArray[Any]], epoch: float | None
) -> _IndexStars:
    name = _magnitude_column(file, columns)
    if len(columns[name]) != len(xyz):
        raise CatalogError(
            f"{file} has {len(xyz)} stars but {len(columns[name])} magnitudes; copy the file again."
        )
    n, band = len(xyz), MAGNITUDE_COLUMNS.get(name, OTHER_MAGNITUDE)
    epochs = np.asarray(columns.get("ref_epoch", np.full(n, band.epoch_jyear)), dtype=np.float64)
    astrometry = [np.asarray(columns.get(c, np.full(n, np.nan)), dtype=np.float64) for c in MOTION_COLUMNS]
    xyz, quantum_mas = _exact_directions(file, xyz, quantum_mas, columns)
    colors = [np.asarray(columns.get(c, np.full(n, np.nan)), dtype=np.float64) for c in COLOR_COLUMNS]
    return _IndexStars(
        xyz=xyz,
        mag=columns[name].astype(np.float64),
        band=np.full(n, band.name or name),
        epoch_jyear=epochs if epoch is None else np.full(n, epoch),
        # A value rounded to a step errs evenly within half a step: sigma = step / sqrt(12).
        sigma_mas=np.full(n, np.hypot(band.sigma_mas, quantum_mas / np.sqrt(12.0))),
        source=np.asarray(columns.get("source_id", np.zeros(n)), dtype=np.int64),
        astrometry=np.stack(astrometry, axis=-1),
        colors=np.stack(colors, axis=-1),
    )


def _exact_directions(
    file: Path, xyz: FloatArray, quantum_mas: float, columns: Mapping[str, NDArray[Any]]
) -> tuple[FloatArray, float]:
    """Return the directions of the columns ra and dec, where they are there and agree with the tree."""
    if not all(name in columns and columns[name].dtype.kind == "f" for name in ("ra", "dec")):
        return xyz, quantum_mas
    ra, dec = (columns[name].astype(np.float64) * RAD_PER_DEG for name in ("ra", "dec"))
    told = unit_from_radec(ra, dec)
    apart = float(np.max(angle_between(told, xyz), initial=0.0)) / RAD_PER_MAS
    if not apart <= TREE_STEPS * quantum_mas + SAME_MAS:
        raise CatalogError(
            f"{file}: the columns ra and dec differ from the star tree by up to {apart:.3g} mas; copy the file again."
        )
    return told, 0.0


def _magnitude_column(file: Path, columns: Mapping[str, NDArray[Any]]) -> str:
    """Return the first known magnitude column, or else the first that is named like one."""
    for name in (*MAGNITUDE_COLUMNS, *(name for name in columns if "mag" in name.lower())):
        if name in columns:
            return name
    raise CatalogError(
        f"{file} tells no magnitudes (columns beside the stars: {', '.join(columns) or 'none'}); use files "
        "with a TAGALONG table, such as Debian's astrometry-data-tycho2 or series 5200, not 5200-LITE."
    )


def _distinct(parts: list[_IndexStars]) -> _IndexStars:
    """Join files and drop the copies of a star: one catalog entry has the same coordinates to the bit."""
    whole = _IndexStars(*(np.concatenate([getattr(p, f) for p in parts]) for f in _IndexStars.__slots__))
    keep = np.isfinite(whole.mag)
    if len(parts) > 1:
        order = np.lexsort(whole.xyz.T)
        copies = np.all(whole.xyz[order[1:]] == whole.xyz[order[:-1]], axis=1)
        keep[order[1:][copies]] = False
    if not np.any(keep):
        raise CatalogError("the index files hold no star with a magnitude; choose other files.")
    return whole if np.all(keep) else _IndexStars(*(getattr(whole, f)[keep] for f in _IndexStars.__slots__))


def _motion_known(stars: _IndexStars) -> NDArray[np.bool_]:
    motion = stars.astrometry[:, :4]
    return np.asarray(np.all(np.isfinite(motion), axis=1) & np.all(motion[:, 1::2] > 0.0, axis=1))


def _table_of_rows(stars: _IndexStars, ra: FloatArray, dec: FloatArray, rows: IntArray) -> StarTable:
    part = _IndexStars(*(getattr(stars, f)[rows] for f in _IndexStars.__slots__))
    pmra, pmra_sigma, pmdec, pmdec_sigma, parallax, parallax_sigma = part.astrometry.T
    return StarTable(
        id=np.array(_names(part, rows), dtype=np.str_),
        ra_rad=ra[rows],
        dec_rad=dec[rows],
        rv_km_s=np.full(len(rows), np.nan),
        mag=part.mag,
        band=part.band,
        epoch_jyear=part.epoch_jyear,
        **astrometry_columns(
            part.mag,
            np.stack([part.sigma_mas, part.sigma_mas], axis=-1),
            np.stack([pmra, pmdec], axis=-1),
            np.stack([pmra_sigma, pmdec_sigma], axis=-1),
            _motion_known(part),
            parallax,
            np.where(parallax_sigma > 0.0, parallax_sigma, np.nan),
        ),
        **_johnson(part).columns(),
    )


def _johnson(part: _IndexStars) -> Johnson:
    blue, red, bt = part.colors.T
    g, vt = (np.where(part.band == band, part.mag, np.nan) for band in ("G", "VT"))
    of_gaia = johnson_from_gaia(g, blue, red)
    of_tycho = johnson_from_tycho(bt, TYCHO_MAG_SIGMA, vt, TYCHO_MAG_SIGMA)
    return of_gaia.or_else(of_tycho).or_else(johnson_from_bands(part.mag, part.band))


def _names(part: _IndexStars, rows: IntArray) -> list[str]:
    releases = [RELEASES.get(epoch, "Gaia") for epoch in part.epoch_jyear.tolist()]
    named = zip(part.source.tolist(), releases, rows.tolist(), strict=True)
    return [f"{release} {source}" if source > 0 else f"row:{row}" for source, release, row in named]
