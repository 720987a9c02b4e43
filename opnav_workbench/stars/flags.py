"""One table of flags for everything that can befall a star's center."""

from collections.abc import Mapping
from enum import IntFlag
from functools import lru_cache

import numpy as np

from opnav_workbench.arrays import BoolArray, IntArray

__all__ = ["StarFlag", "combine_flags", "describe_flags"]


class StarFlag(IntFlag):
    """What is known against a center; bits add up, and OK is none of them.

    Examples
    --------
    >>> StarFlag.EDGE | StarFlag.LOW_SNR
    <StarFlag.EDGE|LOW_SNR: 20>
    """

    OK = 0
    NOT_CONVERGED = 1
    SATURATED = 2
    EDGE = 4
    BAD_PIXELS = 8
    LOW_SNR = 16
    AT_BOUND = 32
    BLENDED = 64
    COSMIC_RAY = 128
    NOT_FINITE = 256
    HIT = 512
    FLANKS = 1024
    PAIR = 2048


_MEANING = {
    StarFlag.NOT_CONVERGED: "the fit did not converge",
    StarFlag.SATURATED: "saturated pixels within the star were left out",
    StarFlag.EDGE: "the box reaches over the edge of the detector",
    StarFlag.BAD_PIXELS: "bad pixels within the star were left out",
    StarFlag.LOW_SNR: "signal-to-noise ratio too low for a center",
    StarFlag.AT_BOUND: "the center stopped at the limit of its search area",
    StarFlag.BLENDED: "another star lies within the star's image",
    StarFlag.COSMIC_RAY: "sharper than the point spread function",
    StarFlag.NOT_FINITE: "no center: too few usable pixels",
    StarFlag.HIT: "pixels with light that is not the star's (a cosmic ray, an unlisted neighbor) were left out",
    StarFlag.FLANKS: "measured by the flanks and wings of its image: the core is saturated",
    StarFlag.PAIR: "its image may be that of two stars, one in no catalog: the covariance holds both",
}


@lru_cache(maxsize=256)
def describe_flags(flags: int) -> str:
    """Return the meaning of a flag value in words, ``"ok"`` for none.

    Examples
    --------
    >>> describe_flags(20)
    'the box reaches over the edge of the detector; signal-to-noise ratio too low for a center'
    """
    return "; ".join(text for flag, text in _MEANING.items() if flags & flag) or "ok"


def combine_flags(conditions: Mapping[StarFlag, BoolArray], n: int) -> IntArray:
    """Return (n,) flag values: the sum of the flags whose condition (n,) holds."""
    flags = np.zeros(n, np.int64)
    for flag, condition in conditions.items():
        flags |= np.where(condition, int(flag), 0)
    return flags
