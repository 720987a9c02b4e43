"""What a night is to do: pictures, how they are processed, and within which limits (YAML, or the command's options).

::

    images: [incoming/lor_*.fit]   # files, folders or patterns, relative to this file
    mission: new_horizons
    kernels: flight.tm             # kernel-set name, metakernel or folder; left out: headers only
    catalog: bundled
    targets: [PLUTO:limb_scan, CHARON]  # left out: the mission's own
    decisions: decisions.yaml
    time_limit_s: 300

Every field of `Processing` may stand there.
"""

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from opnav_workbench.errors import SessionError
from opnav_workbench.image.picture_files import picture_files
from opnav_workbench.processing import Processing
from opnav_workbench.yaml_file import read_model

__all__ = ["NightSpec", "load_night", "pictures_of_night"]

MIN_MEMORY_MB = 300  # a notebook's kernel with this package and one small picture takes 250 MB


class NightSpec(Processing):
    """A night's work: how pictures are processed, which, and within which limits."""

    path_fields: ClassVar[tuple[str, ...]] = (*Processing.path_fields, "notebook")

    images: tuple[str, ...] = Field(
        min_length=1, description="Files, folders (all pictures in them) or patterns."
    )
    notebook: str | None = Field(
        default=None, description="Another notebook than process_image.ipynb; it gets the same parameters."
    )
    time_limit_s: float = Field(
        default=300.0, gt=0.0, description="Longest time a picture may take, notebook and all."
    )
    memory_limit_mb: float = Field(
        default=3000.0,
        ge=MIN_MEMORY_MB,
        description="Most memory that a picture's processes may hold together.",
    )
    pages: Literal["flagged", "all", "none"] = Field(
        default="flagged",
        description="Which notebooks are written as HTML, too: those of pictures that need a person, all, or none.",
    )
    warm: bool = Field(
        default=True,
        description="Processes of pictures are copies of one that has loaded everything; false: each is a new Python, "
        "two to three times slower.",
    )
    learn_psf: bool = Field(
        default=True,
        description="Whether pictures of an undersampled camera (PSF sigma below 0.6 px) teach the night one effective PSF "
        "first, kept in OUT/.psf; false: every picture learns alone.",
    )
    retries: int = Field(
        default=1,
        ge=0,
        le=10,
        description="How often a picture is tried again after a fault of the machine (a process killed, a kernel that "
        "does not start).",
    )


def load_night(path: str | Path) -> NightSpec:
    """Read a night's YAML file; relative paths in it count from its folder.

    Raises
    ------
    SessionError
        The file is missing or breaks the layout; line, field and what is allowed are named.
    """
    file = Path(path)
    spec = read_model(file, NightSpec, "night file", SessionError)
    base = file.resolve().parent
    images = tuple(str(base / image) for image in spec.images)
    return spec.with_full_paths(base).changed(images=images)


def pictures_of_night(spec: NightSpec) -> tuple[Path, ...]:
    """Return the pictures that a night's patterns stand for now, sorted by path, each once.

    Raises
    ------
    SessionError
        A file is not there; a folder or pattern stands for no picture.
    """
    return tuple(sorted(picture_files(spec.images)))
