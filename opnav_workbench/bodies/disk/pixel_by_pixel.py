"""Fits of one disk that stand apart, compared by pixels: each by itself, whatever else explains its neighbours.

The likelihood that a fit rests on is that of its own strip, in its own cells and with its own prior. Strips of outlines that
lie apart hold other pixels, and a strip beside the limb is easily explained.
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import BoolArray, IntArray
from opnav_workbench.bodies.disk.columns import RELIEF, disk_columns
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.disk.limb_cells import limb_places
from opnav_workbench.bodies.disk.sky_edge import surprise
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["likelier", "seen_about"]

SCATTERS = np.geomspace(1e-3, 1.0, 25)  # of a surface about its model, relative


def likelier(pixels: Cutout, *fits: DiskFit) -> DiskFit:
    """Return the fit that explains the pixels of all of them best.

    Each is asked for all of their strips, with the scatter that suits it best.
    """
    strips = np.zeros(pixels.use.shape, dtype=bool)
    for fit in fits:
        strips[fit.pixels.index] = True
    return min(fits, key=lambda fit: _cost(pixels, fit, strips & pixels.use))


def _cost(pixels: Cutout, fit: DiskFit, wanted: BoolArray) -> float:
    """Return minus twice the logarithm of a likelihood of pixels, but for a constant of theirs."""
    line, pixel = here = np.nonzero(wanted)
    there = seen_about(fit, (line, pixel), fit.made.outline(fit.shape))
    model, light = there.model_dn(), fit.brightness_dn * there.columns[RELIEF]
    noise = pixels.variance_dn2(model, here)
    return surprise((pixels.data_dn[here] - model) ** 2 / noise, light**2 / noise, SCATTERS)


def seen_about(fit: DiskFit, index: tuple[IntArray, IntArray], outline: Outline) -> DiskFit:
    """Return a fit with its light at other pixels (line, pixel), about an outline of its shape."""
    line, pixel = index
    near = limb_places(outline, pixel.astype(np.float64), line.astype(np.float64))
    columns = disk_columns(fit.made, fit.shape, outline, near, on_slopes=fit.prior.on_slopes)
    return replace(fit, pixels=near, columns=columns)
