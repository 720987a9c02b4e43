"""The bokeh models of a view: picture, magnifier and panner, and the glyphs of every overlay."""

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, ImageRGBA, PanTool, Range1d, RangeTool, WheelZoomTool
from bokeh.models.annotations import Arrow, BoxAnnotation, VeeHead
from bokeh.plotting import figure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.widgets.overlays import Columns
from opnav_workbench.widgets.themes import DEFAULT_THEME, GROUPS, THEMES

__all__ = ["PictureModels", "lines_columns"]

STAR_SIZES = {"predicted": 15, "used": 10, "rejected": 11, "missing": 13}  # screen px
LABEL_GROUND = "#101418"  # under labels, so that they stay readable over bright bodies
NO_PICTURE = np.zeros((1, 1), np.uint32)


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
        for plot in (self.magnifier, self.panner):
            plot.axis.visible = False
        for plot, name in ((self.picture, "shown"), (self.magnifier, "magnified"), (self.panner, "overview")):
            _add_image(plot, f"opnav-{name}")
        self.sources: dict[str, Any] = {}
        self._glyphs: dict[str, list[Any]] = {}  # by kind, for the theme
        cursor = ColumnDataSource({"pixel": [0.0], "line": [0.0]}, name="opnav-cursor")
        self.magnifier.rect(
            "pixel", "line", 1, 1, source=cursor, fill_color=None, line_color="#E69F00", line_width=1.5
        )
        self._add_masks()
        self._add_lines()
        self._add_stars()
        self._add_tools()

    @property
    def roots(self) -> tuple[Any, ...]:
        """What is shown."""
        return self.picture, self.magnifier, self.panner

    def fill(self, name: str, columns: Columns) -> None:
        """Replace a source's columns, if they differ."""
        source = self.sources[name]
        old = source.data
        if old.keys() != columns.keys() or not all(_same(old[key], columns[key]) for key in columns):
            source.data = columns

    def use_theme(self, name: str) -> None:
        """Give every mark the look that a theme has for it."""
        for kind, glyphs in self._glyphs.items():
            look = THEMES[name][kind]
            for glyph in glyphs:
                glyph.line_color, glyph.line_dash = look.color, look.dash
                if kind == "residual":
                    glyph.end.fill_color = look.color
                if hasattr(glyph, "marker"):
                    glyph.marker = look.shape
                if hasattr(glyph, "hatch_color"):
                    glyph.hatch_color = look.color

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
            self._glyphs[kind] = [
                plot.multi_line(
                    "pixel", "line", source=source, name=f"overlay:{group}", line_width=width
                ).glyph
                for plot in self._plots(group)
            ]
        self._add_text("grid_labels", "grid", "grid")
        self._add_text("body_labels", "bodies", "body")

    def _plots(self, group: str) -> tuple[Any, ...]:
        return (self.picture,) if group == "grid" else (self.picture, self.magnifier)

    def _add_stars(self) -> None:
        vectors = self.sources["vectors"] = _source("pixel", "line", "end_pixel", "end_line")
        head = VeeHead(size=7, fill_color=THEMES[DEFAULT_THEME]["residual"].color, line_color=None)
        arrow: Any = Arrow(
            x_start="pixel", y_start="line", x_end="end_pixel", y_end="end_line", source=vectors, end=head,
            name="overlay:residuals", tags=["own-colors"],
        )  # fmt: skip
        arrow.line_width = 1.5
        self.picture.add_layout(arrow)
        self._glyphs["residual"] = [arrow]
        for kind, size in STAR_SIZES.items():
            group = next(name for name, kinds in GROUPS.items() if kind in kinds)
            source = self.sources[kind] = _source("pixel", "line")
            self._glyphs[kind] = [
                plot.scatter(
                    "pixel", "line", source=source, name=f"overlay:{group}", size=size,
                    fill_color=None, line_width=1.6, marker=THEMES[DEFAULT_THEME][kind].shape,
                ).glyph
                for plot in (self.picture, self.magnifier)
            ]  # fmt: skip
        self._add_text("star_labels", "magnitudes", "predicted")

    def _add_text(self, name: str, group: str, kind: str) -> None:
        source = self.sources[name] = _source("pixel", "line", "text", "x_offset", "y_offset", "side")
        self.picture.text(
            "pixel", "line", "text", source=source, name=f"overlay:{group}", text_font_size="11px",
            text_color=THEMES[DEFAULT_THEME][kind].color, background_fill_color=LABEL_GROUND,
            background_fill_alpha=0.75, padding=1, x_offset="x_offset", y_offset="y_offset", text_align="side",
        )  # fmt: skip

    def _add_tools(self) -> None:
        segments = self.sources["segments"] = _source("x0", "y0", "x1", "y1", "color", "dash", "width")
        self.picture.segment(
            "x0", "y0", "x1", "y1", source=segments, line_color="color", line_dash="dash", line_width="width"
        )
        self._add_text("tool_labels", "tools", "focus")
        for kind in ("circle", "focus"):
            source = self.sources[kind] = _source("pixel", "line", "radius")
            ring = self.picture.circle(
                "pixel", "line", radius="radius", source=source, fill_color=None, line_width=2
            )
            cross = self.picture.scatter(
                "pixel", "line", source=source, marker="cross", size=9 if kind == "circle" else 0
            )
            self._glyphs[kind] = [ring.glyph]
            cross.glyph.line_color = THEMES[DEFAULT_THEME][kind].color


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


def _add_image(plot: Any, name: str) -> None:
    source = ColumnDataSource(
        {"image": [NO_PICTURE], "x": [0.0], "y": [0.0], "dw": [1.0], "dh": [1.0]}, name=name
    )
    plot.add_glyph(source, ImageRGBA(image="image", x="x", y="y", dw="dw", dh="dh"))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a is b or (not isinstance(a, np.ndarray) and not isinstance(b, np.ndarray) and a == b))


def lines_columns(lines: list[FloatArray]) -> Columns:
    """Return lines (n, 2) of (pixel, line) as columns for `PictureModels.fill`; empty ones are left out."""
    shown = [line for line in lines if len(line)]
    return {"pixel": [line[:, 0] for line in shown], "line": [line[:, 1] for line in shown]}
