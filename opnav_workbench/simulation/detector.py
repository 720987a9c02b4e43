"""The detector: from the light that falls on each pixel to data numbers.

Flow    scene + sky + stray light -> flat field -> frame-transfer smear -> photon noise
        -> dark current -> cosmic rays -> full well and blooming -> read noise, bias, gain, converter -> raw DN
        -> bias, dark current, smear and flat field removed -> calibrated DN -> lost data
Frame   arrays are ``[line, pixel]``; columns run along the line axis
Units   electrons, DN, s

Every effect draws from a generator of its own, and the photon noise gives each pixel one deviate whatever its
light, so that switching an effect leaves the random numbers of all others as they were. Data that never reach the
ground are whole lines and square blocks.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.errors import CameraError
from opnav_workbench.simulation.charge import CosmicRayHits, bloom, draw_cosmic_rays, poisson_counts
from opnav_workbench.simulation.detector_properties import (
    DetectorValues,
    FixedPattern,
    Level,
    detector_values,
    fixed_pattern,
)
from opnav_workbench.simulation.effects import DetectorEffects, LostData
from opnav_workbench.simulation.randomness import picture_random

__all__ = ["Exposure", "expose"]


# ---- Data that never reached the ground: whole lines and square blocks.


def draw_lost_data(settings: LostData, shape: tuple[int, int], rng: np.random.Generator) -> BoolArray:
    """Return which pixels (n_line, n_pixel) are lost.

    Examples
    --------
    >>> int(draw_lost_data(LostData(lines=2), (8, 5), np.random.default_rng(0)).sum())
    10
    """
    n_line, n_pixel = shape
    lost = np.zeros(shape, dtype=bool)
    lost[rng.permutation(n_line)[: settings.lines]] = True
    side = settings.block_px
    corners = rng.random((settings.blocks, 2)) * [max(n_line - side, 0) + 1, max(n_pixel - side, 0) + 1]
    for line, pixel in corners.astype(np.int64):
        lost[line : line + side, pixel : pixel + side] = True
    return lost


# ---- The detector: from the light that falls on each pixel to data numbers.

ROUNDING_VARIANCE = PIXEL_VARIANCE_PX2  # DN^2, of a value rounded to a whole number


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """An exposure; arrays are (n_line, n_pixel) and read-only.

    Attributes
    ----------
    image_dn
        What the file holds: raw or calibrated.
    level : {"raw", "calibrated"}
    noiseless_electrons
        The scene's light as it was given: stars and bodies, no detector effect.
    expected_electrons
        Mean of the photo-electrons: with sky, stray light, flat field and smear.
    collected_electrons
        Charge that was read out, after noise, cosmic rays and blooming.
    saturated, lost, defective : bool arrays
        At the end of the converter's range or the full well; lost in telemetry; hot or dead.
    flag_defects
        Whether the quality plane shall show the defective pixels.
    dark_columns_dn : (n_line, k) array
        Raw values of k covered columns beside the picture; k is 0 unless asked for.
    values
        The numbers that were used.
    """

    image_dn: FloatArray
    level: Level
    exposure_s: float
    noiseless_electrons: FloatArray
    expected_electrons: FloatArray
    collected_electrons: FloatArray
    saturated: BoolArray
    lost: BoolArray
    defective: BoolArray
    flag_defects: bool
    dark_columns_dn: FloatArray
    cosmic_rays: CosmicRayHits
    values: DetectorValues

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def error_dn(self) -> FloatArray:
        """One-sigma error of each pixel as a pipeline estimates it: read noise, and shot noise of the picture."""
        bias = self.values.bias_dn if self.level == "raw" else 0.0
        shot = np.maximum(self.image_dn - bias, 0.0) / self.values.gain_e_per_dn
        return np.asarray(np.sqrt(self.values.read_noise_dn**2 + shot))

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the exposure for the truth file."""
        return {
            "level": self.level,
            "exposure_s": self.exposure_s,
            "cosmic_rays": len(self.cosmic_rays),
            "saturated_pixels": int(self.saturated.sum()),
            "lost_pixels": int(self.lost.sum()),
            "defective_pixels": int(self.defective.sum()),
            "values": self.values.as_dict(),
        }


def expose(
    electrons: FloatArray,
    camera: Camera,
    effects: DetectorEffects,
    *,
    exposure_s: float,
    seed: int,
    level: Level = "calibrated",
    dark_columns: int = 0,
) -> Exposure:
    """Expose a detector to light.

    Parameters
    ----------
    electrons : (n_line, n_pixel) array
        Expected photo-electrons of the scene over the whole exposure, at full sensitivity.
    seed
        The same seed gives the same picture, bit for bit.
    level : {"raw", "calibrated"}
        Calibrated: bias, mean dark current, smear and flat field are removed, their noise stays.
    dark_columns
        Covered columns that the raw picture has at its right end.

    Raises
    ------
    CameraError
        Light of another shape or not finite, or a number that is needed and not known.
    """
    light = _checked_light(electrons, camera)
    values = detector_values(camera, effects, exposure_s, level)
    pattern = fixed_pattern(camera, effects, values)
    expected = _expected(light, effects, values, pattern, exposure_s)
    hits = _cosmic_rays(camera, effects, exposure_s + values.transfer_s, seed)
    charge = _charge(expected, effects, values, pattern, exposure_s, seed)
    if len(hits):
        charge = charge + hits.charge(light.shape)
    if values.full_well_e is not None and effects.full_well is not None:
        charge = bloom(charge, values.full_well_e, spill=effects.full_well.blooming)
    raw = _digitised(charge, values, pattern.bias_dn, picture_random(seed, "read_noise"))
    lost = _lost_pixels(light.shape, effects, seed)
    image = raw if level == "raw" else _calibrated(raw, values, pattern, exposure_s)
    return Exposure(
        image_dn=_filled(image, lost, effects, values, level),
        level=level,
        exposure_s=exposure_s,
        noiseless_electrons=light,
        expected_electrons=expected,
        collected_electrons=charge,
        saturated=_saturated(raw, charge, values),
        lost=lost,
        defective=pattern.defective(light.shape),
        flag_defects=effects.bad_pixels is not None and effects.bad_pixels.flagged,
        dark_columns_dn=_dark_columns(camera, values, dark_columns, exposure_s, seed),
        cosmic_rays=hits,
        values=values,
    )


def _checked_light(electrons: FloatArray, camera: Camera) -> FloatArray:
    light = np.array(electrons, dtype=np.float64)
    if light.shape != (camera.n_line, camera.n_pixel):
        raise CameraError(
            f"{camera.name}: light of shape {light.shape} on a detector of {camera.n_line} lines and "
            f"{camera.n_pixel} pixels; render it for this camera."
        )
    if not np.isfinite(light).all():
        raise CameraError(
            f"{camera.name}: {np.sum(~np.isfinite(light))} pixels of light are not finite numbers."
        )
    return light


def _expected(
    light: FloatArray,
    effects: DetectorEffects,
    values: DetectorValues,
    pattern: FixedPattern,
    exposure_s: float,
) -> FloatArray:
    """Return the mean photo-electrons of every pixel."""
    total = np.maximum(light, 0.0)
    if effects.sky is not None:
        total = total + effects.sky.rate_e_s * exposure_s + effects.sky.level_dn * values.gain_e_per_dn
    if effects.stray_light is not None:
        stray = effects.stray_light
        y, x = (np.linspace(-0.5, 0.5, n) for n in light.shape)
        plane = stray.center_e_s + stray.along_pixel_e_s * x + stray.along_line_e_s * y[:, None]
        total = total + np.maximum(plane, 0.0) * exposure_s
    if pattern.response is not None:
        total = total * pattern.response
    return total if values.transfer is None else total + values.transfer.smear(total)


def _charge(
    expected: FloatArray,
    effects: DetectorEffects,
    values: DetectorValues,
    pattern: FixedPattern,
    exposure_s: float,
    seed: int,
) -> FloatArray:
    """Return photo-electrons and thermal electrons, each with its own noise."""
    noisy = effects.shot_noise
    charge = poisson_counts(expected, picture_random(seed, "shot_noise")) if noisy else expected
    if pattern.dark_e_s is None:
        return charge
    thermal = pattern.dark_e_s * (exposure_s + 0.5 * values.transfer_s)
    return charge + (poisson_counts(thermal, picture_random(seed, "dark_current")) if noisy else thermal)


def _cosmic_rays(camera: Camera, effects: DetectorEffects, open_s: float, seed: int) -> CosmicRayHits:
    if effects.cosmic_rays is None:
        return CosmicRayHits.none()
    return draw_cosmic_rays(effects.cosmic_rays, camera, open_s, picture_random(seed, "cosmic_rays"))


def _digitised(
    charge: FloatArray, values: DetectorValues, columns_dn: FloatArray | None, rng: np.random.Generator
) -> FloatArray:
    """Return raw data numbers."""
    raw = charge / values.gain_e_per_dn + values.bias_dn
    if columns_dn is not None:
        raw += columns_dn
    variance = values.read_noise_dn**2 - (ROUNDING_VARIANCE if values.digitised else 0.0)
    if variance > 0.0:
        raw += rng.normal(0.0, np.sqrt(variance), raw.shape)
    if not values.digitised:
        return raw
    # An amplifier without a known offset can give negative numbers; the converter behind a bias cannot.
    floor = 0.0 if values.bias_dn > 0.0 else -np.inf
    return np.asarray(np.clip(np.rint(raw), floor, values.ceiling_dn))


def _saturated(raw: FloatArray, charge: FloatArray, values: DetectorValues) -> BoolArray:
    full = np.zeros(raw.shape, dtype=bool)
    if values.ceiling_dn is not None:
        full |= raw >= values.ceiling_dn
    if values.full_well_e is not None:
        full |= charge >= values.full_well_e
    return full


def _calibrated(
    raw: FloatArray, values: DetectorValues, pattern: FixedPattern, exposure_s: float
) -> FloatArray:
    """Remove what a pipeline knows: bias, mean dark current, smear, flat field."""
    image = raw - values.bias_dn
    if pattern.bias_dn is not None:
        image = image - pattern.bias_dn
    if values.dark_e_s > 0.0:
        image = image - values.dark_e(exposure_s) / values.gain_e_per_dn
    if values.transfer is not None:
        image = values.transfer.remove(image)
    known = pattern.known_response
    return image if known is None else np.divide(image, known, out=np.zeros_like(image), where=known > 0.0)


def _lost_pixels(shape: tuple[int, int], effects: DetectorEffects, seed: int) -> BoolArray:
    if effects.lost_data is None:
        return np.zeros(shape, dtype=bool)
    return draw_lost_data(effects.lost_data, shape, picture_random(seed, "lost_data"))


def _filled(
    image: FloatArray, lost: BoolArray, effects: DetectorEffects, values: DetectorValues, level: Level
) -> FloatArray:
    """Put the fill value where data are lost; calibration takes the bias off it as off any other value."""
    if effects.lost_data is None:
        return image
    fill = effects.lost_data.fill_dn - (0.0 if level == "raw" else values.bias_dn)
    return np.where(lost, fill, image)


def _dark_columns(
    camera: Camera, values: DetectorValues, count: int, exposure_s: float, seed: int
) -> FloatArray:
    """Return covered columns: bias, dark current and read noise."""
    rng = picture_random(seed, "dark_columns")
    thermal = np.full((camera.n_line, count), values.dark_e(exposure_s))
    return _digitised(poisson_counts(thermal, rng), values, None, rng)
