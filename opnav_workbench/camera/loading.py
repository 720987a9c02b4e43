"""Camera files: YAML in, the fields of a `Camera` out, with errors that name the file and the field.

One file describes one camera in one readout mode; `opnav_workbench.camera.schema` holds the schema, and the
files under ``kernels_meta/<mission>/cameras`` are its examples. A number that nobody knows is null.
"""

from os import PathLike
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from opnav_workbench.camera.schema import CameraFile
from opnav_workbench.errors import CameraError

__all__ = ["camera_fields"]

ERRORS_SHOWN = 3  # a file of the wrong kind breaks every rule at once; the first few tell the story


def camera_fields(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of `opnav_workbench.camera.Camera` that a camera file gives.

    Raises
    ------
    CameraError
        The file cannot be read or breaks the schema.
    """
    file = Path(path)
    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
        return CameraFile.model_validate(data).fields()
    except (OSError, UnicodeDecodeError) as error:
        raise CameraError(
            f"camera file {file} cannot be read: {error}; give the path of a camera YAML."
        ) from error
    except yaml.YAMLError as error:
        raise CameraError(f"camera file {file} is not YAML: {' '.join(str(error).split())}") from error
    except ValidationError as error:
        raise CameraError(f"camera file {file}: {_summary(error)}") from error
    except CameraError as error:
        raise CameraError(f"camera file {file}: {error}") from error


def _summary(error: ValidationError) -> str:
    problems = error.errors()
    shown = [
        f"{'.'.join(str(part) for part in p['loc']) or 'file'}: {p['msg']}" for p in problems[:ERRORS_SHOWN]
    ]
    more = len(problems) - len(shown)
    return "; ".join(shown) + (f"; and {more} more" if more > 0 else "")
