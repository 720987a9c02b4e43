"""Residuals of the stars: against magnitude before and after repointing, and as vectors over the frame."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.report.scales import round_scale
from opnav_workbench.session import ImageSession
from opnav_workbench.widgets.workbench_svg import Plot, data_range

__all__ = ["ResidualRows", "residual_plots", "residual_rows", "small_residual_plots", "vector_plot"]

VECTOR_SHARE = 0.12  # of the frame's shorter side, for the longest residual
STRIP_ASPECT = 4.0  # a frame longer than this is drawn without square pixels
LEGEND = (
    '<p class="legend"><span class="key pixel">● pixel</span><span class="key line">■ line</span>'
    "<span>observed − predicted, px, against magnitude</span></p>"
)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualRows:
    """Residuals of the stars in use.

    Attributes
    ----------
    ids : tuple of str
    mag : (n,) array
    place_px : (n, 2) array
        Where they are predicted now.
    before_px, after_px : (n, 2) array
        Observed minus predicted, with the a priori and with the present pointing.
    sigma_px : (n, 2) array
    solved : bool
        Whether a pointing stands, so that ``after_px`` means something.
    frame : (int, int)
        Pixels and lines of the frame.
    """

    ids: tuple[str, ...]
    mag: FloatArray
    place_px: FloatArray
    before_px: FloatArray
    after_px: FloatArray
    sigma_px: FloatArray
    solved: bool
    frame: tuple[int, int]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def residual_rows(session: ImageSession) -> ResidualRows:
    """Return the residuals of the stars in use, as the session stands."""
    state, context = session.state, session.context
    stars, centers = state.a_priori, state.centers
    frame = (context.camera.n_pixel, context.camera.n_line)
    if stars is None or centers is None:
        none = np.empty((0, 2))
        return ResidualRows((), np.empty(0), none, none, none, none, False, frame)
    shown: BoolArray = np.asarray(state.mask("used")) & np.isfinite(centers.pixel_line).all(axis=1)
    place = stars.places(context.camera, session.camera_from_j2000)
    before = stars.places(context.camera, session.inputs.a_priori_camera_from_j2000)
    return ResidualRows(
        ids=tuple(stars.id[shown].tolist()),
        mag=stars.mag[shown],
        place_px=place[shown],
        before_px=(centers.pixel_line - before)[shown],
        after_px=(centers.pixel_line - place)[shown],
        sigma_px=centers.sigma_px[shown],
        solved=state.pointing is not None,
        frame=frame,
    )


def _against_magnitude(
    rows: ResidualRows, residual_px: FloatArray, title: str, size: tuple[int, int], *, y_label: str
) -> str:
    reach = residual_px + np.array([-1.0, 1.0])[:, None, None] * rows.sigma_px
    plot = Plot(
        *size, data_range(rows.mag), data_range(reach, with_zero=True), title, x_label="", y_label=y_label
    )
    for column, style in enumerate(("pixel", "line")):
        titles = [
            f"{star}: {style} {value:+.3f} ± {sigma:.3f} px"
            for star, value, sigma in zip(
                rows.ids, residual_px[:, column], rows.sigma_px[:, column], strict=True
            )
        ]
        plot.points(rows.mag, residual_px[:, column], style, rows.sigma_px[:, column], titles)
    return plot.svg()


def small_residual_plots(rows: ResidualRows) -> str:
    """Return before and after side by side, small; nothing before stars are found."""
    return residual_plots(rows, (222, 118), y_label="") if rows.ids else ""


def residual_plots(rows: ResidualRows, size: tuple[int, int], y_label: str = "residual, px") -> str:
    """Return the plots of residual against magnitude, before and after repointing."""
    if not rows.ids:
        return '<p class="hint">No star is in use: nothing to plot.</p>'
    after = (
        _against_magnitude(rows, rows.after_px, "after repointing", size, y_label=y_label)
        if rows.solved
        else f'<div class="blank" style="width:{size[0]}px;height:{size[1]}px">not repointed yet</div>'
    )
    before = _against_magnitude(rows, rows.before_px, "before repointing", size, y_label=y_label)
    return f'<div class="plots">{before}{after}</div>{LEGEND}'


def vector_plot(rows: ResidualRows, width_px: int) -> str:
    """Return the residual vectors over the frame, enlarged by a round factor that the title tells."""
    n_pixel, n_line = rows.frame
    height = 120 if n_pixel > STRIP_ASPECT * n_line else round((width_px - 66) * n_line / n_pixel) + 54
    longest = float(np.hypot(*rows.after_px.T).max()) if rows.ids else 0.0
    scale = round_scale(VECTOR_SHARE * max(min(n_pixel, n_line), 0.05 * n_pixel) / max(longest, 1e-6))
    plot = Plot(
        width_px,
        height,
        (-0.5, n_pixel - 0.5),
        (n_line - 0.5, -0.5),
        f"residual vectors, × {scale:g}" if rows.ids else "residual vectors: no star in use",
        x_label="pixel",
        y_label="line",
    )
    for star, place, residual in zip(rows.ids, rows.place_px, rows.after_px, strict=True):
        tip = place + scale * residual
        (x0, x1), (y0, y1) = plot.x([place[0], tip[0]]), plot.y([place[1], tip[1]])
        plot.raw(
            f'<path class="vector" d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"><title>{star}</title></path>'
        )
        plot.raw(f'<circle class="root" cx="{x0:.1f}" cy="{y0:.1f}" r="2.5"/>')
    return plot.svg()
