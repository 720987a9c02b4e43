"""Where files stand: those that travel with the package (wheel or checkout), and the user's cache."""

import difflib
import os
from os import PathLike
from pathlib import Path

import platformdirs

from opnav_workbench.errors import OpNavError
from opnav_workbench.paths import is_file

__all__ = [
    "CACHE_VARIABLE",
    "cache_root",
    "docs_sources",
    "kernels_meta_dir",
    "notebooks_dir",
    "ready_file",
    "ready_names",
]

CACHE_VARIABLE = "OPNAV_CACHE"


def cache_root() -> Path:
    """Return the package's cache folder: ``OPNAV_CACHE`` if set, else the user's."""
    named = os.environ.get(CACHE_VARIABLE)
    return Path(named).expanduser().absolute() if named else platformdirs.user_cache_path("opnav_workbench")


def kernels_meta_dir() -> Path:
    """Return the folder of metakernels and scenarios, named ``<mission>/<name>.tm`` or ``.yaml``.

    Examples
    --------
    >>> kernels_meta_dir().name
    'kernels_meta'
    """
    return _installed_or_checked_out("kernels_meta")


def notebooks_dir() -> Path:
    """Return the folder of the notebooks that come along.

    Examples
    --------
    >>> (notebooks_dir() / "process_image.ipynb").is_file()
    True
    """
    return _installed_or_checked_out("notebooks")


def docs_sources() -> tuple[Path, Path, Path]:
    """Return where the documentation's sources, the README's pictures and the changelog stand.

    Examples
    --------
    >>> (docs_sources()[0] / "index.md").is_file()
    True
    """
    package = Path(__file__).resolve().parent
    if (package / "docs").is_dir():
        return package / "docs", package / "docs" / "pictures", package / "docs" / "CHANGELOG.md"
    return package.parent / ".docs", package.parent / ".assets", package.parent / "CHANGELOG.md"


def ready_names(folder: str) -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the YAML files in a folder of each mission's ``kernels_meta``, sorted.

    Examples
    --------
    >>> "new_horizons/pluto_limb" in ready_names("pictures")
    True
    """
    files = kernels_meta_dir().glob(f"*/{folder}/*.yaml")
    return tuple(sorted(f"{path.parents[1].name}/{path.stem}" for path in files))


def ready_file(source: str | PathLike[str], folder: str, what: str, failure: type[OpNavError]) -> Path:
    """Return the file that a ready name or a path means.

    Parameters
    ----------
    source : str or path
    folder
        Where the ready files of this kind stand (`ready_names`).
    what
        Their kind, for the message.
    failure
        The error to raise.

    Raises
    ------
    OpNavError
        Of type `failure`: neither a known name nor a path; the message has the names.
    """
    names = ready_names(folder)
    if source in names:
        mission, _, name = str(source).partition("/")
        return kernels_meta_dir() / mission / folder / f"{name}.yaml"
    path = Path(source)
    if is_file(path) or path.suffix:
        return path
    close = difflib.get_close_matches(str(source), names, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise failure(
        f"no {what} named {str(source)!r}, and no such file: {hint}names are {', '.join(names)}; "
        "or give the path of a YAML file."
    )


def _installed_or_checked_out(name: str) -> Path:
    package = Path(__file__).resolve().parent
    installed = package / name
    return installed if installed.is_dir() else package.parent / name
