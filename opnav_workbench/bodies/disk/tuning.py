"""The prior of a limb's albedo and heights: what the data speak for, within what surfaces are like.

Five logarithms (contrast, length, grain, roughness, hemispheres) by steps of Fisher's scoring with the average information,
in a box: the marginal likelihood's own slopes, and a curvature that is never of the wrong sign.
"""

from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.disk.limb_field import FieldPrior
from opnav_workbench.bodies.disk.marginal import Ascent, LimbSystem

__all__ = ["TunedPrior", "tuned"]

USUAL = np.log([0.1, 0.4, 0.01])  # contrast, length (rad) and grain; and factors by which they vary:
VARIETY = np.array([1.5, 0.8, 1.5, 1.2, np.inf])
WIDEST = 3.0
# No surface is more even than the least of contrast and grain, and no law of it truer over half a radian; none is wilder.
LEAST, MOST = np.log([0.003, 0.08, 0.001]), np.log([0.9, 0.7, 0.25])
MOST_STEPS = 12
LONGEST = np.array([1.2, 1.2, 1.2, 1.2, 5.0])  # of the last there is little to see, and no farther to go
IS_SIGMA = np.array([True, False, True, True, True])
ENOUGH = 0.02  # of a likelihood's logarithm
MOST_HALVINGS = 4
TINY = 1e-9  # of an information, or of a slope over one: quotients stay finite


class TunedPrior(NamedTuple):
    """A prior, and minus the logarithm of its posterior but for a constant of the cells."""

    prior: FieldPrior
    cost: float


class _Slope(NamedTuple):
    """A cost at logarithms (5,), its gradient (5,) and curvature (5, 5)."""

    cost: float
    gradient: FloatArray
    curvature: FloatArray


def tuned(system: LimbSystem, start: FieldPrior, rough_px: float, least_hemispheres: float) -> TunedPrior:
    """Return the prior of greatest marginal likelihood, with the light that `start` has its albedo on.

    `FieldPrior.hemispheres` lies between the least and 1, every doubling as likely.
    """
    usual = np.append(USUAL, [np.log(rough_px), 0.0])
    bounds = usual + np.multiply.outer([-WIDEST, WIDEST], np.minimum(VARIETY, 1e3))
    bounds[:, :3] = np.maximum(bounds[0, :3], LEAST), np.minimum(bounds[1, :3], MOST)
    bounds[:, 4] = np.log(least_hemispheres), 0.0

    def slope(x: FloatArray) -> _Slope:
        prior = FieldPrior.from_logarithms(x, on_slopes=start.on_slopes)
        ascent = system.ascent(prior, system.weighed(prior.grain))
        away = (x - usual) / VARIETY
        cost = 0.5 * float(away @ away) - ascent.log_likelihood
        curvature = ascent.information + np.diag(_bend(ascent) + VARIETY**-2.0)
        return _Slope(cost, away / VARIETY - ascent.gradient, curvature)

    x = np.clip(start.logarithms(), *bounds)
    here = slope(x)
    for _ in range(MOST_STEPS):
        step = _step(here, x, bounds)
        if -float(step @ here.gradient) < 2.0 * ENOUGH:
            break
        for _ in range(MOST_HALVINGS):
            there = np.clip(x + step, *bounds)
            other = slope(there)
            if other.cost < here.cost:
                break
            step = 0.5 * step
        else:
            break
        x, here = there, other
    return TunedPrior(FieldPrior.from_logarithms(x, on_slopes=start.on_slopes), here.cost)


def _bend(ascent: Ascent) -> FloatArray:
    """Return the curvature (5,) beyond the information with which a sigma that is too large becomes right in a step.

    With n data of a mean square m over a sigma's, the likelihood's slope by its logarithm is n (m - 1), its information
    2 n m, and it is too large by -log(m) / 2.
    """
    information = np.maximum(np.diag(ascent.information), TINY)
    over = np.where(IS_SIGMA, np.maximum(-2.0 * ascent.gradient / information, TINY), TINY)
    return np.asarray(information * (over / np.log1p(over) - 1.0))


def _step(here: _Slope, x: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return Newton's step (5,) in a box: what it would take out of the box goes to its side, and the others suit that."""
    least, most = np.maximum(bounds[0] - x, -LONGEST), np.minimum(bounds[1] - x, LONGEST)
    step, free = np.zeros(len(x)), np.ones(len(x), dtype=bool)
    curved = here.curvature + np.diag(np.full(len(x), 1e-3))  # of hemispheres nothing may be told
    while free.any():
        slope = here.gradient[free] + curved[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(curved[np.ix_(free, free)], slope)
        inside = np.clip(step, least, most)
        out = free & (inside != step)
        if not out.any():
            break
        step, free = inside, free & ~out
    return step
