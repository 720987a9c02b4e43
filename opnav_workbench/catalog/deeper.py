"""What a deeper catalog would bring into a field, before anybody has it: commands, and about how many stars.

How many stars there are to a magnitude in a direction is told by how many of the bundled catalog's are around it, against
their mean over the sky: toward the poles of the Galaxy a third of what its plane has.
"""

import math
from dataclasses import dataclass

from opnav_workbench.catalog.bundled import open_bundled
from opnav_workbench.catalog.specs import debian_tycho2
from opnav_workbench.catalog.whole_sky import fetched_names

__all__ = ["deeper_catalogs"]

AROUND_RAD = math.radians(4.0)  # 600 bundled stars in the mean


@dataclass(frozen=True, slots=True)
class _Deeper:
    name: str
    command: str
    stars: float  # of the whole sky


TYCHO2 = _Deeper("tycho2", "opnav catalog fetch tycho2", 2.5e6)
DEBIAN = _Deeper("tycho2", "apt install astrometry-data-tycho2-07", 1.9e6)
GAIA = _Deeper("gaia", "opnav catalog fetch gaia --mag-limit 13", 7e6)


def deeper_catalogs(ra_rad: float, dec_rad: float, field_sr: float) -> str:
    """Say which commands would bring about how many stars into a field, of what this machine has not.

    Parameters
    ----------
    ra_rad, dec_rad
        Middle of the field.
    field_sr
        Its solid angle.

    Returns
    -------
    str
        Empty where the machine has all that the commands would get.

    Examples
    --------
    >>> deeper_catalogs(2.86, 0.12, 2.6e-5)  # doctest: +SKIP
    'opnav catalog fetch tycho2: about 3 stars in this field; opnav catalog fetch gaia --mag-limit 13: about 9'
    """
    here = fetched_names()
    wanted = [found for found in (TYCHO2, GAIA) if found.name not in here]
    if TYCHO2 in wanted:
        wanted = wanted[1:] if debian_tycho2() is not None else [TYCHO2, DEBIAN, *wanted[1:]]
    if not wanted:
        return ""
    part = _crowding(ra_rad, dec_rad) * field_sr / (4.0 * math.pi)
    told = [f"{found.command}: about {_few(found.stars * part)}" for found in wanted]
    return "; ".join([f"{told[0]} stars in this field", *told[1:]])


def _crowding(ra_rad: float, dec_rad: float) -> float:
    """Return how many bundled stars are around a direction, over how many there are in the mean."""
    bundled = open_bundled()
    mean = float(bundled.describe()["n_stars"]) * 0.5 * (1.0 - math.cos(AROUND_RAD))
    return (len(bundled.cone(ra_rad, dec_rad, AROUND_RAD)) + 1.0) / (mean + 1.0)


def _few(count: float) -> str:
    """Return a number of stars, to one digit that means something."""
    digits = 1 - max(math.floor(math.log10(max(count, 1.0))), 1)
    return f"{round(count, digits):.0f}"
