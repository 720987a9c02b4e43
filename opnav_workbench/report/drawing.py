"""What all figures share: the colours of what is marked in a picture, round scales, and PNG files.

Predicted places are yellow, observed ones blue, what was not used vermilion, bodies purple; pixel components are
blue, line components vermilion. The palette is that of Okabe & Ito, which colour-blind readers can tell apart;
every mark has a shape of its own as well. Figures are written with one resolution, and a file is whole or not
there.
"""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from opnav_workbench.files import atomic_path

__all__ = ["STRIP_ASPECT", "png_bytes", "round_scale", "write_png"]


# ---- Figures as PNG: one resolution for all, and files that are whole or not there.

DPI = 110


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, dpi=DPI, format="png")
    return stream.getvalue()


def write_png(figure: Figure, path: str | Path) -> None:
    """Write a figure as a PNG, whole or not at all."""
    picture = png_bytes(figure)
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture)


# ---- Round enlargement factors, for residual vectors that a person reads off.


def round_scale(scale: float) -> float:
    """Return the largest of 1, 2, 5 x 10^k that is not above `scale`.

    Examples
    --------
    >>> round_scale(734.0), round_scale(0.3)
    (500.0, 0.2)
    """
    power = 10.0 ** np.floor(np.log10(scale))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= scale * (1.0 + 1e-9)))


# ---- Layout of the summary figure for square frames and for long strips.

# A frame wider than this many times its height is shown as strips, one under the other.
STRIP_ASPECT = 4.0


# ---- One figure a picture: stretched frame with predicted and observed places, residual vectors, residual ...

PREDICTED_COLOR, OBSERVED_COLOR, REJECTED_COLOR, BODY_COLOR = "#F0E442", "#56B4E9", "#D55E00", "#CC79A7"
PIXEL_COLOR, LINE_COLOR = "#0072B2", "#D55E00"
