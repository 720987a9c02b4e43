"""What all scans share beside the center: how the surface darkens toward the limb, and how wide the PSF is.

A scattering law or a PSF that is a little wrong moves the limb by the same amount all around (a PSF 20 % too wide by half
a pixel), which a limb seen from one side only cannot tell from a shift of the body. But both change the shape of the
profile too, and the same way in every scan, which albedo does not: so they are solved for from all scans together, and
taken out where they are significant.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.scan_matching import ScanSystem

__all__ = ["BLUR", "LAW", "Common", "find_roughness", "no_common", "solve_common"]

LAW, BLUR = 0, 1  # share of another law (`scan_law`); variance added to the PSF, px^2
LAW_SIGMA = 0.5  # a priori: half the way from Lambert to Lommel-Seeliger
BLUR_SIGMA = 0.5  # a priori, of the PSF's variance: a width known to a quarter
SIGNIFICANT = 5.0  # sigmas
ROUGHNESSES = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2)
SPOKEN_FOR = 4.0  # gain in logarithmic likelihood that makes an albedo uneven


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """Values (g,) of what all scans share, and their covariance (g, g); zero where nothing was significant."""

    values: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def no_common() -> Common:
    """Return that nothing is known to be wrong."""
    return Common(np.zeros(2), np.zeros((2, 2)))


def solve_common(
    system: ScanSystem, roughness: float, chosen: BoolArray, psf_variance_px2: float, alike: float
) -> Common:
    """Solve for what the chosen scans share; what is not significant is left at zero.

    `alike` is the number of neighbouring scans that tell the same.
    """
    normal, right = (part / alike for part in system.common_normal(roughness, chosen))
    prior = _prior(psf_variance_px2)
    active = np.array([True, True])
    while active.any():
        rows = np.ix_(active, active)
        covariance = np.linalg.inv(normal[rows] + prior[rows])
        values = covariance @ right[active]
        strength = np.abs(values) / np.sqrt(np.diag(covariance))
        if strength.min() >= SIGNIFICANT:
            out = no_common()
            all_values, all_covariance = np.array(out.values), np.array(out.covariance)
            all_values[active], all_covariance[rows] = values, covariance
            return Common(all_values, all_covariance)
        active[np.flatnonzero(active)[strength.argmin()]] = False
    return no_common()


def find_roughness(system: ScanSystem, chosen: BoolArray, psf_variance_px2: float) -> float:
    """Return the albedo's relative scatter under which the chosen scans are most likely; 0 if they do not ask for one.

    What they share is free, so that a wrong scattering law does not pass for a rough albedo.
    """
    prior = _prior(psf_variance_px2)

    def likelihood(roughness: float) -> float:
        normal, right = system.common_normal(roughness, chosen)
        shared = 0.5 * right @ np.linalg.solve(normal + prior, right)
        return float(system.likelihood(roughness)[chosen].sum() + shared)

    tried = (0.0, *ROUGHNESSES)
    found = [likelihood(roughness) for roughness in tried]
    best = int(np.argmax(found))
    return 0.0 if found[best] < found[0] + SPOKEN_FOR else tried[best]


def _prior(psf_variance_px2: float) -> FloatArray:
    return np.diag([LAW_SIGMA**-2.0, (BLUR_SIGMA * psf_variance_px2) ** -2.0])
