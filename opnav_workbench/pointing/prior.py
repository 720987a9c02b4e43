"""What is known of the attitude beforehand, as measurements beside the stars.

twist     the a priori rotation about the boresight: one measurement, which enters where, and only where, the stars
          alone determine that rotation less well: with one star always, with two when they are close together
attitude  all three angles with their covariance: three measurements, which always enter
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.geometry import vector_from_rotation

__all__ = ["Prior"]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """An a priori attitude and how well it is known.

    Attributes
    ----------
    attitude : (3, 3) array
        camera_from_j2000.
    axis : (3,) array
        Boresight, camera frame.
    twist_sigma_rad : float
        1 sigma of the rotation about it.
    covariance_rad2 : (3, 3) array or None
        Of the rotation vector about the camera frame's axes; None where only the twist counts.
    """

    attitude: FloatArray
    axis: FloatArray
    twist_sigma_rad: float
    covariance_rad2: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def rows(self, stars_twist_information: float) -> FloatArray:
        """Return what enters, (k, 3), in units of its sigmas: k is 3, 1 or 0.

        Parameters
        ----------
        stars_twist_information : float
            Inverse variance, rad^-2, with which the stars alone determine the twist.
        """
        if self.covariance_rad2 is not None:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance_rad2)))
        if self.decides_twist(stars_twist_information):
            return np.asarray(self.axis[None] / self.twist_sigma_rad)
        return np.zeros((0, 3))

    def decides_twist(self, stars_twist_information: float) -> bool:
        """Tell whether the stars alone determine the twist less well."""
        covariance = self.covariance_rad2
        variance = self.twist_sigma_rad**2 if covariance is None else self.axis @ covariance @ self.axis
        return bool(stars_twist_information * variance < 1.0)

    def residual(self, rows: FloatArray, attitude: FloatArray) -> FloatArray:
        """Return a priori minus `attitude`, (k,), in units of the sigmas of `rows`."""
        return np.asarray(-rows @ vector_from_rotation(attitude @ self.attitude.T))
