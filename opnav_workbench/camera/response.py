"""What a camera makes of light: its PSF, its detector, and magnitudes turned into electrons.

Magnitude -> electrons goes through the zero point, the magnitude that gives 1 DN/s: a measured one, or that of Vega as
the standard candle through the band pass. `color` takes a catalog's V and B - V to the camera's magnitude.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.priors import ExposureLimits, PsfPrior
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry import (
    SUN,
    SUN_B_V,
    SUN_V_MAG,
    Bandpass,
    ColorResponse,
    color_response,
    johnson_magnitude,
    synthetic_magnitude,
    zero_point_mag,
)
from opnav_workbench.psf import EffectivePsf, GaussianPsf, Psf

__all__ = ["UNKNOWN_COLOR", "CameraResponse"]

UNKNOWN_COLOR = ColorResponse(0.0, 0.2)  # panchromatic CCDs differ from V by this much between star colors
NOT_NEGATIVE = (
    "read_noise_dn", "bias_dn", "dark_current_e_s", "frame_transfer_s", "prnu", "hot_pixel_fraction",
    "dead_pixel_fraction", "obscuration",
)  # fmt: skip
POSITIVE = ("gain_e_per_dn", "saturation_dn", "full_well_e", "aperture_m")
SHARES = ("prnu", "hot_pixel_fraction", "dead_pixel_fraction", "obscuration")

_color_of = lru_cache(maxsize=32)(color_response)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraResponse:
    """The part of a camera that has to do with light. None: not known, see `require`.

    Attributes
    ----------
    name
        Camera and mode, such as ``LORRI 4x4``.
    psf
        Width of the point spread function before pixel integration, as it is known beforehand.
    psf_shape
        The point spread function of simulated pictures, where more than its width is known.
    effective_psf
        What the stars of the camera's pictures say of the light's distribution within a pixel, with its covariance: the fits
        of stars in undersampled pictures begin with it.
    bits
        Bits of the analog-digital converter.
    gain_e_per_dn, read_noise_dn
        Electrons per data number, and read noise in data numbers.
    saturation_dn
        Level (after bias subtraction) from which a pixel counts as saturated.
    bias_dn
        Level of a raw picture without light.
    full_well_e
        Electrons that a pixel holds.
    dark_current_e_s
        Mean dark current of a pixel, e/s.
    frame_transfer_s
        Time in which the picture is shifted under the mask, lit all the while; None for a camera with a shutter.
    prnu
        Pixel-to-pixel scatter of the sensitivity (what a flat field corrects), 1 sigma.
    exposure_limits
        Shortest and longest exposure, s.
    aperture_m
        Diameter of the entrance pupil.
    obscuration
        Share of the pupil's area that is obscured, where the response does not count it already.
    bandpass
        Electrons per photon that enters the aperture.
    color_response
        Measured; None: that of the band pass.
    zero_point_mag
        V magnitude of a star that gives 1 DN/s; computed from `bandpass`, `aperture_m` and `gain_e_per_dn` where
        these are known and it is not given.
    zero_point_b_v
        B - V of the stars for which that holds; a computed zero point holds for Vega's, 0.
    """

    name: str
    psf: PsfPrior = field(default_factory=PsfPrior)
    psf_shape: Psf | None = None
    effective_psf: EffectivePsf | None = None
    bits: int | None = None
    gain_e_per_dn: float | None = None
    read_noise_dn: float | None = None
    saturation_dn: float | None = None
    bias_dn: float | None = None
    full_well_e: float | None = None
    dark_current_e_s: float | None = None
    frame_transfer_s: float | None = None
    prnu: float | None = None
    hot_pixel_fraction: float | None = None
    dead_pixel_fraction: float | None = None
    exposure_limits: ExposureLimits | None = None
    aperture_m: float | None = None
    obscuration: float = 0.0
    bandpass: Bandpass | None = None
    color_response: ColorResponse | None = None
    zero_point_mag: float | None = None
    zero_point_b_v: float = 0.0

    def __post_init__(self) -> None:
        for name in (*POSITIVE, *NOT_NEGATIVE):
            value = getattr(self, name)
            upper = 1.0 if name in SHARES else np.inf
            if value is not None and not (0.0 <= value < upper and (value > 0.0 or name in NOT_NEGATIVE)):
                allowed = "a share from 0 to below 1" if name in SHARES else "a positive number, or null"
                raise CameraError(f"{self.name}: {name} is {value}; give {allowed}.")
        if self.zero_point_mag is None and not (
            self.bandpass is None or self.aperture_m is None or self.gain_e_per_dn is None
        ):
            zero_point = zero_point_mag(self.bandpass, self.aperture_m, self.gain_e_per_dn, self.obscuration)
            object.__setattr__(self, "zero_point_mag", zero_point)
            object.__setattr__(self, "zero_point_b_v", 0.0)

    @property
    def psf_model(self) -> Psf:
        """The point spread function: `psf_shape`, or the round Gaussian of `psf`."""
        return self.psf_shape or GaussianPsf(self.psf.sigma_px, self.psf.sigma_px)

    @property
    def color(self) -> ColorResponse:
        """What a star's B - V does to its magnitude in this camera."""
        if self.color_response is not None:
            return self.color_response
        return UNKNOWN_COLOR if self.bandpass is None else _color_of(self.bandpass, self.zero_point_b_v)

    def require(self, name: str) -> float:
        """Return a number that not every camera file knows, such as ``gain_e_per_dn``.

        Raises
        ------
        CameraError
            It is not known.
        """
        value = getattr(self, name)
        if value is None:
            more = ", or a bandpass with aperture and gain" if name == "zero_point_mag" else ""
            raise CameraError(
                f"{self.name}: {name} is not known but needed here; give it{more} in the camera file."
            )
        return float(value)

    def require_photometry(self) -> None:
        """Raise CameraError where a number is not known that every measured or predicted brightness needs."""
        for name in ("zero_point_mag", "gain_e_per_dn", "read_noise_dn"):
            self.require(name)

    def exposure_fault(self, exposure_s: float) -> str:
        """Return why the camera cannot take an exposure of this length; empty where it can."""
        limits = self.exposure_limits
        if limits is None or limits.min_s <= exposure_s <= limits.max_s:
            return ""
        return f"{exposure_s:g} s; {self.name} takes {limits.min_s:g} to {limits.max_s:g} s"

    def electrons(self, mag: ArrayLike, exposure_s: float) -> FloatArray:
        """Return the electrons that sources leave in an exposure.

        Parameters
        ----------
        mag : (...) array_like
            Magnitudes in the camera's band (`opnav_workbench.photometry.instrument_magnitude` with `color`), or V
            for sources of the color `zero_point_b_v`. An unknown one (nan) gives nan.

        Raises
        ------
        CameraError
            Neither a zero point nor what it is computed from is known, or the gain is not.
        """
        rate_dn = 10.0 ** (0.4 * (self.require("zero_point_mag") - np.asarray(mag, dtype=np.float64)))
        return np.asarray(rate_dn * (exposure_s * self.require("gain_e_per_dn")))

    def sunlight_e(self, exposure_s: float) -> float:
        """Return the electrons that the Sun at 1 au would leave, were it a point.

        A patch of solid angle w that reflects I/F at r au leaves ``sunlight_e * I/F * w / (pi r^2)`` electrons.

        Raises
        ------
        CameraError
            As `electrons`.
        """
        return float(self.electrons(self.sun_mag, exposure_s))

    @property
    def sun_mag(self) -> float:
        """Magnitude of the Sun at 1 au in the camera's band: its V and, where known, its color."""
        if self.bandpass is None or self.color_response is not None:
            return SUN_V_MAG + float(self.color.offset(SUN_B_V))
        reference = self.color.offset(0.0)  # of Vega, from which synthetic magnitudes count
        return SUN_V_MAG + synthetic_magnitude(self.bandpass, SUN) - johnson_magnitude(SUN) + float(reference)
