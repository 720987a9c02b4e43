"""What a view shows and how, in one bokeh model: both the page and Python may change it, and it survives a reload."""

from typing import Any

from bokeh.core.properties import Bool, Float, List, String
from bokeh.model import DataModel

from opnav_workbench.widgets.stretch import COLORMAPS, LIMITS, STRETCHES
from opnav_workbench.widgets.themes import GROUPS, THEMES
from opnav_workbench.widgets.view_actions import VIEW_ACTIONS

__all__ = ["ViewState", "page_setup"]


class ViewState(DataModel):
    """State of an `ImageView`; what has structure is JSON text."""

    image = String("data", help="Key of the picture that is shown.")
    partner = String("", help="Key of the picture that it blinks against; empty: none.")
    stretch = String("asinh")
    limits = String("sky", help="One of stretch.LIMITS.")
    low = Float(0.0, help="Limits where `limits` is manual, DN.")
    high = Float(1.0)
    colormap = String("gray")
    inverted = Bool(False)
    contrast = Float(1.0)
    bias = Float(0.5)
    groups = List(String, help="Overlays that are shown.")
    vector_scale = Float(1.0, help="Residual vectors are drawn so many times as long.")
    theme = String("standard", help="One of themes.THEMES.")
    drag = String(
        "", help="What a left drag does: empty: pan; else the shape that it draws: box, circle or line."
    )
    body = String("", help="The body that the readout measures from.")
    setup = String("{}", help="Size, colour maps, legend: what the page must know once a picture.")
    images = String("{}", help="Label and limits of each picture, by key.")
    camera = String("null", help="SkyReadout.as_page_values().")
    bodies = String("[]", help="Name, place and radius of each body.")


def page_setup() -> dict[str, Any]:
    """Return what the page must know of menus, colour maps, marks and actions; plain values."""
    looks = {
        theme: {kind: [look.color, look.shape, look.dash] for kind, look in marks.items()}
        for theme, marks in THEMES.items()
    }
    return {
        "stretches": list(STRETCHES),
        "limits": list(LIMITS),
        "themes": list(THEMES),
        "colormaps": {name: "".join(c.lstrip("#") for c in colors) for name, colors in COLORMAPS.items()},
        "groups": {name: list(kinds) for name, kinds in GROUPS.items()},
        "looks": looks,
        "actions": {action.name: [action.label, action.hint] for action in VIEW_ACTIONS},
    }
