"""An estimate in the B-plane: where the flyby goes, when, and how sure that is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.estimation.bplane import BPlane, b_plane, b_plane_partials
from opnav_workbench.estimation.results import Estimate

__all__ = ["BPlaneSolution", "ErrorEllipse", "error_ellipse", "map_to_b_plane"]


@dataclass(frozen=True, slots=True)
class ErrorEllipse:
    """One-sigma ellipse of (B.T, B.R).

    Attributes
    ----------
    semi_major_km, semi_minor_km : float
    angle_rad : float
        Of the major axis, from T toward R, 0 to pi.
    """

    semi_major_km: float
    semi_minor_km: float
    angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class BPlaneSolution:
    """An estimate mapped to the B-plane; arrays are read-only.

    Attributes
    ----------
    a_priori, corrected : BPlane
        Of the trajectory before and after the correction.
    values_before, values_after : (3,) arrays
        B.T, B.R (km) and linearised time of flight (s after the epoch), both with the axes of `a_priori`.
    covariance : (3, 3) array
        Of `values_after`: km^2, km s, s^2.
    """

    a_priori: BPlane
    corrected: BPlane
    values_before: FloatArray
    values_after: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def shift(self) -> FloatArray:
        """Return what the correction moved: (B.T, B.R, time), km and s."""
        return np.asarray(self.values_after - self.values_before)

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations of B.T, B.R (km) and time (s)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def ellipse(self) -> ErrorEllipse:
        """Return the one-sigma ellipse of (B.T, B.R)."""
        return error_ellipse(self.covariance[:2, :2])


def error_ellipse(covariance_km2: ArrayLike) -> ErrorEllipse:
    """Return the one-sigma ellipse of a covariance (2, 2) km^2 of (B.T, B.R).

    Examples
    --------
    >>> ellipse = error_ellipse([[4.0, 0.0], [0.0, 9.0]])
    >>> ellipse.semi_major_km, ellipse.semi_minor_km, round(float(np.degrees(ellipse.angle_rad)), 6)
    (3.0, 2.0, 90.0)
    """
    values, vectors = np.linalg.eigh(symmetric(np.asarray(covariance_km2, float)))
    minor, major = (float(np.sqrt(max(v, 0.0))) for v in values)
    return ErrorEllipse(major, minor, float(np.arctan2(vectors[1, 1], vectors[0, 1]) % np.pi))


def map_to_b_plane(
    estimate: Estimate,
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    gm_km3_s2: float = 0.0,
    *,
    pole: str | ArrayLike = "ecliptic",
    body: str = "",
) -> BPlaneSolution:
    """Map an estimate's correction to the B-plane.

    Parameters
    ----------
    estimate : Estimate
    position_km, velocity_km_s : (3,) array_like
        A priori spacecraft relative to the body at the estimate's epoch, J2000, geometric.
    gm_km3_s2, pole
        As in `b_plane`.
    body : str
        The body that the state is relative to, where the estimate corrects bodies one by one; empty for the system.

    Raises
    ------
    EstimationError
        See `b_plane`.
    """
    state = np.concatenate([np.asarray(position_km, float), np.asarray(velocity_km_s, float)])
    correction, covariance = estimate.relative_state(body)
    moved = state + correction
    before = b_plane(state[:3], state[3:], gm_km3_s2, pole)
    after = b_plane(moved[:3], moved[3:], gm_km3_s2, pole)
    partials = b_plane_partials(moved[:3], moved[3:], gm_km3_s2, pole)
    return BPlaneSolution(
        a_priori=before,
        corrected=after,
        values_before=before.in_axes_of(before),
        values_after=after.in_axes_of(before),
        covariance=symmetric(partials @ covariance @ partials.T),
    )
