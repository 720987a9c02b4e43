"""``opnav calibrate camera`` and ``opnav calibrate psf``: a camera file from the camera's own star frames.

Writes a copy of the camera's file with the new values, a report as JSON and a figure; what the stars do not
determine is null in the report and "not determined" in the table.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench import report
from opnav_workbench.calibration import (
    MAX_EFFECTIVE_SIGMA_PX,
    CameraCalibration,
    Edit,
    PsfCalibration,
    StarPictures,
    calibrate_camera,
    camera_edits,
    solvable,
    stack_psf,
    with_distortion,
    write_camera_file,
)
from opnav_workbench.camera import BrownDistortion, Camera, OwenDistortion
from opnav_workbench.cli.processing_options import processing_of, processing_options
from opnav_workbench.cli.terminal import named_progress, shown
from opnav_workbench.files import atomic_path, make_folder, write_json
from opnav_workbench.processing import OpenedProcessing
from opnav_workbench.processing.model import NO_TARGETS
from opnav_workbench.processing.star_pictures import (
    SolvedPictures,
    effective_psf_of,
    isolation_px,
    psf_pictures,
    sessions_kept,
    solve_star_pictures,
    star_pictures,
)
from opnav_workbench.psf import EffectivePsf, GaussianPsf
from opnav_workbench.version import __version__
from opnav_workbench.yaml_nodes import compose, plain_value, yaml_text

__all__ = ["calibrate"]


# ---- What ``opnav calibrate`` prints and writes: progress, a table of parameters, reports as plain values.


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
    stars: StarPictures,
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
        "frames": [_picture_report(stars, result, i) for i in range(stars.n_pictures)],
        "left_out": [{"image": name, "reason": reason} for name, reason in failed],
        "messages": list(result.messages),
    }


def _picture_report(stars: StarPictures, result: CameraCalibration, index: int) -> dict[str, Any]:
    own = (stars.picture_index == index) & result.used
    return {
        "image": stars.names[index],
        "n_stars": int(own.sum()),
        "rms_before_px": np.sqrt(np.mean(result.residual_before_px[own] ** 2)),
        "rms_after_px": np.sqrt(np.mean(result.residual_after_px[own] ** 2)),
        "camera_from_j2000": result.attitudes[index],
    }


def psf_json(
    result: PsfCalibration,
    effective: EffectivePsf | None,
    names: Sequence[str],
    failed: Sequence[tuple[str, str]],
) -> dict[str, Any]:
    """Return the report of a PSF calibration."""
    learned = None
    if effective is not None:
        learned = {
            "n_stars": effective.n_stars,
            "n_pictures": len(effective.pictures),
            "sigma_px": effective.sigma_px,
            "scatter": effective.scatter,
        }
    return {
        "effective": learned,
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
            {"image": name, "used": bool(used)}
            for name, used in zip(names, result.used_pictures, strict=True)
        ],
        "left_out": [{"image": name, "reason": reason} for name, reason in failed],
        "messages": list(result.messages),
    }


# ---- ``opnav calibrate camera`` and ``opnav calibrate psf``: a camera file from the camera's own star frames.

calibrate = typer.Typer(
    name="calibrate",
    help="Calibrate a camera from its own star frames: optics and mounting, or its PSF.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

DEFAULT_TERMS: dict[type, tuple[str, ...]] = {
    OwenDistortion: ("e2_per_mm2", "e5_per_mm", "e6_per_mm"),
    BrownDistortion: ("k1", "k2", "p1", "p2"),
}

# Of a star frame nothing else matters.
NOT_FOR_CAMERA = ("targets", "method", "target_stars")

ImagesArgument = Annotated[list[Path], typer.Argument(help="Pictures of one camera.", show_default=False)]
OutOption = Annotated[Path, typer.Option(help="Folder for the new camera file and the report.")]


@calibrate.command()
@processing_options(without=NOT_FOR_CAMERA)
def camera(
    images: ImagesArgument,
    given: dict[str, Any],
    solve: Annotated[
        str | None,
        typer.Option(
            help="Parameters, comma-separated; default focal length and the usual distortion terms.",
            show_default=False,
        ),
    ] = None,
    distortion: Annotated[str, typer.Option(help="Distortion model: keep | none | owen | brown")] = "keep",
    out: OutOption = Path("calibration"),
) -> None:
    """Solve focal length, distortion and mounting angles over many star frames.

    [bold]Example[/]

      opnav calibrate camera lor_*.fit -m new_horizons --solve focal_length_mm,e2_per_mm2 --out calibration

    Every picture keeps its own attitude; the parameters are shared. Writes OUT/<camera>.yaml, a copy of the camera's
    file with the new values, OUT/<camera>_calibration.json and OUT/<camera>_residuals.png. Mounting angles
    (mounting_pixel_rad, mounting_line_rad, mounting_boresight_rad) need a priori attitudes that differ alike.
    """
    opened = processing_of({**given, "targets": NO_TARGETS}).opened()
    solved = _solved_pictures(images, opened)
    start = with_distortion(solved.sessions[0].context.camera, distortion)
    names = (
        _default_names(start) if solve is None else tuple(n.strip() for n in solve.split(",") if n.strip())
    )
    stars = star_pictures(solved.sessions)
    result = calibrate_camera(stars, start, names)
    _write_camera(opened, start, solved, stars, result, distortion, out)


@calibrate.command()
@processing_options(without=(*NOT_FOR_CAMERA, "decisions"))
def psf(
    images: ImagesArgument,
    given: dict[str, Any],
    min_snr: Annotated[
        float, typer.Option(help="Least signal-to-noise ratio of a star in the stack.")
    ] = 50.0,
    oversampling: Annotated[
        int | None, typer.Option(help="Cells a pixel; default four to the PSF's width.", show_default=False)
    ] = None,
    out: OutOption = Path("calibration"),
) -> None:
    """Stack bright stars of solved frames to an empirical PSF.

    [bold]Example[/]

      opnav calibrate psf lor_*.fit -m new_horizons --catalog npz:tycho2.npz --out calibration

    Writes OUT/<camera>_psf.npz, OUT/<camera>.yaml, a copy of the camera's file that uses it, and a report as JSON and PNG.
    Stars need not be in the catalog; pictures whose stars have another shape are left out and named. Of an undersampled
    camera (sigma below 0.6 px) it writes OUT/<camera>_effective_psf.npz, too: what the stars say of light within a pixel,
    with its covariance, which every later fit of stars with that camera file begins with. Called again with the new
    camera file and more pictures, it adds these.
    """
    opened = processing_of({**given, "targets": NO_TARGETS}).opened()
    solved = _solved_pictures(images, opened, least_stars=1)
    context = solved.sessions[0].context
    isolation = isolation_px(context.camera)
    pictures = psf_pictures(solved.sessions, min_snr, isolation)
    result = stack_psf(pictures, context.camera_psf, oversampling=oversampling)
    effective = _effective_psf(solved, result, isolation)
    _write_psf(opened, context.camera, solved, result, effective, out)


def _effective_psf(solved: SolvedPictures, result: PsfCalibration, isolation: float) -> EffectivePsf | None:
    """What the pictures say of light within a pixel; None where every star of the camera shows that itself."""
    if not float(np.mean(result.psf.sigma_px)) < MAX_EFFECTIVE_SIGMA_PX:
        return solved.sessions[0].context.camera.effective_psf
    return effective_psf_of(sessions_kept(solved.sessions, result.used_pictures), isolation)


def _solved_pictures(images: Sequence[Path], opened: OpenedProcessing, **options: Any) -> SolvedPictures:
    console = Console(stderr=True, soft_wrap=True)
    with opened.how.kernel_set(), named_progress(console, len(images)) as say:
        solved = solve_star_pictures(images, opened, say, **options)
    for name, reason in solved.failed:
        console.print(f"[yellow]left out[/] {shown(name)}: {shown(reason)}", highlight=False)
    return solved


def _default_names(camera: Camera) -> tuple[str, ...]:
    known = solvable(camera)
    return ("focal_length_mm", *(n for n in DEFAULT_TERMS.get(type(camera.distortion), ()) if n in known))


def _write_camera(
    opened: OpenedProcessing,
    start: Camera,
    solved: SolvedPictures,
    stars: StarPictures,
    result: CameraCalibration,
    distortion: str,
    out: Path,
) -> None:
    source = opened.mission.camera_file(start)
    target = make_folder(out) / source.name
    heading = (
        f"Calibrated with {int(result.used.sum())} stars of {stars.n_pictures} frames ({stars.names[0]} to "
        f"{stars.names[-1]}), catalog {opened.how.catalog}; before: {source.name}"
    )
    _copy_psf(source, target)
    write_camera_file(source, target, camera_edits(result, distortion), heading)
    values_file = target.with_name(f"{source.stem}_calibration.json")
    write_json(values_file, calibration_json(stars, result, start, solved.failed, opened.how.catalog))
    picture = target.with_name(f"{source.stem}_residuals.png")
    report.write_png(
        report.camera_figure(stars, result, f"{start.name}: {stars.n_pictures} frames, {len(stars)} stars"),
        picture,
    )
    console = Console()
    console.print(camera_table(result, start.name))
    rms = f"residuals {result.rms_before_px:.3f} px rms before, {result.rms_after_px:.3f} px after"
    _print_files(console, rms, result.messages, (target, values_file, picture))


def _write_psf(
    opened: OpenedProcessing,
    start: Camera,
    solved: SolvedPictures,
    result: PsfCalibration,
    effective: EffectivePsf | None,
    out: Path,
) -> None:
    source = opened.mission.camera_file(start)
    target = make_folder(out) / source.name
    template = target.with_name(f"{source.stem}_psf.npz")
    result.psf.save(template)
    edit = Edit({"model": "empirical", "file": template.name}, f"{result.n_stars} stars")
    names = [s.context.picture.name for s in solved.sessions]
    heading = (
        f"PSF of {result.n_stars} stars of {int(result.used_pictures.sum())} frames; before: {source.name}"
    )
    edits: dict[tuple[str, ...], Edit] = {("psf", "model"): edit}
    files = [target, template]
    if effective is not None:
        files.append(target.with_name(f"{source.stem}_effective_psf.npz"))
        effective.save(files[-1])
        words = f"{effective.n_stars} stars of {len(effective.pictures)} frames"
        edits["psf", "effective"] = Edit(files[-1].name, words)
    write_camera_file(source, target, edits, heading)
    values_file = target.with_name(f"{source.stem}_psf.json")
    write_json(values_file, psf_json(result, effective, names, solved.failed))
    picture = target.with_name(f"{source.stem}_psf.png")
    sigma = start.psf.sigma_px
    report.write_png(
        report.psf_figure(result, GaussianPsf(sigma, sigma), f"{start.name}: empirical PSF"), picture
    )
    median = [float(np.median(chi2)) for chi2 in (result.gaussian_chi2, result.empirical_chi2)]
    words = (
        f"{result.n_stars} stars, {result.psf.oversampling} cells a pixel; reduced chi-squared of a star (median) "
        f"{median[0]:.2f} with one Gaussian, {median[1]:.2f} with the PSF"
    )
    _print_files(Console(), words, result.messages, (*files, values_file, picture))


def _copy_psf(source: Path, target: Path) -> None:
    """The files of a PSF beside the old file go beside the new one."""
    told = plain_value(compose(yaml_text(source))).get("psf") or {}
    model = told.get("model") or {}
    names = [model.get("file") if isinstance(model, dict) else None, told.get("effective")]
    if source.parent.resolve() != target.parent.resolve():
        for name in filter(None, names):
            with atomic_path(target.parent / name) as temporary:
                shutil.copyfile(source.parent / name, temporary)


def _print_files(console: Console, words: str, messages: Sequence[str], files: Sequence[Path]) -> None:
    console.print(words, highlight=False, soft_wrap=True)
    for message in messages:
        console.print(f"[yellow]note[/] {shown(message)}", highlight=False, soft_wrap=True)
    names = ", ".join(path.name for path in files)
    console.print(f"In {shown(str(files[0].parent))}/: {shown(names)}", highlight=False, soft_wrap=True)
    console.print(
        "To use the new camera file, name it in a mission file (cameras: file), or put it in the old one's place.",
        highlight=False,
        soft_wrap=True,
    )
