"""The bokeh models that Python and the page share: picture, magnifier, panner, the glyphs of every overlay, the state.

State    what is shown and how; both sides may change it, and it survives a reload
Themes   for each kind of mark a colour, a shape and a dash, so that colour is never the only sign (Okabe & Ito; or as
         CAVIAR's users know them)
Tools    lines, labels and rings of the tabs' tools, as columns for the figure
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from bokeh.core.properties import Bool, Float, List, String
from bokeh.model import DataModel
from bokeh.models import ColumnDataSource, ImageRGBA, PanTool, Range1d, RangeTool, WheelZoomTool
from bokeh.models.annotations import Arrow, BoxAnnotation, VeeHead
from bokeh.plotting import figure
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.workbench.actions import VIEW_ACTIONS
from opnav_workbench.workbench.overlays import BodyMarks, Columns
from opnav_workbench.workbench.stretch import COLORMAPS, LIMITS, STRETCHES
from opnav_workbench.workbench.viewer import Layer

__all__ = [
    "DEFAULT_THEME",
    "THEMES",
    "PictureModels",
    "ViewState",
    "label_columns",
    "layer_columns",
    "lines_columns",
    "page_setup",
    "ring_columns",
]


# ---- How marks look: for each kind a colour, a shape and a dash, so that colour is never the only sign.


@dataclass(frozen=True, slots=True)
class MarkStyle:
    """One kind of mark.

    Attributes
    ----------
    shape
        A bokeh marker, or what static/image_view.js draws in the legend: ``line``, ``arrow``, ``hatch``, ``dots``.
    dash
        ``solid``, ``dashed``, ``dotted`` or ``dotdash``.
    """

    color: str
    shape: str
    dash: str = "solid"


Theme = MappingProxyType[str, MarkStyle]

# Colours of Okabe & Ito, which colour-blind readers can tell apart; the same as in the report's figure.
_STANDARD: dict[str, MarkStyle] = {
    "predicted": MarkStyle("#F0E442", "circle"),
    "used": MarkStyle("#56B4E9", "x"),
    "rejected": MarkStyle("#D55E00", "square_x"),
    "missing": MarkStyle("#CC79A7", "inverted_triangle"),
    "residual": MarkStyle("#009E73", "arrow"),
    "body": MarkStyle("#CC79A7", "line"),
    "body_predicted": MarkStyle("#F0E442", "line", "dashed"),
    "body_point": MarkStyle("#CC79A7", "diamond"),
    "terminator": MarkStyle("#E69F00", "line", "dotdash"),
    "pole": MarkStyle("#56B4E9", "line", "dotted"),
    "bad": MarkStyle("#56B4E9", "hatch"),
    "saturated": MarkStyle("#E69F00", "dots"),
    "grid": MarkStyle("#8FA3B5", "line", "dotted"),
    "compass": MarkStyle("#E69F00", "arrow"),
    "circle": MarkStyle("#E69F00", "line", "dashed"),
    "focus": MarkStyle("#FFFFFF", "circle"),
    "tool_used": MarkStyle("#56B4E9", "line"),
    "tool_unused": MarkStyle("#9AA5B1", "line", "dotted"),
    "tool_rejected": MarkStyle("#D55E00", "line", "dashed"),
    "tool_focus": MarkStyle("#F0E442", "line"),
}
# Those who come from CAVIAR know predicted stars as yellow, detected ones as red and missing ones as blue.
_CAVIAR = _STANDARD | {
    "predicted": MarkStyle("#FFFF00", "circle"),
    "used": MarkStyle("#FF3030", "x"),
    "rejected": MarkStyle("#FF9DF0", "square_x"),
    "missing": MarkStyle("#4D8CFF", "inverted_triangle"),
}

THEMES: MappingProxyType[str, Theme] = MappingProxyType(
    {"standard": MappingProxyType(_STANDARD), "CAVIAR": MappingProxyType(_CAVIAR)}
)
DEFAULT_THEME = "standard"

# Overlays that can be switched on and off, with what each shows (kinds of the themes).
OVERLAY_GROUPS: dict[str, tuple[str, ...]] = {
    "predicted": ("predicted", "missing"),
    "observed": ("used", "rejected"),
    "magnitudes": (),
    "residuals": ("residual",),
    "bodies": ("body", "body_predicted", "terminator", "pole"),
    "masks": ("bad", "saturated"),
    "grid": ("grid",),
    "compass": ("compass",),
}


# ---- What a view shows and how, in one bokeh model: both the page and Python may change it, and it survives a reload.


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
    title = String("", help="Name of the picture.")
    message = String("", help="Shown instead of a picture; the controls are away then.")
    images = String("{}", help="Label, limits and pixels' tokens of each picture, by key.")
    ahead = String("[]", help="Pixels' tokens of pictures that may be shown next.")
    camera = String("null", help="SkyReadout.as_page_values().")
    bodies = String("[]", help="Name, place and radius of each body.")
    compass = String("[]", help="Name and direction (pixel, line) of each arrow of the compass.")
    aperture = String("null", help="Aperture.as_page_values(), or a message.")
    compare = String("", help="How the partner is shown: beside, wipe; empty: not.")
    lock = String("sky", help="How another image is laid over this one: by sky or by pixel.")


def page_setup() -> dict[str, Any]:
    """Return what the page must know of menus, colour maps, marks and actions; plain values."""
    styles = {
        theme: {kind: [style.color, style.shape, style.dash] for kind, style in marks.items()}
        for theme, marks in THEMES.items()
    }
    return {
        "stretches": list(STRETCHES),
        "limits": list(LIMITS),
        "themes": list(THEMES),
        "colormaps": {name: "".join(c.lstrip("#") for c in colors) for name, colors in COLORMAPS.items()},
        "groups": {name: list(kinds) for name, kinds in OVERLAY_GROUPS.items()},
        "styles": styles,
        "actions": {action.name: [action.label, action.hint] for action in VIEW_ACTIONS},
    }


# ---- What the workbench's tools draw over the picture, as columns for `PictureModels.fill`.

FOCUS_WIDTH, LINE_WIDTH = 3.0, 1.5  # screen px
RIGHT_EDGE, TOP_EDGE = 0.91, 0.03  # shares of the picture beyond which it would cut a text
LABEL_BELOW_PX = 16.0  # screen px
# Screen px to the left lower corner of a body's name, from its limb below and above, or from the mark of a point; and to
# that of a pole's letter, whose middle is at the pole then.
BELOW_PX, ABOVE_PX, BESIDE_PX, POLE_PX = (-8.0, 18.0), (-8.0, -5.0), (12.0, 5.0), (-4.0, 5.0)
# Of tools' texts: beside their place, or with their middle at its height.
ABOVE_RIGHT_PX, MIDDLE_PX = 4.0, 4.0


def layer_columns(layers: Iterable[Layer], theme: Theme) -> tuple[Columns, Columns]:
    """Return the columns of all layers' segments, and of their labels."""
    shown = list(layers)
    ends = np.array([s for layer in shown for s in layer.segments], dtype=float).reshape(-1, 4)
    styles = [style for layer in shown for style in layer.styles]
    marks = [theme[f"tool_{style}"] for style in styles]
    segments: Columns = {name: ends[:, i] for i, name in enumerate(("x0", "y0", "x1", "y1"))}
    segments["color"] = [mark.color for mark in marks]
    segments["dash"] = [mark.dash for mark in marks]
    segments["width"] = [FOCUS_WIDTH if style == "focus" else LINE_WIDTH for style in styles]
    labels = [label for layer in shown for label in layer.labels]
    sides = [side for layer in shown for side in layer.sides or [""] * len(layer.labels)]
    right = [0.0 if side else ABOVE_RIGHT_PX for side in sides]
    down = [MIDDLE_PX if side else -ABOVE_RIGHT_PX for side in sides]
    texts = label_columns([label[:2] for label in labels], [label[2] for label in labels], (right, down))
    return segments, texts | {"side": [side or "left" for side in sides]}


def label_columns(
    places: Iterable[Any],
    texts: Sequence[str],
    offset: tuple[float | Sequence[float], float | Sequence[float]],
    size: Sequence[int] = (),
) -> Columns:
    """Return the columns of texts beside places (pixel, line).

    Parameters
    ----------
    places : (pixel, line) of each
    offset : (right, down)
        Screen px; each may be one for each text.
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
        np.broadcast_to(np.asarray(offset[0], float), len(array)),
        np.broadcast_to(np.asarray(offset[1], float), len(array)).copy(),
    )
    turned = np.zeros(len(array), bool)
    if len(size):
        turned = array[:, 0] > RIGHT_EDGE * size[0]
        down[array[:, 1] < TOP_EDGE * size[1]] = LABEL_BELOW_PX
    return {
        "pixel": array[:, 0],
        "line": array[:, 1],
        "text": list(texts),
        "x_offset": np.where(turned, -right, right),
        "y_offset": down,
        "side": ["right" if one else "left" for one in turned],
    }


def body_label_columns(marks: Sequence[BodyMarks], shape: tuple[int, ...]) -> Columns:
    """Return the columns of bodies' names and of their poles' letters, of a picture (n_line, n_pixel).

    A letter stands at the end of its pole, the name beyond the limb on the other side: of no size do they lie on each other.
    """
    poles = [mark.pole_px[-1] for mark in marks if len(mark.pole_px)]
    up = [len(mark.pole_px) > 0 and mark.pole_px[-1][1] < mark.center_px[1] for mark in marks]
    sides = np.where(up, 1.0, -1.0) * [mark.radius_px for mark in marks]
    limbs = np.reshape([mark.center_px for mark in marks], (-1, 2)) + np.stack([0.0 * sides, sides], axis=1)
    last = np.array(shape[::-1]) - 1.0
    offsets = [BELOW_PX if one else ABOVE_PX for one in up]
    offsets = [o if len(m.predicted_limb_px) else BESIDE_PX for o, m in zip(offsets, marks, strict=True)]
    right, down = np.reshape([*offsets, *[POLE_PX] * len(poles)], (-1, 2)).T.tolist()
    names = [mark.name for mark in marks] + ["N"] * len(poles)
    return label_columns([*np.clip(limbs, 0.0, last), *poles], names, (right, down), shape[::-1])


def ring_columns(place_px: ArrayLike | None, radius_px: float) -> Columns:
    """Return the columns of one ring, or of none."""
    if place_px is None:
        return {"pixel": [], "line": [], "radius": []}
    pixel, line = np.asarray(place_px, float)
    return {"pixel": [float(pixel)], "line": [float(line)], "radius": [float(radius_px)]}


# ---- The bokeh models of a view: picture, magnifier and panner, and the glyphs of every overlay.

STAR_SIZES = {"predicted": 15, "used": 10, "rejected": 11, "missing": 13}  # screen px
BODY_POINT_SIZE = 20  # screen px, of a body too small for its limb to be drawn
MARK_PX, HALO_PX = 1.6, 2.0  # screen px: lines of marks, and what their dark edge has more
HALO: dict[str, Any] = {"line_color": "#000000", "line_alpha": 0.55}
LABEL_BACKGROUND = "#101418"  # under labels, so that they stay readable over bright bodies
NO_PICTURE = np.zeros((1, 1), np.uint32)


# What the analyst and the page move: on a canvas of its own, so that thousands of marks below are not drawn anew with it.
OVER: Final = "overlay"
STARS = ["stars"]  # tag of what the page draws by itself where many are in sight (static/crowd.js)


def _source(*columns: str) -> Any:
    return ColumnDataSource({name: [] for name in columns})


class PictureModels:
    """All models of one view; the page fills the picture itself in (static/image_view.js)."""

    def __init__(self) -> None:
        self.x_range: Any = Range1d(start=-0.5, end=0.5)
        self.y_range: Any = Range1d(start=0.5, end=-0.5)
        self.picture = _figure("opnav-picture", self.x_range, self.y_range)
        self.picture.add_tools(PanTool(), wheel := WheelZoomTool())
        self.picture.toolbar.active_scroll = wheel
        self.magnifier = _figure("opnav-magnifier", Range1d(start=0, end=1), Range1d(start=1, end=0))
        self.second = _figure("opnav-second", self.x_range, self.y_range)
        self.second.add_tools(PanTool(), second_wheel := WheelZoomTool())
        self.second.toolbar.active_scroll = second_wheel
        self.second.visible = False
        self.panner = _figure("opnav-panner", Range1d(start=0, end=1), Range1d(start=1, end=0))
        box = BoxAnnotation(
            fill_color="#E69F00",
            fill_alpha=0.08,
            line_color="#E69F00",
            line_width=2,
            line_dash="solid",
            tags=["own-colors"],
        )
        self.panner.add_tools(RangeTool(x_range=self.x_range, y_range=self.y_range, overlay=box))
        for plot in (self.magnifier, self.panner, self.second):
            plot.axis.visible = False
        shown = {
            "shown": self.picture,
            "second-shown": self.second,
            "magnified": self.magnifier,
            "overview": self.panner,
        }
        for name, plot in shown.items():
            _add_image(plot, _image_source(f"opnav-{name}"))
        self.sources: dict[str, Any] = {}
        self._glyphs: dict[str, list[Any]] = {}  # by kind, for the theme
        # Renderers of a dark edge below each, so that no mark is lost on a bright ground.
        self._halos: dict[str, list[Any]] = {}
        cursor = ColumnDataSource({"pixel": [0.0], "line": [0.0]}, name="opnav-cursor")
        self.magnifier.rect(
            "pixel", "line", 1, 1, source=cursor, fill_color=None, line_color="#E69F00", line_width=1.5
        )
        self._add_masks()
        self._add_lines()
        self._add_stars()
        self._add_tools()
        self._add_inspection()

    @property
    def roots(self) -> tuple[Any, ...]:
        """What is shown."""
        return self.picture, self.second, self.magnifier, self.panner

    def fill(self, name: str, columns: Columns) -> None:
        """Replace a source's columns, if they differ."""
        source = self.sources[name]
        old = source.data
        if old.keys() != columns.keys() or not all(_same(old[key], columns[key]) for key in columns):
            source.data = columns

    def use_theme(self, name: str) -> None:
        """Give every mark the style that a theme has for it."""
        for kind, halos in self._halos.items():
            for glyph in (halo.glyph for halo in halos):
                glyph.line_dash = THEMES[name][kind].dash
                if hasattr(glyph, "marker"):
                    glyph.marker = THEMES[name][kind].shape
        for kind, glyphs in self._glyphs.items():
            style = THEMES[name][kind]
            for glyph in glyphs:
                glyph.line_color, glyph.line_dash = style.color, style.dash
                if kind == "residual":
                    glyph.end.fill_color = style.color
                if hasattr(glyph, "marker"):
                    glyph.marker = style.shape
                if hasattr(glyph, "hatch_color"):
                    glyph.hatch_color = style.color

    # -- overlays ----------------------------------------------------------------------------------------------

    def _add_masks(self) -> None:
        for kind, pattern in (("bad", "right_diagonal_line"), ("saturated", "dot")):
            source = self.sources[kind] = _source("left", "right", "top", "bottom")
            source.name = f"opnav-{kind}"  # the readout tells what masks the pixel
            renderer = self.picture.quad(
                left="left", right="right", top="top", bottom="bottom", source=source, name="overlay:masks",
                fill_color=None, hatch_pattern=pattern, hatch_scale=6, line_width=1,
            )  # fmt: skip
            self._glyphs[kind] = [renderer.glyph]

    def _add_lines(self) -> None:
        for kind, group, width in (
            ("grid", "grid", 1),
            ("body_predicted", "bodies", 1.5),
            ("body", "bodies", 1.5),
            ("terminator", "bodies", 1.5),
            ("pole", "bodies", 1.5),
        ):
            source = self.sources[kind] = _source("pixel", "line")
            both = [
                [
                    plot.multi_line("pixel", "line", source=source, name=f"overlay:{group}", **look)
                    for plot in self._plots(group)
                ]
                for look in ({**HALO, "line_width": width + HALO_PX}, {"line_width": width})
            ]
            self._keep_marks(kind, *both)
        self._add_points("body_point", "bodies", BODY_POINT_SIZE)

    def _plots(self, group: str) -> tuple[Any, ...]:
        return (self.picture,) if group == "grid" else (self.picture, self.magnifier, self.second)

    def _add_stars(self) -> None:
        # The page draws them as long as the analyst wants them, without asking.
        vectors = self.sources["vectors"] = _source("pixel", "line", "d_pixel", "d_line")
        arrows = _source("pixel", "line", "end_pixel", "end_line")
        vectors.name, arrows.name = "opnav-vectors", "opnav-arrows"
        self.picture.scatter("pixel", "line", source=vectors, size=0, visible=False)
        head = VeeHead(size=7, fill_color=THEMES[DEFAULT_THEME]["residual"].color, line_color=None)
        arrow: Any = Arrow(
            x_start="pixel", y_start="line", x_end="end_pixel", y_end="end_line", source=arrows, end=head,
            name="overlay:residuals", tags=["own-colors", *STARS],
        )  # fmt: skip
        arrow.line_width = 1.5
        self.picture.add_layout(arrow)
        self._glyphs["residual"] = [arrow]
        marks = _image_source("opnav-marks")
        for plot in (self.picture, self.second):
            _add_image(plot, marks)
        for kind, size in STAR_SIZES.items():
            group = next(name for name, kinds in OVERLAY_GROUPS.items() if kind in kinds)
            for renderer in self._add_points(kind, group, size):
                renderer.tags = STARS
        # All labels above all marks: among thousands of stars they could not be read.
        self._add_text("grid_labels", "grid", "grid")
        self._add_text("body_labels", "bodies", "body")
        self._add_text("star_labels", "magnitudes", "predicted")
        facts = self.sources["facts"] = _source(
            "pixel", "line", "id", "mag", "snr", "d_pixel", "d_line"
        )  # read by the page, drawn by nothing
        facts.name = "opnav-facts"
        self.picture.scatter("pixel", "line", source=facts, size=0, visible=False)

    def _add_points(self, kind: str, group: str, size: int) -> list[Any]:
        """Add marks and their dark edges; return those in large pictures."""
        source = self.sources[kind] = _source("pixel", "line")
        both = [
            [
                plot.scatter(
                    "pixel", "line", source=source, name=f"overlay:{group}", size=size,
                    fill_color=None, marker=THEMES[DEFAULT_THEME][kind].shape, **look,
                )
                for plot in (self.picture, self.magnifier, self.second)
            ]
            for look in ({**HALO, "line_width": MARK_PX + HALO_PX}, {"line_width": MARK_PX})
        ]  # fmt: skip
        self._keep_marks(kind, *both)
        return [one for look in both for one in (look[0], look[2])]

    def _keep_marks(self, kind: str, halos: list[Any], marks: list[Any]) -> None:
        self._halos[kind], self._glyphs[kind] = halos, [mark.glyph for mark in marks]

    def _add_text(self, name: str, group: str, kind: str) -> None:
        source = self.sources[name] = _source("pixel", "line", "text", "x_offset", "y_offset", "side")
        self.picture.text(
            "pixel", "line", "text", source=source, name=f"overlay:{group}", text_font_size="11px",
            text_color=THEMES[DEFAULT_THEME][kind].color, background_fill_color=LABEL_BACKGROUND,
            background_fill_alpha=0.9, padding=1, x_offset="x_offset", y_offset="y_offset", text_align="side",
        )  # fmt: skip

    def _add_tools(self) -> None:
        segments = self.sources["segments"] = _source("x0", "y0", "x1", "y1", "color", "dash", "width")
        self.picture.segment(
            "x0", "y0", "x1", "y1", source=segments, line_color="color", line_dash="dash", line_width="width",
            level=OVER,
        )  # fmt: skip
        self._add_text("tool_labels", "tools", "focus")
        for kind in ("circle", "focus"):
            source = self.sources[kind] = _source("pixel", "line", "radius")
            source.name = f"opnav-{kind}"
            self.picture.circle(
                "pixel",
                "line",
                radius="radius",
                source=source,
                fill_color=None,
                level=OVER,
                **HALO,
                line_width=2 + HALO_PX,
            )
            ring = self.picture.circle(
                "pixel", "line", radius="radius", source=source, fill_color=None, line_width=2, level=OVER
            )
            cross = self.picture.scatter(
                "pixel", "line", source=source, marker="cross", size=9 if kind == "circle" else 0, level=OVER
            )
            self._glyphs[kind] = [ring.glyph]
            cross.glyph.line_color = THEMES[DEFAULT_THEME][kind].color

    def _add_inspection(self) -> None:
        """What the page draws by itself: the tools' shapes, and the compass in the corner."""
        lines, ring = _source("x0", "y0", "x1", "y1"), _source("pixel", "line", "radius")
        ends = _source("pixel", "line")
        color = THEMES[DEFAULT_THEME]["compass"].color
        for look in (
            {**HALO, "line_width": MARK_PX + HALO_PX},
            {"line_color": color, "line_width": MARK_PX},
        ):
            self.picture.segment("x0", "y0", "x1", "y1", source=lines, level=OVER, **look)
            self.picture.circle(
                "pixel", "line", radius="radius", source=ring, fill_color=None, level=OVER, **look
            )
            for source, marker, size in ((ends, "square", 7), (ring, "cross", 9)):
                self.picture.scatter(
                    "pixel",
                    "line",
                    source=source,
                    marker=marker,
                    size=size,
                    fill_color=None,
                    level=OVER,
                    **look,
                )
        lines.name, ends.name, ring.name = "opnav-inspect", "opnav-inspect-ends", "opnav-inspect-ring"
        self._add_compass(color)

    def _add_compass(self, color: str) -> None:
        arrows = _source("pixel", "line", "end_pixel", "end_line")
        names = _source("pixel", "line", "text")
        arrows.name, names.name = "opnav-compass", "opnav-compass-names"
        self.picture.segment(
            "pixel", "line", "end_pixel", "end_line", source=arrows, name="overlay:compass",
            level=OVER, **{**HALO, "line_width": MARK_PX + HALO_PX},
        )  # fmt: skip
        arrow: Any = Arrow(
            x_start="pixel", y_start="line", x_end="end_pixel", y_end="end_line", source=arrows,
            end=VeeHead(size=8, fill_color=color, line_color=None), name="overlay:compass", tags=["own-colors"],
            level=OVER,
        )  # fmt: skip
        arrow.line_color, arrow.line_width = color, MARK_PX
        self.picture.add_layout(arrow)
        self.picture.text(
            "pixel", "line", "text", source=names, name="overlay:compass", text_font_size="11px",
            text_color=color, text_align="center", text_baseline="middle",
            background_fill_color=LABEL_BACKGROUND, background_fill_alpha=0.85, padding=1, level=OVER,
        )  # fmt: skip


def _figure(name: str, x_range: Any, y_range: Any) -> Any:
    plot = figure(
        name=name, x_range=x_range, y_range=y_range, frame_width=400, frame_height=400, tools="",
        toolbar_location=None, min_border=2, outline_line_width=1, lod_threshold=None,
    )  # fmt: skip
    plot.grid.visible = False
    plot.axis.major_label_text_font_size = "10px"
    plot.axis.minor_tick_line_color = None
    plot.axis.major_tick_in = 0
    return plot


def _image_source(name: str) -> Any:
    return ColumnDataSource(
        {"image": [NO_PICTURE], "x": [0.0], "y": [0.0], "dw": [1.0], "dh": [1.0]}, name=name
    )


def _add_image(plot: Any, source: Any) -> None:
    plot.add_glyph(source, ImageRGBA(image="image", x="x", y="y", dw="dw", dh="dh"))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, list) and isinstance(b, list):
        if not any(isinstance(one, np.ndarray) for one in (*a[:1], *b[:1])):
            return a == b  # thousands of names
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a is b or (not isinstance(a, np.ndarray) and not isinstance(b, np.ndarray) and a == b))


def lines_columns(lines: list[FloatArray]) -> Columns:
    """Return lines (n, 2) of (pixel, line) as columns for `PictureModels.fill`; empty ones are left out."""
    shown = [line for line in lines if len(line)]
    return {"pixel": [line[:, 0] for line in shown], "line": [line[:, 1] for line in shown]}
