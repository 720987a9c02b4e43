"""Which method "auto" means for a body."""

import numpy as np

__all__ = ["UNRESOLVED_TO_PX", "choose_method"]

UNRESOLVED_TO_PX = 1.0  # AAS 13-443: unresolved below one pixel
LIMB_SCAN_FROM_PX = (
    40.0  # a limb long enough for scans; below, its pattern is a small part of a pixel's error
)
THIN_PHASE_RAD = np.radians(150.0)  # beyond, limb scans cross nothing but a thread


def choose_method(diameter_px: float, phase_rad: float = np.nan, *, known_surface: bool = False) -> str:
    """Return the method for a body of a predicted size and phase.

    Parameters
    ----------
    diameter_px
        0 or nan for a point.
    phase_rad
        Sun - body - spacecraft; nan where unknown.
    known_surface
        Whether the model has the body's albedo map: its whole disk then counts, not its limb alone.

    Returns
    -------
    str
        ``unresolved``, ``least_squares`` or ``limb_scan``.

    Notes
    -----
    Below 1 px a body is a star with its light beside its center of figure; above, the rendered model is that very light,
    so that nothing jumps between the two. From 40 px on the limb carries the center, and albedo features do not.

    Examples
    --------
    >>> [choose_method(size, 0.3) for size in (0.2, 3.0, 190.0)]
    ['unresolved', 'least_squares', 'limb_scan']
    """
    if not diameter_px >= UNRESOLVED_TO_PX:
        return "unresolved"
    if diameter_px < LIMB_SCAN_FROM_PX or known_surface or phase_rad > THIN_PHASE_RAD:
        return "least_squares"
    return "limb_scan"
