"""Macroscopic roughness: effective angles and shadowing of a surface of many small slopes.

Source: Hapke, Icarus 59, 41 (1984), doi:10.1016/0019-1035(84)90054-X, equations 46 to 64.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray

__all__ = ["rough_angles"]

SMALLEST_SINE = 1e-9  # keeps cot(angle) finite for straight-down light; exp(-cot) is zero long before


def rough_angles(
    mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray, mean_slope_rad: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return effective cos i and cos e, and the shadowing function, for positive cosines.

    A mean slope of zero gives the cosines back, and 1.

    Examples
    --------
    >>> rough_angles(np.array([0.5]), np.array([0.8]), np.array([0.4]), 0.0)
    (array([0.5]), array([0.8]), array([1.]))
    """
    if mean_slope_rad == 0.0:
        return mu0, mu, np.ones(np.broadcast_shapes(mu0.shape, mu.shape))
    mu0, mu, phase_rad = np.broadcast_arrays(mu0, mu, phase_rad)
    tan_slope = np.tan(mean_slope_rad)
    chi = 1.0 / np.sqrt(1.0 + np.pi * tan_slope**2)
    azimuth = _azimuth(mu0, mu, phase_rad)
    hidden = np.exp(-2.0 * np.tan(np.minimum(0.5 * azimuth, 0.5 * np.pi - SMALLEST_SINE)))
    # The equations treat the steeper of the two directions apart; with it as "far" one form serves both cases.
    near, far = np.maximum(mu0, mu), np.minimum(mu0, mu)
    bend = _bend(near, far, azimuth, tan_slope)
    near_e = chi * (near + _sine(near) * tan_slope * bend[0])
    far_e = chi * (far + _sine(far) * tan_slope * bend[1])
    sun_steeper = mu0 < mu
    mu0_e, mu_e = np.where(sun_steeper, far_e, near_e), np.where(sun_steeper, near_e, far_e)
    eta0, eta = _eta(mu0, tan_slope, chi), _eta(mu, tan_slope, chi)
    nearer = np.where(sun_steeper, mu / eta, mu0 / eta0)
    shade = mu_e / eta * (mu0 / eta0) * chi / (1.0 - hidden + hidden * chi * nearer)
    return mu0_e, mu_e, shade


def _bend(
    near: FloatArray, far: FloatArray, azimuth: FloatArray, tan_slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return what tilts the effective angles: of the direction nearer the normal, and of the other."""
    half = np.sin(0.5 * azimuth) ** 2
    e1_near, e2_near = _exponentials(near, tan_slope)
    e1_far, e2_far = _exponentials(far, tan_slope)
    below = 2.0 - e1_far - azimuth / np.pi * e1_near
    return (np.cos(azimuth) * e2_far + half * e2_near) / below, (e2_far - half * e2_near) / below


def _azimuth(mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
    """Return the angle between the planes of incidence and emission, 0..pi."""
    sines = np.maximum(_sine(mu0) * _sine(mu), SMALLEST_SINE**2)
    return np.asarray(np.arccos(np.clip((np.cos(phase_rad) - mu0 * mu) / sines, -1.0, 1.0)))


def _eta(mu: FloatArray, tan_slope: float, chi: float) -> FloatArray:
    e1, e2 = _exponentials(mu, tan_slope)
    return np.asarray(chi * (mu + _sine(mu) * tan_slope * e2 / (2.0 - e1)))


def _exponentials(mu: FloatArray, tan_slope: float) -> tuple[FloatArray, FloatArray]:
    cot = mu / np.maximum(_sine(mu), SMALLEST_SINE) / tan_slope
    return np.exp(-2.0 / np.pi * cot), np.exp(-(cot**2) / np.pi)


def _sine(mu: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(1.0 - mu * mu, 0.0)))
