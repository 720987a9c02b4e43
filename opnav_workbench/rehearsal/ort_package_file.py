"""``ort.yaml``: what a rehearsal's package tells the team, and the checksums that hold it together."""

import hashlib
import json
from pathlib import Path
from typing import Any

import yaml
from pydantic import PositiveFloat

from opnav_workbench.errors import SessionError
from opnav_workbench.files import plain_values, write_text
from opnav_workbench.spice.scenario_parts import Strict
from opnav_workbench.yaml_file import read_model

__all__ = [
    "FILE_NAME",
    "FORMAT",
    "BPlaneContent",
    "OrtContent",
    "PictureContent",
    "digest",
    "read_content",
    "write_content",
]

FILE_NAME = "ort.yaml"
FORMAT = "opnav-ort/1"
OWN = ("sealed_truth",)  # what is not part of the digest that the truth holds

Sigma = PositiveFloat | tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class BPlaneContent(Strict):
    """The flyby as predicted."""

    body: str
    gm_km3_s2: float
    pole: str
    closest_utc: str
    closest_km: float
    b_dot_t_km: float
    b_dot_r_km: float
    time_of_flight_s: float  # linearised, from the epoch
    v_infinity_km_s: float


class PictureContent(Strict):
    """One picture of the sequence."""

    name: str
    file: str
    utc: str
    camera: str
    exposure_s: float
    targets: tuple[str, ...]
    received: bool


class SealContent(Strict):
    """The sealed truth."""

    file: str
    sha256: str
    plain_sha256: str


class OrtContent(Strict):
    """The whole file."""

    format: str
    name: str
    title: str
    description: str
    mission: str
    catalog: str
    targets: tuple[str, ...]
    reference_body: str
    kernels: str
    epoch_utc: str
    parameters: dict[str, Sigma]
    b_plane: BPlaneContent
    due_utc: str
    deliver: tuple[str, ...]
    pictures: tuple[PictureContent, ...]
    sha256: dict[str, str]
    sealed_truth: SealContent


HEAD = """\
# Rehearsal package of opnav_workbench: what the team is told. The truth stays sealed until the director reveals it.
# Do not edit: the checksums and the sealed truth hold this file to what it was.
"""


def digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of what the file tells, without the seal itself."""
    told = {name: value for name, value in plain_values(content).items() if name not in OWN}
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def write_content(folder: Path, content: OrtContent) -> None:
    """Write ``ort.yaml`` into a folder."""
    values = plain_values(content.model_dump(mode="json"))
    write_text(
        folder / FILE_NAME, HEAD + yaml.safe_dump(values, sort_keys=False, width=110, allow_unicode=True)
    )


def read_content(folder: Path) -> OrtContent:
    """Read ``ort.yaml`` of a folder.

    Raises
    ------
    SessionError
        There is none, or it is not one that this version reads.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        raise SessionError(
            f"{folder} is no rehearsal package: it has no {FILE_NAME}. Make one with opnav ort new SCENARIO --out DIR."
        )
    content = read_model(path, OrtContent, "rehearsal package", SessionError)
    if content.format != FORMAT:
        raise SessionError(f"{path} has format {content.format!r}; this version reads {FORMAT!r}.")
    return content
