"""Which method "auto" means for a body."""

import numpy as np

__all__ = ["UNRESOLVED_TO_PX", "choose_method"]

UNRESOLVED_TO_PX = 1.0  # AAS 13-443: unresolved below one pixel
DISK_FROM_PX = 6.0  # a limb that is a line of pixels, not a blur
CRESCENT_FROM_PX = 2.5  # width of the lit part: narrower, size and figure cannot be told from the place


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
        ``unresolved``, ``least_squares`` or ``disk``.

    Notes
    -----
    Below 1 px a body is a star with its light beside its center of figure; above, the rendered model is that very light,
    so that nothing jumps between the two. From 6 px on the pixels about the limb carry the center, with whatever albedo.

    Examples
    --------
    >>> [choose_method(size, 0.3) for size in (0.2, 3.0, 190.0)]
    ['unresolved', 'least_squares', 'disk']
    """
    if not diameter_px >= UNRESOLVED_TO_PX:
        return "unresolved"
    width = 0.5 * diameter_px * (1.0 + np.cos(phase_rad)) if np.isfinite(phase_rad) else diameter_px
    if diameter_px < DISK_FROM_PX or width < CRESCENT_FROM_PX or known_surface:
        return "least_squares"
    return "disk"
