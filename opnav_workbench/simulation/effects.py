"""What a detector does to light: one switch and a few numbers per effect, as they stand in scenario files.

``true`` switches an effect on with the camera's own numbers, ``false`` switches it off, and a mapping gives other
numbers. A number that is null is the camera's.
"""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from opnav_workbench.yaml_file import Also, StrictModel

__all__ = ["CosmicRays", "DetectorEffects", "LostData", "Sky"]

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Effect = TypeVar("Effect")


def _switched(value: Any) -> Any:
    """Turn ``true`` into an effect without settings of its own, and ``false`` into none."""
    if isinstance(value, bool):
        return {} if value else None
    return value


Switch = Annotated[Effect | None, BeforeValidator(_switched), Also(("boolean",))]


class ReadNoise(StrictModel):
    """Noise of reading a pixel, as a dark frame shows it: digitisation is part of it, as in flight headers."""

    sigma_dn: NonNegativeFloat | None = None


class Bias(StrictModel):
    """Electronic offset; its pattern from column to column belongs to the camera. Calibration removes both."""

    level_dn: NonNegativeFloat | None = None
    pattern_dn: NonNegativeFloat = 0.0  # 1 sigma


class DarkCurrent(StrictModel):
    """Thermal electrons, their number in a pixel Poisson-distributed. Calibration removes their mean."""

    rate_e_s: NonNegativeFloat | None = None  # per pixel
    nonuniformity: NonNegativeFloat = 0.0  # 1 sigma of the rate from pixel to pixel, of its mean


class FullWell(StrictModel):
    """Charge that a pixel can hold; what is more spills along its column, as much up as down."""

    electrons: PositiveFloat | None = None
    blooming: bool = True  # False: an anti-blooming drain takes what is too much


class Adc(StrictModel):
    """Analog-digital converter: whole numbers up to ``2^bits - 1``."""

    bits: Annotated[PositiveInt | None, Field(le=32)] = None


class BadPixels(StrictModel):
    """Hot pixels, which leak, and dead pixels, which see nothing: always the same ones of a camera."""

    hot_fraction: Fraction | None = None
    hot_rate_e_s: NonNegativeFloat = 2000.0  # mean of the exponentially distributed leak
    dead_fraction: Fraction | None = None
    flagged: bool = False  # whether the quality plane knows them


class CosmicRays(StrictModel):
    """Charged particles: isotropic through a layer of silicon, with log-normal losses along their tracks."""

    rate_per_cm2_s: NonNegativeFloat | None = None  # None: 4, the galactic flux of deep space
    rate_per_px_s: NonNegativeFloat | None = None  # instead of the rate per area
    electrons_per_um: PositiveFloat = 80.0  # of a minimum-ionising particle in silicon
    spread: NonNegativeFloat = 0.5  # 1 sigma of the natural logarithm of the loss
    depth_um: PositiveFloat = 15.0  # thickness that collects charge
    longest_px: PositiveFloat = 200.0


class FrameTransfer(StrictModel):
    """Light that falls while charge moves along columns, where no shutter stops it.

    After the exposure the picture moves `toward` its first or last line in `transfer_s`; before it, the rows that
    arrive have gathered light on their way for `scrub_s` at most. Calibration removes the mean.
    """

    transfer_s: NonNegativeFloat | None = None  # all lines
    scrub_s: NonNegativeFloat | None = None  # None: as long as the transfer; 0: cleared at once
    toward: Literal["first_line", "last_line"] = "first_line"


class FlatField(StrictModel):
    """Sensitivity over the field: darker corners, and pixels that differ. Calibration removes all but `error`."""

    vignetting: Fraction = 0.0  # light lost in the corners, growing with the square of the radius
    prnu: NonNegativeFloat | None = None  # 1 sigma from pixel to pixel, relative
    error: NonNegativeFloat = 0.0  # 1 sigma per pixel of the flat that calibration divides by, relative


class Sky(StrictModel):
    """Evenly bright background."""

    rate_e_s: NonNegativeFloat = 0.0  # electrons per pixel and second
    level_dn: NonNegativeFloat = 0.0  # whatever the exposure


class StrayLight(StrictModel):
    """A plane of scattered light, never below zero: at the center, and its change from edge to edge."""

    center_e_s: NonNegativeFloat = 0.0  # electrons per pixel and second
    along_pixel_e_s: float = 0.0
    along_line_e_s: float = 0.0


class LostData(StrictModel):
    """Lines and blocks that telemetry lost: filled with a value, and flagged in the quality plane."""

    lines: NonNegativeInt = 0
    blocks: NonNegativeInt = 0
    block_px: PositiveInt = 32  # blocks are squares
    fill_dn: float = 0.0  # raw DN: after calibration a lost pixel stands below zero by the bias


class DetectorEffects(StrictModel):
    """All effects. Those on by default are in every picture; the others ask for numbers that are no constants.

    Examples
    --------
    >>> effects = DetectorEffects.model_validate({"read_noise": False, "sky": {"level_dn": 1.0}})
    >>> effects.read_noise is None, effects.sky.level_dn, effects.shot_noise
    (True, 1.0, True)
    """

    gain_e_per_dn: PositiveFloat | None = None
    shot_noise: bool = True
    read_noise: Switch[ReadNoise] = ReadNoise()
    bias: Switch[Bias] = Bias()
    dark_current: Switch[DarkCurrent] = DarkCurrent()
    full_well: Switch[FullWell] = FullWell()
    adc: Switch[Adc] = Adc()
    frame_transfer: Switch[FrameTransfer] = FrameTransfer()
    flat_field: Switch[FlatField] = None
    bad_pixels: Switch[BadPixels] = None
    cosmic_rays: Switch[CosmicRays] = None
    sky: Switch[Sky] = None
    stray_light: Switch[StrayLight] = None
    lost_data: Switch[LostData] = None

    @classmethod
    def none(cls) -> "DetectorEffects":
        """Return the ideal detector: electrons over gain."""
        off = dict.fromkeys(("shot_noise", *cls._switches()), False)
        return cls.model_validate(off)

    @classmethod
    def _switches(cls) -> tuple[str, ...]:
        return tuple(name for name in cls.model_fields if name not in ("gain_e_per_dn", "shot_noise"))
