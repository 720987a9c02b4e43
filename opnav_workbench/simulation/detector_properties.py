"""The detector as it is in one exposure: its numbers, and the maps that belong to it.

The numbers are those of the scenario where it gives them, else the camera's. The maps (flat field, hot and dead
pixels, bias columns) are drawn from the camera's name: they are the same in every picture of a camera.
"""

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.simulation.charge import ChargeTransfer
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.randomness import camera_random

__all__ = ["DetectorValues", "FixedPattern", "Level", "detector_values", "fixed_pattern"]


# ---- The numbers that an exposure uses: those of the scenario where it gives them, else the camera's.

Level = Literal["raw", "calibrated"]


@dataclass(frozen=True, slots=True)
class DetectorValues:
    """The numbers of a detector as they act in one exposure; None where there is no such effect.

    Attributes
    ----------
    dark_e_s
        Mean dark current of a pixel.
    digitised
        Whether data numbers are whole numbers.
    ceiling_dn
        Highest raw value.
    transfer_s
        Time of the frame transfer, 0 without.
    """

    gain_e_per_dn: float
    read_noise_dn: float
    bias_dn: float
    dark_e_s: float
    full_well_e: float | None
    digitised: bool
    ceiling_dn: float | None
    transfer: ChargeTransfer | None
    transfer_s: float
    prnu: float
    hot_fraction: float
    dead_fraction: float

    def dark_e(self, exposure_s: float) -> float:
        """Return the mean thermal electrons of a pixel in an exposure and its readout."""
        return self.dark_e_s * (exposure_s + 0.5 * self.transfer_s)

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers by name, for the truth file."""
        return asdict(self)


def detector_values(
    camera: Camera, effects: DetectorEffects, exposure_s: float, level: Level = "calibrated"
) -> DetectorValues:
    """Settle every number of an exposure.

    Raises
    ------
    CameraError
        An effect is on whose number neither the scenario nor the camera knows (what is on by default and unknown
        is left out, but for gain, read noise and, in raw pictures, bias), or an exposure that is not positive.
    """
    if not 0.0 < exposure_s < float("inf"):
        raise CameraError(f"{camera.name}: exposure of {exposure_s} s; give a positive number of seconds.")
    bias = _bias_level_dn(camera, effects, level)
    transfer_s, transfer = _transfer(camera, effects, exposure_s)
    read, dark, well = effects.read_noise, effects.dark_current, effects.full_well
    flat, bad = effects.flat_field, effects.bad_pixels
    return DetectorValues(
        gain_e_per_dn=_given_or_required(effects.gain_e_per_dn, camera, "gain_e_per_dn"),
        read_noise_dn=0.0 if read is None else _given_or_required(read.sigma_dn, camera, "read_noise_dn"),
        bias_dn=bias or 0.0,
        dark_e_s=0.0 if dark is None else _given_or_known(dark.rate_e_s, camera, "dark_current_e_s") or 0.0,
        full_well_e=None if well is None else _given_or_known(well.electrons, camera, "full_well_e"),
        digitised=effects.adc is not None,
        ceiling_dn=_ceiling_dn(camera, effects, bias),
        transfer=transfer,
        transfer_s=transfer_s,
        prnu=0.0 if flat is None else _given_or_known(flat.prnu, camera, "prnu") or 0.0,
        hot_fraction=0.0
        if bad is None
        else _given_or_required(bad.hot_fraction, camera, "hot_pixel_fraction"),
        dead_fraction=0.0
        if bad is None
        else _given_or_required(bad.dead_fraction, camera, "dead_pixel_fraction"),
    )


def _given_or_required(given: float | None, camera: Camera, name: str) -> float:
    return camera.require(name) if given is None else given


def _given_or_known(given: float | None, camera: Camera, name: str) -> float | None:
    return getattr(camera, name) if given is None else given


def _bias_level_dn(camera: Camera, effects: DetectorEffects, level: Level) -> float | None:
    if effects.bias is None:
        return 0.0
    if level == "raw":
        return _given_or_required(effects.bias.level_dn, camera, "bias_dn")
    return _given_or_known(effects.bias.level_dn, camera, "bias_dn")


def _ceiling_dn(camera: Camera, effects: DetectorEffects, bias: float | None) -> float | None:
    """Highest raw value: of the converter; where the bias is not known, also the camera's saturation level."""
    if effects.adc is None:
        return None
    bits = effects.adc.bits or camera.bits
    limits = [] if bits is None else [2.0**bits - 1.0]
    if camera.saturation_dn is not None and bias is None:
        limits.append(camera.saturation_dn)
    return min(limits, default=None)


def _transfer(
    camera: Camera, effects: DetectorEffects, exposure_s: float
) -> tuple[float, ChargeTransfer | None]:
    settings = effects.frame_transfer
    if settings is None:
        return 0.0, None
    transfer_s = _given_or_known(settings.transfer_s, camera, "frame_transfer_s")
    if transfer_s is None:
        return 0.0, None
    scrub_s = transfer_s if settings.scrub_s is None else settings.scrub_s
    first = settings.toward == "first_line"
    return transfer_s, ChargeTransfer.of(transfer_s, scrub_s, exposure_s, toward_first=first)


# ---- What belongs to the camera and is the same in every picture.


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """Maps of a detector, all (n_line, n_pixel); None stands for a map that changes nothing.

    Attributes
    ----------
    response
        Relative sensitivity; 0 in dead pixels.
    known_response
        The flat field that calibration divides by.
    dark_e_s
        Dark current, with the leak of hot pixels.
    bias_dn : (n_pixel,) array or None
        Offset of each column from the bias level.
    hot, dead : bool arrays or None
    """

    response: FloatArray | None
    known_response: FloatArray | None
    dark_e_s: FloatArray | None
    bias_dn: FloatArray | None
    hot: BoolArray | None
    dead: BoolArray | None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def defective(self, shape: tuple[int, int]) -> BoolArray:
        """Return the pixels that are hot or dead."""
        mask = np.zeros(shape, dtype=bool)
        for part in (self.hot, self.dead):
            if part is not None:
                mask |= part
        return mask


def fixed_pattern(camera: Camera, effects: DetectorEffects, values: DetectorValues) -> FixedPattern:
    """Return the camera's maps; equal names of cameras give equal maps."""
    return _pattern(_Detector(camera.name, (camera.n_line, camera.n_pixel)), effects, values)


@dataclass(frozen=True, slots=True)
class _Detector:
    name: str
    shape: tuple[int, int]

    def normal(self, stream: str) -> FloatArray:
        """Return the same standard normal deviates every time."""
        return camera_random(self.name, stream).standard_normal(self.shape)


@lru_cache(maxsize=4)  # a sequence of pictures asks for the same maps again and again
def _pattern(camera: _Detector, effects: DetectorEffects, values: DetectorValues) -> FixedPattern:
    hot = _chosen_pixels(camera, "hot_pixels", values.hot_fraction)
    dead = _chosen_pixels(camera, "dead_pixels", values.dead_fraction)
    response, known = _flat_fields(camera, effects, values)
    if dead is not None:
        response = np.where(dead, 0.0, np.ones(camera.shape) if response is None else response)
    return FixedPattern(
        response,
        known,
        _dark_rate_e_s(camera, effects, values, hot),
        _bias_columns_dn(camera, effects),
        hot,
        dead,
    )


def _chosen_pixels(camera: _Detector, stream: str, fraction: float) -> BoolArray | None:
    if fraction == 0.0:
        return None
    return camera_random(camera.name, stream).random(camera.shape) < fraction


def _flat_fields(
    camera: _Detector, effects: DetectorEffects, values: DetectorValues
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return true and known flat field."""
    settings = effects.flat_field
    if settings is None:
        return None, None
    y, x = (np.linspace(-1.0, 1.0, n) ** 2 for n in camera.shape)
    flat = 1.0 - settings.vignetting * 0.5 * (y[:, None] + x)
    if values.prnu > 0.0:
        flat *= 1.0 + values.prnu * camera.normal("prnu")
    flat = np.maximum(flat, 0.0)
    if settings.error == 0.0:
        return flat, flat
    return flat, flat * np.maximum(1.0 + settings.error * camera.normal("flat_error"), 0.0)


def _dark_rate_e_s(
    camera: _Detector, effects: DetectorEffects, values: DetectorValues, hot: BoolArray | None
) -> FloatArray | None:
    if values.dark_e_s == 0.0 and hot is None:
        return None
    rate = np.full(camera.shape, values.dark_e_s)
    if effects.dark_current is not None and effects.dark_current.nonuniformity > 0.0:
        rate *= np.maximum(1.0 + effects.dark_current.nonuniformity * camera.normal("dark_pattern"), 0.0)
    if hot is not None and effects.bad_pixels is not None:
        leak = camera_random(camera.name, "hot_leak").standard_exponential(camera.shape)
        rate += np.where(hot, effects.bad_pixels.hot_rate_e_s * leak, 0.0)
    return rate


def _bias_columns_dn(camera: _Detector, effects: DetectorEffects) -> FloatArray | None:
    if effects.bias is None or effects.bias.pattern_dn == 0.0:
        return None
    columns = camera_random(camera.name, "bias_pattern").standard_normal(camera.shape[1])
    return np.asarray(effects.bias.pattern_dn * columns)
