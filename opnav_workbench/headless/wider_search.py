"""A second, wider look for a body whose ephemeris is farther off than anybody announced."""

import numpy as np

from opnav_workbench.bodycenters import BodyCenter, BodyFlag
from opnav_workbench.bodycenters.subarray import search_radius
from opnav_workbench.session import ImageSession

__all__ = ["search_wider"]

# An ephemeris may be off by more than a body's size; a disk this wide is not mistaken for a star or another body.
WIDER_FROM_PX = 3.0
WIDER_SEARCHES = (2.5, 6.0)  # of the usual radius, one after the other
# A point may be mistaken for one: so far out it counts only if it is as clear and as bright as it should be.
POINT_SEARCHES_PX = (10.0, 30.0)
POINT_SNR = 10.0


def search_wider(session: ImageSession, name: str, method: str) -> None:
    """Look farther out for a body that stands at the edge of where it was searched, or beyond: as an analyst would."""
    diameter = float(np.nan_to_num(session.predict_body(name).diameter_px))
    if diameter < WIDER_FROM_PX:
        _search_point(session, name, method)
        return
    for factor in WIDER_SEARCHES:
        center = _last(session, name)
        if center.pixel_line is not None and not center.flags & BodyFlag.AT_LIMIT:
            return
        session.find_body(name, method, factor * search_radius(0.5 * diameter, None))


def _search_point(session: ImageSession, name: str, method: str) -> None:
    """Look farther out for a point of known brightness; what does not fit is taken back."""
    missed = _last(session, name)
    known = session.inputs.targets[name].magnitude is not None
    if missed.method != "unresolved" or missed.status != "not_detected" or not known:
        return
    for radius_px in POINT_SEARCHES_PX:
        session.find_body(name, method, radius_px)
        found = _last(session, name)
        if found.status == "ok" and found.snr >= POINT_SNR:
            return
        session.undo()


def _last(session: ImageSession, name: str) -> BodyCenter:
    return next(body for body in reversed(session.state.bodies) if body.name == name)
