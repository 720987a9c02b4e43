"""The likelihood of cells of a limb, marginal over an albedo that is a random field on the body and over a rough limb.

    y = X theta + N (w + V b) + e,    w ~ N(0, K),  b ~ N(0, B),  theta ~ N(theta_0, 1 / Lambda),  e ~ N(0, D)

y are the means of data in cells (j pieces of limb with c depths), X what all pieces share (center, size, axes, law, PSF,
background), and N, block by block, what each piece has of its own: its albedo at k arcs from the limb, and the place of
its limb. w are patches of albedo and heights, a ring of blocks (`DiskField.ring`), b amplitudes that all pieces share:
hemispheres, or all patches of a small disk (`opnav_workbench.bodies.disk.surface_modes`), where U stands for N V. With
M = K^-1 + N^T D^-1 N, a ring of blocks as well, every quantity follows from one decomposition of M (Rasmussen & Williams
2006, "Gaussian Processes for Machine Learning", section 2.7 and equation A.9). Its slopes by the prior need no more of the
inverse than the blocks that M has.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_field import (
    ALBEDO,
    BLOCK,
    GRAIN,
    LENGTH,
    ROUGH,
    Amplitudes,
    DiskField,
    FieldPrior,
)
from opnav_workbench.bodies.disk.ring import RingFactor, RingPrior, products
from opnav_workbench.bodies.scales import RIDGE, MixedSolution, mixed_solution

__all__ = ["Ascent", "LimbScores", "LimbSystem", "MarginalSolution"]

SMALL_STEP = 1e-5  # in a logarithm, for the slope of the field's own precision
IN_RING = (ALBEDO, LENGTH, ROUGH)  # which of the logarithms of a prior the ring depends on


@dataclass(frozen=True, slots=True, eq=False)
class MarginalSolution:
    """What the data say.

    Attributes
    ----------
    log_likelihood
        Marginal over everything, relative to the noise of the cells.
    theta : (p,) array
    covariance : (p, p) array
    albedo : (j, k) or (1, k) array
        Mean of the random field in the parts of the light, DN: by piece, or for all of them.
    height_px : (j,) array
        Of the pieces of limb.
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
    albedo: FloatArray
    height_px: FloatArray
    chi2: float
    held_chi2: float
    held_cost: float
    share: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


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


class LimbScores(NamedTuple):
    """What pieces of limb have of a solution for k unknowns, in the unknowns' units: their sum is what the prior takes back.

    Attributes
    ----------
    found : (k, j) array
    expected : (k, j, k, j) array
        Their second moments, if the cells are as the model has them.
    information : (k, k) array
        Covariance that all pieces together would have, without the prior and with nothing taken by the solution.
    """

    found: FloatArray
    expected: FloatArray
    information: FloatArray


class WeighedCells(NamedTuple):
    """Cells weighed by noise and grain, W = 1 / D.

    `columns` are [X, U, y] (p + r + 1, j, c), `own` N^T W N (j, q, q), `cross` N^T W [X, U, y] as blocks of the ring,
    `plain` [X, U, y]^T W [X, U, y]. `log_weights` is the sum of the logarithms of the weights, relative to those that
    the noise of the data alone would give.
    """

    weight: FloatArray
    columns: FloatArray
    own: FloatArray
    cross: FloatArray
    plain: FloatArray
    n_cells: int
    log_weights: float


class _MarginalEquations(NamedTuple):
    """K^-1; M, and what it leaves of [X, U, y]; normal equations with the prior; their solution over all scales.

    `shared` is p, how many of the unknowns are no amplitudes; `amplitudes` what is believed of these, over `brightness_dn`.
    """

    shared: int
    ring: RingPrior
    factor: RingFactor
    halves: list[FloatArray]
    amplitudes: Amplitudes
    brightness_dn: float
    normal: FloatArray
    right: FloatArray
    whole: float
    mixed: MixedSolution

    def without_amplitudes(self) -> tuple[FloatArray, FloatArray, float]:
        """Return the normal equations of what is shared, and chi-squared without it, marginal over amplitudes."""
        p, normal, right = self.shared, self.normal, self.right
        gain = np.linalg.solve(normal[p:, p:], np.column_stack([normal[p:, :p], right[p:]]))
        less = normal[:p, p:] @ gain
        return (
            normal[:p, :p] - less[:, :p],
            right[:p] - less[:, p],
            self.whole - float(right[p:] @ gain[:, p]),
        )

    def amplitudes_width(self) -> float:
        """Return what the amplitudes add to a cost where they are not among the unknowns of its evidence."""
        return float(np.linalg.slogdet(self.normal[self.shared :, self.shared :])[1])

    def width(self, cells: WeighedCells) -> float:
        """Return what a cost has beside chi-squared: how wide a model takes its errors to be, in cells that are expected."""
        field = self.factor.log_determinant - self.ring.log_determinant
        scale = 2.0 * (len(self.right) - self.shared) * float(np.log(self.brightness_dn))
        return field + self.amplitudes.log_determinant + scale - cells.log_weights - cells.n_cells

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
    parts : (k, j, c) array
        Of the light.
    own : (q, j, c) array
        N; the last of q is the place of the limb.
    amplified : (r, j, c) array
        U, what all pieces have of each of the amplitudes.
    prior_mean, prior_precision : (p,) arrays
    scales : (k, p) array
        Precisions about 0 that stand beside `prior_precision`, one row for each scale of the figure.
    field
        Of the albedo and the heights.
    brightness_dn
        Of the model: albedo is relative to it.
    """

    data: FloatArray
    variance: FloatArray
    seen_variance: FloatArray
    light: FloatArray
    shared: FloatArray
    parts: FloatArray
    own: FloatArray
    amplified: FloatArray
    prior_mean: FloatArray
    prior_precision: FloatArray
    scales: FloatArray
    field: DiskField
    brightness_dn: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def residuals_dn(self, solution: MarginalSolution) -> FloatArray:
        """Return what a solution leaves of the cells (j, c)."""
        shared = np.tensordot(solution.theta, self.shared, axes=1)
        raised = self.own[-1] * solution.height_px[:, None]
        return np.asarray(self.data - shared - self.albedo_dn(solution) - raised)

    def albedo_dn(self, solution: MarginalSolution) -> FloatArray:
        """Return what the albedo of a solution adds to the light of the cells (j, c)."""
        albedo = np.broadcast_to(solution.albedo, (len(self.data), len(self.parts)))
        return np.asarray(np.einsum("jk,kjc->jc", albedo, self.parts))

    def figure_prior(
        self, solution: MarginalSolution, unknowns: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and precision (n,) that some unknowns had beforehand, by the scales that a solution found."""
        own = self.prior_precision[unknowns]
        variance = solution.share @ (1.0 / (own + self.scales[:, unknowns]))
        return own * self.prior_mean[unknowns] * variance, 1.0 / variance

    def weighed(self, grain: float) -> WeighedCells:
        """Return the products of the cells, weighed by their noise and grain: all that a prior needs of them."""
        j, q = self.data.shape[0], len(self.own)
        weight = 1.0 / (self.variance + (grain * self.light) ** 2)
        stacked = np.concatenate([self.shared, self.amplified, self.data[None]])
        columns = stacked.transpose(1, 2, 0)
        weighted = columns * weight[..., None]
        own = np.ascontiguousarray(self.own.transpose(1, 2, 0))
        inner = np.matmul(np.swapaxes(own * weight[..., None], 1, 2), own)
        cross = np.matmul(np.swapaxes(own, 1, 2), weighted).reshape(j // BLOCK, BLOCK * q, -1)
        m = len(stacked)
        plain = weighted.reshape(-1, m).T @ columns.reshape(-1, m)
        used = weight > 0.0
        log_weights = float(np.log(weight[used] * self.seen_variance[used]).sum())
        cells = int(np.count_nonzero(used))
        return WeighedCells(weight, stacked, inner, cross, plain, cells, log_weights)

    def _marginal(self, prior: FieldPrior, cells: WeighedCells) -> _MarginalEquations:
        """Return the normal equations of what is shared and of the amplitudes, marginal over the ring."""
        ring = self.field.ring(prior, self.brightness_dn)
        n, s, m = cells.cross.shape
        factor = RingFactor(ring.diagonal + _in_blocks(cells.own), np.broadcast_to(ring.before, (n, s, s)))
        halves = factor.halves(cells.cross)
        p, r = len(self.shared), m - 1 - len(self.shared)
        amplitudes, brightness = self.field.amplitudes(prior), self.brightness_dn
        information = cells.plain - products(halves, halves)
        precision = np.append(self.prior_precision, np.diag(amplitudes.precision) / brightness**2)
        normal, right = information[:-1, :-1].copy(), information[:-1, -1].copy()
        normal[:p, :p] += np.diag(self.prior_precision)
        normal[p:, p:] += amplitudes.precision / brightness**2
        right[:p] += self.prior_precision * self.prior_mean
        # What the field takes leaves rounding errors, of either sign, where nothing is left.
        least = np.maximum(precision, RIDGE * np.diag(cells.plain)[:-1])
        whole = float(information[-1, -1] + precision[:p] @ self.prior_mean**2)
        mixed = mixed_solution(normal, right, np.pad(self.scales, ((0, 0), (0, r))), least)
        return _MarginalEquations(
            p, ring, factor, halves, amplitudes, brightness, normal, right, whole, mixed
        )

    def noise_covariance(self, prior: FieldPrior) -> FloatArray:
        """Return what the noise of the cells alone scatters theta (p, p) by, under a prior.

        The solution is G y with G = P X^T C^-1, so this is G V G^T with V the noise. The rest of its covariance P stays the
        same when the picture is taken again: albedo and grain, law, figure.
        """
        cells = self.weighed(prior.grain)
        found, p = self._marginal(prior, cells), len(self.shared)
        left = self._pulled(cells, found.factor.solved(found.halves))[:-1]
        used = np.isfinite(self.variance)
        by_noise = found.mixed.covariance[:p] @ (left[:, used] * np.sqrt(self.variance[used]))
        return np.asarray(by_noise @ by_noise.T)

    def scores(self, prior: FieldPrior, unknowns: Sequence[int]) -> LimbScores:
        """Return what each piece of limb has of a solution for some unknowns.

        With G = P X^T C^-1 and r what the solution leaves, a piece has the part of G r that its cells are in. The cells are
        expected to differ from the model by C, of which the solution takes X P X^T.
        """
        cells = self.weighed(prior.grain)
        found = self._marginal(prior, cells)
        pulled = self._pulled(cells, found.factor.solved(found.halves))
        theta, covariance, k = found.mixed.theta, found.mixed.covariance, len(unknowns)
        gain = np.tensordot(covariance[list(unknowns)], cells.columns[:-1], axes=1)
        pull = pulled[-1] - np.tensordot(theta, pulled[:-1], axes=1)
        (j, _), (n, s, _) = self.data.shape, cells.cross.shape
        # Each piece by itself: what the others know of the field goes with it.
        own = np.einsum("qjc,jc,kjc->jqk", self.own, cells.weight, gain)
        alone = np.zeros((j, len(self.own), k, j))
        each = np.arange(j)
        alone[each, :, :, each] = own
        halves = found.factor.halves(alone.reshape(n, s, k * j))
        expected = -products(halves, halves).reshape(k, j, k, j)
        expected[:, each, :, each] += np.einsum("ajc,jc,bjc->jab", gain, cells.weight, gain)
        shared = np.einsum("kjc,pjc->kjp", gain, pulled[:-1])
        expected -= np.tensordot(shared @ covariance, shared, axes=(2, 2))
        information = np.einsum("ajp,bp->ab", shared, covariance[list(unknowns)])
        return LimbScores(np.einsum("kjc,jc->kj", gain, pull), expected, 0.5 * (information + information.T))

    def _pulled(self, cells: WeighedCells, nodes: FloatArray) -> FloatArray:
        """Return what the inverse of D + N K N^T makes of `WeighedCells.columns` (m, j, c); the ring has `nodes` of them."""
        j, q = self.data.shape[0], len(self.own)
        taken = np.matmul(self.own.transpose(1, 2, 0), nodes.reshape(j, q, -1)).transpose(2, 0, 1)
        return np.asarray((cells.columns - taken) * cells.weight)

    def log_likelihood(self, prior: FieldPrior, cells: WeighedCells) -> float:
        """Return that of a prior, marginal over everything; `cells` are weighed by its grain."""
        return self._marginal(prior, cells).log_likelihood(cells)

    def ascent(self, prior: FieldPrior, cells: WeighedCells) -> Ascent:
        """Return the likelihood of a prior with its slopes; `cells` are weighed by its grain.

        With u what the ring has of the data, its slope by what changes K^-1 = Q is that of log |Q| less
        tr((M^-1 + u u^T) dQ), halved, over all that theta may be; the average information is y^T P dC P dC P y / 2 with C
        the covariance of the cells and P y = C^-1 (y - X theta).
        """
        found = self._marginal(prior, cells)
        covariance, theta = found.mixed.covariance, found.mixed.theta
        nodes = found.factor.solved(found.halves)
        pulled = self._pulled(cells, nodes)
        ring = nodes[..., -1] - nodes[..., :-1] @ theta
        pull = pulled[-1] - np.tensordot(theta, pulled[:-1], axes=1)
        blocks = found.factor.inverse()
        gradient, changes = np.zeros(5), np.zeros((5, *self.data.shape))
        sums = _second_moments(blocks, ring, nodes[..., :-1], covariance)
        by_ring = [self._by_ring(prior, found.ring, k, sums, ring) for k in IN_RING]
        gradient[list(IN_RING)] = [slope for slope, _ in by_ring]
        moves = -found.ring.covariance_times(np.stack([change for _, change in by_ring], axis=2))
        moves = moves.reshape(*self.own.shape[1::-1], -1).transpose(2, 0, 1)
        changes[list(IN_RING)] = np.einsum("qjc,kjq->kjc", self.own, moves)
        gradient[GRAIN], changes[GRAIN] = self._by_grain(prior, cells, blocks[0], pull, pulled, covariance)
        first, precision = len(self.shared), found.amplitudes.precision
        mean, moments = theta[first:], covariance[first:, first:] + np.outer(theta[first:], theta[first:])
        excess = precision @ (moments @ precision / self.brightness_dn**2) - precision
        for k, change in found.amplitudes.changes.items():
            gradient[k] += 0.5 * float(np.vdot(excess, change))
            changes[k] += np.tensordot(change @ (precision @ mean), self.amplified, axes=1)
        information = self._information(found, cells, changes)
        return Ascent(found.log_likelihood(cells), gradient, information)

    def _by_ring(
        self,
        prior: FieldPrior,
        ring: RingPrior,
        k: int,
        sums: tuple[FloatArray, FloatArray],
        nodes: FloatArray,
    ) -> tuple[float, FloatArray]:
        """Return the slope by a logarithm that the ring depends on, and dQ u, n blocks (n, s)."""
        beside = prior.logarithms()
        beside[k] += SMALL_STEP
        other = self.field.ring(FieldPrior.from_logarithms(beside), self.brightness_dn)
        diagonal, before, width = ((np.asarray(b) - a) / SMALL_STEP for a, b in zip(ring, other, strict=True))
        slope = 0.5 * float(width - np.vdot(sums[0], diagonal) - 2.0 * np.vdot(sums[1], before))
        return slope, RingPrior(diagonal, before, 0.0).times(nodes[..., None])[..., 0]

    def _by_grain(
        self,
        prior: FieldPrior,
        cells: WeighedCells,
        blocks: FloatArray,
        pull: FloatArray,
        pulled: FloatArray,
        covariance: FloatArray,
    ) -> tuple[float, FloatArray]:
        """Return the slope by the logarithm of the grain, and dC P y (j, c).

        `blocks` are those of M^-1 on the diagonal, `pull` is P y, `pulled` C^-1 [X, U, y].
        """
        j, q = self.data.shape[0], len(self.own)
        change, weight = 2.0 * (prior.grain * self.light) ** 2, cells.weight
        known = np.einsum("pjc,pjc->jc", np.tensordot(covariance, pulled[:-1], axes=1), pulled[:-1])
        each = np.arange(BLOCK)
        by_piece = blocks.reshape(-1, BLOCK, q, BLOCK, q)[:, each, :, each].swapaxes(0, 1).reshape(j, q, q)
        own = self.own.transpose(1, 2, 0)
        spent = weight - weight**2 * np.einsum("jcq,jcq->jc", np.matmul(own, by_piece), own)
        return 0.5 * float(np.sum(change * (pull**2 + known - spent))), change * pull

    def _information(self, found: _MarginalEquations, cells: WeighedCells, changes: FloatArray) -> FloatArray:
        """Return half of f^T P f of changes f (k, j, c)."""
        k, (n, s, _) = len(changes), cells.cross.shape
        weighted = changes * cells.weight
        cross = np.matmul(self.own.transpose(1, 0, 2), weighted.transpose(1, 2, 0)).reshape(n, s, k)
        halves = found.factor.halves(cross)
        flat, columns = weighted.reshape(k, -1), cells.columns[:-1].reshape(len(found.right), -1)
        inner = flat @ changes.reshape(k, -1).T - products(halves, halves)
        beside = columns @ flat.T - products(found.halves, halves)[:-1]
        return np.asarray(0.5 * (inner - beside.T @ found.mixed.covariance @ beside))

    def solve(
        self,
        prior: FieldPrior,
        held: Mapping[int, float] | None = None,
        bounds: FloatArray | None = None,
    ) -> MarginalSolution:
        """Solve for what all pieces share, marginal over the rest.

        `held` are values of theta for which `MarginalSolution.held_chi2` is wanted, whatever the solution is. `bounds`
        (2, p) are the least and the largest that theta may be: the mean is within them, all else is as without.
        """
        cells = self.weighed(prior.grain)
        found = self._marginal(prior, cells)
        mixed, p = found.mixed, len(self.shared)
        chi2 = found.whole - mixed.gained
        held_chi2, held_cost = (
            (chi2, chi2) if held is None else _held_cost(*found.without_amplitudes(), self.scales, held)
        )
        theta = mixed.theta if bounds is None else _bounded(mixed.theta, mixed.covariance, bounds)
        solved = found.factor.solved(found.halves)
        nodes = (solved[..., -1] - solved[..., :-1] @ theta).reshape(len(self.data), -1)
        return MarginalSolution(
            found.log_likelihood(cells),
            theta[:p],
            mixed.covariance[:p, :p],
            self.field.albedo(nodes[:, :-1], theta[p:]),
            nodes[:, -1],
            chi2,
            held_chi2,
            held_cost + found.width(cells) + found.amplitudes_width(),
            mixed.share,
        )


def _bounded(theta: FloatArray, covariance: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return a mean with those of its first p that lie beyond bounds (2, p) at them, and all others as that lets them be."""
    first = theta[: bounds.shape[1]]
    back = np.clip(first, *bounds) - first
    beyond = np.flatnonzero(back)
    gain = np.linalg.solve(covariance[np.ix_(beyond, beyond)], covariance[beyond])
    return np.asarray(theta + back[beyond] @ gain)


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


def _in_blocks(each: FloatArray) -> FloatArray:
    """Return matrices (j, q, q) of pieces on the diagonals of blocks (j / `BLOCK`, `BLOCK` q, `BLOCK` q)."""
    j, q, _ = each.shape
    out = np.zeros((j // BLOCK, BLOCK, q, BLOCK, q))
    here = np.arange(BLOCK)
    out[:, here, :, here] = each.reshape(-1, BLOCK, q, q).swapaxes(0, 1)
    return out.reshape(-1, BLOCK * q, BLOCK * q)


def _second_moments(
    blocks: tuple[FloatArray, FloatArray], mean: FloatArray, nodes: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the sums (s, s) over the ring of its second moments, in a block and with the one before.

    `blocks` are its covariance for a given theta, `mean` (n, s) its mean, and `nodes` (n, s, p) what it has of theta.
    """
    spread = nodes @ covariance
    moments = []
    for own, turned in zip(blocks, (0, 1), strict=True):
        there = np.tensordot(spread, np.roll(nodes, turned, axis=0), axes=((0, 2), (0, 2)))
        moments.append(own.sum(axis=0) + there + mean.T @ np.roll(mean, turned, axis=0))
    return moments[0], moments[1]
