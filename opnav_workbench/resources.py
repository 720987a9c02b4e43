"""Where files stand: those that travel with the package (wheel or checkout), and the user's cache."""

import os
from pathlib import Path

import platformdirs

__all__ = ["CACHE_VARIABLE", "cache_root", "kernels_meta_dir"]

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
    package = Path(__file__).resolve().parent
    installed = package / "kernels_meta"
    return installed if installed.is_dir() else package.parent / "kernels_meta"
