"""Figures of calibrations: star residuals before and after, and the empirical PSF beside its Gaussian.

Pixel components are blue, line components vermilion, as in the summary figure (Okabe & Ito).
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opnav_workbench.arrays import FloatArray
from opnav_workbench.calibration import CameraCalibration, PsfCalibration, StarPictures
from opnav_workbench.camera import Camera
from opnav_workbench.psf import Psf
from opnav_workbench.report.drawing import LINE_COLOR, PIXEL_COLOR, new_figure

__all__ = ["camera_figure", "psf_figure"]

GREY = "0.6"
VECTOR_SHARE = 0.08  # of the detector's smaller side, for an arrow as long as the larger of both rms
PROFILE_PX = 5.0
FLOOR = 1e-6  # of the logarithmic picture, relative to the peak


def camera_figure(stars: StarPictures, result: CameraCalibration, title: str = "") -> Figure:
    """Draw residuals before and after over the detector and against the radius, and the correlations.

    Parameters
    ----------
    result
        Of these stars.
    """
    figure = new_figure(13.0, 8.2, title)
    axes = figure.subplots(2, 3)
    scale = max(result.rms_before_px, result.rms_after_px) or 1.0
    pairs = (
        ("before", result.residual_before_px, result.rms_before_px),
        ("after", result.residual_after_px, result.rms_after_px),
    )
    for row, (name, residual, rms) in enumerate(pairs):
        _draw_vectors(axes[row, 0], stars, result, residual, scale)
        axes[row, 0].set_title(f"{name}: {rms:.3f} px rms")
        _against_radius(axes[row, 1], stars, result, residual, 4.5 * scale)
    _draw_histogram(axes[0, 2], result, pairs[0][1], pairs[1][1])
    _draw_correlation(axes[1, 2], result)
    return figure


def psf_figure(result: PsfCalibration, gaussian: Psf, title: str = "") -> Figure:
    """Draw an empirical PSF, its profiles beside a Gaussian's, and how well either explains the stars."""
    figure = new_figure(13.0, 4.2, title)
    picture, profile, misfit = figure.subplots(1, 3)
    samples, cells = result.psf.samples, result.psf.oversampling
    half = len(samples) / 2.0 / cells
    shown = np.log10(np.maximum(samples / samples.max(), FLOOR))
    drawn = picture.imshow(shown, extent=(-half, half, half, -half), cmap="viridis", vmin=-4.0)
    figure.colorbar(drawn, ax=picture, label="log10 of the peak")
    picture.set(xlabel="pixel", ylabel="line", title=f"{result.n_stars} stars, {cells} cells a pixel")
    _draw_profiles(profile, result.psf, gaussian)
    bins = np.geomspace(0.3, max(float(result.gaussian_chi2.max()), 3.0), 25).tolist()
    misfit.hist(
        result.gaussian_chi2,
        bins=bins,
        color=GREY,
        label=f"Gaussian, median {np.median(result.gaussian_chi2):.2f}",
    )
    misfit.hist(
        result.empirical_chi2,
        bins=bins,
        histtype="step",
        color=PIXEL_COLOR,
        linewidth=2.0,
        label=f"empirical, median {np.median(result.empirical_chi2):.2f}",
    )
    misfit.set(xscale="log", xlabel="reduced chi-squared of a star's image", ylabel="stars")
    misfit.legend()
    return figure


def _draw_vectors(
    axes: Axes, stars: StarPictures, result: CameraCalibration, residual: FloatArray, scale_px: float
) -> None:
    camera: Camera = result.camera
    length = VECTOR_SHARE * min(camera.n_pixel, camera.n_line) / scale_px
    for mask, color in ((result.used, PIXEL_COLOR), (~result.used, LINE_COLOR)):
        x, y = stars.observed_px[mask].T
        u, v = np.clip(length * residual[mask], -camera.n_line, camera.n_line).T
        axes.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1.0, color=color, width=0.003)
    axes.set(xlim=(0, camera.n_pixel), ylim=(camera.n_line, 0), xlabel="pixel", ylabel="line", aspect="equal")


def _against_radius(
    axes: Axes, stars: StarPictures, result: CameraCalibration, residual: FloatArray, limit_px: float
) -> None:
    offset = (stars.observed_px - result.camera.center_pixel_line)[result.used]
    radius = np.hypot(*offset.T)
    outward = offset / np.maximum(radius, 1.0)[:, None]
    radial = np.sum(residual[result.used] * outward, axis=1)
    across = residual[result.used] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    axes.plot(radius, radial, ".", color=PIXEL_COLOR, markersize=3, label="radial")
    axes.plot(
        radius, np.sum(across * outward, axis=1), ".", color=LINE_COLOR, markersize=3, label="tangential"
    )
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.set(xlabel="distance from the center, px", ylabel="residual, px", ylim=(-limit_px, limit_px))
    axes.legend(loc="upper left")


def _draw_histogram(axes: Axes, result: CameraCalibration, before: FloatArray, after: FloatArray) -> None:
    largest = 4.0 * max(result.rms_before_px, result.rms_after_px) or 1.0
    bins = np.linspace(-largest, largest, 41).tolist()
    axes.hist(before[result.used].ravel(), bins=bins, color=GREY, label="before")
    axes.hist(
        after[result.used].ravel(),
        bins=bins,
        histtype="step",
        color=PIXEL_COLOR,
        linewidth=2.0,
        label="after",
    )
    axes.set(xlabel="residual (both coordinates), px", ylabel="stars")
    axes.legend()


def _draw_correlation(axes: Axes, result: CameraCalibration) -> None:
    if not result.names:
        axes.set_axis_off()
        return
    drawn = axes.imshow(np.nan_to_num(result.correlation), vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    ticks = np.arange(len(result.names))
    axes.set_xticks(ticks, result.names, rotation=60, ha="right")
    axes.set_yticks(ticks, result.names)
    axes.set_title("correlation")
    axes.figure.colorbar(drawn, ax=axes, shrink=0.8)


def _draw_profiles(axes: Axes, psf: Psf, gaussian: Psf) -> None:
    """Shares of a pixel against its distance from the point: what the pixels of many stars look like."""
    place = np.random.default_rng(1).uniform(-0.5, 0.5, (60, 2))
    half = int(PROFILE_PX)
    first = np.full((len(place), 2), -half)
    step = np.arange(-half, half + 1)
    distance = np.hypot(
        step[None, None, :] - place[:, 0, None, None], step[None, :, None] - place[:, 1, None, None]
    )
    for model, color, label in ((gaussian, GREY, "Gaussian"), (psf, PIXEL_COLOR, "empirical")):
        shares = model.box(place, first, len(step))
        axes.plot(distance.ravel(), np.abs(shares).ravel(), ".", color=color, markersize=2, label=label)
    axes.set(yscale="log", ylim=(1e-5, 1.0), xlabel="distance, px", ylabel="share of the light in a pixel")
    axes.legend(markerscale=4)
