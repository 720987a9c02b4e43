"""Light that a bright body leaves all along its columns while a frame-transfer CCD is read out without a shutter."""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import ImageError

__all__ = ["column_level"]

LEAST_LINES = 8  # of a column, to tell its level from


def column_level(image_dn: FloatArray, leave_out: ArrayLike = False) -> FloatArray:
    """Return the level (n_line, n_pixel) of a picture's columns: the median of each, body and stars left aside.

    A body's charge is shifted under its own light on its way to the store: every pixel of its columns gets the same
    share of it.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    leave_out : (n_line, n_pixel) array_like of bool
        Pixels of the body, and bad ones.

    Raises
    ------
    ImageError
        The picture has no usable line; a column with fewer than 8 takes the level of its neighbours.

    Examples
    --------
    >>> picture = np.full((32, 3), 5.0)
    >>> picture[:, 1] = 9.0
    >>> picture[10, 1] = 500.0
    >>> column_level(picture)[0].tolist()
    [5.0, 9.0, 5.0]
    """
    out = np.broadcast_to(np.asarray(leave_out, dtype=bool), image_dn.shape)
    usable = ~out & np.isfinite(image_dn)
    enough = usable.sum(axis=0) >= min(LEAST_LINES, len(image_dn))
    if not enough.any():
        raise ImageError("no column of the picture has usable lines beside the body; leave less of it out.")
    level = np.nanmedian(np.where(usable, image_dn, np.nan)[:, enough], axis=0)
    columns = np.arange(image_dn.shape[1])
    return np.broadcast_to(np.interp(columns, columns[enough], level), image_dn.shape).copy()
