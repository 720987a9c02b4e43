"""What stays the same through a session: the picture, its camera, its noise, and where the inputs come from."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera, fit_reseau
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.errors import ImageError
from opnav_workbench.image import (
    Background,
    KeywordMap,
    Picture,
    contained_bias_dn,
    pixel_noise,
    read_image,
    sky_and_bodies,
)
from opnav_workbench.image.formats.sidecar import find_sidecar
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.mission import Mission
from opnav_workbench.session.settings import Settings
from opnav_workbench.stars import NoiseModel, ShapePrior

if TYPE_CHECKING:
    from opnav_workbench.session import beside
    from opnav_workbench.session.beside import ToldBeside
else:  # few pictures have anything beside them
    beside = module_on_demand("opnav_workbench.session.beside")

__all__ = [
    "DETECTION_SNR",
    "Context",
    "faintest_magnitude",
    "open_context",
    "typical_noise_dn",
    "with_focal_scale",
    "zero_point_mag",
]

DETECTION_SNR = 5.0  # lower than for blind detection: a false detection matches no pattern


# An area of light this wide is no star: 6 sigmas of the PSF hold all but the wings of the brightest, and saturated
# columns are narrower.
MIN_BODY_RADIUS_PX, BODY_PSF_SIGMAS = 6.0, 6.0


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Context:
    """A picture ready for measuring.

    Attributes
    ----------
    signal_dn : (n_line, n_pixel) array
        Picture minus background level.
    noise_dn : (n_line, n_pixel) array
        One-sigma noise of the background in each pixel; the stars' own shot noise is added by the fit.
    bad : (n_line, n_pixel) array of bool
        Pixels that no measurement may use.
    extended : (n_line, n_pixel) array of bool
        Pixels that the light of resolved bodies covers, where no star can be measured.
    beside
        Image support data beside the picture, where there are any.
    """

    picture: Picture
    camera: Camera
    mission: Mission
    background: Background
    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    extended: BoolArray
    settings: Settings
    beside: "ToldBeside | None" = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def not_stars(self) -> BoolArray:
        """Pixels that no measurement of a star may use: bad ones, and those that show a body."""
        return self.bad | self.extended

    @property
    def camera_psf(self) -> ShapePrior:
        """The camera file's PSF as a prior for the first fit."""
        psf = self.camera.psf
        return ShapePrior.round_psf(psf.sigma_px, psf.sigma_sigma_px / psf.sigma_px)

    @property
    def noise_model(self) -> NoiseModel | None:
        """Read noise and gain for the stars' own shot noise; None where the camera file has no gain."""
        camera = self.camera
        if camera.gain_e_per_dn is None or camera.read_noise_dn is None:
            return None
        return NoiseModel(camera.read_noise_dn, camera.gain_e_per_dn)


def zero_point_mag(context: Context) -> float | None:
    """Magnitude of a star of 1 DN in this exposure; None where the camera file has no zero point."""
    zero_point = context.camera.zero_point_mag
    if zero_point is None or not context.picture.exposure_s > 0.0:
        return None
    return zero_point + 2.5 * float(np.log10(context.picture.exposure_s))


_TYPICAL_NOISE_DN: WeakKeyDictionary[Context, float] = WeakKeyDictionary()


def typical_noise_dn(context: Context) -> float:
    """Median noise of the pixels; nan where it is known in none. Found once a picture: pages ask for it at each key."""
    noise = _TYPICAL_NOISE_DN.get(context)
    if noise is None:
        known = context.noise_dn[np.isfinite(context.noise_dn)]
        noise = _TYPICAL_NOISE_DN[context] = float(np.median(known)) if known.size else float("nan")
    return noise


def faintest_magnitude(context: Context) -> float:
    """Magnitude of the faintest star detected in this exposure; inf where no zero point is known."""
    zero_point = zero_point_mag(context)
    if zero_point is None or np.isnan(noise := typical_noise_dn(context)):
        return float("inf")
    # A PSF of this width spreads its light over as many pixels.
    pixels = 4.0 * np.pi * (context.camera.psf.sigma_px**2 + PIXEL_VARIANCE_PX2)
    return zero_point - 2.5 * float(np.log10(DETECTION_SNR * noise * np.sqrt(pixels)))


def open_context(path: str | Path, mission: Mission, settings: Settings) -> Context:
    """Read a picture and prepare it.

    Raises
    ------
    ImageError, CameraError
        See `opnav_workbench.image.read_image` and `Mission.camera_for`.
    """
    picture = read_image(path, KeywordMap(**mission.keywords))
    camera = with_focal_scale(mission.camera_for(picture.header), settings.focal_scale)
    _check_size(picture, camera)
    if camera.reseau is not None:
        picture, camera = _by_its_marks(picture, camera)
    told: ToldBeside | None = None
    if find_sidecar(picture.path) is not None:
        picture, told = beside.told_beside(picture, camera)
    saturated = picture.saturated
    if camera.saturation_dn is not None:
        saturated = saturated | (picture.image_dn >= camera.saturation_dn)
        picture = picture.with_saturated(saturated)
    sigma = camera.psf.sigma_px
    background, extended = sky_and_bodies(
        picture.image_dn,
        picture.bad,
        saturated,
        radius_px=max(MIN_BODY_RADIUS_PX, BODY_PSF_SIGMAS * sigma),
        psf_sigma_px=sigma,
    )
    detector = camera.read_noise_dn, camera.gain_e_per_dn
    bias = contained_bias_dn(background, *detector, camera.bias_dn)
    noise = pixel_noise(background, *detector, bias_dn=bias)
    signal = np.where(picture.bad, 0.0, picture.image_dn - background.level_dn)
    return Context(picture, camera, mission, background, signal, noise, picture.bad, extended, settings, told)


def with_focal_scale(camera: Camera, scale: float) -> Camera:
    """Return a camera with its focal length multiplied; the camera itself for 1."""
    return camera if scale == 1.0 else replace(camera, focal_length_mm=camera.focal_length_mm * scale)


NOMINAL_PX = 3  # c4400436's marks stand 1 to 3 px from their nominal places, 9 in a corner


def _by_its_marks(picture: Picture, camera: Camera) -> tuple[Picture, Camera]:
    """Return a raw vidicon picture without what its reseau marks hide, and the camera with the distortion that they tell."""
    fit = fit_reseau(camera, picture.image_dn)
    count = len(fit.seen)
    if fit.is_solved:
        used = np.count_nonzero(fit.seen)
        said = (
            f"raw picture: its distortion is fitted to {used} of {count} reseau marks, to {fit.rms_px:.2f} px"
        )
        told = replace(picture, bad=picture.bad | fit.hidden, messages=(*picture.messages, said))
        return told, fit.camera
    doubt = (
        f"raw picture whose {count} reseau marks are not seen (a sky cut off at zero?): its nominal distortion may be "
        f"off by {NOMINAL_PX} px; give the picture that is corrected by them"
    )
    return replace(
        picture, messages=(*picture.messages, doubt), contradictions=(*picture.contradictions, doubt)
    ), camera


def _check_size(picture: Picture, camera: Camera) -> None:
    n_line, n_pixel = picture.image_dn.shape
    if (n_line, n_pixel) != (camera.n_line, camera.n_pixel):
        raise ImageError(
            f"{picture.name} has {n_pixel} x {n_line} pixels, but {camera.name} makes {camera.n_pixel} x "
            f"{camera.n_line}; choose the mission file that describes this picture (--mission)."
        )
