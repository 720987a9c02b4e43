"""A disk fitted to the pixels about its limb: Gauss-Newton in its outline and law, linear in all else.

Flow   place -> tables of light -> pixels of the strip about the outline -> cells -> marginal solution -> center, size, axes,
       law moved -> ... -> field prior by marginal likelihood -> ... -> covariance
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.bodies.disk.blocks import LimbSamples
from opnav_workbench.bodies.disk.columns import (
    ALBEDO,
    CENTER,
    FIGURE,
    RELIEF,
    SHADED,
    SHADING,
    SHARED,
    SHARES,
    STRAINED,
    DiskShape,
    TabulatedDisk,
    Unknown,
    columns_dn,
    disk_columns,
)
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.disk.limb_cells import cell_of, gathered, limb_pixels, limb_places, piece_angles
from opnav_workbench.bodies.disk.limb_field import FieldPrior
from opnav_workbench.bodies.disk.limb_light import Patches
from opnav_workbench.bodies.disk.limb_scatter import limb_scatter
from opnav_workbench.bodies.disk.marginal import LimbSystem, MarginalSolution
from opnav_workbench.bodies.disk.problem import LIT_LIMB, DiskProblem
from opnav_workbench.bodies.disk.tuning import TunedPrior, tuned
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.errors import CenterfindingError

__all__ = ["WANDERED_SHARE", "Fitter"]

SAME_CELLS_PX = 0.35  # that an outline may move by, and cells stay what they are: half of their depth
# Turns with one prior and light; times that the fine light is tabulated, and that its prior is tuned; times that the prior
# of coarse light is. Nothing but the tables tells how light changes with a power: along the valley of a law they have to
# follow.
MOST_TURNS, MOST_FINE, MOST_TUNED, COARSE_TUNINGS = 12, 8, 2, 2
MOST_HALVINGS, MOST_UPHILL = 3, 2
IN_PROPORTION = 0.375  # of what a step costs, half of it: a half of that by a slope, a quarter by a curvature
STILL_PX, STILL_SIGMAS = 0.005, 0.1
COARSE_PX, COARSE_SIGMAS = 0.04, 0.3  # with coarse light, which is no truer
NEAR_PX, NEAR_SIGMAS = 0.02, 0.5  # last step of a solution that counts as one
LARGEST_LOG = 0.5  # of the size over the model's
LONGEST_PX = 1.0  # a step: the derivatives of a limb reach no farther than the PSF
MOST_BLUR = 0.5, 20.0  # of the PSF's variance, less and more
# A step: as far as their derivatives reach. Light is linear in the share of a law, so that is taken whole.
MOST_STRAIN, MOST_LAW = 0.02, np.array([2.0, 0.2])
LEAST_BRIGHT = 0.5  # of light without what a law adds to it
MOST_BRIGHTER = 1.3  # a step: what is believed of noise and albedo goes with it
HALFWAY = (1.0, 0.5)  # to a shape from that of the last tables
SURE_SIGMAS = 1.0  # of the PSF, inward of the limb: there pixels show the albedo beside it
# Of a disk's brightness: light of a camera and of its sky that no model has, be a cell of many pixels known ever so well.
FAINTEST = 3e-4
DOUBTED_SIGMAS = 4.0  # of a cell's residual: beyond, it counts as if its noise were larger
# Solutions with weights by the last one; and weights alike, in the logarithm.
MOST_DOUBTS, SAME_DOUBT = 4, 0.5
WANDERED_SHARE = 0.5  # of the way from the best place to the last one
EVEN = 0.01  # albedo and grain of a surface that either light explains
LOST_SHARE = 0.05  # of the cells: as a cost, more than new weights make of the same fit
FAINT_ALBEDO = 0.05  # the most that another law may look like
GROWTH = 0.5  # chi-squared may grow so much in a step: brightness and weights change with it


class Changes(NamedTuple):
    """Of a shape, from which on its light is tabulated anew; that of the blur in shares of the PSF's variance."""

    share: float
    power: float
    size: float
    strain: float
    blur: float


# Light is linear in the share, but for an albedo that is on it: what counts is the product of both.
NEW, LAST = Changes(0.03, 0.12, 0.01, 0.01, 0.1), Changes(0.012, 0.04, 0.004, 0.006, 0.05)
# For a fit that did not come to rest: along the slopes of tables of another shape, steps become smaller and smaller.
UNRESTED = Changes(0.003, 0.01, 0.001, 0.0015, 0.01)
EVEN_ALBEDO = 0.05  # and noise changes with the share


def _is_uneven(prior: FieldPrior) -> bool:
    return max(prior.albedo, prior.grain) > EVEN


def _degrees(system: LimbSystem) -> int:
    return max(int(np.count_nonzero(np.isfinite(system.variance))) - SHARED, 1)


def _spread(places: Sequence[FloatArray], about: FloatArray) -> FloatArray:
    """Return the mean square (2, 2) of places (2,) about one."""
    away = np.array(places) - about
    return np.asarray(away.T @ away / len(away))


class _CelledSamples(NamedTuple):
    """Samples about an outline, and the cell (n,) of each: what two shapes that lie near each other are compared by.

    Samples that changed cells, or came and went, would make a likelihood jump by more than a step gains.
    """

    about: Outline
    samples: LimbSamples
    cell: IntArray

    def seen_from(self, outline: Outline) -> "_CelledSamples":
        """Return the same samples and cells, with their places about another outline."""
        places = limb_places(outline, self.samples.places.pixel, self.samples.places.line)
        return self._replace(samples=self.samples._replace(places=places))


class _Cells(NamedTuple):
    """Variance, that by the light of the data (`LimbSystem.seen_variance`), data and columns of cells (j, c)."""

    variance: FloatArray
    seen_variance: FloatArray
    data: FloatArray
    columns: FloatArray


class _LinearDisk(NamedTuple):
    """A disk linearized about a shape: its system, samples with their columns as in `DiskFit`, and the solution."""

    system: LimbSystem
    celled: _CelledSamples
    columns: FloatArray
    solution: MarginalSolution


class _FitState(NamedTuple):
    """Where a fit stands."""

    shape: DiskShape
    brightness: float
    piece_albedo: FloatArray
    made: TabulatedDisk
    linear: _LinearDisk


class Fitter:
    """A disk that is being fitted.

    Parameters
    ----------
    start
        A shape, or another fit of the same problem.
    follows_light
        Take steps along the slopes of the light that each solution means, and not of the one that was tabulated. Where both
        differ, the others come to rest where nothing is explained; but where no light of the model is the picture's, they
        hold on to the limb, and these are led away.
    """

    def __init__(
        self, problem: DiskProblem, start: DiskShape | DiskFit, *, follows_light: bool = False
    ) -> None:
        self.problem, self.follows_light = problem, follows_light
        self.lengths: list[float] = []
        self.converged = False
        self.doubt: FloatArray | float = 1.0
        self.patchy = np.zeros(problem.pieces)
        self.celled: _CelledSamples | None = None
        self.tables_likelihood = -np.inf
        self.refused: DiskShape | None = None  # of which no tables were likelier than the last
        self.wandered_px, self.unrest_px2 = np.zeros(2), np.zeros((2, 2))
        if isinstance(start, DiskFit):
            self.shape, self.tuned, self.made = start.shape, start.prior, start.made
            self.brightness = start.brightness_dn
            self.piece_albedo = start.piece_albedo
            self.tunings = 0
            return
        self.tunings = COARSE_TUNINGS
        self.shape = start
        self.tuned = FieldPrior(0.15, 0.5, 0.02, problem.rough_px)
        self.made = problem.tabulated(start)
        self.brightness = _first_brightness(problem, self.made)
        self.piece_albedo = np.ones(problem.pieces)

    @property
    def prior(self) -> FieldPrior:
        """The prior that the data speak for, with cells as uneven as slopes of the relief leave them."""
        return self.tuned.with_slopes(self.problem.radius_px)

    @property
    def is_nearly_even(self) -> bool:
        """Whether the albedo may be that of a surface by another law, rather than of one with patches."""
        return self.prior.albedo < FAINT_ALBEDO

    @property
    def leans_most(self) -> bool:
        """Whether the surface leans as far as it may, by a shading that its axes would not have."""
        return bool(np.any(np.abs(self.shape.strain[2:]) >= self.problem.most_lean))

    @property
    def log_likelihood(self) -> float:
        """That of the last solution, over all that it may be."""
        return self.linear.solution.log_likelihood

    @property
    def known_px2(self) -> FloatArray:
        """Covariance (2, 2) of the center, however far the fit has yet to go."""
        return np.asarray(self._excess() * self.linear.solution.covariance[np.ix_(CENTER, CENTER)])

    def is_likelier(self, settled: "Fitter") -> bool:
        """Tell whether the light that this fit begins with explains more than that of another one, with its prior."""
        self.tuned = settled.tuned
        self._solve()
        self._reweigh()
        return self.log_likelihood > settled.log_likelihood

    def settle(self) -> None:
        """Fit with coarse light."""
        self._solve()
        self.tables_likelihood = self.log_likelihood  # of the last tables as they were made
        for _ in range(self.tunings):
            self._tune(other_light=self.made.light.on_slopes is None)
            self._iterate(MOST_TURNS)

    def run(self, most_fine: int) -> DiskFit:
        """Go on with fine light, which is tabulated so many times at the most."""
        tabled, anew, bounds = self._state(), True, LAST
        for turn in range(most_fine):
            light, then = self.made.light, self.made.shape
            if not light.fine or self._stale(bounds):
                if not self._tabulate(fine=True) and light.fine:
                    # Light that tables are extrapolated to led away from every one of them.
                    self._wander_back(tabled)
                    self._solve()
                    break  # no other light explains more
                tabled, anew = self._state(), not light.fine or self._differ(bounds, self.made.shape, then)
            if turn < MOST_TUNED:
                self._tune(other_light=self.made.light.on_slopes is None)
            bounds = LAST if self._iterate(MOST_TURNS) else UNRESTED
            if not (anew and self._stale(bounds)):
                break
        return self._result()

    def _result(self) -> DiskFit:
        plane, excess = self.problem.pixels.use.shape, self._excess()
        outline = self.made.outline(self.shape)
        near = limb_pixels(outline, plane, *self.problem.reach)
        columns = disk_columns(self.made, self.shape, outline, near, on_slopes=self.prior.on_slopes)
        return DiskFit(
            place=self.problem.place,
            shape=self.shape,
            outline=outline,
            smooth_outline=self.made.outline(self.shape, rough=False),
            made=self.made,
            brightness_dn=self.brightness,
            prior=self.prior,
            system=self.linear.system,
            solution=self._over_hemispheres(),
            pixels=near,
            columns=columns,
            piece_albedo=self.piece_albedo,
            figure=self.problem.figure,
            reach_px=self.problem.reach,
            chi2_reduced=self.chi2_reduced(),
            lit_share=float(np.mean(self.problem.seen_limb(self.made, self.linear.system))),
            lengths_px=tuple(self.lengths),
            converged=self.converged,
            excess=excess,
            scatter=limb_scatter(self.linear.system.scores(self.prior, CENTER), excess),
            unrest_px2=self._unrest_px2(),
            extrapolated=self._stale(NEW, self._meant()),
        )

    def _unrest_px2(self) -> FloatArray:
        """Return by how much (2, 2) the center is off as it wandered, and as the last solution would still move it."""
        wants = self.linear.solution.theta[CENTER]
        wandered = WANDERED_SHARE**2 * np.outer(self.wandered_px, self.wandered_px)
        return np.asarray(wandered + self.unrest_px2 + np.outer(wants, wants))

    def _meant(self) -> DiskShape:
        """Return the shape with the light that the solution means."""
        theta = self.linear.solution.theta
        return replace(
            self.shape, strain=theta[STRAINED], law=theta[SHARES], blur_px2=float(theta[Unknown.BLUR])
        )

    def chi2_reduced(self) -> float:
        """Return that of all cells, or of those without the sky: a rough sky is no fault of the image."""
        whole = self.linear.system
        image = replace(whole, variance=np.where(self.problem.beside, np.inf, whole.variance))
        each = ((whole, self.linear.solution), (image, image.solve(self.prior)))
        return min(solution.chi2 / _degrees(system) for system, solution in each)

    def _solve(self) -> None:
        outline = self.made.outline(self.shape)
        celled = self._celled(outline)
        (_, near, _), on_slopes = celled, self.prior.on_slopes
        columns = disk_columns(
            self.made, self.shape, outline, near.places, on_slopes=on_slopes, spread_px=near.spread_px
        )
        self._solve_at(celled, columns)

    def _solve_at(self, celled: _CelledSamples, columns: FloatArray) -> None:
        """Solve, with cells of sky that no model reaches counting as much as their residuals say (Huber's weights).

        What shines there stays where it is while the outline and its cells move: each solution has to find it anew. Beside
        that nothing changes from one solution to the next: a step that explains a surface is not to be told from one that
        doubts it.
        """
        for _ in range(MOST_DOUBTS):
            system = self._system(celled, columns)
            self.linear = _LinearDisk(system, celled, columns, self._solution(system))
            self.celled = celled
            before, found = self.doubt, self._doubts(self.linear)
            self.doubt = np.where(self.problem.in_sky, found, before)
            if np.max(np.abs(np.log(self.doubt / before))) < SAME_DOUBT:
                break

    def _solution(self, system: LimbSystem) -> MarginalSolution:
        """Return the solution for a law that surfaces have: all else goes with the law, and one of none leads it away."""
        return system.solve(self.prior, self._held(), self._bounds())

    def _bounds(self) -> FloatArray:
        """Return the least and the largest theta (2, p), where the light is about as bright as its tables: `_meant_law`."""
        made = self.made
        bounds = np.full((2, SHARED), [[-np.inf], [np.inf]])
        step = self.problem.law_bounds - made.shape.law
        step[:, 0] /= np.maximum(1.0 + step[:, 0] * made.light.law_means[0], LEAST_BRIGHT)
        bounds[:, SHARES] = made.shape.law + step
        return bounds

    def _doubts(self, linear: _LinearDisk) -> FloatArray:
        """Return by how much (j, c) larger the variance of cells counts than their noise is."""
        return np.maximum(self._sigmas_off(linear) / DOUBTED_SIGMAS, 1.0)

    def _sigmas_off(self, linear: _LinearDisk) -> FloatArray:
        """Return how many sigmas of noise and grain the cells (j, c) are from the model; 0 without pixels."""
        system = linear.system
        known = np.isfinite(system.variance)
        sigma = np.sqrt(np.where(known, system.variance, 1.0) + (self.prior.grain * system.light) ** 2)
        away = np.abs(system.residuals_dn(linear.solution)) / sigma * np.sqrt(self.doubt)
        return np.where(known, away, 0.0)

    def _excess(self) -> float:
        """Return the variance of the cells over what was expected of them, as Huber's loss has it; 1 at least.

        Where cells are no model's, the others know no more of the center than the same model lets them.
        """
        away = self._sigmas_off(self.linear)
        loss = np.where(away < DOUBTED_SIGMAS, away**2, (2.0 * away - DOUBTED_SIGMAS) * DOUBTED_SIGMAS)
        return max(float(loss.sum()) / _degrees(self.linear.system), 1.0)

    def _tune(self, *, other_light: bool = False) -> None:
        """Find the prior of the field; `other_light`: also for an albedo on the other light."""
        before = self.log_likelihood
        self._doubt()
        best, system = self._tuned(), self.linear.system
        if other_light and _is_uneven(best.prior):  # else there is nothing to explain
            kept, self.tuned = self.linear, replace(best.prior, on_slopes=not best.prior.on_slopes)
            self._solve()
            other = self._tuned()
            if other.cost < best.cost:
                best, system = other, self.linear.system
            else:
                self.linear = kept
        self.tuned = best.prior
        self.linear = self.linear._replace(solution=self._solution(system))
        self.tables_likelihood += self.log_likelihood - before

    def _tuned(self) -> TunedPrior:
        problem = self.problem
        return tuned(self.linear.system, self.tuned, problem.rough_px, float(problem.hemispheres.min()))

    def _over_hemispheres(self) -> MarginalSolution:
        """Return the solution, its covariance over all that hemispheres may differ by, as likely as the data have each."""
        solution, system = self.linear.solution, self.linear.system
        if len(self.problem.hemispheres) == 1:
            return solution
        bounds = self._bounds()
        each = [
            system.solve(replace(self.prior, hemispheres=float(h)), bounds=bounds)
            for h in self.problem.hemispheres
        ]
        weight = softmax([one.log_likelihood for one in each])
        away = np.array([one.theta for one in each]) - solution.theta
        whole = np.array([one.covariance for one in each]) + away[:, :, None] * away[:, None, :]
        return replace(solution, covariance=np.tensordot(weight, whole, axes=1))

    def _patchiness(self, celled: _CelledSamples, columns: FloatArray) -> FloatArray:
        """Return the variance (j,) of the albedo within pieces of limb, by pixels beside it about the means of cells.

        Where it is large, a cell's mean of data is not that of its light: pixels that are brighter lie deeper, or less deep.
        """
        problem, near = self.problem, celled.samples
        light = self.brightness * columns[Unknown.BRIGHTNESS]
        here = (
            (near.side == 1.0)
            & (near.places.depth_px < -SURE_SIGMAS * problem.psf_px)
            & (light > LIT_LIMB * self.brightness)
        )
        albedo, light = near.data_dn[here] / light[here], light[here]
        noise = (near.variance_dn2[here] + light / problem.pixels.gain_e_per_dn) / light**2
        count, mean, (square, expected) = gathered(
            celled.cell[here],
            np.ones(len(albedo)),
            albedo,
            np.stack([albedo**2, noise]),
            problem.pieces,
            problem.edges,
        )
        free = np.maximum(count - 1.0, 0.0)
        beyond = np.sum(count * (square - mean**2) - free * expected, axis=1)
        return np.asarray(np.maximum(beyond, 0.0) / np.maximum(free.sum(axis=1), 1.0))

    def _doubt(self) -> None:
        """Let cells that no model reaches count as much as their residuals say (Huber's weights), and patchy ones less."""
        linear = self.linear
        self.doubt = self._doubts(linear)
        self.patchy = self._patchiness(linear.celled, linear.columns)
        self._solve_at(linear.celled, linear.columns)

    def _iterate(self, most: int) -> bool:
        """Move until nothing moves any more, `most` times at the most, and return to the best place that was passed.

        It tells whether that was where nothing moves.

        One that goes on wandering by less than its sigma is as good as settled: how far is in its covariance.

        A step may lead uphill (Chamberlain et al. 1982, doi:10.1007/BFb0120945): the light changes its noise with it.
        """
        self._reweigh()
        best, self.wandered_px, self.unrest_px2 = self._state(), np.zeros(2), np.zeros((2, 2))
        passed, uphill, rests, anew = [], 0, False, True
        for _ in range(most):
            if not anew:
                self._reweigh()  # costs with other weights are not to be compared; new tables have been weighed
            length, lower = self._step()
            self.lengths.append(length)
            passed.append(self.shape.center_px)
            uphill = 0 if lower else uphill + 1
            anew = not self.made.light.fine and self._wants_tables() and self._tabulate(fine=False)
            if anew or self.linear.solution.held_cost < best.linear.solution.held_cost:
                best = self._state()
            fine = self.made.light.fine
            still = (STILL_PX, STILL_SIGMAS) if fine else (COARSE_PX, COARSE_SIGMAS)
            rests = self._wanted_px() < self._slack_px(*still)
            if rests or uphill == MOST_UPHILL:
                break
        if self.linear.solution.held_cost > best.linear.solution.held_cost + self._lost():
            self._wander_back(best)
        lit = bool(self.linear.solution.theta[Unknown.BRIGHTNESS] > 0.0)
        settled = self._wanted_px() < self._slack_px(NEAR_PX, NEAR_SIGMAS)
        if not settled:
            self.unrest_px2 = _spread(passed[len(passed) // 2 :], self.shape.center_px)
            settled = self._slack_px(NEAR_PX, 1.0) ** 2 > float(np.trace(self.unrest_px2))
        self.converged = lit and settled
        return rests

    def _lost(self) -> float:
        """Return by how much a cost may grow with new weights, or new tables, of the same fit."""
        return LOST_SHARE * float(np.count_nonzero(np.isfinite(self.linear.system.variance)))

    def _state(self) -> _FitState:
        return _FitState(self.shape, self.brightness, self.piece_albedo, self.made, self.linear)

    def _wanted_px(self) -> float:
        """Return how far the solution would move the center."""
        return float(np.hypot(*self.linear.solution.theta[CENTER]))

    def _slack_px(self, least_px: float, sigmas: float) -> float:
        """Return what a center may still move by: so many px, or so many of its sigmas."""
        return max(least_px, sigmas * float(np.sqrt(self.linear.solution.covariance[CENTER, CENTER].max())))

    def _step(self) -> tuple[float, bool]:
        """Take a step, or a part of it that does not make the fit worse.

        It returns its length (px), and whether it was such a part. Else it is the last one that was tried; or all of the
        step, where the cost rises in proportion to its parts, and no more than it may with new weights: noise and albedo
        go with the light then, and no part is better.
        """
        before, begun, start = self.shape, self.linear, self.linear.solution
        tried: list[tuple[float, float, _FitState]] = []  # what it costs, its length, where it leads
        for halving in range(MOST_HALVINGS):
            self.shape = before
            length = self._move(begun, 0.5**halving)
            self._solve()
            cost = self.linear.solution.held_cost - start.held_cost
            if cost < self._regrouping(begun, length) or length < STILL_PX:
                return length, True
            tried.append((cost, length, self._state()))
        if IN_PROPORTION * tried[0][0] < tried[1][0] < 0.5 * self._lost():
            _, length, whole = tried[0]
            self._return_to(whole)
        return length, False

    def _regrouping(self, begun: _LinearDisk, length_px: float) -> float:
        """Return what a cost may grow by, with what it changes by (one sigma) if cells so far away are others."""
        if self.linear.celled.cell is begun.celled.cell:
            return GROWTH
        cells = np.count_nonzero(np.isfinite(self.linear.system.variance))
        return GROWTH + 2.0 * float(np.sqrt(cells * min(length_px, 1.0)))

    def _tabulate(self, *, fine: bool) -> bool:
        """Tabulate the light of the shape; where that is less likely than the last tables were, go half as far from them.

        A law that tables are extrapolated to, with an albedo that is on the light they hold, may be no light of any body,
        and still explain the pixels: only what was tabulated is compared. It tells whether the tables are new.
        """
        kept, then, now = self._state(), self.made.shape, self.shape
        patches, moved = self._patches(), self._differ(UNRESTED, now, then)
        for share in HALFWAY:
            self.shape = replace(
                now,
                strain=then.strain + share * (now.strain - then.strain),
                law=then.law + share * (now.law - then.law),
                blur_px2=then.blur_px2 + share * (now.blur_px2 - then.blur_px2),
            )
            both = fine and not self.made.light.fine  # which light the albedo is on is asked once more
            self.made = self.problem.tabulated(
                self.shape,
                fine=fine,
                on_slopes=None if both else self.prior.on_slopes,
                patches=patches,
            )
            self._solve()
            self._reweigh()
            likelihood = self.log_likelihood
            finer = both and not moved  # the same light, better known: likelier or not
            if finer or likelihood > self.tables_likelihood - 0.5 * self._lost():
                self.tables_likelihood, self.refused = likelihood, None
                return True
        if not fine:
            self.refused = now
            self._return_to(kept)
        return False

    def _patches(self) -> Patches:
        """Return the surface that the solution means."""
        solution = self.linear.solution
        mean = float(solution.theta[Unknown.BRIGHTNESS]) / self.brightness
        return Patches(mean, solution.albedo / self.brightness, self.prior.on_slopes)

    def _return_to(self, state: _FitState) -> None:
        self.shape, self.brightness, self.piece_albedo, self.made, self.linear = state
        self.celled = self.linear.celled

    def _wander_back(self, state: _FitState) -> None:
        """Return to a better state, and tell how far the fit had gone from it."""
        went_px = self.shape.center_px
        self._return_to(state)
        self.wandered_px = state.shape.center_px - went_px

    def _held(self) -> dict[int, float]:
        """Return the outline as it is, in terms of theta."""
        shape = self.shape
        figure = dict(zip(FIGURE, (shape.log_size, *shape.strain[:2]), strict=True))
        return {**dict.fromkeys(CENTER, 0.0), **{k: float(v) for k, v in figure.items()}}

    def _move(self, linear: _LinearDisk, most: float) -> float:
        solution, shape = linear.solution, self.shape
        theta = solution.theta
        if not np.isfinite(theta).all():
            raise CenterfindingError(f"{self.problem.name}: its limb tells nothing of its place here.")
        center, size, strain = (
            theta[CENTER],
            theta[Unknown.SIZE] - shape.log_size,
            theta[STRAINED] - shape.strain,
        )
        limb_px = self._limb_moves_px(linear.system, np.concatenate([center, [size], strain[:2]]))
        bounds = (LONGEST_PX / max(limb_px, 1e-12), MOST_STRAIN / max(float(np.abs(strain[:2]).max()), 1e-12))
        part = most * min(1.0, *bounds)
        # A limb that lies elsewhere tells nothing of the light yet.
        near = part * (min(bounds) >= 1.0)
        strained = shape.strain + np.array([part, part, near, near, near]) * np.clip(
            strain, -MOST_STRAIN, MOST_STRAIN
        )
        strained[2:] = np.clip(strained[2:], -self.problem.most_lean, self.problem.most_lean)
        law = np.clip(self._meant_law(linear), *self.problem.law_bounds)
        self.shape = DiskShape(
            shape.center_px + part * center,
            float(np.clip(shape.log_size + part * size, -LARGEST_LOG, LARGEST_LOG)),
            strained,
            shape.law + near * np.clip(law - shape.law, -MOST_LAW, MOST_LAW),
            self._bounded_blur(shape.blur_px2 + near * float(theta[Unknown.BLUR] - shape.blur_px2)),
            shape.rough_px + part * (solution.height_px - shape.rough_px),
        )
        return part * float(np.hypot(*center))

    def _meant_law(self, linear: _LinearDisk) -> FloatArray:
        """Return the law (2,) that a solution means: in the share light is linear, but for the brightness with it."""
        theta, law = linear.solution.theta, self.made.shape.law
        step = theta[SHARES] - law
        whole = self._brightness(linear) / linear.system.brightness_dn
        step[0] /= max(whole - float(step @ self.made.light.law_means), LEAST_BRIGHT)
        return np.asarray(law + step)

    def _limb_moves_px(self, system: LimbSystem, step: FloatArray) -> float:
        """Return how far the limb moves at most, where it is seen, by a step (5,) of center, size and strain of the outline.

        A center that is far off along what is not seen may go all of its way at once.
        """
        angle, radius = piece_angles(self.problem.pieces), self.problem.radius_px
        rows = [np.cos(angle), np.sin(angle)]
        rows += [radius * np.ones_like(angle), radius * np.cos(2.0 * angle), radius * np.sin(2.0 * angle)]
        moves = np.abs(step @ np.stack(rows))
        seen = self.problem.seen_limb(self.made, system)
        return float(moves[seen].max() if seen.any() else moves.max())

    def _reweigh(self) -> None:
        """Solve anew where the outline is, with pieces as bright as the solution has them.

        Noise, grain and albedo go with that: a start whose pieces are all alike would look better than any step from it.
        """
        self._relight(self.linear)
        if self.follows_light:
            self._solve()
        else:
            self._solve_at(self.linear.celled, self.linear.columns)

    def _relight(self, linear: _LinearDisk) -> None:
        """Let the tables and the pieces of limb be as bright as a solution has them."""
        albedo = self.problem.field.at_rim(linear.solution.albedo)
        brightness = self._brightness(linear)
        self.brightness = float(
            np.clip(brightness, self.brightness / MOST_BRIGHTER, self.brightness * MOST_BRIGHTER)
        )
        own = float(linear.solution.theta[Unknown.BRIGHTNESS])
        self.piece_albedo = np.maximum((own + albedo) / self.brightness, 0.1)
        if self.follows_light:
            self.made = self.made.sloped(linear.solution.theta)

    def _brightness(self, linear: _LinearDisk) -> float:
        """Return how bright the tabulated light has to be for the light that a solution means.

        What the law, the shading or the mean of the field make brighter is then no brightness of another kind.
        """
        system, solution, made = linear.system, linear.solution, self.made
        beyond = [*SHARES, *SHADING, Unknown.BLUR]
        known = np.array([*made.shape.law, *made.strain[2:], made.shape.blur_px2])
        unit = system.shared[Unknown.BRIGHTNESS]
        light = np.tensordot(solution.theta[beyond] - known, system.shared[beyond], axes=1)
        light += system.albedo_dn(solution)
        power = max(float(np.sum(unit**2)), np.finfo(float).tiny)
        return float(solution.theta[Unknown.BRIGHTNESS] + np.sum(unit * light) / power)

    def _bounded_blur(self, blur_px2: float) -> float:
        whole = self.problem.psf_variance_px2
        return float(np.clip(blur_px2, -MOST_BLUR[0] * whole, MOST_BLUR[1] * whole))

    def _wants_tables(self) -> bool:
        """Whether coarse light is to be tabulated: not if that of nearly the same shape was none the likelier."""
        return self._stale(NEW) and (self.refused is None or self._differ(NEW, self.shape, self.refused))

    def _stale(self, bounds: Changes, shape: DiskShape | None = None) -> bool:
        """Whether the light was tabulated for another shape than the present one, or than another."""
        return self._differ(bounds, shape or self.shape, self.made.shape)

    def _differ(self, bounds: Changes, now: DiskShape, then: DiskShape) -> bool:
        """Whether two shapes have other light."""
        strain = float(np.abs(now.strain - then.strain).max()) if self.problem.can_be_strained else 0.0
        blur = abs(now.blur_px2 - then.blur_px2) / self.problem.psf_variance_px2
        size = abs(now.log_size - then.log_size)
        share, power = np.abs(now.law - then.law)
        law = share * max(self.prior.albedo, EVEN_ALBEDO) > bounds.share or power > bounds.power
        return law or size > bounds.size or strain > bounds.strain or blur > bounds.blur

    def _celled(self, outline: Outline) -> _CelledSamples:
        """Return the samples about an outline in their cells: those that there are, unless it has moved too far."""
        kept, problem = self.celled, self.problem
        if kept is not None and outline.farthest_px(kept.about) < SAME_CELLS_PX:
            return kept.seen_from(outline)
        near = problem.samples(outline)
        cell = cell_of(near.places, problem.pieces, problem.edges)
        order = np.argsort(cell, kind="stable")  # looked up where the tables lie together: half of the time
        return _CelledSamples(outline, near.in_order(order), cell[order])

    def _cells(self, celled: _CelledSamples, columns: FloatArray) -> _Cells:
        """Return the cells (j, c) of the samples."""
        problem, near, cell = self.problem, celled.samples, celled.cell
        model = self.brightness * columns[Unknown.BRIGHTNESS]
        weight, seen = (
            1.0 / (near.variance_dn2 + np.maximum(light, 0.0) / (problem.pixels.gain_e_per_dn * near.side**2))
            for light in (model, near.data_dn)
        )
        both = np.concatenate([columns, weight[None], columns[:1] ** 2, (seen / weight)[None]])
        whole, data, means = gathered(cell, weight, near.data_dn, both, problem.pieces, problem.edges)
        usable = whole > 0.0
        whole = np.where(usable, whole, 1.0)
        share = means[-3] / whole  # of a pixel in its cell
        uneven = np.maximum(means[-2] - means[0] ** 2, 0.0) * share
        patches = self.brightness**2 * self.patchy[:, None] * uneven
        faint = (FAINTEST * self.brightness) ** 2
        variance = np.where(usable, self.doubt * (1.0 / whole + faint) + patches, np.inf)
        seen_variance = 1.0 / np.where(usable, means[-1] * whole, 1.0) + faint
        return _Cells(variance, seen_variance, data, means[:-3])

    def _system(self, celled: _CelledSamples, columns: FloatArray) -> LimbSystem:
        """Return the linear system of the cells: what the present shape has of theta stands on the side of the data."""
        problem, shape, made = self.problem, self.shape, self.made
        variance, seen_variance, data, means = self._cells(celled, columns)
        lit = self.brightness * self.piece_albedo[:, None]
        means = columns_dn(means, self.brightness, lit)
        shaded, parts = means[SHADED], means[ALBEDO]
        known = np.array(
            [shape.log_size, *shape.strain[:2], *made.shape.law, *made.strain[2:], made.shape.blur_px2]
        )
        data = (
            data
            + np.tensordot(known, means[[*FIGURE, *SHARES, *SHADING, Unknown.BLUR]], axes=1)
            + np.tensordot(made.strain[:2], shaded, axes=1)
            + means[SHARED] * shape.rough_px[:, None]
        )
        means[FIGURE[1:]] += shaded  # the outline has its strain, the shading that of the tables
        usable = np.isfinite(variance)
        own, amplified = problem.field.split(parts)
        light = lit * np.maximum(means[0], means[0] + means[Unknown.WINGS] / self.brightness)
        return LimbSystem(
            data=data,
            variance=variance,
            seen_variance=seen_variance,
            light=np.where(usable, np.maximum(np.maximum(light, means[RELIEF]), 0.0), 0.0),
            shared=means[:SHARED],
            parts=parts,
            own=np.concatenate([own, means[SHARED : SHARED + 1]]),
            amplified=amplified,
            prior_mean=problem.prior_mean(shape.center_px),
            prior_precision=problem.prior_precision,
            scales=problem.scales,
            field=problem.field,
            brightness_dn=self.brightness,
        )


def _first_brightness(problem: DiskProblem, made: TabulatedDisk) -> float:
    near = problem.samples(made.outline(made.shape))
    model = near.side * made.light.at(near.places.angle_rad, near.places.depth_px, 1)[0]
    power = float(model @ model)
    least = problem.picture.typical_noise_dn
    return max(float(model @ (near.side * near.data_dn)) / power, least) if power > 0.0 else least
