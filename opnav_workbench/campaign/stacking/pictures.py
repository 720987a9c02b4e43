"""What goes into a stack: solved pictures of one camera, their weights, and how they come from run folders.

The sessions of run folders are taken up again; kernels give the target's place.  The part of an attitude's covariance that
comes from the catalog is the same in all pictures of a field and does not average out; it is kept apart.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError, OpNavError, SessionError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.mission import Mission
from opnav_workbench.psf import Psf
from opnav_workbench.session import ImageSession
from opnav_workbench.session.body_models import picture_psf
from opnav_workbench.session.pointing import pointing_doubt
from opnav_workbench.targets import TargetState

__all__ = [
    "RunPictures",
    "StackPicture",
    "check_pictures",
    "picture_of_session",
    "pictures_of_runs",
    "weights_of",
]


# ---- What goes into a stack: solved pictures of one camera.

NO_COVARIANCE = np.zeros((3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class StackPicture:
    """One solved picture; arrays are read-only.

    Attributes
    ----------
    et, exposure_s
        Mid-exposure, TDB seconds past J2000.
    signal_dn, noise_dn : (n_line, n_pixel) array
        Picture without background, and its 1-sigma noise.
    bad : (n_line, n_pixel) array of bool
        Pixels to leave out, also saturated ones.
    camera_from_j2000 : (3, 3) array
        Solved attitude.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter.
    psf
        Of the picture's own stars.
    target
        As ephemeris expects it; None in a stack that follows the stars.
    attitude_covariance_rad2, catalog_covariance_rad2 : (3, 3) array
        Of the solved attitude, and the part of it that comes from the catalog's errors: the same in all pictures of a
        field, it does not average out.
    excess_sigma_px
        Centering error of the picture's stars beyond their covariances.
    gain_e_per_dn
        For the target's own shot noise; inf: none.
    neighbours : (k, 3) array
        Apparent directions of other bodies, J2000: bright ones beside a faint target.
    pointing_doubt
        Why its pointing is not ok, in words.
    """

    name: str
    et: float
    exposure_s: float
    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    psf: Psf
    target: TargetState | None = None
    attitude_covariance_rad2: FloatArray = field(default_factory=NO_COVARIANCE.copy)
    catalog_covariance_rad2: FloatArray = field(default_factory=NO_COVARIANCE.copy)
    excess_sigma_px: float = 0.0
    gain_e_per_dn: float = np.inf
    neighbours: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    pointing_doubt: str = ""

    def __post_init__(self) -> None:
        shape = np.shape(self.signal_dn)
        if np.shape(self.bad) != shape or np.shape(self.noise_dn) != shape or len(shape) != 2:
            raise CenterfindingError(f"{self.name}: picture, noise and mask differ in shape.")
        freeze_arrays(self)

    @property
    def variance_dn2(self) -> FloatArray:
        """Variance of the background (n_line, n_pixel)."""
        return np.asarray(self.noise_dn**2)

    def replace(self, **changes: Any) -> "StackPicture":
        """Return a copy with some fields changed."""
        return replace(self, **changes)


def check_pictures(pictures: Sequence[StackPicture], *, follow: str) -> None:
    """Refuse pictures that no stack can be made of.

    Raises
    ------
    CenterfindingError
        Fewer than two, exposures that are not positive, or a target that some do not know.
    """
    if len(pictures) < 2:
        raise CenterfindingError(f"a stack needs two pictures at least, got {len(pictures)}.")
    for picture in pictures:
        if not 0.0 < picture.exposure_s < np.inf:
            raise CenterfindingError(
                f"{picture.name}: exposure of {picture.exposure_s} s; its light cannot be scaled."
            )
        if follow == "target" and picture.target is None:
            raise CenterfindingError(f"{picture.name}: no target to follow; name one, or follow the stars.")
    names = sorted({picture.camera.name for picture in pictures})
    if len(names) > 1:
        raise CenterfindingError(f"the pictures are of {', '.join(names)}; stack one camera at a time.")


def weights_of(pictures: Sequence[StackPicture]) -> tuple[FloatArray, FloatArray]:
    """Return what each picture's light is worth against the longest one's (n,), and best weights (n,), sum 1.

    A picture of twice the exposure, or of half the noise, counts four times: a faint target is lost in the background.

    Raises
    ------
    CenterfindingError
        A picture without usable pixels or without noise.
    """
    exposure = np.array([picture.exposure_s for picture in pictures])
    response = exposure / exposure.max()
    noise = np.array([_typical_noise(picture) for picture in pictures])
    weights = (response / noise) ** 2
    return response, weights / weights.sum()


def _typical_noise(picture: StackPicture) -> float:
    noise = float(np.median(picture.noise_dn[~picture.bad])) if (~picture.bad).any() else np.nan
    if not 0.0 < noise < np.inf:
        raise CenterfindingError(
            f"{picture.name}: no usable pixel, or no noise; it cannot be weighted in a stack."
        )
    return noise


# ---- Pictures for a stack from their run folders.


@dataclass(frozen=True, slots=True)
class RunPictures:
    """Pictures of run folders.

    Attributes
    ----------
    pictures
        In the order of time.
    utc
        Of their exposures.
    left_out : tuple of (str, str)
        Folder and reason of those that cannot be stacked.
    """

    pictures: tuple[StackPicture, ...]
    utc: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]
    mission: str
    reference_body: str


def pictures_of_runs(
    folders: Sequence[str | Path],
    target: str | None,
    say: Callable[[str], None] = lambda _: None,
) -> RunPictures:
    """Take up sessions again and return their pictures for a stack.

    Parameters
    ----------
    folders
        Run folders with ``session.json``.
    target
        SPICE body, or star of the target list; a session that has not met it yet asks the active `KernelSet`.
    say
        Called with each folder's name before it is read.

    Raises
    ------
    SessionError
        None of them can be used.
    """
    taken: list[tuple[StackPicture, str, Mission]] = []
    left_out = []
    for folder in map(Path, folders):
        say(folder.name)
        try:
            session = ImageSession.resume(folder)
            picture = picture_of_session(session, target)
        except OpNavError as error:
            left_out.append((str(folder), str(error)))
        else:
            taken.append((picture, session.inputs.utc, session.context.mission))
    if not taken:
        why = "; ".join(f"{folder}: {reason}" for folder, reason in left_out[:2])
        raise SessionError(f"no run can be stacked ({why}).")
    taken.sort(key=lambda item: (item[0].et, item[0].name))
    pictures, times, missions = zip(*taken, strict=True)
    return RunPictures(pictures, times, tuple(left_out), missions[0].name, missions[0].reference_body)


def picture_of_session(session: ImageSession, target: str | None = None) -> StackPicture:
    """Return a session's picture for a stack.

    Raises
    ------
    SessionError, KernelError
        Its pointing is not solved, or nothing is known of the target.
    """
    pointing, context, inputs = session.state.pointing, session.context, session.inputs
    if pointing is None:
        raise SessionError(f"{context.picture.name}: its pointing is not solved; it cannot be placed.")
    if target is not None and target not in inputs.targets:
        session.add_target(target)
        inputs = session.inputs
    gain = context.camera.gain_e_per_dn
    return StackPicture(
        name=context.picture.name,
        et=inputs.et,
        exposure_s=context.picture.exposure_s,
        signal_dn=context.signal_dn,
        noise_dn=context.noise_dn,
        bad=context.bad | context.picture.saturated,
        camera=context.camera.standing(pointing.camera_from_j2000),
        camera_from_j2000=pointing.camera_from_j2000,
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        psf=picture_psf(context, session.state),
        target=None if target is None else inputs.targets[target],
        attitude_covariance_rad2=pointing.covariance_rad2,
        catalog_covariance_rad2=_catalog_covariance(session),
        excess_sigma_px=pointing.excess_sigma_px,
        gain_e_per_dn=np.inf if gain is None else gain,
        neighbours=_other_directions(session, target),
        pointing_doubt=pointing_doubt(session.state),
    )


def _other_directions(session: ImageSession, target: str | None) -> FloatArray:
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
    attitude = state.pointing.camera_from_j2000
    camera = session.context.camera.standing(attitude)
    total = np.zeros((3, 3))
    for star in used:
        partials = camera.attitude_jacobian(attitude @ state.a_priori.directions[star])
        own = state.a_priori.covariance_px2[star]
        excess = state.pointing.excess_sigma_px**2 * np.eye(2)
        weight = np.linalg.inv(state.centers.covariance_px2[star] + own + excess)
        total += partials.T @ weight @ own @ weight @ partials
    covariance = np.asarray(state.pointing.covariance_rad2)
    return symmetric(covariance @ total @ covariance)
