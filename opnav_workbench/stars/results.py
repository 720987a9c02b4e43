"""What the centerfinders take and return: PSF shapes and their priors, noise, centers of stars, images to judge them by.

Arrays are read-only. Units are DN and px; places are (pixel, line), boxes are indexed [star, line, pixel].
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import PsfCorrection, box_values, ellipse_from_shape, shape_from_ellipse
from opnav_workbench.psf.correction import phases_of_a_pixel
from opnav_workbench.stars.flags import StarFlag

__all__ = ["NoiseModel", "PsfShape", "ShapePrior", "StarCenters", "StarImages"]


# ---- What a person looks at to judge a center.


@dataclass(frozen=True, slots=True, eq=False)
class StarImages:
    """Boxes around n stars as a centerfinder saw them, indexed [star, line, pixel]."""

    first: IntArray  # (n, 2) pixel, line of the first pixel of each box
    data_dn: FloatArray  # (n, size, size), nan where bad, saturated or off the detector
    model_dn: FloatArray  # (n, size, size) star, its neighbors and background: template or fitted PSF
    sigma_dn: FloatArray  # (n, size, size) noise used for the weights, infinite where a pixel was left out
    # (n, size, size) of the matched filter (in sigmas) or cross-correlation, nan where not searched; else none
    surface: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return int(self.data_dn.shape[-1])

    @property
    def residual_dn(self) -> FloatArray:
        """Data minus model (n, size, size), nan where there are no data."""
        return self.data_dn - self.model_dn

    @property
    def weighted_residual(self) -> FloatArray:
        """Residual in sigmas (n, size, size), 0 where a pixel was left out."""
        return np.where(np.isfinite(self.sigma_dn), self.residual_dn / self.sigma_dn, 0.0)


# ---- What the centerfinders take and return: PSF shapes, noise, star centers; arrays are read-only.

# A center with one of these is not a measurement of the star.
UNUSABLE_FLAGS = (
    StarFlag.NOT_CONVERGED | StarFlag.LOW_SNR | StarFlag.AT_BOUND | StarFlag.COSMIC_RAY | StarFlag.NOT_FINITE
)

DEFAULT_SIGMA_LOG_SCALE = 0.3  # a PSF width known to 30 %: what a camera description is good for
CORE_HALF_SIGMAS = 3.0  # half the side of the square that holds what counts of a star
DEFAULT_SIGMA_ELLIPTICITY = 0.2  # sigmas along the axes differ by 20 %: optics and a smear of half a sigma


@dataclass(frozen=True, slots=True)
class PsfShape:
    """An elliptical Gaussian PSF before integration over the pixels."""

    sigma_major_px: float
    sigma_minor_px: float
    angle_rad: float = 0.0  # of the major axis, from +pixel toward +line

    def __post_init__(self) -> None:
        if not 0.0 < self.sigma_minor_px <= self.sigma_major_px < np.inf:
            raise CenterfindingError(
                f"PSF sigmas must be 0 < minor <= major, got {self.sigma_minor_px}, {self.sigma_major_px} px."
            )

    @property
    def parameters(self) -> FloatArray:
        """Log scale, e1, e2; (3,)."""
        return shape_from_ellipse(np.array([self.sigma_major_px, self.sigma_minor_px, self.angle_rad]))


@dataclass(frozen=True, slots=True, eq=False)
class ShapePrior:
    """What is known of the PSF beforehand, as Gaussians on ln(scale/px) and on the ellipticity (e1, e2)."""

    log_scale: float
    sigma_log_scale: float
    ellipticity: FloatArray  # (2,)
    sigma_ellipticity: float
    correction: PsfCorrection | None = None  # what the Gaussian leaves of the PSF

    def __post_init__(self) -> None:
        ellipticity = np.asarray(self.ellipticity, dtype=float)
        if ellipticity.shape != (2,) or not np.hypot(*ellipticity) < 1.0 or not np.isfinite(self.log_scale):
            raise CenterfindingError(
                f"a PSF prior needs a finite log scale and an ellipticity (e1, e2) inside the unit circle, "
                f"got {self.log_scale} and {self.ellipticity}."
            )
        if not (0.0 < self.sigma_log_scale < np.inf and 0.0 < self.sigma_ellipticity < np.inf):
            raise CenterfindingError(
                f"PSF prior sigmas must be positive: {self.sigma_log_scale}, {self.sigma_ellipticity}."
            )
        object.__setattr__(self, "ellipticity", ellipticity)
        freeze_arrays(self)

    @classmethod
    def round_psf(
        cls,
        sigma_px: float,
        sigma_log_scale: float = DEFAULT_SIGMA_LOG_SCALE,
        sigma_ellipticity: float = DEFAULT_SIGMA_ELLIPTICITY,
    ) -> "ShapePrior":
        """Return the prior of a round PSF of `sigma_px`, known to `sigma_log_scale` (a fraction).

        Examples
        --------
        >>> ShapePrior.round_psf(0.65).sigma_px
        0.65
        """
        if not 0.0 < sigma_px < np.inf:
            raise CenterfindingError(f"the PSF sigma must be positive, got {sigma_px} px.")
        return cls(float(np.log(sigma_px)), sigma_log_scale, np.zeros(2), sigma_ellipticity)

    @property
    def sigma_px(self) -> float:
        """Scale of the PSF: root mean square of the sigmas along its axes."""
        return float(np.exp(self.log_scale))

    @property
    def mean(self) -> FloatArray:
        """Log scale, e1, e2; (3,)."""
        return np.array([self.log_scale, *self.ellipticity])

    @property
    def correction_part(self) -> float:
        """The correction and its errors as a part of the star's image (root of sums of squares).

        A star of another color or brightness differs from the picture's others by less than they do from a Gaussian.
        """
        if self.correction is None:
            return 0.0
        center, size = phases_of_a_pixel(), 2 * int(np.ceil(CORE_HALF_SIGMAS * self.sigma_px)) + 1
        first = np.full(center.shape, -(size // 2.0))
        image = box_values(center, np.broadcast_to(self.mean, (len(center), 3)), first, size)
        added, errors = (
            self.correction.evaluate(center, first, size)[0],
            self.correction.errors(center, first, size),
        )
        return float(np.sqrt((np.sum(added**2) + np.sum(errors**2)) / np.sum((image + added) ** 2)))

    @property
    def information(self) -> FloatArray:
        """Inverse variances of log scale, e1, e2; (3,)."""
        sigmas = np.array([self.sigma_log_scale, self.sigma_ellipticity, self.sigma_ellipticity])
        return np.asarray(sigmas**-2.0)

    @property
    def shape(self) -> PsfShape:
        """The most likely PSF."""
        major, minor, angle = ellipse_from_shape(self.log_scale, *self.ellipticity)
        return PsfShape(float(major), float(minor), float(angle))


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a pixel: read noise, and the shot noise of the electrons in it."""

    read_noise_dn: float
    gain_e_per_dn: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.read_noise_dn < np.inf and 0.0 < self.gain_e_per_dn < np.inf):
            raise CenterfindingError(
                "read noise must be >= 0 and gain > 0, "
                f"got {self.read_noise_dn} DN and {self.gain_e_per_dn} e/DN."
            )

    def sigma_dn(self, signal_dn: FloatArray) -> FloatArray:
        """Return the 1-sigma noise (DN) of pixels that hold `signal_dn` above bias.

        Examples
        --------
        >>> float(NoiseModel(3.0, 2.0).sigma_dn(32.0))
        5.0
        """
        return np.sqrt(self.read_noise_dn**2 + np.maximum(signal_dn, 0.0) / self.gain_e_per_dn)


@dataclass(frozen=True, slots=True, eq=False)
class StarCenters:
    """Centers of n stars with their covariance; nan only where `flags` says NOT_FINITE."""

    pixel_line: FloatArray  # (n, 2)
    covariance_px2: FloatArray  # (n, 2, 2)
    flux_dn: FloatArray  # (n,) total, over the whole plane
    flux_sigma_dn: FloatArray  # (n,)
    background_dn: FloatArray  # (n,) at the star
    shape: FloatArray  # (n, 3) sigma_major_px, sigma_minor_px, angle_rad (from +pixel toward +line)
    shape_covariance: FloatArray  # (n, 3, 3) of log scale, e1, e2 (see `psf`), prior included
    chi2_reduced: FloatArray  # (n,)
    snr: FloatArray  # (n,) flux over its sigma
    degrees_of_freedom: FloatArray  # (n,) pixels used less parameters estimated from them
    flags: IntArray  # (n,) sum of StarFlag
    method: str
    psf_error: float = 0.0  # relative error of the PSF model that the covariance allows for
    images: StarImages | None = None  # what a person looks at
    # (n, 2, r) what each of r independent one-sigma errors of a PSF learned from these stars makes of all centers at once;
    # part of `covariance_px2`
    common_px: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.flags)

    @property
    def sigma_px(self) -> FloatArray:
        """1-sigma of (pixel, line); (n, 2)."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    @property
    def amplitude_dn(self) -> FloatArray:
        """Height of the Gaussian before integration over pixels, the paper's amplitude; (n,)."""
        return self.flux_dn / (2.0 * np.pi * self.shape[:, 0] * self.shape[:, 1])

    @property
    def usable(self) -> BoolArray:
        """True where the center is a measurement; (n,)."""
        return np.asarray((self.flags & int(UNUSABLE_FLAGS)) == 0)
