"""How the flown attitude differs from the predicted one: bias, drift and jitter.

Bias and drift move the boresight's sky over the detector and add to the twist, as `delta_pixel`, `delta_line` and
`delta_twist` of a solved pointing count them. Jitter is a sum of sines about the camera's own axes; a power spectral
density becomes sines of random phase (Shinozuka & Deodatis 1991, doi:10.1115/1.3119501), so that exposures smear.

Attitudes stand close enough for the jitter inside `jitter_windows` only, so that files stay small.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.constants import HOUR_S
from opnav_workbench.geometry.aiming import aim, turn_about_boresight, turn_across
from opnav_workbench.geometry.rotations import pointing_angle_arrays, unit_from_radec
from opnav_workbench.kernels.making.attitude_history import (
    MOST_NODES,
    AttitudeHistory,
    even_epochs,
    rates_of,
    refined_epochs,
)
from opnav_workbench.kernels.making.scenario import AttitudeError, JitterLine, JitterSpectrum, Scenario
from opnav_workbench.kernels.time import et_from_utc_datetime

__all__ = ["flown_attitudes", "jitter_of"]

DRIFT_TOLERANCE_RAD = 1e-9  # of even turns between attitudes, as for the plan
AXES = ("pixel", "line", "twist")
# Many sines together seldom exceed four times their rms; a few never exceed the sum of their amplitudes.
PEAK_SIGMAS = 4.0
FADE_STEPS = 20  # attitudes while jitter swells or dies
SHORTEST_STEP_S = 1e-5  # a hundred times what et resolves
CLOSEST = 1e-3  # of a step: epochs nearer than this to another one say nothing new
BLOCK = 4096  # epochs at a time: with thousands of sines a larger table would fill the memory


@dataclass(frozen=True, slots=True, eq=False)
class Jitter:
    """Sines ``amplitude * cos(2 pi frequency (et - start) + phase)``, each about one of three axes.

    Attributes
    ----------
    amplitudes_rad : (n, 3) array
        Along pixel, along line, twist; one of the three is not zero.
    frequencies_hz, phases_rad : (n,) array
    start
        et from which the phases count.
    spans : (k, 2) array
        Begin and end in et; outside there is none.
    fade_s
        Time within which it swells before a span, and dies after it.
    """

    amplitudes_rad: FloatArray
    frequencies_hz: FloatArray
    phases_rad: FloatArray
    start: float
    spans: FloatArray
    fade_s: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def angles_at(self, et: FloatArray) -> FloatArray:
        """Return the angles (n, 3) at epochs (n,): along pixel, along line, twist; rad."""
        parts = [self._block(et[i : i + BLOCK]) for i in range(0, len(et), BLOCK)]
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    def _block(self, et: FloatArray) -> FloatArray:
        cycles = np.outer(et - self.start, self.frequencies_hz)
        phases = 2.0 * np.pi * (cycles - np.floor(cycles)) + self.phases_rad
        return np.asarray(self._share(et)[:, None] * (np.cos(phases) @ self.amplitudes_rad))

    def _share(self, et: FloatArray) -> FloatArray:
        """Return the part (n,) of the jitter that is there: 1 inside the spans, 0 away from them."""
        outside = np.maximum(self.spans[:, 0] - et[:, None], et[:, None] - self.spans[:, 1])
        away = np.clip(outside.min(axis=1, initial=np.inf) / max(self.fade_s, 1e-9), 0.0, 1.0)
        return np.asarray(0.5 * (1.0 + np.cos(np.pi * away)))

    @property
    def is_present(self) -> bool:
        """Whether there is any."""
        return len(self.frequencies_hz) > 0

    def step_s(self, tolerance_rad: float) -> float:
        """Return the step between attitudes at which even turns follow within the tolerance."""
        swing = self.amplitudes_rad.max(axis=1, initial=0.0) * (2.0 * np.pi * self.frequencies_hz) ** 2
        peak = min(float(swing.sum()), PEAK_SIGMAS * math.sqrt(0.5 * float(swing @ swing)))
        return math.sqrt(8.0 * tolerance_rad / peak) if peak > 0.0 else math.inf


def jitter_of(error: AttitudeError, pixel_scale_rad: float, start: float, spans: FloatArray) -> Jitter:
    """Return the jitter of an attitude error as sines, the random phases drawn from its seed.

    Parameters
    ----------
    pixel_scale_rad
        Angle of a pixel.
    start
        et from which phases count.
    spans : (k, 2) array
        et between which there is jitter.

    Examples
    --------
    >>> error = AttitudeError(jitter=[{"axis": "line", "frequency_hz": 2.0, "amplitude_urad": 5.0, "phase_deg": 0}])
    >>> jitter = jitter_of(error, 5e-6, 0.0, np.array([[0.0, 10.0]]))
    >>> (jitter.angles_at(np.array([1.0, 1.25])) * 1e6).round(9).tolist()
    [[0.0, 5.0, 0.0], [0.0, -5.0, 0.0]]
    """
    lines = [_sine(line, i, error.seed, pixel_scale_rad) for i, line in enumerate(error.jitter)]
    spectra = [_sines(s, i, error.seed, pixel_scale_rad) for i, s in enumerate(error.spectra)]
    rows = np.concatenate([np.empty((0, 5)), *lines, *spectra])
    return Jitter(rows[:, 2:], rows[:, 0], rows[:, 1], start, np.reshape(spans, (-1, 2)), error.fade_s)


def _random(seed: int, effect: str, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, number, *effect.encode()])


def _sine(line: JitterLine, number: int, seed: int, pixel_scale_rad: float) -> FloatArray:
    """Return one row: frequency, phase, amplitudes (3)."""
    drawn = _random(seed, "jitter line", number).uniform(0.0, 2.0 * np.pi)
    phase = drawn if line.phase_deg is None else math.radians(line.phase_deg)
    amplitudes = line.amplitude_rad(pixel_scale_rad) * np.eye(3)[AXES.index(line.axis)]
    return np.array([[line.frequency_hz, phase, *amplitudes]])


def _sines(spectrum: JitterSpectrum, number: int, seed: int, pixel_scale_rad: float) -> FloatArray:
    """Return rows of frequency, phase and amplitudes (3): one sine for each of `terms` bands.

    Bands are even in the logarithm of the frequency; the sine of a band has its power, and stands somewhere in it,
    so that no two frequencies are multiples of a third and the whole does not repeat.
    """
    random = _random(seed, "jitter spectrum", number)
    frequency, density = np.array(spectrum.psd).T
    edges = np.geomspace(frequency[0], frequency[-1], spectrum.terms + 1)
    power = np.array([band_power(frequency, density, a, b) for a, b in pairwise(edges.tolist())])
    if spectrum.rms is not None:
        power = power * spectrum.rms**2 / power.sum()
    where = edges[:-1] * (edges[1:] / edges[:-1]) ** random.uniform(size=spectrum.terms)
    phase = random.uniform(0.0, 2.0 * np.pi, spectrum.terms)
    amplitude = np.sqrt(2.0 * power) * spectrum.unit_rad(pixel_scale_rad)
    axis = np.eye(3)[AXES.index(spectrum.axis)]
    return np.column_stack([where, phase, amplitude[:, None] * axis])


def band_power(frequency_hz: FloatArray, density: FloatArray, low_hz: float, high_hz: float) -> float:
    """Return the power between two frequencies of a density that is a power law between the table's rows.

    Examples
    --------
    >>> round(band_power(np.array([1.0, 100.0]), np.array([1.0, 1e-4]), 1.0, 10.0), 9)  # 1 / f^2
    0.9
    """
    inside = frequency_hz[(frequency_hz > low_hz) & (frequency_hz < high_hz)]
    f = np.concatenate([[low_hz], inside, [high_hz]])
    s = np.exp(np.interp(np.log(f), np.log(frequency_hz), np.log(density)))
    ratio = np.log(f[1:] / f[:-1])
    slope = np.log(s[1:] / s[:-1]) / ratio + 1.0
    # Integral of s f^(slope - 1): (exp(slope * ratio) - 1) / slope, which is the ratio itself at slope 0.
    steep = np.where(np.abs(slope) > 1e-9, slope, 1.0)
    growth = np.where(np.abs(slope) > 1e-9, np.expm1(slope * ratio) / steep, ratio)
    return float(np.sum(s[:-1] * f[:-1] * growth))


def flown_attitudes(history: AttitudeHistory, error: AttitudeError, scenario: Scenario) -> AttitudeHistory:
    """Return the attitudes as flown: predicted ones with bias, drift and jitter.

    Raises
    ------
    ValueError
        The jitter needs more attitudes than a file should hold; or the boresight is so near a celestial pole
        that the shifted sky cannot be had with that twist.
    """
    camera, start = scenario.pointed_instrument, et_from_utc_datetime(scenario.span.start)
    jitter = jitter_of(error, camera.pixel_scale_rad, start, _spans(error, history))
    tolerance = error.jitter_tolerance_px * camera.pixel_scale_rad

    def biased(times: FloatArray) -> FloatArray:
        return _biased(times, history.attitudes_at(times), error, scenario, start)

    def turn(times: FloatArray) -> FloatArray:
        return (
            _shaken(times, jitter, scenario)
            @ biased(times)
            @ np.swapaxes(history.attitudes_at(times), -1, -2)
        )

    own = [history.et[a : b + 1] for a, b in history.intervals()]
    if error.drifts:
        own = [refined_epochs(biased, nodes, DRIFT_TOLERANCE_RAD) for nodes in own]
    pieces = [_with_jitter(nodes, jitter, tolerance) for nodes in own]
    et, starts = np.concatenate(pieces), np.cumsum([0, *(len(p) for p in pieces[:-1])])
    predicted = history.attitudes_at(et)
    # The turn's own rate stands in camera axes; the predicted rate is known already.
    slopes = np.concatenate([rates_of(turn, times) for times in pieces])
    rates = history.rates_at(et) + np.einsum("nji,nj->ni", predicted, slopes)
    return AttitudeHistory(et, turn(et) @ predicted, rates, starts)


def _biased(
    et: FloatArray, attitudes: FloatArray, error: AttitudeError, scenario: Scenario, start: float
) -> FloatArray:
    """Return attitudes (n, 3, 3) with bias and drift, in the sense of a solved pointing."""
    camera, hours = scenario.pointed_instrument, (et - start) / HOUR_S
    ra, dec, twist = pointing_angle_arrays(attitudes, camera.focal_from_camera)
    shift_px = np.array(error.shift_px) + hours[:, None] * np.array(error.drift_px_h)
    more_twist = np.radians(error.twist_deg + error.drift_twist_deg_h * hours)
    offset = shift_px * camera.pixel_scale_rad
    return aim(unit_from_radec(ra, dec), twist + more_twist, camera.focal_from_camera, offset)


def _shaken(et: FloatArray, jitter: Jitter, scenario: Scenario) -> FloatArray:
    """Return the jitter's turns (n, 3, 3) of the camera about its own axes."""
    focal, angles = scenario.pointed_instrument.focal_from_camera, jitter.angles_at(et)
    return turn_about_boresight(angles[:, 2], focal) @ turn_across(angles[:, :2], focal)


def _spans(error: AttitudeError, history: AttitudeHistory) -> FloatArray:
    """Return when there is jitter: the spans given, or all the time."""
    if error.jitter_windows:
        return np.array(
            [[et_from_utc_datetime(w.start), et_from_utc_datetime(w.end)] for w in error.jitter_windows]
        )
    return np.array([[history.et[a], history.et[b]] for a, b in history.intervals()])


def _with_jitter(own: FloatArray, jitter: Jitter, tolerance_rad: float) -> FloatArray:
    """Return the epochs of one interval, and those that the jitter needs between them."""
    if not jitter.is_present:
        return own
    step = min(jitter.step_s(tolerance_rad), jitter.fade_s / FADE_STEPS)
    spans = np.clip(jitter.spans + np.array([-jitter.fade_s, jitter.fade_s]), own[0], own[-1])
    spans = spans[spans[:, 1] > spans[:, 0]]
    _refuse(float(np.sum(spans[:, 1] - spans[:, 0])) / step, step)
    extra = [even_epochs(a, b, step) for a, b in spans.tolist()]
    return _merged(own, np.concatenate([np.empty(0), *extra]), CLOSEST * step)


def _merged(own: FloatArray, extra: FloatArray, closest_s: float) -> FloatArray:
    """Return both in order, without extra epochs that all but coincide with own ones."""
    right = np.clip(np.searchsorted(own, extra), 1, len(own) - 1)
    apart = np.minimum(np.abs(extra - own[right - 1]), np.abs(own[right] - extra))
    return np.sort(np.concatenate([own, extra[apart > closest_s]]))


def _refuse(count: float, step_s: float) -> None:
    if count > MOST_NODES or step_s < SHORTEST_STEP_S:
        raise ValueError(
            f"the jitter needs {count:.3g} attitudes {step_s:.3g} s apart; give jitter_windows around the exposures, or "
            "a larger jitter_tolerance_px"
        )
