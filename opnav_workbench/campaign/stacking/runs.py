"""Pictures for a stack from their run folders: the sessions are taken up again, kernels give the target's place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.mission import Mission
from opnav_workbench.observables import attitude_partials
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.session import ImageSession

__all__ = ["RunFrames", "frame_of_session", "frames_of_runs"]


@dataclass(frozen=True, slots=True)
class RunFrames:
    """Pictures of run folders.

    Attributes
    ----------
    frames : tuple of StackFrame
        In the order of time.
    utc : tuple of str
        Of their exposures.
    left_out : tuple of (str, str)
        Folder and reason of those that cannot be stacked.
    mission, reference_body : str
    """

    frames: tuple[StackFrame, ...]
    utc: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]
    mission: str
    reference_body: str


def frames_of_runs(
    folders: Sequence[str | Path],
    target: str | None,
    say: Callable[[str], None] = lambda _: None,
) -> RunFrames:
    """Take up sessions again and return their pictures for a stack.

    Parameters
    ----------
    folders : sequence of path
        Run folders with ``session.json``.
    target : str or None
        SPICE body, or star of the target list; a session that has not met it yet asks the active `KernelSet`.
    say : callable
        Called with each folder's name before it is read.

    Raises
    ------
    SessionError
        None of them can be used.
    """
    taken: list[tuple[StackFrame, str, Mission]] = []
    left_out = []
    for folder in map(Path, folders):
        say(folder.name)
        try:
            session = ImageSession.resume(folder)
            frame = frame_of_session(session, target)
        except OpNavError as error:
            left_out.append((str(folder), str(error)))
        else:
            taken.append((frame, session.inputs.utc, session.context.mission))
    if not taken:
        why = "; ".join(f"{folder}: {reason}" for folder, reason in left_out[:2])
        raise SessionError(f"no run can be stacked ({why}).")
    taken.sort(key=lambda item: (item[0].et, item[0].name))
    frames, times, missions = zip(*taken, strict=True)
    return RunFrames(frames, times, tuple(left_out), missions[0].name, missions[0].reference_body)


def frame_of_session(session: ImageSession, target: str | None = None) -> StackFrame:
    """Return a session's picture for a stack.

    Raises
    ------
    SessionError, KernelError
        Its pointing is not solved, or nothing is known of the target.
    """
    pointing, context, inputs = session.state.pointing, session.context, session.inputs
    if pointing is None:
        raise SessionError(f"{context.frame.path.name}: its pointing is not solved; it cannot be placed.")
    if target is not None and target not in inputs.targets:
        session.add_target(target)
        inputs = session.inputs
    shape = (session.state.psf or context.camera_psf).shape
    gaussian = GaussianPsf(shape.sigma_major_px, shape.sigma_minor_px, shape.angle_rad)
    gain = context.camera.gain_e_per_dn
    return StackFrame(
        name=context.frame.path.name,
        et=inputs.et,
        exposure_s=context.frame.exposure_s,
        signal_dn=context.signal_dn,
        noise_dn=context.noise_dn,
        bad=context.bad | context.frame.saturated,
        camera=context.camera,
        camera_from_j2000=pointing.camera_from_j2000,
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        psf=context.camera.psf_shape or gaussian,  # a calibrated PSF, else that of the picture's own stars
        target=None if target is None else inputs.targets[target],
        attitude_covariance_rad2=pointing.covariance_rad2,
        catalog_covariance_rad2=_catalog_covariance(session),
        excess_sigma_px=pointing.excess_sigma_px,
        gain_e_per_dn=np.inf if gain is None else gain,
        neighbours=_others(session, target),
    )


def _others(session: ImageSession, target: str | None) -> FloatArray:
    """Apparent directions (k, 3) of the other bodies that the session knows."""
    velocity = session.inputs.observer.velocity_km_s
    others = [state.direction for name, state in session.inputs.targets.items() if name != target]
    return apparent_direction(np.array(others), velocity) if others else np.zeros((0, 3))


def _catalog_covariance(session: ImageSession) -> FloatArray:
    """Part of the attitude's covariance that comes from the catalog: the fit's map applied to its covariance alone."""
    state = session.state
    assert state.pointing is not None
    assert state.a_priori is not None
    assert state.centers is not None
    used = np.flatnonzero(state.pointing.used)
    attitude, camera = state.pointing.camera_from_j2000, session.context.camera
    total = np.zeros((3, 3))
    for star in used:
        partials = attitude_partials(state.a_priori.directions[star], camera, attitude)
        own = state.a_priori.covariance_px2[star]
        excess = state.pointing.excess_sigma_px**2 * np.eye(2)
        weight = np.linalg.inv(state.centers.covariance_px2[star] + own + excess)
        total += partials.T @ weight @ own @ weight @ partials
    covariance = np.asarray(state.pointing.covariance_rad2)
    return symmetric(covariance @ total @ covariance)
