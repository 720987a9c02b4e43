"""Mid-exposure times from header values, without kernels.

Source: IAU time scales through astropy/ERFA. They agree with SPICE's to 0.05 ms, as SPICE keeps one term of
TDB - TT.
"""

import re

import erfa
import numpy as np

from opnav_workbench.constants import DAY_S, J2000_JD

__all__ = ["et_from_text", "text_from_et"]

DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})[T ](.+)")
CLOCK = re.compile(r"\d{1,2}:\d{2}")  # a date alone would silently mean midnight
CALENDAR = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d)(?::([0-5]\d(?:\.\d*)?))?")
# ERFA's own leap seconds hold in these years (IERS, Bulletin C 70); of later ones astropy knows by its data
ERFA_YEARS = range(1972, 2026)


def et_from_text(utc: str, scale: str = "utc") -> float:
    """Return TDB seconds past J2000 of a UTC text: calendar or day of year, with or without a final Z.

    Parameters
    ----------
    scale : {"utc", "tai", "tt", "tdb"}
        Of the text, where it is another one.

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
    time = _plain_calendar_tdb(text) if scale == "utc" else None
    if time is None:
        from astropy.time import Time  # noqa: PLC0415 (loads tables, a tenth of a short command)

        try:
            found = Time(text, scale=scale).tdb
        except ValueError:  # one line for each of the library's forms
            raise ValueError(
                "no such date, or not of the form 2015-07-01T12:00:00.000 or 2015-182T12:00:00"
            ) from None
        time = found.jd1, found.jd2
    return float(((time[0] - J2000_JD) + time[1]) * DAY_S)


def _plain_calendar_tdb(text: str) -> tuple[float, float] | None:
    """Return the Julian date, TDB, of a calendar text as most headers have it, as astropy does; None: another text."""
    match = CALENDAR.fullmatch(text)
    if match is None or int(match[1]) not in ERFA_YEARS:
        return None
    *minutes, seconds = match.groups(default="0")
    try:
        utc = erfa.dtf2d("UTC", *map(int, minutes), float(seconds))
    except erfa.ErfaError:
        return None
    tt = erfa.taitt(*erfa.utctai(*utc))
    of_day = (utc[0] - 0.5) % 1.0 + utc[1]
    day, part = erfa.tttdb(*tt, erfa.dtdb(*tt, of_day % 1.0, 0.0, 0.0, 0.0))
    return float(day), float(part)


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
    from astropy.time import Time  # noqa: PLC0415 (loads tables, a tenth of a short command)

    whole_days = np.floor(et / DAY_S)
    time = Time(J2000_JD + whole_days, (et - whole_days * DAY_S) / DAY_S, format="jd", scale="tdb")
    utc = time.utc
    utc.precision = decimals
    return str(utc.isot)
