"""``opnav kernels``: what there is, what it covers, kernels fetched, made and told about, and used.

list, check, fetch, brief  about kernels; check exits with 3 where something is missing or does not cover the time
make                       kernels of a scenario, or the DSK of a shape model
make-ck                    solved pointings of a run as a reconstructed CK
make-isd                   the same as image support data (JSON) for mapping programs
geometry                   times, states, attitude and targets at an epoch
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from opnav_workbench import report
from opnav_workbench.camera import Camera
from opnav_workbench.cli.kernel_tables import (
    print_brief,
    print_check,
    print_fetched,
    print_kernel_sets,
    print_made,
)
from opnav_workbench.cli.terminal import EXIT_PARTLY, shown
from opnav_workbench.downloads import Progress as DownloadProgress
from opnav_workbench.errors import KernelError, OpNavError, SessionError, counted
from opnav_workbench.files import json_text, make_folder, read_json, write_json
from opnav_workbench.kernels import (
    FetchedKernels,
    KernelKind,
    KernelSet,
    ManifestKernel,
    body_id,
    brief,
    check_kernels,
    et_from_utc,
    fetch_kernels,
    kernel_sets,
    known_names,
    make_kernels,
    match_kinds,
    packaged_leap_seconds,
)
from opnav_workbench.kernels.dsk_files import write_dsk
from opnav_workbench.kernels.kernel_set import unknown_name
from opnav_workbench.kernels.shape_files import read_shape
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.paths import exists, is_file
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import GeometryReport, geometry_report
from opnav_workbench.session import (
    RESULT_FILE,
    Reconstruction,
    support_data_of_result,
    write_reconstructed_ck,
)

__all__ = ["geometry", "kernels_app", "make_ck", "make_isd"]


# ---- What ``opnav kernels make`` does: kernels of a scenario, or the DSK of a shape model.


def make_from_scenario(source: str, out: Path | None, *, actual: bool) -> tuple[list[Path], list[Path]]:
    """Make the kernels of a scenario file or of a kernel set by name; return them and the metakernels.

    Raises
    ------
    MissionError, KernelError
        See `opnav_workbench.kernels.make_kernels`.
    """
    named = kernels_meta_dir() / f"{source}.yaml"
    scenario = named if source in known_names() and named.is_file() else Path(source)
    if not exists(scenario) and not scenario.suffix:
        raise KernelError(unknown_name(source))
    folder = out or Path("kernels") / scenario.stem
    metakernel = make_kernels(scenario, folder, actual=actual)
    metakernels = [metakernel, *([metakernel.with_stem(f"{metakernel.stem}_actual")] if actual else [])]
    files = dict.fromkeys(f.path for m in metakernels for f in KernelSet(m).kernels() if f.kind != "META")
    return list(files), metakernels


def make_from_shape(
    shape: Path,
    out: Path | None,
    body: str | None,
    number: int | None,
    frame: str,
    unit: str,
    kernels: str | None,
) -> Path:
    """Write the DSK of a shape model and return its path.

    Raises
    ------
    KernelError
        The file is no shape model, body or frame are unknown, or the DSK cannot be written.
    """
    path = out or shape.with_suffix(".bds")
    vertices_km, plates = read_shape(shape, unit)
    with ExitStack() as stack:
        stack.enter_context(KernelSet(kernels or stack.enter_context(packaged_leap_seconds())))
        target = number if number is not None else body_id(str(body))
        write_dsk(path, vertices_km, plates, target, frame)
    return path


# ---- ``opnav kernels make-ck`` and ``opnav kernels geometry``.

CK_FILE = "reconstructed.bc"
YAML_SUFFIXES = (".yaml", ".yml")
RunFolder = Annotated[Path, typer.Argument(help="Folder that opnav process wrote.", show_default=False)]
ResultsMission = Annotated[
    str | None,
    typer.Option(
        "--mission", "-m", help="Mission name or YAML; default the results' own.", show_default=False
    ),
]


def make_ck(
    run_dir: RunFolder,
    out: Annotated[
        Path | None, typer.Option(help=f"The CK; default RUN_DIR/{CK_FILE}.", show_default=False)
    ] = None,
    kernels: Annotated[
        str | None,
        typer.Option(
            help="Metakernel, kernel folder or kernel-set name: LSK, SCLK and FK.", show_default=False
        ),
    ] = None,
    mission: ResultsMission = None,
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
    results = _results_of_run(run_dir)
    with ExitStack() as stack:
        if kernels is not None:
            stack.enter_context(KernelSet(kernels))
        written = write_reconstructed_ck(
            results,
            out or run_dir / CK_FILE,
            None if mission is None else load_mission(mission),
            without_twist=without_twist,
        )
    _print_reconstruction(written)


def make_isd(
    run_dir: RunFolder,
    target: Annotated[
        str,
        typer.Option("--target", "-t", help="Body that the pictures shall be mapped on.", show_default=False),
    ],
    kernels: Annotated[
        str,
        typer.Option(help="Metakernel, kernel folder or kernel-set name: SPK and PCK.", show_default=False),
    ],
    mission: ResultsMission = None,
    out: Annotated[Path | None, typer.Option(help="Folder; default RUN_DIR.", show_default=False)] = None,
) -> None:
    """Write solved pictures as image support data (JSON) of the Community Sensor Model.

    [bold]Example[/]

      opnav kernels make-isd run --target PLUTO --kernels new_horizons/pluto_approach

    One NAME.isd.json for each picture, as ALE writes them for ISIS, SOCET GXP and the Ames Stereo Pipeline.
    """
    console, failed = Console(soft_wrap=True), False
    with KernelSet(kernels):
        for result in _results_of_run(run_dir):
            name = Path(str(result["image"])).stem
            try:
                content = support_data_of_result(
                    result, load_mission(mission or str(result["mission"])), target
                )
            except OpNavError as error:
                failed = True
                console.print(f"[yellow]left out[/] {shown(name)}: {shown(str(error))}", highlight=False)
                continue
            path = make_folder(out or run_dir) / f"{name}.isd.json"
            write_json(path, content)
            console.print(f"[green]{shown(str(path))}[/]", highlight=False)
    if failed:
        raise typer.Exit(EXIT_PARTLY)


def _results_of_run(run_dir: Path) -> list[dict[str, Any]]:
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
    return [_read_result(path) for path in files]


def _read_result(path: Path) -> dict[str, Any]:
    result = read_json(path, "process the picture again.")
    if not {"image", "mission", "camera"} <= set(result):
        raise SessionError(f"{path} is not the result of a picture; process the picture again.")
    return result


def _print_reconstruction(written: Reconstruction) -> None:
    console = Console(soft_wrap=True)
    count = len(written.pictures)
    console.print(
        f"[green]{shown(str(written.path))}[/]: attitude of {shown(written.frame)} ({written.structure_id}) from "
        f"{counted(count, 'picture')}",
        highlight=False,
    )
    for name, why in written.skipped:
        console.print(f"[yellow]left out[/] {shown(name)}: {shown(why)}", highlight=False)
    if written.note:
        console.print(f"[yellow]note[/] {shown(written.note)}", highlight=False)


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
    seen_by = None if camera is None else _named_camera(known, camera)
    with KernelSet(kernels) as opened:
        et = et_from_utc(time)
        found = geometry_report(
            et,
            known.spacecraft_id,
            _target_names(targets) if targets is not None else _covered_targets(known, opened, et),
            seen_by,
            clock_id=known.clock_id,
            center=center or known.reference_body,
            frame=frame,
        )
    _print_geometry(found, as_json)


def _named_camera(mission: Mission, name: str) -> Camera:
    return Camera.from_yaml(name) if Path(name).suffix in YAML_SUFFIXES else mission.camera_named(name)


def _target_names(targets: str) -> list[str]:
    return [name.strip() for name in targets.split(",") if name.strip()]


def _covered_targets(mission: Mission, kernels: KernelSet, et: float) -> list[str]:
    """Return those of the mission's targets that the kernels know at that time."""
    return [
        name for name in mission.default_targets if _covers_target(kernels, name, mission.spacecraft_id, et)
    ]


def _covers_target(kernels: KernelSet, name: str, spacecraft: int, et: float) -> bool:
    try:
        return kernels.covers_state(name, spacecraft, et, "CN")
    except KernelError:  # nobody knows the name
        return False


def _print_geometry(found: GeometryReport, as_json: bool) -> None:
    console = Console(soft_wrap=True)
    if as_json:
        console.print(json_text(found.as_dict()), markup=False, highlight=False)
        return
    for line in found.text().splitlines():
        heading = bool(line) and not line.startswith((" ", "note:"))
        console.print(f"[bold]{shown(line)}[/]" if heading else shown(line), highlight=False)


# ---- ``opnav kernels``: what there is, what it covers, and kernels fetched, made and told about.

SHAPE_SUFFIXES = (".obj", ".cmod")

kernels_app = typer.Typer(
    name="kernels",
    help="SPICE kernels: list, check, fetch and make them, look into them, and use them.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
KernelsArgument = Annotated[
    list[str],
    typer.Argument(help="Metakernel, kernel folder, kernel files or kernel-set name.", show_default=False),
]


@kernels_app.command("list")
def list_() -> None:
    """List the kernel sets that come with the package, and the flight kernels that can be fetched.

    [bold]Example[/]

      opnav kernels list
    """
    print_kernel_sets(Console(), kernel_sets())


@kernels_app.command()
def check(
    kernels: KernelsArgument,
    time: Annotated[
        str | None,
        typer.Option(help="UTC, clock reading (3/0299171897:00000) or TDB s past J2000.", show_default=False),
    ] = None,
    mission: Annotated[
        str | None,
        typer.Option(
            "--mission",
            "-m",
            help="Ask about this mission's spacecraft and targets only.",
            show_default=False,
        ),
    ] = None,
    targets: Annotated[
        str | None, typer.Option(help="Ask about these bodies only, comma-separated.", show_default=False)
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(help="Ask about the attitude of this frame only: NH_LORRI.", show_default=False),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the coverage as PNG.", show_default=False)
    ] = None,
) -> None:
    """Show what kernels cover and what they lack, kind by kind and at a time.

    Exit status 3 where one of the eight kinds is missing, or something does not cover the time.

    [bold]Example[/]

      opnav kernels check new_horizons/pluto_approach --time 2015-07-09T04:29:00 -m new_horizons
    """
    bodies = [t.strip() for t in targets.split(",") if t.strip()] if targets else []
    spacecraft = None
    if mission is not None:
        about = load_mission(mission)
        spacecraft, bodies = about.spacecraft_id, bodies or list(about.default_targets)
        camera = camera or about.bus_frame
    found = check_kernels(kernels, time, spacecraft=spacecraft, targets=bodies, frame=camera)
    with packaged_leap_seconds() as lsk, KernelSet(lsk):
        print_check(Console(), found)
        if picture is not None:
            report.write_coverage(found, picture)
            Console().print(f"Written: {shown(str(picture))}", highlight=False, soft_wrap=True)
    if not found.ok:
        raise typer.Exit(EXIT_PARTLY)


@kernels_app.command()
def fetch(
    mission: Annotated[str, typer.Argument(help="Mission name or manifest YAML.", show_default=False)],
    only: Annotated[
        str | None,
        typer.Option(
            help="Only these kinds, comma-separated: LSK, SCLK, PCK, FK, IK, SPK, CK.", show_default=False
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Folder; by default the cache, where MISSION/flight names them.", show_default=False
        ),
    ] = None,
) -> None:
    """Fetch a mission's flight kernels from NASA's archive; what is here already is verified, not fetched again.

    A fetch that was stopped goes on where it was. Every file is held to its SHA-256.

    [bold]Example[/]

      opnav kernels fetch generic --only LSK
    """
    kinds = tuple(kind for word in only.split(",") for kind in match_kinds(word)) if only else ()
    console = Console()
    fetched = _fetch_with_progress(mission, into, kinds)
    print_fetched(console, fetched)
    name = f"{fetched.manifest.mission}/flight" if into is None else str(fetched.metakernel)
    console.print(f"Look at them: opnav kernels check {shown(name)}", highlight=False, soft_wrap=True)


def _fetch_with_progress(mission: str, into: Path | None, kinds: tuple[KernelKind, ...]) -> FetchedKernels:
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:

        def begin(kernel: ManifestKernel) -> DownloadProgress:
            task = bars.add_task(kernel.file, total=kernel.size)
            return lambda there, total: bars.update(task, completed=there, total=total)

        return fetch_kernels(mission, into, kinds=kinds, progress=begin)


@kernels_app.command()
def make(
    source: Annotated[
        str,
        typer.Argument(
            help="Scenario YAML, kernel-set name, or shape model (.obj, .cmod).", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder, by default kernels/NAME; or the DSK file.", show_default=False),
    ] = None,
    actual: Annotated[
        bool, typer.Option("--actual", help="Also the attitudes as flown, with the scenario's errors.")
    ] = False,
    body: Annotated[
        str | None, typer.Option(help="Shape model: the body's name.", show_default=False)
    ] = None,
    body_id: Annotated[
        int | None,
        typer.Option(
            help="Shape model: its NAIF number, if SPICE does not know the name.", show_default=False
        ),
    ] = None,
    frame: Annotated[
        str | None, typer.Option(help="Shape model: its body-fixed frame.", show_default=False)
    ] = None,
    unit: Annotated[str, typer.Option(help="Shape model: km or m.")] = "km",
    kernels: Annotated[
        str | None, typer.Option(help="Shape model: kernels that define body and frame.", show_default=False)
    ] = None,
) -> None:
    """Make every kernel of a scenario and its metakernel, or a DSK of a shape model.

    [bold]Example[/]

      opnav kernels make new_horizons/pluto_approach --out kernels

      opnav kernels make bennu.obj --body BENNU --body-id 2101955 --frame IAU_BENNU --out bennu.bds
    """
    console = Console()
    if Path(source).suffix.lower() in SHAPE_SUFFIXES:
        if frame is None or (body is None and body_id is None):
            raise KernelError(
                f"{source} is a shape model: say --body (or --body-id) and --frame, such as IAU_BENNU."
            )
        print_made(console, [make_from_shape(Path(source), out, body, body_id, frame, unit, kernels)], [])
        return
    files, metakernels = make_from_scenario(source, out, actual=actual)
    print_made(console, files, metakernels)


@kernels_app.command("brief")
def brief_(
    files: Annotated[
        list[Path],
        typer.Argument(help="Kernels; an SCLK or FK among them helps to read a CK.", show_default=False),
    ],
    kernels: Annotated[
        str | None,
        typer.Option(help="Kernels that help to read: the SCLK of a CK, names.", show_default=False),
    ] = None,
) -> None:
    """Tell what kernels hold: bodies, frames, types, times, comments, variables.

    [bold]Example[/]

      opnav kernels brief attitude.bc clock.tsc
    """
    console = Console()
    helpers = [*KernelSet(kernels).paths] if kernels is not None else []
    helpers += [path for path in files if path.suffix.lower() in (".tsc", ".tf") and is_file(path)]
    for number, path in enumerate(files):
        if number:
            console.print()
        print_brief(console, brief(path, helpers))


kernels_app.command()(geometry)
kernels_app.command("make-ck")(make_ck)
kernels_app.command("make-isd")(make_isd)
