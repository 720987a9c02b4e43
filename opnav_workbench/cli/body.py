"""``opnav body solve``: a body's size, axes, pole, spin and center of figure from the pictures of an approach."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from opnav_workbench.cli.processing_options import processing_options
from opnav_workbench.cli.terminal import folding_table, named_progress, shown
from opnav_workbench.constants import DAY_S
from opnav_workbench.geometry import wrapped
from opnav_workbench.processing.body_sequence import BodyFromPictures, solve_body_of

__all__ = ["body_app"]

body_app = typer.Typer(
    name="body",
    help="Bodies from sequences of pictures: size, axes, pole, spin, center of figure.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@body_app.callback()
def body() -> None:
    """Bodies from sequences of pictures: size, axes, pole, spin, center of figure."""


Sigma = float | None


@body_app.command()
@processing_options(without=("targets", "method", "target_stars", "decisions"))
def solve(
    name: Annotated[str, typer.Argument(help="SPICE name of the body, such as BENNU.", show_default=False)],
    images: Annotated[list[Path], typer.Argument(help="Pictures of one approach.", show_default=False)],
    given: dict[str, Any],
    position_sigma: Annotated[
        Sigma, typer.Option(help="Of the ephemeris, each axis, km.", show_default="100")
    ] = None,
    velocity_sigma: Annotated[Sigma, typer.Option(help="Of it, km/s.", show_default="1e-5")] = None,
    size_sigma: Annotated[
        Sigma, typer.Option(help="Of the size, as a part of it.", show_default="the mission's, else 0.1")
    ] = None,
    axes_sigma: Annotated[
        Sigma, typer.Option(help="Of each axis beside the size.", show_default="the mission's, else 0.05")
    ] = None,
    pole_sigma: Annotated[Sigma, typer.Option(help="Of the pole, deg.", show_default="5")] = None,
    meridian_sigma: Annotated[
        Sigma,
        typer.Option(help="Of the prime meridian in the middle of the sequence, deg.", show_default="10"),
    ] = None,
    spin_sigma: Annotated[
        Sigma, typer.Option(help="Of the spin rate, as a part of it.", show_default="1e-3")
    ] = None,
    offset_sigma: Annotated[
        Sigma,
        typer.Option(help="Of the center of figure from that of mass, in mean radii.", show_default="0.02"),
    ] = None,
    passes: Annotated[int, typer.Option(min=1, max=10, help="How often outlines are read.")] = 3,
    albedo_map: Annotated[
        bool, typer.Option(help="Make the albedo map that the pictures show, some seconds a picture.")
    ] = True,
    out: Annotated[
        Path, typer.Option(help="Folder for PCK, albedo map, lines of the mission file and JSON.")
    ] = Path("body"),
) -> None:
    """Solve for a body, with the trajectory and the pictures' pointing, and write it as a PCK.

    Each picture's pointing comes from its stars. Its outline, and its landmarks where --landmarks gives maplets, go into one
    batch; then outlines are read again with the body that came out.

    [bold]Example[/]

      opnav body solve BENNU approach/*.fits -m osiris_rex --kernels approach.tm --position-sigma 5 --out bennu

      opnav process next.fits -m osiris_rex --kernels with_bennu.tm      # a metakernel that loads bennu/BENNU.tpc last
    """
    sigmas = {
        "position_sigma_km": position_sigma,
        "velocity_sigma_km_s": velocity_sigma,
        "size_sigma": size_sigma,
        "axes_sigma": axes_sigma,
        "pole_sigma_deg": pole_sigma,
        "meridian_sigma_deg": meridian_sigma,
        "spin_sigma": spin_sigma,
        "offset_sigma": offset_sigma,
    }
    with named_progress(Console(stderr=True, soft_wrap=True), (1 + passes) * len(images) + albedo_map) as say:
        found = solve_body_of(
            images, name, sigmas=sigmas, passes=passes, albedo=albedo_map, out=out, say=say, **given
        )
    _print(found, out)


def _print(found: BodyFromPictures, out: Path) -> None:
    console = Console(soft_wrap=True)
    table = folding_table((shown(found.body), "believed", "solved", "σ", "change/σ"))
    for row in _rows(found):
        table.add_row(*row)
    console.print(table)
    used = {r.image for r in found.solution.residuals if r.used}
    console.print(
        f"{len(used)} pictures; scatter of outlines beyond what they state {found.solution.excess_px:.2g} px",
        highlight=False,
    )
    for words in (*found.solution.words, *found.solution.messages):
        console.print(f"[yellow]{shown(words)}[/]", highlight=False)
    for name, reason in found.left_out:
        console.print(f"[yellow]left out[/] {shown(name)}: {shown(reason)}", highlight=False)
    if found.surface is not None:
        console.print(
            f"albedo map of {len(found.surface.images)} pictures, {100.0 * found.surface.seen_share:.0f} % of the surface",
            highlight=False,
        )
    console.print(f"[bold]{shown(str(out))}[/]: PCK, lines of the mission file, JSON, map", highlight=False)


def _rows(found: BodyFromPictures) -> list[tuple[str, ...]]:
    """Return name, before, after, sigma and change in sigmas of what a person asks for."""
    s, before = found.solution, found.solution.a_priori_rotation
    after, angle = s.rotation, np.sqrt(np.diag(s.rotation_covariance))
    rows = [
        (f"radius {axis}, km", s.a_priori_radii_km[k], s.radii_km[k], s.radii_sigma_km[k])
        for k, axis in enumerate("abc")
    ]
    deg_day = np.degrees(1.0) * DAY_S
    turned = float(wrapped(after.meridian_rad - before.meridian_rad))
    rows += [
        ("pole RA, deg", *np.degrees([before.pole_ra_rad, after.pole_ra_rad, angle[0]])),
        ("pole Dec, deg", *np.degrees([before.pole_dec_rad, after.pole_dec_rad, angle[1]])),
        (
            "prime meridian, mid-sequence, deg",
            *np.degrees([before.meridian_rad, before.meridian_rad + turned, angle[2]]),
        ),
        ("spin rate, deg/day", before.rate_rad_s * deg_day, after.rate_rad_s * deg_day, angle[3] * deg_day),
    ]
    rows += [
        (f"center of figure {a}, km", 0.0, s.offset_km[k], s.offset_sigma_km[k]) for k, a in enumerate("xyz")
    ]
    moved, sigma = s.state.state, np.sqrt(np.diag(s.covariance))
    rows += [(f"position {a}, km", 0.0, moved[k], sigma[k]) for k, a in enumerate("xyz")]
    rows += [(f"velocity {a}, km/s", 0.0, moved[3 + k], sigma[3 + k]) for k, a in enumerate("xyz")]
    return [
        (name, _number(old, sig), _number(new, sig), f"{sig:.2g}", f"{(new - old) / sig:+.1f}")
        for name, old, new, sig in rows
    ]


def _number(value: float, sigma: float) -> str:
    """Return a value with one digit more than its sigma makes known."""
    digits = int(np.clip(2 - np.floor(np.log10(sigma)), 0, 12))
    return f"{value:.{digits}f}"
