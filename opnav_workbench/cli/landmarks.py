"""``opnav landmarks``: maplets made from a shape, and what a file of maplets holds."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from opnav_workbench.cli.terminal import folding_table, shown
from opnav_workbench.errors import MissionError
from opnav_workbench.kernels import KernelSet, body_radii_km
from opnav_workbench.landmarks import Maplets, ellipsoid_shape, make_maplets
from opnav_workbench.mission import TargetSurface, load_mission
from opnav_workbench.render import AlbedoMap, ShapeModel

__all__ = ["landmarks_app"]

landmarks_app = typer.Typer(
    name="landmarks",
    help="Landmarks: make maplets of a body from its shape and albedo map, and show what a file of them holds.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
DEFAULT_SAMPLES = 49
ELLIPSOID_STEPS = (
    600  # of the half circumference, at most: finer plates than that show nothing of an ellipsoid
)


@landmarks_app.command()
def make(
    body: Annotated[str, typer.Argument(help="SPICE name of the body, such as BENNU.", show_default=False)],
    spacing: Annotated[
        str, typer.Option(help="Least distance between landmarks: 5deg, 0.02km or 20m.", show_default=False)
    ],
    shape: Annotated[
        Path | None,
        typer.Option(
            help="Shape model: OBJ, PLT, cmod, DSK, ...; without it the mission's.", show_default=False
        ),
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the shape file: km or m.")] = "km",
    radii: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Radii of an ellipsoid, km, where there is no shape.", show_default=False),
    ] = None,
    kernels: Annotated[
        str | None, typer.Option(help="Kernel set whose PCK has the radii.", show_default=False)
    ] = None,
    mission: Annotated[
        str | None,
        typer.Option(
            "--mission", "-m", help="Mission whose shape and albedo map are used.", show_default=False
        ),
    ] = None,
    albedo_map: Annotated[
        Path | None, typer.Option("--map", help="Equirectangular albedo map.", show_default=False)
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            help="Between samples, 0.3m or 0.0003km: best near the size of a pixel on the surface; by default so that a "
            "maplet is 1.5 spacings wide.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[int, typer.Option(help="Along a side of a maplet, odd.")] = DEFAULT_SAMPLES,
    sigma: Annotated[
        str | None,
        typer.Option(
            help="1 sigma of a place, each coordinate; by default a tenth of a sample.", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write; by default BODY.maplets.npz.", show_default=False)
    ] = None,
) -> None:
    """Cover a body with maplets: small patches with heights and albedo, which pictures are searched for.

    [bold]Example[/]

      opnav landmarks make BENNU --shape bennu.obj --spacing 5deg

      opnav landmarks make PLUTO --radii 1188.3 1188.3 1188.3 --map pluto.png --spacing 100km --scale 5km
    """
    surface = TargetSurface() if mission is None else load_mission(mission).target_surfaces.get(body)
    surface = TargetSurface() if surface is None else surface
    model, source = _shape(body, shape, unit, radii, kernels, surface, samples, spacing)
    mean_km = float(np.linalg.norm(model.vertices_km, axis=1).mean())
    albedo = None
    if albedo_map is not None:
        albedo = AlbedoMap.from_file(albedo_map)
        source += f", {albedo_map.name}"
    elif surface.albedo_map is not None:
        albedo = AlbedoMap.from_file(
            surface.albedo_map.file, **surface.albedo_map.model_dump(exclude={"file"})
        )
        source += f", {surface.albedo_map.file.name}"
    with Console(stderr=True).status(f"covering {shown(body)} with maplets"):
        maplets = make_maplets(
            body.upper(),
            model,
            _km(spacing, mean_km),
            scale_km=None if scale is None else _km(scale, mean_km),
            samples=samples,
            albedo=albedo,
            sigma_km=None if sigma is None else _km(sigma, mean_km),
            source=source,
        )
        path = maplets.write(Path(f"{body.upper()}.maplets.npz") if out is None else out)
    _print_maplets(path, maplets)


@landmarks_app.command()
def show(
    file: Annotated[Path, typer.Argument(help="File of maplets.", show_default=False)],
) -> None:
    """Show what a file of maplets holds.

    [bold]Example[/]

      opnav landmarks show BENNU.maplets.npz
    """
    _print_maplets(file, Maplets.read(file))


def _shape(
    body: str,
    shape: Path | None,
    unit: str,
    radii: tuple[float, float, float] | None,
    kernels: str | None,
    surface: TargetSurface,
    samples: int,
    spacing: str,
) -> tuple[ShapeModel, str]:
    """Return the surface to cover, and what it is made of."""
    if unit not in ("km", "m"):
        raise MissionError(f"--unit {unit}: give km or m.")
    if shape is not None:
        return ShapeModel.from_file(shape, unit), shape.name
    if radii is None and surface.shape is not None:
        return ShapeModel.from_file(surface.shape, surface.shape_unit), surface.shape.name
    if radii is None and kernels is not None:
        with KernelSet(kernels):
            a, b, c = body_radii_km(body)
            radii = (float(a), float(b), float(c))
    if radii is None:
        raise MissionError(
            f"the shape of {body} is unknown; give --shape FILE, --radii A B C, or --kernels with its PCK."
        )
    largest = max(radii)
    step = max(_km(spacing, float(np.mean(radii))) / samples, np.pi * largest / ELLIPSOID_STEPS)
    return ellipsoid_shape(list(radii), step), f"ellipsoid {radii[0]:g} x {radii[1]:g} x {radii[2]:g} km"


UNITS_KM = {"km": 1.0, "m": 1e-3, "deg": np.pi / 180.0}  # a degree of the mean radius


def _km(text: str, radius_km: float) -> float:
    """Return a length that was given as 20m, 0.02km or 5deg; a bare number is km."""
    plain = text.strip().lower()
    unit = next((u for u in ("deg", "km", "m") if plain.endswith(u)), "")
    try:
        number = float(plain.removesuffix(unit))
    except ValueError as error:
        raise MissionError(f"{text!r} is no length; give it as 5deg, 0.02km or 20m.") from error
    if not 0.0 < number < np.inf:
        raise MissionError(f"{text!r}: give a positive length, such as 5deg, 0.02km or 20m.")
    return number * UNITS_KM[unit or "km"] * (radius_km if unit == "deg" else 1.0)


def _print_maplets(path: Path, maplets: Maplets) -> None:
    table = folding_table(("maplets", ""))
    lon = np.degrees(np.arctan2(maplets.place_km[:, 1], maplets.place_km[:, 0])) % 360.0
    lat = np.degrees(np.arcsin(maplets.place_km[:, 2] / np.linalg.norm(maplets.place_km, axis=1)))
    relief = np.nanmax(maplets.heights_km, axis=(1, 2)) - np.nanmin(maplets.heights_km, axis=(1, 2))
    contrast = maplets.albedo.std(axis=(1, 2)) / maplets.albedo.mean(axis=(1, 2))
    spread = (
        f"latitude {lat.min():.1f} to {lat.max():.1f} deg, longitude {lon.min():.1f} to {lon.max():.1f} deg"
    )
    wide = f"{1e3 * np.median(maplets.scale_km):.4g} m apart, {2e3 * np.median(maplets.half_width_km):.4g} m wide"
    for name, value in (
        ("body", shown(maplets.body)),
        ("made from", shown(maplets.source) or "not said"),
        ("landmarks", f"{len(maplets)}, {spread}"),
        ("samples", f"{maplets.samples} x {maplets.samples}, {wide}"),
        ("relief", f"{1e3 * np.median(relief):.3g} m (median of highest minus lowest)"),
        ("albedo", f"contrast {np.median(contrast):.3f}" if contrast.max() > 0.0 else "uniform"),
        ("sigma of places", f"{1e3 * np.median(maplets.sigma_km):.3g} m"),
    ):
        table.add_row(name, value)
    console = Console()
    console.print(table)
    console.print(f"[bold]{shown(str(path))}[/]", highlight=False)
