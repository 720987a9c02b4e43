"""What goes into a stack: solved pictures of one camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import Psf

__all__ = ["StackFrame", "check_frames", "weights_of"]

NO_COVARIANCE = np.zeros((3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class StackFrame:
    """One solved picture; arrays are read-only.

    Attributes
    ----------
    name : str
    et, exposure_s : float
        Mid-exposure, TDB seconds past J2000.
    signal_dn, noise_dn : (n_line, n_pixel) array
        Picture without background, and its 1-sigma noise.
    bad : (n_line, n_pixel) array of bool
        Pixels to leave out, also saturated ones.
    camera : Camera
    camera_from_j2000 : (3, 3) array
        Solved attitude.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter.
    psf : Psf
        Of the picture's own stars.
    target : TargetState or None
        As ephemeris expects it; None in a stack that follows the stars.
    attitude_covariance_rad2, catalog_covariance_rad2 : (3, 3) array
        Of the solved attitude, and the part of it that comes from the catalog's errors: the same in all pictures of a
        field, it does not average out.
    excess_sigma_px : float
        Centering error of the picture's stars beyond their covariances.
    gain_e_per_dn : float
        For the target's own shot noise; inf: none.
    neighbours : (k, 3) array
        Apparent directions of other bodies, J2000: bright ones beside a faint target.
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

    def __post_init__(self) -> None:
        shape = np.shape(self.signal_dn)
        if np.shape(self.bad) != shape or np.shape(self.noise_dn) != shape or len(shape) != 2:
            raise CenterfindingError(f"{self.name}: picture, noise and mask differ in shape.")
        freeze_arrays(self)

    @property
    def variance_dn2(self) -> FloatArray:
        """Variance of the background (n_line, n_pixel)."""
        return np.asarray(self.noise_dn**2)

    def replace(self, **changes: Any) -> "StackFrame":
        """Return a copy with some fields changed."""
        return replace(self, **changes)


def check_frames(frames: Sequence[StackFrame], *, follow: str) -> None:
    """Refuse pictures that no stack can be made of.

    Raises
    ------
    CenterfindingError
        Fewer than two, exposures that are not positive, or a target that some do not know.
    """
    if len(frames) < 2:
        raise CenterfindingError(f"a stack needs two pictures at least, got {len(frames)}.")
    for frame in frames:
        if not 0.0 < frame.exposure_s < np.inf:
            raise CenterfindingError(
                f"{frame.name}: exposure of {frame.exposure_s} s; its light cannot be scaled."
            )
        if follow == "target" and frame.target is None:
            raise CenterfindingError(f"{frame.name}: no target to follow; name one, or follow the stars.")
    names = sorted({frame.camera.name for frame in frames})
    if len(names) > 1:
        raise CenterfindingError(f"the pictures are of {', '.join(names)}; stack one camera at a time.")


def weights_of(frames: Sequence[StackFrame]) -> tuple[FloatArray, FloatArray]:
    """Return what each picture's light is worth against the longest one's (n,), and best weights (n,), sum 1.

    A picture of twice the exposure, or of half the noise, counts four times: a faint target is lost in the background.

    Raises
    ------
    CenterfindingError
        A picture without usable pixels or without noise.
    """
    exposure = np.array([frame.exposure_s for frame in frames])
    response = exposure / exposure.max()
    noise = np.array([_typical_noise(frame) for frame in frames])
    weights = (response / noise) ** 2
    return response, weights / weights.sum()


def _typical_noise(frame: StackFrame) -> float:
    noise = float(np.median(frame.noise_dn[~frame.bad])) if (~frame.bad).any() else np.nan
    if not 0.0 < noise < np.inf:
        raise CenterfindingError(
            f"{frame.name}: no usable pixel, or no noise; it cannot be weighted in a stack."
        )
    return noise
