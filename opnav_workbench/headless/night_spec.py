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

import glob
from collections import Counter
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from opnav_workbench.errors import SessionError
from opnav_workbench.yaml_file import read_model

__all__ = ["NightSpec", "load_night", "picture_names", "pictures_of_night"]

PICTURE_SUFFIXES = (".fit", ".fits", ".fts", ".fit.gz", ".fits.gz", ".img", ".vic", ".imq")
MIN_MEMORY_MB = 300  # a notebook's kernel with this package and one small picture takes 250 MB
WILDCARDS = "*?["


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
    found: dict[Path, None] = {}
    for image in spec.images:
        found.update(dict.fromkeys(_expanded(image)))
    return tuple(sorted(found))


def _expanded(image: str) -> list[Path]:
    path = Path(image).expanduser()
    if path.is_file():
        return [path.resolve()]
    if path.is_dir():
        inside = [
            p.resolve() for p in path.iterdir() if p.name.lower().endswith(PICTURE_SUFFIXES) and p.is_file()
        ]
        return inside or _nothing(f"the folder {path} holds no picture ({', '.join(PICTURE_SUFFIXES)}).")
    if not any(sign in image for sign in WILDCARDS):
        return _nothing(f"the picture {path} is not there.")
    # Path.glob takes no absolute patterns
    matching = [Path(p).resolve() for p in glob.glob(str(path), recursive=True) if Path(p).is_file()]  # noqa: PTH207
    return matching or _nothing(
        f"no picture matches {image!r}; quote the pattern, and see that the folder is right."
    )


def _nothing(message: str) -> list[Path]:
    raise SessionError(message)


def picture_names(pictures: tuple[Path, ...]) -> dict[Path, str]:
    """Return the name of each picture's folder: its stem, with the folder it lies in where stems are not unique.

    Raises
    ------
    SessionError
        Two pictures cannot be told apart this way.

    Examples
    --------
    >>> list(picture_names((Path("a/x.fit"), Path("b/x.fit"), Path("b/y.fit"))).values())
    ['a_x', 'b_x', 'y']
    """
    stems = Counter(path.stem for path in pictures)
    names = {p: p.stem if stems[p.stem] == 1 else f"{p.parent.name}_{p.stem}" for p in pictures}
    twice = [name for name, count in Counter(names.values()).items() if count > 1]
    if twice:
        raise SessionError(
            f"more than one picture is named {', '.join(sorted(twice))}; process them in nights of their own, "
            "each with its --out."
        )
    bad = [str(path) for path, name in names.items() if name.strip(".") == "" or name.startswith(".")]
    if bad:
        raise SessionError(f"{', '.join(bad)} gives no name for a folder; rename the picture.")
    return names
