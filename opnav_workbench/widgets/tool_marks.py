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
    return segments, label_columns([label[:2] for label in labels], [label[2] for label in labels])


def label_columns(
    places: Iterable[Any], texts: Sequence[str], y_offset: Sequence[float] | None = None
) -> Columns:
    """Return the columns of texts at places (pixel, line), moved down by screen px."""
    array = np.array(list(places), dtype=float).reshape(-1, 2)
    moved = np.zeros(len(array)) if y_offset is None else np.asarray(y_offset, float)
    return {"pixel": array[:, 0], "line": array[:, 1], "text": list(texts), "y_offset": moved}


def ring_columns(place_px: ArrayLike | None, radius_px: float) -> Columns:
    """Return the columns of one ring, or of none."""
    if place_px is None:
        return {"pixel": [], "line": [], "radius": []}
    pixel, line = np.asarray(place_px, float)
    return {"pixel": [float(pixel)], "line": [float(line)], "radius": [float(radius_px)]}
