"""``opnav campaign stack``: many solved pictures of a faint target as one."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.campaign.run_folder import find_runs
from opnav_workbench.campaign.stacking import (
    Growth,
    Stacked,
    StackProducts,
    find_in_stack,
    frames_of_runs,
    snr_growth,
    stack_frames,
    write_stack,
)
from opnav_workbench.cli.calibrate_output import progress_of
from opnav_workbench.report.campaign_stack_figure import stack_figure
from opnav_workbench.report.png import write_png
from opnav_workbench.spice import KernelSet

__all__ = ["stack"]

STYLES = {"ok": "green", "uncertain": "yellow"}


def stack(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Run folders of solved pictures, or folders of them.", show_default=False),
    ],
    target: Annotated[
        str | None,
        typer.Option(
            "--target", "-t", help="Body whose motion is followed; none: the stars.", show_default=False
        ),
    ] = None,
    kernels: Annotated[
        str | None,
        typer.Option(help="Kernels, for a target that the runs have not met.", show_default=False),
    ] = None,
    subtract_stars: Annotated[
        bool,
        typer.Option("--subtract-stars", help="Take the star field away, as the other pictures show it."),
    ] = False,
    search_radius: Annotated[
        float, typer.Option(min=1.0, help="How far from its prediction the target may be, px.")
    ] = 3.0,
    window: Annotated[
        int | None,
        typer.Option(
            min=16,
            help="Side of the stacked part, px; default 64 about a target, else all.",
            show_default=False,
        ),
    ] = None,
    keep_hits: Annotated[
        bool, typer.Option("--keep-hits", help="Do not mask what is in one picture only.")
    ] = False,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the stack's own folder.")] = Path(
        "stacks"
    ),
) -> None:
    """Stack pictures for a target too faint for each of them.

    [bold]Example[/]

      opnav campaign stack run/c* --target CHARON --kernels new_horizons/pluto_opnav --out stacks

    Pictures are brought onto one grid by their solved pointings, distortion honoured, hits masked. Writes
    OUT/stack_.../ with the stack as FITS (picture, noise, pictures in each pixel), result.json, observables.ecsv and a
    figure; `opnav campaign ingest` takes that folder as it takes a picture's.
    """
    folders = list(dict.fromkeys(folder for run in runs for folder in find_runs(run)))
    console = Console(stderr=True, soft_wrap=True)
    with ExitStack() as opened:
        if kernels is not None:
            opened.enter_context(KernelSet(kernels))
        with progress_of(console, len(folders)) as say:
            pictures = frames_of_runs(folders, target, lambda name: say(name, "taking up its session"))
        for run, reason in pictures.left_out:
            console.print(f"[yellow]left out[/] {escape(run)}: {escape(reason)}", highlight=False)
        with console.status("stacking") if console.is_terminal else ExitStack():
            stacked = stack_frames(
                pictures.frames,
                "stars" if target is None else "target",
                window_px=window,
                reject_hits=not keep_hits,
                subtract=subtract_stars,
            )
            center = (
                None if target is None else find_in_stack(stacked, target, search_radius_px=search_radius)
            )
        products = write_stack(
            stacked,
            center,
            out,
            mission=pictures.mission,
            reference_body=pictures.reference_body,
            left_out=pictures.left_out,
        )
    _draw(stacked, center, products)
    _tell(Console(soft_wrap=True), stacked, center, products)


def _draw(stacked: Stacked, center: BodyCenter | None, products: StackProducts) -> None:
    growth: Growth | None = None
    if center is not None and center.pixel_line is not None and stacked.subtractions is None:
        growth = snr_growth(stacked, center.pixel_line)
    figure = stack_figure(stacked, center, growth, products.folder.name)
    write_png(figure, products.picture.with_suffix(".png"))


def _tell(console: Console, stacked: Stacked, center: BodyCenter | None, products: StackProducts) -> None:
    names = [frame.name for frame in stacked.frames]
    console.print(
        f"{len(names)} pictures, {escape(names[0])} to {escape(names[-1])}, mean epoch "
        f"{products.result['utc']} UTC; {sum(stacked.hits)} pixels masked",
        highlight=False,
    )
    if center is not None:
        console.print(_center_line(center, products), highlight=False)
        _notes(console, center.messages)
    _notes(console, stacked.messages)
    console.print(f"Stack in {escape(str(products.folder))}/", highlight=False)


def _center_line(center: BodyCenter, products: StackProducts) -> str:
    status = f"[{STYLES.get(center.status, 'bold red')}]{center.status.replace('_', ' ')}[/]"
    seen = products.observable
    if center.pixel_line is None or seen is None or seen.residual_px is None:
        return f"{escape(center.name)}: {status}"
    sigma = [seen.total_covariance_px2[i, i] ** 0.5 for i in (0, 1)]
    offsets = " and ".join(
        f"{value:+.3f} ± {error:.3f} px" for value, error in zip(seen.residual_px, sigma, strict=True)
    )
    return (
        f"{escape(center.name)}: {status}, SNR {center.snr:.1f}, pixel {center.pixel_line[0]:.3f}, line "
        f"{center.pixel_line[1]:.3f}, O−C {offsets}"
    )


def _notes(console: Console, messages: Sequence[str]) -> None:
    for message in messages:
        console.print(f"[yellow]note[/] {escape(message)}", highlight=False)
