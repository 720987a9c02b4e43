"""What the workbench's tools draw over the picture, as columns for `PictureModels.fill`."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.widgets.overlays import Columns
from opnav_workbench.widgets.themes import Theme
from opnav_workbench.widgets.workbench_viewer import Layer

__all__ = ["label_columns", "layer_columns", "ring_columns"]

FOCUS_WIDTH, WIDTH = 3.0, 1.5  # screen px
RIGHT_EDGE, TOP_EDGE = 0.91, 0.03  # shares of the picture beyond which it would cut a text
BELOW = 16.0  # screen px


def layer_columns(layers: Iterable[Layer], theme: Theme) -> tuple[Columns, Columns]:
    """Return the columns of all layers' segments, and of their labels."""
    shown = list(layers)
    ends = np.array([s for layer in shown for s in layer.segments], dtype=float).reshape(-1, 4)
    styles = [style for layer in shown for style in layer.styles]
    looks = [theme[f"tool_{style}"] for style in styles]
    segments: Columns = {name: ends[:, i] for i, name in enumerate(("x0", "y0", "x1", "y1"))}
    segments["color"] = [look.color for look in looks]
    segments["dash"] = [look.dash for look in looks]
    segments["width"] = [FOCUS_WIDTH if style == "focus" else WIDTH for style in styles]
    labels = [label for layer in shown for label in layer.labels]
    return segments, label_columns(
        [label[:2] for label in labels], [label[2] for label in labels], (4.0, -4.0)
    )


def label_columns(
    places: Iterable[Any],
    texts: Sequence[str],
    offset: tuple[float, float | Sequence[float]],
    size: Sequence[int] = (),
) -> Columns:
    """Return the columns of texts beside places (pixel, line).

    Parameters
    ----------
    places : (pixel, line) of each
    texts : sequence of str
    offset : (right, down)
        Screen px; down may be one for each text.
    size : (n_pixel, n_line)
        Of the picture: a text near its right edge stands left of its place, one near the top below it.

    Examples
    --------
    >>> columns = label_columns([(10.0, 50.0), (99.0, 2.0)], ["a", "b"], (9.0, -5.0), (100, 100))
    >>> columns["side"], columns["x_offset"].tolist(), columns["y_offset"].tolist()
    (['left', 'right'], [9.0, -9.0], [-5.0, 16.0])
    """
    array = np.array(list(places), dtype=float).reshape(-1, 2)
    right, down = (
        np.full(len(array), offset[0]),
        np.broadcast_to(np.asarray(offset[1], float), len(array)).copy(),
    )
    turned = np.zeros(len(array), bool)
    if len(size):
        turned = array[:, 0] > RIGHT_EDGE * size[0]
        down[array[:, 1] < TOP_EDGE * size[1]] = BELOW
    return {
        "pixel": array[:, 0],
        "line": array[:, 1],
        "text": list(texts),
        "x_offset": np.where(turned, -right, right),
        "y_offset": down,
        "side": ["right" if one else "left" for one in turned],
    }


def ring_columns(place_px: ArrayLike | None, radius_px: float) -> Columns:
    """Return the columns of one ring, or of none."""
    if place_px is None:
        return {"pixel": [], "line": [], "radius": []}
    pixel, line = np.asarray(place_px, float)
    return {"pixel": [float(pixel)], "line": [float(line)], "radius": [float(radius_px)]}
