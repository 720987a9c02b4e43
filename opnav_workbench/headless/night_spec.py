"""What a night is to do: pictures, how they are processed, and within which limits (YAML, or the command's options).

::

    images: [incoming/lor_*.fit]   # files, folders or patterns, relative to this file
    mission: new_horizons
    kernels: flight.tm             # kernel-set name, metakernel or folder; left out: headers only
    catalog: bundled
    targets: [PLUTO, CHARON]       # left out: the mission's own
    methods: {PLUTO: limb_scan}    # centerfinder by target; left out: automatic
    decisions: decisions.yaml
    time_limit_s: 300
"""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from opnav_workbench.errors import SessionError
from opnav_workbench.image.picture_files import picture_files
from opnav_workbench.yaml_file import read_model

__all__ = ["NightSpec", "load_night", "pictures_of_night"]

MIN_MEMORY_MB = 300  # a notebook's kernel with this package and one small picture takes 250 MB


class NightSpec(BaseModel):
    """A night's work.

    Attributes
    ----------
    images : tuple of str
        Files, folders (all pictures in them) or patterns.
    mission, catalog, attitude, model, centers : str
        As ``opnav process`` takes them.
    kernels, target_stars, decisions : str or None
    targets : tuple of str or None
        None: the mission's own.
    methods : mapping of str to str
        Centerfinder by target.
    notebook : str or None
        Another notebook than ``process_image.ipynb``; it gets the same parameters.
    time_limit_s : float
        Longest time a picture may take, notebook and all.
    memory_limit_mb : float
        Most memory that a picture's processes may hold together.
    retries : int
        How often a picture is tried again after a fault of the machine (a process killed, a kernel that does not start).
    """

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())

    images: tuple[str, ...] = Field(min_length=1)
    mission: str
    kernels: str | None = None
    catalog: str = "bundled"
    targets: tuple[str, ...] | None = None
    methods: dict[str, str] = {}
    target_stars: str | None = None
    decisions: str | None = None
    attitude: str = "auto"
    model: str = "euler"
    centers: str = "least_squares"
    notebook: str | None = None
    time_limit_s: float = Field(300.0, gt=0.0)
    memory_limit_mb: float = Field(3000.0, ge=MIN_MEMORY_MB)
    retries: int = Field(1, ge=0, le=10)


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
    changes: dict[str, Any] = {"images": tuple(str(base / image) for image in spec.images)}
    for field in ("decisions", "target_stars", "notebook", "kernels", "mission"):
        value = getattr(spec, field)
        # Kernel sets and missions have names too; what exists beside the file is meant as a file.
        named = field in ("kernels", "mission") and value is not None and not (base / value).exists()
        if value is not None and not named:
            changes[field] = str(base / value)
    return spec.model_copy(update=changes)


def pictures_of_night(spec: NightSpec) -> tuple[Path, ...]:
    """Return the pictures that a night's patterns stand for now, sorted by path, each once.

    Raises
    ------
    SessionError
        A file is not there; a folder or pattern stands for no picture.
    """
    return tuple(sorted(picture_files(spec.images)))
