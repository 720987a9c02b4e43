"""Attitudes of cameras and of bodies, from the open `KernelSet`."""

import spiceypy

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.spice.coverage import CK_FRAME
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.states import body_id, body_name

__all__ = [
    "body_attitude",
    "body_frame",
    "camera_attitude",
    "camera_rate",
    "ck_structure",
    "knows_frame",
    "rotation",
]


def camera_attitude(frame: str, et: float) -> FloatArray:
    """Return ``camera_from_j2000``, shape (3, 3): ``v_camera = camera_from_j2000 @ v_j2000``.

    Parameters
    ----------
    frame : str
        The camera's own SPICE frame, or any other.
    et : float
        TDB s past J2000.

    Raises
    ------
    KernelError
        The frame is unknown, or FK, SCLK, LSK or CK data are missing; for a gap, the message says what is
        covered.
    """
    with spice_call(Request(f"attitude of {frame}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.pxform("J2000", frame, et), (3, 3), "camera_from_j2000")


def rotation(frame: str, other: str, et: float) -> FloatArray:
    """Return ``other_from_frame``, shape (3, 3), between two frames: ``v_other = other_from_frame @ v_frame``.

    Raises
    ------
    KernelError
        A frame is unknown, or the kernels do not connect them at `et`.
    """
    with spice_call(Request(f"rotation from {frame} to {other}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.pxform(frame, other, et), (3, 3), "other_from_frame")


def camera_rate(frame: str, et: float) -> FloatArray:
    """Return the angular velocity (3,) of a frame with respect to J2000, rad/s, J2000 components.

    Raises
    ------
    KernelError
        As `camera_attitude`; or the CK holds no angular rates.
    """
    with spice_call(Request(f"angular rate of {frame}", et, frame=frame), needs_kernels=True):
        return readonly(spiceypy.xf2rav(spiceypy.sxform("J2000", frame, et))[1], (3,), "rate")


def ck_structure(frame: str) -> tuple[int, int] | None:
    """Return the CK structure that orients a frame, and its clock; None where no CK does (or nobody knows the frame).

    Raises
    ------
    KernelError
        No `KernelSet` is open.
    """
    with spice_call(Request(f"structure of {frame}"), needs_kernels=True):
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
    with spice_call(Request(f"frame {frame}"), needs_kernels=True):
        return int(spiceypy.namfrm(frame)) != 0


def body_attitude(body: str | int, et: float) -> FloatArray:
    """Return ``body_from_j2000``, shape (3, 3), in the body's own frame (see `body_frame`).

    Raises
    ------
    KernelError
        The body or its frame is unknown, or no loaded PCK orients it.
    """
    frame = body_frame(body)
    request = Request(f"attitude of {body} ({frame})", et, (body,), frame)
    with spice_call(request, needs_kernels=True):
        return readonly(spiceypy.pxform("J2000", frame, et), (3, 3), "body_from_j2000")


def body_frame(body: str | int) -> str:
    """Return the body-fixed frame of a body.

    The frame that a kernel ties to it (``OBJECT_<id>_FRAME``), or SPICE's own IAU frame, or one named
    IAU_<BODY>.

    Raises
    ------
    KernelError
        The body is unknown or has no such frame.
    """
    number = body_id(body)
    fallback = f"IAU_{body_name(number)}".replace(" ", "_")
    with spice_call(Request(f"frame of {body}", bodies=(body,)), needs_kernels=True):
        try:
            return str(spiceypy.cidfrm(number)[1])
        except spiceypy.NotFoundError as error:
            if spiceypy.namfrm(fallback):
                return fallback
            raise KernelError(
                f"{body} ({number}) has no body-fixed frame; load the FK or PCK that gives "
                f"OBJECT_{number}_FRAME or defines {fallback}."
            ) from error
