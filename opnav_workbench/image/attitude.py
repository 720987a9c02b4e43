"""Pointing and trajectory from header keywords."""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.image.frame import Header, HeaderGeometry
from opnav_workbench.image.keywords import KeywordMap, number

__all__ = ["header_geometry"]

# Quaternions are printed with at least five digits; one that is further from length 1 is no attitude.
QUATERNION_NORM_TOLERANCE = 1e-3
# FK5 at J2000 is turned against the ICRS by about 23 mas.
FRAME_REMARK = (
    "header coordinates are {}, which differs from ICRS by about 0.02 arcsec; no correction is made"
)


def header_geometry(header: Header, keywords: KeywordMap) -> tuple[HeaderGeometry | None, tuple[str, ...]]:
    """Return what the header says of pointing and trajectory, None without a usable attitude, and remarks.

    Notes
    -----
    New Horizons headers give the Sun without stellar aberration (checked against SPICE in 2007 headers to the
    100 km by which the trajectories differ), so the vector turned round is the spacecraft's place.
    """
    messages = _frame_remarks(header)
    if keywords.quaternion is None:
        return None, messages
    attitude, problem = _attitude(header, keywords)
    if attitude is None:
        return None, (*messages, problem)
    return (
        HeaderGeometry(
            attitude,
            _turned_round(header, keywords, "sun_position"),
            _turned_round(header, keywords, "sun_velocity"),
            str(keywords.value(header, "geometry_quality") or ""),
        ),
        messages,
    )


def _attitude(header: Header, keywords: KeywordMap) -> tuple[FloatArray | None, str]:
    names = ", ".join(keywords.quaternion or ())
    quaternion = _vector(header, keywords, "quaternion")
    if quaternion is None:
        return None, f"no header pointing: {names} are not all in the header"
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= QUATERNION_NORM_TOLERANCE:
        return None, f"no header pointing: the quaternion {names} has length {length:.6g} instead of 1"
    matrix = matrix_from_quaternion(quaternion)
    return (matrix.T if keywords.quaternion_sense == "camera_to_j2000" else matrix), ""


def _turned_round(header: Header, keywords: KeywordMap, name: str) -> FloatArray | None:
    sun = _vector(header, keywords, name)
    return None if sun is None else -sun


def _vector(header: Header, keywords: KeywordMap, name: str) -> FloatArray | None:
    values = [number(keywords.known(header, keyword)) for keyword in getattr(keywords, name) or ()]
    known = [v for v in values if v is not None and np.isfinite(v)]
    return np.array(known) if known and len(known) == len(values) else None


def _frame_remarks(header: Header) -> tuple[str, ...]:
    system = header.get("RADESYS", header.get("RADECSYS"))
    if not isinstance(system, str) or system.strip().upper() in ("", "ICRS"):
        return ()
    return (FRAME_REMARK.format(system.strip()),)
