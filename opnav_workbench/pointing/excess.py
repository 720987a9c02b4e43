"""Do the residuals scatter as the centers' covariances say? If not, how much centering error is missing.

A method-of-moments random-effects model: one excess variance, the same for all stars and both coordinates, is
added to the covariances so that chi-squared equals its degrees of freedom (Paule & Mandel 1982, J. Res. NBS
87, 377, doi:10.6028/jres.087.022). Plate errors, an imperfect PSF and catalog errors act this way; scaling
all covariances by one factor would instead punish the faint stars for the errors of the bright ones.
"""

from scipy.optimize import brentq
from scipy.stats import chi2 as chi2_distribution

from opnav_workbench.pointing.fit import Linear

__all__ = ["IMPROBABLE", "excess_sigma", "probability"]

IMPROBABLE = 1e-3  # a formal chi-squared this rare (one picture in a thousand by chance) is not believed
EXCESS_TOLERANCE_PX = 1e-6  # far below any centering error


def probability(linear: Linear, excess_sigma_px: float = 0.0) -> float:
    """Return the probability of a chi-squared at least as large by chance; 1 without redundancy."""
    if linear.freedom <= 0:
        return 1.0
    return float(chi2_distribution.sf(linear.chi2(excess_sigma_px), linear.freedom))


def excess_sigma(linear: Linear) -> float:
    """Return the excess centering sigma in px; 0 where the given covariances explain the residuals."""
    if probability(linear) >= IMPROBABLE:
        return 0.0

    def surplus(sigma_px: float) -> float:
        return linear.chi2(sigma_px) - linear.freedom

    upper = 0.1
    while surplus(upper) > 0.0:  # falls as 1 / sigma^2
        upper *= 2.0
    return float(brentq(surplus, 0.0, upper, xtol=EXCESS_TOLERANCE_PX))
