"""Where the files that travel with the package stand: in a wheel, or beside the package in a checkout."""

from pathlib import Path

__all__ = ["kernels_meta_dir"]


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
