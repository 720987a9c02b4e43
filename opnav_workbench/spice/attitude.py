"""Attitudes of cameras and of bodies, from the open `KernelSet`."""

import spiceypy

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import KernelError
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.states import body_id, body_name

__all__ = ["body_attitude", "body_frame", "camera_attitude"]


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
