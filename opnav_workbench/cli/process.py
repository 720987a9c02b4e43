"""``opnav process``: pictures in, pointing and observables out."""

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from opnav_workbench.cli.summary import Reporter
from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder
from opnav_workbench.headless import Decisions, Outcome, Policy, load_decisions, process_image
from opnav_workbench.mission import load_mission
from opnav_workbench.pointing.models import MODELS
from opnav_workbench.session import ATTITUDE_SOURCES, BODY_METHODS
from opnav_workbench.session.steps_stars import FINAL_METHODS
from opnav_workbench.spice import KernelSet

__all__ = ["EXIT_SOME_FAILED", "named_targets", "process", "run_images"]

EXIT_SOME_FAILED = 3


def process(
    images: Annotated[list[Path], typer.Argument(help="Pictures (FITS, VICAR).", show_default=False)],
    mission: Annotated[
        str, typer.Option("--mission", "-m", help="Mission name or mission YAML.", show_default=False)
    ],
    kernels: Annotated[
        str | None, typer.Option(help="Metakernel, kernel folder or kernel-set name.", show_default=False)
    ] = None,
    catalog: Annotated[str, typer.Option(help="Catalog spec; see opnav catalog list.")] = "bundled",
    targets: Annotated[
        str | None,
        typer.Option(
            help="Targets, comma-separated, each with its method if wanted (PLUTO:limb_scan,CHARON); default the "
            "mission's, with kernels.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[str, typer.Option(help="Body centers: " + " | ".join(BODY_METHODS))] = "auto",
    target_stars: Annotated[
        Path | None, typer.Option(help="YAML star list for stars that are targets.", show_default=False)
    ] = None,
    decisions: Annotated[
        Path | None,
        typer.Option(help="YAML of an analyst's decisions on stars, bodies and scans.", show_default=False),
    ] = None,
    attitude: Annotated[
        str, typer.Option(help="A priori attitude: " + " | ".join(ATTITUDE_SOURCES))
    ] = "auto",
    centers: Annotated[
        str, typer.Option(help="Star centers: " + " | ".join(FINAL_METHODS))
    ] = "least_squares",
    model: Annotated[str, typer.Option(help="Pointing model: " + " | ".join(MODELS))] = "euler",
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("run"),
) -> None:
    """Solve pointing and target centers of pictures.

    [bold]Example[/]

      opnav process lor_*.fit --mission new_horizons --kernels approach.tm --targets PLUTO,CHARON --out run

    Writes OUT/<picture>/ with result.json, observables.ecsv, session.json and summary.png.
    Exit status: 0 all pictures solved, 2 bad input, 3 some pictures failed (the others are kept).
    """
    named = None if targets is None else named_targets(targets)
    policy = Policy(
        mission=load_mission(mission),
        catalog=catalog,
        targets=None if named is None else list(named),
        method=method,
        methods={name: how for name, how in (named or {}).items() if how},
        target_stars=target_stars,
        attitude=attitude,
        final=centers,
        model=model,
        decisions=load_decisions(decisions) if decisions else Decisions(),
    )
    with ExitStack() as stack:
        if kernels is not None:
            stack.enter_context(KernelSet(kernels))
        outcomes = run_images(images, policy, out)
    if any(outcome.failed for outcome in outcomes):
        raise typer.Exit(EXIT_SOME_FAILED)


def named_targets(text: str) -> dict[str, str]:
    """Return targets with their methods (empty: as for all), from a list such as ``PLUTO:limb_scan,CHARON``.

    Raises
    ------
    SessionError
        A method is unknown.

    Examples
    --------
    >>> named_targets("PLUTO:limb_scan, CHARON")
    {'PLUTO': 'limb_scan', 'CHARON': ''}
    """
    pairs = [part.strip().partition(":") for part in text.split(",") if part.strip()]
    for name, colon, how in pairs:
        if colon and how.strip() not in BODY_METHODS:
            raise SessionError(
                f"target {name.strip()}: unknown method {how.strip()!r}; choose one of {', '.join(BODY_METHODS)}."
            )
    return {name.strip(): how.strip() for name, _, how in pairs}


def run_images(images: Sequence[Path], policy: Policy, out: Path) -> list[Outcome]:
    """Process pictures one after the other with progress, and print what came out.

    Raises
    ------
    SessionError
        Two pictures share a name (their results would share a folder), or `out` cannot be written.
    """
    _check_names(images)
    make_folder(out)
    outcomes = []
    with Reporter(len(images)) as reporter:
        for image in images:
            outcome = process_image(image, policy, out, partial(reporter.say, image.name))
            reporter.done(outcome)
            outcomes.append(outcome)
    reporter.table(outcomes, out)
    return outcomes


def _check_names(images: Sequence[Path]) -> None:
    twice = [name for name, count in Counter(image.stem for image in images).items() if count > 1]
    if twice:
        raise SessionError(
            f"more than one picture is named {', '.join(twice)}; process them in calls of their own, each with its --out."
        )
