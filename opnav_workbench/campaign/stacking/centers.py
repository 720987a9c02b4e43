"""Center of a target in a stack, with a sigma that knows how the stack was made.

Flow   `find_unresolved` on the stack (is it there, where about, is it a point) -> least squares with the exact image of
       a point in the stack -> covariance from the exact covariance of the stack's pixels

The image of a point in the stack depends on where it falls between the pixels of every picture; it is computed, not
assumed: each picture's PSF at its own place, sent through the same resampling, weights and subtraction as the data.
Stacked pixels are correlated, so the covariance of the fit is A C A^T with the fit's own linear map A and the pixels'
covariance C, not the inverse of the normal matrix.

The signal-to-noise ratio of the flux grows as the root of the number of pictures, if all is well (`snr_growth`).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.bodies import BodyCenter, find_unresolved
from opnav_workbench.bodies.unresolved import NEIGHBOUR_SIGMAS
from opnav_workbench.campaign.stacking.combining import Stacked, average
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import Psf, covering_boxes
from opnav_workbench.stars import ShapePrior
from opnav_workbench.stars.picture_fit import faint_factor, misfit_factor

__all__ = ["Growth", "PointFit", "find_in_stack", "fit_point", "snr_growth"]


# ---- Center of a target in a stack, with a sigma that knows how the stack was made.

METHOD = "stack"
DEFAULT_SEARCH_PX = 3.0
BOX_SIGMAS = 4.0  # half side of the fitted box; one more pixel for what resampling spreads
MAX_STEPS = 20
CONVERGED_PX = 1e-4
FIT_REACH_PX = 4  # how far a fit may move the point from where it starts
MIN_PART = 0.5  # of the fitted box that must be usable
MAX_STEP_PX = 0.7  # a longer one is beyond the linear range of an undersampled image
SHAPE_ERROR = 0.2  # of the stack's PSF, for `find_unresolved`: a Gaussian is not what resampling leaves


@dataclass(frozen=True, slots=True, eq=False)
class PointFit:
    """A point fitted to a stack; arrays are read-only.

    Attributes
    ----------
    pixel_line : (2,) array
        Of the reference camera.
    covariance_px2 : (2, 2) array
    flux_dn, flux_sigma_dn
        DN of the longest exposure.
    chi2_reduced, degrees_of_freedom
        With the full covariance of the pixels.
    """

    pixel_line: FloatArray
    covariance_px2: FloatArray
    flux_dn: float
    flux_sigma_dn: float
    chi2_reduced: float
    degrees_of_freedom: float
    converged: bool

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def snr(self) -> float:
        """Flux over its sigma."""
        return self.flux_dn / self.flux_sigma_dn


def find_in_stack(
    stacked: Stacked,
    name: str,
    *,
    predicted_px: FloatArray | None = None,
    search_radius_px: float = DEFAULT_SEARCH_PX,
) -> BodyCenter:
    """Find a target in a stack.

    Parameters
    ----------
    predicted_px : (2,) array, optional
        (pixel, line) of the reference camera; default where ephemeris expects the stack's target.

    Returns
    -------
    BodyCenter
        Method "stack"; statuses as of `find_unresolved`. The center's covariance is that of noise and of the pictures' own
        centering errors; that of their pointing is in the observable.
    """
    expected = stacked.predicted_px if predicted_px is None else np.asarray(predicted_px, dtype=np.float64)
    if not np.isfinite(expected).all():
        raise CenterfindingError(f"{name}: the stack does not know where it is; give predicted_px.")
    box = _FitBox(stacked, expected)
    found = find_unresolved(
        np.nan_to_num(stacked.image_dn),
        np.where(stacked.count > 0, stacked.noise_dn, np.inf) * box.noise_factor(),
        stacked.count == 0,
        stacked.grid.index(expected),
        box.prior(),
        name=name,
        search_radius_px=search_radius_px,
        neighbours_px=stacked.grid.index(_neighbours_in_view(stacked)),
    )
    if found.pixel_line is None:
        return replace(found, method=METHOD)
    fit = fit_point(stacked, found.pixel_line + stacked.grid.first)
    if not fit.converged or np.hypot(*(fit.pixel_line - expected)) > search_radius_px + 1.0:
        return BodyCenter.without_center(name, METHOD, "failed", "the fit of its image does not converge")
    # A PSF that does not explain the image does not explain its center better (bright, undersampled, smeared stars).
    misfit = misfit_factor(np.array([fit.chi2_reduced]), np.array([fit.degrees_of_freedom]))
    factor = float((misfit * faint_factor(np.array([fit.snr])))[0])
    excess = float(
        stacked.weights**2 @ np.array([picture.excess_sigma_px for picture in stacked.pictures]) ** 2
    )
    return replace(
        found,
        method=METHOD,
        pixel_line=fit.pixel_line,
        covariance_px2=factor * fit.covariance_px2 + excess * np.eye(2),
        flux_dn=fit.flux_dn,
        snr=fit.snr,
    )


def fit_point(stacked: Stacked, start_px: FloatArray) -> PointFit:
    """Fit flux, center and level of a point near `start_px` (pixel, line) of the reference camera."""
    return _fitted(_FitBox(stacked, start_px), start_px)


def _fitted(box: "_FitBox", start_px: FloatArray) -> PointFit:
    place, converged, lost = np.array(start_px, dtype=np.float64), False, False
    for _ in range(MAX_STEPS):
        image, slope = box.image(place)
        flux = float(_flux_and_level(box, image)[0])
        design = box.weight[:, None] * np.column_stack([image, flux * slope, np.ones(len(image))])
        step = np.linalg.lstsq(design, box.weight * (box.data - flux * image), rcond=None)[0]
        move = step[1:3]
        place = place + move * min(1.0, MAX_STEP_PX / max(float(np.hypot(*move)), 1e-12))
        converged = bool(np.hypot(*move) < CONVERGED_PX)
        lost = not np.abs(place - start_px).max() < FIT_REACH_PX
        if converged or lost:
            break
    return _with_covariance(box, place, converged and not lost)


def fit_flux(stacked: Stacked, pixel_line: FloatArray) -> tuple[float, float]:
    """Return flux and its sigma (DN of the longest exposure) of a point held at a place of the reference camera."""
    box = _FitBox(stacked, pixel_line)
    image, _ = box.image(pixel_line)
    design = np.column_stack([image, np.ones(len(image))])
    inverse = np.linalg.pinv(box.weight[:, None] * design) * box.weight
    flux = float(inverse[0] @ box.data)
    return flux, float(np.sqrt(inverse[0] @ box.covariance(pixel_line, max(flux, 0.0)) @ inverse[0]))


def _flux_and_level(box: "_FitBox", image: FloatArray) -> FloatArray:
    """Flux and level (2,) are linear: solved at once for the place at hand."""
    design = box.weight[:, None] * np.column_stack([image, np.ones(len(image))])
    return np.asarray(np.linalg.lstsq(design, box.weight * box.data, rcond=None)[0])


def _with_covariance(box: "_FitBox", place: FloatArray, converged: bool) -> PointFit:
    image, slope = box.image(place)
    flux, level = _flux_and_level(box, image)
    design = np.column_stack([image, flux * slope, np.ones(len(image))])
    inverse = np.linalg.pinv(box.weight[:, None] * design) * box.weight  # parameters from pixels
    covariance = box.covariance(place, max(float(flux), 0.0))
    of_parameters = symmetric(inverse @ covariance @ inverse.T)
    rest = box.data - flux * image - level
    freedom = float(max(len(rest) - 4, 1))
    return PointFit(
        pixel_line=place,
        covariance_px2=of_parameters[1:3, 1:3],
        flux_dn=float(flux),
        flux_sigma_dn=float(np.sqrt(of_parameters[0, 0])),
        chi2_reduced=float(rest @ np.linalg.pinv(covariance, hermitian=True) @ rest) / freedom,
        degrees_of_freedom=freedom,
        converged=converged,
    )


class _FitBox:
    """The pixels of a stack about a place, and how each of them comes from the pictures."""

    def __init__(self, stacked: Stacked, place: FloatArray) -> None:
        self._stacked, self._start = stacked, np.asarray(place, dtype=np.float64)
        half = int(np.ceil(BOX_SIGMAS * _sigma_px(stacked))) + 1
        self.points, index = _usable_points(stacked, place, half)
        self.data = stacked.image_dn[index[:, 1], index[:, 0]]
        self.weight = 1.0 / stacked.noise_dn[index[:, 1], index[:, 0]]
        self.operators = stacked.operators(self.points)
        self._near = [self._windowed(i, place) for i in range(len(self.operators))]
        noise = np.zeros((len(self.points),) * 2)
        for operator, picture in zip(self.operators, stacked.before_subtraction, strict=True):
            noise += ((operator @ sparse.diags_array(picture.variance_dn2.ravel())) @ operator.T).toarray()
        self._noise = noise

    def image(self, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (m,) of a point of unit flux at a place of the reference camera, and its slopes (m, 2)."""
        value, slope = np.zeros(len(self.points)), np.zeros((len(self.points), 2))
        for i, near in enumerate(self._near):
            share, slopes = self._shares(i, place)
            value += near.operator @ share
            slope += near.operator @ slopes
        return value, slope

    def covariance(self, place: FloatArray, flux: float) -> FloatArray:
        """Covariance (m, m) of the pixels, with the shot noise of a point of that flux."""
        total = np.array(self._noise)
        for i, near in enumerate(self._near):
            gain = self._stacked.before_subtraction[i].gain_e_per_dn
            if np.isfinite(gain) and flux > 0.0:
                share, _ = self._shares(i, place)
                total += near.operator @ (flux * np.maximum(share, 0.0) / gain * near.operator).T
        return total

    def _windowed(self, i: int, place: FloatArray) -> "_PictureWindow":
        """The operator of a picture on the pixels that the point's light reaches, wherever the fit may move it."""
        picture = self._stacked.before_subtraction[i]
        there = self._stacked.grid.to_picture(place[None], picture)
        psf = picture.psf.at(there[0])
        first, size = covering_boxes(psf, there)
        first, size = first[0] - FIT_REACH_PX, size + 2 * FIT_REACH_PX
        line, pixel = (axis.ravel() for axis in np.indices((size, size)) + first[::-1, None, None])
        n_line, n_pixel = picture.bad.shape
        inside = (line >= 0) & (line < n_line) & (pixel >= 0) & (pixel < n_pixel)
        flat = np.where(inside, line * n_pixel + pixel, 0)
        slope = self._stacked.grid.jacobian(place[None], picture)[0]
        return _PictureWindow(
            psf, there[0], slope, first, size, self.operators[i][:, flat].toarray() * inside
        )

    def _shares(self, i: int, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light of the point in the pixels near it in a picture (k,), and its slopes with the place (k, 2)."""
        near, response = self._near[i], float(self._stacked.response[i])
        # Over some pixels the map is straight to 1e-5 px.
        center_px = near.center_px + near.slope @ (place - self._start)
        boxes = near.psf.gradient(center_px[None], near.first[None], near.size)
        slopes = np.stack([boxes.d_pixel[0].ravel(), boxes.d_line[0].ravel()], axis=1)
        return response * boxes.value[0].ravel(), response * slopes @ near.slope

    def prior(self) -> ShapePrior:
        """A Gaussian of the second moments of a point's image in the stack, for `find_unresolved`."""
        image, _ = self.image(self._middle())
        light = np.maximum(image, 0.0) / np.maximum(image, 0.0).sum()
        offset = self.points - light @ self.points
        variance = 0.5 * float(light @ (offset**2).sum(axis=1)) - PIXEL_VARIANCE_PX2
        return ShapePrior.round_psf(max(variance, 0.04) ** 0.5, SHAPE_ERROR)

    def noise_factor(self) -> float:
        """By how much correlation raises the noise of a matched filter above that of independent pixels."""
        image, _ = self.image(self._middle())
        alone = float(image @ (np.diag(self._noise) * image))
        return float(np.sqrt(max(float(image @ self._noise @ image) / alone, 1.0)))

    def _middle(self) -> FloatArray:
        return np.asarray(self.points[len(self.points) // 2] + 0.25)  # between pixel center and corner


@dataclass(frozen=True, slots=True, eq=False)
class _PictureWindow:
    """A picture about the target: where the start of the fit lies in it, a square box, and the operator (m, size^2)."""

    psf: Psf
    center_px: FloatArray
    slope: FloatArray
    first: IntArray
    size: int
    operator: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def _sigma_px(stacked: Stacked) -> float:
    return max(float(picture.psf.sigma_px.max()) for picture in stacked.pictures)


def _neighbours_in_view(stacked: Stacked) -> FloatArray:
    """Places (k, 2) of other bodies that are in front of the camera."""
    places = stacked.neighbours_px()
    return np.asarray(places[np.isfinite(places).all(axis=1)])


def _usable_points(stacked: Stacked, place: FloatArray, half: int) -> tuple[FloatArray, IntArray]:
    """Usable pixels (m, 2) of the stack in a box, in the reference camera and in the grid's arrays."""
    line, pixel = np.indices((2 * half + 1,) * 2)
    points = np.stack([pixel.ravel(), line.ravel()], axis=1) + np.round(place) - half
    index = stacked.grid.index(points).astype(np.int64)
    n_line, n_pixel = stacked.grid.shape
    inside = np.asarray(((index >= 0) & (index < [n_pixel, n_line])).all(axis=1))
    safe = np.where(inside[:, None], index, 0)
    known = inside & (stacked.count[safe[:, 1], safe[:, 0]] > 0)
    own = np.hypot(*(points - place).T)
    for other in _neighbours_in_view(stacked):  # another body's light, nearer to it than to the target
        apart = np.hypot(*(points - other).T)
        known &= ~((apart < own) & (apart < NEIGHBOUR_SIGMAS * _sigma_px(stacked) + 1.0))
    if known.sum() < MIN_PART * len(points):
        raise CenterfindingError("too few usable pixels of the stack about the target; give a larger window.")
    return points[known], index[known]


# ---- How the signal-to-noise ratio grows with the pictures of a stack.


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """Flux of a point at one place in stacks of the first pictures; arrays (k,) are read-only.

    Attributes
    ----------
    pictures : array of int
    """

    pictures: IntArray
    flux_dn: FloatArray
    flux_sigma_dn: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def snr(self) -> FloatArray:
        """Flux over its sigma (k,)."""
        return np.asarray(self.flux_dn / self.flux_sigma_dn)


def snr_growth(stacked: Stacked, pixel_line: FloatArray) -> Growth:
    """Return the flux at a place of the reference camera in stacks of 1, 2, 4 ... pictures, and of all.

    Raises
    ------
    CenterfindingError
        A stack whose star field was subtracted: its templates are made of all pictures.
    """
    if stacked.subtractions is not None:
        raise CenterfindingError("a subtracted stack has no part: its templates are made of all pictures.")
    total = len(stacked.pictures)
    counts = [*(2**i for i in range(total.bit_length()) if 2**i < total), total]
    fluxes = [fit_flux(_stack_of_first(stacked, count), pixel_line) for count in counts]
    flux, sigma = np.array(fluxes).T
    return Growth(np.array(counts), flux, sigma)


def _stack_of_first(stacked: Stacked, count: int) -> Stacked:
    weights = stacked.weights[:count] / stacked.weights[:count].sum()
    pictures, response = stacked.pictures[:count], stacked.response[:count]
    image, noise, count_of_pixels = average(pictures, stacked.grid, weights, response)
    return replace(
        stacked, pictures=pictures, before_subtraction=stacked.before_subtraction[:count], weights=weights,
        response=response, image_dn=image, noise_dn=noise, count=count_of_pixels,
    )  # fmt: skip
