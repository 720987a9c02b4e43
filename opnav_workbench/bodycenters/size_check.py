"""Whether a body's image has the size of its model."""

from collections.abc import Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.bodycenters.cutout import Cutout
from opnav_workbench.bodycenters.expectation import Found
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.scene_fit import SceneFit, fit_scene
from opnav_workbench.bodycenters.scene_light import range_derivatives

__all__ = ["size_ratios"]

NOTICED = 0.02  # relative change of size that a linear estimate must show before a fit is spent on it
SIGMAS = 5.0
MIN_DIAMETER_PX = 4.0  # smaller images tell their brightness, not their size
BETTER = 0.7  # of chi-squared, in which another size must fit to be believed


def size_ratios(picture: BodyPicture, cutout: Cutout, fit: SceneFit, found: Sequence[Found]) -> FloatArray:
    """Return the size of each body's image over that of its model (n,); 1 where nothing speaks against it.

    A linear estimate first, from what the residuals have in common with a change of size; where that is significant, or
    where the search has seen another size, a fit with the size free. `found` are the first bodies of the fit.
    """
    n = len(fit.state.names)
    checked = fit.light.diameter_px > MIN_DIAMETER_PX
    if not checked.any():
        return np.full(n, np.nan)
    change, sigma = _linear_estimate(
        fit, range_derivatives(picture, cutout.window, fit.state, fit.light, checked)
    )
    scatter = np.sqrt(max(fit.chi2 / fit.degrees_of_freedom, 1.0))
    noticed = np.zeros(n, dtype=bool)
    noticed[checked] = (np.abs(change) > NOTICED) & (np.abs(change) > SIGMAS * scatter * sigma)
    ratios = np.where(checked, 1.0, np.nan)
    start = fit.state
    for index, body in enumerate(found):
        if body.size_ratio != 1.0:
            noticed[index] = checked[index]
            start = start.at(index, body.sized_place.center_px, -float(np.log(body.size_ratio)))
    if not noticed.any():
        return ratios
    free = fit_scene(picture, cutout, start, solve_range=noticed, reject_hits=False)
    if free.chi2 > BETTER * fit.chi2:
        return ratios
    return np.where(noticed, np.exp(-free.state.log_range), ratios)


def _linear_estimate(fit: SceneFit, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return changes (k,) of the logarithm of range, all else solved for again, and their sigmas."""
    columns = np.concatenate([sizes, fit.columns]).reshape(len(sizes) + len(fit.columns), -1)
    weighted = columns * fit.weight.ravel()
    inverse = np.linalg.pinv(symmetric(weighted @ columns.T), rcond=1e-14, hermitian=True)
    k = len(sizes)
    return (inverse @ (weighted @ fit.residual_dn.ravel()))[:k], np.sqrt(np.diag(inverse)[:k])
