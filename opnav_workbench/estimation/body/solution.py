"""Size, axes, pole, spin and center of figure of a body from pictures, in one batch with trajectory and pointing.

    minimise  sum over pictures |L^-1 r(x)|^2  +  |L0^-1 x|^2

with x what all pictures share (`opnav_workbench.estimation.body.knowledge`), the error of each picture's attitude, and the
place of each landmark. An even rotation that is off by a quarter of a turn, or by one from the first picture to the last,
may explain outlines nearly as well, so the batch begins at several and the likeliest counts.

Reference: Tapley, Schutz & Born (2004), Statistical Orbit Determination, section 4.3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import chdtrc

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.body.design import BodyState, Rows, landmark_rows, outline_rows, spun_target
from opnav_workbench.estimation.body.knowledge import (
    MAP,
    MERIDIAN,
    OFFSET,
    POLE,
    RADII,
    SHARED,
    SPIN,
    BodyKnowledge,
)
from opnav_workbench.estimation.body.rotation import BodyRotation
from opnav_workbench.estimation.body.sightings import BodySighting
from opnav_workbench.estimation.body.words import observability_words
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.geometry import wrapped
from opnav_workbench.kernels.making.pool_variables import pck_assignments
from opnav_workbench.kernels.text_kernels import write_text_kernel
from opnav_workbench.render import BodyModel, FigureUncertainty
from opnav_workbench.robust import equal_sigmas, moment_excess

__all__ = ["BodySolution", "SightingResidual", "solve_body"]

MOST_STEPS = 25
STILL = 1e-5  # of chi-squared: a last step of 0.003 sigma in any direction
NO_BETTER = 1e-2  # a step of 0.1 sigma that makes nothing better: the bottom of a bent valley
MOST_HALVINGS = 4
REJECT_SIGMAS = 4.5  # one good outline in 150 000 is lost
MOST_REJECTED = 1.0 / 3.0
START_STEP_RAD = np.radians(40.0)  # the outline of an ellipsoid comes again after half a turn
START_SIGMAS = 2.5
MOST_STARTS = 60
EXCESS_TOLERANCE_PX = 1e-4
FEWEST_TO_JUDGE = 6  # outlines: what one of fewer says nobody can contradict
LEAST_FREEDOM = 1e-3  # of an outline's variance: what is left of one that alone determines something
MIDDLE_OF_FIVE = 4.351  # the median of chi-squared with five degrees of freedom
SECOND_BEST = 9.0  # of chi-squared: a solution elsewhere that is no less likely than 3 sigma
CHART_STEPS = 6
NO_TERMS: Mapping[str, int] = MappingProxyType({})
FIGURE_LIMITS = 1e-5, 0.9


@dataclass(frozen=True, slots=True, eq=False)
class SightingResidual:
    """What remains of one picture's outline or of one of its landmarks.

    Attributes
    ----------
    kind
        "outline" or the landmark's name.
    residual_px : (5,) or (2,) array
        Observed minus computed; of an outline center, mean radius, and radius as cos 2a and sin 2a.
    sigmas
        Its size, as the sigma of equal probability.
    """

    image: str
    kind: str
    residual_px: FloatArray
    sigmas: float
    used: bool
    reason: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class BodySolution:
    """A body as a sequence of pictures tells it.

    Attributes
    ----------
    name
        Of the body.
    epoch_et
        Of state correction and prime meridian, TDB seconds past J2000.
    state
        Everything that was solved for.
    a_priori_radii_km, a_priori_rotation
        What was believed before.
    covariance : (20, 20) array
        Of what all pictures share, in the order of `opnav_workbench.estimation.body.knowledge.PARAMETERS`.
    a_priori_covariance : (20, 20) array
    attitude_covariances : (m, 3, 3) array
        Of each picture's attitude, solved.
    images, residuals
        Pictures in their order; what remains.
    excess_px
        Scatter of outlines beyond what they state; in the covariance.
    chi2, degrees_of_freedom
        Of measurements and a priori knowledge together; everything solved for has an a priori sigma, so that there are as
        many degrees of freedom as measured numbers.
    words
        What the pictures tell and what they do not, in plain words.
    messages
        What must be known of the whole.
    """

    name: str
    epoch_et: float
    state: BodyState
    a_priori_radii_km: FloatArray
    a_priori_rotation: BodyRotation
    covariance: FloatArray
    a_priori_covariance: FloatArray
    attitude_covariances: FloatArray
    images: tuple[str, ...]
    residuals: tuple[SightingResidual, ...]
    excess_px: float
    chi2: float
    degrees_of_freedom: int
    converged: bool
    words: tuple[str, ...]
    messages: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def radii_km(self) -> FloatArray:
        """Semi-axes (3,)."""
        return self.state.radii_km

    @property
    def radii_sigma_km(self) -> FloatArray:
        """Standard deviations (3,) of the semi-axes."""
        return np.asarray(self.radii_km * self._sigma(RADII.columns))

    @property
    def rotation(self) -> BodyRotation:
        """Pole, prime meridian and spin."""
        return self.state.rotation

    @property
    def pole_sigma_rad(self) -> FloatArray:
        """Standard deviations (2,) of the pole toward east and toward north."""
        return self._sigma(POLE.columns)

    @property
    def phase_sigma_rad(self) -> float:
        """Standard deviation of the rotation's phase at the epoch, beside the pole's."""
        return float(self._sigma(MERIDIAN.columns)[0])

    @property
    def rotation_covariance(self) -> FloatArray:
        """Covariance (4, 4) of pole RA and Dec, prime meridian at the epoch (rad) and rate (rad/s)."""
        columns = slice(POLE.columns.start, SPIN.columns.stop)
        jacobian = self.rotation.angles_jacobian()
        return symmetric(jacobian @ self.covariance[columns, columns] @ jacobian.T)

    @property
    def spin_sigma_rad_s(self) -> float:
        """Standard deviation of the rate."""
        return float(self._sigma(SPIN.columns)[0])

    @property
    def offset_km(self) -> FloatArray:
        """Center of figure (3,) from the center of mass, body-fixed."""
        return self.state.offset_km

    @property
    def offset_sigma_km(self) -> FloatArray:
        """Standard deviations (3,) of that."""
        return self._sigma(OFFSET.columns)

    def _sigma(self, columns: slice) -> FloatArray:
        return np.asarray(np.sqrt(np.diag(self.covariance)[columns]))

    @property
    def figure_sigmas(self) -> tuple[float, float]:
        """Standard deviations of the common size, and of an axis beside it, as parts of themselves."""
        whole = self.covariance[RADII.columns, RADII.columns]
        size = float(whole.mean())
        axes = max(float(np.trace(whole)) / 3.0 - size, 0.0)
        low, high = FIGURE_LIMITS
        return float(np.clip(np.sqrt(size), low, high)), float(np.clip(np.sqrt(axes), low, high))

    @property
    def probability(self) -> float:
        """Of a chi-squared as large or larger by chance; nan without degrees of freedom."""
        freedom = self.degrees_of_freedom
        return float(chdtrc(freedom, self.chi2)) if freedom > 0 else float("nan")

    def model(
        self, model: BodyModel, sighting: BodySighting, transition: Transition = straight_line
    ) -> BodyModel:
        """Return the body's model for a picture of the sequence: its size, place and orientation as solved.

        A shape keeps its form and becomes no larger; its radii are not those of an ellipsoid.
        """
        moved = transition(self.epoch_et, sighting.et)[:3] @ self.state.state
        target = spun_target(sighting, self.state, sighting.target.position_km + moved)
        assert target.body_from_j2000 is not None
        figure_center = target.position_km + self.offset_km @ target.body_from_j2000
        there = model.target.standing_at(figure_center)
        return replace(
            model, target=replace(there, radii_km=self.radii_km, body_from_j2000=target.body_from_j2000)
        )

    def figure(self, figure: FigureUncertainty) -> FigureUncertainty:
        """Return how far a disk's model may be off now, roughness, albedo and law as they were."""
        size, axes = self.figure_sigmas
        return replace(figure, size_sigma=size, axes_sigma=axes)

    def write_pck(self, path: str | Path, body_id: int, periodic_terms: Mapping[str, int] = NO_TERMS) -> Path:
        """Write radii, pole and prime meridian as a PCK text kernel, to be loaded after those that it corrects.

        Parameters
        ----------
        periodic_terms : mapping of str to int, optional
            Of the kernels before (`opnav_workbench.kernels.body_periodic_terms`): the solved rotation has none.

        Raises
        ------
        KernelError
            The file cannot be written.
        """
        ra, dec, meridian = self.rotation.pck_terms()
        values = pck_assignments(
            body_id,
            radii_km=tuple(float(x) for x in self.radii_km),
            pole_ra_deg=ra,
            pole_dec_deg=dec,
            prime_meridian_deg=meridian,
        )
        title = (
            f"Size and rotation of {self.name} as solved by opnav_workbench from {len(self.images)} pictures; load it after "
            "the kernels that it corrects."
        )
        comment = "\n\n".join((title, *self.words))
        values |= {name: (0.0,) * count for name, count in periodic_terms.items()}
        write_text_kernel(path, "PCK", values, comment)
        return Path(path)


def solve_body(
    sightings: Sequence[BodySighting],
    rotation: BodyRotation,
    knowledge: BodyKnowledge | None = None,
    *,
    radii_km: FloatArray | None = None,
    transition: Transition = straight_line,
    reject_sigmas: float = REJECT_SIGMAS,
    start: BodyState | None = None,
) -> BodySolution:
    """Solve for a body's size, axes, pole, spin and center of figure, the trajectory and the pictures' pointing.

    Parameters
    ----------
    sightings
        Of one body in one picture each, with an outline, landmarks, or both.
    rotation
        As believed; its epoch is that of the solution, best near the middle of the sequence.
    knowledge
        What is believed before, and how well.
    radii_km : (3,) array, optional
        As believed; by default those of the first picture's target.
    transition : callable
        How a correction of the body's state relative to the spacecraft at the epoch grows: ``(epoch_et, et) -> (6, 6)``.
    reject_sigmas
        An outline or landmark that remains farther off than this is left out; inf for none.
    start
        Where to begin; by default at what is believed, and at the phases and rates about it.

    Raises
    ------
    EstimationError
        Nothing to solve from, an attitude without a covariance, or too much that does not fit.

    Examples
    --------
    ``solution = solve_body(sightings, BodyRotation.from_attitudes(attitude, epoch))``, then ``solution.radii_km``,
    ``solution.words`` and ``solution.write_pck("bennu.tpc", 2101955)``.

    >>> solve_body([], BodyRotation(0.0, 1.0, 0.0, 1e-4, 0.0))
    Traceback (most recent call last):
    ...
    opnav_workbench.errors.EstimationError: none of 0 pictures shows an outline or landmarks; nothing to solve from.
    """
    seen = [s for s in sightings if s.outline is not None or s.landmarks is not None]
    if not seen:
        raise EstimationError(
            f"none of {len(sightings)} pictures shows an outline or landmarks; nothing to solve from."
        )
    batch = _Batch(seen, rotation, knowledge or BodyKnowledge(), radii_km, transition)
    best, rivals = batch.best([start] if start is not None else batch.starts())
    best = batch.without_outliers(best, reject_sigmas)
    return batch.solution(best, rivals)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    state: BodyState
    step: FloatArray  # whole way from what is believed, of what is shared
    covariance: FloatArray
    chi2: float
    excess_px: float
    converged: bool


class _Batch:
    """What stays while a body is solved for."""

    def __init__(
        self,
        sightings: Sequence[BodySighting],
        rotation: BodyRotation,
        knowledge: BodyKnowledge,
        radii_km: FloatArray | None,
        transition: Transition,
    ) -> None:
        self.sightings, self.knowledge, self.rotation = tuple(sightings), knowledge, rotation
        self.times = np.array([s.et for s in sightings])
        first = sightings[0].target.radii_km
        if radii_km is None and first is None:
            raise EstimationError(f"the size of {sightings[0].target.name} is unknown; give its radii, km.")
        self.radii_km = np.asarray(first if radii_km is None else radii_km, float)
        self.transition = [transition(rotation.epoch_et, s.et)[:3] for s in sightings]
        landmarks = [s.landmarks for s in sightings if s.landmarks is not None]
        self.names = tuple(dict.fromkeys(name for one in landmarks for name in one.id.tolist()))
        self.column = {name: SHARED + 3 * len(sightings) + 3 * i for i, name in enumerate(self.names)}
        self.size = SHARED + 3 * len(sightings) + 3 * len(self.names)
        self.outliers: dict[tuple[int, str], str] = {}
        self.prior = self._prior()

    def _prior(self) -> FloatArray:
        """Return the information (n, n) of what is believed before."""
        mean = float(np.cbrt(np.prod(self.radii_km)))
        self.a_priori_covariance = self.knowledge.covariance(mean, self.rotation.rate_rad_s)
        blocks = [np.linalg.inv(self.a_priori_covariance)]
        for sighting in self.sightings:
            try:
                np.linalg.cholesky(sighting.attitude_covariance_rad2)
            except np.linalg.LinAlgError as error:
                raise EstimationError(f"{sighting.image}: the covariance of its attitude is none.") from error
            blocks.append(np.linalg.inv(sighting.attitude_covariance_rad2))
        places = {
            name: covariance
            for s in self.sightings
            if s.landmarks is not None
            for name, covariance in zip(
                s.landmarks.id.tolist(), s.landmarks.place_covariance_km2, strict=True
            )
        }
        blocks += [np.linalg.inv(places[name]) for name in self.names]
        return np.asarray(block_diag(*blocks))

    # ---- Where to begin.

    def believed(self) -> BodyState:
        return BodyState(
            np.zeros(6), self.radii_km, self.rotation, np.zeros(3), 0.0, np.zeros(3),
            np.zeros((len(self.sightings), 3)), {name: np.zeros(3) for name in self.names},
        )  # fmt: skip

    def starts(self) -> list[BodyState]:
        """Return states with the phases and rates that are believed possible, the likeliest first."""
        sigma = np.sqrt(np.diag(self.a_priori_covariance))
        half_s = max(float(np.abs(self.times - self.rotation.epoch_et).max()), 1.0)
        phases = _ladder(START_SIGMAS * sigma[MERIDIAN.columns][0], START_STEP_RAD)
        rates = _ladder(START_SIGMAS * sigma[SPIN.columns][0] * half_s, START_STEP_RAD) / half_s
        steps = sorted(
            ((p, r) for p in phases for r in rates),
            key=lambda one: float(
                np.hypot(one[0] / sigma[MERIDIAN.columns][0], one[1] / sigma[SPIN.columns][0])
            ),
        )
        out = []
        for phase, rate in steps[:MOST_STARTS]:
            step = np.zeros(self.size)
            step[MERIDIAN.columns], step[SPIN.columns] = phase, rate
            out.append(self.believed().moved(step))
        return out

    def best(self, starts: Sequence[BodyState]) -> tuple[_Found, tuple[_Found, ...]]:
        """Return the likeliest solution, and others that are nearly as likely."""
        found = sorted((self._descend(start, 0.0) for start in starts), key=lambda one: one.chi2)
        best = self._with_excess(found[0])
        scale = max(found[0].chi2 / max(self._freedom(), 1), 1.0)
        sigma = np.sqrt(np.diag(best.covariance))
        rivals = [
            one
            for one in found[1:]
            if one.chi2 < found[0].chi2 + SECOND_BEST * scale
            and np.abs((one.step - found[0].step) / sigma[:SHARED]).max() > 1.0
        ]
        return best, tuple(rivals)

    # ---- The batch.

    def rows(self, state: BodyState, excess_px: float) -> list[tuple[int, str, Rows]]:
        """Return the rows of every picture's outline and landmarks, with the picture's number."""
        out: list[tuple[int, str, Rows]] = []
        for i, s in enumerate(self.sightings):
            if s.outline is not None:
                rows = outline_rows(s, s.outline, state, state.attitudes[i], self.transition[i])
                radius = 0.5 * s.outline.outline.diameter_px
                more = (excess_px / np.array([1.0, 1.0, radius, radius, radius])) ** 2
                out.append((i, "outline", replace(rows, covariance=rows.covariance + np.diag(more))))
            if s.landmarks is not None:
                rows = landmark_rows(s, s.landmarks, state, state.attitudes[i], self.transition[i])
                out.append((i, "landmarks", rows))
        return out

    def _used(self, i: int, kind: str) -> FloatArray:
        """Return which rows (k,) are in use."""
        if kind == "outline":
            return np.full(5, (i, kind) not in self.outliers)
        reading = self.sightings[i].landmarks
        assert reading is not None
        return np.repeat([(i, name) not in self.outliers for name in reading.id.tolist()], 2)

    def _jacobian(self, i: int, rows: Rows) -> FloatArray:
        jacobian = np.zeros((len(rows.residual), self.size))
        jacobian[:, :SHARED] = rows.by_shared
        first = SHARED + 3 * i
        jacobian[:, first : first + 3] = rows.by_attitude
        if rows.by_place is not None:
            reading = self.sightings[i].landmarks
            assert reading is not None
            for k, name in enumerate(reading.id.tolist()):
                column = self.column[name]
                jacobian[2 * k : 2 * k + 2, column : column + 3] = rows.by_place[k]
        return jacobian

    def _normal(
        self, state: BodyState, total: FloatArray, excess_px: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return normal matrix, right side and chi-squared."""
        normal, right = self.prior.copy(), -self.prior @ total
        chi2 = float(total @ self.prior @ total)
        for i, kind, rows in self.rows(state, excess_px):
            used = self._used(i, kind)
            if not used.any():
                continue
            weight = np.linalg.inv(rows.covariance[np.ix_(used, used)])
            jacobian, residual = self._jacobian(i, rows)[used], rows.residual[used]
            by_weight = jacobian.T @ weight
            normal += by_weight @ jacobian
            right += by_weight @ residual
            chi2 += float(residual @ weight @ residual)
        return normal, right, chi2

    def _descend(self, start: BodyState, excess_px: float) -> _Found:
        """Gauss-Newton with halved steps where one makes it worse."""
        state, total = start, self._way_to(start)
        normal, right, chi2 = self._normal(state, total, excess_px)
        converged = False
        for _ in range(MOST_STEPS):
            step = _solve(normal, right)
            decrease = float(right @ step)  # of chi-squared, as the linearized batch has it
            for halving in range(MOST_HALVINGS):
                part = step * 0.5**halving
                try:
                    trial = state.moved(part)
                    made = self._normal(trial, total + part, excess_px)
                except EstimationError:
                    continue
                if made[2] < chi2 + 1e-6 * max(chi2, 1.0):
                    break
            else:
                converged = decrease < NO_BETTER
                break
            state, total, (normal, right, chi2) = trial, total + part, made
            if decrease < STILL:
                converged = True
                break
        covariance = _inverse(normal)
        return _Found(state, total[:SHARED], covariance, chi2, excess_px, converged)

    def _way_to(self, state: BodyState) -> FloatArray:
        """Return the whole step (n,) from what is believed to a state."""
        total = np.zeros(self.size)
        total[:6] = state.state
        total[RADII.columns] = np.log(state.radii_km / self.radii_km)
        total[slice(POLE.columns.start, SPIN.columns.stop)] = _turn_between(self.rotation, state.rotation)
        total[OFFSET.columns], total[MAP.columns] = state.offset_km, state.map_log
        total[OFFSET.columns.stop] = state.limb_px
        m = 3 * len(self.sightings)
        total[SHARED : SHARED + m] = state.attitudes.ravel()
        if self.names:
            total[SHARED + m :] = np.concatenate([state.places_km[name] for name in self.names])
        return total

    def _freedom(self) -> int:
        outlines = sum(
            5
            for i, s in enumerate(self.sightings)
            if s.outline is not None and (i, "outline") not in self.outliers
        )
        landmarks = sum(
            2 for i, s in enumerate(self.sightings) if s.landmarks is not None
            for name in s.landmarks.id.tolist() if (i, name) not in self.outliers
        )  # fmt: skip
        return outlines + landmarks

    # ---- What does not fit.

    def _with_excess(self, found: _Found) -> _Found:
        """Return the solution with the scatter of outlines beyond what they state in its covariance."""
        for _ in range(2):
            excess = self._excess(found)
            if abs(excess - found.excess_px) < EXCESS_TOLERANCE_PX:
                break
            found = self._descend(found.state, excess)
        return found

    def _excess(self, found: _Found) -> float:
        outlines = [
            (rows, 0.5 * self.sightings[i].outline.outline.diameter_px)  # type: ignore[union-attr]
            for i, kind, rows in self.rows(found.state, 0.0)
            if kind == "outline" and (i, kind) not in self.outliers
        ]
        if len(outlines) < 3:
            return 0.0
        # Attitudes are held by what is known of them; what all share takes a part of every outline's freedom.
        left = max(1.0 - SHARED / (5.0 * len(outlines)), 0.3)

        def surplus(sigma: float) -> float:
            """Of the middle outline: one that does not fit is an outlier, not scatter."""
            squares = []
            for rows, radius in outlines:
                more = (sigma / np.array([1.0, 1.0, radius, radius, radius])) ** 2
                whole = rows.covariance + np.diag(more)
                squares.append(float(rows.residual @ np.linalg.solve(whole, rows.residual)))
            return float(np.median(np.array(squares)) - MIDDLE_OF_FIVE * left)

        return moment_excess(surplus, EXCESS_TOLERANCE_PX)

    def residuals(self, found: _Found) -> list[tuple[tuple[int, str], SightingResidual]]:
        """Return what remains of every outline and landmark, with its key among the outliers."""
        out = []
        for i, kind, rows in self.rows(found.state, found.excess_px):
            s = self.sightings[i]
            parts = [("outline", slice(0, 5))]
            if kind == "landmarks":
                assert s.landmarks is not None
                parts = [(name, slice(2 * k, 2 * k + 2)) for k, name in enumerate(s.landmarks.id.tolist())]
            for name, part in parts:
                residual = rows.residual[part]
                square = float(residual @ np.linalg.solve(rows.covariance[part, part], residual))
                scale = np.ones(len(residual))
                if name == "outline" and s.outline is not None:
                    scale[2:] = 0.5 * s.outline.outline.diameter_px
                reason = self.outliers.get((i, name), "")
                sigmas = equal_sigmas(square, len(residual))
                out.append(
                    ((i, name), SightingResidual(s.image, name, residual * scale, sigmas, not reason, reason))
                )
        return out

    def without_outliers(self, found: _Found, reject_sigmas: float) -> _Found:
        """Return the solution without what does not fit, one round of outliers after the other."""
        while True:
            remaining = self.residuals(found)
            far = [(k, r) for k, r in remaining if r.used and r.sigmas > reject_sigmas]
            if not far:
                fewer = self._without_one(found, reject_sigmas)
                if fewer is None:
                    return found
                found = fewer
                continue
            worst = max(r.sigmas for _, r in far)
            for key, r in far:
                if r.sigmas > 0.5 * worst:
                    self.outliers[key] = f"{r.sigmas:.1f} sigma off"
            if len(self.outliers) > MOST_REJECTED * len(remaining):
                raise EstimationError(
                    f"{len(self.outliers)} of {len(remaining)} outlines and landmarks are more than {reject_sigmas:g} sigma "
                    "off: sigmas, trajectory or rotation do not fit the pictures; look at the centers, or believe less."
                )
            found = self._with_excess(self._descend(found.state, found.excess_px))

    def _without_one(self, found: _Found, reject_sigmas: float) -> _Found | None:
        """Return the solution without the outline that pulls most, if the others say that it is none of them.

        One wrong outline bends a fit of a few and hides in the scatter that it makes.
        """
        if found.excess_px == 0.0 or not np.isfinite(reject_sigmas):
            return None
        outlines = [
            (i, rows)
            for i, kind, rows in self.rows(found.state, found.excess_px)
            if kind == "outline" and (i, kind) not in self.outliers
        ]
        if len(outlines) < FEWEST_TO_JUDGE:
            return None
        i, _ = max(outlines, key=lambda one: self._off(one[0], one[1], found.covariance, -1.0))
        self.outliers[i, "outline"] = "not like the others"
        others = self._with_excess(self._descend(found.state, 0.0))
        rows = next(
            r for k, kind, r in self.rows(others.state, others.excess_px) if (k, kind) == (i, "outline")
        )
        sigmas = equal_sigmas(self._off(i, rows, others.covariance, 1.0), len(rows.residual))
        if sigmas > reject_sigmas:
            self.outliers[i, "outline"] = f"{sigmas:.1f} sigma off what the others say"
            return others
        del self.outliers[i, "outline"]
        return None

    def _off(self, i: int, rows: Rows, covariance: FloatArray, sign: float) -> float:
        """Return chi-squared of an outline's residual: one in use (-1) scatters less than it states, one not in use more."""
        jacobian = self._jacobian(i, rows)
        mapped = symmetric(rows.covariance + sign * jacobian @ covariance @ jacobian.T)
        value, axes = np.linalg.eigh(mapped / np.outer(*[np.sqrt(np.diag(rows.covariance))] * 2))
        part = axes.T @ (rows.residual / np.sqrt(np.diag(rows.covariance)))
        return float(np.sum(part**2 / np.maximum(value, LEAST_FREEDOM)))

    # ---- What comes out.

    def solution(self, found: _Found, rivals: Sequence[_Found]) -> BodySolution:
        m = len(self.sightings)
        attitudes = np.array(
            [found.covariance[k : k + 3, k : k + 3] for k in range(SHARED, SHARED + 3 * m, 3)]
        )
        residuals = tuple(r for _, r in self.residuals(found))
        sight = np.mean([s.target.direction for s in self.sightings], axis=0)
        shared = found.covariance[:SHARED, :SHARED]
        words = observability_words(
            shared,
            self.a_priori_covariance,
            sight / np.linalg.norm(sight),
            with_outlines=any(s.outline is not None for s in self.sightings),
            with_map=bool(self.names),
        )
        messages = [] if found.converged else [f"not converged after {MOST_STEPS} steps"]
        if rivals:
            turn = _turn_between(found.state.rotation, rivals[0].state.rotation)
            messages.append(
                f"another rotation explains the pictures nearly as well: the prime meridian {np.degrees(turn[2]):+.1f} deg, "
                f"the spin rate {turn[3] / self.rotation.rate_rad_s:+.2e} of itself; more pictures between, or better a "
                "priori knowledge, would tell"
            )
        return BodySolution(
            name=self.sightings[0].target.name,
            epoch_et=self.rotation.epoch_et,
            state=found.state,
            a_priori_radii_km=self.radii_km,
            a_priori_rotation=self.rotation,
            covariance=symmetric(shared),
            a_priori_covariance=self.a_priori_covariance,
            attitude_covariances=attitudes,
            images=tuple(s.image for s in self.sightings),
            residuals=residuals,
            excess_px=found.excess_px,
            chi2=found.chi2,
            degrees_of_freedom=self._freedom(),
            converged=found.converged,
            words=words,
            messages=tuple(messages),
        )


def _ladder(reach: float, step: float) -> FloatArray:
    """Return 0 and even steps to both sides, as far as `reach` goes."""
    n = int(np.ceil(max(reach - 0.5 * step, 0.0) / step))
    return np.asarray(np.arange(-n, n + 1) * step, dtype=np.float64)


def _turn_between(first: BodyRotation, second: BodyRotation) -> FloatArray:
    """Return the step (4,) that `BodyRotation.turned` takes from one to another of the same epoch."""
    if first == second:
        return np.zeros(4)
    step = np.zeros(4)
    # The step is a chart of rotations: exact for a pole that stays, else within its second order.
    for _ in range(CHART_STEPS):
        here = first.turned(step)
        away = np.array([
            wrapped(second.pole_ra_rad - here.pole_ra_rad), second.pole_dec_rad - here.pole_dec_rad,
            wrapped(second.meridian_rad - here.meridian_rad), second.rate_rad_s - here.rate_rad_s,
        ])  # fmt: skip
        step = step + np.linalg.solve(here.angles_jacobian(), away)
    return step


def _scaled_factor(normal: FloatArray) -> tuple[tuple[FloatArray, bool], FloatArray]:
    scale = 1.0 / np.sqrt(np.diag(normal))
    return cho_factor(normal * np.outer(scale, scale)), scale


def _solve(normal: FloatArray, right: FloatArray) -> FloatArray:
    factor, scale = _scaled_factor(normal)
    return np.asarray(scale * cho_solve(factor, scale * right))


def _inverse(normal: FloatArray) -> FloatArray:
    factor, scale = _scaled_factor(normal)
    return symmetric(cho_solve(factor, np.eye(len(normal))) * np.outer(scale, scale))
