"""Packages of operational readiness tests: a folder that tells a team what it would be told in flight, and no more.

DIR/ort.yaml        mission, sequence, what to estimate and how well it is known; checksums of everything
DIR/briefing.md     the same for people, and briefing.html
DIR/pictures/       flight-like pictures; headers hold what was predicted
DIR/kernels/        the predicted kernels and their metakernel
DIR/maps/           in orbit, the team's map of the body: maplets and a shape
DIR/truth.sealed    what was true, encrypted
DIR.key             opens it; stays with the director

`open_rehearsal` checks that a package is whole and unaltered; the schema of ``ort.yaml`` is `OrtContent`.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import PositiveFloat

from opnav_workbench.errors import SessionError
from opnav_workbench.files import inside, plain_values, sha256_of, write_text
from opnav_workbench.mission import mission_names
from opnav_workbench.paths import is_file
from opnav_workbench.yaml_file import StrictModel, read_model

__all__ = [
    "PACKAGE_FORMAT",
    "BPlaneContent",
    "OrbitContent",
    "OrtContent",
    "OrtPackage",
    "OrtPicture",
    "PictureContent",
    "open_rehearsal",
    "public_digest",
    "write_content",
]


# ---- ``ort.yaml``: what a rehearsal's package tells the team, and the checksums that hold it together.

PACKAGE_FILE = "ort.yaml"
PACKAGE_FORMAT = "opnav-ort/1"
SEAL_FIELDS = ("sealed_truth",)  # what is not part of the digest that the truth holds

StatedSigma = PositiveFloat | tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class BPlaneContent(StrictModel):
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


class OrbitContent(StrictModel):
    """The body in orbit about it: its map, and how well body and map are known; sigmas at the epoch."""

    body: str
    gm_km3_s2: float
    distance_km: float  # of the spacecraft at the epoch, as predicted
    maplets: str
    shape: str
    pole_sigma_deg: PositiveFloat
    meridian_sigma_deg: PositiveFloat
    spin_sigma: PositiveFloat
    map_sigma: PositiveFloat
    predict_utc: str  # when the spacecraft's place is asked for


class PictureContent(StrictModel):
    """One picture of the sequence."""

    name: str
    file: str
    utc: str
    camera: str
    exposure_s: float
    targets: tuple[str, ...]
    received: bool


class SealContent(StrictModel):
    """The sealed truth."""

    file: str
    sha256: str
    plain_sha256: str


class OrtContent(StrictModel):
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
    parameters: dict[str, StatedSigma]
    b_plane: BPlaneContent | None = None
    orbit: OrbitContent | None = None  # in place of a flyby
    due_utc: str
    deliver: tuple[str, ...]
    pictures: tuple[PictureContent, ...]
    sha256: dict[str, str]
    sealed_truth: SealContent


PACKAGE_FILE_HEAD = """\
# Rehearsal package of opnav_workbench: what the team is told. The truth stays sealed until the director reveals it.
# Do not edit: the checksums and the sealed truth hold this file to what it was.
"""


def public_digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of what the file tells, without the seal itself."""
    told = {
        name: value
        for name, value in plain_values(content).items()
        if name not in SEAL_FIELDS
        and (name != "orbit" or value is not None)  # of packages older than the field
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def write_content(folder: Path, content: OrtContent) -> None:
    """Write ``ort.yaml`` into a folder."""
    values = plain_values(content.model_dump(mode="json"))
    write_text(
        folder / PACKAGE_FILE,
        PACKAGE_FILE_HEAD + yaml.safe_dump(values, sort_keys=False, width=110, allow_unicode=True),
    )


def read_content(folder: Path) -> OrtContent:
    """Read ``ort.yaml`` of a folder.

    Raises
    ------
    SessionError
        There is none, or it is not one that this version reads.
    """
    path = folder / PACKAGE_FILE
    if not is_file(path):
        raise SessionError(
            f"{folder} is no rehearsal package: it has no {PACKAGE_FILE}. Make one with opnav ort new SCENARIO --out DIR."
        )
    content = read_model(path, OrtContent, "rehearsal package", SessionError)
    if content.format != PACKAGE_FORMAT:
        raise SessionError(f"{path} has format {content.format!r}; this version reads {PACKAGE_FORMAT!r}.")
    return content


# ---- Packages of operational readiness tests.

BRIEFING_FILE = "briefing.md"
BRIEFING_PAGE_FILE = "briefing.html"
PICTURE_FOLDER = "pictures"
MAP_FOLDER = "maps"
SEALED_FILE = "truth.sealed"
KEY_SUFFIX = ".key"
MOST_NAMED = 5  # altered files that a message names

APrioriSigma = float | tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class OrtPicture:
    """One picture of the sequence.

    Attributes
    ----------
    name
        File name stem.
    path
        Where it is, or would be had it arrived.
    utc
        Mid-exposure.
    camera
        Name of the mission's camera file.
    received
        Whether it arrived; not all of it need be there.
    """

    name: str
    path: Path
    utc: str
    camera: str
    exposure_s: float
    targets: tuple[str, ...]
    received: bool


@dataclass(frozen=True, slots=True)
class OrtPackage:
    """A rehearsal as the team has it.

    Attributes
    ----------
    mission
        Name, or path of the mission file in the package.
    catalog
        Catalog spec.
    metakernel
        Of the predicted kernels.
    pictures
        The whole sequence in the order of time, with those that did not arrive.
    parameters : mapping of str to float or three floats
        What to estimate, as `opnav_workbench.estimation.estimate` names it, and the a priori sigmas, km and km/s.
    epoch_utc
        Of the corrected states.
    b_plane
        Body, its GM, the pole, and the flyby as predicted; None in orbit.
    orbit
        The body in orbit about it, its map, and how well both are known; None of a flyby.
    maps : mapping of str to Path
        Of an orbit: ``maplets`` and ``shape``.
    sha256
        Of every file, by its path in the folder.
    commitment
        SHA-256 of the truth's plain text.
    public_sha256
        Of all that ``ort.yaml`` tells.
    """

    folder: Path
    name: str
    title: str
    description: str
    mission: str
    catalog: str
    targets: tuple[str, ...]
    reference_body: str
    metakernel: Path
    pictures: tuple[OrtPicture, ...]
    parameters: Mapping[str, APrioriSigma]
    epoch_utc: str
    b_plane: BPlaneContent | None
    orbit: OrbitContent | None
    maps: Mapping[str, Path]
    due_utc: str
    sha256: Mapping[str, str] = field(repr=False)
    sealed: Path
    commitment: str
    public_sha256: str

    @property
    def key_path(self) -> Path:
        """Where the director's key stands unless it was taken elsewhere."""
        return key_beside(self.folder)

    @property
    def received(self) -> tuple[OrtPicture, ...]:
        """The pictures that arrived, whole or in part."""
        return tuple(picture for picture in self.pictures if picture.received)

    @property
    def briefing(self) -> Path:
        """The briefing as text."""
        return self.folder / BRIEFING_FILE


def key_beside(folder: Path) -> Path:
    """Return the key file of a package's folder."""
    return folder.with_name(folder.name + KEY_SUFFIX)


def open_rehearsal(folder: str | os.PathLike[str]) -> OrtPackage:
    """Open a rehearsal's package and check that it is whole and unaltered.

    Parameters
    ----------
    folder : path

    Raises
    ------
    SessionError
        It is no package, or files are missing or altered: they are named.
    """
    home = Path(folder).expanduser().absolute()
    content = read_content(home)
    sums = {**content.sha256, content.sealed_truth.file: content.sealed_truth.sha256}
    bad = [name for name, expected in sums.items() if _sum_of(home, name) != expected]
    if bad:
        named = ", ".join(
            f"{name} ({'altered' if inside(home, name).is_file() else 'missing'})"
            for name in bad[:MOST_NAMED]
        )
        more = f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else ""
        raise SessionError(
            f"rehearsal package {home}: not as it was made: {named}{more}. Get it again from its director; results belong "
            "into a folder of their own."
        )
    return _package(home, content)


def _sum_of(home: Path, name: str) -> str:
    with contextlib.suppress(OSError):
        return sha256_of(inside(home, name))
    return ""


def _package(home: Path, content: OrtContent) -> OrtPackage:
    known = content.mission in mission_names()
    pictures = tuple(
        OrtPicture(path=inside(home, p.file), **p.model_dump(exclude={"file"})) for p in content.pictures
    )
    same = (
        "name",
        "title",
        "description",
        "catalog",
        "targets",
        "reference_body",
        "parameters",
        "epoch_utc",
        "b_plane",
        "orbit",
    )
    orbit = content.orbit
    maps = {} if orbit is None else {"maplets": orbit.maplets, "shape": orbit.shape}
    return OrtPackage(
        folder=home,
        mission=content.mission if known else str(inside(home, content.mission)),
        metakernel=inside(home, content.kernels),
        pictures=pictures,
        maps={name: inside(home, file) for name, file in maps.items()},
        due_utc=content.due_utc,
        sha256=content.sha256,
        sealed=inside(home, content.sealed_truth.file),
        commitment=content.sealed_truth.plain_sha256,
        public_sha256=public_digest(content.model_dump(mode="json")),
        **{name: getattr(content, name) for name in same},
    )
