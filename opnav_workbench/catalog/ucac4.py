"""UCAC4: zone files z001 to z900 of 78-byte records, with u4hpm.dat for the 25 to 32 fastest stars.

The folder may be the one with ``u4b`` and ``u4i`` in it, or ``u4b`` itself. Layout and meaning of the fields: Zacharias
et al. (2013), AJ 145, 44, and the catalog's ``readme_u4.txt``; signed bytes hold a sigma less 128. A motion of 32767 (0.1
mas/yr) stands in u4hpm.dat instead, found by the star's unique number; without that file it counts as unknown.

Magnitude: the aperture magnitude of UCAC; where there is none its model magnitude, then APASS V, then 2MASS J. Johnson V
and B-V come from APASS (a sigma of 0 marks Tycho VT and BT in its place), else from the UCAC magnitude and J-K.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.johnson import (
    Johnson,
    johnson_from_2mass_color,
    johnson_from_standard,
    johnson_from_tycho,
    johnson_from_ucac,
)
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

__all__ = ["UCAC4_RECORD", "open_ucac4"]

UCAC4_RECORD = np.dtype(
    [
        ("ra", "<i4"), ("spd", "<i4"), ("magm", "<i2"), ("maga", "<i2"), ("sigmag", "u1"), ("objt", "u1"), ("cdf", "u1"),
        ("sigra", "i1"), ("sigdc", "i1"), ("na1", "u1"), ("nu1", "u1"), ("cu1", "u1"), ("cep", "<u2", (2,)),
        ("pm", "<i2", (2,)), ("sigpm", "i1", (2,)), ("pts_key", "<u4"), ("jhk", "<i2", (3,)), ("icqflg", "u1", (3,)),
        ("e2mpho", "u1", (3,)), ("apasm", "<i2", (5,)), ("apase", "i1", (5,)), ("gcflg", "u1"), ("icf", "<u4"),
        ("leda", "u1"), ("x2m", "u1"), ("rnm", "<u4"), ("zn2", "<u2"), ("rn2", "<u4"),
    ]
)  # fmt: skip
SOUTH_POLE_RAD = -0.5 * np.pi
NO_MAG = 20_000  # mmag
ELSEWHERE = 32_767  # the motion stands in u4hpm.dat
NO_MOTION = 255  # sigma of the motion, after + 128
LARGE_SIGMAS = {251: 27.5, 252: 32.5, 253: 37.5, 254: 45.0}  # mas/yr
SINGLE_APASS_MAG = 0.05  # added to the formal error of a single APASS observation, which is stored negative
HPM_SIGMA_MAS_YR = 10.0  # u4hpm.dat gives none; between its sources (Hipparcos, LSPM) motions differ by that
NO_SIGMA, UNKNOWN_MAG_SIGMA = 99, 0.3
TYCHO_MAG_SIGMA = 0.05  # UCAC4 does not repeat it; Tycho-2 has 0.013 to magnitude 9 and 0.06 at 11
INDEX_BINS = 1440
REMEDY = (
    "give the folder with u4b (zone files z001 to z900) and u4i of UCAC4, copied in binary mode from CDS catalog I/322A "
    "(https://cdsarc.cds.unistra.fr/ftp/I/322A/UCAC4/)."
)


def open_ucac4(argument: str) -> StoredCatalog:
    """Open a folder of UCAC4 zone files.

    Parameters
    ----------
    argument
        The folder that holds ``u4b`` (and ``u4i``), or ``u4b`` itself; ``~`` stands for the home folder. Zones may be
        missing as long as none of them is asked for.

    Raises
    ------
    CatalogError
        The folder is missing, empty or holds no zone file.
    """
    given = Path(argument).expanduser()
    folder = given / "u4b" if is_folder(given / "u4b") else given
    fast, index = (_index_file(given, name) for name in ("u4hpm.dat", "u4index.unf"))
    layout = _layout(_fast_motions(fast) if fast else {})
    files = open_zones(folder, layout)
    return StoredCatalog(
        name=f"ucac4:{argument}",
        facts={
            "source": "UCAC4 (Zacharias et al. 2013, CDS I/322A)",
            "folder": str(folder),
            "bands": [UCAC_BAND],
            "high_motion_file": None if fast is None else str(fast),
        },
        store=ZoneStore(folder, files, layout, _zone_counts(index) if index else None),
        motion=MotionBound(FASTEST_STAR_RAD_YR, 1998.0, 2004.0),
    )


def _layout(fast: dict[int, tuple[float, float]]) -> ZoneLayout:
    numbers = np.array(sorted(fast), dtype=np.int64)
    motions = np.array([fast[number] for number in numbers.tolist()]).reshape(-1, 2)
    return ZoneLayout(
        name="UCAC4",
        record=UCAC4_RECORD,
        n_zones=900,
        zone_deg=0.2,
        dec_rad=lambda records: records["spd"] * RAD_PER_MAS + SOUTH_POLE_RAD,
        mag=_mag,
        flags=_flags,
        build=lambda records, names: _table(records, names, numbers, motions),
        mag_range=(-1.5, 16.5),
        remedy=REMEDY,
    )


def _index_file(given: Path, name: str) -> Path | None:
    """Return a file of ``u4i``, wherever that stands beside the zone files."""
    places = (given / "u4i", given.parent / "u4i", given)
    return next((place / name for place in places if is_file(place / name)), None)


def _fast_motions(path: Path) -> dict[int, tuple[float, float]]:
    """Return the motions of u4hpm.dat, 0.1 mas/yr, by unique number: rnm zone record pmra pmdec RA SPD mag."""
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines() if line.strip()]
        return {int(row[0]): (float(row[3]), float(row[4])) for row in rows}
    except (OSError, UnicodeDecodeError, ValueError, IndexError) as error:
        raise CatalogError(f"{path} is not the file of high motions of UCAC4 ({error}); {REMEDY}") from error


def _zone_counts(path: Path) -> IntArray:
    """Return how many records each zone has: n0(zone, bin), then nn(zone, bin), the zone running fastest."""
    content = np.fromfile(path, dtype="<i4")
    if content.size != 2 * 900 * INDEX_BINS:
        raise CatalogError(f"{path} has {content.nbytes} bytes, not {8 * 900 * INDEX_BINS}; {REMEDY}")
    counts = content[900 * INDEX_BINS :].reshape(INDEX_BINS, 900).sum(axis=0, dtype=np.int64)
    return np.asarray(counts)


def _mmag(column: NDArray[np.int16]) -> FloatArray:
    """Return magnitudes of mmag, nan where there is none: looked up, three times as fast as comparing."""
    return np.asarray(MAGNITUDES[column])  # a negative code counts from the end


def _choose_mag(records: NDArray[np.void]) -> tuple[FloatArray, IntArray]:
    """Return the magnitude (n,), 20 where there is none, and which of the choices it is (place in MAG_BANDS)."""
    columns = (records["maga"], records["magm"], records["apasm"][:, 1], records["jhk"][:, 0])
    mag, which = _mmag(columns[0]), np.zeros(len(records), dtype=np.int64)
    for choice, column in enumerate(columns[1:], start=1):
        missing = np.isnan(mag)
        if not missing.any():
            return mag, which
        mag, which = np.where(missing, _mmag(column), mag), np.where(missing, choice, which)
    return np.where(np.isnan(mag), 20.0, mag), which


def _mag(records: NDArray[np.void]) -> FloatArray:
    return _choose_mag(records)[0]


def _flags(records: NDArray[np.void]) -> IntArray:
    unused = (records["nu1"] == 0) & (records["na1"] > 0)  # every picture of the star has some problem
    extended = (records["leda"] > 0) | (records["x2m"] > 0)
    flags = KIND_FLAGS[records["objt"]] | DOUBLE_FLAGS[records["cdf"]]
    flags[unused] |= int(StarQuality.BAD_ASTROMETRY)
    flags[extended] |= int(StarQuality.EXTENDED)
    flags[records["maga"] >= NO_MAG] |= int(StarQuality.BAD_PHOTOMETRY)
    return np.asarray(flags)


def _table(
    records: NDArray[np.void], names: NDArray[np.str_], fast: IntArray, fast_motions: FloatArray
) -> StarTable:
    motion, motion_sigma, known = _motions(records, fast, fast_motions)
    place = np.empty((len(records), 2))
    place[:, 0], place[:, 1] = records["sigra"], records["sigdc"]
    mag, which = _choose_mag(records)
    return StarTable(
        id=names,
        ra_rad=records["ra"] * RAD_PER_MAS,
        dec_rad=records["spd"] * RAD_PER_MAS + SOUTH_POLE_RAD,
        mag=mag,
        band=MAG_BANDS[which],
        flags=_flags(records),
        **columns_at_j2000(motion, motion_sigma, place + 128.0, 1900.0 + 0.01 * records["cep"], known, mag),
        **_johnson(records, mag, which).columns(),
    )


def _motions(
    records: NDArray[np.void], fast: IntArray, fast_motions: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return motions and their sigmas (n, 2), mas/yr, and whether the star has one (n,)."""
    code = records["sigpm"].astype(np.int64) + 128
    motion, sigma = np.asarray(records["pm"] * 0.1), MOTION_SIGMAS[code]
    known = (code[:, 0] != NO_MOTION) & (code[:, 1] != NO_MOTION)
    elsewhere = (records["pm"][:, 0] == ELSEWHERE) | (records["pm"][:, 1] == ELSEWHERE)
    if elsewhere.any():
        listed = elsewhere & np.isin(records["rnm"], fast)
        motion[listed] = 0.1 * fast_motions[np.searchsorted(fast, records["rnm"][listed])]
        sigma[listed & ~known] = HPM_SIGMA_MAS_YR
        known = np.where(elsewhere, listed, known)
    return motion, sigma, known


def _johnson(records: NDArray[np.void], mag: FloatArray, which: IntArray) -> Johnson:
    b, v = (_mmag(records["apasm"][:, column]) for column in (0, 1))
    error = records["apase"][:, :2]
    sigma = np.abs(error * 0.01) + (error < 0) * SINGLE_APASS_MAG
    tycho_b, tycho_v = ((error == 0) & (records["apasm"][:, :2] < NO_MAG)).T
    johnson = johnson_from_standard(
        np.where(tycho_b, np.nan, b), sigma[:, 0], np.where(tycho_v, np.nan, v), sigma[:, 1]
    )
    rows = np.flatnonzero(tycho_b | tycho_v)
    if rows.size:
        bt, vt = np.where(tycho_b, b, np.nan)[rows], np.where(tycho_v, v, np.nan)[rows]
        johnson = johnson.or_at(rows, johnson_from_tycho(bt, TYCHO_MAG_SIGMA, vt, TYCHO_MAG_SIGMA))
    if np.isnan(johnson.b_v).any():
        j, k = (_mmag(records["jhk"][:, column]) for column in (0, 2))
        ucac = np.where(which <= 1, mag, np.nan)
        sigma = np.where(records["sigmag"] < NO_SIGMA, records["sigmag"] * 0.01, UNKNOWN_MAG_SIGMA)
        johnson = johnson.or_else(johnson_from_ucac(ucac, sigma, j, k))
        if (which > 1).any():
            johnson = johnson.or_else(johnson_from_2mass_color(j, k))
    return johnson


def _magnitudes() -> FloatArray:
    codes = np.arange(2**16, dtype=np.uint16).view(np.int16)
    return np.where((codes < NO_MAG) & (codes != 0), codes * 1e-3, np.nan)


def _motion_sigmas() -> FloatArray:
    sigmas = np.arange(256) * np.float64(0.1)
    sigmas[list(LARGE_SIGMAS)] = list(LARGE_SIGMAS.values())
    return sigmas


MAGNITUDES = _magnitudes()  # by the 16 bits in the file
MOTION_SIGMAS = _motion_sigmas()  # by the code in the file
MAG_BANDS = np.array([UCAC_BAND, UCAC_BAND, "V", "J"])
KIND, DOUBLE = np.arange(256), np.arange(256)
KIND_FLAGS = quality_flags(
    {
        StarQuality.BAD_ASTROMETRY: np.isin(KIND, (2, 5, 8, 9)),
        StarQuality.HIGH_PROPER_MOTION: np.isin(KIND, (3, 4, 8, 9)),
        StarQuality.SUPPLEMENT: np.isin(KIND, (6, 7)),
        StarQuality.BAD_PHOTOMETRY: KIND == 1,
    }
)
DOUBLE_FLAGS = quality_flags({StarQuality.DOUBLE: (DOUBLE >= 10) | (DOUBLE % 10 >= 2)})
