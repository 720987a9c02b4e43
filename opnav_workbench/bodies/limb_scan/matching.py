"""How far the data of a scan lie from the model along it, whatever the albedo: generalised least squares, scan by scan.

With m the model along a scan and m' its change per px that the limb lies farther out, the data are

    d = m + o m' + c + e,     e ~ N(0, V)

c the background of this scan, and V the covariance of noise and of the light of an uneven albedo, whose strength and length
are those of the disk: it holds what a scan is brighter or darker than the model. The offset o that explains most is the
maximum of the correlation of data and model in the metric of V, linearised about the model's place: one step of
Gauss-Newton, exact where the iteration ends.

References: Rasmussen & Williams (2006), Gaussian Processes for Machine Learning, section 2.7; Jackman & Dumont (2013), AAS
13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.limb_scan.fan import STEP_PX
from opnav_workbench.bodies.limb_scan.view import ScanView, piece_shares

__all__ = ["ScanMatch", "correlate_scans", "match_scans"]

BLOCKED = 1e9  # factor on the variance of samples that do not count
BLOCKED_SHARE = 0.1  # of a window's samples: more of them unusable, and a lag says nothing
# Surfaces have edges, a Gaussian field has none: a scan may follow an albedo of this times the disk's strength. On 30 disks
# of the exam's families (seed 808) errors stay as they are, and over their sigmas they are 1.4 instead of 1.7.
EDGES = 2.0
TABLES_PX = 0.01  # what the light of the tables is good to


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Offsets of n scans.

    Attributes
    ----------
    offset_px : (n,) array
    common : (n, p) array
        Change of the offsets with what all scans share (`opnav_workbench.bodies.limb_scan.view.COMMON`).
    noise, covariance : (n, n) arrays
        Of the offsets: from noise alone, and with albedo, roughness of the limb and what the tables are good to.
    brightness : (n,) array
    metric : (n, w, w) array
        Inverse of V, backgrounds taken out.
    relief_px
        Of the limb, 1 sigma: part of `covariance`.
    """

    offset_px: FloatArray
    common: FloatArray
    noise: FloatArray
    covariance: FloatArray
    brightness: FloatArray
    metric: FloatArray
    relief_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def edge_sigma_px(self) -> FloatArray:
        """Of each offset (n,), without the relief: how well the edge is seen, wherever the limb has it."""
        own = np.diag(self.covariance) - self.relief_px**2
        return np.sqrt(np.maximum(own, np.diag(self.noise)))


def match_scans(view: ScanView, fit: DiskFit) -> ScanMatch:
    """Return the offsets of scans, with what they are uncertain by."""
    field = fit.system.field.part_covariance(fit.prior, fit.brightness_dn)
    weight = np.linalg.inv(_sample_covariance(view, fit, EDGES**2 * field))
    design = np.stack([view.limb, np.ones_like(view.model)], axis=-1)
    both = np.matmul(np.swapaxes(design, 1, 2), weight)
    gain = np.matmul(np.linalg.inv(_safe(np.matmul(both, design))), both)[:, 0]
    level = both[:, 1]
    metric = weight - level[:, :, None] * level[:, None] / level.sum(axis=1)[:, None, None]
    noise = _pixel_noise(view, gain)
    return ScanMatch(
        offset_px=np.einsum("nw,nw->n", gain, view.data - view.model),
        common=np.einsum("nw,nwp->np", gain, view.common),
        noise=noise,
        covariance=noise + _surface_covariance(view, fit, gain) + TABLES_PX**2 * np.eye(len(gain)),
        brightness=_brightness(view),
        metric=metric,
        relief_px=fit.prior.rough_px,
    )


def _brightness(view: ScanView) -> FloatArray:
    """Return data over model (n,) of each scan, its background taken out."""
    weight = np.where(view.blocked, 0.0, 1.0 / view.variance)
    total = np.maximum(weight.sum(axis=1), 1e-300)
    data, model = (v - ((weight * v).sum(axis=1) / total)[:, None] for v in (view.data, view.model))
    power = (weight * model * model).sum(axis=1)
    return np.asarray((weight * data * model).sum(axis=1) / np.maximum(power, 1e-300))


def _sample_covariance(view: ScanView, fit: DiskFit, field: FloatArray) -> FloatArray:
    """Return V (n, w, w) with an albedo's covariance (k, k) over the arcs.

    A sample every half pixel holds half of a pixel's information: its variance counts double.
    """
    out = np.matmul(view.parts @ field, np.swapaxes(view.parts, 1, 2))
    grain = fit.prior.grain * view.model
    out += grain[:, :, None] * grain[:, None] * (view.cell[:, :, None] == view.cell[:, None])
    index = np.arange(out.shape[1])
    out[:, index, index] += view.variance / STEP_PX * np.where(view.blocked, BLOCKED, 1.0)
    return np.asarray(out)


def _safe(matrix: FloatArray) -> FloatArray:
    """Return matrices (n, q, q) that can be inverted where a scan says nothing."""
    diagonal = np.maximum(np.einsum("nii->ni", matrix), 1e-30)
    return np.asarray(matrix + 1e-10 * diagonal[:, :, None] * np.eye(matrix.shape[-1]))


def _pixel_noise(view: ScanView, gain: FloatArray) -> FloatArray:
    """Return the covariance (n, n) of offsets from the noise of pixels, which neighbouring scans share."""
    weights = view.sampler.pixel_weights(gain)
    scaled = weights.multiply(np.where(view.use, view.variance_plane, 0.0).reshape(1, -1))
    return np.asarray((scaled @ weights.T).toarray())


def _surface_covariance(view: ScanView, fit: DiskFit, gain: FloatArray) -> FloatArray:
    """Return the covariance (n, n) of offsets from albedo, its grain, and the heights of the limb."""
    pieces, angle = len(fit.piece_albedo), view.fan.angle_rad
    shares = piece_shares(angle, pieces)
    parts, limb = np.einsum("nw,nwk->nk", gain, view.parts), np.einsum("nw,nw->n", gain, view.limb)
    cells = [np.where(view.cell == c, gain * view.model, 0.0).sum(axis=1) for c in np.unique(view.cell)]
    piece = shares.argmax(axis=1)
    grain = fit.prior.grain**2 * (np.transpose(cells) @ cells) * (piece[:, None] == piece)
    surface = fit.system.field.scattered(fit.prior, fit.brightness_dn, shares, parts, limb)
    return np.asarray(surface + grain)


def correlate_scans(match: ScanMatch, model: FloatArray, data: FloatArray, blocked: BoolArray) -> FloatArray:
    """Return correlations (n, k) in -1..1 of models (n, w) with windows of data (n, w + k - 1); nan where unusable."""
    windows = sliding_window_view(np.where(blocked, 0.0, data), model.shape[1], axis=1)
    weighted = np.matmul(match.metric, model[..., None])[..., 0]
    norm = np.einsum("nw,nw->n", weighted, model)
    both = np.einsum("nkw,nw->nk", windows, weighted)
    power = np.einsum("nkw,nkw->nk", np.matmul(windows, match.metric), windows)
    share = sliding_window_view(blocked, model.shape[1], axis=1).mean(axis=-1)
    good = (share <= BLOCKED_SHARE) & (norm > 0.0)[:, None] & (power > 0.0)
    below = np.sqrt(np.where(good, norm[:, None] * np.where(good, power, 1.0), 1.0))
    return np.where(good, np.clip(both / below, -1.0, 1.0), np.nan)
