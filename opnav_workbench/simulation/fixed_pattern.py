"""What belongs to the camera and is the same in every picture: flat field, hot and dead pixels, bias columns."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.simulation.detector_values import DetectorValues
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.randomness import camera_random

__all__ = ["FixedPattern", "fixed_pattern"]


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """Maps of a detector, all (n_line, n_pixel); None stands for a map that changes nothing.

    Attributes
    ----------
    response : array or None
        Relative sensitivity; 0 in dead pixels.
    known_response : array or None
        The flat field that calibration divides by.
    dark_e_s : array or None
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
    hot = _chosen(camera, "hot_pixels", values.hot_fraction)
    dead = _chosen(camera, "dead_pixels", values.dead_fraction)
    response, known = _flat(camera, effects, values)
    if dead is not None:
        response = np.where(dead, 0.0, np.ones(camera.shape) if response is None else response)
    return FixedPattern(
        response, known, _dark(camera, effects, values, hot), _bias(camera, effects), hot, dead
    )


def _chosen(camera: _Detector, stream: str, fraction: float) -> BoolArray | None:
    if fraction == 0.0:
        return None
    return camera_random(camera.name, stream).random(camera.shape) < fraction


def _flat(
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


def _dark(
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


def _bias(camera: _Detector, effects: DetectorEffects) -> FloatArray | None:
    if effects.bias is None or effects.bias.pattern_dn == 0.0:
        return None
    columns = camera_random(camera.name, "bias_pattern").standard_normal(camera.shape[1])
    return np.asarray(effects.bias.pattern_dn * columns)
