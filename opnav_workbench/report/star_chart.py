"""A chart of catalog stars: the tangent plane about a direction, north up and east to the left, as on the sky."""

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import StarTable
from opnav_workbench.catalog.proper_motion import sky_offset_rad
from opnav_workbench.geometry import unit_from_radec
from opnav_workbench.report.drawing import BLUE, ORANGE, VERMILION, new_figure, write_png

__all__ = ["write_star_chart"]

STAR, NO_MOTION, FLAGGED = BLUE, ORANGE, VERMILION
LARGEST_AREA, SMALLEST_AREA = 90.0, 2.0  # of the dots, pt^2
MAG_STEP = 0.7  # the area of a dot falls by this factor per magnitude
NAMED = 12  # the brightest stars get their names
MAX_RADIUS_RAD = math.radians(60.0)  # the tangent plane beyond tells nothing


def write_star_chart(
    path: str | Path, stars: StarTable, ra_rad: float, dec_rad: float, radius_rad: float, et_s: float | None
) -> None:
    """Write the chart of `star_chart` as a PNG, whole or not at all."""
    write_png(star_chart(stars, ra_rad, dec_rad, radius_rad, et_s), path)


def star_chart(
    stars: StarTable, ra_rad: float, dec_rad: float, radius_rad: float, et_s: float | None = None
) -> Figure:
    """Draw the stars of a cone.

    Parameters
    ----------
    stars
        Brightest first.
    ra_rad, dec_rad, radius_rad
        The cone, J2000.
    et_s
        Epoch of the places, TDB seconds past J2000; none: the catalog's own.

    Returns
    -------
    matplotlib.figure.Figure
        Dots by magnitude; orange without a known motion, vermilion with a flag against the star.
    """
    half = math.degrees(math.tan(min(radius_rad, MAX_RADIUS_RAD)))
    places = unit_from_radec(stars.ra_rad, stars.dec_rad) if et_s is None else stars.directions(et_s)
    n = len(stars)
    offset = np.degrees(sky_offset_rad(np.full(n, ra_rad), np.full(n, dec_rad), places))
    figure = new_figure(6.4, 6.6)
    axes = figure.add_subplot(
        aspect="equal", xlim=(1.04 * half, -1.04 * half), ylim=(-1.04 * half, 1.04 * half)
    )
    colors = np.where(stars.motion_known, STAR, NO_MOTION)
    colors = np.where(stars.flags != 0, FLAGGED, colors)
    axes.scatter(offset[:, 0], offset[:, 1], s=_areas(stars.mag), c=colors.tolist(), linewidths=0.0)
    axes.add_patch(Circle((0.0, 0.0), half, fill=False, color="0.6", linewidth=0.8))
    for name, place in zip(stars.id[:NAMED], offset[:NAMED], strict=False):
        axes.annotate(str(name), place, xytext=(4, 4), textcoords="offset points", fontsize=7, color="0.25")
    axes.set_xlabel("degrees east")
    axes.set_ylabel("degrees north")
    axes.set_title(_title(stars, ra_rad, dec_rad), fontsize=9, loc="left")
    return figure


def _areas(mag: FloatArray) -> FloatArray:
    brightest = float(np.min(mag)) if mag.size else 0.0
    return np.asarray(np.maximum(LARGEST_AREA * MAG_STEP ** (mag - brightest), SMALLEST_AREA))


def _title(stars: StarTable, ra_rad: float, dec_rad: float) -> str:
    where = f"RA {math.degrees(ra_rad):.4f}°, Dec {math.degrees(dec_rad):+.4f}°"
    if len(stars) == 0:
        return f"{where}\nno stars"
    span = f"magnitude {stars.mag.min():.1f} to {stars.mag.max():.1f}"
    return f"{where}\n{len(stars)} stars, {span}; orange: motion unknown, red: flagged"
