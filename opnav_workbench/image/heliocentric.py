"""From the Sun to the solar-system barycenter without kernels.

Source: ERFA ``epv00`` after VSOP2000 (Moisson & Bretagnon 2001, Celest. Mech. 80, 205): the Earth's places
with respect to the barycenter and to the Sun differ by the Sun's own. In 2006-2030 that is at most 118 km
from DE440's, nearly constant (DE440 counts the Kuiper belt into the barycenter), its velocity 0.3 mm/s.
"""

import erfa
import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import AU_KM

__all__ = ["barycentric_from_heliocentric"]

J2000_JD = 2451545.0
DAY_S = 86400.0


def barycentric_from_heliocentric(
    position_km: ArrayLike, velocity_km_s: ArrayLike, et: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Shift a state with respect to the Sun to one with respect to the solar-system barycenter, J2000.

    Parameters
    ----------
    position_km, velocity_km_s : (3,) or (n, 3) array_like
        With respect to the Sun.
    et : float or (n,) array_like
        TDB seconds past J2000.

    Returns
    -------
    position_km, velocity_km_s : arrays as given
        With respect to the solar-system barycenter.

    Notes
    -----
    Meant for 1900 to 2100, where the series holds.

    Examples
    --------
    >>> position, velocity = barycentric_from_heliocentric([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0)
    >>> bool(np.linalg.norm(position) < 2.2 * 695_700.0)  # the Sun stays within two of its radii
    True
    """
    heliocentric, barycentric = erfa.epv00(J2000_JD, np.asarray(et, dtype=np.float64) / DAY_S)
    sun_km = (barycentric["p"] - heliocentric["p"]) * AU_KM
    sun_km_s = (barycentric["v"] - heliocentric["v"]) * AU_KM / DAY_S
    return np.asarray(position_km, float) + sun_km, np.asarray(velocity_km_s, float) + sun_km_s
