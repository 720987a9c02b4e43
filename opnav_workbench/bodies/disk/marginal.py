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

__all__ = ["Ascent", "FieldPrior", "LimbSystem", "MarginalSolution"]


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

    `unroot` is the pseudo-inverse of R.
    `log_weights` is the sum of the logarithms of the weights, relative to those that the noise of the data alone would give.
    """

    grain: float
    root: FloatArray
    unroot: FloatArray
    cross: FloatArray
    plain: FloatArray
    n_cells: int
    log_weights: float


class Ascent(NamedTuple):
    """A marginal likelihood about a prior, by the logarithms (5,) of `FieldPrior`.

    Attributes
    ----------
    log_likelihood
    gradient : (5,) array
    information : (5, 5) array
        The average information: mean of the observed and the expected one (Gilmour, Thompson & Cullis 1995,
        doi:10.2307/2533274). Never negative.
    """

    log_likelihood: float
    gradient: FloatArray
    information: FloatArray


class _FieldParts(NamedTuple):
    """K in parts: patches and hemispheres of the albedo's nodes; heights of the limb, and what albedo between nodes does."""

    patches: FloatArray
    hemispheres: FloatArray
    rough: FloatArray
    hidden: FloatArray


class _MarginalEquations(NamedTuple):
    """K, whole and in parts, R K and the factor of 1 + R K R^T; normal equations with the prior; their solution over all scales.

    `half` is what R K carries of [X, y], solved for with the factor.
    """

    parts: _FieldParts
    field: FloatArray
    spread: FloatArray
    factor: FloatArray
    half: FloatArray
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
        return self._whole(self._field_parts(prior))

    def _whole(self, parts: _FieldParts) -> FloatArray:
        j, q = self.data.shape[0], len(self.own)
        whole = np.zeros((j, q, j, q))
        whole[:, :-1, :, :-1] = (parts.patches + parts.hemispheres).reshape(j, q - 1, j, q - 1)
        whole[:, -1, :, -1] = parts.rough + parts.hidden
        return whole.reshape(j * q, j * q)

    def _field_parts(self, prior: FieldPrior) -> _FieldParts:
        return _FieldParts(
            (prior.albedo * self.brightness_dn) ** 2 * np.exp(-self.chord / prior.length_rad),
            (prior.hemispheres * self.brightness_dn) ** 2 * self.broad,
            prior.rough_px**2 * np.exp(-self.turn / self.rough_length_rad),
            prior.albedo**2 * self.hidden.covariance_px2(prior.length_rad),
        )

    def _field_changes(
        self, prior: FieldPrior, parts: _FieldParts
    ) -> list[tuple[FloatArray | None, FloatArray | None]]:
        """Return what K changes by with the logarithms of albedo, length, roughness and hemispheres: nodes, and limb."""
        longer = prior.albedo**2 * self.hidden.lengthened_px2(prior.length_rad)
        return [
            (2.0 * parts.patches, 2.0 * parts.hidden),
            (parts.patches * (self.chord / prior.length_rad), longer),
            (None, 2.0 * parts.rough),
            (2.0 * parts.hemispheres, None),
        ]

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
        return WeighedCells(grain, *_roots(inner), cross, plain, int(np.count_nonzero(used)), log_weights)

    def _marginal(self, prior: FieldPrior, cells: WeighedCells) -> _MarginalEquations:
        """Return the normal equations of what is shared, marginal over the field."""
        root, cross = cells.root, cells.cross
        j, q, p = len(root), len(self.own), len(self.shared)
        parts = self._field_parts(prior)
        field = self._whole(parts)
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
        return _MarginalEquations(parts, field, spread, factor, half, normal, right, whole, mixed)

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

    def ascent(self, prior: FieldPrior, cells: WeighedCells) -> Ascent:
        """Return the likelihood of a prior with its slopes; `cells` are weighed by its grain.

        With C the covariance of the cells, P = C^-1 - C^-1 X S X^T C^-1 and S that of theta over all scales, the slope by
        what changes C is half of tr((P y y^T P - P) dC), and the average information y^T P dC P dC P y / 2.
        """
        found = self._marginal(prior, cells)
        root, cross, p = cells.root, cells.cross, len(self.shared)
        j, q = len(root), len(self.own)
        covariance, theta = found.mixed.covariance, found.mixed.theta
        # N^T C^-1 [X, y], and what the field has of [X, y].
        solved = linalg.solve_triangular(found.factor, found.half, lower=True, trans=1, check_finite=False)
        pulled = cross - np.matmul(np.swapaxes(root, 1, 2), solved.reshape(j, q, -1)).reshape(j * q, -1)
        nodes = found.field @ pulled
        inverse = _inverse(found.factor)
        pull = pulled[:, p] - pulled[:, :p] @ theta
        beyond = np.outer(pull, pull) + pulled[:, :p] @ covariance @ pulled[:, :p].T - _between(root, inverse)
        beyond = beyond.reshape(j, q, j, q)
        at_nodes = np.ascontiguousarray(beyond[:, :-1, :, :-1]).reshape(self.chord.shape)
        at_limb = np.ascontiguousarray(beyond[:, -1, :, -1])
        gradient, moves = np.zeros(5), np.zeros((5, j, q))
        order = [0, 1, 3, 4]  # of the logarithms; grain is no part of the field
        for k, (albedo, limb) in zip(order, self._field_changes(prior, found.parts), strict=True):
            if albedo is not None:
                gradient[k] += 0.5 * float(np.vdot(at_nodes, albedo))
                moves[k, :, :-1] = (albedo @ pull.reshape(j, q)[:, :-1].ravel()).reshape(j, q - 1)
            if limb is not None:
                gradient[k] += 0.5 * float(np.vdot(at_limb, limb))
                moves[k, :, -1] = limb @ pull.reshape(j, q)[:, -1]
        changes = np.einsum("kjq,qjc->kjc", moves, self.own)
        gradient[2], changes[2] = self._by_grain(prior, found, cells, nodes, inverse)
        return Ascent(found.log_likelihood(cells), gradient, self._information(prior, found, cells, changes))

    def _by_grain(
        self,
        prior: FieldPrior,
        found: _MarginalEquations,
        cells: WeighedCells,
        nodes: FloatArray,
        inverse: FloatArray,
    ) -> tuple[float, FloatArray]:
        """Return the slope by the logarithm of the grain, and dC P y (j, c).

        `nodes` is what the field has of [X, y], `inverse` that of 1 + R K R^T.
        """
        j, q, p = self.data.shape[0], len(self.own), len(self.shared)
        grains = (prior.grain * self.light) ** 2
        weight, change = 1.0 / (self.variance + grains), 2.0 * grains
        by_piece = nodes.reshape(j, q, p + 1)
        left = np.concatenate([self.shared, self.data[None]]) - np.einsum("qjc,jqp->pjc", self.own, by_piece)
        left *= weight  # C^-1 [X, y]
        pull = left[p] - np.tensordot(found.mixed.theta, left[:p], axes=1)
        known = np.einsum("pjc,pjc->jc", np.tensordot(found.mixed.covariance, left[:p], axes=1), left[:p])
        # log |C| is log |D| + log |1 + K Q|, and Q = N^T D^-1 N changes with the weights.
        own = self.own.transpose(1, 2, 0)
        less = np.matmul(np.swapaxes(own * (change * weight**2)[..., None], 1, 2), own)
        less = np.matmul(np.matmul(np.swapaxes(cells.unroot, 1, 2), less), cells.unroot)
        each = np.arange(j)
        kept = np.eye(q) - inverse.reshape(j, q, j, q)[each, :, each]
        spent = float(np.sum(weight * change)) - float(np.sum(kept * less))
        return 0.5 * (float(np.sum(change * (pull**2 + known))) - spent), change * pull

    def _information(
        self, prior: FieldPrior, found: _MarginalEquations, cells: WeighedCells, changes: FloatArray
    ) -> FloatArray:
        """Return half of f^T P f of changes f (k, j, c)."""
        j, p, k = self.data.shape[0], len(self.shared), len(changes)
        weighted = changes / (self.variance + (prior.grain * self.light) ** 2)
        cross = np.matmul(self.own.transpose(1, 0, 2), weighted.transpose(1, 2, 0)).reshape(-1, k)
        half = linalg.solve_triangular(found.factor, found.spread @ cross, lower=True, check_finite=False)
        carried, flat = found.field @ cross, weighted.reshape(k, -1)
        inner = flat @ changes.reshape(k, -1).T - cross.T @ carried + half.T @ half
        beside = self.shared.reshape(p, -1) @ flat.T - cells.cross[:, :p].T @ carried + found.half[:, :p].T @ half
        return np.asarray(0.5 * (inner - beside.T @ found.mixed.covariance @ beside))

    def solve(self, prior: FieldPrior, held: Mapping[int, float] | None = None) -> MarginalSolution:
        """Solve for what all pieces share, marginal over the rest.

        `held` are values of theta for which `MarginalSolution.held_chi2` is wanted, whatever the solution is.
        """
        cells = self.weighed(prior.grain)
        equations = self._marginal(prior, cells)
        _, field, spread, factor, _, normal, right, whole, mixed = equations
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


def _between(root: FloatArray, middle: FloatArray) -> FloatArray:
    """Return R^T A R (j q, j q) of A alike and R (j, q, q)."""
    j, q, _ = root.shape
    half = np.matmul(np.swapaxes(root, 1, 2), middle.reshape(j, q, j * q)).reshape(j * q, j, q)
    return np.asarray(np.matmul(half.swapaxes(0, 1), root).swapaxes(0, 1).reshape(j * q, j * q))


def _inverse(factor: FloatArray) -> FloatArray:
    """Return the inverse of a matrix with this lower Cholesky factor."""
    lower, _ = linalg.lapack.dpotri(factor, lower=1)
    whole = lower + lower.T
    whole[np.diag_indices(len(whole))] *= 0.5
    return np.asarray(whole)


def _roots(inner: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R (j, q, q) with R^T R = inner, which may be singular, and its pseudo-inverse."""
    value, vector = np.linalg.eigh(inner)
    root = np.sqrt(np.maximum(value, 0.0))
    known = root > np.sqrt(RIDGE) * root.max(axis=1, keepdims=True)
    over = np.where(known, 1.0 / np.where(known, root, 1.0), 0.0)
    return root[..., None] * np.swapaxes(vector, 1, 2), vector * over[:, None, :]
