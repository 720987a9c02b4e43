"""Pixels on their way to the pages: kept here as long as somebody needs them, asked for by each page piece by piece.

Flow   an array is put up and gets a token -> the view's state tells the pages tokens in the order of need -> a page asks for
       pieces of what it lacks (static/pixel_store.js), first what is shown, then what will be shown next
Why    a picture of 4096 x 4096 sent whole keeps a page and the kernel's channel for seconds, and every key with them
"""

import itertools
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["ArrayStore", "SentArray", "SentPicture", "block_means"]

MAX_UINT16 = 65535
COARSE_PX = 1024  # longest side of what is sent ahead of a larger picture, so that it is seen at once


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class SentArray:
    """An array that pages may ask for by its token; uint16 or float32, contiguous."""

    token: str
    values: np.ndarray

    def as_page_values(self) -> dict[str, Any]:
        """What a page must know to ask for it."""
        return {"token": self.token, "dtype": self.values.dtype.name, "shape": self.values.shape}

    def piece(self, first: int, count: int) -> memoryview:
        """Return bytes of it, from the `first` on."""
        return self.values.data.cast("B")[max(first, 0) : max(first, 0) + max(count, 0)]


@dataclass(frozen=True, slots=True, eq=False)
class SentPicture:
    """A picture's pixels, and where it is large means of `block` x `block` of them, which come first."""

    full: SentArray
    coarse: SentArray | None
    block: int

    @property
    def n_bytes(self) -> int:
        """What a page holds of it."""
        return int(self.full.values.nbytes)

    def as_page_values(self) -> dict[str, Any]:
        """What a page must know to show it."""
        coarse = None if self.coarse is None else self.coarse.as_page_values() | {"block": self.block}
        return {"full": self.full.as_page_values(), "coarse": coarse}


class ArrayStore:
    """Arrays by token; each lives as long as what `put` returned is kept."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._arrays: weakref.WeakValueDictionary[str, SentArray] = weakref.WeakValueDictionary()

    def put(self, image: np.ndarray) -> SentPicture:
        """Put up a picture (n_line, n_pixel)."""
        block = -(-max(image.shape) // COARSE_PX)
        coarse = None if block == 1 else self._put(block_means(image, block))
        return SentPicture(self._put(_compact(image)), coarse, block)

    def get(self, token: str) -> SentArray | None:
        """Return an array; None where it is gone."""
        return self._arrays.get(token)

    def _put(self, values: np.ndarray) -> SentArray:
        one = SentArray(str(next(self._numbers)), values)
        self._arrays[one.token] = one
        return one


def block_means(image: np.ndarray, block: int) -> np.ndarray:
    """Return means of blocks of `block` x `block` pixels as float32; those at the far edges may be smaller.

    Pixels that are no number do not count; nan where a block has no other.

    Examples
    --------
    >>> block_means(np.arange(15.0).reshape(3, 5), 2).tolist()
    [[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]]
    """
    known = np.isfinite(image) if image.dtype.kind == "f" else None
    if known is None or known.all():
        lines, pixels = (np.diff([*range(0, n, block), n]) for n in image.shape)
        return np.asarray(_block_sums(image, block) / np.outer(lines, pixels), dtype=np.float32)
    with np.errstate(invalid="ignore"):  # a block without a number
        means = _block_sums(np.where(known, image, 0.0), block) / _block_sums(known, block)
    return np.asarray(means, dtype=np.float32)


def _block_sums(image: np.ndarray, block: int) -> np.ndarray:
    lines, pixels = (np.arange(0, n, block) for n in image.shape)
    sums: np.ndarray = np.add.reduceat(np.add.reduceat(image, lines, axis=0, dtype=float), pixels, axis=1)
    return sums


def _compact(image: np.ndarray) -> np.ndarray:
    """Return the smallest type that holds the picture: counts as uint16, anything else as float32."""
    whole = np.isfinite(image).all() and (image == np.floor(image)).all()
    counts = whole and image.min() >= 0 and image.max() <= MAX_UINT16
    return np.ascontiguousarray(image.astype(np.uint16 if counts else np.float32))
