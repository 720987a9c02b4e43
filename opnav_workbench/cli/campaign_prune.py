"""``opnav campaign prune``: a night's folder made smaller by age."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from opnav_workbench.cli.terminal import shown
from opnav_workbench.errors import SessionError
from opnav_workbench.headless.pruning import Retention, prune, superfluous

__all__ = ["prune_night"]

MB = 1e6


def prune_night(
    night: Annotated[Path, typer.Argument(help="Folder of a night.", show_default=False)],
    notebooks: Annotated[
        float | None,
        typer.Option(min=0.0, help="Days to keep executed notebooks of solved pictures.", show_default=False),
    ] = None,
    figures: Annotated[
        float | None,
        typer.Option(min=0.0, help="Days to keep the figures of solved pictures.", show_default=False),
    ] = None,
    attic: Annotated[
        float | None,
        typer.Option(min=0.0, help="Days to keep what nights put aside in .attic.", show_default=False),
    ] = None,
    delete: Annotated[bool, typer.Option("--delete", help="Do it; without this it is only told.")] = False,
) -> None:
    """Make a night's folder smaller: notebooks and figures that can be made again, and the attic, by age in days.

    [bold]Example[/]

      opnav campaign prune night --notebooks 30 --figures 365 --delete

    Results, observables, sessions and records stay for ever; so does all of a picture that is not solved, or that an analyst
    has worked on or has open. The attic holds what is not a night's own: it goes only with --attic.
    """
    keep = Retention(notebooks, figures, attic)
    if keep == Retention():
        raise SessionError("nothing to prune; give --notebooks, --figures or --attic with a number of days.")
    found = prune(night, keep) if delete else superfluous(night, keep)
    console = Console(soft_wrap=True)
    sizes: Counter[str] = Counter()
    for item in found:
        sizes[item.kind] += item.size_bytes
        if item.kind == "attic":
            console.print(shown(str(item.path)), highlight=False)
    numbers = Counter(item.kind for item in found)
    for kind, number in numbers.items():
        console.print(f"{number} {kind}: {sizes[kind] / MB:.1f} MB", highlight=False)
    total = sum(sizes.values()) / MB
    done = "deleted" if delete else "can go; --delete does it"
    console.print(f"{len(found)} files and folders, {total:.1f} MB {done}", highlight=False)
