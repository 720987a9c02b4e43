"""Saturated stars in a detection list: the filter sees only their wings, their cores say where they are."""

from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from opnav_workbench.arrays import BoolArray
from opnav_workbench.starcenters.detections import Detections
from opnav_workbench.starcenters.flags import StarFlag

__all__ = ["replace_saturated"]

WING_SIGMAS = 4.0  # a core's wings, beyond its own radius, in which detections are parts of the same star


def replace_saturated(found: Detections, saturated: BoolArray, sigma_px: float) -> Detections:
    """Return the detections with one at the middle of each saturated core, in place of those around it.

    Its flux is that of the brightest detection it replaces (of all, where it replaces none), a lower limit; it is
    flagged SATURATED.
    """
    if not saturated.any():
        return found
    labels, count = ndimage.label(saturated, structure=np.ones((3, 3)))
    rows = np.arange(1, count + 1)
    middle = np.array(ndimage.center_of_mass(saturated, labels, rows))[:, ::-1]
    radius = np.sqrt(np.bincount(labels.ravel(), minlength=count + 1)[1:] / np.pi) + WING_SIGMAS * sigma_px
    near = cKDTree(found.pixel_line.reshape(-1, 2)).query_ball_point(middle, radius)
    kept = np.setdiff1d(np.arange(len(found)), np.concatenate([*near, []]).astype(np.int64))
    brightest = float(np.max(found.flux_dn, initial=1.0))
    flux = np.array([float(found.flux_dn[n].max()) if n else brightest for n in near])
    snr = np.array([float(found.snr[n].max()) if n else float(np.max(found.snr, initial=1.0)) for n in near])
    return replace(
        found,
        pixel_line=np.vstack([found.pixel_line[kept], middle]),
        flux_dn=np.r_[found.flux_dn[kept], flux],
        snr=np.r_[found.snr[kept], snr],
        sharpness=np.r_[found.sharpness[kept], np.ones(count)],
        flags=np.r_[found.flags[kept], np.full(count, int(StarFlag.SATURATED))],
    )
