"""What a fit takes a star to look like: an elliptical Gaussian of unknown shape, or a known PSF.

A Gaussian has three shape parameters (log scale, e1, e2) with a prior; a known PSF (empirical, Moffat, trailed)
has none, and its derivatives with respect to the center are its own.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.psf import Psf, TrailedPsf, box_integrals, box_values, covering_boxes, ellipse_from_shape
from opnav_workbench.starcenters.results import ShapePrior

__all__ = ["GaussianProfile", "KnownProfile", "Profile"]

MAX_ELLIPTICITY = 0.65  # of e1 and e2 each: |e| < 0.92, an axis ratio of 5; longer trails take a TrailedPsf
MIN_SCALE_PX = 0.12  # below this a star is one pixel whatever its sigma
SCALE_RANGE_SIGMAS = 5.0  # how far from its prior the log scale may go
# A fitted scale this fraction of the PSF's is a cosmic ray, where the PSF is wide enough to tell.
COSMIC_RAY_SCALE = 0.5
RESOLVED_SIGMA_PX = 0.6
PIXEL_VARIANCE_PX2 = 1.0 / 12.0


class Profile(Protocol):
    """The image of a point as a function of its center and of n_shape parameters that all stars have."""

    @property
    def mean(self) -> FloatArray:
        """Expected shape parameters, (n_shape,)."""
        ...

    @property
    def information(self) -> FloatArray:
        """Inverse variances of what is known of them, (n_shape,)."""
        ...

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the shape parameters, (n_shape,) each."""
        ...

    @property
    def core_px(self) -> float:
        """Sigma of the core of the expected image."""
        ...

    @property
    def reach_px(self) -> float:
        """Largest sigma of the expected image: that along its trail."""
        ...

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares (n, size, size) of points with the expected shape."""
        ...

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares (n, size, size) and derivatives: along pixel, along line, with each shape parameter."""
        ...

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Ellipses (n, 3) of shapes (n, n_shape): sigma_major_px, sigma_minor_px, angle_rad."""
        ...

    def core(self, shape: FloatArray) -> FloatArray:
        """Sigma of the core of shapes (n, n_shape); (n,)."""
        ...

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """True where a fitted shape (n, n_shape) is that of no star."""
        ...


@dataclass(frozen=True, slots=True)
class GaussianProfile:
    """An elliptical Gaussian, its shape estimated with a prior."""

    prior: ShapePrior

    @property
    def mean(self) -> FloatArray:
        """Log scale, e1, e2."""
        return self.prior.mean

    @property
    def information(self) -> FloatArray:
        """Inverse variances of log scale, e1, e2."""
        return self.prior.information

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of log scale, e1, e2."""
        prior, reach = self.prior, SCALE_RANGE_SIGMAS * self.prior.sigma_log_scale
        limit = max(MAX_ELLIPTICITY, float(np.abs(prior.ellipticity).max()))
        least = max(prior.log_scale - reach, min(np.log(MIN_SCALE_PX), prior.log_scale))
        return np.array([least, -limit, -limit]), np.array([prior.log_scale + min(reach, 2.0), limit, limit])

    @property
    def core_px(self) -> float:
        """Root mean square of the sigmas along the axes."""
        return self.prior.sigma_px

    @property
    def reach_px(self) -> float:
        """Sigma along the major axis."""
        return self.prior.shape.sigma_major_px

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares with the shape of the prior's mean."""
        return box_values(center, np.broadcast_to(self.prior.mean, (len(center), 3)), first, size)

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares and derivatives."""
        psf = box_integrals(center, shape, first, size)
        return psf.value, psf.d_pixel, psf.d_line, psf.d_log_scale, psf.d_e1, psf.d_e2

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Ellipses of the fitted shapes."""
        return ellipse_from_shape(shape[:, 0], shape[:, 1], shape[:, 2])

    def core(self, shape: FloatArray) -> FloatArray:
        """Fitted scales."""
        return np.exp(shape[:, 0])

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """True where the scale is far below the PSF's."""
        sharp = shape[:, 0] < self.prior.log_scale + np.log(COSMIC_RAY_SCALE)
        return np.asarray(sharp & (self.prior.sigma_px >= RESOLVED_SIGMA_PX))


@dataclass(frozen=True, slots=True, eq=False)
class KnownProfile:
    """A PSF taken as it is."""

    psf: Psf
    _ellipse: FloatArray = field(init=False, repr=False)
    core_px: float = field(init=False)  # of a round Gaussian of the same noise area

    def __post_init__(self) -> None:
        if isinstance(self.psf, TrailedPsf):
            object.__setattr__(self, "psf", self.psf.tabulated())
        box = _centered_box(self.psf)
        object.__setattr__(self, "_ellipse", _moments(box))
        object.__setattr__(self, "core_px", _core_sigma(box))

    @property
    def mean(self) -> FloatArray:
        """Nothing."""
        return np.zeros(0)

    @property
    def information(self) -> FloatArray:
        """Nothing."""
        return np.zeros(0)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Nothing."""
        return np.zeros(0), np.zeros(0)

    @property
    def reach_px(self) -> float:
        """Half the width of the noise area along the longer axis: wings hardly count."""
        return self.core_px * float(np.sqrt(self._ellipse[0] / self._ellipse[1]))

    def value(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Shares."""
        return self.psf.box(center, np.asarray(first, np.int64), size)

    def evaluate(
        self, center: FloatArray, shape: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, ...]:
        """Shares and derivatives."""
        del shape
        psf = self.psf.gradient(center, np.asarray(first, np.int64), size)
        return psf.value, psf.d_pixel, psf.d_line

    def ellipse(self, shape: FloatArray) -> FloatArray:
        """Second moments of the PSF, the same for all."""
        return np.broadcast_to(self._ellipse, (len(shape), 3))

    def core(self, shape: FloatArray) -> FloatArray:
        """The same for all."""
        return np.full(len(shape), self.core_px)

    def too_sharp(self, shape: FloatArray) -> BoolArray:
        """Nowhere: the shape is given."""
        return np.zeros(len(shape), bool)


def _centered_box(psf: Psf) -> FloatArray:
    place = np.zeros((1, 2))
    first, size = covering_boxes(psf, place)
    return np.asarray(psf.box(place, first, size)[0])


def _moments(box: FloatArray) -> FloatArray:
    """Ellipse of the second moments, pixel integration taken out."""
    weight = box / box.sum()
    middle = (len(box) - 1) / 2.0
    line, pixel = np.indices(box.shape) - middle
    pixel, line = pixel - np.sum(weight * pixel), line - np.sum(weight * line)
    uu, uv, vv = (float(np.sum(weight * product)) for product in (pixel**2, pixel * line, line**2))
    value, vector = np.linalg.eigh(np.array([[uu, uv], [uv, vv]]) - PIXEL_VARIANCE_PX2 * np.eye(2))
    sigma = np.sqrt(np.maximum(value, MIN_SCALE_PX**2))
    return np.array([sigma[1], sigma[0], np.arctan2(vector[1, 1], vector[0, 1])])


def _core_sigma(box: FloatArray) -> float:
    """Sigma of a round Gaussian with the same noise area 4 pi (sigma^2 + 1/12): wings hardly count."""
    area = box.sum() ** 2 / np.sum(box**2)
    return float(np.sqrt(max(area / (4.0 * np.pi) - PIXEL_VARIANCE_PX2, MIN_SCALE_PX**2)))
