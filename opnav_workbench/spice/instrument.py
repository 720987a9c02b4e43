"""Instrument kernels: all that the loaded kernels say about one instrument, as a plain mapping."""

from collections.abc import Mapping
from types import MappingProxyType

from opnav_workbench.errors import KernelError
from opnav_workbench.spice import pool
from opnav_workbench.spice.explain import loaded_text
from opnav_workbench.spice.guard import spice_call

__all__ = ["instrument_values"]


def instrument_values(instrument_id: int) -> Mapping[str, tuple[float, ...] | tuple[str, ...]]:
    """Return all pool variables of an instrument, ``INS<id>_*``, by their full names.

    Parameters
    ----------
    instrument_id : int
        NAIF number, such as -98301.

    Raises
    ------
    KernelError
        No loaded IK describes the instrument.
    """
    prefix = f"INS{instrument_id}_"
    with spice_call(f"instrument {instrument_id}", needs_kernels=True):
        names = sorted(n for n in pool.pool_names(f"{prefix}*"))
        if not names:
            raise KernelError(
                f"no loaded kernel describes instrument {instrument_id} ({prefix}*); "
                f"load its IK. {loaded_text()}"
            )
        found = {name: pool.pool_value(name) for name in names}
    return MappingProxyType({name: value for name, value in found.items() if value is not None})
