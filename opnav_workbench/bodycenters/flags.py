"""One table of flags for everything that can befall a body's center."""

from enum import IntFlag

__all__ = ["BodyFlag", "describe_body_flags"]


class BodyFlag(IntFlag):
    """What is known against a body's center; bits add up, and OK is none of them.

    Examples
    --------
    >>> BodyFlag.CUT_BY_EDGE | BodyFlag.THIN_CRESCENT
    <BodyFlag.CUT_BY_EDGE|THIN_CRESCENT: 9>
    """

    OK = 0
    CUT_BY_EDGE = 1
    OVEREXPOSED = 2
    OCCULTED = 4
    THIN_CRESCENT = 8
    CIRCLE_MISFIT = 16
    POOR_FIT = 32
    AT_LIMIT = 64
    WEAK_GEOMETRY = 128
    EMPTY = 256
    BAD_PIXELS = 512
    HIT = 1024
    NOT_CONVERGED = 2048
    SIZE_UNSOLVED = 4096


_MEANING = {
    BodyFlag.CUT_BY_EDGE: "part of it lies off the detector",
    BodyFlag.OVEREXPOSED: "saturated pixels were left out",
    BodyFlag.OCCULTED: "another body hides part of it",
    BodyFlag.THIN_CRESCENT: "its lit crescent is less than a pixel wide",
    BodyFlag.CIRCLE_MISFIT: "its image does not have the size that was expected",
    BodyFlag.POOR_FIT: "its image is not that of the model",
    BodyFlag.AT_LIMIT: "the center stopped at the limit of its search area",
    BodyFlag.WEAK_GEOMETRY: "one direction is hardly determined",
    BodyFlag.EMPTY: "too few usable pixels",
    BodyFlag.BAD_PIXELS: "bad pixels on it were left out",
    BodyFlag.HIT: "pixels with light that is not the body's (cosmic rays, stars) were left out",
    BodyFlag.NOT_CONVERGED: "the solution did not converge",
    BodyFlag.SIZE_UNSOLVED: "its size could not be solved for",
}


def describe_body_flags(flags: int) -> str:
    """Return the meaning of a flag value in words, ``"ok"`` for none.

    Examples
    --------
    >>> describe_body_flags(9)
    'part of it lies off the detector; its lit crescent is less than a pixel wide'
    """
    return "; ".join(text for flag, text in _MEANING.items() if flags & flag) or "ok"
