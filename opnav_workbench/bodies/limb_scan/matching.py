"""How far the data of a scan lie from the model along it, whatever the albedo: generalised least squares, scan by scan.

With m the model along a scan and m' its change per px of outward motion, the data are

    d = a m + o a m' + c + T w + noise,     w ~ N(0, (r a)^2)

a the brightness of this scan, c its background, T w light of an uneven albedo (`ScanProfiles`) with relative scatter
r. The offset o that explains most is the maximum of the correlation of data and model in the metric of all that may
differ besides, the inverse covariance of T w and noise; linearised about the model's place it is one step of
Gauss-Newton, exact where the iteration ends. With r = 0 this is the plain normalised cross-correlation. Over many lags the
model is compared with the data that lie there, in the same metric.

The scatter r is the one under which the data are most likely, all scans taken together (restricted maximum likelihood).

What all scans share  A scattering law or a PSF that is a little wrong moves the limb by the same amount all around (a PSF
20 % too wide by half a pixel), which a limb seen from one side only cannot tell from a shift of the body. But both change
the shape of the profile too, and the same way in every scan, which albedo does not: so they are solved for from all scans
together, and taken out where they are significant.

References: Rasmussen & Williams (2006), Gaussian Processes for Machine Learning, sections 2.7 and 5.4; Jackman & Dumont
(2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays

__all__ = [
    "LAW",
    "CommonTerms",
    "ScanMatch",
    "ScanSystem",
    "correlate_scans",
    "correlation_peaks",
    "find_roughness",
    "no_common_terms",
    "solve_common_terms",
]


# ---- How far the data of a scan lie from the model along it, whatever the albedo.

BLOCKED = 1e12  # factor on the variance of samples that do not count
TINY = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Offsets of n scans.

    Attributes
    ----------
    offset_px : (n,) array
    gain : (n, w) array
        Offset per unit of data: ``offset = gain @ data`` near zero.
    albedo : (n, j) array
        Offset that each part of an albedo of relative scatter 1 makes.
    motion : (n, 2) array
        Change of the offset per px that the center moves.
    brightness : (n,) array
    background_dn : (n,) array
    common : (n, g) array
        Change of the offset per unit of what all scans share.
    chi2, freedom : (n,) arrays
        Of each scan's own fit.
    """

    offset_px: FloatArray
    gain: FloatArray
    albedo: FloatArray
    motion: FloatArray
    brightness: FloatArray
    background_dn: FloatArray
    common: FloatArray
    chi2: FloatArray
    freedom: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


class ScanSystem:
    """The normal equations of n scans, for any roughness of the albedo.

    Parameters
    ----------
    data, model : (n, w) arrays
    slope : (n, w, 2) array
        Change of the model per px that the center moves along pixel and line.
    direction : (n, 2) array
    parts : (n, w, j) array
        Light of an uneven albedo per unit of brightness and relative scatter.
    variance : (n, w) array
        Of the noise of each sample.
    blocked : (n, w) array of bool
        Samples that do not count.
    brightness : (n,) array
        Expected, data over model.
    common : (n, w, g) array, optional
        Changes of the model that all scans share, per unit of g further unknowns.
    """

    def __init__(
        self,
        data: FloatArray,
        model: FloatArray,
        slope: FloatArray,
        direction: FloatArray,
        parts: FloatArray,
        variance: FloatArray,
        blocked: BoolArray,
        brightness: FloatArray,
        common: FloatArray | None = None,
    ) -> None:
        self.slope, self.brightness = slope, brightness
        shared = np.zeros((*model.shape, 0)) if common is None else common
        self._common = shared * brightness[:, None, None]
        outward = np.einsum("nwk,nk->nw", slope, direction)
        columns = [brightness[:, None] * outward, model, np.ones_like(model)]
        self._root = np.where(blocked, 1e-6, 1.0) / np.sqrt(variance)
        self._design = np.stack(columns, axis=-1) * self._root[..., None]
        self._data = data * self._root
        self._parts = parts * (brightness[:, None] * self._root)[..., None]
        self._count = (~blocked).sum(axis=1)
        self._shared = self._common * self._root[..., None]
        self._inner = np.matmul(np.swapaxes(self._parts, 1, 2), self._parts)
        self._sum_up()

    def _sum_up(self) -> None:
        columns = np.concatenate([self._design, self._data[..., None], self._shared], axis=-1)
        self._cross = np.matmul(np.swapaxes(self._parts, 1, 2), columns)
        self._normal = np.matmul(np.swapaxes(columns, 1, 2), columns)

    def without_common(self, values: FloatArray) -> "ScanSystem":
        """Return the system with changes (g,) that all scans share taken out of the data."""
        other = copy(self)
        other._data = self._data - self._shared @ values  # noqa: SLF001 - its own kind
        other._sum_up()  # noqa: SLF001
        return other

    def common_normal(self, roughness: float, chosen: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return normal matrix (g, g) and right side (g,) of what the chosen scans share, all else solved for."""
        reduced = self._reduced(roughness)
        own, mixed, shared = reduced[:, :3, :3], reduced[:, :3, 3:], reduced[:, 3:, 3:]
        left = shared - np.swapaxes(mixed, 1, 2) @ np.linalg.solve(_safe(own), mixed)
        total = left[chosen].sum(axis=0)
        return total[1:, 1:], total[1:, 0]

    def _reduced(self, roughness: FloatArray | float) -> FloatArray:
        """Return the normal matrices (n, 4 + g, 4 + g) of design, data and what is shared, the albedo's parts taken out."""
        return np.asarray(
            self._normal - np.swapaxes(self._cross, 1, 2) @ self._shrunk(roughness) @ self._cross
        )

    def _shrunk(self, roughness: FloatArray | float) -> FloatArray:
        """Return the posterior covariance (n, j, j) of the albedo's parts for a prior scatter (n,) or one for all."""
        r2 = np.broadcast_to(np.square(roughness), len(self._inner))[:, None, None]
        return np.asarray(r2 * np.linalg.inv(np.eye(self._inner.shape[-1]) + r2 * self._inner))

    def likelihood(self, roughness: float) -> FloatArray:
        """Return the restricted logarithmic likelihood (n,) of each scan's data."""
        reduced = self._reduced(roughness)
        design, mixed = reduced[:, :3, :3], reduced[:, :3, 3]
        solved = np.linalg.solve(_safe(design), mixed[..., None])[..., 0]
        chi2 = reduced[:, 3, 3] - np.einsum("ni,ni->n", mixed, solved)
        grown = np.eye(self._inner.shape[-1]) + roughness**2 * self._inner
        return np.asarray(-0.5 * (chi2 + np.linalg.slogdet(grown)[1] + np.linalg.slogdet(_safe(design))[1]))

    def match(self, roughness: FloatArray | float) -> ScanMatch:
        """Return the offsets for an albedo of given roughness."""
        shrunk = self._shrunk(roughness)
        reduced = self._reduced(roughness)
        inverse = np.linalg.inv(_safe(reduced[:, :3, :3]))
        solved = np.einsum("nij,nj->ni", inverse, reduced[:, :3, 3])
        # Weights of the whitened data in each unknown: the design less what the albedo's parts explain of it.
        explained = self._parts @ (shrunk @ self._cross[..., :3])
        gain = np.einsum("nj,nwj->nw", inverse[:, 0], self._design - explained) * self._root
        brightness = self.brightness
        chi2 = reduced[:, 3, 3] - np.einsum("ni,ni->n", reduced[:, :3, 3], solved)
        return ScanMatch(
            offset_px=solved[:, 0],
            gain=gain,
            albedo=np.einsum("nw,nwj->nj", gain / self._root, self._parts),
            motion=brightness[:, None] * np.einsum("nw,nwk->nk", gain, self.slope),
            brightness=solved[:, 1],
            background_dn=solved[:, 2],
            common=np.einsum("nw,nwg->ng", gain, self._common),
            chi2=chi2,
            freedom=np.maximum(self._count - 3.0, 1.0),
        )

    def metric(self, roughness: float) -> tuple[FloatArray, FloatArray]:
        """Return the metric of the correlation: a diagonal (n, w), and columns (n, w, j + 1) whose squares it lacks."""
        root = np.linalg.cholesky(self._shrunk(roughness) + TINY * np.eye(self._inner.shape[-1]))
        parts = self._parts @ root
        level = self._design[..., 2]
        level = level - np.einsum("nwj,nj->nw", parts, np.einsum("nwj,nw->nj", parts, self._design[..., 2]))
        norm = np.sqrt(np.maximum(np.einsum("nw,nw->n", level, self._design[..., 2]), TINY))
        columns = np.concatenate([parts, (level / norm[:, None])[..., None]], axis=-1)
        return self._root**2, columns * self._root[..., None]


def _safe(matrix: FloatArray) -> FloatArray:
    """Return matrices that can be inverted where a scan says nothing."""
    diagonal = np.einsum("nii->ni", matrix)
    scale = np.maximum(np.abs(diagonal).max(axis=1), TINY)
    return np.asarray(matrix + 1e-13 * scale[:, None, None] * np.eye(matrix.shape[-1]))


# ---- Cross-correlation of data and model along scans, over many lags.

BLOCKED_SHARE = 0.1  # of a window's samples: more of them unusable, and a lag says nothing


def correlate_scans(
    system: ScanSystem, model: FloatArray, data: FloatArray, blocked: BoolArray, roughness: float
) -> FloatArray:
    """Return correlations (n, k) in -1..1 of models (n, w) with windows of data (n, w + k - 1); nan where unusable."""
    diagonal, columns = system.metric(roughness)
    data = np.where(blocked, 0.0, data)
    windows, squares = (sliding_window_view(d, model.shape[1], axis=1) for d in (data, data**2))
    lacks = np.einsum("nw,nwj->nj", model, columns)
    weighted = diagonal * model - np.einsum("nwj,nj->nw", columns, lacks)
    norm = np.einsum("nw,nw->n", weighted, model)
    both = np.einsum("nkw,nw->nk", windows, weighted, optimize=True)
    power = np.einsum("nkw,nw->nk", squares, diagonal, optimize=True)
    power = power - np.square(np.matmul(windows, columns)).sum(axis=-1)
    share = sliding_window_view(blocked, model.shape[1], axis=1).mean(axis=-1)
    good = (share <= BLOCKED_SHARE) & (norm > 0.0)[:, None] & (power > 0.0)
    below = np.sqrt(np.where(good, norm[:, None] * np.where(good, power, 1.0), 1.0))
    return np.where(good, np.clip(both / below, -1.0, 1.0), np.nan)


def correlation_peaks(correlation: FloatArray, lag_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return place (n,) px and height (n,) of each scan's maximum, refined with a parabola; nan without one inside.

    Examples
    --------
    >>> lag = np.arange(-3.0, 4.0)
    >>> place, height = correlation_peaks(0.9 - 0.1 * (lag - 0.2)[None] ** 2, lag)
    >>> place.round(3), height.round(3)
    (array([0.2]), array([0.9]))
    """
    filled = np.where(np.isfinite(correlation), correlation, -2.0)
    rows = np.arange(len(filled))
    best = filled.argmax(axis=1)
    inner = np.clip(best, 1, filled.shape[1] - 2)
    left, middle, right = (filled[rows, inner + k] for k in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    found = (best == inner) & (bend < 0.0) & (np.minimum(left, right) >= -1.0)
    shift = np.where(found, 0.5 * (left - right) / np.where(found, bend, -1.0), 0.0)
    place = lag_px[inner] + (lag_px[1] - lag_px[0]) * shift
    height = middle - 0.25 * (left - right) * shift
    return np.where(found, place, np.nan), np.where(found, height, np.nan)


# ---- What all scans share beside the center.

LAW, BLUR = 0, 1  # share of another law (`AdjustedLaw`); variance added to the PSF, px^2
LAW_SIGMA = 0.5  # a priori: half the way from Lambert to Lommel-Seeliger
BLUR_SIGMA = 0.5  # a priori, of the PSF's variance: a width known to a quarter
SIGNIFICANT = 5.0  # sigmas
ROUGHNESSES = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2)
SPOKEN_FOR = 4.0  # gain in logarithmic likelihood that makes an albedo uneven


@dataclass(frozen=True, slots=True, eq=False)
class CommonTerms:
    """Values (g,) of what all scans share, and their covariance (g, g); zero where nothing was significant."""

    values: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def no_common_terms() -> CommonTerms:
    """Return that nothing is known to be wrong."""
    return CommonTerms(np.zeros(2), np.zeros((2, 2)))


def solve_common_terms(
    system: ScanSystem, roughness: float, chosen: BoolArray, psf_variance_px2: float, alike: float
) -> CommonTerms:
    """Solve for what the chosen scans share; what is not significant is left at zero.

    `alike` is the number of neighbouring scans that tell the same.
    """
    normal, right = (part / alike for part in system.common_normal(roughness, chosen))
    prior = _prior(psf_variance_px2)
    active = np.array([True, True])
    while active.any():
        rows = np.ix_(active, active)
        covariance = np.linalg.inv(normal[rows] + prior[rows])
        values = covariance @ right[active]
        strength = np.abs(values) / np.sqrt(np.diag(covariance))
        if strength.min() >= SIGNIFICANT:
            out = no_common_terms()
            all_values, all_covariance = np.array(out.values), np.array(out.covariance)
            all_values[active], all_covariance[rows] = values, covariance
            return CommonTerms(all_values, all_covariance)
        active[np.flatnonzero(active)[strength.argmin()]] = False
    return no_common_terms()


def find_roughness(system: ScanSystem, chosen: BoolArray, psf_variance_px2: float) -> float:
    """Return the albedo's relative scatter under which the chosen scans are most likely; 0 if they do not ask for one.

    What they share is free, so that a wrong scattering law does not pass for a rough albedo.
    """
    prior = _prior(psf_variance_px2)

    def likelihood(roughness: float) -> float:
        normal, right = system.common_normal(roughness, chosen)
        shared = 0.5 * right @ np.linalg.solve(normal + prior, right)
        return float(system.likelihood(roughness)[chosen].sum() + shared)

    tried = (0.0, *ROUGHNESSES)
    found = [likelihood(roughness) for roughness in tried]
    best = int(np.argmax(found))
    return 0.0 if found[best] < found[0] + SPOKEN_FOR else tried[best]


def _prior(psf_variance_px2: float) -> FloatArray:
    return np.diag([LAW_SIGMA**-2.0, (BLUR_SIGMA * psf_variance_px2) ** -2.0])
