"""``opnav check``: files that people or other programs wrote, held against what they must be."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from opnav_workbench.cli.terminal import EXIT_BAD_INPUT, shown
from opnav_workbench.contracts import KINDS, check_file, write_schemas
from opnav_workbench.errors import SessionError

__all__ = ["check"]


def check(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="YAML files, result.json, session.json, status.json, exports.", show_default=False
        ),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            "--as", help=f"What they are, if it is not plain: {', '.join(KINDS)}.", show_default=False
        ),
    ] = None,
    schemas: Annotated[
        Path | None,
        typer.Option(help="Write the JSON Schema of every kind into this folder.", show_default=False),
    ] = None,
) -> None:
    """Check files that opnav reads or writes: one line for each fault, with its field.

    [bold]Examples[/]

      opnav check night.yaml my_camera.yaml run/*/result.json approach.tdm

      opnav check --schemas schemas   # for editors and other programs

    YAML files are also read as the program would read them: what they name must be there. Exit status 2: something
    is wrong.
    """
    console = Console(soft_wrap=True)
    if not files and schemas is None:
        raise SessionError("nothing to check; give files, or --schemas FOLDER.")
    if schemas is not None:
        written = write_schemas(schemas)
        console.print(f"{shown(str(schemas))}: {len(written)} schemas", highlight=False)
    if _faults(files or [], kind, console):
        raise typer.Exit(EXIT_BAD_INPUT)


def _faults(files: list[Path], kind: str | None, console: Console) -> int:
    """Print what is wrong with each file; return how many faults there are."""
    count = 0
    for file in files:
        name = shown(str(file))
        try:
            checked = check_file(file, kind)
        except SessionError as error:
            console.print(f"[red]{shown(str(error))}[/]", highlight=False)
            count += 1
            continue
        for fault in checked.faults:
            console.print(f"{name}: [red]{shown(fault)}[/]", highlight=False)
        if not checked.faults:
            console.print(f"{name}: {checked.what}, [green]sound[/]", highlight=False)
        count += len(checked.faults)
    return count
