"""What the figures of a body's center share: which center they show, its marks, and panels with a colour bar in DN.

A center comes from a session, then with its prediction, compass and the analyst's circle, or alone. A window much
larger than the body, as of joint fits, is cut down to the body and a rim. Stretches are linear between percentiles,
so that a cosmic ray does not darken the rest.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies import BodyCenter, BodyResiduals, Circle, describe_body_flags
from opnav_workbench.bodies.results import DiskReading, LimbEllipse
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import radec_from_unit, tangent_basis
from opnav_workbench.report.drawing import BODY_COLOR, GREEN, OBSERVED_COLOR, PREDICTED_COLOR
from opnav_workbench.session import ImageSession

__all__ = [
    "ShownBody",
    "draw_compass",
    "draw_mark",
    "draw_panel",
    "legend_below",
    "linear_limits",
    "method_title",
    "pictures_around",
    "shown_body",
    "shown_of_session",
    "symmetric_limit",
    "title_remarks",
]

DARK_EDGE = withStroke(linewidth=2.6, foreground="black")
# The stretch is linear between these percentiles: a cosmic ray or a hot pixel does not darken the rest.
BRIGHTEST, LARGEST = 99.9, 99.8
# A window this many times as large as the body, and some px, is cut down to the body and a rim: a share of it, and px.
WIDE, LEAST_WIDE_PX = 2.0, 60
CLOSE_RIM, LEAST_RIM_PX = 0.2, 6.0
TEXT_WIDTH = 190  # characters that fit a line of the title
# Mark and colour by what stands there.
MARKS: dict[str, dict[str, Any]] = {
    "predicted": {"marker": "o", "color": PREDICTED_COLOR, "markersize": 11.0},
    "observed": {"marker": "+", "color": OBSERVED_COLOR, "markersize": 11.0},
    "truth": {"marker": "x", "color": GREEN, "markersize": 8.0},
}
OUTLINE: dict[str, Any] = {"color": BODY_COLOR, "linewidth": 1.0, "linestyle": (0, (4, 3))}


@dataclass(frozen=True, slots=True, eq=False)
class ShownBody:
    """A center and what is drawn with it.

    Attributes
    ----------
    predicted_px : (2,) array or None
        Expected center (pixel, line); None where no session tells.
    outline_px : (k, 2) array
        The model's limb at the solution; k = 0 where it is not known.
    circle
        Where the analyst saw the body.
    east_north : (2, 2) array or None
        Rows: how (pixel, line) change with RA cos Dec and with Dec, as unit vectors.
    where
        Picture and time; empty without a session.
    """

    center: BodyCenter
    predicted_px: FloatArray | None
    outline_px: FloatArray
    circle: Circle | None = None
    east_north: FloatArray | None = None
    where: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


def shown_body(source: BodyCenter | ImageSession, name: str = "", method: str = "") -> ShownBody:
    """Return the center to show: `source` itself, or the last one of a session with this name and method.

    Raises
    ------
    SessionError
        The session has no such center.
    """
    if isinstance(source, BodyCenter):
        return ShownBody(source, None, _limb_of(source))
    found = [b for b in source.state.bodies if name in ("", b.name) and method in ("", b.method)]
    if not found:
        asked = " ".join(part for part in (name, f"({method})" if method else "") if part) or "any body"
        there = ", ".join(f"{b.name} ({b.method})" for b in source.state.bodies) or "none"
        raise SessionError(f"no center of {asked}; find_body() makes one. Found so far: {there}.")
    return shown_of_session(source, found[-1])


def shown_of_session(session: ImageSession, center: BodyCenter) -> ShownBody:
    """Return a center with what a session knows of its body; the center need not stand in it any more."""
    where = f"{session.context.picture.name}   {session.inputs.utc} UTC"
    expected = session.predict_body(center.name)
    outline = _limb_of(center)
    if not len(outline) and center.pixel_line is not None:
        size = expected.range_km / center.range_km if np.isfinite(center.range_km) else 1.0
        outline = center.pixel_line + size * (expected.limb_px - expected.pixel_line)
    circle = session.state.circles.get(center.name)
    return ShownBody(
        center, expected.pixel_line, outline, circle, _east_north(session, expected.direction), where
    )


def _east_north(session: ImageSession, direction: FloatArray) -> FloatArray:
    attitude = session.camera_from_j2000
    camera = session.context.camera.standing(attitude)
    sky = np.stack(tangent_basis(*radec_from_unit(direction)))
    motion = sky @ attitude.T @ camera.project_jacobian(attitude @ direction).T
    return np.asarray(motion / np.linalg.norm(motion, axis=1, keepdims=True))


def _limb_of(center: BodyCenter) -> FloatArray:
    return (
        center.detail.outline_px if isinstance(center.detail, LimbEllipse | DiskReading) else np.empty((0, 2))
    )


def pictures_around(shown: ShownBody) -> BodyResiduals:
    """Return the pictures of a center; of a window much larger than the body, as of joint fits, the part around it.

    Raises
    ------
    SessionError
        It has none.
    """
    center = shown.center
    if center.pictures is not None:
        return _cut_around(center.pictures, shown.outline_px)
    why = f"{center.status}: {'; '.join(center.messages)}" if center.pixel_line is None else "not kept"
    raise SessionError(
        f"{center.name} ({center.method}) has no pictures to show ({why.rstrip(': ')}); find_body() with a method for "
        "extended bodies makes them."
    )


def _cut_around(pictures: BodyResiduals, outline: FloatArray) -> BodyResiduals:
    if not len(outline):
        return pictures
    first, size = np.array(pictures.window[:2]), np.array(pictures.window[2:])
    low, high = outline.min(axis=0), outline.max(axis=0)
    if (size <= WIDE * (high - low) + LEAST_WIDE_PX).all():
        return pictures
    rim = 0.5 * CLOSE_RIM * (high - low).max() + LEAST_RIM_PX
    begin = np.clip(np.floor(low - rim).astype(int) - first, 0, size - 1)
    end = np.clip(np.ceil(high + rim).astype(int) - first, begin + 1, size)
    part = np.s_[begin[1] : end[1], begin[0] : end[0]]
    window = tuple(int(value) for value in (*(first + begin), *(end - begin)))
    return BodyResiduals(
        window,  # type: ignore[arg-type]
        pictures.data_dn[part],
        pictures.model_dn[part],
        pictures.difference_dn[part],
        pictures.mask[part],
    )


def title_remarks(center: BodyCenter) -> list[str]:
    """Return a center's messages and flags as lines that fit a title."""
    said = [*center.messages, *([describe_body_flags(center.flags)] if center.flags else [])]
    return textwrap.wrap("; ".join(dict.fromkeys(said)), TEXT_WIDTH)


def method_title(method: str) -> str:
    """Return a method's name as one writes it.

    Examples
    --------
    >>> method_title("limb_scan"), method_title("cross_correlation")
    ('limb scan', 'cross-correlation')
    """
    return {"cross_correlation": "cross-correlation"}.get(method, method.replace("_", " "))


def linear_limits(*values: FloatArray) -> tuple[float, float]:
    """Return where a linear stretch begins and ends that suits all of these."""
    good = np.concatenate([v[np.isfinite(v)] for v in values])
    if not good.size:
        return 0.0, 1.0
    low, high = (float(p) for p in np.percentile(good, (100.0 - BRIGHTEST, BRIGHTEST)))
    return min(low, 0.0), max(high, low + 1e-6)


def symmetric_limit(*values: FloatArray) -> float:
    """Return the limit of a stretch that is even about zero."""
    good = np.concatenate([np.abs(v[np.isfinite(v)]) for v in values])
    return max(float(np.percentile(good, LARGEST)), 1e-6) if good.size else 1.0


def draw_panel(
    axes: Axes,
    window: tuple[int, int, int, int],
    values: FloatArray,
    limits: tuple[float, float],
    title: str,
    *,
    cmap: str = "gray",
) -> None:
    """Draw part of the detector, with axes in its pixels and lines and a colour bar as high as the picture."""
    pixel, line, n_pixel, n_line = window
    drawn = axes.imshow(
        values,
        cmap=cmap,
        vmin=limits[0],
        vmax=limits[1],
        interpolation="nearest",
        extent=(pixel - 0.5, pixel + n_pixel - 0.5, line + n_line - 0.5, line - 0.5),
    )
    bar = axes.inset_axes((1.03, 0.0, 0.045, 1.0))
    axes.figure.colorbar(drawn, cax=bar)
    bar.set_title("DN", fontsize=8)
    for each in (axes, bar):
        each.tick_params(labelsize=8)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("pixel", fontsize=9)


def draw_mark(axes: Axes, what: str, place: FloatArray | None) -> Artist | None:
    """Draw a mark where it lies within the axes' limits, and return it."""
    if place is None or not _within(axes, place):
        return None
    style = {
        "markerfacecolor": "none",
        "markeredgewidth": 1.5,
        "linestyle": "none",
        "path_effects": [DARK_EDGE],
    }
    (artist,) = axes.plot(*place, **(MARKS[what] | style))
    return artist


def draw_compass(axes: Axes, shown: ShownBody) -> None:
    """Draw in the upper right corner where right ascension and declination grow."""
    if shown.east_north is None:
        return
    corner = np.array([0.87, 0.87])
    for name, (pixel, line) in zip(("RA", "Dec"), shown.east_north, strict=True):
        way = np.array([pixel, -line])  # the axes' fractions count upward, lines downward
        tip, text = corner + 0.06 * way, corner + 0.095 * way
        arrow = {"arrowstyle": "->", "color": "w", "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate("", tuple(tip), tuple(corner), "axes fraction", "axes fraction", arrowprops=arrow)
        style: dict[str, Any] = {"color": "w", "fontsize": 7.5, "ha": "center", "va": "center"}
        axes.text(float(text[0]), float(text[1]), name, transform=axes.transAxes, **style)


def _within(axes: Axes, place: FloatArray) -> bool:
    limits = (sorted(axes.get_xlim()), sorted(axes.get_ylim()))
    return all(low <= value <= high for value, (low, high) in zip(place, limits, strict=True))


def legend_below(figure: Figure, entries: Sequence[tuple[Artist, str]], *, dark: bool = True) -> None:
    """Explain marks below the panels: those of pictures left and on grey, those of plots (`dark` False) right on white."""
    if not entries:
        return
    handles, labels = zip(*entries, strict=True)
    figure.legend(
        handles,
        labels,
        loc="outside lower left" if dark else "outside lower right",
        ncols=len(entries),
        fontsize=8.5,
        facecolor="0.25" if dark else "w",
        labelcolor="w" if dark else "k",
        handlelength=1.8,
    )
