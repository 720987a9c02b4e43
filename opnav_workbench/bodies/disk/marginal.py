"""The likelihood of cells of a limb, marginal over an albedo that is a random field on the body and over a rough limb.

    y = X theta + N w + e,    w ~ N(0, K),  theta ~ N(theta_0, 1 / Lambda),  e ~ N(0, D)

y are the means of data in cells (j pieces of limb with c depths), X what all pieces share (center, size, axes, law, PSF,
background), and N, block by block, what each piece has of its own: its albedo at k arcs from the limb, and the place of
its limb. K is exponential in the distance on the body: the covariance of a surface that is patched by boundaries at
random places. With R^T R = N^T D^-1 N, block by block, every quantity follows from one Cholesky decomposition of
1 + R K R^T (Rasmussen & Williams 2006, "Gaussian Processes for Machine Learning", section 2.7 and equation A.9).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.hidden_albedo import HiddenAlbedo
from opnav_workbench.bodies.scales import RIDGE, MixedSolution, mixed_solution

__all__ = ["FieldPrior", "LimbSystem", "MarginalSolution"]


@dataclass(frozen=True, slots=True)
class FieldPrior:
    """Hyperparameters of the random field.

    Attributes
    ----------
    albedo
        Relative standard deviation of the albedo.
    length_rad
        Over which it is correlated.
    grain
        Relative standard deviation of what differs from cell to cell.
    rough_px
        Standard deviation of the limb.
    on_slopes
        Whether the albedo is relative to the light of slopes that face the Sun: terrain shines where a smooth body has no
        light.
    hemispheres
        What whole hemispheres differ by over what they may: over the standard deviation of `LimbSystem.broad`.
    """

    albedo: float
    length_rad: float
    grain: float
    rough_px: float
    on_slopes: bool = False
    hemispheres: float = 1.0

    def logarithms(self) -> FloatArray:
        """Return the logarithms (5,)."""
        return np.log([self.albedo, self.length_rad, self.grain, self.rough_px, self.hemispheres])

    @classmethod
    def from_logarithms(cls, values: FloatArray, *, on_slopes: bool = False) -> "FieldPrior":
        """Return the prior of logarithms (5,)."""
        albedo, length, grain, rough, hemispheres = (float(v) for v in np.exp(values))
        return cls(albedo, length, grain, rough, on_slopes, hemispheres)


@dataclass(frozen=True, slots=True, eq=False)
class MarginalSolution:
    """What the data say.

    Attributes
    ----------
    log_likelihood
        Marginal over everything, relative to the noise of the cells.
    theta : (p,) array
    covariance : (p, p) array
    nodes : (j, q) array
        Mean of the random field.
    chi2
        y^T C^-1 y at the solution.
    held_chi2
        The same with those of theta that were to be held, at the values given.
    held_cost
        Minus twice the logarithm of the likelihood with what is held, relative to the noise of the cells: which of two
        models is the likelier, however wide they take their own errors to be.
    share : (k,) array
        Of each of the scales that theta may have.
    """

    log_likelihood: float
    theta: FloatArray
    covariance: FloatArray
    nodes: FloatArray
    chi2: float
    held_chi2: float
    held_cost: float
    share: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


class WeighedCells(NamedTuple):
    """Cells weighed by noise and `grain`: R (j, q, q) with R^T R = N^T W N, N^T W [X, y] and [X, y]^T W [X, y].

    `log_weights` is the sum of the logarithms of the weights, relative to those that the noise of the data alone would give.
    """

    grain: float
    root: FloatArray
    cross: FloatArray
    plain: FloatArray
    n_cells: int
    log_weights: float


class _MarginalEquations(NamedTuple):
    """K, R K and the factor of 1 + R K R^T; normal equations with the prior; their solution over all scales."""

    field: FloatArray
    spread: FloatArray
    factor: FloatArray
    normal: FloatArray
    right: FloatArray
    whole: float
    mixed: MixedSolution

    @property
    def field_width(self) -> float:
        return 2.0 * float(np.log(np.diag(self.factor)).sum())

    def width(self, cells: WeighedCells) -> float:
        """Return what a cost has beside chi-squared: how wide a model takes its errors to be, in cells that are expected."""
        return self.field_width - cells.log_weights - cells.n_cells

    def log_likelihood(self, cells: WeighedCells) -> float:
        return self.mixed.log_evidence - 0.5 * (self.whole + self.width(cells))


@dataclass(frozen=True, slots=True, eq=False)
class LimbSystem:
    """Cells with their model.

    Attributes
    ----------
    data, variance : (j, c) arrays
        Infinite variance without pixels.
    seen_variance : (j, c) array
        Of noise as the data, not the model, have it. Likelihoods are relative to it and to a chi-squared of one a cell, so
        that outlines with other pixels in their strips, and other cells, compare.
    light : (j, c) array
        What `FieldPrior.grain` is relative to, DN: the light of slopes that face the Sun.
    shared : (p, j, c) array
        X.
    own : (q, j, c) array
        N; the last of q is the place of the limb.
    prior_mean, prior_precision : (p,) arrays
    scales : (k, p) array
        Precisions about 0 that stand beside `prior_precision`, one row for each scale of the figure.
    chord, broad : (j (q - 1), j (q - 1)) arrays
        Distance of the albedo's nodes on the body, rad; relative covariance of what whole hemispheres differ by at most.
    turn : (j, j) array
        Angle between pieces of limb about the center, rad.
    brightness_dn
        Of the model: albedo is relative to it.
    rough_length_rad
        Over which the limb's heights are correlated.
    hidden
        Albedo between the nodes.
    """

    data: FloatArray
    variance: FloatArray
    seen_variance: FloatArray
    light: FloatArray
    shared: FloatArray
    own: FloatArray
    prior_mean: FloatArray
    prior_precision: FloatArray
    scales: FloatArray
    chord: FloatArray
    broad: FloatArray
    turn: FloatArray
    brightness_dn: float
    rough_length_rad: float
    hidden: HiddenAlbedo

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def prior_covariance(self, prior: FieldPrior) -> FloatArray:
        """Return K in the order piece, node."""
        j, q = self.data.shape[0], len(self.own)
        albedo = (prior.albedo * self.brightness_dn) ** 2 * np.exp(-self.chord / prior.length_rad)
        albedo += (prior.hemispheres * self.brightness_dn) ** 2 * self.broad
        hidden = prior.albedo**2 * self.hidden.covariance_px2(prior.length_rad)
        rough = prior.rough_px**2 * np.exp(-self.turn / self.rough_length_rad) + hidden
        whole = np.zeros((j, q, j, q))
        whole[:, :-1, :, :-1] = albedo.reshape(j, q - 1, j, q - 1)
        whole[:, -1, :, -1] = rough
        return whole.reshape(j * q, j * q)

    def residuals_dn(self, solution: MarginalSolution) -> FloatArray:
        """Return what a solution leaves of the cells (j, c)."""
        own = np.einsum("jq,qjc->jc", solution.nodes, self.own)
        return np.asarray(self.data - np.tensordot(solution.theta, self.shared, axes=1) - own)

    def figure_prior(
        self, solution: MarginalSolution, unknowns: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and precision (n,) that some unknowns had beforehand, by the scales that a solution found."""
        own = self.prior_precision[unknowns]
        variance = solution.share @ (1.0 / (own + self.scales[:, unknowns]))
        return own * self.prior_mean[unknowns] * variance, 1.0 / variance

    def weighed(self, grain: float) -> WeighedCells:
        """Return the products of the cells, weighed by their noise and grain: all that a prior needs of them."""
        j, q, p = self.data.shape[0], len(self.own), len(self.shared)
        weight = 1.0 / (self.variance + (grain * self.light) ** 2)
        own = np.ascontiguousarray(self.own.transpose(1, 2, 0))
        columns = np.concatenate([self.shared, self.data[None]]).transpose(1, 2, 0)
        weighted = columns * weight[..., None]
        inner = np.matmul(np.swapaxes(own * weight[..., None], 1, 2), own)
        cross = np.matmul(np.swapaxes(own, 1, 2), weighted).reshape(j * q, p + 1)
        plain = weighted.reshape(-1, p + 1).T @ columns.reshape(-1, p + 1)
        used = weight > 0.0
        log_weights = float(np.log(weight[used] * self.seen_variance[used]).sum())
        return WeighedCells(grain, _roots(inner), cross, plain, int(np.count_nonzero(used)), log_weights)

    def _marginal(self, prior: FieldPrior, cells: WeighedCells) -> _MarginalEquations:
        """Return the normal equations of what is shared, marginal over the field."""
        root, cross = cells.root, cells.cross
        j, q, p = len(root), len(self.own), len(self.shared)
        field = self.prior_covariance(prior)
        spread = np.matmul(root, field.reshape(j, q, j * q)).reshape(j * q, j * q)
        both = np.matmul(spread.reshape(j * q, j, q).swapaxes(0, 1), np.swapaxes(root, 1, 2))
        both = both.swapaxes(0, 1).reshape(j * q, j * q)
        both[np.diag_indices(j * q)] += 1.0
        factor = linalg.cholesky(both, lower=True, check_finite=False, overwrite_a=True)
        carried = field @ cross
        half = linalg.solve_triangular(factor, spread @ cross, lower=True, check_finite=False)
        # (K^-1 + Q)^-1 = K - K R^T (1 + R K R^T)^-1 R K
        information = cells.plain - cross.T @ carried + half.T @ half
        normal = information[:p, :p] + np.diag(self.prior_precision)
        right = information[:p, p] + self.prior_precision * self.prior_mean
        # What the field takes leaves rounding errors, of either sign, where nothing is left.
        least = np.maximum(self.prior_precision, RIDGE * np.diag(cells.plain)[:p])
        whole = float(information[p, p] + self.prior_precision @ self.prior_mean**2)
        mixed = mixed_solution(normal, right, self.scales, least)
        return _MarginalEquations(field, spread, factor, normal, right, whole, mixed)

    def noise_covariance(self, prior: FieldPrior) -> FloatArray:
        """Return what the noise of the cells alone scatters theta (p, p) by, under a prior.

        The solution is G y with G = P X^T C^-1, so this is G V G^T with V the noise. The rest of its covariance P stays the
        same when the picture is taken again: albedo and grain, law, figure.
        """
        cells = self.weighed(prior.grain)
        found, p = self._marginal(prior, cells), len(self.shared)
        cross, spread = cells.cross[:, :p], found.spread
        half = linalg.cho_solve((found.factor, True), spread @ cross, check_finite=False)
        # Of the field, of each column of X.
        nodes = (found.field @ cross - spread.T @ half).reshape(len(cells.root), -1, p)
        left = self.shared - np.einsum("qjc,jqp->pjc", self.own, nodes)
        used = np.isfinite(self.variance)
        by_noise = (left / (self.variance + (prior.grain * self.light) ** 2))[:, used] * np.sqrt(
            self.variance[used]
        )
        by_noise = found.mixed.covariance @ by_noise
        return np.asarray(by_noise @ by_noise.T)

    def log_likelihood(self, prior: FieldPrior, cells: WeighedCells) -> float:
        """Return that of a prior, marginal over everything; `cells` are weighed by its grain."""
        return self._marginal(prior, cells).log_likelihood(cells)

    def solve(self, prior: FieldPrior, held: Mapping[int, float] | None = None) -> MarginalSolution:
        """Solve for what all pieces share, marginal over the rest.

        `held` are values of theta for which `MarginalSolution.held_chi2` is wanted, whatever the solution is.
        """
        cells = self.weighed(prior.grain)
        equations = self._marginal(prior, cells)
        field, spread, factor, normal, right, whole, mixed = equations
        p, theta = len(self.shared), mixed.theta
        chi2 = whole - mixed.gained
        held_chi2, held_cost = (
            (chi2, chi2) if held is None else _held_cost(normal, right, whole, self.scales, held)
        )
        rest = cells.cross[:, p] - cells.cross[:, :p] @ theta
        nodes = field @ rest - spread.T @ linalg.cho_solve((factor, True), spread @ rest, check_finite=False)
        return MarginalSolution(
            equations.log_likelihood(cells),
            theta,
            mixed.covariance,
            nodes.reshape(len(cells.root), -1),
            chi2,
            held_chi2,
            held_cost + equations.width(cells),
            mixed.share,
        )


def _held_cost(
    normal: FloatArray, right: FloatArray, whole: float, precisions: FloatArray, held: Mapping[int, float]
) -> tuple[float, float]:
    """Return the least of theta^T N theta - 2 theta^T r + whole with some of theta held, over all scales.

    First by itself, then with the width of the scales' priors.
    """
    fixed = np.array(list(held), dtype=np.int64)
    free = np.setdiff1d(np.arange(len(right)), fixed)
    value = np.array(list(held.values()))
    every = normal + precisions[:, None, :] * np.eye(len(right))
    rest = right[free] - every[:, free[:, None], fixed] @ value
    inner = every[:, free[:, None], free]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(inner, axis1=1, axis2=2), 1e-300))
    scaled = inner * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(len(free))
    right_side = scale * rest
    gained = np.einsum("kf,kf->k", right_side, np.linalg.solve(scaled, right_side[..., None])[..., 0])
    cost = whole + np.einsum("i,kij,j->k", value, every[:, fixed[:, None], fixed], value)
    cost = cost - 2.0 * float(value @ right[fixed]) - gained
    wide = -np.log(np.where(precisions > 0.0, precisions, 1.0)).sum(axis=1)
    least = float((cost + wide).min())
    return float(cost.min()), least - 2.0 * float(np.log(np.mean(np.exp(-0.5 * (cost + wide - least)))))


def _roots(inner: FloatArray) -> FloatArray:
    """Return R (j, q, q) with R^T R = inner, which may be singular."""
    value, vector = np.linalg.eigh(inner)
    return np.asarray(np.sqrt(np.maximum(value, 0.0))[..., None] * np.swapaxes(vector, 1, 2))
