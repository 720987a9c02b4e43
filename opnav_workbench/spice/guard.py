"""The one door to spiceypy: takes the lock, asks for kernels where needed, and fails in clear words."""

import contextlib
import math
from collections.abc import Iterator

import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.spice import pool
from opnav_workbench.spice.explain import Request, explanation

__all__ = ["Request", "spice_call", "toolkit_version"]

NO_KERNELS = "no kernels are loaded; open some: with KernelSet('mission/name'): ..., or give it kernel paths."


@contextlib.contextmanager
def spice_call(request: Request | str, *, needs_kernels: bool = False) -> Iterator[None]:
    """Guard a block that calls spiceypy: one thread at a time, and a SPICE failure becomes a `KernelError`.

    Parameters
    ----------
    request : Request or str
        What is asked; it begins the message. With time, bodies and frame the message says what covers them.
    needs_kernels : bool
        Refuse while no `KernelSet` is open.

    Raises
    ------
    KernelError
        SPICE failed, no `KernelSet` is open, or the time is not finite.
    """
    asked = Request(request) if isinstance(request, str) else request
    with pool.LOCK:
        if needs_kernels and pool.active() is None:
            raise KernelError(f"{asked.what}: {NO_KERNELS}")
        if asked.et is not None and not math.isfinite(asked.et):
            raise KernelError(
                f"{asked.what}: the time et = {asked.et} s is not finite; check where it comes from."
            )
        try:
            yield
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            raise KernelError(explanation(error, asked)) from error


def toolkit_version() -> str:
    """Return the version of the SPICE toolkit, such as ``CSPICE_N0067``."""
    with pool.LOCK:
        return str(spiceypy.tkvrsn("TOOLKIT"))
