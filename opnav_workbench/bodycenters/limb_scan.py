"""Center of a body by scans across its limb, which albedo features on its disk do not move.

Flow   expected place -> coarse search -> scans over a wide range (`scan_capture`) -> rendered model at the center ->
       data and model along each scan -> offset of each (`scan_matching`) -> scans chosen (`scan_choice`) -> center by
       least squares (`scan_center`) -> model at the new center, until that moves by less than 0.01 px

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.cutout import Cutout
from opnav_workbench.bodycenters.expectation import Found, expect, find_place
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.bodycenters.scan_capture import Capture, capture
from opnav_workbench.bodycenters.scan_center import CenterStep, OffsetErrors, offset_errors, solve_center
from opnav_workbench.bodycenters.scan_choice import Choice, check_numbers, choose_scans, unevenness
from opnav_workbench.bodycenters.scan_common import LAW, Common, solve_common
from opnav_workbench.bodycenters.scan_fan import N_SCANS
from opnav_workbench.bodycenters.scan_law import with_law_share
from opnav_workbench.bodycenters.scan_matching import ScanMatch, ScanSystem
from opnav_workbench.bodycenters.scan_profiles import scan_profiles
from opnav_workbench.bodycenters.scan_report import ScanRun, report
from opnav_workbench.bodycenters.scan_sampling import ScanSampler
from opnav_workbench.bodycenters.scan_view import (
    BodyLight,
    ScanView,
    body_light,
    fan_reach,
    pooled_brightness,
    scan_system,
    usable_pixels,
    view_scans,
)
from opnav_workbench.bodycenters.silhouette import Silhouette
from opnav_workbench.errors import CenterfindingError

__all__ = ["METHOD", "find_limb_scan"]

METHOD = "limb_scan"
CONVERGED_PX = 0.01
MAX_ITERATIONS = 8
SETTLED_PX = 0.3  # a step below which choice and roughness stay as they are
ROUGHNESSES = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2)
SPOKEN_FOR = 4.0  # gain in logarithmic likelihood that makes an albedo uneven
# Maps have edges that a Gaussian of their mean roughness does not expect: scans are matched with a rougher albedo, which
# costs little, and errors stated for one that is rougher by so much (over 40 mottled maps, error over sigma is 1.0).
MARGIN, ERROR_MARGIN = 3.0, 1.4
FEWEST = 3
LAW_CHANGE = 0.05  # share of another scattering law from which on the body is rendered with it
MAX_LAW_CHANGES = 3


def find_limb_scan(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    scans: Sequence[int] | None = None,
    n_scans: int = N_SCANS,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure with scans across its limb.

    Brightness and background of every scan are free, and the albedo near the limb is taken for a random function whose
    roughness the data tell; so neither an albedo map nor a wrong scattering law moves the center much.

    Parameters
    ----------
    picture : BodyPicture
    name : str
    circle : Circle, optional
        Where an analyst sees the body.
    scans : sequence of int, optional
        Numbers of the scans to use; scan k leaves the center at ``360 k / n_scans`` degrees from +pixel toward +line.
        None: they are chosen automatically.
    n_scans : int
        How many there are.
    search_radius_px : float, optional
        How far from its prediction (or circle) the body may be.

    Returns
    -------
    BodyCenter
        `detail` is a `LimbScans`: every scan with its offset and the reason why it was used or not. Status ``ok``;
        ``uncertain`` (see its messages); ``not_detected``, ``off_detector``, ``saturated`` or ``failed`` without a
        center. `diameter_px` is measured with the same scans, and does not touch the center.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, has no size, or a scan number does not exist.
    """
    if n_scans < FEWEST:
        raise CenterfindingError(
            f"{n_scans} scans cannot give a center; use {FEWEST} at least, such as {N_SCANS}."
        )
    numbers = None if scans is None else check_numbers(scans, n_scans)
    silhouette = Silhouette(picture, name)
    expected = expect(picture, name, METHOD, circle, search_radius_px)
    if isinstance(expected, BodyCenter):
        return expected
    found = find_place(picture, expected, METHOD, other_sizes=False)
    if isinstance(found, BodyCenter):
        return found
    try:
        captured = capture(picture, silhouette, found.place.center_px, 1.0, n_scans)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, METHOD, "failed", str(error))
    return _iterated(picture, name, found, captured, numbers)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """Everything seen with the model at one center."""

    center: FloatArray
    cutout: Cutout
    body: BodyLight
    sampler: ScanSampler
    view: ScanView
    brightness: FloatArray
    system: ScanSystem
    variance_dn2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Settings:
    """What the data tell of the scans, kept once the center has settled."""

    roughness: float
    choice: Choice
    uneven: FloatArray


def _iterated(
    picture: BodyPicture, name: str, found: Found, captured: Capture, numbers: NDArray[np.int64] | None
) -> BodyCenter:
    center, law_changes = captured.center_px, 0
    settings: _Settings | None = None
    steps: list[tuple[float, float]] = []
    for _ in range(MAX_ITERATIONS):
        look = _look(picture, name, captured, center)
        if settings is None or np.hypot(*steps[-1]) > SETTLED_PX:
            settings = _settings(picture, captured, look, numbers)
        if settings.choice.chosen.sum() < FEWEST:
            return _without(name, settings)
        seen = _seen(picture, captured, look, settings)
        center = center + seen.solved.step_px
        steps.append((float(seen.solved.step_px[0]), float(seen.solved.step_px[1])))
        length = float(np.hypot(*seen.solved.step_px))
        if not length < 2.0 + 0.5 * float(np.median(captured.fan.limb_px)):
            return _without(name, settings)
        share = float(seen.common.values[LAW])
        if abs(share) > LAW_CHANGE and law_changes < MAX_LAW_CHANGES:
            picture, law_changes, settings = with_law_share(picture, name, share), law_changes + 1, None
            profiles = scan_profiles(picture, name, captured.fan, look.center, captured.range_scale)
            captured = replace(captured, profiles=profiles)
        elif length < CONVERGED_PX:
            break
    run = ScanRun(
        picture, found, captured, look.center, look.cutout, look.body, look.view, seen.system, seen.match, seen.errors,
        seen.solved, seen.common, seen.settings.choice, seen.settings.uneven, seen.settings.roughness, tuple(steps),
        converged=bool(np.hypot(*steps[-1]) < CONVERGED_PX), by_hand=numbers is not None,
    )  # fmt: skip
    return report(run, METHOD)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What one iteration came to."""

    settings: _Settings
    common: Common
    system: ScanSystem
    match: ScanMatch
    errors: OffsetErrors
    solved: CenterStep


def _seen(picture: BodyPicture, captured: Capture, look: _Look, settings: _Settings) -> _Seen:
    """Match the scans and solve for the center, with what all scans share taken out."""
    roughness, chosen = settings.roughness, settings.choice.chosen
    common = solve_common(look.system, roughness, chosen, float(np.mean(picture.psf.sigma_px**2)))
    system = look.system.without_common(common.values)
    match = system.match(MARGIN * roughness)
    weighted = offset_errors(match, look.sampler, look.variance_dn2, MARGIN * roughness)
    solved = solve_center(
        match,
        weighted.sigma_px,
        chosen,
        captured.fan.limb_px,
        look.sampler,
        look.variance_dn2,
        ERROR_MARGIN * roughness,
        captured.fan.angle_rad,
        common.covariance,
    )
    errors = offset_errors(match, look.sampler, look.variance_dn2, ERROR_MARGIN * roughness)
    return _Seen(settings, common, system, match, errors, solved)


def _look(picture: BodyPicture, name: str, captured: Capture, center: FloatArray) -> _Look:
    fan = captured.fan
    body = body_light(picture, name, center, captured.range_scale, fan_reach(fan, picture))
    cutout = usable_pixels(picture, name, center, body.window)
    sampler = ScanSampler(fan.places(center, fan.distances()), body.window)
    view = view_scans(sampler, cutout, body)
    brightness = pooled_brightness(view)
    system = scan_system(fan, view, captured.profiles, cutout.gain_e_per_dn, brightness)
    variance = cutout.noise_dn**2 + np.maximum(cutout.data_dn, 0.0) / cutout.gain_e_per_dn
    return _Look(center, cutout, body, sampler, view, brightness, system, variance)


def _settings(
    picture: BodyPicture, captured: Capture, look: _Look, numbers: NDArray[np.int64] | None
) -> _Settings:
    """Let the data tell how rough the albedo is, and choose scans."""
    fan, view = captured.fan, look.view
    sigma_psf = float(np.max(picture.psf.sigma_px))
    uneven = unevenness(fan, view, look.brightness, sigma_psf, look.cutout.gain_e_per_dn)
    system, roughness = look.system, 0.0

    def chosen() -> Choice:  # which scans may speak depends a little on the roughness
        match = system.match(MARGIN * roughness)
        errors = offset_errors(match, look.sampler, look.variance_dn2, MARGIN * roughness)
        return choose_scans(fan, view, errors.sigma_px, match.motion, uneven, numbers)

    for _ in range(2):
        choice = chosen()
        roughness = _roughness(system, choice)
        common = solve_common(look.system, roughness, choice.chosen, sigma_psf**2)
        system = look.system.without_common(common.values)
    roughness = _roughness(system, choice)
    return _Settings(roughness, chosen(), uneven)


def _roughness(system: ScanSystem, choice: Choice) -> float:
    """Return the albedo's relative scatter under which the chosen scans are most likely; 0 if they do not ask for one."""
    if not choice.chosen.any():
        return 0.0
    likelihood = [float(system.likelihood(r)[choice.chosen].sum()) for r in (0.0, *ROUGHNESSES)]
    best = int(np.argmax(likelihood))
    return 0.0 if best == 0 or likelihood[best] < likelihood[0] + SPOKEN_FOR else ROUGHNESSES[best - 1]


def _without(name: str, settings: _Settings) -> BodyCenter:
    reasons, counts = np.unique(settings.choice.reason[~settings.choice.chosen], return_counts=True)
    said = [f"{n} scans: {text}" for n, text in sorted(zip(counts, reasons, strict=True), reverse=True)]
    message = f"{int(settings.choice.chosen.sum())} usable scans do not determine a center"
    return BodyCenter.without_center(name, METHOD, "failed", message, *said[:3])
