"""Mid-exposure times from header values, without kernels.

Source: IAU time scales through astropy/ERFA. They agree with SPICE's to 0.05 ms, as SPICE keeps one term of
TDB - TT.
"""

import re

import numpy as np
from astropy.time import Time

from opnav_workbench.constants import DAY_S, J2000_JD

__all__ = ["et_from_text", "text_from_et"]

DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})[T ](.+)")
CLOCK = re.compile(r"\d{1,2}:\d{2}")  # a date alone would silently mean midnight


def et_from_text(utc: str) -> float:
    """Return TDB seconds past J2000 of a UTC text: calendar or day of year, with or without a final Z.

    Raises
    ------
    ValueError
        The text is no time, or a date without a time of day.

    Examples
    --------
    >>> round(et_from_text("2020-113T10:06:52.348Z"), 3)
    640822081.534
    """
    text = utc.strip().removesuffix("Z").removesuffix("UTC").strip()
    if not CLOCK.search(text):
        raise ValueError(f"{utc!r} has no time of day")
    if match := DAY_OF_YEAR.fullmatch(text):
        text = ":".join(match.groups())
    time = Time(text, scale="utc").tdb
    return float(((time.jd1 - J2000_JD) + time.jd2) * DAY_S)


def text_from_et(et: float, decimals: int = 3) -> str:
    """Return the UTC of TDB seconds past J2000, ISO calendar with so many decimals of the second.

    Raises
    ------
    ValueError
        `et` is outside the years 1 to 9999.

    Examples
    --------
    >>> text_from_et(640822081.5339231)
    '2020-04-22T10:06:52.348'
    """
    whole_days = np.floor(et / DAY_S)
    time = Time(J2000_JD + whole_days, (et - whole_days * DAY_S) / DAY_S, format="jd", scale="tdb")
    utc = time.utc
    utc.precision = decimals
    return str(utc.isot)
