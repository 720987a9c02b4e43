"""Packages of operational readiness tests: a folder that tells a team what it would be told in flight, and no more.

DIR/ort.yaml        mission, sequence, what to estimate and how well it is known; checksums of everything
DIR/briefing.md     the same for people, and briefing.html
DIR/pictures/       flight-like pictures; headers hold what was predicted
DIR/kernels/        the predicted kernels and their metakernel
DIR/truth.sealed    what was true, encrypted
DIR.key             opens it; stays with the director
"""

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from opnav_workbench.errors import SessionError
from opnav_workbench.files import inside, sha256_of
from opnav_workbench.mission import mission_names
from opnav_workbench.rehearsal.ort_package_file import BPlaneContent, OrtContent, digest, read_content

__all__ = ["OrtPackage", "OrtPicture", "open_rehearsal"]

BRIEFING = "briefing.md"
PAGE = "briefing.html"
PICTURES = "pictures"
SEALED = "truth.sealed"
KEY_SUFFIX = ".key"
NAMED = 5  # altered files that a message names

Sigma = float | tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class OrtPicture:
    """One picture of the sequence.

    Attributes
    ----------
    name : str
        File name stem.
    path : Path
        Where it is, or would be had it arrived.
    utc : str
        Mid-exposure.
    camera : str
        Name of the mission's camera file.
    exposure_s : float
    targets : tuple of str
    received : bool
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
    folder : Path
    name, title, description : str
    mission : str
        Name, or path of the mission file in the package.
    catalog : str
        Catalog spec.
    targets : tuple of str
    reference_body : str
    metakernel : Path
        Of the predicted kernels.
    pictures : tuple of OrtPicture
        The whole sequence in the order of time, with those that did not arrive.
    parameters : mapping of str to float or three floats
        What to estimate, as `opnav_workbench.estimation.estimate` names it, and the a priori sigmas, km and km/s.
    epoch_utc : str
        Of the corrected states.
    b_plane : BPlaneContent
        Body, its GM, the pole, and the flyby as predicted.
    due_utc : str
    sha256 : mapping of str to str
        Of every file, by its path in the folder.
    sealed : Path
    commitment : str
        SHA-256 of the truth's plain text.
    public_sha256 : str
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
    parameters: Mapping[str, Sigma]
    epoch_utc: str
    b_plane: BPlaneContent
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
        return self.folder / BRIEFING

    @property
    def briefing_page(self) -> Path:
        """The briefing as a page."""
        return self.folder / PAGE


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
            f"{name} ({'altered' if inside(home, name).is_file() else 'missing'})" for name in bad[:NAMED]
        )
        more = f" and {len(bad) - NAMED} more" if len(bad) > NAMED else ""
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
    )
    return OrtPackage(
        folder=home,
        mission=content.mission if known else str(inside(home, content.mission)),
        metakernel=inside(home, content.kernels),
        pictures=pictures,
        due_utc=content.due_utc,
        sha256=content.sha256,
        sealed=inside(home, content.sealed_truth.file),
        commitment=content.sealed_truth.plain_sha256,
        public_sha256=digest(content.model_dump(mode="json")),
        **{name: getattr(content, name) for name in same},
    )
