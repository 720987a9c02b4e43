"""The index of star patterns: every star, as the faintest of three, with its nearest brighter stars.

A picture that is complete to some magnitude holds, for each of its stars, the brighter ones around it: so bright stars
make the large triangles that wide fields need, and faint ones small triangles for narrow fields, without a choice of scales.
Stars stand in order of brightness, and their triangles in bands of it (`BANDS`), each in a file of its own that is made
when a field first needs it: a field of 10 deg never asks for stars of magnitude 11.

In a band, triangles are sorted by a key: the cell of their code, then their angle (`patterns`). `Band.patterns_near` looks
for the runs of keys that a code may have. With each star stand more of its neighbors than its triangles are made of: among
them a fourth star shows which triangles are true. Files are kept in the user's cache (`index_file`), for the digest of the
stars that they were made from.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.resources import cache_root
from opnav_workbench.stars.lost_in_space.index_file import read_arrays, write_arrays
from opnav_workbench.stars.lost_in_space.patterns import ORDERS, code_of, named_orders, pairs

__all__ = ["BANDS", "Band", "SkyIndex", "index_of_stars", "patterns_folder"]

FORMAT = 2  # raise it whenever the same stars would make another index


@dataclass(frozen=True, slots=True)
class BandRule:
    """Which stars, counted from the brightest, are the faintest of a band's triangles, and of how many neighbors."""

    first: int
    last: int
    neighbors: int  # nearest brighter ones: triangles of a star are two of so many


# Of 1,500 fields with five stars or more in the index, all hold a triangle of a star with two of its six nearest brighter
# ones, and all but one of them a fourth star around it (0.3 to 20 deg, a third false, a fifth of the catalog missing).
# Noise hides some of those: more cost little for bright stars, which are few.
BANDS = (
    BandRule(0, 1 << 14, 12),
    BandRule(1 << 14, 1 << 16, 10),
    BandRule(1 << 16, 1 << 18, 8),
    BandRule(1 << 18, 1 << 19, 7),
    BandRule(1 << 19, 1 << 20, 7),
    BandRule(1 << 20, 1 << 21, 7),
    BandRule(1 << 21, 1 << 22, 7),
)
AROUND = 32  # nearest stars among so many times as many as are brighter: where three alone are bright, the fourth is not
DEEPER = 2.5
MAX_ANGLE_RAD = np.radians(30.0)  # of a pattern: wider than any field that is flat enough
TOO_CLOSE = (
    0.03  # of the distance of the farthest of a triangle's: the two of a double star are one in the picture
)
SPARE_NEIGHBORS = 6  # asked for beyond those, so that enough brighter ones are among them, none too close
LEAF_STARS = 64  # of a tree: built in two thirds of the time that scipy's 16 take, and asked no slower
GROWTH = 1.25  # of the list of stars among which neighbors are looked for
CHUNK = 8192  # stars whose triangles are made at once

CODE_CELL = 0.0025  # about what noise moves a code
X_CELLS = int(np.ceil(0.5 / CODE_CELL)) + 1  # x runs from 0 to 0.5, y from -0.87 to 0.87
Y_CELLS = int(np.ceil(1.75 / CODE_CELL))
ANGLE_STEPS = 1 << 14
LOG_ANGLES = np.log(1e-6), np.log(1.0)  # of the first and last step


# ---- Triangles of a band: made, sorted by their keys, looked up.


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Triangles whose faintest stars are those of one `BandRule`."""

    brighter: NDArray[np.uint32]  # (n, neighbors) rows of stars, those near each star of the band
    around: NDArray[np.uint32]  # (n, AROUND)
    keys: NDArray[np.uint32]  # (m,) in order
    patterns: NDArray[np.uint32]  # (m,) packed: number of the star in its band, which neighbors, which order
    first: int

    def patterns_near(
        self, codes: FloatArray, angle_rad: FloatArray, code_reach: FloatArray, angle_reach: float
    ) -> tuple[IntArray, IntArray, IntArray]:
        """Return rows (c,) of codes (q, 2) that triangles may have, their stars (c, 3) A, B, C, and their numbers (c,)."""
        low, high, rows = _runs_of_keys(codes, angle_rad, code_reach, angle_reach)
        begin = np.searchsorted(self.keys, low)
        count = np.searchsorted(self.keys, high, side="right") - begin
        rows = np.repeat(rows, count)
        place = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        number, which, order = _unpacked(self.patterns.take(place))
        members = self._members(number, which)
        return rows, np.take_along_axis(members, ORDERS.take(order, axis=0), axis=1), number

    def _members(self, number: IntArray, which: IntArray) -> IntArray:
        return _members(self.brighter, self.first, number, which)


def _members(brighter: NDArray[np.uint32], first: int, number: IntArray, which: IntArray) -> IntArray:
    """Return the stars (c, 3) of triangles: those of these numbers in their band, and two brighter ones near each."""
    width = brighter.shape[1]
    near = brighter.ravel().take(number[:, None] * width + pairs(width).take(which, axis=0))
    return np.column_stack([number + first, near]).astype(np.int64)


def _packed(number: IntArray, which: IntArray, order: IntArray) -> NDArray[np.uint32]:
    return ((number << 11) | (which << 3) | order).astype(np.uint32)


def _unpacked(packed: NDArray[np.uint32]) -> tuple[IntArray, IntArray, IntArray]:
    plain = packed.astype(np.int64)
    return plain >> 11, (plain >> 3) & 0xFF, plain & 0x7


def make_band(vectors: NDArray[np.float32], rule: BandRule) -> dict[str, NDArray[Any]]:
    """Make the arrays of a band from the unit vectors (n, 3) of all stars, brightest first."""
    last = min(rule.last, len(vectors))
    brighter, around = _neighbors(vectors, rule.first, last, rule.neighbors)
    made = list(_patterns(vectors, brighter, rule.first))
    packed = np.concatenate([part for part, _ in made])
    keys = np.concatenate([part for _, part in made])
    order = np.argsort(keys, kind="stable")
    return {"brighter": brighter, "around": around, "patterns": packed[order], "keys": keys[order]}


def _neighbors(
    vectors: NDArray[np.float32], first: int, last: int, wanted: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return for stars first..last the nearest brighter ones (n, wanted), and of `DEEPER` times as many (n, AROUND).

    Where there are too few, the star itself stands instead.
    """
    own = np.arange(first, max(last, first), dtype=np.uint32)[:, None]
    brighter, around = np.tile(own, (1, wanted)), np.tile(own, (1, AROUND))
    begin = first
    while begin < last:
        end = min(max(int(begin * GROWTH), begin + AROUND), last)
        deep = vectors[: min(max(int(begin * DEEPER), end), len(vectors))]
        tree = cKDTree(deep, balanced_tree=False, compact_nodes=False, leafsize=LEAF_STARS)
        apart, near = tree.query(
            vectors[begin:end], k=np.arange(min(AROUND + SPARE_NEIGHBORS, len(deep))) + 1
        )
        near, here = np.asarray(near, np.int64), slice(begin - first, end - first)
        number = np.arange(begin, end)[:, None]
        _keep_first(around[here], near, near != number)
        good = near < number
        rank = np.cumsum(good, axis=1)
        reach = np.where(good & (rank <= wanted), apart, 0.0).max(axis=1, keepdims=True)
        _keep_first(brighter[here], near, good & (apart > TOO_CLOSE * reach))
        begin = end
    return brighter, around


def _keep_first(kept: NDArray[np.uint32], near: IntArray, good: BoolArray) -> None:
    """Write the first good ones of each row of `near` (n, k) into `kept` (n, wanted)."""
    rank = np.cumsum(good, axis=1)
    rows, places = np.nonzero(good & (rank <= kept.shape[1]))
    kept[rows, rank[rows, places] - 1] = near[rows, places]


def _patterns(
    vectors: NDArray[np.float32], brighter: NDArray[np.uint32], first: int
) -> Iterator[tuple[NDArray[np.uint32], NDArray[np.uint32]]]:
    """Yield packed triangles and their keys."""
    sets = np.arange(len(pairs(brighter.shape[1])))
    yield np.empty(0, np.uint32), np.empty(0, np.uint32)
    for begin in range(0, len(brighter), CHUNK):
        number = np.arange(begin, min(begin + CHUNK, len(brighter)))
        number, which = (part.ravel() for part in np.meshgrid(number, sets, indexing="ij"))
        members = _members(brighter, first, number, which)
        whole = (members[:, 1:] != members[:, :1]).all(axis=1)
        number, which, members = number[whole], which[whole], members[whole]
        three = vectors[members].astype(np.float64)
        rows, order = named_orders(three)
        codes, angle = code_of(np.take_along_axis(three[rows], ORDERS[order][:, :, None], axis=1))
        kept = angle < MAX_ANGLE_RAD
        x, y = _cells(codes[kept])
        yield _packed(number[rows], which[rows], order)[kept], _keys(x, y, angle[kept])


# ---- Keys of codes and angles.


def _cells(codes: FloatArray) -> tuple[IntArray, IntArray]:
    x = np.clip(np.floor(codes[:, 0] / CODE_CELL), 0, X_CELLS - 1)
    y = np.clip(np.floor(codes[:, 1] / CODE_CELL) + Y_CELLS // 2, 0, Y_CELLS - 1)
    return x.astype(np.int64), y.astype(np.int64)


def _keys(x: IntArray, y: IntArray, angle_rad: FloatArray) -> NDArray[np.uint32]:
    """Return the cells, and within each the angle's logarithm."""
    first, last = LOG_ANGLES
    step = np.clip((np.log(angle_rad) - first) / (last - first) * ANGLE_STEPS, 0, ANGLE_STEPS - 1)
    return np.asarray((x * Y_CELLS + y) * ANGLE_STEPS + step.astype(np.int64), np.uint32)


def _runs_of_keys(
    codes: FloatArray, angle_rad: FloatArray, code_reach: FloatArray, angle_reach: float
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], IntArray]:
    """Return first and last keys of the cells that codes may be in, and the rows (c,) of these codes."""
    left, low = _cells(codes - code_reach[:, None])
    right, high = _cells(codes + code_reach[:, None])
    wide, tall = right - left + 1, high - low + 1
    rows = np.repeat(np.arange(len(codes)), wide * tall)
    step = np.arange(len(rows)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
    x, y = left[rows] + step // tall[rows], low[rows] + step % tall[rows]
    angle = angle_rad[rows]
    return _keys(x, y, angle * np.exp(-angle_reach)), _keys(x, y, angle * np.exp(angle_reach)), rows


# ---- The whole index: stars in order of brightness, bands made when first asked for.

MIN_TREE = 1 << 12
# Of which the density is taken, where stars are
COVER_STARS, COVER_SAMPLE, COVER_NEIGHBORS = 1 << 16, 300, 20


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
        summed = sha256(f"{FORMAT} {BANDS} {AROUND} {DEEPER} {CODE_CELL}".encode())
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

    def is_made(self, number: int) -> bool:
        """Tell whether a band stands ready."""
        return number in self._bands or self._path(number).is_file()

    def band(self, number: int) -> Band:
        """Return a band, read or made at its first use."""
        if number not in self._bands:
            path, identity = self._path(number), {"digest": self.digest, "band": number}
            arrays = read_arrays(path, identity)
            if arrays is None:
                if self._progress is not None:
                    self._progress(f"making the index of star patterns, band {number + 1} of {len(BANDS)}")
                arrays = make_band(self.vectors, BANDS[number])
                write_arrays(path, identity, arrays)
            self._bands[number] = Band(
                arrays["brighter"], arrays["around"], arrays["keys"], arrays["patterns"], BANDS[number].first
            )
        return self._bands[number]

    def open_all(self) -> None:
        """Make or read all that pictures of any width ask for, so that none waits."""
        for number, rule in enumerate(BANDS):
            if rule.first < len(self):
                self.band(number)
        size = MIN_TREE
        while size < 2 * len(self):
            self.brightest_tree(size)
            size *= 2

    def _path(self, number: int) -> Path:
        return self._folder / f"{self.digest[:16]}-band{number}.opnavindex"

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
