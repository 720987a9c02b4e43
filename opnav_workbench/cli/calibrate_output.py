"""What ``opnav calibrate`` prints and writes: progress, a table of parameters, reports as plain values."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.table import Table

from opnav_workbench.calibration import CameraCalibration, PsfCalibration, StarFrames
from opnav_workbench.camera import Camera
from opnav_workbench.version import __version__

__all__ = ["calibration_json", "camera_table", "progress_of", "psf_json"]


@contextmanager
def progress_of(console: Console, total: int) -> Iterator[Callable[[str, str], None]]:
    """Show how far the pictures are; the yielded function tells of the next one."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=total)
        begun = [0]

        def say(name: str, words: str) -> None:
            progress.update(task, description=f"{escape(name)}: {escape(words)}", completed=begun[0])
            begun[0] += 1

        yield say


def camera_table(result: CameraCalibration, name: str) -> Table:
    """Return the table of parameters: before, after, sigma, and the change in sigmas."""
    table = Table(title=name, title_justify="left", box=None, header_style="bold", pad_edge=False)
    table.add_column("parameter", no_wrap=True)
    for heading in ("before", "after", "σ", "change/σ"):
        table.add_column(heading, justify="right", no_wrap=True)
    for parameter, before, after, sigma in zip(
        result.names, result.initial, result.values, result.sigmas, strict=True
    ):
        if np.isinf(sigma):
            table.add_row(parameter, f"{before:.9g}", f"{after:.9g}", "not determined", "–")
        else:
            change = (after - before) / sigma
            table.add_row(parameter, f"{before:.9g}", f"{after:.9g}", f"{sigma:.2g}", f"{change:+.1f}")
    for first, second, value in result.strong_correlations:
        table.add_row(f"[dim]correlation {first}, {second}: {value:+.3f}[/]")
    return table


def calibration_json(
    stars: StarFrames,
    result: CameraCalibration,
    start: Camera,
    failed: Sequence[tuple[str, str]],
    catalog: str,
) -> dict[str, Any]:
    """Return the report of a camera calibration; what is not determined is null."""
    return {
        "version": __version__,
        "camera": start.name,
        "catalog": catalog,
        "parameters": [
            {"name": name, "before": before, "after": after, "sigma": sigma}
            for name, before, after, sigma in zip(
                result.names, result.initial, result.values, result.sigmas, strict=True
            )
        ],
        "covariance": result.covariance,
        "correlation": result.correlation,
        "strong_correlations": [list(pair) for pair in result.strong_correlations],
        "not_determined": [
            dict(zip(result.names, direction, strict=True)) for direction in result.open_directions
        ],
        "rms_before_px": result.rms_before_px,
        "rms_after_px": result.rms_after_px,
        "excess_sigma_px": result.excess_sigma_px,
        "chi2_reduced": result.chi2_reduced,
        "iterations": result.iterations,
        "n_stars": int(result.used.sum()),
        "n_rejected": int((~result.used).sum()),
        "frames": [_frame(stars, result, i) for i in range(stars.n_frames)],
        "left_out": [{"image": name, "reason": reason} for name, reason in failed],
        "messages": list(result.messages),
    }


def _frame(stars: StarFrames, result: CameraCalibration, index: int) -> dict[str, Any]:
    own = (stars.frame == index) & result.used
    return {
        "image": stars.names[index],
        "n_stars": int(own.sum()),
        "rms_before_px": np.sqrt(np.mean(result.residual_before_px[own] ** 2)),
        "rms_after_px": np.sqrt(np.mean(result.residual_after_px[own] ** 2)),
        "camera_from_j2000": result.attitudes[index],
    }


def psf_json(
    result: PsfCalibration, names: Sequence[str], failed: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    """Return the report of a PSF calibration."""
    return {
        "version": __version__,
        "n_stars": result.n_stars,
        "oversampling": result.psf.oversampling,
        "half_size_px": result.psf.half_size_px,
        "sigma_px": result.psf.sigma_px,
        "smoothness": result.smoothness,
        "chi2_reduced_median": {
            "gaussian": np.median(result.gaussian_chi2),
            "empirical": np.median(result.empirical_chi2),
            "empirical_other_stars": result.held_out_chi2,
        },
        "centers_moved_rms_px": result.moved_px,
        "frames": [
            {"image": name, "used": bool(used)} for name, used in zip(names, result.used_frames, strict=True)
        ],
        "left_out": [{"image": name, "reason": reason} for name, reason in failed],
        "messages": list(result.messages),
    }
