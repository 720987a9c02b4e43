"""What a person should know of a simulated picture before it is used: saturated, drawn by a guess, or of no use."""

from collections.abc import Iterator

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.render import RenderedBody
from opnav_workbench.simulation.picture import SimulatedPicture

__all__ = ["cautions", "points_snr"]

SEEN_SNR = 5.0  # as sessions detect
STARS_OF_A_POINTING = 2  # fewer leave the twist unknown
SATURATED_SHARE = 0.001  # of a disk: less is a mountain in the Sun, or a cosmic ray


def cautions(picture: SimulatedPicture) -> tuple[str, ...]:
    """Return a line for each of what will spoil a picture, or was guessed to draw it.

    Saturated bodies and stars, with the exposure that would not; bodies whose scattering law nobody gave; and pictures
    that neither stars nor a body will solve.
    """
    return (*_saturated(picture), *_guessed(picture), *_unsolved(picture))


def points_snr(picture: SimulatedPicture) -> FloatArray:
    """Return the SNR of each star (n,): its light against that, the sky's and the read noise in the pixels of a point."""
    values, psf = picture.exposure.values, picture.inputs.psf
    pixels = 4.0 * np.pi * (float(np.prod(psf.sigma_px)) + PIXEL_VARIANCE_PX2)
    level_e = float(np.median(picture.exposure.expected_electrons))
    variance = level_e + (values.read_noise_dn * values.gain_e_per_dn) ** 2
    return np.asarray(picture.star_flux_e / np.sqrt(picture.star_flux_e + pixels * variance))


def _saturated(picture: SimulatedPicture) -> Iterator[str]:
    full = picture.exposure.saturated
    if not full.any():
        return
    line, pixel = np.nonzero(full)
    free = np.ones(len(line), bool)
    for body in picture.rendering.bodies:
        near = np.hypot(pixel - body.center_px[0], line - body.center_px[1]) <= 0.5 * body.diameter_px + 1.0
        free &= ~near
        share = np.count_nonzero(near) / max(0.25 * np.pi * body.diameter_px**2, 1.0)
        if share > SATURATED_SHARE:
            yield f"{body.name} is saturated in {np.count_nonzero(near)} pixels{_shorter(picture, body)}"
    places = picture.star_trails.mean_px[picture.star_drawn]
    hit = np.zeros(len(places), bool)
    for x, y in zip(pixel[free], line[free], strict=True):
        hit |= np.hypot(places[:, 0] - x, places[:, 1] - y) <= 1.0
    if hit.any():
        count = np.count_nonzero(hit)
        yield f"{count} {'star is' if count == 1 else 'stars are'} saturated"


def _shorter(picture: SimulatedPicture, body: RenderedBody) -> str:
    """Return the exposure with which the brightest pixel of a body is just not saturated, in words."""
    values, electrons = picture.exposure.values, picture.exposure.expected_electrons
    y, x = np.indices(electrons.shape)
    near = np.hypot(x - body.center_px[0], y - body.center_px[1]) <= 0.5 * body.diameter_px + 1.0
    limits = [] if values.full_well_e is None else [values.full_well_e]
    if values.ceiling_dn is not None:
        limits.append((values.ceiling_dn - values.bias_dn) * values.gain_e_per_dn)
    peak = float(electrons[near].max(initial=0.0))
    if not limits or not 0.0 < min(limits) < peak:
        return ""
    return f"; {picture.inputs.exposure_s * min(limits) / peak:.2g} s would not be too long"


def _guessed(picture: SimulatedPicture) -> Iterator[str]:
    for name in picture.inputs.without_law:
        yield (
            f"{name} is drawn by Lambert's law, as nobody says how it scatters light; give bodies: [{{name: {name}, law: "
            "...}]"
        )


def _unsolved(picture: SimulatedPicture) -> Iterator[str]:
    drawn = picture.star_drawn
    stars = int(np.count_nonzero(points_snr(picture)[drawn] >= SEEN_SNR))
    if stars >= STARS_OF_A_POINTING:
        return
    words = {0: "no star", 1: "one star alone"}[stars]
    camera = picture.inputs.camera
    seen = [b.name for b in picture.rendering.bodies if b.flux_e > 0.0 and camera.on_detector(b.center_px)]
    if not seen:
        yield f"{words} is bright enough to be found, and no body is on the detector: nothing solves this picture"
        return
    have = "has" if len(seen) == 1 else "have"
    yield (
        f"{words} is bright enough to be found: no pointing will be solved, and {', '.join(seen)} {have} places by an a "
        "priori one or one carried from a longer exposure beside it"
    )
