"""UCAC2: zone files z001 to z288 of 44-byte records, dec -90 to about +50.

The folder may hold the zone files, or ``u2`` with them in it. Layout: the catalog's ``readme.txt``, section 5a (CDS I/289);
signed bytes hold a sigma less 127, the motion in RA lacks the factor cos(dec), in units of 0.1 mas/yr. Every star has a
motion. Source: Zacharias et al. (2004), AJ 127, 3043, doi:10.1086/386353.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.johnson import johnson_from_ucac
from opnav_workbench.catalog.quality import StarQuality, quality_flags
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.catalog.zones import (
    UCAC_BAND,
    ZoneLayout,
    ZoneStore,
    columns_at_j2000,
    open_zones,
)
from opnav_workbench.constants import FASTEST_STAR_RAD_YR, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.paths import is_file, is_folder

__all__ = ["UCAC2_RECORD", "open_ucac2"]

UCAC2_RECORD = np.dtype(
    [
        ("ra", "<i4"), ("dec", "<i4"), ("mag", "<i2"), ("e_place", "i1", (2,)), ("nobs", "i1"), ("e_pos", "i1"),
        ("ncat", "i1"), ("cflg", "i1"), ("epoch", "<i2", (2,)), ("pm", "<i4", (2,)), ("e_pm", "i1", (2,)),
        ("q_pm", "i1", (2,)), ("id_2mass", "<i4"), ("jhk", "<i2", (3,)), ("ph_qual", "i1"), ("cc_flg", "i1"),
    ]
)  # fmt: skip
POOR_FIT = 5.0  # reduced chi of the motion; 1 is expected
MAG_SIGMA = 0.1  # section 3d: 0.1 mag, more for bright and faint stars
NO_MAG = 20_000  # mmag; 30000 stands for none
INDEX_BINS = 240  # of 0.1 h
REMEDY = (
    "give the folder of the zone files z001 to z288 of UCAC2, copied in binary mode from its CDs (directory u2) or from "
    "CDS catalog I/289 (https://cdsarc.cds.unistra.fr/ftp/I/289/)."
)


def open_ucac2(argument: str) -> StoredCatalog:
    """Open a folder of UCAC2 zone files.

    Parameters
    ----------
    argument
        The folder of the files z001 to z288, or the one that holds ``u2``; ``~`` stands for the home folder. Zones may
        be missing as long as none of them is asked for. North of the last zone (dec +54) there are no stars.

    Raises
    ------
    CatalogError
        The folder is missing, empty or holds no zone file.
    """
    given = Path(argument).expanduser()
    folder = given / "u2" if is_folder(given / "u2") else given
    files = open_zones(folder, LAYOUT)
    places = (folder, given / "info", given.parent / "info")
    index = next((p / "u2index.da" for p in places if is_file(p / "u2index.da")), None)
    return StoredCatalog(
        name=f"ucac2:{argument}",
        facts={
            "source": "UCAC2 (Zacharias et al. 2004, CDS I/289), dec -90 to about +50 deg",
            "folder": str(folder),
            "bands": [UCAC_BAND],
        },
        store=ZoneStore(folder, files, LAYOUT, None if index is None else _zone_counts(index)),
        motion=MotionBound(FASTEST_STAR_RAD_YR, 2000.0, 2000.0),
    )


def _zone_counts(path: Path) -> IntArray:
    """Return how many records each zone has: the index tells the running number of the last star of each bin."""
    content = np.fromfile(path, dtype="<i4")
    if content.size != LAYOUT.n_zones * INDEX_BINS:
        raise CatalogError(
            f"{path} has {content.nbytes} bytes, not {4 * LAYOUT.n_zones * INDEX_BINS}; {REMEDY}"
        )
    last = content.reshape(LAYOUT.n_zones, INDEX_BINS)[:, -1].astype(np.int64)
    return np.diff(last, prepend=0)


def _flags(records: NDArray[np.void]) -> IntArray:
    quality = (records["q_pm"].astype(np.int64) + 127) * 0.05
    return quality_flags({StarQuality.BAD_ASTROMETRY: np.any(quality > POOR_FIT, axis=1)})


def _dec(records: NDArray[np.void]) -> FloatArray:
    return np.asarray(records["dec"] * RAD_PER_MAS)


def _mag(records: NDArray[np.void]) -> FloatArray:
    return np.asarray(records["mag"] * 0.01)


def _table(records: NDArray[np.void], names: NDArray[np.str_]) -> StarTable:
    dec, mag = _dec(records), _mag(records)
    motion = records["pm"] * 0.1
    motion[:, 0] *= np.cos(dec)
    sigmas = (records["e_pm"].astype(np.float64) + 127.0) * 0.1, records["e_place"].astype(np.float64) + 127.0
    central = 1975.0 + 0.001 * records["epoch"]
    j, k = (np.where(records["jhk"][:, i] < NO_MAG, records["jhk"][:, i] * 1e-3, np.nan) for i in (0, 2))
    return StarTable(
        id=names,
        ra_rad=records["ra"] * RAD_PER_MAS,
        dec_rad=dec,
        mag=mag,
        band=np.full(len(records), UCAC_BAND),
        flags=_flags(records),
        **columns_at_j2000(motion, *sigmas, central, np.ones(len(records), dtype=bool), mag),
        **johnson_from_ucac(mag, MAG_SIGMA, j, k).columns(),
    )


LAYOUT = ZoneLayout(
    name="UCAC2",
    record=UCAC2_RECORD,
    n_zones=288,
    zone_deg=0.5,
    dec_rad=_dec,
    mag=_mag,
    flags=_flags,
    build=_table,
    mag_range=(7.5, 16.5),
    remedy=REMEDY,
)
