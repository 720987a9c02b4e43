"""Camera files.

One camera file describes one camera in one readout mode. `opnav_workbench.camera.schema` holds its schema,
and the files under ``kernels_meta/<mission>/cameras`` are its examples. A number that nobody knows is null.
"""

from os import PathLike
from pathlib import Path
from typing import Any

from opnav_workbench.camera.schema import CameraFile
from opnav_workbench.errors import CameraError
from opnav_workbench.yaml_file import read_model

__all__ = ["camera_fields"]


def camera_fields(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of `opnav_workbench.camera.Camera` that a camera file gives.

    Raises
    ------
    CameraError
        The file cannot be read or breaks the schema.
    """
    file = read_model(path, CameraFile, "camera file", CameraError)
    try:
        return file.fields(Path(path).parent)
    except CameraError as error:
        raise CameraError(f"camera file {path}: {error}") from error
