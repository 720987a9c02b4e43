"""``opnav demo``: simulate approach pictures offline, process them, and hold the solution against the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench.cli.process import run_images
from opnav_workbench.cli.terminal import EXIT_PARTLY
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import Processing
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    DEMO_TARGETS,
    Comparison,
    compare,
    simulate_picture,
)
from opnav_workbench.simulation.truth import Truth

__all__ = ["demo"]

AGREES_SIGMAS = 3.0


def demo(
    out: Annotated[Path, typer.Option(help="Folder for pictures, truth and results.")] = Path("opnav_demo"),
    seed: Annotated[int, typer.Option(help="Another seed makes another pointing error and noise.")] = 0,
) -> None:
    """Simulate New Horizons approach pictures, process them, and print truth beside solution.

    Works offline, in well under a minute, with the same code that processes flight pictures.

    [bold]Example[/]

      opnav demo --out opnav_demo
    """
    console = Console(soft_wrap=False)
    mission = load_mission(DEMO_MISSION)
    console.print(
        "Simulating New Horizons on approach to Pluto: real stars, Pluto and Charon,\n"
        "detector noise, and a pointing error that the solver does not know.",
        highlight=False,
    )
    with KernelSet(DEMO_KERNELS):
        truths = [
            simulate_picture(r.reseeded(seed), mission, DEMO_CATALOG, out / "pictures") for r in DEMO_PICTURES
        ]
        how = Processing(mission=DEMO_MISSION, catalog=DEMO_CATALOG, targets=DEMO_TARGETS)
        outcomes = run_images([truth.picture for truth in truths], how, out)
    ok = True
    for request, truth, outcome in zip(DEMO_PICTURES, truths, outcomes, strict=True):
        rows = compare(truth, outcome.result, mission.camera_for(request.header))
        console.print(_comparison_table(truth, rows))
        ok &= bool(rows) and all(abs(row.sigmas) <= AGREES_SIGMAS for row in rows)
    console.print(
        f"[green]Every solved quantity is within {AGREES_SIGMAS:g} of its own sigmas of the truth.[/]"
        if ok
        else f"[bold red]A solved quantity is more than {AGREES_SIGMAS:g} sigmas from the truth.[/]",
        highlight=False,
    )
    console.print(f"Look at {out / truths[0].picture.stem / 'summary.png'}", highlight=False, soft_wrap=True)
    if not ok:
        raise typer.Exit(EXIT_PARTLY)


def _comparison_table(truth: Truth, rows: Sequence[Comparison]) -> Table:
    table = Table(
        title=f"Truth beside solution: {truth.picture.stem}",
        title_justify="left",
        box=None,
        header_style="bold",
        pad_edge=False,
    )
    table.add_column("quantity")
    for name in ("solved", "truth", "error", "predicted σ", "error / σ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit")
    for row in rows:
        style = "green" if abs(row.sigmas) <= AGREES_SIGMAS else "bold red"
        table.add_row(
            row.name,
            f"{row.solved:.4f}",
            f"{row.truth:.4f}",
            f"{row.error:+.4f}",
            f"{row.sigma:.4f}",
            f"[{style}]{row.sigmas:+.2f}[/]",
            row.unit,
        )
    return table
