"""What ``opnav kernels make`` does: kernels of a scenario, or the DSK of a shape model."""

from contextlib import ExitStack
from pathlib import Path

from opnav_workbench.errors import KernelError
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.spice import (
    KernelSet,
    body_id,
    known_names,
    make_kernels,
    packaged_leap_seconds,
)
from opnav_workbench.spice.dsk import write_dsk
from opnav_workbench.spice.shapes import read_shape
from opnav_workbench.spice.sources import unknown_name

__all__ = ["made_from_scenario", "made_from_shape"]


def made_from_scenario(source: str, out: Path | None, *, actual: bool) -> tuple[list[Path], list[Path]]:
    """Make the kernels of a scenario file or of a kernel set by name; return them and the metakernels.

    Raises
    ------
    MissionError, KernelError
        See `opnav_workbench.spice.make_kernels`.
    """
    named = kernels_meta_dir() / f"{source}.yaml"
    scenario = named if source in known_names() and named.is_file() else Path(source)
    if not scenario.exists() and not scenario.suffix:
        raise KernelError(unknown_name(source))
    folder = out or Path("kernels") / scenario.stem
    metakernel = make_kernels(scenario, folder, actual=actual)
    metakernels = [metakernel, *([metakernel.with_stem(f"{metakernel.stem}_actual")] if actual else [])]
    files = dict.fromkeys(f.path for m in metakernels for f in KernelSet(m).kernels() if f.kind != "META")
    return list(files), metakernels


def made_from_shape(
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
