"""Cameras as the open kernels know them: attitude, angular rate, frames, CK structures and instrument values.

Attitudes are ``camera_from_j2000``, so that ``v_camera = camera_from_j2000 @ v_j2000``; rates are rad/s in J2000
components. Any other frame that the kernels define will do as well.
"""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.calls import SpiceRequest, loaded_text, spice_call
from opnav_workbench.kernels.coverage import CK_FRAME, ck_structures, frame_number, gaps_within, windows_of
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "attitude_gaps",
    "camera_attitude",
    "camera_rate",
    "ck_structure",
    "instrument_ids",
    "instrument_values",
    "knows_frame",
    "rotation",
]

INSTRUMENT = re.compile(r"INS(-?\d+)_")


# ---- Attitudes of cameras and of bodies, from the open `KernelSet`.


def camera_attitude(frame: str, et: float) -> FloatArray:
    """Return ``camera_from_j2000``, shape (3, 3): ``v_camera = camera_from_j2000 @ v_j2000``.

    Parameters
    ----------
    frame
        The camera's own SPICE frame, or any other.
    et
        TDB s past J2000.

    Raises
    ------
    KernelError
        The frame is unknown, or FK, SCLK, LSK or CK data are missing; for a gap, the message says what is
        covered.
    """
    with spice_call(SpiceRequest(f"attitude of {frame}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.pxform("J2000", frame, et), (3, 3), "camera_from_j2000")


def attitude_gaps(frame: str, begin_et: float, end_et: float) -> FloatArray:
    """Return when, between two times, the loaded CKs know no attitude of a frame: (m, 2), TDB s past J2000.

    Interpolation between attitudes on both sides does not notice such a gap.

    Raises
    ------
    KernelError
        The frame is unknown, or a clock is not loaded.
    """
    with spice_call(SpiceRequest(f"attitudes of {frame}", begin_et, frame=frame), needs_kernels=True):
        gaps = [
            gaps_within(windows_of("CK", structure).intervals_et, begin_et, end_et)
            for structure in ck_structures(frame_number(frame))
        ]
    return np.concatenate([np.empty((0, 2)), *gaps])


def rotation(frame: str, other: str, et: float) -> FloatArray:
    """Return ``other_from_frame``, shape (3, 3), between two frames: ``v_other = other_from_frame @ v_frame``.

    Raises
    ------
    KernelError
        A frame is unknown, or the kernels do not connect them at `et`.
    """
    with spice_call(SpiceRequest(f"rotation from {frame} to {other}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.pxform(frame, other, et), (3, 3), "other_from_frame")


def camera_rate(frame: str, et: float) -> FloatArray:
    """Return the angular velocity (3,) of a frame with respect to J2000, rad/s, J2000 components.

    Raises
    ------
    KernelError
        As `camera_attitude`; or the CK holds no angular rates.
    """
    with spice_call(SpiceRequest(f"angular rate of {frame}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.xf2rav(spiceypy.sxform("J2000", frame, et))[1], (3,), "rate")


def ck_structure(frame: str) -> tuple[int, int] | None:
    """Return the CK structure that orients a frame, and its clock; None where no CK does (or nobody knows the frame).

    Raises
    ------
    KernelError
        No `KernelSet` is open.
    """
    with spice_call(SpiceRequest(f"structure of {frame}"), needs_kernels=True):
        number = int(spiceypy.namfrm(frame))
        if number == 0:
            return None
        _, frame_class, structure = spiceypy.frinfo(number)
        if frame_class != CK_FRAME:
            return None
        return int(structure), int(spiceypy.ckmeta(int(structure), "SCLK"))


def knows_frame(frame: str) -> bool:
    """Tell whether SPICE, with the kernels that are loaded, knows a frame by this name.

    Raises
    ------
    KernelError
        No `KernelSet` is open.
    """
    with spice_call(SpiceRequest(f"frame {frame}"), needs_kernels=True):
        return int(spiceypy.namfrm(frame)) != 0


# ---- Instrument kernels: all that the loaded kernels say about one instrument, as a plain mapping.


def instrument_values(instrument_id: int) -> Mapping[str, tuple[float, ...] | tuple[str, ...]]:
    """Return all pool variables of an instrument, ``INS<id>_*``, by their full names, and those of frames of its addendum.

    These are the frame that the addendum names, and those fixed to the field of view's frame; where the kernels give no such
    frame, the one of the instrument's number: ``FRAME_*_NAME`` and ``TKFRAME_*``.

    Parameters
    ----------
    instrument_id
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
        names += pool.pool_names(f"INS_{instrument_id}_*")  # as an addendum of Cassini's has it
        names += _frame_names(instrument_id)
        found = {name: pool.pool_value(name) for name in names}
    return MappingProxyType({name: value for name, value in found.items() if value is not None})


def instrument_ids() -> tuple[int, ...]:
    """Return the NAIF numbers of all instruments that the loaded kernels describe, the first of a spacecraft first.

    Raises
    ------
    KernelError
        No `KernelSet` is open.
    """
    with spice_call("instruments", needs_kernels=True):
        found = (INSTRUMENT.match(name) for name in pool.pool_names("INS*"))
        return tuple(sorted({int(match[1]) for match in found if match}, reverse=True))


def _frame_names(instrument_id: int) -> list[str]:
    """The variables of frames that an instrument's addendum needs; none where the field of view's frame says all."""
    field = pool.pool_value(f"INS{instrument_id}_FOV_FRAME")
    numbers = [] if field is not None else [str(instrument_id)]
    told = pool.pool_value(f"INS_{instrument_id}_FRAME_ID") or pool.pool_value(f"INS{instrument_id}_FRAME_ID")
    if told:
        numbers.append(str(round(float(told[0]))))
    if field is not None and pool.pool_value(f"INS{instrument_id}_TRANSX") is not None:
        fixed = [name for name in pool.pool_names("TKFRAME_*_RELATIVE") if pool.pool_value(name) == field]
        numbers += [name.removeprefix("TKFRAME_").removesuffix("_RELATIVE") for name in fixed]
    names = [name for number in numbers for name in pool.pool_names(f"TKFRAME_{number}_*")]
    return names + [name for number in numbers for name in pool.pool_names(f"FRAME_{number}_NAME")]
