"""``opnav export``: observables of processed pictures as one file for orbit determination."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from opnav_workbench.bodies.results import BODY_STATUSES
from opnav_workbench.cli.terminal import shown
from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.files import files_named
from opnav_workbench.mission import load_mission
from opnav_workbench.observables import (
    Observable,
    Origin,
    TdmOptions,
    read_ecsv,
    read_with_origins,
    write_csv,
    write_ecsv,
    write_observables_json,
    write_tdm,
)
from opnav_workbench.observables.files import observables_of_result, read_result
from opnav_workbench.paths import is_folder

__all__ = ["FORMATS", "export"]

FORMATS = ("tdm", "csv", "json", "ecsv")
TABLE, RESULT = "observables.ecsv", "result.json"
READABLE = (".ecsv", ".csv", ".json")
Told = tuple[tuple[Observable, ...], tuple[Origin, ...]]  # and how they came about

SourcesArgument = Annotated[
    list[Path],
    typer.Argument(help="Folders that opnav process wrote, or their result.json files.", show_default=False),
]
FormatOption = Annotated[
    str | None,
    typer.Option("--format", "-f", help=" | ".join(FORMATS) + "; default from --out.", show_default=False),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", "-o", help="File; default observables.FORMAT.", show_default=False)
]
TargetsOption = Annotated[
    str | None, typer.Option(help="Only these targets, comma-separated.", show_default=False)
]
MethodsOption = Annotated[
    str | None, typer.Option(help="Only these center methods, comma-separated.", show_default=False)
]
AberrationOption = Annotated[str, typer.Option(help="TDM: stellar aberration of the angles, removed | kept.")]
FrameOption = Annotated[str, typer.Option(help="TDM: name of the reference frame, ICRF | EME2000.")]
OriginatorOption = Annotated[str, typer.Option(help="TDM: agency, as registered with SANA.")]
ValidatedOption = Annotated[
    str,
    typer.Option(
        help="TDM: who has looked at the observables; they are VALIDATED then, else RAW.", show_default=False
    ),
]
SpacecraftOption = Annotated[
    str | None, typer.Option(help="Its name, where the results do not tell it.", show_default=False)
]


def export(
    sources: SourcesArgument,
    format_: FormatOption = None,
    out: OutOption = None,
    targets: TargetsOption = None,
    methods: MethodsOption = None,
    aberration: AberrationOption = "removed",
    frame: FrameOption = "ICRF",
    originator: OriginatorOption = "OPNAV_WORKBENCH",
    spacecraft: SpacecraftOption = None,
    validated_by: ValidatedOption = "",
) -> None:
    """Export observables of many pictures to one file.

    [bold]Examples[/]

      opnav export run --format tdm --out approach.tdm

      opnav export run/*/result.json --targets PLUTO --methods limb_scan --out pluto.csv

    tdm: CCSDS Tracking Data Message (503.0-B-2), right ascension, declination and range of every center found.

    csv, ecsv, json: everything, with partials and covariances; their headers say what each value is.
    """
    format_ = _format(format_, out)
    path = out or Path(f"observables.{format_}")
    found, origins = _all_observables(sources)
    chosen = sorted(_select(found, targets, methods), key=lambda o: (o.et, o.image))
    if spacecraft is not None:
        chosen = [replace(o, observer=spacecraft) for o in chosen]
    options = TdmOptions(
        aberration=aberration, frame=frame, originator=originator, validated_by=validated_by.strip()
    )
    writers: dict[str, Callable[[Sequence[Observable], Path, Sequence[Origin]], None]] = {
        "tdm": partial(write_tdm, options=options),
        "csv": write_csv,
        "json": write_observables_json,
        "ecsv": write_ecsv,
    }
    writers[format_](chosen, path, _origins_of(chosen, origins))
    Console(soft_wrap=True).print(_summary(chosen, path), highlight=False)


def _format(wanted: str | None, out: Path | None) -> str:
    name = wanted or (out.suffix.removeprefix(".") if out else "")
    if name not in FORMATS:
        what = f"unknown format {name!r}" if name else "no format given"
        raise SessionError(f"{what}; choose --format {' | '.join(FORMATS)}, or a file name that ends so.")
    return name


def _all_observables(sources: Sequence[Path]) -> tuple[list[Observable], list[Origin]]:
    """Observables of all sources, and how those of each file came about."""
    found: list[Observable] = []
    origins: list[Origin] = []
    for source in sources:
        for observables, told in _read_source(source):
            _check_meant(source, observables)
            found += observables
            origins += told
    return found, origins


def _check_meant(source: Path, observables: Sequence[Observable]) -> None:
    """Refuse what is no observable, though it can be read: a table whose columns were shifted."""
    for o in observables:
        if o.status not in BODY_STATUSES or not math.isfinite(o.et):
            raise SessionError(
                f"{source}, {o.image} {o.name}: status {o.status!r} at et {o.et} is no observable; opnav check tells more."
            )


def _origins_of(observables: Sequence[Observable], origins: Sequence[Origin]) -> list[Origin]:
    """Origins, with the pictures of chosen observables only."""
    chosen = {o.image for o in observables}
    named = [origin for origin in origins if chosen & set(origin.images)]
    return [replace(origin, images=tuple(i for i in origin.images if i in chosen)) for origin in named]


def _read_source(source: Path) -> Iterator[Told]:
    """Yield what each file of a folder of results (or folders of folders) tells, or one file."""
    if is_folder(source):
        tables = files_named(source, TABLE)
        if not tables:
            raise SessionError(
                f"{source} holds no {TABLE}; give a folder that opnav process wrote (--out there)."
            )
        for table in tables:
            observables, origins = _read_file(table)
            yield _with_spacecraft(observables, table.parent), origins
    elif source.name == RESULT:
        table = source.parent / TABLE
        result = read_result(source)
        read = read_ecsv(table) if table.is_file() else observables_of_result(result, str(source))
        yield _with_spacecraft(read, source.parent), (Origin.of_result(result),)
    elif source.suffix in READABLE:
        yield _read_file(source)
    else:
        raise SessionError(f"{source} is no folder and no {', '.join(READABLE)} file; nothing to export.")


def _read_file(file: Path) -> Told:
    """Read observables, and how they came about: as their own file tells it, else as the result beside it does."""
    observables, told = read_with_origins(file)
    result = file.parent / RESULT
    if told or not result.is_file():
        return observables, told
    return observables, (Origin.of_result(read_result(result)),)


def _with_spacecraft(observables: tuple[Observable, ...], folder: Path) -> tuple[Observable, ...]:
    """Take the spacecraft from the result's mission where an older table does not name it."""
    result = folder / RESULT
    if all(o.observer for o in observables) or not result.is_file():
        return observables
    try:
        name = load_mission(str(read_result(result).get("mission", ""))).spacecraft_name
    except MissionError:  # a mission file of the user's, elsewhere; --spacecraft says it
        return observables
    return tuple(o if o.observer else replace(o, observer=name) for o in observables)


def _select(observables: Sequence[Observable], targets: str | None, methods: str | None) -> list[Observable]:
    names, ways = (_name_set(words) for words in (targets, methods))
    chosen = [
        o
        for o in observables
        if (names is None or o.name.casefold() in names) and (ways is None or o.method.casefold() in ways)
    ]
    if not chosen:
        there = ", ".join(sorted({f"{o.name} ({o.method})" for o in observables})) or "none"
        raise SessionError(f"no observable to export; there are: {there}.")
    return chosen


def _name_set(words: str | None) -> set[str] | None:
    return None if words is None else {word.strip().casefold() for word in words.split(",") if word.strip()}


def _summary(observables: Sequence[Observable], path: Path) -> str:
    pictures = len({o.image for o in observables})
    centers = sum(o.observed_px is not None for o in observables)
    bodies = ", ".join(f"{name} {n}" for name, n in sorted(Counter(o.name for o in observables).items()))
    return (
        f"{shown(str(path))}: {len(observables)} observables of {pictures} pictures ({shown(bodies)}), "
        f"{centers} with a center"
    )
