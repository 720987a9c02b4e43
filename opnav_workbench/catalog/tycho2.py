"""Tycho-2 as the CDS distributes it (I/259): a folder with tyc2.dat, or tyc2.dat.00 to .19, and suppl_1.dat.

Each file may be plain or .gz, its lines end with LF or CRLF. The text is read once and kept in the cache folder.

Rows of the main catalog
    Position at J2000.0, motion, and their sigmas at the mean epochs of observation, RA and dec apart; the sigmas are
    carried from there to J2000, with the covariance of position and motion (`StarTable.position_motion`).
Rows without a mean position (flag X)
    The position that Tycho observed, at its own epoch near J1991.5, with its sigma; no motion, the flag
    NO_MEAN_POSITION. Where both coordinates have their own epoch the mean of the two is taken: without a motion
    the difference of 0.2 years is worth 3 mas, which goes into the sigma.
suppl_1.dat (17,588 stars of Hipparcos and Tycho-1 that Tycho-2 lacks)
    Position at J1991.25; motion where given; flag SUPPLEMENT. A folder without it lacks mostly the brightest stars.
suppl_2.dat (1,146 stars of Tycho-1) is not used: its authors list it as false or heavily disturbed.

Source: Hog et al. (2000), A&A 355, L27, and the byte tables of CDS I/259.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.cache import (
    CachedStars,
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
from opnav_workbench.catalog.johnson import Johnson, johnson_from_hipparcos, johnson_from_tycho
from opnav_workbench.catalog.proper_motion import UNKNOWN_MOTION_MAS_YR, astrometry_columns
from opnav_workbench.catalog.quality import StarQuality, quality_flags
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError

__all__ = ["PARTS", "RULE", "SUPPLEMENT_FILE", "folder_records", "open_tycho2", "stored_tycho2"]

RULE = 1  # raise it whenever a record of the same row would change
MAIN_CHARACTERS, SUPPLEMENT_CHARACTERS = 206, 122
WHOLE_FILE, SUPPLEMENT_FILE = "tyc2.dat", "suppl_1.dat"
PARTS = [f"{WHOLE_FILE}.{part:02d}" for part in range(20)]
FILES = [WHOLE_FILE, *PARTS, SUPPLEMENT_FILE]
BANDS = ("VT", "BT", "Hp")
REMEDY = (
    "give the folder with tyc2.dat or tyc2.dat.00 to .19 (each may be .gz) and suppl_1.dat of CDS catalog I/259 "
    "(https://cdsarc.cds.unistra.fr/ftp/I/259/)."
)
SUPPLEMENT_JYEAR = 1991.25
NEIGHBOR_ARCSEC = 5.0  # a Tycho star nearer than this shares the picture of the star in a narrow-angle camera
POOR_FIT = (
    5.0  # q: scatter of the positions over what their sigmas promise; 1 is expected, 5 no longer chance
)
RA_DEC_COLUMNS = (((15, 27), (152, 164)), ((28, 40), (165, 177)))  # mean position, observed position
# Blank where Tycho-1 gave none, for half of the supplement: what its faint stars typically have.
SUPPLEMENT_SIGMA_MAS = 50.0


def open_tycho2(argument: str, progress: Progress | None = None) -> StoredCatalog:
    """Open a folder of Tycho-2 files.

    Parameters
    ----------
    argument
        The folder; ``~`` stands for the home folder.
    progress : callable, optional
        Told the fraction done while the cache file is built, which takes about 20 s for the whole catalog.

    Raises
    ------
    CatalogError
        The folder is missing or empty, or a file in it is short, damaged or of another layout.
    """
    folder = Path(argument).expanduser()
    main, supplement = _files(folder)
    identity = {"rule": RULE, **source_identity([*main, *supplement])}
    build = partial(_records, main, supplement, progress)
    stars = cached_stars(cache_path(cache_name("tycho2", folder)), identity, build)
    return stored_tycho2(f"tycho2:{argument}", stars, {"files": [str(file) for file in (*main, *supplement)]})


def folder_records(folder: Path, progress: Progress | None = None) -> Records:
    """Return the records of a folder of Tycho-2 files, in no order.

    Raises
    ------
    CatalogError
        As `open_tycho2`.
    """
    return _records(*_files(folder), progress)


def stored_tycho2(name: str, stars: CachedStars, facts: Mapping[str, Any]) -> StoredCatalog:
    """Return converted stars of Tycho-2 as a catalog of this name; `facts` are told of it besides."""
    return StoredCatalog(
        name=name,
        facts={
            "source": "Tycho-2 (Hog et al. 2000, CDS I/259)",
            **facts,
            "bands": sorted(BANDS),
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, BANDS, _names, stars.limits, stars.checks),
        motion=MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear),
    )


def _files(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files of the main catalog, whole or in parts, and of the supplement (none, or one)."""
    found = {
        file.name.lower().removesuffix(".gz"): file for file in source_files(folder, FILES, "Tycho-2", REMEDY)
    }
    supplement = [found[SUPPLEMENT_FILE]] if SUPPLEMENT_FILE in found else []
    if WHOLE_FILE in found:
        return [found[WHOLE_FILE]], supplement
    missing = [name for name in PARTS if name not in found]
    if missing:
        raise CatalogError(f"the folder {folder} lacks {', '.join(missing)} of Tycho-2; {REMEDY}")
    return [found[name] for name in PARTS], supplement


def _records(main: Sequence[Path], supplement: Sequence[Path], progress: Progress | None) -> Records:
    kinds = [(file, MAIN_CHARACTERS, _main_rows) for file in main]
    kinds += [(file, SUPPLEMENT_CHARACTERS, _supplement_rows) for file in supplement]
    parts: list[Records] = []
    for done, (file, characters, convert) in enumerate(kinds):
        for rows, fraction in read_rows(file, characters, REMEDY):
            try:
                parts.append(convert(rows))
            except ValueError as error:
                raise CatalogError(f"{file} is not in the layout of CDS I/259: {error}; {REMEDY}") from error
            if progress is not None:
                progress((done + fraction) / len(kinds))
    return np.concatenate(parts)


def _main_rows(rows: TextRows) -> Records:
    observed = rows.text(13, 14) == b"X"
    mag, johnson, band, magless = _magnitudes(rows, (110, 116), (117, 122), (123, 129), (130, 135), None)
    mean_epochs = np.stack([rows.numbers(75, 82), rows.numbers(83, 90)], axis=-1)
    observed_epochs = 1990.0 + np.stack([rows.numbers(178, 182), rows.numbers(183, 187)], axis=-1)
    sigma, covariance = _mean_sigmas(rows, mean_epochs)
    own = np.hypot(
        np.stack([rows.numbers(188, 193), rows.numbers(194, 199)], axis=-1),
        UNKNOWN_MOTION_MAS_YR * 0.5 * np.abs(np.diff(observed_epochs, axis=1)),
    )
    known = ~observed & np.all(np.isfinite(sigma), axis=1)
    motion = np.stack([rows.numbers(41, 48), rows.numbers(49, 56)], axis=-1)
    position = [np.where(observed, rows.numbers(*b), rows.numbers(*a)) for a, b in RA_DEC_COLUMNS]
    return star_records(
        len(rows),
        number=_number(rows),
        ra_rad=position[0] * RAD_PER_DEG,
        dec_rad=position[1] * RAD_PER_DEG,
        epoch_jyear=np.where(observed, observed_epochs.mean(axis=1), 2000.0),
        mag=mag,
        **astrometry_columns(
            mag, np.where(observed[:, None], own, sigma[:, :2]), motion, sigma[:, 2:], known
        ),
        position_motion=np.where(known[:, None], covariance, 0.0),
        **johnson.columns(),
        hip=rows.integers(142, 148),
        flags=_main_flags(rows, observed, magless),
        band=band,
    )


def _mean_sigmas(rows: TextRows, epochs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sigmas (n, 4) at J2000 of position and motion, and the covariance (n, 2) of each pair; mas, mas/yr."""
    at_mean = np.stack([rows.numbers(57, 60), rows.numbers(61, 64)], axis=-1)
    motion = np.stack([rows.numbers(65, 69), rows.numbers(70, 74)], axis=-1)
    years = 2000.0 - epochs
    covariance = years * motion**2 * RAD_PER_MAS**2
    return np.concatenate([np.hypot(at_mean, years * motion), motion], axis=1), covariance


def _main_flags(rows: TextRows, observed: BoolArray, magless: BoolArray) -> IntArray:
    photocenter = (rows.text(13, 14) == b"P") | np.isin(rows.text(200, 201), (b"D", b"P"))
    fits = np.stack([rows.numbers(a, a + 3) for a in (94, 98, 102, 106)])
    return quality_flags(
        {
            StarQuality.DOUBLE: photocenter | _near_another(rows, 136, 139) | ~rows.blank(148, 151),
            StarQuality.BAD_ASTROMETRY: np.any(fits > POOR_FIT, axis=0),  # nan, where there is none, is not
            StarQuality.NO_MEAN_POSITION: observed,
            StarQuality.BAD_PHOTOMETRY: magless,
        }
    )


def _supplement_rows(rows: TextRows) -> Records:
    in_hp = rows.text(81, 82) == b"H"
    mag, johnson, band, magless = _magnitudes(rows, (83, 89), (90, 95), (96, 102), (103, 108), in_hp)
    motion = np.stack([rows.numbers(41, 48), rows.numbers(49, 56)], axis=-1)
    sigma = np.stack([rows.numbers(57, 62), rows.numbers(63, 68)], axis=-1)
    motion_sigma = np.stack([rows.numbers(69, 74), rows.numbers(75, 80)], axis=-1)
    known = np.all(np.isfinite(motion) & np.isfinite(motion_sigma), axis=1)
    place = np.where(np.isfinite(sigma), sigma, SUPPLEMENT_SIGMA_MAS)
    double = _near_another(rows, 109, 112) | ~rows.blank(121, 122)
    return star_records(
        len(rows),
        number=_number(rows),
        ra_rad=rows.numbers(15, 27) * RAD_PER_DEG,
        dec_rad=rows.numbers(28, 40) * RAD_PER_DEG,
        epoch_jyear=SUPPLEMENT_JYEAR,
        mag=mag,
        **astrometry_columns(mag, place, motion, motion_sigma, known),
        **johnson.columns(),
        hip=rows.integers(115, 121),
        flags=quality_flags({StarQuality.DOUBLE: double, StarQuality.BAD_PHOTOMETRY: magless})
        | int(StarQuality.SUPPLEMENT),
        band=band,
    )


def _magnitudes(
    rows: TextRows,
    bt_columns: tuple[int, int],
    bt_sigma_columns: tuple[int, int],
    vt_columns: tuple[int, int],
    vt_sigma_columns: tuple[int, int],
    in_hp: BoolArray | None,
) -> tuple[FloatArray, Johnson, IntArray, BoolArray]:
    """Return magnitude, Johnson V and B-V, number of the band, and where there is no magnitude at all (then 20)."""
    bt, bt_sigma = rows.numbers(*bt_columns), rows.numbers(*bt_sigma_columns)
    vt, vt_sigma = rows.numbers(*vt_columns), rows.numbers(*vt_sigma_columns)
    hp = np.full(len(rows), np.nan) if in_hp is None else np.where(in_hp, vt, np.nan)
    vt = np.where(np.isnan(hp), vt, np.nan)
    johnson = johnson_from_tycho(bt, np.nan_to_num(bt_sigma, nan=0.3), vt, np.nan_to_num(vt_sigma, nan=0.3))
    johnson = johnson_from_hipparcos(hp, np.nan_to_num(vt_sigma), np.nan, np.nan).or_else(johnson)
    band = np.where(np.isfinite(hp), 2, np.where(np.isfinite(vt), 0, 1))
    mag = np.where(np.isfinite(hp), hp, np.where(np.isfinite(vt), vt, bt))
    return np.nan_to_num(mag, nan=20.0), johnson, band, np.isnan(mag)


def _near_another(rows: TextRows, first: int, last: int) -> BoolArray:
    return np.asarray(rows.numbers(first, last) < 10.0 * NEIGHBOR_ARCSEC)


def _number(rows: TextRows) -> IntArray:
    """Return TYC1, TYC2 and TYC3 as one number (n,): 1-8-1 is 1000081."""
    return np.asarray((rows.integers(0, 4) * 100_000 + rows.integers(5, 10)) * 10 + rows.integers(11, 12))


def _names(records: Records) -> Sequence[str]:
    return list(_tyc(records["number"].tolist()))


def _tyc(numbers: Sequence[int]) -> Iterator[str]:
    for number in numbers:
        yield f"TYC {number // 1_000_000}-{number // 10 % 100_000}-{number % 10}"
