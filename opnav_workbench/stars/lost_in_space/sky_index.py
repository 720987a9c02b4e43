"""The index of star patterns: every star, as the faintest of four, with its nearest brighter stars.

A picture that is complete to some magnitude holds, for each of its stars, the brighter ones around it: so bright stars
make the large patterns that wide fields need, and faint ones small patterns for narrow fields, without a choice of scales.
Stars stand in order of brightness, and their patterns in bands of it (`BANDS`), each in a file of its own that is made
when a field first needs it: a field of 10 deg never asks for stars of magnitude 11.

In a band, patterns are sorted by the cell of their code and angle (`patterns`): `Band.patterns_near` looks into the cells
that a code may be in. Files are kept in the user's cache (`index_file`), for the digest of the stars that they were
made from.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.resources import cache_root
from opnav_workbench.stars.lost_in_space.index_file import read_arrays, write_arrays
from opnav_workbench.stars.lost_in_space.patterns import ORDERS, code_of, named_orders, triples

__all__ = ["BANDS", "Band", "SkyIndex", "index_of_stars", "patterns_folder"]

FORMAT = 1  # raise it whenever the same stars would make another index


@dataclass(frozen=True, slots=True)
class BandRule:
    """Which stars, counted from the brightest, are the faintest of a band's patterns, and of how many neighbors."""

    first: int
    last: int
    neighbors: int  # patterns of a star: three of so many


# Bright stars are few, so that more patterns of each cost little and a wide field misses none.
BANDS = (
    BandRule(0, 1 << 14, 12),
    BandRule(1 << 14, 1 << 16, 9),
    BandRule(1 << 16, 1 << 18, 8),
    BandRule(1 << 18, 1 << 20, 6),
    BandRule(1 << 20, 1 << 22, 6),
)
MAX_ANGLE_RAD = np.radians(30.0)  # of a pattern: wider than any field that is flat enough
TOO_CLOSE = 0.03  # of the farthest neighbor's distance: the two of a double star are one in the picture
SPARE_NEIGHBORS = 10  # asked for beyond those wanted, for those that are fainter or too close
LEAF_STARS = 64  # of a tree: built in two thirds of the time that scipy's 16 take, and asked no slower
GROWTH = 1.25  # of the list of stars among which neighbors are looked for
CHUNK = 8192  # stars whose patterns are made at once

CODE_CELL, ANGLE_CELL = 0.03, 0.15  # of code numbers, and of the angle's logarithm
CODE_SPAN = int(np.ceil(2.2 / CODE_CELL))  # y runs from -0.87 to 0.87
CELLS_PER_PATTERN = 1.0
MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: spreads neighboring cells over the table


# ---- Patterns of a band: made, sorted into cells, looked up.


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Patterns whose faintest stars are those of one `BandRule`."""

    neighbors: NDArray[np.uint32]  # (n, k) rows of stars
    patterns: NDArray[np.uint64]  # (m,) packed: number of the star in its band, which neighbors, which order
    starts: NDArray[np.uint32]  # (cells + 1,) where the patterns of a cell begin
    first: int

    def patterns_near(
        self, codes: FloatArray, angle_rad: FloatArray, code_reach: FloatArray, angle_reach: float
    ) -> tuple[IntArray, IntArray]:
        """Return rows (c,) of the codes (q, 4) and the stars (c, 4) A, B, C, D of patterns in the cells they may be in."""
        cells, rows = _cells_around(codes, angle_rad, code_reach, angle_reach, len(self.starts) - 1)
        begin = self.starts[cells].astype(np.int64)
        count = self.starts[cells + 1].astype(np.int64) - begin
        rows = np.repeat(rows, count)
        place = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        return rows, self.stars_of(self.patterns[place])

    def stars_of(self, packed: NDArray[np.uint64]) -> IntArray:
        """Return the stars (c, 4) of packed patterns."""
        number, which, order = _unpacked(packed)
        return np.take_along_axis(_members(self.neighbors, self.first, number, which), ORDERS[order], axis=1)


def _members(neighbors: NDArray[np.uint32], first: int, number: IntArray, which: IntArray) -> IntArray:
    """Return the stars (c, 4) of patterns: those of these numbers in their band, and three neighbors of each."""
    slots = triples(neighbors.shape[1])
    return np.column_stack([number + first, neighbors[number[:, None], slots[which]]]).astype(np.int64)


def _packed(number: IntArray, which: IntArray, order: IntArray) -> NDArray[np.uint64]:
    return ((number << 16) | (which << 8) | order).astype(np.uint64)


def _unpacked(packed: NDArray[np.uint64]) -> tuple[IntArray, IntArray, IntArray]:
    plain = packed.astype(np.int64)
    return plain >> 16, (plain >> 8) & 0xFF, plain & 0xFF


def make_band(vectors: NDArray[np.float32], rule: BandRule) -> dict[str, NDArray[Any]]:
    """Make the arrays of a band from the unit vectors (n, 3) of all stars, brightest first."""
    last = min(rule.last, len(vectors))
    neighbors = _brighter_neighbors(vectors, rule.first, last, rule.neighbors)
    made = list(_patterns(vectors, neighbors, rule.first))
    packed = np.concatenate([part for part, _ in made])
    hashes = np.concatenate([part for _, part in made])
    bits = max(int(np.ceil(np.log2(max(len(packed) * CELLS_PER_PATTERN, 1.0)))), 1)
    cells = (hashes >> np.uint64(64 - bits)).astype(np.int64)
    order = np.argsort(cells, kind="stable")
    starts = np.zeros((1 << bits) + 1, np.uint32)
    starts[1:] = np.cumsum(np.bincount(cells, minlength=1 << bits))
    return {"neighbors": neighbors, "patterns": packed[order], "starts": starts}


def _brighter_neighbors(
    vectors: NDArray[np.float32], first: int, last: int, wanted: int
) -> NDArray[np.uint32]:
    """Return for stars first..last the nearest brighter ones (n, wanted); the star itself where there are too few."""
    found = np.tile(np.arange(first, max(last, first), dtype=np.uint32)[:, None], (1, wanted))
    begin = max(first, wanted)
    while begin < last:
        end = min(max(int(begin * GROWTH), begin + 1), last)
        tree = cKDTree(vectors[:end], balanced_tree=False, compact_nodes=False)
        apart, near = tree.query(vectors[begin:end], k=min(wanted + SPARE_NEIGHBORS, end))
        near = np.asarray(near, np.int64)
        good = near < np.arange(begin, end)[:, None]
        rank = np.cumsum(good, axis=1)
        reach = np.where(good & (rank <= wanted), apart, 0.0).max(axis=1, keepdims=True)
        good &= apart > TOO_CLOSE * reach
        rank = np.cumsum(good, axis=1)
        rows, places = np.nonzero(good & (rank <= wanted))
        found[begin - first + rows, rank[rows, places] - 1] = near[rows, places]
        begin = end
    return found


def _patterns(
    vectors: NDArray[np.float32], neighbors: NDArray[np.uint32], first: int
) -> Iterator[tuple[NDArray[np.uint64], NDArray[np.uint64]]]:
    """Yield packed patterns and the hashes of their cells."""
    sets = np.arange(len(triples(neighbors.shape[1])))
    for begin in range(0, len(neighbors), CHUNK):
        number = np.arange(begin, min(begin + CHUNK, len(neighbors)))
        number, which = (part.ravel() for part in np.meshgrid(number, sets, indexing="ij"))
        members = _members(neighbors, first, number, which)
        whole = (members[:, 1:] != members[:, :1]).all(axis=1)
        number, which, members = number[whole], which[whole], members[whole]
        if len(number) == 0:
            yield np.empty(0, np.uint64), np.empty(0, np.uint64)
            continue
        quads = vectors[members].astype(np.float64)
        rows, order = named_orders(quads)
        quads = np.take_along_axis(quads[rows], ORDERS[order][:, :, None], axis=1)
        codes, angle = code_of(quads)
        kept = angle < MAX_ANGLE_RAD
        packed = _packed(number[rows], which[rows], order)[kept]
        yield packed, _hashes(_bins(codes[kept]), _angle_bins(angle[kept]))


# ---- Cells of codes and angles.


def _bins(codes: FloatArray) -> IntArray:
    return np.clip(np.floor((codes + 1.1) / CODE_CELL), 0, CODE_SPAN).astype(np.int64)


def _angle_bins(angle_rad: FloatArray) -> IntArray:
    return np.asarray(np.floor(np.log(angle_rad) / ANGLE_CELL) + 200, np.int64)


def _hashes(bins: IntArray, angle_bins: IntArray) -> NDArray[np.uint64]:
    key = angle_bins
    for axis in range(bins.shape[1]):
        key = key * (CODE_SPAN + 1) + bins[:, axis]
    return np.asarray(key.astype(np.uint64) * MIX)


def _cells_around(
    codes: FloatArray, angle_rad: FloatArray, code_reach: FloatArray, angle_reach: float, n_cells: int
) -> tuple[IntArray, IntArray]:
    """Return the cells that codes may be in, and the rows (c,) of these codes."""
    low, high = _bins(codes - code_reach[:, None]), _bins(codes + code_reach[:, None])
    # A reach never spans more than two cells: what is wider is searched two cells wide.
    high = np.minimum(high, low + 1)
    angle_low = _angle_bins(angle_rad * np.exp(-angle_reach))
    angle_high = np.minimum(_angle_bins(angle_rad * np.exp(angle_reach)), angle_low + 1)
    bits = np.uint64(64 - int(np.log2(n_cells)))
    cells, rows = [], []
    for steps in product((0, 1), repeat=5):
        step = np.array(steps[:4])
        wanted = ((step == 0) | (high > low)).all(axis=1) & ((steps[4] == 0) | (angle_high > angle_low))
        row = np.flatnonzero(wanted)
        cells.append((_hashes(low[row] + step, angle_low[row] + steps[4]) >> bits).astype(np.int64))
        rows.append(row)
    return np.concatenate(cells), np.concatenate(rows)


# ---- The whole index: stars in order of brightness, bands made when first asked for.

MIN_TREE = 1 << 12
COVER_STARS, COVER_SAMPLE, COVER_NEIGHBORS = (
    1 << 16,
    300,
    20,
)  # of which the density is taken, where stars are


class SkyIndex:
    """Stars, brightest first, and the patterns that they make.

    Parameters
    ----------
    vectors : (n, 3) ndarray
        Unit vectors, J2000, brightest star first.
    mag : (n,) ndarray
    folder
        Where bands are kept.
    progress : callable, optional
        Told what is made, as this takes seconds.
    """

    def __init__(
        self,
        vectors: NDArray[np.float32],
        mag: NDArray[np.float32],
        folder: Path,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        self.vectors, self.mag = vectors, mag
        self._folder, self._progress = folder, progress
        self._bands: dict[int, Band] = {}
        self._trees: dict[int, cKDTree] = {}

    def __len__(self) -> int:
        return len(self.mag)

    @cached_property
    def digest(self) -> str:
        """What the files of the index are valid for."""
        summed = sha256(f"{FORMAT} {BANDS} {CODE_CELL} {ANGLE_CELL}".encode())
        summed.update(np.ascontiguousarray(self.vectors).tobytes())
        summed.update(np.ascontiguousarray(self.mag).tobytes())
        return summed.hexdigest()

    @cached_property
    def coverage(self) -> float:
        """Part of the sky that the stars cover: 1, or less for a catalog of a region."""
        tree = self.brightest_tree(COVER_STARS)
        sample = self.vectors[: tree.n : max(tree.n // COVER_SAMPLE, 1)]
        count = min(COVER_NEIGHBORS, tree.n)
        reach = np.asarray(tree.query(sample, k=[count])[0])
        around = np.pi * float(np.median(reach)) ** 2 / count  # solid angle of a star, rad^2
        return float(np.clip(tree.n * around / (4.0 * np.pi), 1e-9, 1.0))

    def band(self, number: int) -> Band:
        """Return a band, read or made at its first use."""
        if number not in self._bands:
            path = self._folder / f"{self.digest[:16]}-band{number}.opnavindex"
            identity = {"digest": self.digest, "band": number}
            arrays = read_arrays(path, identity)
            if arrays is None:
                if self._progress is not None:
                    self._progress(f"making the index of star patterns, band {number + 1} of {len(BANDS)}")
                arrays = make_band(self.vectors, BANDS[number])
                write_arrays(path, identity, arrays)
            self._bands[number] = Band(
                arrays["neighbors"], arrays["patterns"], arrays["starts"], BANDS[number].first
            )
        return self._bands[number]

    def brightest_tree(self, wanted: float) -> cKDTree:
        """Return a tree of at least so many of the brightest stars, or all; its rows are theirs."""
        size = MIN_TREE
        while size < min(wanted, len(self)):
            size *= 2
        size = min(size, len(self))
        if size not in self._trees:
            self._trees[size] = cKDTree(
                self.vectors[:size], leafsize=LEAF_STARS, balanced_tree=False, compact_nodes=False
            )
        return self._trees[size]


def patterns_folder() -> Path:
    """Return where indexes stand in the user's cache."""
    return cache_root() / "star_patterns"


def index_of_stars(
    vectors: FloatArray,
    mag: FloatArray,
    *,
    folder: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> SkyIndex:
    """Return the index of stars, from the cache what stands there.

    Parameters
    ----------
    vectors : (n, 3) ndarray
        Unit vectors, J2000, in any order.
    mag : (n,) ndarray
        Magnitudes; stars without one are left out.
    folder
        Where the bands are kept; default the user's cache.
    progress : callable, optional
        Told in words what is made.
    """
    order = np.lexsort((vectors[:, 0], mag))[: int(np.isfinite(mag).sum())]
    where = folder or patterns_folder()
    return SkyIndex(vectors[order].astype(np.float32), mag[order].astype(np.float32), where, progress)
