"""The light that a planned picture is expected to have: scene, background, and the variance of every pixel.

Flow   `PictureInputs` -> stars and bodies as a simulated picture draws them -> detector without noise -> variances
Units  electrons, DN
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.psf import Psf
from opnav_workbench.psf.trailed import TrailedPsf
from opnav_workbench.simulation import PictureInputs, SimulatedPicture, expose, expose_picture
from opnav_workbench.simulation.detector_properties import DetectorValues, detector_values
from opnav_workbench.stars import NoiseModel

__all__ = ["ExpectedLight", "expected_light", "star_psf"]

# Chance has no place in what is expected.
RANDOM_EFFECTS = ("read_noise", "cosmic_rays", "lost_data", "bad_pixels")


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedLight:
    """What a picture is expected to be; arrays are (n_line, n_pixel).

    Attributes
    ----------
    picture
        Exposed without noise.
    without_stars_e
        Mean electrons of bodies, sky, stray light and frame transfer.
    values
        Numbers of the detector.
    """

    picture: SimulatedPicture
    without_stars_e: FloatArray
    values: DetectorValues

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def inputs(self) -> PictureInputs:
        """What the picture is made of."""
        return self.picture.inputs

    @property
    def expected_e(self) -> FloatArray:
        """Mean photo-electrons, all light."""
        return self.picture.exposure.expected_electrons

    @property
    def dark_e(self) -> float:
        """Mean thermal electrons of a pixel."""
        return self.values.dark_e(self.inputs.exposure_s)

    @property
    def noise_model(self) -> NoiseModel:
        """Read noise and gain."""
        return NoiseModel(self.values.read_noise_dn, self.values.gain_e_per_dn)

    @property
    def saturated(self) -> BoolArray:
        """Pixels that even without noise stand at the end of the converter, the full well or the camera's range."""
        level = self.inputs.camera.saturation_dn
        exposure = self.picture.exposure
        if level is None:
            return exposure.saturated
        bias = self.values.bias_dn if exposure.level == "raw" else 0.0
        return np.asarray(exposure.saturated | (exposure.image_dn - bias >= level))

    def variance_dn2(self, electrons: FloatArray) -> FloatArray:
        """Return the variance of pixels with these mean photo-electrons."""
        gain = self.values.gain_e_per_dn
        shot = np.maximum(electrons, 0.0) + self.dark_e if self.inputs.effects.shot_noise else 0.0 * electrons
        return np.asarray(self.values.read_noise_dn**2 + shot / gain**2)


def expected_light(inputs: PictureInputs) -> ExpectedLight:
    """Return the expected light of a picture.

    Raises
    ------
    CameraError
        The camera does not know a number that is needed.
    """
    quiet = inputs.effects.model_copy(update={"shot_noise": False, **dict.fromkeys(RANDOM_EFFECTS)})
    picture = expose_picture(replace(inputs, effects=quiet))
    rest = expose(
        picture.rendering.electrons, inputs.camera, quiet, exposure_s=inputs.exposure_s, seed=inputs.seed
    )
    values = detector_values(inputs.camera, inputs.effects, inputs.exposure_s, inputs.level)
    return ExpectedLight(replace(picture, inputs=inputs), rest.expected_electrons, values)


def star_psf(inputs: PictureInputs, ratio: float = 1.0) -> Psf:
    """Return what a star looks like in this picture: the PSF, drawn out where the camera moves.

    A steady motion goes `ratio` times as far in an exposure that is longer by so much.
    """
    if inputs.path.is_still:
        return inputs.psf
    offsets = ratio * inputs.path.offsets_px(inputs.camera)
    trailed = TrailedPsf(inputs.psf, offsets - inputs.path.weights @ offsets, inputs.path.weights)
    return trailed.tabulated()
