"""What the scans show: data and rendered model on the same points, their noise, and which points count.

Flow   center -> window -> rendered body and its derivatives -> samples along the scans
Units  DN; derivatives per px that the center moves
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation, laplace

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.cutout import Cutout, cut_out
from opnav_workbench.bodycenters.hit_pixels import find_hit_pixels
from opnav_workbench.bodycenters.model_picture import displaced_model, model_picture, sunlight_electrons
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.scan_fan import STEP_PX, ScanFan, edge_reach, near_bodies
from opnav_workbench.bodycenters.scan_matching import ScanSystem
from opnav_workbench.bodycenters.scan_profiles import ScanProfiles
from opnav_workbench.bodycenters.scan_sampling import ScanSampler
from opnav_workbench.bodycenters.subarray import choose_subarray
from opnav_workbench.render import render_moving

__all__ = [
    "BodyLight",
    "ScanView",
    "body_light",
    "fan_reach",
    "pooled_brightness",
    "scan_system",
    "usable_pixels",
    "view_scans",
    "without_others",
]

OTHERS_SHARE = 1.0  # light of other bodies, in units of the noise, from which on a pixel does not count
OTHERS_ERROR_PX = 3  # of their places
FAINTEST = 0.05  # of the mean brightness: the least that a scan is taken for
POOLED = 5  # scans to each side whose mean brightness stands for a scan's own


@dataclass(frozen=True, slots=True, eq=False)
class BodyLight:
    """A body rendered in a window of the picture, and its derivatives.

    Attributes
    ----------
    window : (int, int, int, int)
    light_dn : (n_line, n_pixel) array
    slope_dn : (2, n_line, n_pixel) array
        Per px that the center moves along pixel and along line.
    diameter_px : float
    flux_dn : float
        On and off the window.
    """

    window: tuple[int, int, int, int]
    light_dn: FloatArray
    slope_dn: FloatArray
    diameter_px: float
    flux_dn: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class ScanView:
    """Windows of n scans with w samples each.

    Attributes
    ----------
    data, model : (n, w) arrays
    slope : (n, w, 2) array
        Of the model.
    blur : (n, w) array
        Change of the model per px^2 of additional variance of the PSF, along each axis.
    noise2 : (n, w) array
        Variance of the background's noise.
    blocked : (n, w) array of bool
    """

    data: FloatArray
    model: FloatArray
    slope: FloatArray
    blur: FloatArray
    noise2: FloatArray
    blocked: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def body_light(
    picture: BodyPicture, name: str, center_px: FloatArray, range_scale: float, reach_px: float
) -> BodyLight:
    """Render a body alone at a place, in the part of the detector within `reach_px` of it."""
    window = choose_subarray(picture, name, Circle(center_px, reach_px), margin=0.0).window
    (body,) = render_moving(
        [displaced_model(picture, name, center_px, range_scale)],
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
    )
    gain = picture.gain_e_per_dn
    slope = body.slopes / gain
    return BodyLight(window, body.electrons / gain, slope, body.body.diameter_px, body.body.flux_e / gain)


def usable_pixels(picture: BodyPicture, name: str, center_px: FloatArray, body: BodyLight) -> Cutout:
    """Return the data of the body's window, without pixels that other bodies light or cosmic rays have hit."""
    cutout = without_others(picture, name, center_px, body.window)
    weight = cutout.weight(body.light_dn)
    under = float(np.sum(weight * body.light_dn**2))
    scale = float(np.sum(weight * cutout.data_dn * body.light_dn)) / under if under > 0.0 else 0.0
    hits = find_hit_pixels(cutout.data_dn - scale * body.light_dn, cutout.weight(scale * body.light_dn))
    return replace(cutout, use=cutout.use & ~hits)


def without_others(
    picture: BodyPicture, name: str, center_px: FloatArray, window: tuple[int, int, int, int]
) -> Cutout:
    """Return the data of a window, with pixels left out that other bodies light."""
    cutout = cut_out(picture, window)
    others = near_bodies(picture, name, center_px)
    if not others:
        return cutout
    light = model_picture(picture, window, others, only=tuple(others))
    lit = binary_dilation(light > OTHERS_SHARE * cutout.noise_dn, iterations=OTHERS_ERROR_PX)
    return replace(cutout, use=cutout.use & ~lit)


def view_scans(sampler: ScanSampler, cutout: Cutout, body: BodyLight) -> ScanView:
    """Sample data and model along scans."""
    return ScanView(
        data=sampler.sample(cutout.data_dn),
        model=sampler.sample(body.light_dn),
        slope=np.stack([sampler.sample(slope) for slope in body.slope_dn], axis=-1),
        blur=sampler.sample(0.5 * laplace(body.light_dn, mode="nearest")),
        noise2=np.maximum(sampler.sample(cutout.noise_dn**2), np.finfo(float).tiny),
        blocked=sampler.blocked(cutout.use),
    )


def pooled_brightness(view: ScanView) -> FloatArray:
    """Return the brightness (n,), data over model, of each scan with its neighbours.

    Pooled, it does not follow the noise of the one scan whose weights it sets.
    """
    free = ~view.blocked
    both = np.where(free, view.data * view.model, 0.0).sum(axis=1)
    square = np.where(free, view.model**2, 0.0).sum(axis=1)
    total = both.sum() / max(square.sum(), np.finfo(float).tiny)
    around = np.ones(2 * POOLED + 1)
    pooled = np.convolve(np.pad(both, POOLED, mode="wrap"), around, "valid")
    under = np.convolve(np.pad(square, POOLED, mode="wrap"), around, "valid")
    under = np.maximum(under, 1e-6 * max(float(under.max()), np.finfo(float).tiny))
    floor = max(FAINTEST * abs(total), np.finfo(float).tiny)
    return np.asarray(np.maximum(pooled / under, floor))


def scan_system(
    fan: ScanFan, view: ScanView, profiles: ScanProfiles, gain_e_per_dn: float, brightness: FloatArray
) -> ScanSystem:
    """Set up the matching of data and model for each scan.

    A sample every half pixel holds half of a pixel's information: its variance counts double.
    """
    shot = np.maximum(brightness[:, None] * view.model, 0.0) / gain_e_per_dn
    norm = np.einsum("nw,nw->", profiles.total, profiles.total)
    scale = float(np.einsum("nw,nw->", view.model, profiles.total)) / max(norm, np.finfo(float).tiny)
    return ScanSystem(
        view.data,
        view.model,
        view.slope,
        fan.direction,
        scale * profiles.parts,
        (view.noise2 + shot) / STEP_PX,
        view.blocked,
        brightness,
        np.stack([scale * profiles.law, view.blur], axis=-1),
    )


def fan_reach(fan: ScanFan, picture: BodyPicture) -> float:
    """Return how far from the center the scans' windows reach, with the pixels that interpolation needs."""
    return float(STEP_PX * (fan.first.max() + fan.n_samples)) + 3.0 + edge_reach(picture)
