"""Shape models of a scenario's bodies as DSK files."""

from pathlib import Path

from opnav_workbench.spice.attitude import body_frame
from opnav_workbench.spice.scenario_parts import Body, Shape

__all__ = ["write_shape"]


def write_shape(path: Path, body: Body, shape: Shape, folder: Path) -> None:
    """Write the DSK of a body; needs the scenario's FK in the active `KernelSet`.

    Raises
    ------
    KernelError
        The body has no body-fixed frame, or the file is no shape model.
    """
    from opnav_workbench.spice.dsk import write_dsk  # noqa: PLC0415
    from opnav_workbench.spice.shapes import read_shape  # noqa: PLC0415

    vertices_km, plates = read_shape(folder / shape.file, shape.unit)  # a full path stays what it is
    write_dsk(path, vertices_km, plates, body.id, body_frame(body.id))
