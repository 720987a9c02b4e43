"""``opnav process``: pictures in, pointing and observables out; with progress, then tables of results.

`run_images` and `Reporter` serve ``opnav demo`` and ``opnav ort solve`` as well. A picture that fails is named at
once, and the others are kept.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench.cli.processing_options import processing_of, processing_options
from opnav_workbench.cli.terminal import EXIT_PARTLY, error_console, picture_progress, plain_table, shown
from opnav_workbench.errors import plain_line
from opnav_workbench.processing import Outcome, Processing, process_images

__all__ = ["Reporter", "process", "run_images"]


# ---- What the command line prints: progress on standard error, results as tables on standard output.

WIDE_COLUMNS = 120  # a terminal this wide has room for directions beside places
STATUS_STYLES = {"ok": "green", "partial": "yellow", "failed": "bold red"}


class Reporter:
    """Progress while pictures are processed, then their table."""

    def __init__(self, total: int) -> None:
        self._out = Console(soft_wrap=False, emoji=False)
        self._err = error_console()
        self._progress = picture_progress(self._err)
        self._task = self._progress.add_task("", total=total)

    def __enter__(self) -> "Reporter":
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def say(self, name: str, words: str) -> None:
        """Show what is being done."""
        self._progress.update(self._task, description=f"{shown(name)}: {shown(words)}")

    def done(self, outcome: Outcome) -> None:
        """Count a picture; one that failed is named at once, with its reason."""
        self._progress.advance(self._task)
        if outcome.failed:
            self._err.print(f"[bold red]failed:[/] {shown(_named_error(outcome))}", highlight=False)
        if outcome.note:
            _print_note(self._err, outcome, outcome.note)

    def table(self, outcomes: Sequence[Outcome], out: Path) -> None:
        """Print one row a picture, one a target, one a body with landmarks, and where the files are."""
        wide = self._out.width >= WIDE_COLUMNS
        self._out.print(_pointing_table(outcomes, wide))
        bodies = [(o, body) for o in outcomes for body in o.result.get("bodies", ())]
        if bodies:
            self._out.print(_body_table(bodies, wide))
        searched = [(o, one) for o in outcomes for one in o.result.get("landmarks", ())]
        if searched:
            self._out.print(_landmark_table(searched))
        for outcome in outcomes:
            if outcome.result["status"] == "partial":
                for message in outcome.result["messages"]:
                    _print_note(self._out, outcome, message)
        self._out.print(f"Results in {shown(str(out))}/", highlight=False, soft_wrap=True)


def _print_note(console: Console, outcome: Outcome, message: str) -> None:
    words = f"[yellow]note[/] {shown(outcome.image.stem)}: {shown(message)}"
    console.print(words, highlight=False, soft_wrap=True)


def _named_error(outcome: Outcome) -> str:
    """The reason, led by the picture's name once."""
    name = plain_line(outcome.image.name)
    return outcome.error if name in outcome.error else f"{name}: {outcome.error}"


def _pointing_table(outcomes: Sequence[Outcome], wide: bool) -> Table:
    names = ("stars", "Δpixel", "Δline", "Δtwist°", "rms px", *(("RA°", "Dec°", "twist°") if wide else ()))
    table = plain_table("Pointing", ("picture", "status"), names)
    for outcome in outcomes:
        status = outcome.result["status"]
        row = [shown(outcome.image.stem), f"[{STATUS_STYLES[status]}]{status}[/]"]
        table.add_row(*row, *_pointing_cells(outcome.result.get("pointing"))[: len(names)])
    return table


def _pointing_cells(p: dict[str, Any] | None) -> list[str]:
    if p is None:
        return ["–"] * 8
    return [
        str(p["n_stars"]),
        f"{p['delta_pixel']:+.2f}",
        f"{p['delta_line']:+.2f}",
        f"{p['delta_twist_deg']:+.4f}",
        f"{p['rms_px']:.3f}" if p["n_stars"] else "–",
        f"{p['ra_deg']:.5f}",
        f"{p['dec_deg']:+.5f}",
        f"{p['twist_deg']:.3f}",
    ]


DIRECTION_FORMATS = (("ra_deg", ".6f"), ("dec_deg", "+.6f"))


def _body_table(rows: Sequence[tuple[Outcome, dict[str, Any]]], wide: bool) -> Table:
    ranges = any(_measured_without_ephemeris(body) for _, body in rows)
    names = ("pixel", "line", "σ", "σ", "O−C", "O−C", *(("RA°", "Dec°", "method") if wide else ()))
    names = (*names[:4], "range km", "σ", *names[6:]) if ranges else names
    table = plain_table(
        "Targets" if ranges else "Targets (O−C in px)", ("picture", "target", "status"), names
    )
    for outcome, body in rows:
        cells = [shown(outcome.image.stem), shown(body["name"]), body["status"].replace("_", " ")]
        table.add_row(*cells, *_body_cells(body, ranges=ranges)[: len(names)])
    return table


def _measured_without_ephemeris(body: dict[str, Any]) -> bool:
    return body["observed"] is not None and body["residual_px"] is None


def _body_cells(body: dict[str, Any], *, ranges: bool) -> list[str]:
    if body["observed"] is None:
        return [*["–"] * 8, body["method"]]
    return [
        *(f"{value:.3f}" for value in body["observed"]),
        *(f"{body['covariance_px2'][i][i] ** 0.5:.3f}" for i in (0, 1)),
        *(_range_cells(body) if ranges else [f"{value:+.3f}" for value in body["residual_px"]]),
        *(f"{body[name]:{how}}" if math.isfinite(body[name]) else "–" for name, how in DIRECTION_FORMATS),
        body["method"],
    ]


def _range_cells(body: dict[str, Any]) -> list[str]:
    """Range and its sigma where the picture tells it; what was expected stands in the result."""
    if not math.isfinite(body["measured_range_km"]):
        return ["–", "–"]
    return [f"{body['measured_range_km']:.6g}", f"{body['range_sigma_km']:.2g}"]


def _landmark_table(rows: Sequence[tuple[Outcome, dict[str, Any]]]) -> Table:
    """Landmarks by body, and where they put the spacecraft: how far from its a priori place, and the largest sigma."""
    numbers = ("accepted", "of", "rms px", "moved km", "σ km")
    table = plain_table("Landmarks", ("picture", "body"), numbers)
    for outcome, one in rows:
        accepted = sum(point["status"] == "accepted" for point in one["points"])
        counts = (str(accepted), str(len(one["points"])))
        table.add_row(shown(outcome.image.stem), shown(one["body"]), *counts, *_pose_cells(one["pose"]))
    return table


def _pose_cells(pose: dict[str, Any] | None) -> list[str]:
    if pose is None:
        return ["–"] * 3
    sigma = math.sqrt(float(np.linalg.eigvalsh(np.asarray(pose["covariance"])[:3, :3])[-1]))
    return [f"{pose['rms_px']:.3f}", f"{math.hypot(*pose['position_shift_km']):.4g}", f"{sigma:.2g}"]


# ---- ``opnav process``: pictures in, pointing and observables out.


@processing_options()
def process(
    images: Annotated[
        list[Path],
        typer.Argument(
            help="Pictures: FITS, VICAR, PDS, ISIS; PNG, TIFF, JPEG, raw with a sidecar.", show_default=False
        ),
    ],
    given: dict[str, Any],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("run"),
    figure: Annotated[
        bool,
        typer.Option(help="Draw summary.png; without, a picture's first second of processor time is saved."),
    ] = True,
) -> None:
    """Solve pointing and target centers of pictures.

    [bold]Example[/]

      opnav process lor_*.fit --mission new_horizons --kernels approach.tm --targets PLUTO,CHARON --out run

    Writes OUT/<picture>/ with result.json, observables.ecsv, session.json and summary.png.
    Exit status: 0 all pictures solved, 2 bad input, 3 some pictures failed (the others are kept).
    """
    outcomes = run_images(images, processing_of(given), out, figure=figure)
    if any(outcome.failed for outcome in outcomes):
        raise typer.Exit(EXIT_PARTLY)


def run_images(
    images: Sequence[Path], how: Processing, out: Path, *, figure: bool = True
) -> tuple[Outcome, ...]:
    """Process pictures one after the other with progress, and print what came out, also when Ctrl-C ends it.

    Raises
    ------
    OpNavError
        As `opnav_workbench.process`.
    """
    reporter, finished = Reporter(len(images)), list[Outcome]()

    def done(outcome: Outcome) -> None:
        finished.append(outcome)
        reporter.done(outcome)

    try:
        with reporter:
            finished[:] = process_images(images, how, out, reporter.say, done, figure=figure)
        return tuple(finished)
    finally:
        if finished:
            reporter.table(finished, out)
