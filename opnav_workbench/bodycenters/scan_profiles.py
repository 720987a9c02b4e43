"""What a scan would show if the albedo differed from place to place: the body's light along the scan, divided by depth.

Flow   rays along the scans -> brightness of the surface, divided among depths -> line spread -> samples
Units  px along the scan; brightness relative to the model's

A scan that crosses the limb sees the surface at an angle of b = arccos(r / r_limb) from grazing; on a sphere that is the
arc from the limb. The albedo along a scan is a sum of hat functions of b. As it is not known, it is taken for a random
function of b, Gaussian, with a correlation length of 8 deg, which is what maps of icy satellites and of Pluto have at
the sizes that matter at a limb (Buie et al. 2010, doi:10.1088/0004-6256/139/3/1128).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodycenters.model_picture import displaced_model
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.scan_fan import STEP_PX, ScanFan, pixel_rays
from opnav_workbench.psf import Psf
from opnav_workbench.render import Lambert, LommelSeeliger, ScatteringLaw
from opnav_workbench.render.body import PlacedBody

__all__ = ["CORRELATION_RAD", "ScanProfiles", "scan_profiles"]

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
        Change per share of another law (`opnav_workbench.bodycenters.scan_law`), at unchanged mean brightness.
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
