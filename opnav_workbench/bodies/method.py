"""Which method "auto" means for a body."""

__all__ = ["UNRESOLVED_TO_PX", "choose_method"]

UNRESOLVED_TO_PX = 1.0  # AAS 13-443: unresolved below one pixel


def choose_method(diameter_px: float, *, known_surface: bool = False) -> str:
    """Return the method for a body of a predicted size.

    Parameters
    ----------
    diameter_px
        0 or nan for a point.
    known_surface
        Whether the model has the body's albedo map: its whole disk then counts, not its limb alone.

    Returns
    -------
    str
        ``unresolved``, ``least_squares`` or ``disk``.

    Notes
    -----
    Below 1 px a body is a star with its light beside its center of figure; above, the rendered model is that very light,
    so that nothing jumps between the two. The disk's likelihood knows that size, figure, law and albedo are not what was
    expected: of a body of a few pixels that is most of its center's uncertainty.

    Examples
    --------
    >>> [choose_method(size) for size in (0.2, 3.0, 190.0)]
    ['unresolved', 'disk', 'disk']
    """
    if not diameter_px >= UNRESOLVED_TO_PX:
        return "unresolved"
    return "least_squares" if known_surface else "disk"
