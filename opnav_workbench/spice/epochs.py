"""Calendar times and Julian dates of scenario files as ephemeris time (TDB seconds past J2000)."""

from datetime import UTC, datetime
from decimal import Decimal

from opnav_workbench.spice.time import et_from_utc

__all__ = ["AU_KM", "DAY_S", "J2000_JD", "et_from_jd", "et_from_tdb", "utc_to_et"]

AU_KM = 149597870.7  # IAU 2012
DAY_S = 86400.0
J2000_JD = 2451545.0
J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def et_from_tdb(moment: datetime) -> float:
    """Return seconds past J2000 of a TDB calendar time; exact to its microsecond.

    Examples
    --------
    >>> et_from_tdb(datetime(2000, 1, 2, 12))
    86400.0
    """
    return (moment.replace(tzinfo=UTC) - J2000).total_seconds()


def utc_to_et(moment: datetime) -> float:
    """Return seconds past J2000 TDB of a UTC calendar time; needs an active `KernelSet` with an LSK."""
    return et_from_utc(moment.isoformat())


def et_from_jd(julian_date: str | float) -> float:
    """Return seconds past J2000 of a TDB Julian date; text keeps digits that a float has no room for.

    Examples
    --------
    >>> et_from_jd("2457205.50000000125"), et_from_jd(2451546.0)
    (489067200.000108, 86400.0)
    """
    return float((Decimal(str(julian_date)) - Decimal(J2000_JD)) * Decimal(DAY_S))
