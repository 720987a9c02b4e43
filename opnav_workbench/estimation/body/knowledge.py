"""What a batch over a sequence solves for, and what is believed of it before the first picture.

Twenty numbers that all pictures share, in the order of `PARAMETERS`; then the error of each picture's attitude; then the
place of each landmark.

Units  km, km/s, rad, rad/s, px; sizes as logarithms
"""

from dataclasses import dataclass, fields

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import EstimationError

__all__ = ["PARAMETERS", "BodyKnowledge", "Group"]


@dataclass(frozen=True, slots=True)
class Group:
    """Parameters that belong together: where they stand among those shared, what they are called, and their unit."""

    columns: slice
    labels: tuple[str, ...]
    unit: str


POSITION = Group(slice(0, 3), ("position x", "position y", "position z"), "km")
VELOCITY = Group(slice(3, 6), ("velocity x", "velocity y", "velocity z"), "km/s")
RADII = Group(slice(6, 9), ("radius a", "radius b", "radius c"), "of it")
POLE = Group(slice(9, 11), ("pole toward east", "pole toward north"), "rad")
MERIDIAN = Group(slice(11, 12), ("prime meridian",), "rad")
SPIN = Group(slice(12, 13), ("spin rate",), "rad/s")
OFFSET = Group(slice(13, 16), ("center of figure x", "center of figure y", "center of figure z"), "km")
LIMB = Group(slice(16, 17), ("limb, all pictures",), "px")
MAP = Group(slice(17, 20), ("landmarks' scale x", "landmarks' scale y", "landmarks' scale z"), "of it")
PARAMETERS = (POSITION, VELOCITY, RADII, POLE, MERIDIAN, SPIN, OFFSET, LIMB, MAP)
SHARED = MAP.columns.stop


@dataclass(frozen=True, slots=True)
class BodyKnowledge:
    """What is believed before, as standard deviations; all greater than zero.

    Attributes
    ----------
    position_sigma_km, velocity_sigma_km_s
        Of each axis of the body's state relative to the spacecraft, at the epoch.
    size_sigma, axes_sigma
        Of the common size, and of each axis beside it, as parts of themselves.
    pole_sigma_deg, meridian_sigma_deg
        Of the pole toward each side; of the prime meridian at the epoch.
    spin_sigma
        Of the spin rate, as a part of it.
    offset_sigma
        Of the center of figure from the center of mass, each axis, as a part of the mean radius.
    limb_sigma_px
        Of how far all limbs may be read too far out: what law and PSF that are not quite true leave.
    map_sigma
        Of the scale of the landmarks' places along each axis, as a part of it.

    Raises
    ------
    EstimationError
        One of them is not greater than zero.
    """

    position_sigma_km: float = 100.0
    velocity_sigma_km_s: float = 1e-5
    size_sigma: float = 0.10
    axes_sigma: float = 0.05
    pole_sigma_deg: float = 5.0
    meridian_sigma_deg: float = 10.0
    spin_sigma: float = 1e-3
    offset_sigma: float = 0.02
    limb_sigma_px: float = 0.1
    map_sigma: float = 0.02

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < np.inf:
                raise EstimationError(
                    f"{field.name} is {value}; give a standard deviation greater than zero."
                )

    def covariance(self, mean_radius_km: float, rate_rad_s: float) -> FloatArray:
        """Return the covariance (20, 20) of what all pictures share."""
        sigma = np.zeros(SHARED)
        pole, meridian = np.radians(self.pole_sigma_deg), np.radians(self.meridian_sigma_deg)
        for group, value in (
            (POSITION, self.position_sigma_km),
            (VELOCITY, self.velocity_sigma_km_s),
            (RADII, self.axes_sigma),
            (POLE, pole),
            (MERIDIAN, meridian),
            (SPIN, self.spin_sigma * abs(rate_rad_s)),
            (OFFSET, self.offset_sigma * mean_radius_km),
            (LIMB, self.limb_sigma_px),
            (MAP, self.map_sigma),
        ):
            sigma[group.columns] = value
        out = np.diag(sigma**2)
        out[RADII.columns, RADII.columns] += self.size_sigma**2
        return out
