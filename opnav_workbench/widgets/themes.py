"""How marks look: for each kind a colour, a shape and a dash, so that colour is never the only sign."""

from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["DEFAULT_THEME", "GROUPS", "THEMES", "Look", "Theme"]


@dataclass(frozen=True, slots=True)
class Look:
    """One kind of mark.

    Attributes
    ----------
    color : str
    shape : str
        A bokeh marker, or what static/image_view.js draws in the legend: ``line``, ``arrow``, ``hatch``, ``dots``.
    dash : str
        ``solid``, ``dashed``, ``dotted`` or ``dotdash``.
    """

    color: str
    shape: str
    dash: str = "solid"


Theme = MappingProxyType[str, Look]

# Colours of Okabe & Ito, which colour-blind readers can tell apart; the same as in the report's figure.
_STANDARD: dict[str, Look] = {
    "predicted": Look("#F0E442", "circle"),
    "used": Look("#56B4E9", "x"),
    "rejected": Look("#D55E00", "square_x"),
    "missing": Look("#CC79A7", "inverted_triangle"),
    "residual": Look("#009E73", "arrow"),
    "body": Look("#CC79A7", "line"),
    "body_predicted": Look("#F0E442", "line", "dashed"),
    "terminator": Look("#E69F00", "line", "dotdash"),
    "pole": Look("#56B4E9", "line", "dotted"),
    "bad": Look("#56B4E9", "hatch"),
    "saturated": Look("#E69F00", "dots"),
    "grid": Look("#8FA3B5", "line", "dotted"),
    "circle": Look("#E69F00", "line", "dashed"),
    "focus": Look("#FFFFFF", "circle"),
    "tool_used": Look("#56B4E9", "line"),
    "tool_unused": Look("#9AA5B1", "line", "dotted"),
    "tool_rejected": Look("#D55E00", "line", "dashed"),
    "tool_focus": Look("#F0E442", "line"),
}
# Those who come from CAVIAR know predicted stars as yellow, detected ones as red and missing ones as blue.
_CAVIAR = _STANDARD | {
    "predicted": Look("#FFFF00", "circle"),
    "used": Look("#FF3030", "x"),
    "rejected": Look("#FF9DF0", "square_x"),
    "missing": Look("#4D8CFF", "inverted_triangle"),
}

THEMES: MappingProxyType[str, Theme] = MappingProxyType(
    {"standard": MappingProxyType(_STANDARD), "CAVIAR": MappingProxyType(_CAVIAR)}
)
DEFAULT_THEME = "standard"

# Overlays that can be switched on and off, with what each shows (kinds of the themes).
GROUPS: dict[str, tuple[str, ...]] = {
    "predicted": ("predicted", "missing"),
    "observed": ("used", "rejected"),
    "magnitudes": (),
    "residuals": ("residual",),
    "bodies": ("body", "body_predicted", "terminator", "pole"),
    "masks": ("bad", "saturated"),
    "grid": ("grid",),
}
