"""Description files: YAML in, a validated model out, with errors that name the file and the field.

One camera file describes one camera in one readout mode. `opnav_workbench.camera.schema` holds its schema,
and the files under ``kernels_meta/<mission>/cameras`` are its examples. A number that nobody knows is null.
"""

from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from opnav_workbench.camera.schema import CameraFile
from opnav_workbench.errors import CameraError, OpNavError

__all__ = ["camera_fields", "read_model"]

ERRORS_SHOWN = 3  # a file of the wrong kind breaks every rule at once; the first few tell the story

Model = TypeVar("Model", bound=BaseModel)


def camera_fields(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of `opnav_workbench.camera.Camera` that a camera file gives.

    Raises
    ------
    CameraError
        The file cannot be read or breaks the schema.
    """
    file = read_model(path, CameraFile, "camera file", CameraError)
    try:
        return file.fields()
    except CameraError as error:
        raise CameraError(f"camera file {path}: {error}") from error


def read_model(path: str | PathLike[str], model: type[Model], what: str, failure: type[OpNavError]) -> Model:
    """Read a YAML file into a pydantic model.

    Parameters
    ----------
    path : path-like
    model : type
        The schema.
    what : str
        What kind of file this is, for the message.
    failure : type
        The error to raise.

    Raises
    ------
    OpNavError
        Of type `failure`: the file cannot be read, is not YAML or breaks the schema.
    """
    try:
        return model.model_validate(yaml.safe_load(Path(path).read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise failure(f"{what} {path} cannot be read: {error}; give the path of a YAML file.") from error
    except yaml.YAMLError as error:
        raise failure(f"{what} {path} is not YAML: {' '.join(str(error).split())}") from error
    except ValidationError as error:
        raise failure(f"{what} {path}: {_summary(error)}") from error


def _summary(error: ValidationError) -> str:
    problems = error.errors()
    places = [".".join(str(part) for part in problem["loc"]) or "whole file" for problem in problems]
    texts = [f"{place}: {problem['msg']}" for place, problem in zip(places, problems, strict=True)]
    more = [f"and {len(texts) - ERRORS_SHOWN} more"] if len(texts) > ERRORS_SHOWN else []
    return "; ".join(texts[:ERRORS_SHOWN] + more)
