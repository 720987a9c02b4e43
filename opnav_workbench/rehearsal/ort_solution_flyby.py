"""The flyby of a rehearsal as its predicted kernels have it, and where corrections of it lie in the B-plane."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.estimation import BPlane, b_plane, b_plane_partials
from opnav_workbench.mission import load_mission
from opnav_workbench.spice import KernelSet, et_from_utc, state

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.ort_package import OrtPackage

__all__ = ["Flyby", "predicted_flyby"]


@dataclass(frozen=True, slots=True, eq=False)
class Flyby:
    """The predicted flyby.

    Attributes
    ----------
    body : str
        Of the B-plane.
    epoch_et : float
        Of the state and of the estimated corrections, TDB seconds past J2000.
    epoch_utc : str
    state : (6,) array
        Spacecraft relative to the body, J2000, geometric, km and km/s.
    gm_km3_s2 : float
    pole : str
    plane : BPlane
        Of that state.
    """

    body: str
    epoch_et: float
    epoch_utc: str
    state: FloatArray
    gm_km3_s2: float
    pole: str
    plane: BPlane

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def values(self) -> FloatArray:
        """Return (B.T, B.R, linearised time after the epoch), km and s."""
        return self.plane.in_axes_of(self.plane)

    def moved(self, correction: ArrayLike) -> FloatArray:
        """Return the same of the state with a correction (6,), in the axes of the predicted flyby."""
        state = self.state + np.asarray(correction, float)
        return b_plane(state[:3], state[3:], self.gm_km3_s2, self.pole).in_axes_of(self.plane)

    def covariance(self, correction: ArrayLike, covariance: ArrayLike) -> FloatArray:
        """Map a covariance (6, 6) of the corrected state to (B.T, B.R, time), (3, 3) km^2, km s, s^2."""
        state = self.state + np.asarray(correction, float)
        partials = b_plane_partials(state[:3], state[3:], self.gm_km3_s2, self.pole)
        return symmetric(partials @ np.asarray(covariance, float) @ partials.T)


def predicted_flyby(package: "OrtPackage") -> Flyby:
    """Return the flyby that a package's own kernels predict.

    Raises
    ------
    KernelError
        The kernels do not hold spacecraft or body at the epoch.
    EstimationError
        There is no flyby.
    """
    body = package.b_plane.body
    spacecraft = load_mission(package.mission).spacecraft_id
    with KernelSet(package.metakernel):
        epoch = et_from_utc(package.epoch_utc)
        found = state(spacecraft, epoch, body)
    relative = np.concatenate([found.position_km, found.velocity_km_s])
    plane = b_plane(relative[:3], relative[3:], package.b_plane.gm_km3_s2, package.b_plane.pole)
    return Flyby(
        body, epoch, package.epoch_utc, relative, package.b_plane.gm_km3_s2, package.b_plane.pole, plane
    )
