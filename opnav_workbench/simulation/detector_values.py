"""The numbers that an exposure uses: those of the scenario where it gives them, else the camera's."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.frame_transfer import Transfer

__all__ = ["DetectorValues", "Level", "detector_values"]

Level = Literal["raw", "calibrated"]


@dataclass(frozen=True, slots=True)
class DetectorValues:
    """The numbers of a detector as they act in one exposure; None where there is no such effect.

    Attributes
    ----------
    gain_e_per_dn, read_noise_dn, bias_dn : float
    dark_e_s : float
        Mean dark current of a pixel.
    full_well_e : float or None
    digitised : bool
        Whether data numbers are whole numbers.
    ceiling_dn : float or None
        Highest raw value.
    transfer : Transfer or None
    transfer_s : float
        Time of the frame transfer, 0 without.
    prnu, hot_fraction, dead_fraction : float
    """

    gain_e_per_dn: float
    read_noise_dn: float
    bias_dn: float
    dark_e_s: float
    full_well_e: float | None
    digitised: bool
    ceiling_dn: float | None
    transfer: Transfer | None
    transfer_s: float
    prnu: float
    hot_fraction: float
    dead_fraction: float

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
    bias = _bias(camera, effects, level)
    transfer_s, transfer = _transfer(camera, effects, exposure_s)
    read, dark, well = effects.read_noise, effects.dark_current, effects.full_well
    flat, bad = effects.flat_field, effects.bad_pixels
    return DetectorValues(
        gain_e_per_dn=_or(effects.gain_e_per_dn, camera, "gain_e_per_dn"),
        read_noise_dn=0.0 if read is None else _or(read.sigma_dn, camera, "read_noise_dn"),
        bias_dn=bias or 0.0,
        dark_e_s=0.0 if dark is None else _if_known(dark.rate_e_s, camera, "dark_current_e_s") or 0.0,
        full_well_e=None if well is None else _if_known(well.electrons, camera, "full_well_e"),
        digitised=effects.adc is not None,
        ceiling_dn=_ceiling(camera, effects, bias),
        transfer=transfer,
        transfer_s=transfer_s,
        prnu=0.0 if flat is None else _if_known(flat.prnu, camera, "prnu") or 0.0,
        hot_fraction=0.0 if bad is None else _or(bad.hot_fraction, camera, "hot_pixel_fraction"),
        dead_fraction=0.0 if bad is None else _or(bad.dead_fraction, camera, "dead_pixel_fraction"),
    )


def _or(given: float | None, camera: Camera, name: str) -> float:
    return camera.require(name) if given is None else given


def _if_known(given: float | None, camera: Camera, name: str) -> float | None:
    return getattr(camera, name) if given is None else given


def _bias(camera: Camera, effects: DetectorEffects, level: Level) -> float | None:
    if effects.bias is None:
        return 0.0
    if level == "raw":
        return _or(effects.bias.level_dn, camera, "bias_dn")
    return _if_known(effects.bias.level_dn, camera, "bias_dn")


def _ceiling(camera: Camera, effects: DetectorEffects, bias: float | None) -> float | None:
    """Highest raw value: of the converter; where the bias is not known, also the camera's saturation level."""
    if effects.adc is None:
        return None
    bits = effects.adc.bits or camera.bits
    limits = [] if bits is None else [2.0**bits - 1.0]
    if camera.saturation_dn is not None and bias is None:
        limits.append(camera.saturation_dn)
    return min(limits, default=None)


def _transfer(camera: Camera, effects: DetectorEffects, exposure_s: float) -> tuple[float, Transfer | None]:
    settings = effects.frame_transfer
    if settings is None:
        return 0.0, None
    transfer_s = _if_known(settings.transfer_s, camera, "frame_transfer_s")
    if transfer_s is None:
        return 0.0, None
    scrub_s = transfer_s if settings.scrub_s is None else settings.scrub_s
    first = settings.toward == "first_line"
    return transfer_s, Transfer.of(transfer_s, scrub_s, exposure_s, toward_first=first)
