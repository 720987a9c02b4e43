"""Where files stand: those that travel with the package (wheel or checkout), and the user's cache."""

import os
from pathlib import Path

import platformdirs

__all__ = ["CACHE_VARIABLE", "cache_root", "kernels_meta_dir", "notebooks_dir"]

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


def _installed_or_checked_out(name: str) -> Path:
    package = Path(__file__).resolve().parent
    installed = package / name
    return installed if installed.is_dir() else package.parent / name
