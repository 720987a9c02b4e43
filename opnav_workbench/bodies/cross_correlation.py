"""Center of a body by cross-correlation of its rendered picture with the data.

Flow   search over the whole area (FFT) -> the model fitted: size, figure, law, PSF and a first center (`fit_scene`) -> its
       correlation with the data at 3 x 3 lags -> paraboloid's peak, against that of the model with itself

A paraboloid through 3 x 3 samples is not the correlation's peak: it is off by up to 0.1 px, and by an amount that depends
on where between the pixels the body lies. The model correlated with itself, with the same weights and the same missing
pixels, is off just as much; the difference of the two has no bias.

The peak weighs the limb less sharply than least squares do. It is least squares plus a linear function of their residuals,
with whose noise their own is not correlated: its covariance is theirs plus that of the function.

Reference: Jackman & Dumont (2013), AAS 13-443, "Cross-Correlation Target Centerfinding".
"""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.detection import SearchRequest
from opnav_workbench.bodies.fit_report import measure_bodies
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter
from opnav_workbench.bodies.scene_fit import SceneFit
from opnav_workbench.stars.peaks import paraboloid_peak

__all__ = ["find_cross_correlation"]

METHOD = "cross_correlation"
PROBE_PX = 0.01  # of numeric derivatives of the peak
MIN_RESPONSE = 0.05  # of the peak to a shift, as a determinant: below, the paraboloid says nothing
LAGS = [(line, pixel) for line in (-1, 0, 1) for pixel in (-1, 0, 1)]


def find_cross_correlation(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = False,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure by correlation with its model over the whole search area.

    Bodies that touch it are rendered along, at their likely places; pixels of the others are left out.

    Parameters
    ----------
    circle
        Where an analyst sees the body.
    solve_range
        Solve for its range from the size of its image, which the fit of the model gives.
    search_radius_px
        How far from its prediction (or circle) the body may be; see `find_jointly`.

    Returns
    -------
    BodyCenter
        `detail` is a `ModelFit`; covariance as in `find_least_squares`, of this estimator.

    Raises
    ------
    CenterfindingError
        The body is not in the scene.
    """
    circles = {} if circle is None else {name: circle}
    search = SearchRequest(METHOD, circles, solve_range, search_radius_px)
    return measure_bodies(picture, (name,), search, _correlated).centers[0]


def _correlated(fit: SceneFit) -> SceneFit:
    """Return a fit whose first center is that of the correlation's peak."""
    own, weight = fit.light[0], fit.noise_weight
    lags = _correlator(own, weight)
    samples = np.tensordot(lags, own, axes=2)
    steps = np.tensordot(lags, fit.columns[:2], axes=((1, 2), (1, 2)))
    response = _slope(samples, PROBE_PX * steps) / PROBE_PX
    if not abs(np.linalg.det(response)) > MIN_RESPONSE:
        return fit
    offset = _offset(samples + np.tensordot(lags, fit.residual_dn, axes=2)) - _offset(samples)
    probe = 1e-4 * float(np.abs(samples).max())
    gain = np.tensordot(np.linalg.solve(response, _slope(samples, probe * np.eye(9)) / probe), lags, axes=1)
    return fit.corrected(np.asarray(np.linalg.solve(response, offset), dtype=np.float64), gain)


def _correlator(light: FloatArray, weight: FloatArray) -> FloatArray:
    """Return (9, n_line, n_pixel), whose products with data are its correlations with the light at the lags."""
    padded = np.pad(light, 1, mode="edge")
    n_line, n_pixel = light.shape
    # The model moved by a lag shows at x what it had at x - lag.
    moved = np.stack([padded[1 - a : 1 - a + n_line, 1 - b : 1 - b + n_pixel] for a, b in LAGS])
    moved -= (np.tensordot(moved, weight, axes=2) / weight.sum())[:, None, None]
    power = np.einsum("klm,lm,klm->k", moved, weight, moved)
    return np.asarray(moved * (weight / np.sqrt(np.maximum(power, 1e-300))[:, None, None]))


def _offset(samples: FloatArray) -> FloatArray:
    """Return the offset (2,) of the paraboloid's peak from lag zero."""
    return np.asarray(paraboloid_peak(samples.reshape(1, 3, 3))[0][0])


def _slope(samples: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the change (2, k) of the peak with steps (9, k) of the samples."""
    return np.stack([0.5 * (_offset(samples + step) - _offset(samples - step)) for step in steps.T], axis=1)
