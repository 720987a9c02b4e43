"""What may be wrong with a catalog star: one table of flags for all catalogs."""

from collections.abc import Mapping
from enum import IntFlag

import numpy as np

from opnav_workbench.arrays import BoolArray, IntArray

__all__ = ["StarQuality", "quality_flags"]


class StarQuality(IntFlag):
    """Flags of a star's row, combined with ``|``; 0 says that the catalog knows nothing against the star.

    ====================  ======================================================================================
    flag                  meaning
    ====================  ======================================================================================
    DOUBLE                component of a double or multiple star, blended, or a close neighbor that may move the
                          light center
    BAD_ASTROMETRY        the catalog itself doubts position or motion; they may be off by more than their sigmas
    NO_MEAN_POSITION      position of one observed epoch only (Tycho-2 rows marked X): no motion, a larger sigma
    HIGH_PROPER_MOTION    treated as a star of high proper motion, where catalogs mismatch most easily
    SUPPLEMENT            not from the catalog's own observations: put in from another list
    BAD_PHOTOMETRY        the magnitude is missing, saturated or doubtful
    VARIABLE              known to vary in brightness
    EXTENDED              matched to a galaxy or an extended source
    ====================  ======================================================================================

    That a motion is unknown is told by the column `motion_known`, not by a flag.

    Examples
    --------
    >>> StarQuality.DOUBLE | StarQuality.VARIABLE
    <StarQuality.DOUBLE|VARIABLE: 65>
    """

    DOUBLE = 1
    BAD_ASTROMETRY = 2
    NO_MEAN_POSITION = 4
    HIGH_PROPER_MOTION = 8
    SUPPLEMENT = 16
    BAD_PHOTOMETRY = 32
    VARIABLE = 64
    EXTENDED = 128


def quality_flags(where: Mapping[StarQuality, BoolArray]) -> IntArray:
    """Return the flags (n,) of stars from masks (n,), one a flag.

    Examples
    --------
    >>> quality_flags({StarQuality.DOUBLE: np.array([True, False])}).tolist()
    [1, 0]
    """
    columns = [np.where(mask, int(flag), 0) for flag, mask in where.items()]
    return np.asarray(np.bitwise_or.reduce(columns), dtype=np.int64)
