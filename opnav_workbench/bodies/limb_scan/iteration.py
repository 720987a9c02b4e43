"""The iteration of a limb scan: model at the center, scans matched, center moved, until it stays.

Along with the center follow, where the data speak for it beyond doubt: the body's size, how its surface darkens toward the
limb, and the width of the PSF. A limb seen from one side only would turn errors of these into a shift of the body.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.limb_scan.acquisition import Acquisition
from opnav_workbench.bodies.limb_scan.center_solution import (
    CenterStep,
    ErrorSources,
    OffsetErrors,
    offset_errors,
    solve_center,
)
from opnav_workbench.bodies.limb_scan.fan import ScanFan, ScanSampler
from opnav_workbench.bodies.limb_scan.matching import (
    LAW,
    CommonTerms,
    ScanMatch,
    ScanSystem,
    find_roughness,
    no_common_terms,
    solve_common_terms,
)
from opnav_workbench.bodies.limb_scan.selection import ScanSelection, choose_scans, unevenness
from opnav_workbench.bodies.limb_scan.view import (
    CORRELATION_RAD,
    ModelLight,
    ScanProfiles,
    ScanView,
    fan_reach,
    law_share,
    pooled_brightness,
    render_model_light,
    scan_profiles,
    scan_system,
    usable_pixels,
    view_scans,
    with_law_share,
)
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.subarray import Cutout

__all__ = ["FEWEST", "ScanIteration", "ScanSolution", "iterate_center"]

CONVERGED_PX = 0.01
MAX_ROUNDS = 12
SETTLED_PX = 0.3  # a step, or move of the limb, after which choice and roughness stay as they are
# Maps have edges that a Gaussian of their mean roughness does not expect: scans are matched with a rougher albedo, which
# costs little, and errors stated for one that is rougher by so much (over 40 mottled maps, error over sigma is 1.0).
MARGIN, ERROR_MARGIN = 3.0, 1.4
FEWEST = 3
SMALLEST_COMMON_PX = 10.0  # radius of a body whose limb is long enough to tell law and PSF
LAW_CHANGE = 0.03  # share of another scattering law from which on the body is rendered with it
# A share follows another law's darkening but not its shape: of twelve pairs of laws, the centers were off by what 0.1 to 0.6
# of the share that was solved for makes.
LAW_FAMILY = 0.3
LARGEST_LAW_CHANGE = 0.4  # at a time: the change is linear in the share only nearby
PIXELS_SHARED_PX = 2.0  # along the limb, by the interpolation of a scan
STEP_UNEVEN, STEP_BACK = 0.83, 0.6  # shares of a step over an uneven albedo, and of one that turns back
TRUST_ROUNDS = 3  # after which the size is followed as far as it was: else it may go to and fro
LIMB_MOVED_PX = 0.02  # by another size, from which on the body is rendered anew


@dataclass(frozen=True, slots=True, eq=False)
class ScanEvaluation:
    """Everything seen with the model at one center."""

    center: FloatArray
    cutout: Cutout
    body: ModelLight
    sampler: ScanSampler
    view: ScanView
    brightness: FloatArray
    system: ScanSystem
    variance_dn2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def errors(self, match: ScanMatch, roughness: float) -> OffsetErrors:
        """Return the errors of offsets."""
        return offset_errors(match, self.sampler, self.variance_dn2, roughness)


@dataclass(frozen=True, slots=True, eq=False)
class _ScanConditions:
    """What the data tell of the scans, kept once the center has settled."""

    roughness: float
    choice: ScanSelection
    uneven: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ScanIteration:
    """What one round came to.

    Attributes
    ----------
    uneven : (n,) array
    system
        With what is common taken out.
    """

    evaluation: ScanEvaluation
    roughness: float
    choice: ScanSelection
    uneven: FloatArray
    common: CommonTerms
    system: ScanSystem
    match: ScanMatch
    errors: OffsetErrors
    solved: CenterStep


@dataclass(frozen=True, slots=True, eq=False)
class ScanSolution:
    """Where the iteration ended.

    Attributes
    ----------
    last
        None where fewer scans than `FEWEST` were left, or a step left the body.
    steps : tuple of (float, float)
    """

    last: ScanIteration | None
    choice: ScanSelection
    steps: tuple[tuple[float, float], ...]
    converged: bool


def iterate_center(
    picture: BodyPicture,
    name: str,
    captured: Acquisition,
    numbers: NDArray[np.int64] | None,
    *,
    solve_size: bool,
) -> ScanSolution:
    """Move the center until it stays.

    Parameters
    ----------
    numbers : (k,) array of int or None
        Scans chosen by hand.
    """
    fan, profiles = captured.fan, captured.profiles
    center, scale = captured.center_px, captured.range_scale
    radius = float(np.median(fan.limb_px))
    settings, seen, settled, converged = None, None, False, False
    trust = 1.0 if solve_size else None
    steps: list[tuple[float, float]] = []
    for _ in range(MAX_ROUNDS):
        evaluation = _evaluate(picture, name, fan, profiles, center, scale)
        if settings is None or not settled:
            settings = _scan_conditions(picture, fan, evaluation, numbers)
        if settings.choice.chosen.sum() < FEWEST:
            seen = None
            break
        seen = _solve_iteration(picture, name, fan, evaluation, settings, -np.log(scale), trust)
        step = seen.solved.step_px
        turned = bool(steps) and float(step @ np.array(steps[-1])) < 0.0
        steps.append((float(step[0]), float(step[1])))
        center = center + _share_of_step(step, settings.roughness, turned=turned) * step
        grown = float(np.exp(seen.solved.size_trust * seen.solved.size)) * scale - 1.0
        moved = max(float(np.hypot(*step)), radius * abs(grown))
        settled = moved < SETTLED_PX
        if not moved < 2.0 + 0.5 * radius:
            seen = None
            break
        if len(steps) >= TRUST_ROUNDS:
            trust = seen.solved.size_trust
        if radius * abs(grown) > LIMB_MOVED_PX:
            scale /= 1.0 + grown
        changed = _other_law(picture, name, seen.common)
        if changed is not picture:
            picture, settled = changed, False
            profiles = scan_profiles(picture, name, fan, evaluation.center, scale)
        elif moved < CONVERGED_PX + LIMB_MOVED_PX and np.hypot(*step) < CONVERGED_PX:
            converged = True
            break
    assert settings is not None
    return ScanSolution(seen, settings.choice, tuple(steps), converged)


def _other_law(picture: BodyPicture, name: str, common: CommonTerms) -> BodyPicture:
    """Return the picture with the scattering law that the scans ask for; itself if they ask for no other."""
    present = law_share(picture, name)
    share = float(np.clip(common.values[LAW], -LARGEST_LAW_CHANGE, LARGEST_LAW_CHANGE))
    changed = with_law_share(picture, name, present + share)
    return changed if abs(law_share(changed, name) - present) > LAW_CHANGE else picture


def _share_of_step(step: FloatArray, roughness: float, *, turned: bool) -> float:
    """Return how much of a step to take: an uneven albedo seems to shift along with the limb, and steps overshoot."""
    if np.hypot(*step) < CONVERGED_PX or (roughness == 0.0 and not turned):
        return 1.0
    return STEP_BACK if turned else STEP_UNEVEN


def _evaluate(
    picture: BodyPicture, name: str, fan: ScanFan, profiles: ScanProfiles, center: FloatArray, scale: float
) -> ScanEvaluation:
    body = render_model_light(picture, name, center, scale, fan_reach(fan, picture))
    cutout = usable_pixels(picture, name, center, body)
    sampler = ScanSampler(fan.places(center, fan.distances()), body.window)
    view = view_scans(sampler, cutout, body)
    brightness = pooled_brightness(view)
    system = scan_system(fan, view, profiles, cutout.gain_e_per_dn, brightness)
    variance = cutout.noise_dn**2 + np.maximum(cutout.data_dn, 0.0) / cutout.gain_e_per_dn
    return ScanEvaluation(center, cutout, body, sampler, view, brightness, system, variance)


def _scan_conditions(
    picture: BodyPicture, fan: ScanFan, evaluation: ScanEvaluation, numbers: NDArray[np.int64] | None
) -> _ScanConditions:
    """Let the data tell how rough the albedo is, and choose scans."""
    psf_sigma = float(np.max(picture.psf.sigma_px))
    uneven = unevenness(
        fan, evaluation.view, evaluation.brightness, psf_sigma, evaluation.cutout.gain_e_per_dn
    )
    system, roughness = evaluation.system, 0.0
    for _ in range(2):
        chosen = _choice(fan, evaluation, system, roughness, uneven, numbers).chosen
        if not chosen.any():
            break
        roughness = find_roughness(evaluation.system, chosen, _psf_variance(picture))
        system = evaluation.system.without_common(_common(picture, fan, evaluation, roughness, chosen).values)
    return _ScanConditions(roughness, _choice(fan, evaluation, system, roughness, uneven, numbers), uneven)


def _choice(
    fan: ScanFan,
    evaluation: ScanEvaluation,
    system: ScanSystem,
    roughness: float,
    uneven: FloatArray,
    numbers: NDArray[np.int64] | None,
) -> ScanSelection:
    """Choose scans; which of them may speak depends a little on the roughness."""
    match = system.match(MARGIN * roughness)
    sigma = evaluation.errors(match, MARGIN * roughness).sigma_px
    return choose_scans(fan, evaluation.view, sigma, match.motion, uneven, numbers)


def _psf_variance(picture: BodyPicture) -> float:
    return float(np.mean(picture.psf.sigma_px**2))


def _common(
    picture: BodyPicture,
    fan: ScanFan,
    evaluation: ScanEvaluation,
    roughness: float,
    chosen: NDArray[np.bool_],
) -> CommonTerms:
    if float(np.median(fan.limb_px)) < SMALLEST_COMMON_PX:
        return no_common_terms()
    alike = _alike(fan, roughness)
    return solve_common_terms(
        evaluation.system, ERROR_MARGIN * roughness, chosen, _psf_variance(picture), alike
    )


def _alike(fan: ScanFan, roughness: float) -> float:
    """Return how many neighbouring scans see the same pixels or the same albedo: they count as one."""
    spacing = 2.0 * np.pi / len(fan)
    pixels = PIXELS_SHARED_PX / (spacing * float(np.median(fan.limb_px)))
    albedo = np.sqrt(2.0 * np.pi) * CORRELATION_RAD / spacing if roughness > 0.0 else 1.0
    return max(1.0, pixels, float(albedo))


def _solve_iteration(
    picture: BodyPicture,
    name: str,
    fan: ScanFan,
    evaluation: ScanEvaluation,
    settings: _ScanConditions,
    size_in_model: float,
    trust: float | None,
) -> ScanIteration:
    """Match the scans and solve for the center, with what all scans share taken out."""
    roughness, chosen = settings.roughness, settings.choice.chosen
    common = _common(picture, fan, evaluation, roughness, chosen)
    system = evaluation.system.without_common(common.values)
    match = system.match(MARGIN * roughness)
    law = law_share(picture, name) + float(common.values[LAW])
    covariance = common.covariance + np.diag([(LAW_FAMILY * law) ** 2, 0.0])
    sources = ErrorSources(
        evaluation.sampler, evaluation.variance_dn2, ERROR_MARGIN * roughness, fan.angle_rad, covariance
    )
    weight_sigma = evaluation.errors(match, MARGIN * roughness).sigma_px
    solved = solve_center(match, weight_sigma, chosen, fan.limb_px, sources, float(size_in_model), trust)
    errors = evaluation.errors(match, ERROR_MARGIN * roughness)
    return ScanIteration(
        evaluation, roughness, settings.choice, settings.uneven, common, system, match, errors, solved
    )
