"""When a body that comes nearer is first detected: in a single picture, and in a stack of several.

Flow   magnitude of the target over time -> flux -> signal-to-noise ratio of a point (Cramer-Rao, mean over sub-pixel
       phases) -> first time above the threshold

N stacked pictures hold N times the information, so that the stack's ratio is sqrt(N) times the single picture's.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, OpNavError
from opnav_workbench.geometry import angle_between
from opnav_workbench.kernels import et_from_utc, utc_from_et
from opnav_workbench.planning.bodies import v_magnitude
from opnav_workbench.planning.opened_sequence import OpenedSequence
from opnav_workbench.planning.sequence import ApproachSearch, PlannedPicture
from opnav_workbench.planning.stars import star_bounds
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel, render_bodies
from opnav_workbench.simulation.detector_properties import DetectorValues, detector_values
from opnav_workbench.simulation.surfaces import Surface, surface_of
from opnav_workbench.stars import NoiseModel, default_box_px, flux_at_snr

__all__ = ["Approach", "Detection", "search_approach"]

EPOCHS = 121  # over the search: light curves of an approach are smooth
PHASES = 4  # sub-pixel phases along each axis
PRECISION_S = 1.0  # of an epoch
LEAST_DN = 1e-9  # of a body that shows no light


@dataclass(frozen=True, slots=True)
class Detection:
    """The first time that a number of stacked pictures shows the target.

    Attributes
    ----------
    utc
        Empty where it is not within the search.
    mag, range_km, phase_deg, elongation_deg
        Of the target then; nan where it is not within the search.
    limiting_mag
        V of a body of the target's color that has the threshold's SNR (at the search's end where light is scattered).
    words
        The same for people.
    """

    stack: int
    utc: str
    mag: float
    range_km: float
    phase_deg: float
    elongation_deg: float
    limiting_mag: float
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """A search: curves over time, and the detections.

    Attributes
    ----------
    et : (n,) array
    mag, snr, diameter_px, range_km, phase_deg, elongation_deg : (n,) arrays
        V; SNR of a single picture; of the target as the spacecraft sees it.
    keep_out : (n,) array of bool
        The Sun forbids it.
    detections
        Of the single picture and of the stack.
    problem
        Why there is no answer; empty otherwise.
    """

    search: ApproachSearch
    et: FloatArray
    mag: FloatArray
    snr: FloatArray
    diameter_px: FloatArray
    range_km: FloatArray
    phase_deg: FloatArray
    elongation_deg: FloatArray
    keep_out: BoolArray
    detections: tuple[Detection, ...]
    problem: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class _SearchGeometry:
    """What does not change over a search: camera, detector and the target's surface."""

    opened: OpenedSequence
    search: ApproachSearch
    camera: Camera
    surface: Surface
    values: DetectorValues
    psf: Psf

    def body(self, et: float) -> BodyModel:
        target = self.opened.target(self.search.target, et)
        return self.surface.model(target, self.opened.mission, self.camera, self.search.exposure_s)

    def conditions(self, et: float) -> tuple[float, ...]:
        """Flux (DN), noise (DN), V, range, phase, elongation, diameter."""
        model = self.body(et)
        target = model.target
        elongation = self.opened.elongation_deg(target.direction, et)
        sun = target.sun_position_km
        phase = np.nan if sun is None else float(np.degrees(angle_between(sun, -target.position_km)))
        radius = 0.0 if target.radii_km is None else float(np.cbrt(np.prod(target.radii_km)))
        flux = self.flux_dn(model)
        mag = (
            v_magnitude(self.camera, flux, self.search.exposure_s)
            if target.magnitude is None
            else target.magnitude
        )
        diameter = 2.0 * radius / target.range_km / self.camera.pixel_scale_rad
        return (
            flux,
            self.noise_dn(elongation),
            mag,
            target.range_km,
            phase,
            elongation,
            diameter,
        )

    def flux_dn(self, model: BodyModel) -> float:
        if model.flux_e is not None:
            return model.flux_e / self.values.gain_e_per_dn
        # From albedo and sunlight: the renderer integrates the disk, wherever the camera looks.
        drawn = render_bodies(
            [model],
            self.camera,
            self.opened.attitude(self.planned_picture, self.camera, self.opened.et(self.planned_picture)),
            np.zeros(3),
            psf=self.psf,
            sunlight_e=self.camera.sunlight_e(self.search.exposure_s),
            window=(0, 0, 1, 1),
        )
        return drawn.bodies[0].flux_e / self.values.gain_e_per_dn

    @property
    def planned_picture(self) -> PlannedPicture:
        return PlannedPicture.model_validate(
            {
                "name": self.search.name,
                "utc": self.search.start,
                "camera": self.search.camera,
                "exposure_s": self.search.exposure_s,
                "pointing": {"track": [self.search.target]},
            }
        )

    def noise_dn(self, elongation_deg: float) -> float:
        """Noise of a pixel of sky."""
        effects, t, gain = self.opened.sequence.detector, self.search.exposure_s, self.values.gain_e_per_dn
        stray = self.opened.stray_light_dn_s(elongation_deg) * gain * t if self.search.stray_light else 0.0
        sky = 0.0 if effects.sky is None else effects.sky.rate_e_s * t + effects.sky.level_dn * gain
        dark = self.values.dark_e(t)
        return float(np.sqrt(self.values.read_noise_dn**2 + (sky + stray + dark) / gain**2))

    def snr(self, flux_dn: FloatArray, noise_dn: FloatArray) -> FloatArray:
        """SNR (n,) of points of these fluxes over these noises, in the mean over sub-pixel phases."""
        line, pixel = np.indices((PHASES, PHASES)).reshape(2, -1)
        phases = (
            (np.column_stack([pixel, line]) + 0.5) / PHASES - 0.5 + np.rint(self.camera.center_pixel_line)
        )
        count = len(flux_dn)
        places, flux, noise = (
            np.tile(phases, (count, 1)),
            *(np.repeat(a, len(phases)) for a in (flux_dn, noise_dn)),
        )
        model = NoiseModel(self.values.read_noise_dn, self.values.gain_e_per_dn)
        _, snr = star_bounds(places, flux, noise, self.psf, model)
        return np.asarray(snr.reshape(count, -1).mean(axis=1))

    def needed_flux_dn(self, snr: float, noise_dn: float) -> float:
        """Flux that has this SNR."""
        box = default_box_px(float(self.psf.sigma_px.max()))
        model = NoiseModel(self.values.read_noise_dn, self.values.gain_e_per_dn)
        return flux_at_snr(snr, self.psf, noise_dn, box_px=box, noise_model=model)


def search_approach(opened: OpenedSequence, search: ApproachSearch) -> Approach:
    """Search the time span for the first detection.

    A target, camera or time that cannot be had is told in `Approach.problem`.
    """
    et = np.linspace(et_from_utc(search.start.isoformat()), et_from_utc(search.stop.isoformat()), EPOCHS)
    try:
        geometry = _search_geometry(opened, search)
        rows = np.array([geometry.conditions(float(t)) for t in et])
    except OpNavError as error:
        empty = np.zeros(0)
        return Approach(
            search, empty, empty, empty, empty, empty, empty, empty, empty.astype(bool), (), str(error)
        )
    flux, noise, mag, range_km, phase, elongation, diameter = rows.T
    keep_out = elongation < opened.sequence.sun.keep_out_deg
    stacks = dict.fromkeys((1, search.stack))
    snr = geometry.snr(np.maximum(flux, LEAST_DN), noise)
    detections = tuple(_detection(geometry, n, et, rows, snr) for n in stacks)
    return Approach(search, et, mag, snr, diameter, range_km, phase, elongation, keep_out, detections)


def _search_geometry(opened: OpenedSequence, search: ApproachSearch) -> _SearchGeometry:
    camera = opened.mission.camera_named(search.camera)
    camera.require_photometry()
    fault = camera.exposure_fault(search.exposure_s)
    if fault:
        raise CameraError(f"exposure of {fault}.")
    scenario = opened.opened_scenario.scenario
    surface = surface_of(scenario.body(search.target), scenario, ("search",))
    values = detector_values(camera, opened.sequence.detector, search.exposure_s)
    psf = camera.psf_model.at(camera.center_pixel_line)
    return _SearchGeometry(opened, search, camera, surface, values, psf)


def _detection(
    geometry: _SearchGeometry, stack: int, et: FloatArray, rows: FloatArray, snr: FloatArray
) -> Detection:
    """Find the first time at which `stack` pictures reach the threshold."""
    search = geometry.search
    single = search.snr / np.sqrt(stack)

    def excess(time: float) -> float:
        flux, noise, *_ = geometry.conditions(time)
        return float(geometry.snr(np.array([flux]), np.array([noise]))[0] / single - 1.0)

    above = np.flatnonzero(snr >= single)
    limit = _limiting_mag(geometry, single, rows[above[0] if above.size else -1])
    what = "a single picture" if stack == 1 else f"{stack} stacked pictures"
    if not above.size:
        words = f"{what}: {search.target} is not detected before {search.stop.isoformat()} (magnitude {limit:.1f} needed)"
        return Detection(stack, "", np.nan, np.nan, np.nan, np.nan, limit, words)
    k = int(above[0])
    epoch = float(et[0]) if k == 0 else brentq(excess, float(et[k - 1]), float(et[k]), xtol=PRECISION_S)
    _, _, mag, range_km, phase, elongation, _ = geometry.conditions(epoch)
    utc = utc_from_et(epoch, 0)
    seen = "detected" if k else "detected already"
    words = (
        f"{what}: {search.target} is {seen} on {utc} at {range_km:.4g} km (V {mag:.1f}, limit {limit:.1f})"
    )
    if k == 0:
        reach = range_km * 10.0 ** (0.2 * (limit - mag))
        words += f", where the search begins; with the same Sun and phase it would be from {reach:.3g} km on"
    if elongation < geometry.opened.sequence.sun.keep_out_deg:
        words += f"; but the Sun is {elongation:.0f}° away, inside the keep-out angle"
    return Detection(stack, utc, mag, range_km, phase, elongation, limit, words)


def _limiting_mag(geometry: _SearchGeometry, snr: float, row: FloatArray) -> float:
    flux, noise, mag = row[:3]
    return float(mag - 2.5 * np.log10(geometry.needed_flux_dn(snr, noise) / flux))
