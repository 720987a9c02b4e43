"""``opnav catalog``: which star catalogs there are, what stands in them, and getting them."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from opnav_workbench import report
from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import (
    Catalog,
    StarQuality,
    StarTable,
    catalog_status,
    fetch_whole_sky,
    open_catalog,
    open_vizier,
)
from opnav_workbench.cli.terminal import folding_table, shown
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.files import atomic_path, json_text
from opnav_workbench.geometry import et_from_jyear, radec_from_unit

__all__ = ["catalog_app"]

SHOWN_STARS = 25  # stars in the printed table; --all shows every one
EPOCHS = (1000.0, 3000.0)
WIDE_COLUMNS = 105  # a terminal this wide has room for colors, motions and flags
WIDE_NAMES = ("B−V", "μα* mas/yr", "μδ mas/yr", "flags")

catalog_app = typer.Typer(
    name="catalog",
    help="Star catalogs: list, info, build, fetch, cone.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

SpecArgument = Annotated[
    str, typer.Argument(help="Catalog spec, such as bundled, tycho2:DIR or ucac4:DIR.", show_default=False)
]


@catalog_app.command("list")
def list_catalogs() -> None:
    """List the kinds of catalogs, and what of each is found here.

    [bold]Example[/]

      opnav catalog list
    """
    table = folding_table(("spec", "", "detail"))
    for status in catalog_status():
        mark = "[green]ok[/]" if status.available else "[yellow]missing[/]"
        table.add_row(shown(status.form), mark, shown(status.detail))
    console = Console()
    console.print(table)
    console.print("Join specs with + to merge catalogs, such as bundled+tycho2:DIR.", highlight=False)


@catalog_app.command()
def info(spec: SpecArgument) -> None:
    """Show what a catalog is: source, stars, magnitudes, epochs.

    [bold]Example[/]

      opnav catalog info bundled
    """
    _print_facts(_open_with_progress(spec))


@catalog_app.command()
def build(spec: SpecArgument) -> None:
    """Convert a text catalog into its cache file now, not at its first use.

    [bold]Example[/]

      opnav catalog build tycho2:catalogs/tycho2
    """
    _print_facts(_open_with_progress(spec))


@catalog_app.command()
def fetch(
    name: Annotated[
        str,
        typer.Argument(help="The whole sky: tycho2, gaia; a cone of VizieR: gaia-dr3, tycho2, ucac4, hip2."),
    ],
    cone: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="RA, Dec and radius, degrees; without it the whole sky.", show_default=False),
    ] = None,
    mag: Annotated[
        float | None, typer.Option("--mag", "--mag-limit", help="Faintest magnitude.", show_default=False)
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Another web folder with the whole sky's files, or TAP service.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Fetch the whole sky of a catalog once, part of bundled from then on; or a cone, which vizier:NAME serves offline.

    What was fetched before a cut is kept: call it again.

    [bold]Example[/]

      opnav catalog fetch tycho2 --mag-limit 12

      opnav catalog fetch gaia --mag-limit 13

      opnav catalog fetch gaia-dr3 --cone 217.39 -62.68 0.5 --mag 16
    """
    console = Console()
    if cone is None:
        with Console(stderr=True).status(f"fetching {shown(name)}") as status:
            whole = fetch_whole_sky(
                name, mag, url, lambda what, done: status.update(f"{shown(what)} {done:.0%}")
            )
        n_stars = whole.describe()["n_stars"]
        console.print(
            f"{n_stars} stars of {shown(name)} kept; bundled has them from now on.", highlight=False
        )
        return
    catalog = open_vizier(name)
    with Console(stderr=True).status(f"asking VizieR for {shown(name)}"):
        n_stars = catalog.fetch(*cone, mag)
    console.print(
        f"{n_stars} stars of {shown(name)} kept in {shown(str(catalog.folder))}; use --catalog vizier:{shown(name)}",
        highlight=False,
    )


@catalog_app.command(
    context_settings={"ignore_unknown_options": True}
)  # negative declinations are no options
def cone(
    spec: SpecArgument,
    ra: Annotated[float, typer.Argument(help="Degrees, J2000.", show_default=False)],
    dec: Annotated[float, typer.Argument(help="Degrees, J2000.", show_default=False)],
    radius: Annotated[float, typer.Argument(help="Degrees.", show_default=False)],
    epoch: Annotated[
        float | None, typer.Option(help="Julian year of the places, such as 2015.5.", show_default=False)
    ] = None,
    mag: Annotated[float, typer.Option(help="Faintest magnitude.", show_default=False)] = math.inf,
    exclude: Annotated[
        str | None,
        typer.Option(help="Leave out stars with these flags, such as DOUBLE,VARIABLE.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    every: Annotated[bool, typer.Option("--all", help="Print every star.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw a chart into this PNG.", show_default=False)] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write all columns to this ECSV.", show_default=False)
    ] = None,
) -> None:
    """Show the stars within RADIUS of a direction, brightest first.

    Places are those of --epoch seen from the solar system's barycenter, without it the catalog's own.

    [bold]Example[/]

      opnav catalog cone bundled 268.4475 -34.792 0.3 --epoch 2006.66 --mag 9 --plot m7.png
    """
    # The catalogs take any angle, and a misprint would show another part of the sky.
    if not 0.0 <= ra <= 360.0:
        raise CatalogError(f"ra {ra:g} deg is no right ascension; give 0 to 360 deg.")
    if math.isnan(mag):
        raise CatalogError("the magnitude is no number; give the faintest, such as 9.5.")
    et_s = _et(epoch)
    center = ra * RAD_PER_DEG, dec * RAD_PER_DEG, radius * RAD_PER_DEG
    stars = _open_with_progress(spec).cone(*center, mag, et_s, _flags(exclude))
    if plot is not None:
        report.write_star_chart(plot, stars, *center, et_s)
    if out is not None:
        _write_ecsv(out, stars)
    if as_json:
        typer.echo(json_text({"catalog": spec, "epoch_jyear": epoch, "stars": list(_rows(stars, et_s))}))
    else:
        _print_stars(stars, et_s, every=every)
        for path in (plot, out):
            if path is not None:
                Console().print(f"Written: {shown(str(path))}", highlight=False, soft_wrap=True)


def _open_with_progress(spec: str) -> Catalog:
    with _conversion_progress(spec) as tell:
        return open_catalog(spec, tell)


@contextmanager
def _conversion_progress(spec: str) -> Iterator[Any]:
    """Show a bar as soon as a conversion reports; opening a ready catalog shows nothing."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(f"reading {shown(spec)}", total=1.0, visible=False)
        yield lambda done: progress.update(task, completed=done, visible=True)


def _et(epoch: float | None) -> float | None:
    if epoch is None:
        return None
    if not EPOCHS[0] <= epoch <= EPOCHS[1]:
        raise CatalogError(f"the epoch {epoch} is no Julian year; give one such as 2015.5.")
    return float(et_from_jyear(epoch))


def _flags(names: str | None) -> StarQuality:
    flags = StarQuality(0)
    for name in (part.strip().upper() for part in (names or "").split(",") if part.strip()):
        if name not in StarQuality.__members__:
            raise CatalogError(f"unknown flag {name}; use {', '.join(StarQuality.__members__)}.")
        flags |= StarQuality[name]
    return flags


def _print_facts(catalog: Catalog) -> None:
    console = Console()
    facts = dict(catalog.describe())
    parts = facts.pop("parts", ())  # of a merged catalog, each a catalog of its own
    for number, told in enumerate((facts, *parts)):
        table = Table(box=None, show_header=False, pad_edge=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        for key, value in told.items():
            table.add_row(key.replace("_", " "), shown(_fact_words(value)))
        if number:
            console.print()
        console.print(table)


def _fact_words(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return "unknown" if math.isnan(value) else f"{value:.2f}".rstrip("0").rstrip(".")
    if isinstance(value, dict):
        return ", ".join(f"{k} {_fact_words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return "; ".join(_fact_words(v) for v in value) or "none"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _places_deg(stars: StarTable, et_s: float | None) -> tuple[Any, Any]:
    if et_s is None or len(stars) == 0:
        return np.degrees(stars.ra_rad), np.degrees(stars.dec_rad)
    ra, dec = radec_from_unit(stars.directions(et_s))
    return np.degrees(ra), np.degrees(dec)


def _place_sigmas_rad(stars: StarTable, et_s: float | None) -> FloatArray:
    """Return the sigmas (n, 2) of the places shown: at another epoch the motion's uncertainty is in them."""
    if et_s is None or len(stars) == 0:
        return stars.sigma[:, :2]
    covariance = stars.sky_covariance(et_s)
    return np.sqrt(covariance[:, [0, 1], [0, 1]])


def _rows(stars: StarTable, et_s: float | None) -> Iterator[dict[str, Any]]:
    ra, dec = _places_deg(stars, et_s)
    sigma_mas = _place_sigmas_rad(stars, et_s) / RAD_PER_MAS
    for i in range(len(stars)):
        known = bool(stars.motion_known[i])
        yield {
            "id": str(stars.id[i]),
            "ra_deg": ra[i],
            "dec_deg": dec[i],
            "mag": stars.mag[i],
            "band": str(stars.band[i]),
            "v_mag": stars.v_mag[i],
            "b_v": stars.b_v[i],
            "pmra_mas_yr": stars.pmra_rad_yr[i] / RAD_PER_MAS,
            "pmdec_mas_yr": stars.pmdec_rad_yr[i] / RAD_PER_MAS,
            "motion_known": known,
            "parallax_mas": stars.parallax_rad[i] / RAD_PER_MAS,
            "rv_km_s": stars.rv_km_s[i],
            "epoch_jyear": stars.epoch_jyear[i],
            "sigma_mas": sigma_mas[i].tolist(),
            "flags": _flag_names(int(stars.flags[i])),
        }


def _flag_names(flags: int) -> list[str]:
    return [flag.name for flag in StarQuality if flag & flags and flag.name is not None]


def _print_stars(stars: StarTable, et_s: float | None, *, every: bool) -> None:
    console = Console()
    count = len(stars) if every else min(len(stars), SHOWN_STARS)
    table = Table(box=None, header_style="bold", pad_edge=False)
    wide = console.width >= WIDE_COLUMNS
    for name in ("star", "RA deg", "Dec deg", "mag", "σ mas", *(WIDE_NAMES if wide else ())):
        table.add_column(name, justify="left" if name in {"star", "flags"} else "right", no_wrap=True)
    for row in _rows(stars.take(slice(0, count)), et_s):
        cells = [
            shown(row["id"]),
            f"{row['ra_deg']:.6f}",
            f"{row['dec_deg']:+.6f}",
            f"{row['mag']:.2f} {row['band']}",
            f"{max(row['sigma_mas']):.2f}",
        ]
        table.add_row(*cells, *(_wide_cells(row) if wide else ()))
    console.print(table)
    rest = f"; the {count} brightest are shown, --all shows the others" if count < len(stars) else ""
    console.print(f"{len(stars)} stars{rest}", highlight=False)


def _wide_cells(row: dict[str, Any]) -> list[str]:
    motion = [f"{row[k]:.1f}" if row["motion_known"] else "?" for k in ("pmra_mas_yr", "pmdec_mas_yr")]
    color = "" if math.isnan(row["b_v"]) else f"{row['b_v']:.2f}"
    return [color, *motion, " ".join(row["flags"]).lower()]


def _write_ecsv(path: Path, stars: StarTable) -> None:
    with atomic_path(path) as temporary:
        stars.to_qtable().write(temporary, format="ascii.ecsv", overwrite=True)
