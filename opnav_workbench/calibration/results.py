"""What calibrations hold; arrays are read-only."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.psf import EmpiricalPsf

__all__ = ["CameraCalibration", "PsfCalibration", "open_message"]

STRONG = 0.9  # a correlation above this is worth naming: one parameter is hardly known without the other
NAMED_PART = 0.2  # of an open direction, for a parameter to be named


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A calibrated camera and how far it can be trusted.

    Attributes
    ----------
    camera : Camera
        With the solved values; mounting angles turn its ``focal_from_camera``.
    names : tuple of str
        The q parameters; values in the unit of their name.
    initial, values : (q,) arrays
        Before and after; mounting angles start from 0.
    sigmas : (q,) array
        1 sigma; infinite where a parameter belongs to a combination that is not determined.
    covariance : (q, q) array
        Determined combinations only.
    open_directions : (k, q) array
        Combinations that are not determined: unit vectors in units of one pixel's effect of each parameter.
    attitudes : (m, 3, 3) array
        camera_from_j2000 of the frames, for directions in the frame of the uncalibrated camera.
    used : (n,) array of bool
        Stars that were not rejected as outliers.
    residual_before_px, residual_after_px : (n, 2) arrays
        Observed minus computed, every frame's attitude fitted, with the old and with the new camera.
    excess_sigma_px : float
        Centering error beyond the given covariances that the remaining scatter asks for.
    chi2_reduced : float
        Per degree of freedom, with the given covariances.
    iterations : int
    messages : tuple of str
        What is not determined, and what else the analyst should know.
    """

    camera: Camera
    names: tuple[str, ...]
    initial: FloatArray
    values: FloatArray
    sigmas: FloatArray
    covariance: FloatArray
    open_directions: FloatArray
    attitudes: FloatArray
    used: BoolArray
    residual_before_px: FloatArray
    residual_after_px: FloatArray
    excess_sigma_px: float
    chi2_reduced: float
    iterations: int
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def rms_before_px(self) -> float:
        """Root mean square of the residuals of the used stars, per coordinate, with the old camera."""
        return float(np.sqrt(np.mean(self.residual_before_px[self.used] ** 2)))

    @property
    def rms_after_px(self) -> float:
        """The same with the new camera."""
        return float(np.sqrt(np.mean(self.residual_after_px[self.used] ** 2)))

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (q, q) of the parameters; nan for those that are not determined."""
        sigma = np.where(np.isfinite(self.sigmas) & (self.sigmas > 0.0), self.sigmas, np.nan)
        return np.asarray(self.covariance / np.outer(sigma, sigma))

    @property
    def strong_correlations(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters that are hardly known one without the other, the strongest first."""
        matrix = self.correlation
        pairs = [
            (self.names[i], self.names[j], float(matrix[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(matrix[i, j]) > STRONG
        ]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))


@dataclass(frozen=True, slots=True, eq=False)
class PsfCalibration:
    """An empirical PSF and how much better than a Gaussian it explains its stars.

    Attributes
    ----------
    psf : EmpiricalPsf
    n_stars : int
    smoothness : float
        Weight of the cells' second differences that explained other stars best.
    gaussian_chi2, empirical_chi2 : (n_stars,) arrays
        Reduced chi-squared of the stars' images, fitted with their mean Gaussian and with the new PSF.
    held_out_chi2 : float
        Median of the latter for stars that were left out of the stack.
    moved_px : float
        Root mean square shift between Gaussian and empirical centers, per coordinate.
    used_frames : (m,) array of bool
        False for frames whose stars have another shape.
    messages : tuple of str
    """

    psf: EmpiricalPsf
    n_stars: int
    smoothness: float
    gaussian_chi2: FloatArray
    empirical_chi2: FloatArray
    held_out_chi2: float
    moved_px: float
    used_frames: BoolArray
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)


def open_message(direction: FloatArray, names: tuple[str, ...]) -> str:
    """Say which parameters a direction that is not determined binds together."""
    order = np.argsort(-np.abs(direction))
    parts = [f"{direction[i]:+.2f} {names[i]}" for i in order if abs(direction[i]) > NAMED_PART]
    if len(parts) == 1:
        return (
            f"{names[order[0]]} is not determined by these frames (their own attitudes take up what it does): it keeps "
            "its value; leave it out, or give frames that tell it"
        )
    return (
        f"the combination {' '.join(parts)} (each in units of one pixel's effect) is not determined by these frames: "
        "its value stays; leave one of these parameters out, or give frames that tell them apart"
    )
