"""Times: UTC, spacecraft clock and et (TDB seconds past J2000)."""

import re

import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.spice.guard import Request, spice_call

__all__ = ["et_from_sclk", "et_from_utc", "sclk_from_et", "utc_from_et"]

UTC_MARK = re.compile(
    r"\s*(?:Z|\+00:?00|UTC)\s*$", re.IGNORECASE
)  # ISO 8601 ways to say what a UTC string is
MOST_DIGITS = 9  # of a second; et itself resolves about 1e-7 s today


def et_from_utc(utc: str) -> float:
    """Return the time of a UTC string, TDB s past J2000.

    Parameters
    ----------
    utc : str
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
    et : float
        TDB s past J2000.
    precision : int
        Decimals of the second, 0 to 9.

    Raises
    ------
    KernelError
        No LSK is loaded, or the time lies outside the calendar.
    """
    if not 0 <= precision <= MOST_DIGITS:
        raise KernelError(f"{precision} decimals of a second; ask for 0 to {MOST_DIGITS}.")
    with spice_call(Request("UTC", et), needs_kernels=True):
        return str(spiceypy.et2utc(et, "ISOC", precision))


def et_from_sclk(spacecraft_id: int, sclk: str) -> float:
    """Return the time of a spacecraft clock reading, TDB s past J2000.

    Parameters
    ----------
    spacecraft_id : int
        NAIF number, such as -98; its clock.
    sclk : str
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
    with spice_call(Request(f"reading of clock {spacecraft_id}", et), needs_kernels=True):
        return str(spiceypy.sce2s(spacecraft_id, et))
