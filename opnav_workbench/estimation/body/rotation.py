"""A body that spins evenly about a fixed axis, as three terms of a PCK have it.

    body_from_j2000 = R3(W) R1(90 deg - Dec) R3(90 deg + RA),   W = W0 + rate (t - epoch)

Source: Archinal et al. (2018), Celest. Mech. Dyn. Astr. 130, 22; NAIF, PCK Required Reading.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import (
    radec_from_unit,
    rotation_from_vector,
    tangent_basis,
    unit_from_radec,
    vector_from_rotation,
)

__all__ = ["BodyRotation"]

STEP_S = 30.0  # between attitudes that tell the rate: no body turns by half a turn in it
TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class BodyRotation:
    """Pole, prime meridian and spin of a body.

    Attributes
    ----------
    pole_ra_rad, pole_dec_rad
        J2000.
    meridian_rad
        Prime meridian W at the epoch: from the node of the body's equator on that of J2000, along the body's equator.
    rate_rad_s
        Of W; negative where it turns the other way.
    epoch_et
        TDB seconds past J2000.

    Examples
    --------
    >>> rotation = BodyRotation(0.0, 0.5 * np.pi, 0.0, 1e-4, 0.0)
    >>> (rotation.body_from_j2000(0.0) @ [1.0, 0.0, 0.0]).round(12) + 0.0
    array([ 0., -1.,  0.])
    """

    pole_ra_rad: float
    pole_dec_rad: float
    meridian_rad: float
    rate_rad_s: float
    epoch_et: float

    @classmethod
    def from_attitudes(cls, attitude: Callable[[float], FloatArray], epoch_et: float) -> "BodyRotation":
        """Return the even rotation that a body's attitudes, ``body_from_j2000`` of a time, have about an epoch.

        Raises
        ------
        EstimationError
            The body does not turn about its z axis, as one that tumbles.
        """
        before, after = attitude(epoch_et - STEP_S), attitude(epoch_et + STEP_S)
        turned = -vector_from_rotation(after @ before.T) / (2.0 * STEP_S)
        across = float(np.hypot(turned[0], turned[1]))
        if across > 0.01 * max(abs(float(turned[2])), 1e-12):
            raise EstimationError(
                f"the body turns about another axis than its z axis ({across:.3g} of {np.linalg.norm(turned):.3g} rad/s): a "
                "body that tumbles cannot be solved for."
            )
        return cls._of(attitude(epoch_et), float(turned[2]), epoch_et)

    @classmethod
    def _of(cls, matrix: FloatArray, rate_rad_s: float, epoch_et: float) -> "BodyRotation":
        ra, dec = (float(x) for x in radec_from_unit(matrix[2]))
        east, north = tangent_basis(ra, dec)
        meridian = np.arctan2(matrix[0] @ north, matrix[0] @ east)  # the node lies east of the pole
        return cls(ra, dec, float(meridian) % TURN, rate_rad_s, epoch_et)

    @property
    def pole(self) -> FloatArray:
        """Unit vector (3,) of the pole, J2000."""
        return unit_from_radec(self.pole_ra_rad, self.pole_dec_rad)

    def body_from_j2000(self, et: float) -> FloatArray:
        """Return the attitude (3, 3) at a time."""
        east, north = tangent_basis(self.pole_ra_rad, self.pole_dec_rad)
        angle = self.meridian_rad + self.rate_rad_s * (et - self.epoch_et)
        x = np.cos(angle) * east + np.sin(angle) * north
        return np.stack([x, np.cross(self.pole, x), self.pole])

    def at_epoch(self, epoch_et: float) -> "BodyRotation":
        """Return the same rotation with another epoch."""
        return self._of(self.body_from_j2000(epoch_et), self.rate_rad_s, epoch_et)

    def turned(self, step: FloatArray) -> "BodyRotation":
        """Return a rotation near by.

        Parameters
        ----------
        step : (4,) array
            The pole moves east and north (rad) on the shortest way, then the body turns about it: phase at the epoch (rad)
            and rate (rad/s).
        """
        east, north = tangent_basis(self.pole_ra_rad, self.pole_dec_rad)
        tilt = rotation_from_vector(np.cross(self.pole, step[0] * east + step[1] * north))
        spun = rotation_from_vector(np.array([0.0, 0.0, -step[2]]))
        matrix = spun @ self.body_from_j2000(self.epoch_et) @ tilt.T
        return self._of(matrix, self.rate_rad_s + float(step[3]), self.epoch_et)

    def step_to(self, other: "BodyRotation") -> FloatArray:
        """Return the step (4,) with which `turned` leads to another rotation.

        Examples
        --------
        >>> rotation, step = BodyRotation(0.3, 0.9, 1.0, 1e-4, 0.0), np.array([2e-3, -1e-3, 4e-3, 1e-8])
        >>> bool(np.allclose(rotation.step_to(rotation.turned(step)), step, atol=1e-12))
        True
        """
        there = other.at_epoch(self.epoch_et)
        axis, cosine = np.cross(self.pole, there.pole), float(self.pole @ there.pole)
        sine = float(np.linalg.norm(axis))
        turn = axis * (np.arctan2(sine, cosine) / sine) if sine > 0.0 else np.zeros(3)
        toward = np.cross(turn, self.pole)
        east, north = tangent_basis(self.pole_ra_rad, self.pole_dec_rad)
        tilt = rotation_from_vector(turn)
        spun = there.body_from_j2000(self.epoch_et) @ tilt @ self.body_from_j2000(self.epoch_et).T
        phase = -float(vector_from_rotation(spun)[2])
        return np.array([toward @ east, toward @ north, phase, there.rate_rad_s - self.rate_rad_s])

    def partials(self, et: float) -> FloatArray:
        """Return how the attitude at a time turns with the step of `turned`, (3, 4).

        A small rotation vector phi about the body's axes, ``true = rotation_from_vector(phi) @ body_from_j2000``.
        """
        east, north = tangent_basis(self.pole_ra_rad, self.pole_dec_rad)
        attitude = self.body_from_j2000(et)
        tilts = -attitude @ np.cross(self.pole, np.stack([east, north])).T
        spin = np.array([0.0, 0.0, -1.0])
        return np.column_stack([tilts, spin, spin * (et - self.epoch_et)])

    def angles_jacobian(self) -> FloatArray:
        """Return d(RA, Dec, W at the epoch, rate)/d(step of `turned`), (4, 4).

        The prime meridian counts from the node, which moves with the pole.
        """
        out = np.eye(4)
        cosine = max(np.cos(self.pole_dec_rad), 1e-9)
        out[0, 0] = 1.0 / cosine
        out[2, 0] = -np.tan(min(abs(self.pole_dec_rad), 0.5 * np.pi - 1e-9)) * np.sign(self.pole_dec_rad)
        return out

    def pck_terms(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Return pole RA, pole Dec and prime meridian at J2000 with their rates, deg and deg/day, as a PCK has them."""
        at_zero = (self.meridian_rad - self.rate_rad_s * self.epoch_et) % TURN
        rate = float(np.degrees(self.rate_rad_s)) * DAY_S
        ra, dec, meridian = (float(np.degrees(x)) for x in (self.pole_ra_rad, self.pole_dec_rad, at_zero))
        return (ra,), (dec,), (meridian, rate)
