"""What an elliptical Gaussian leaves of a real PSF: a smooth correction of the light before it is integrated over pixels.

The correction is a Gaussian process on the plane, with lengths in sigmas of the PSF and densities in those of the
Gaussian's peak: a smooth layer and a fine one for core and rings, a coarse one for wings. Being densities of light, their
pixel shares add up to the same flux at every sub-pixel phase. A fourth, weak layer is what pixels make of the light
beyond adding it up: edges less sensitive, charge that spreads. The modes are the eigenvectors of each layer's covariance.

Reference: Rasmussen & Williams (2006), Gaussian Processes for Machine Learning, chapters 2 and 8.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.special import i0e

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, readonly
from opnav_workbench.constants import PIXEL_VARIANCE_PX2

__all__ = [
    "PRIOR_AMPLITUDES",
    "PsfCorrection",
    "PsfEvidence",
    "layout_of_modes",
    "mode_layers",
    "mode_products",
    "mode_shares",
    "phases_of_a_pixel",
    "round_and_other",
]


@dataclass(frozen=True, slots=True)
class _Layer:
    """A square of cubic B-splines; lengths in sigmas of the PSF, densities in those of the Gaussian's peak."""

    spacing: float
    half_nodes: int  # on each side of the middle one
    length: float  # over which the correction changes
    core: float  # scale of the fall of its amplitude, amplitude (1 + (r / core)^2)^-power
    amplitude: float
    power: float
    integrated: bool = True  # over the pixels; else in units of the PSF that is integrated already


LAYERS = (
    _Layer(0.8, 6, 1.6, 2.0, 1.0, 2.0),  # smooth
    _Layer(0.6, 6, 0.8, 1.5, 1.0, 2.0),  # fine
    _Layer(2.5, 5, 3.5, 4.0, 0.1, 1.5),  # wings
    _Layer(0.6, 6, 1.0, 1.5, 0.2, 2.0, integrated=False),  # pixels
)
# Of the layers' modes. Simulated disks, obstructed Airy patterns and Moffat profiles have half of it; the fine layer's was
# raised until stars of real frames, which fall at other phases in each, repeat nearly within their sigmas.
PRIOR_AMPLITUDES = (0.5, 0.6, 0.5, 0.2)
LEAST_VARIANCE = 1e-4  # of a layer's largest mode: weaker ones change no pixel that anybody could measure
ROUND_SHARE = (
    0.5  # of the variance of a mode that is called round; but for the square of nodes it would be 0 or 1
)
PHASES = 8  # along each axis of a pixel
PEAK_DENSITY = 1.0 / (2.0 * np.pi)  # of a Gaussian, per sigma^2


@cache
def _modes(layer: _Layer) -> FloatArray:
    """Modes (k, side, side) of a layer: densities as coefficients of B-splines, [mode, line, pixel]."""
    at, side = _nodes(layer), 2 * layer.half_nodes + 1
    square = np.sum((at[:, None] - at) ** 2, axis=-1)
    value, vector = np.linalg.eigh(_fall(layer) * np.exp(-0.5 * square / layer.length**2))
    kept = value > LEAST_VARIANCE * value[-1]
    modes = PEAK_DENSITY * (vector[:, kept] * np.sqrt(value[kept])).T[::-1]
    return readonly(modes.reshape(-1, side, side))


def _nodes(layer: _Layer) -> FloatArray:
    """Places (side^2, 2) of a layer's nodes in sigmas."""
    at = layer.spacing * np.arange(-layer.half_nodes, layer.half_nodes + 1)
    return np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)


def _fall(layer: _Layer) -> FloatArray:
    """Product of the amplitudes at two nodes each."""
    fall = layer.amplitude * (1.0 + np.sum(_nodes(layer) ** 2, axis=1) / layer.core**2) ** -layer.power
    return np.asarray(fall[:, None] * fall)


@cache
def round_and_other() -> tuple[FloatArray, IntArray]:
    """Return a rotation (k, k) of the modes into such as are round and such as are not, and their groups (k,).

    A group is twice the layer, plus one for what is not round. Most of what a PSF has beyond a Gaussian, wings, rings or a
    flat core, is round: each of the two has a variance of its own. The layer of pixels, which are square, is one group.
    """
    layers = mode_layers()
    turn, groups = np.eye(len(layers)), 2 * layers
    for i, layer in enumerate(LAYERS):
        if layer.integrated:
            rows = np.flatnonzero(layers == i)
            share, axes = np.linalg.eigh(_round_part(layer))
            turn[np.ix_(rows, rows)] = axes
            groups[rows] += share < ROUND_SHARE
    groups.setflags(write=False)
    return readonly(turn), groups


def _round_part(layer: _Layer) -> FloatArray:
    """Covariance (k, k) of the modes' amplitudes, before 1 each, if only the mean over all turns of the layer is left."""
    radius = np.sqrt(np.sum(_nodes(layer) ** 2, axis=1)) / layer.length
    mean = np.exp(-0.5 * (radius[:, None] - radius) ** 2) * i0e(radius[:, None] * radius)
    modes = _modes(layer).reshape(-1, len(radius)) / PEAK_DENSITY
    inverse = modes / np.sum(modes**2, axis=1, keepdims=True)
    return np.asarray(inverse @ (_fall(layer) * mean) @ inverse.T)


@cache
def mode_layers() -> IntArray:
    """Return the layer (k,) that each mode belongs to."""
    layers = np.concatenate([np.full(len(_modes(layer)), i, np.int64) for i, layer in enumerate(LAYERS)])
    layers.setflags(write=False)
    return layers


def layout_of_modes() -> FloatArray:
    """Return numbers that change when the modes would: a row for each layer."""
    return np.array(
        [
            [*(float(getattr(layer, name)) for name in layer.__slots__), float(len(_modes(layer)))]
            for layer in LAYERS
        ]
    )


def phases_of_a_pixel() -> FloatArray:
    """Return places (64, 2) all over a pixel, about its middle."""
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    return np.stack(np.meshgrid(phase, phase), axis=-1).reshape(-1, 2)


def mode_shares(sigma_px: float, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
    """Return pixel shares (n, size, size, k) of all modes for points at centers (n, 2); boxes as in `Psf.box`."""
    parts = []
    for layer in LAYERS:
        along_pixel, along_line = (
            _axis(layer, sigma_px, first[:, axis] - center[:, axis], size)[0] for axis in (0, 1)
        )
        lines = np.einsum("nyi,kij->nykj", along_line, _modes(layer), optimize=True)
        parts.append(np.einsum("nykj,nxj->nyxk", lines, along_pixel, optimize=True))
    return np.concatenate(parts, axis=-1)


def mode_products(
    sigma_px: float, center: FloatArray, first: FloatArray, size: int, light: FloatArray
) -> FloatArray:
    """Return the sums (k, r) of all modes' shares, those of `mode_shares`, times each of r lights (r, n, size, size)."""
    parts = []
    for layer in LAYERS:
        along_pixel, along_line = (
            _axis(layer, sigma_px, first[:, axis] - center[:, axis], size)[0] for axis in (0, 1)
        )
        at_nodes = np.sum(np.swapaxes(along_line, 1, 2) @ light @ along_pixel, axis=1)
        parts.append(np.tensordot(_modes(layer), at_nodes, ([1, 2], [1, 2])))
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True, eq=False)
class PsfEvidence:
    """What stars say of the amplitudes of the modes, the prior not counted.

    Attributes
    ----------
    matrix : (k, k) array
        Information.
    right : (k,) array
        Information times the amplitudes that explain the stars best.
    """

    matrix: FloatArray
    right: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def total(cls, parts: Sequence["PsfEvidence"]) -> "PsfEvidence":
        """Return what several say together; nothing, if none."""
        count = len(mode_layers())
        matrix = sum((part.matrix for part in parts), start=np.zeros((count, count)))
        return cls(matrix, sum((part.right for part in parts), start=np.zeros(count)))


@dataclass(frozen=True, slots=True, eq=False)
class PsfCorrection:
    """A correction as it was learned, with its covariance.

    Attributes
    ----------
    sigma_px
        Of the Gaussian that it corrects.
    amplitudes : (k,) array
        Of the modes.
    root : (k, r) array
        Root of their covariance: amplitudes scatter by `root` times standard normal numbers.
    evidence
        What the stars of this picture alone say of it; None where none taught it.
    n_stars
        How many these are.
    shape_scatter
        One sigma by which their own log scales and ellipticities differ from it, that believed beforehand of too few stars;
        None where none taught it.
    """

    sigma_px: float
    amplitudes: FloatArray
    root: FloatArray
    evidence: PsfEvidence | None = None
    n_stars: int = 0
    shape_scatter: float | None = None
    _coefficients: tuple[FloatArray, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        layers = mode_layers()
        coefficients = (
            np.tensordot(self.amplitudes[layers == i], _modes(layer), 1) for i, layer in enumerate(LAYERS)
        )
        object.__setattr__(self, "_coefficients", tuple(coefficients))
        freeze_arrays(self)

    def as_error(self) -> "PsfCorrection":
        """Return no correction, whose covariance holds this one and its own: the expected square of what is left out."""
        root = np.column_stack([self.root, self.amplitudes])
        return PsfCorrection(self.sigma_px, np.zeros_like(self.amplitudes), root)

    def evaluate(
        self, center: FloatArray, first: FloatArray, size: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pixel shares (n, size, size) and their derivatives with the center along pixel and line, 1/px."""
        n = len(center)
        value, d_pixel, d_line = np.zeros((3, n, size, size))
        offset = (
            first - center
        ).T.ravel()  # both axes at once: what is around the numbers takes longer than they
        for layer, coefficients in zip(LAYERS, self._coefficients, strict=True):
            light, change = _axis(layer, self.sigma_px, offset, size)
            x, dx = np.swapaxes(light[:n], 1, 2), np.swapaxes(change[:n], 1, 2)
            lines = light[n:] @ coefficients
            value += lines @ x
            d_pixel += lines @ dx
            d_line += change[n:] @ coefficients @ x
        return value, d_pixel, d_line

    def errors(self, center: FloatArray, first: FloatArray, size: int) -> FloatArray:
        """Return independent one-sigma errors (n, size, size, r) of the pixel shares."""
        return mode_shares(self.sigma_px, center, first, size) @ self.root


def _axis(layer: _Layer, sigma_px: float, offset: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Light (n, size, nodes) of the B-splines in the pixels of an axis, and its derivatives with the center, 1/px."""
    nodes = np.arange(-layer.half_nodes, layer.half_nodes + 1)
    if not layer.integrated:
        width = float(np.hypot(sigma_px, np.sqrt(PIXEL_VARIANCE_PX2)))
        spline = _Spline((offset[:, None] + np.arange(size))[..., None] / (layer.spacing * width) - nodes)
        return spline.value() / width, -spline.slope() / (layer.spacing * width**2)
    edges = offset[:, None] - 0.5 + np.arange(size + 1)
    spline = _Spline(edges[..., None] / (layer.spacing * sigma_px) - nodes)
    cumulated, density = spline.cumulated(), spline.value()
    return layer.spacing * (cumulated[:, 1:] - cumulated[:, :-1]), -(
        density[:, 1:] - density[:, :-1]
    ) / sigma_px


class _Spline:
    """The cubic B-spline of unit spacing at places."""

    def __init__(self, at: FloatArray) -> None:
        distance = np.abs(at)
        self._at = at
        self._inner, self._outer = np.maximum(1.0 - distance, 0.0), np.maximum(2.0 - distance, 0.0)
        # Products: powers of arrays take ten times as long.
        self._inner2, self._outer2 = self._inner * self._inner, self._outer * self._outer

    def cumulated(self) -> FloatArray:
        """Integral from below."""
        beyond = (self._outer2 * self._outer2 - 4.0 * self._inner2 * self._inner2) / 24.0
        return np.asarray(np.where(self._at > 0.0, 1.0 - beyond, beyond))

    def value(self) -> FloatArray:
        """The spline."""
        return np.asarray((self._outer2 * self._outer - 4.0 * self._inner2 * self._inner) / 6.0)

    def slope(self) -> FloatArray:
        """Its derivative."""
        return np.asarray(np.sign(self._at) * (2.0 * self._inner2 - 0.5 * self._outer2))
