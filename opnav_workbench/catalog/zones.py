"""Catalogs of binary zone files, as UCAC2 and UCAC4 are: read where they stand, nothing converted or held in memory.

A zone is a strip of declination, one file of fixed records that ascend in right ascension. That order is the sky
index: a cone reads the records between two right ascensions of the few zones it meets, found by bisection on the
memory-mapped file. The index files of the distributions are not needed for that; where they stand they tell how
many records each zone must have.

Both UCAC catalogs give positions at J2000.0 (moved there by the motion given), but sigmas at central epochs of
observation of their own in RA and dec. With c the years from there to J2000:

    sigma(J2000)^2 = sigma^2 + c^2 sigma_motion^2,    cov(position, motion) = c sigma_motion^2

so that the propagated sigma is smallest at the central epoch, as it is. Stars without a motion were not moved:
their position is that of the central epoch, which then is the epoch of the row (RA and dec apart by months at most:
their mean).
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.catalog.proper_motion import astrometry_columns
from opnav_workbench.catalog.star_store import GUARD_RAD, Candidates, by_magnitude, ra_spans
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.constants import J2000_JYEAR, RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import unit_from_radec
from opnav_workbench.paths import exists, is_folder

__all__ = ["UCAC_BAND", "ZoneLayout", "ZoneStore", "columns_at_j2000", "open_zones"]


# ---- Catalogs of binary zone files, as UCAC2 and UCAC4 are.

ROW_BITS = 24  # row number = zone * 2**24 + record; the largest zone has 0.3 million records
THREE_DIGITS = np.array([f"{value:03d}" for value in range(1000)])
TURN_MAS = 1_296_000_000


@dataclass(frozen=True, slots=True)
class ZoneLayout:
    """What distinguishes one catalog of zone files from another."""

    name: str
    record: np.dtype[np.void]  # with fields `ra` in mas, and the one that `dec_rad` reads
    n_zones: int
    zone_deg: float  # height; the first zone begins at the south pole
    dec_rad: Callable[[NDArray[np.void]], FloatArray]
    mag: Callable[[NDArray[np.void]], FloatArray]
    flags: Callable[[NDArray[np.void]], IntArray]
    build: Callable[[NDArray[np.void], NDArray[np.str_]], StarTable]  # of records and their names
    mag_range: tuple[float, float]
    remedy: str


def open_zones(folder: Path, layout: ZoneLayout) -> dict[int, Path]:
    """Return the zone files of a folder by their number.

    Raises
    ------
    CatalogError
        The folder is missing, empty or holds no zone file.
    """
    if not exists(folder):
        raise CatalogError(f"the folder {folder} does not exist; {layout.remedy}")
    if not is_folder(folder):
        raise CatalogError(f"{folder} is a file, not the folder of {layout.name}; {layout.remedy}")
    entries = {entry.name.lower(): entry for entry in folder.iterdir()}
    zones = {
        zone: entries[f"z{zone:03d}"] for zone in range(1, layout.n_zones + 1) if f"z{zone:03d}" in entries
    }
    if not zones:
        state = "is empty" if not entries else f"holds no zone file z001 to z{layout.n_zones:03d}"
        raise CatalogError(f"the folder {folder} {state}; {layout.remedy}")
    return zones


class ZoneStore:
    """The stars of zone files.

    Parameters
    ----------
    folder
        Where the files stand, for messages.
    files
        Zone number to file.
    layout
        The catalog's own.
    expected : (n_zones,) ndarray of int, optional
        How many records each zone has by the catalog's index file.
    """

    __slots__ = ("_expected", "_files", "_folder", "_layout", "_opened")

    def __init__(
        self, folder: Path, files: Mapping[int, Path], layout: ZoneLayout, expected: IntArray | None = None
    ) -> None:
        self._folder, self._files, self._layout, self._expected = folder, files, layout, expected
        self._opened: dict[int, NDArray[np.void]] = {}

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars between the right ascensions, and in the zones, that the cone meets."""
        reach = radius_rad + GUARD_RAD
        height = self._layout.zone_deg * RAD_PER_DEG
        first, last = (int((dec_rad + side + 0.5 * np.pi) // height) + 1 for side in (-reach, reach))
        spans = ra_spans(ra_rad, dec_rad, reach)
        # As plain bytes: numpy would compare the fields of every part before it joins them.
        plain = f"V{self._layout.record.itemsize}"
        rows, parts = [np.empty(0, np.int64)], [np.empty(0, plain)]
        for zone in range(max(first, 1), min(last, self._layout.n_zones) + 1):
            records = self._zone(zone)
            for start, stop in _record_ranges(records["ra"], spans):
                rows.append(np.arange(start, stop) + (zone << ROW_BITS))
                parts.append(records[start:stop].view(plain))
        found = np.concatenate(parts).view(self._layout.record)
        ra = found["ra"] * RAD_PER_MAS
        return Candidates(np.concatenate(rows), unit_from_radec(ra, self._layout.dec_rad(found)), found)

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes."""
        return self._layout.mag(_records(found))

    def flags(self, found: Candidates) -> IntArray:
        """Return the flags."""
        return self._layout.flags(_records(found))

    def brightest_first(self, found: Candidates) -> Candidates:
        """Return the candidates by magnitude."""
        return by_magnitude(found, self.mag(found))

    def columns(self, found: Candidates) -> Mapping[str, Callable[[], FloatArray]]:
        """Return what gives magnitudes."""
        return {"mag": partial(self.mag, found)}

    def build(self, found: Candidates) -> StarTable:
        """Return the stars of these records."""
        zones, places = found.rows >> ROW_BITS, found.rows & ((1 << ROW_BITS) - 1)
        names = zone_names(self._layout.name, zones, places + 1)
        return self._layout.build(_records(found), names)

    def summary(self) -> Mapping[str, Any]:
        """Return the number of stars, of zones, and the nominal limits of the magnitudes."""
        sizes = [file.stat().st_size for file in self._files.values()]
        brightest, faintest = self._layout.mag_range
        return {
            "n_stars": sum(sizes) // self._layout.record.itemsize,
            "n_zones": len(self._files),
            "brightest_mag": brightest,
            "faintest_mag": faintest,
        }

    def _zone(self, zone: int) -> NDArray[np.void]:
        if zone not in self._opened:
            if zone not in self._files:
                raise CatalogError(
                    f"the zone file z{zone:03d} of {self._layout.name} is not in {self._folder}; {self._layout.remedy}"
                )
            self._opened[zone] = self._checked(zone, self._files[zone])
        return self._opened[zone]

    def _checked(self, zone: int, file: Path) -> NDArray[np.void]:
        """Return the memory-mapped records of a zone file, its size and a few records checked."""
        size, length = file.stat().st_size, self._layout.record.itemsize
        if size == 0 or size % length:
            raise CatalogError(
                f"{file} has {size} bytes, not records of {length}; it is cut short: {self._layout.remedy}"
            )
        if self._expected is not None and self._expected[zone - 1] != size // length:
            raise CatalogError(
                f"{file} has {size // length} of {self._expected[zone - 1]} records by the catalog's index; "
                f"it is cut short: {self._layout.remedy}"
            )
        try:
            records = np.memmap(file, dtype=self._layout.record, mode="r").view(np.ndarray)
        except OSError as error:
            raise CatalogError(f"cannot read {file}: {error.strerror}; {self._layout.remedy}") from error
        sample = records[np.linspace(0, len(records) - 1, min(len(records), 9)).astype(np.int64)]
        low = -90.0 + (zone - 1) * self._layout.zone_deg
        dec_deg = self._layout.dec_rad(sample) / RAD_PER_DEG
        ra = sample["ra"].astype(np.int64)
        inside = (dec_deg > low - 1e-6) & (dec_deg < low + self._layout.zone_deg + 1e-6)
        if not (np.all(inside) and np.all((ra >= 0) & (ra <= TURN_MAS)) and np.all(np.diff(ra) >= 0)):
            raise CatalogError(
                f"{file} does not hold the stars of {self._layout.name} zone {zone}: a record says RA {ra[0]} mas, "
                f"dec {dec_deg[0]:.5f} deg; wrong byte order or another file: {self._layout.remedy}"
            )
        return records


def _record_ranges(ra_mas: NDArray[Any], spans: list[tuple[float, float]]) -> list[tuple[int, int]]:
    """Return the ranges of records of a zone between right ascensions (turns), none twice."""
    ranges: list[tuple[int, int]] = []
    used = 0
    for low, high in sorted(spans):
        start = max(bisect_left(ra_mas, int(np.floor(low * TURN_MAS))), used)
        used = max(bisect_right(ra_mas, int(np.ceil(high * TURN_MAS))), start)
        ranges.append((start, used))
    return ranges


def zone_names(catalog: str, zones: IntArray, numbers: IntArray) -> NDArray[np.str_]:
    """Return the names of stars by zone and number of the record, counted from 1.

    Written for all stars at once: formatting them one by one took a third of a cone search.

    Examples
    --------
    >>> zone_names("UCAC4", np.array([451]), np.array([12]))
    array(['UCAC4-451-000012'], dtype='<U16')
    """
    parts = {"head": f"{catalog}-", "zone": THREE_DIGITS[zones], "dash": "-"}
    parts |= {"thousands": THREE_DIGITS[numbers // 1000], "rest": THREE_DIGITS[numbers % 1000]}
    widths = (len(catalog) + 1, 3, 1, 3, 3)
    names = np.empty(
        len(zones), dtype=[(name, f"U{width}") for name, width in zip(parts, widths, strict=True)]
    )
    for name, letters in parts.items():
        names[name] = letters
    return names.view(f"U{sum(widths)}")


def _records(found: Candidates) -> NDArray[np.void]:
    assert found.records is not None  # candidates of this store have their records
    return found.records


# ---- What UCAC2 and UCAC4 rows have in common.

UCAC_BAND = "UCAC"  # 579-642 nm, between V and R


def columns_at_j2000(
    motion: FloatArray,
    motion_sigma: FloatArray,
    place_sigma: FloatArray,
    central_jyear: FloatArray,
    known: BoolArray,
    mag: FloatArray,
) -> dict[str, Any]:
    """Return the columns of motion, sigma and epoch of a `StarTable`: J2000, or the central epoch without a motion.

    Parameters
    ----------
    motion, motion_sigma : (n, 2) array
        RA cos(dec) and dec, mas/yr.
    place_sigma, central_jyear : (n, 2) array
        Sigma in mas at the central epochs, RA cos(dec) and dec.
    known : (n,) array of bool
        Whether the star has a motion.
    mag : (n,) array
        For the parallax, which neither catalog gives.
    """
    years = np.where(known[:, None], J2000_JYEAR - central_jyear, 0.0)
    aged = np.where(known[:, None], years * motion_sigma, 0.0)
    spread = np.where(known[:, None], motion_sigma, 0.0)
    return {
        **astrometry_columns(mag, np.sqrt(place_sigma**2 + aged**2), motion, motion_sigma, known),
        "rv_km_s": np.full(len(mag), np.nan),
        "epoch_jyear": np.where(known, J2000_JYEAR, central_jyear.mean(axis=1)),
        "position_motion": years * spread**2 * RAD_PER_MAS**2,
    }
