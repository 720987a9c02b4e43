"""What the scans show: data and rendered model on the same points, their noise, and what an uneven albedo would change.

Flow   center -> window -> rendered body and its derivatives -> samples along the scans; rays along the scans -> brightness
       of the surface, divided among depths -> line spread -> samples
Units  DN; derivatives per px that the center moves; profiles relative to the model's brightness

Albedo  A scan that crosses the limb sees the surface at an angle of b = arccos(r / r_limb) from grazing; on a sphere that
        is the arc from the limb. The albedo along a scan is a sum of hat functions of b. As it is not known, it is taken
        for a random function of b, Gaussian, with a correlation length of 8 deg, which is what maps of icy satellites and
        of Pluto have at the sizes that matter at a limb (Buie et al. 2010, doi:10.1088/0004-6256/139/3/1128).
Law     Lommel-Seeliger's law is Lambert's times 2 / (mu0 + mu), mu0 and mu the cosines of incidence and emission; most
        laws lie between the two. A power of that factor times any law, ``law (2 / (mu0 + mu))^share``, follows what scans
        show of the darkening near the limb: share 1 turns Lambert into Lommel-Seeliger, share -1 the other way.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d, laplace

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.limb_scan.fan import (
    STEP_PX,
    ScanFan,
    ScanSampler,
)
from opnav_workbench.bodies.limb_scan.matching import ScanSystem
from opnav_workbench.bodies.neighbours import edge_reach, without_others
from opnav_workbench.bodies.picture import (
    BodyPicture,
    Circle,
    displaced_model,
    pixel_rays,
    sunlight_electrons,
)
from opnav_workbench.bodies.subarray import Cutout, choose_subarray, find_hit_pixels
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel, Lambert, LommelSeeliger, ScatteringLaw, render_moving
from opnav_workbench.render.body import PlacedBody
from opnav_workbench.render.scattering import AdjustedLaw

__all__ = [
    "CORRELATION_RAD",
    "ModelLight",
    "ScanProfiles",
    "ScanView",
    "fan_reach",
    "law_share",
    "pooled_brightness",
    "render_model_light",
    "scan_profiles",
    "scan_system",
    "usable_pixels",
    "view_scans",
    "with_law_share",
]


# ---- A scattering law made to fit: the body's own, darkened toward the limb by more or less.

LARGEST_LAW_SHARE = 1.2  # a little beyond from one law to the other


def law_share(picture: BodyPicture, name: str) -> float:
    """Return the share that is in a body's law already."""
    law = picture.model(name).law
    return law.share if isinstance(law, AdjustedLaw) else 0.0


def with_law_share(picture: BodyPicture, name: str, share: float) -> BodyPicture:
    """Return the picture with another share in the law of one body's model, kept within bounds."""
    bounded = float(np.clip(share, -LARGEST_LAW_SHARE, LARGEST_LAW_SHARE))
    models = (_with_share(m, bounded) if m.target.name == name else m for m in picture.models)
    return replace(picture, models=tuple(models))


def _with_share(model: BodyModel, share: float) -> BodyModel:
    own = model.law.law if isinstance(model.law, AdjustedLaw) else model.law
    return replace(model, law=AdjustedLaw(own, share))


# ---- What a scan would show if the albedo differed from place to place.

CORRELATION_RAD = np.radians(8.0)
NODES = 10  # hat functions; they stand less than 3 deg apart
FINE = 4  # rays per sample: 1/8 px
KEPT_SHARE = 1e-4  # of the line spread function; what lies farther out is cut off


@dataclass(frozen=True, slots=True, eq=False)
class ScanProfiles:
    """Brightness of n scans in one dimension: without the curvature of the limb, which the rendered picture has.

    Attributes
    ----------
    total : (n, w) array
        Of a uniform albedo of 1, relative.
    parts : (n, w, j) array
        Orthogonal parts of the random albedo: the covariance of brightness is ``parts @ parts.T`` for an albedo
        with a relative scatter of 1.
    law : (n, w) array
        Change per share of another law (`opnav_workbench.bodies.limb_scan.view`), at unchanged mean brightness.
    """

    total: FloatArray
    parts: FloatArray
    law: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def scan_profiles(
    picture: BodyPicture, name: str, fan: ScanFan, center_px: FloatArray, range_scale: float
) -> ScanProfiles:
    """Return the brightness profiles of scans, from rays along them and the PSF's line spread."""
    spread = _line_spread(picture.psf.at(center_px), round(1.0 / STEP_PX) * FINE)
    pad = -(-len(spread) // (2 * FINE))
    n, w = len(fan), fan.n_samples + 2 * pad
    distance = STEP_PX * (fan.first[:, None] - pad + np.arange(w * FINE) / FINE)
    model = displaced_model(picture, name, center_px, range_scale)
    rays = pixel_rays(picture, fan.places(center_px, distance).reshape(-1, 2))

    def radiance(law: ScatteringLaw) -> FloatArray:
        body = PlacedBody(replace(model, law=law), picture.camera.pixel_scale_rad)
        return body.radiance(rays).reshape(n, -1)

    light = radiance(model.law)
    share, prior = _albedo_parts(distance, fan)
    fine = convolve1d(light[..., None] * (share @ prior), spread, axis=1, mode="constant")
    total = convolve1d(light, spread, axis=1, mode="constant")
    law = convolve1d(light * _darkening(light, radiance), spread, axis=1, mode="constant")
    kept = slice(pad * FINE, (pad + fan.n_samples) * FINE, FINE)
    peak = max(float(total.max(initial=0.0)), np.finfo(float).tiny)
    return ScanProfiles(total[:, kept] / peak, fine[:, kept] / peak, law[:, kept] / peak)


def _darkening(light: FloatArray, radiance: Callable[[ScatteringLaw], FloatArray]) -> FloatArray:
    """Return the logarithm of 2 / (mu0 + mu) along scans (n, k), less its mean where there is light."""
    lambert, seeliger = radiance(Lambert()), radiance(LommelSeeliger())
    lit = (lambert > 0.0) & (seeliger > 0.0)
    factor = np.log(np.where(lit, seeliger, 1.0) / np.where(lit, lambert, 1.0))
    weight = np.where(lit, light, 0.0)
    mean = np.sum(weight * factor, axis=1) / np.maximum(weight.sum(axis=1), np.finfo(float).tiny)
    return np.where(lit, factor - mean[:, None], 0.0)


def _albedo_parts(distance_px: FloatArray, fan: ScanFan) -> tuple[FloatArray, FloatArray]:
    """Return the shares (n, k, j) of points in hat functions of their arc, and the root (j, j) of the prior covariance."""
    arc = np.arccos(np.clip(np.abs(distance_px) / fan.limb_px[:, None], 0.0, 1.0))
    deepest = np.arccos(np.clip(STEP_PX * fan.first / fan.limb_px, 0.0, 1.0)).max()
    node = np.linspace(0.0, max(float(deepest), 1e-3), NODES)
    share = np.clip(1.0 - np.abs(arc[..., None] - node) / node[1], 0.0, None)
    share[..., -1] = np.where(arc >= node[-1], 1.0, share[..., -1])
    apart = (node[:, None] - node) / CORRELATION_RAD
    value, vector = np.linalg.eigh(np.exp(-0.5 * apart**2))
    return share, vector * np.sqrt(np.maximum(value, 0.0))


def _line_spread(psf: Psf, subsample: int) -> FloatArray:
    """Return the light of a point along a line, summed across it and over pixels: the mean of both axes, in fine steps."""
    kernel = psf.kernel(subsample)
    line = 0.5 * (kernel.sum(axis=0) + kernel.sum(axis=1))
    line = np.convolve(line, np.ones(subsample + 1) / (subsample + 1.0))
    kept = np.flatnonzero(line > KEPT_SHARE * line.max())
    half = int(max(abs(kept[0] - len(line) // 2), abs(kept[-1] - len(line) // 2)))
    middle = len(line) // 2
    line = line[middle - half : middle + half + 1]
    return np.asarray(line / line.sum())


# ---- What the scans show: data and rendered model on the same points, their noise, and which points count.

FAINTEST = 0.05  # of the mean brightness: the least that a scan is taken for
POOLED = 5  # scans to each side whose mean brightness stands for a scan's own


@dataclass(frozen=True, slots=True, eq=False)
class ModelLight:
    """A body rendered in a window of the picture, and its derivatives.

    Attributes
    ----------
    window : (int, int, int, int)
    light_dn : (n_line, n_pixel) array
    slope_dn : (2, n_line, n_pixel) array
        Per px that the center moves along pixel and along line.
    flux_dn
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


def render_model_light(
    picture: BodyPicture, name: str, center_px: FloatArray, range_scale: float, reach_px: float
) -> ModelLight:
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
    return ModelLight(window, body.electrons / gain, slope, body.body.diameter_px, body.body.flux_e / gain)


def usable_pixels(picture: BodyPicture, name: str, center_px: FloatArray, body: ModelLight) -> Cutout:
    """Return the data of the body's window, without pixels that other bodies light or cosmic rays have hit."""
    cutout = without_others(picture, name, center_px, body.window)
    weight = cutout.weight(body.light_dn)
    under = float(np.sum(weight * body.light_dn**2))
    scale = float(np.sum(weight * cutout.data_dn * body.light_dn)) / under if under > 0.0 else 0.0
    hits = find_hit_pixels(cutout.data_dn - scale * body.light_dn, cutout.weight(scale * body.light_dn))
    return replace(cutout, use=cutout.use & ~hits)


def view_scans(sampler: ScanSampler, cutout: Cutout, body: ModelLight) -> ScanView:
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
