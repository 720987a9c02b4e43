"""Converted catalogs in the user's cache folder: records in one memory-mapped file each.

A record is what `StarTable` says of a star, in small types, and takes 108 bytes; the columns are in rad and rad/yr.
Records are sorted by their place on the sky; names are made from a number only when a star is asked for.

Layout of a file: the header (`mapped_file`, padded to `HEADER_BYTES`), n sort keys (f8), n records (`STAR_RECORD`).
The header says what the file was made from (`identity`: format, versions, or names, sizes and times of the source
files), the CRC-32 of all that follows it, and what a catalog tells of itself, so that opening reads no star. A file
that fails any check is built anew; one that cannot be written is done without. Of a large file the header and the keys are
checked when it is opened (5 ms for 500,000 stars), and each block of records before the first of its stars is used: damage
that comes later, even with the file's times as they were, ends in one line, and the file is made anew.  It is written under
another name and renamed, so that two processes may build at once.
"""

import contextlib
import math
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.star_store import Candidates, SkyIndex, SkyOfMany, sort_keys
from opnav_workbench.catalog.star_table import StarTable
from opnav_workbench.errors import CatalogError, SessionError
from opnav_workbench.files import atomic_path
from opnav_workbench.mapped_file import header_bytes, mapped_array, read_header
from opnav_workbench.resources import cache_root

__all__ = [
    "CachedStars",
    "Progress",
    "RecordStore",
    "Records",
    "cache_name",
    "cache_path",
    "cached_stars",
    "source_identity",
    "star_records",
]


# ---- Stars as records of fixed size, sorted by their place on the sky.

STAR_RECORD = np.dtype(
    [
        ("number", "<i8"),  # turned into the name by the catalog
        ("ra_rad", "<f8"),
        ("dec_rad", "<f8"),
        ("epoch_jyear", "<f8"),
        ("mag", "<f8"),
        ("pmra_rad_yr", "<f4"),
        ("pmdec_rad_yr", "<f4"),
        ("parallax_rad", "<f4"),
        ("sigma", "<f4", (5,)),
        ("position_motion", "<f4", (2,)),
        ("v_mag", "<f4"),
        ("v_sigma", "<f4"),
        ("b_v", "<f4"),
        ("b_v_sigma", "<f4"),
        ("hip", "<i4"),
        ("flags", "<u2"),
        ("band", "u1"),  # place in the list of bands
        ("motion_known", "?"),
    ]
)
Records = NDArray[np.void]
TABLE_COLUMNS = [name for name in STAR_RECORD.names or () if name not in ("number", "band")]


def star_records(n: int, **columns: Any) -> Records:
    """Return n records with these columns, the others zero.

    Examples
    --------
    >>> star_records(2, ra_rad=[0.1, 0.2])["ra_rad"].tolist()
    [0.1, 0.2]
    """
    records = np.zeros(n, dtype=STAR_RECORD)
    for name, values in columns.items():
        records[name] = values
    return records


class RecordStore:
    """Records in the order of their sort keys, in memory or memory-mapped.

    Parameters
    ----------
    records : (n,) ndarray of `STAR`
        Sorted by `keys`.
    keys : (n,) ndarray
        Their `sort_keys`.
    bands
        What the column ``band`` counts in.
    names
        Turns records (k,) into their names (k,).
    limits
        ``brightest_mag`` and ``faintest_mag``.
    checks
        Of the blocks of a mapped file, before their stars are used.
    """

    __slots__ = ("_bands", "_checks", "_limits", "_names", "_records", "_sky")

    def __init__(
        self,
        records: Records,
        keys: FloatArray,
        bands: Sequence[str],
        names: Callable[[Records], Sequence[str]],
        limits: Mapping[str, float],
        checks: "BlockChecks | None" = None,
    ) -> None:
        self._checks = checks
        self._records, self._names, self._limits = records, names, dict(limits)
        self._bands = np.array(list(bands), dtype=np.str_)
        places = records["ra_rad"], records["dec_rad"]
        self._sky = SkyOfMany(SkyIndex(*places, keys=keys), *places, records["mag"])

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars of the index ranges that the cone meets.

        Raises
        ------
        CatalogError
            Their block of the file has been damaged since it was written.
        """
        found = self._sky.near(ra_rad, dec_rad, radius_rad)
        if self._checks is not None:
            self._checks.look_at(self._records, found.rows)
        return found

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes."""
        return np.asarray(self._records["mag"][found.rows])

    def flags(self, found: Candidates) -> IntArray:
        """Return the flags."""
        return np.asarray(self._records["flags"][found.rows].astype(np.int64))

    def brightest_first(self, found: Candidates) -> Candidates:
        """Return the candidates by magnitude."""
        return self._sky.brightest_first(found)

    def build(self, found: Candidates) -> StarTable:
        """Return the stars of these records."""
        part = self._records[found.rows]
        return StarTable(
            id=np.array(self._names(part), dtype=np.str_),
            band=self._bands[part["band"]],
            rv_km_s=np.full(len(part), np.nan),
            **{name: part[name] for name in TABLE_COLUMNS},
        )

    def columns(self, found: Candidates) -> Mapping[str, Callable[[], FloatArray]]:
        """Return what gives places and magnitudes."""
        return {name: partial(self._column, name, found.rows) for name in ("ra_rad", "dec_rad", "mag")}

    def _column(self, name: str, rows: IntArray) -> FloatArray:
        return np.asarray(self._records[name][rows])

    def summary(self) -> Mapping[str, Any]:
        """Return the number of stars and the limits of their magnitudes."""
        return {"n_stars": len(self._records), **self._limits}


# ---- Converted catalogs in the user's cache folder.

Progress = Callable[[float], None]  # told the fraction done, 0 to 1

MAGIC = b"OPNAVSTR"
LAYOUT = 2  # raise it whenever `STAR_RECORD` or the meaning of one of its columns changes
HEADER_BYTES = 1 << 16
WHOLE_BYTES = 1 << 23  # a smaller file is checked as a whole when it is opened
BLOCK_RECORDS, MOST_BLOCKS = 2048, 2000  # their checksums stand in the header
CHUNK_BYTES = 1 << 23
KEYS_AT_ONCE = CHUNK_BYTES // 8


class BlockChecks:
    """Checksums of the blocks of a mapped file's records, each taken once, before its stars are used.

    Parameters
    ----------
    path
        The file; it is removed where a block is damaged, so that it is made anew.
    crcs
        CRC-32 of each block.
    size
        Records of a block.
    """

    __slots__ = ("_crcs", "_path", "_size", "_sure")

    def __init__(self, path: Path, crcs: Sequence[int], size: int) -> None:
        self._path, self._crcs, self._size = path, crcs, size
        self._sure = np.zeros(len(crcs), bool)

    def look_at(self, records: Records, rows: IntArray) -> None:
        """Check the blocks that hold these rows of the file's records.

        Raises
        ------
        CatalogError
            One is not what was written.
        """
        if self._sure.all():
            return
        blocks = rows // self._size
        for block in np.unique(blocks[~self._sure[blocks]]).tolist():
            if (
                zlib.crc32(records[block * self._size : (block + 1) * self._size].tobytes())
                != self._crcs[block]
            ):
                with contextlib.suppress(OSError):
                    self._path.unlink()
                raise CatalogError(
                    f"{self._path} was damaged on the disk after it was written; it is removed. Run the same command again: "
                    "it is made anew. If this comes again, check the disk."
                )
            self._sure[block] = True


@dataclass(frozen=True, slots=True, eq=False)
class CachedStars:
    """The stars of a cache file, sorted by place, and what the whole catalog is like."""

    records: Records
    keys: FloatArray
    limits: Mapping[str, float]  # brightest_mag, faintest_mag
    fastest_rad_yr: float
    first_jyear: float
    last_jyear: float
    n_with_motion: int
    checks: BlockChecks | None = None  # of a large file


def cache_path(name: str) -> Path:
    """Return where the cache file of this name stands, built or not."""
    return cache_root() / "catalogs" / f"{name}.stars"


def cache_name(kind: str, source: Path) -> str:
    """Return the name of the cache file of a source folder or file: one a path."""
    return f"{kind}-{sha256(str(source.resolve()).encode()).hexdigest()[:16]}"


def source_identity(files: Sequence[Path]) -> dict[str, Any]:
    """Return name, size and time of change of source files: what a cache is valid for."""
    stats = [(file, file.stat()) for file in files]
    return {"files": [[file.name, stat.st_size, stat.st_mtime_ns] for file, stat in stats]}


def cached_stars(path: Path, identity: Mapping[str, Any], build: Callable[[], Records]) -> CachedStars:
    """Return the stars of a cache file, built first where there is none that is whole and of this identity.

    Parameters
    ----------
    path
        The file; see `cache_path`.
    identity
        JSON values that change when the content would.
    build
        Returns the records in any order.
    """
    wanted = {"layout": LAYOUT, **identity}
    found = _open_cache(path, wanted)
    if found is not None:
        return found
    records = build()
    _check_finite(path, records)
    keys = sort_keys(records["ra_rad"], records["dec_rad"])
    order = np.argsort(keys, kind="stable")
    with contextlib.suppress(SessionError):  # an unwritable cache: the next session builds it again
        _write_cache(path, wanted, records, keys, order)
        found = _open_cache(path, wanted)
    return found or CachedStars(records[order], keys[order], **_catalog_facts(records))


def _check_finite(path: Path, records: Records) -> None:
    """Refuse infinities, and places and magnitudes that are no number, before they are kept for every later session."""
    for name in records.dtype.names or ():
        values = records[name]
        if values.dtype.kind != "f":
            continue
        known = np.isfinite(values) if name in ("ra_rad", "dec_rad", "mag") else ~np.isinf(values)
        if not known.all():
            row = int(np.argmin(known.reshape(len(values), -1).all(axis=1)))
            raise CatalogError(
                f"{path.stem}: star {row} of the source has {name} = {values[row]}; copy or fetch the catalog again."
            )


def _open_cache(path: Path, identity: Mapping[str, Any]) -> CachedStars | None:
    """Return the stars of a whole file of this identity, else None."""
    try:
        with path.open("rb") as stream:
            header = read_header(stream.read(HEADER_BYTES), MAGIC)
            if header is None or header["identity"] != identity:
                return None
            n, status = int(header["n"]), os.fstat(stream.fileno())
            if status.st_size != HEADER_BYTES + n * (8 + STAR_RECORD.itemsize):
                return None
            large = status.st_size >= WHOLE_BYTES
            if (
                not large
                and _crc(path, status.st_ino, status.st_mtime_ns, status.st_ctime_ns) != header["crc"]
            ):
                return None
        keys = mapped_array(path, "<f8", HEADER_BYTES, (n,))
        records = mapped_array(path, STAR_RECORD, HEADER_BYTES + 8 * n, (n,))
        if not large:
            return CachedStars(records, keys, **header["facts"])
        if zlib.crc32(keys.tobytes()) != header["keys_crc"]:
            return None
        checks = BlockChecks(path, header["blocks"], int(header["block"]))
        return CachedStars(records, keys, **header["facts"], checks=checks)
    except (OSError, ValueError, KeyError, TypeError):
        return None


@lru_cache(maxsize=64)
def _crc(path: Path, _inode: int, _mtime_ns: int, _ctime_ns: int) -> int:
    """Return the checksum of what follows the header; a file that has not changed since is not read again."""
    crc = 0
    with path.open("rb") as stream:
        stream.seek(HEADER_BYTES)
        while chunk := stream.read(CHUNK_BYTES):
            crc = zlib.crc32(chunk, crc)
    return crc


def _write_cache(
    path: Path, identity: Mapping[str, Any], records: Records, keys: FloatArray, order: np.ndarray[Any, Any]
) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(bytes(HEADER_BYTES))
        crc, n = 0, len(order)
        for first in range(0, n, KEYS_AT_ONCE):
            chunk = keys[order[first : first + KEYS_AT_ONCE]].tobytes()
            crc = zlib.crc32(chunk, crc)
            stream.write(chunk)
        keys_crc, blocks = crc, []
        block = max(BLOCK_RECORDS, -(-n // MOST_BLOCKS))
        for first in range(0, n, block):
            chunk = records[order[first : first + block]].tobytes()
            crc = zlib.crc32(chunk, crc)
            blocks.append(zlib.crc32(chunk))
            stream.write(chunk)
        header = {"identity": identity, "n": n, "crc": crc, "facts": _catalog_facts(records)}
        header |= {"keys_crc": keys_crc, "block": block, "blocks": blocks}
        stream.seek(0)
        stream.write(header_bytes(MAGIC, header, HEADER_BYTES))


def _catalog_facts(records: Records) -> dict[str, Any]:
    speed = math.hypot(*(float(np.abs(records[name]).max()) for name in ("pmra_rad_yr", "pmdec_rad_yr")))
    return {
        "limits": {
            "brightest_mag": float(records["mag"].min()),
            "faintest_mag": float(records["mag"].max()),
        },
        "fastest_rad_yr": min(speed, float(np.hypot(records["pmra_rad_yr"], records["pmdec_rad_yr"]).max())),
        "first_jyear": float(records["epoch_jyear"].min()),
        "last_jyear": float(records["epoch_jyear"].max()),
        "n_with_motion": int(np.count_nonzero(records["motion_known"])),
    }
