"""``opnav kernels make-ck`` and ``opnav kernels geometry``: solved pointings as a CK, and the geometry of an epoch."""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import json_text
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.scene import GeometryReport, geometry_report
from opnav_workbench.session import RESULT_FILE, Reconstruction, write_reconstructed_ck
from opnav_workbench.spice import KernelSet, et_from_utc

__all__ = ["geometry", "make_ck"]

CK_FILE = "reconstructed.bc"
YAML_SUFFIXES = (".yaml", ".yml")


def make_ck(
    run_dir: Annotated[Path, typer.Argument(help="Folder that opnav process wrote.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help=f"The CK; default RUN_DIR/{CK_FILE}.", show_default=False)
    ] = None,
    kernels: Annotated[
        str | None,
        typer.Option(
            help="Metakernel, kernel folder or kernel-set name: LSK, SCLK and FK.", show_default=False
        ),
    ] = None,
    mission: Annotated[
        str | None,
        typer.Option(
            "--mission", "-m", help="Mission name or YAML; default the results' own.", show_default=False
        ),
    ] = None,
    without_twist: Annotated[
        bool,
        typer.Option("--without-twist", help="Take pictures whose stars left the twist open, too."),
    ] = False,
) -> None:
    """Write the solved pointings of a run as a reconstructed CK.

    [bold]Example[/]

      opnav kernels make-ck run --kernels new_horizons/pluto_approach --out pluto_reconstructed.bc

    Takes RUN_DIR/*/result.json. Each picture becomes an interval of its own that spans its exposure; the CK's comment
    lists the pictures with their sigmas. Load it after the predicted CK, so that it takes precedence.
    """
    results = _results(run_dir)
    with ExitStack() as stack:
        if kernels is not None:
            stack.enter_context(KernelSet(kernels))
        written = write_reconstructed_ck(
            results,
            out or run_dir / CK_FILE,
            None if mission is None else load_mission(mission),
            without_twist=without_twist,
        )
    _show(written)


def _results(run_dir: Path) -> list[dict[str, Any]]:
    """Read the results of a run, or of one picture.

    Raises
    ------
    SessionError
        There are none, or one of them cannot be read.
    """
    files = sorted(run_dir.glob(f"*/{RESULT_FILE}")) or sorted(run_dir.glob(RESULT_FILE))
    if not files:
        raise SessionError(
            f"no {RESULT_FILE} in the folders of {run_dir}; give a folder that opnav process wrote."
        )
    return [_result(path) for path in files]


def _result(path: Path) -> dict[str, Any]:
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SessionError(f"{path} cannot be read ({error}); process the picture again.") from error
    if not isinstance(result, dict) or not {"image", "mission", "camera"} <= set(result):
        raise SessionError(f"{path} is not the result of a picture; process the picture again.")
    return result


def _show(written: Reconstruction) -> None:
    console = Console(soft_wrap=True)
    count = len(written.pictures)
    console.print(
        f"[green]{escape(str(written.path))}[/]: attitude of {escape(written.frame)} ({written.structure_id}) from "
        f"{count} picture{'' if count == 1 else 's'}",
        highlight=False,
    )
    for name, why in written.skipped:
        console.print(f"[yellow]left out[/] {escape(name)}: {escape(why)}", highlight=False)
    if written.note:
        console.print(f"[yellow]note[/] {escape(written.note)}", highlight=False)


def geometry(
    kernels: Annotated[
        str, typer.Argument(help="Metakernel, kernel folder or kernel-set name.", show_default=False)
    ],
    mission: Annotated[
        str, typer.Option("--mission", "-m", help="Mission name or mission YAML.", show_default=False)
    ],
    time: Annotated[str, typer.Option(help="UTC, such as 2015-07-09T04:29:00.", show_default=False)],
    camera: Annotated[
        str | None,
        typer.Option(
            help="Camera of the mission, such as lorri_1x1, or a YAML; none: no attitude.", show_default=False
        ),
    ] = None,
    targets: Annotated[
        str | None,
        typer.Option(help="Bodies, comma-separated; default the mission's.", show_default=False),
    ] = None,
    center: Annotated[
        str | None,
        typer.Option(
            help="Body that states refer to; default the mission's reference body.", show_default=False
        ),
    ] = None,
    frame: Annotated[str, typer.Option(help="SPICE frame of the states.")] = "J2000",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show the geometry of an epoch: times, states, attitude, and each target as the camera sees it.

    [bold]Example[/]

      opnav kernels geometry new_horizons/pluto_approach -m new_horizons --camera lorri_1x1 --time 2015-07-09T04:29:00
    """
    known = load_mission(mission)
    seen_by = None if camera is None else _camera(known, camera)
    with KernelSet(kernels) as opened:
        et = et_from_utc(time)
        report = geometry_report(
            et,
            known.spacecraft_id,
            _asked(targets) if targets is not None else _covered(known, opened, et),
            seen_by,
            clock_id=known.clock_id,
            center=center or known.reference_body,
            frame=frame,
        )
    _print(report, as_json)


def _camera(mission: Mission, name: str) -> Camera:
    return Camera.from_yaml(name) if Path(name).suffix in YAML_SUFFIXES else mission.camera_named(name)


def _asked(targets: str) -> list[str]:
    return [name.strip() for name in targets.split(",") if name.strip()]


def _covered(mission: Mission, kernels: KernelSet, et: float) -> list[str]:
    """Return those of the mission's targets that the kernels know at that time."""
    return [name for name in mission.default_targets if _covers(kernels, name, mission.spacecraft_id, et)]


def _covers(kernels: KernelSet, name: str, spacecraft: int, et: float) -> bool:
    try:
        return kernels.covers_state(name, spacecraft, et, "CN")
    except KernelError:  # nobody knows the name
        return False


def _print(report: GeometryReport, as_json: bool) -> None:
    console = Console(soft_wrap=True)
    if as_json:
        console.print(json_text(report.as_dict()), markup=False, highlight=False)
        return
    for line in report.text().splitlines():
        heading = bool(line) and not line.startswith((" ", "note:"))
        console.print(f"[bold]{escape(line)}[/]" if heading else escape(line), highlight=False)
