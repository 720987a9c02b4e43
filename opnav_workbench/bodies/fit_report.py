"""How the full-disk methods come to centers: search, fit, and from the fit covariance, flags, status and messages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.detection import DetectedBody, SearchRequest, detect_bodies
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.results import (
    DOUBTFUL_FLAGS,
    BodyCenter,
    BodyFlag,
    BodyResiduals,
    JointCenters,
    ModelFit,
    flag_messages,
    flags_where,
    size_messages,
)
from opnav_workbench.bodies.scene_fit import (
    COUNT,
    LAW,
    PARAMETERS,
    SCALE,
    SIZE,
    SceneFit,
    SceneState,
    fit_scene,
)
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["measure_bodies"]

NO_PIXELS = "no usable pixels about its place"
MIN_PIXELS_PER_BODY = 10
LOST_LIGHT = 0.1  # share of a body's light off the detector that makes its center doubtful
SATURATED_PART = 0.2  # of its bright pixels
BAD_PART = 0.1
CERTAIN_SNR = 5.0
POORLY_EXPLAINED = 0.6  # share of the light's power; an albedo map of Pluto's contrast leaves 0.9
ABSORBED = 0.8  # of a pattern's power: what is left in the residuals no longer tells how strong it is
SIZE_SIGMAS = 2.0  # by which an image may differ from the size that was expected
PRIOR_SIGMAS = 3.0  # by which size and strains may leave what was known of them
THIN_PHASE_RAD = np.radians(130.0)
THIN_PX = 1.0  # widest part of a crescent: below, the sampled model holds its light to a few percent only
WEAK_RATIO = 10.0  # of the axes of the error ellipse
WEAK_SIGMA_PX = 0.05
# Limbs are sampled in cells of 1/32 px. What that does to a center, over the root of the diameter: nothing for a full
# disk, whose errors cancel, most for a crescent.
RENDERING_ERROR_PX = 0.004


def measure_bodies(
    picture: BodyPicture,
    names: Sequence[str],
    search: SearchRequest,
    read: Callable[[SceneFit], SceneFit],
) -> JointCenters:
    """Search bodies, fit those that touch each other together, and report them in the order of `names`.

    Parameters
    ----------
    read
        Makes of the fit of a group the one to report.
    """
    for name in names:
        picture.model(name)  # raises for a name that is not there
    detected = detect_bodies(picture, names, search)
    centers, joint = dict(detected.missed), np.full((2 * len(names), 2 * len(names)), np.nan)
    for group in detected.groups(picture):
        wanted = [name for name in group if name in detected.found]
        cutout = detected.pixels(picture, group)
        if cutout is None or np.count_nonzero(cutout.use) < MIN_PIXELS_PER_BODY * len(group):
            for name in wanted:
                centers[name] = BodyCenter.without_center(
                    name, search.method, "failed", NO_PIXELS, flags=int(BodyFlag.EMPTY)
                )
            continue
        places = np.stack([detected.places[name] for name in group])
        sizes = np.array([detected.found[n].size_ratio if n in wanted else 1.0 for n in group])
        solved = np.array([search.solve_range and name in wanted for name in group])
        fit = read(fit_scene(picture, cutout, SceneState.at(group, places, sizes), solved))
        report = _FitReport(picture, cutout, fit, search.method, solved, _covariance(picture, fit))
        centers |= {name: report.center(k, detected.found[name]) for k, name in enumerate(wanted)}
        at = np.ravel([[2 * names.index(name), 2 * names.index(name) + 1] for name in wanted])
        joint[at[:, None], at] = report.covariance_px2[: 2 * len(wanted), : 2 * len(wanted)]
    seen = np.repeat([centers[name].pixel_line is not None for name in names], 2)
    joint[np.isnan(joint)] = 0.0
    joint[~seen] = joint[:, ~seen] = np.nan
    return JointCenters(tuple(centers[name] for name in names), joint)


def _covariance(picture: BodyPicture, fit: SceneFit) -> FloatArray:
    """Return the covariance (2 n, 2 n) of the centers, with the rendering's sampling and the error of the frame's stars."""
    phase = np.array([picture.phase_rad(name) for name in fit.state.names])
    dark = np.where(np.isfinite(phase), 0.5 * (1.0 - np.cos(phase)), 0.0)
    diameter = np.array([max(body.diameter_px, 1.0) for body in fit.rendered])
    own = RENDERING_ERROR_PX**2 * dark**2 / diameter + picture.excess_sigma_px**2
    at = np.ravel([[COUNT * k, COUNT * k + 1] for k in range(len(phase))])
    return np.asarray(fit.covariance[at[:, None], at] + np.diag(np.repeat(own, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _FitReport:
    """A finished fit, from which the centers of its bodies are reported."""

    picture: BodyPicture
    cutout: Cutout
    fit: SceneFit
    method: str
    solved: BoolArray  # (n,) bodies whose range was solved for
    covariance_px2: FloatArray  # (2 n, 2 n)

    def center(self, index: int, found: DetectedBody) -> BodyCenter:
        """Return the center of one body."""
        fit, name, row = self.fit, self.fit.state.names[index], self.fit.state.bodies[index]
        if not row[SCALE] > 0.0 or not np.isfinite(row[:2]).all():
            return BodyCenter.without_center(
                name, self.method, "not_detected", "the fit found no light of it at its place"
            )
        part, first = slice(2 * index, 2 * index + 2), COUNT * index
        solved = bool(self.solved[index])
        sigma = np.sqrt(np.diag(fit.covariance))
        size_sigma = float(sigma[first + SIZE]) if solved else np.nan
        range_km = self.picture.model(name).target.range_km * float(np.exp(-row[SIZE])) if solved else np.nan
        diameter = fit.rendered[index].diameter_px if solved else np.nan
        evidence = self._evidence(index, found)
        flags, status, messages = evidence.verdict()
        return BodyCenter(
            name=name,
            method=self.method,
            status=status,
            pixel_line=row[:2],
            covariance_px2=self.covariance_px2[part, part],
            flux_dn=evidence.flux_dn,
            snr=evidence.snr,
            diameter_px=diameter,
            messages=messages,
            flags=int(flags),
            noise_covariance_px2=fit.noise_covariance[first : first + 2, first : first + 2],
            chi2_reduced=fit.chi2_reduced,
            diameter_sigma_px=diameter * size_sigma,
            brightness_scale=float(row[SCALE]),
            brightness_scale_sigma=float(sigma[first + SCALE]),
            background_dn=fit.state.level_dn,
            background_sigma_dn=float(sigma[-1]),
            range_km=range_km,
            range_sigma_km=range_km * size_sigma,
            pictures=self._pictures(),
            detail=self._detail(index),
        )

    def _evidence(self, index: int, found: DetectedBody) -> "_Evidence":
        fit, first = self.fit, COUNT * index
        light, row = fit.light[index], fit.state.bodies[index]
        column = fit.columns[first + SCALE]
        strains = slice(first + SIZE, first + LAW)
        flux_dn = fit.rendered[index].flux_e / self.picture.gain_e_per_dn * float(row[SCALE])
        under = (light > 0.01 * light.max(initial=0.0)) & (fit.noise_weight > 0.0)
        power = float(np.sum((fit.noise_weight * (self.cutout.data_dn - fit.state.level_dn) ** 2)[under]))
        left = float(np.sum((fit.noise_weight * fit.residual_dn**2)[under])) - np.count_nonzero(under)
        return _Evidence(
            picture=self.picture,
            found=found,
            center_px=row[:2],
            covariance_px2=self.covariance_px2[2 * index : 2 * index + 2, 2 * index : 2 * index + 2],
            snr=float(row[SCALE] * np.sqrt(np.sum(fit.noise_weight * column**2))),
            occulted=fit.rendered[index].occulted_fraction,
            lost_light=float(1.0 - light.sum() / flux_dn) if flux_dn > 0.0 else 0.0,
            flux_dn=flux_dn,
            bright=light > 0.1 * light.max(initial=0.0),
            use=self.cutout.use & ~fit.hits,
            saturated=self.cutout.saturated,
            hits=fit.hits,
            explained=float(np.clip(1.0 - left / max(power, 1e-300), 0.0, 1.0)),
            absorbed=fit.absorbed,
            size=float(row[SIZE]),
            size_solved=bool(self.solved[index]),
            size_sigma=float(np.sqrt(fit.covariance[first + SIZE, first + SIZE])),
            beyond_prior=float(np.abs(fit.state.vector / fit.prior_sigma)[strains].max()),
            converged=fit.converged,
        )

    def _pictures(self) -> BodyResiduals:
        residual = np.where(self.cutout.use, self.fit.residual_dn, 0.0)
        model = self.cutout.data_dn - self.fit.residual_dn
        return BodyResiduals(
            self.cutout.window, self.cutout.data_dn, model, residual, self.fit.noise_weight > 0.0
        )

    def _detail(self, index: int) -> ModelFit:
        fit, pattern, first = self.fit, self.fit.pattern, COUNT * index
        names = [f"{name} {parameter}" for name in fit.state.names for parameter in PARAMETERS]
        return ModelFit(
            parameters=(*names, "psf", "level"),
            values=fit.state.vector,
            covariance=fit.covariance,
            iterations=tuple((float(step[first]), float(step[first + 1])) for step in fit.steps),
            residual_sigma=fit.residual_dn * np.sqrt(fit.noise_weight),
            hits=fit.hits,
            pattern_sigma=0.0 if pattern is None else pattern.contrast,
            pattern_length_px=0.0 if pattern is None else float(np.sqrt(pattern.area_px2 / (2.0 * np.pi))),
        )


# ---- Verdict over a body's center: flags, status, and what the analyst must know.


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """What a fit tells of one body."""

    picture: BodyPicture
    found: DetectedBody
    center_px: FloatArray
    covariance_px2: FloatArray
    snr: float
    occulted: float  # share of its light that others hide
    lost_light: float  # share that falls off the window
    flux_dn: float
    bright: BoolArray  # (n_line, n_pixel) pixels that show the body
    use: BoolArray
    saturated: BoolArray
    hits: BoolArray
    explained: float  # share of the data's power under the body
    absorbed: float
    size: float  # logarithm of its image's size over the model's
    size_solved: bool
    size_sigma: float
    beyond_prior: float  # sigmas by which size or strains leave what was known
    converged: bool

    def verdict(self) -> tuple[BodyFlag, str, tuple[str, ...]]:
        """Return flags, status and messages."""
        expected, picture = self.found.expectation, self.picture
        saturated, hit = int((self.bright & self.saturated).sum()), int((self.bright & self.hits).sum())
        bad = int((self.bright & ~self.use & ~self.saturated).sum())
        error = np.linalg.eigvalsh(self.covariance_px2)
        detector = np.array([picture.camera.n_pixel, picture.camera.n_line])
        reach = np.abs(self.center_px - 0.5 * (detector - 1)) + expected.radius_px
        away = float(np.hypot(*(self.center_px - expected.center_px)))
        sizes = () if self.size_solved else self._size_words()
        weak = error[1] > WEAK_SIGMA_PX**2 and error[1] > WEAK_RATIO**2 * max(error[0], 0.0)
        # what is said of each, where it holds
        notes = {
            BodyFlag.CUT_BY_EDGE: (
                np.any(reach > 0.5 * detector),
                f"{100 * self.lost_light:.0f} % of its light",
            ),
            BodyFlag.OVEREXPOSED: (saturated, f"{saturated} px"),
            BodyFlag.OCCULTED: (self.occulted > 0.0, f"{100 * self.occulted:.0f} % of its light"),
            BodyFlag.THIN_CRESCENT: (self._thin(), ""),
            BodyFlag.CIRCLE_MISFIT: (sizes, "; ".join(sizes)),
            BodyFlag.POOR_FIT: (
                self._poor(),
                f"the model explains {100 * self.explained:.0f} % of the light",
            ),
            BodyFlag.AT_LIMIT: (away > expected.search_px + 1.0, ""),
            BodyFlag.WEAK_GEOMETRY: (weak, ""),
            BodyFlag.BAD_PIXELS: (bad, f"{bad} px"),
            BodyFlag.HIT: (hit, f"{hit} px"),
            BodyFlag.NOT_CONVERGED: (not self.converged, ""),
        }
        flags = flags_where({flag: condition for flag, (condition, _) in notes.items()})
        messages = flag_messages(flags, {flag: note for flag, (_, note) in notes.items()})
        if self.snr < CERTAIN_SNR:
            messages.append(f"SNR {self.snr:.1f} is below {CERTAIN_SNR:g}")
        count = max(int(self.bright.sum()), 1)
        doubtful = (
            flags & DOUBTFUL_FLAGS
            or self.snr < CERTAIN_SNR
            or self.lost_light > LOST_LIGHT
            or saturated > SATURATED_PART * count
            or bad > BAD_PART * count
        )
        return flags, "uncertain" if doubtful else "ok", tuple(messages)

    def _poor(self) -> bool:
        beyond = self.beyond_prior > PRIOR_SIGMAS and not self.size_solved
        unseen = self.absorbed > ABSORBED and np.trace(self.covariance_px2) > WEAK_SIGMA_PX**2
        return bool(self.explained < POORLY_EXPLAINED or unseen or beyond)

    def _thin(self) -> bool:
        """Tell whether the lit crescent is less than a pixel wide."""
        expected = self.found.expectation
        phase = self.picture.phase_rad(expected.name)
        return bool(phase > THIN_PHASE_RAD and expected.radius_px * (1.0 + np.cos(phase)) < THIN_PX)

    def _size_words(self) -> tuple[str, ...]:
        """Say what speaks against the predicted size: the image, or an analyst's circle."""
        expected = self.found.expectation
        known = SIZE_SIGMAS * self.picture.model(expected.name).figure.size_sigma
        certain = abs(self.size) > max(PRIOR_SIGMAS * self.size_sigma, known)
        ratio = float(np.exp(self.size)) if certain else 1.0
        circle = expected.circle_ratio
        remedy = "check its range and radii, or solve for its range"
        diameter = self.picture.diameter_px(expected.name)
        return tuple(size_messages(ratio, circle, diameter, "it is about", remedy))
