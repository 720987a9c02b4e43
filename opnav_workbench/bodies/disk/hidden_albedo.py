"""What albedo between a field's nodes does to a limb: it moves what is taken for the limb's place.

    step = integral over depth x of K(x) d(x),    K(x) = exp(-x^2 / 4 s^2)

is the least-squares place of an edge of brightness 1, blurred by a Gaussian of width s, whose bright side has a relative
albedo 1 + d. Of a field on the body that is exponential in distance, d is the mean over a piece of limb less what hat
functions between its nodes have of it; near the limb a pixel is a long way on the body, and so d is never nothing. The
step's covariance between pieces follows from the field's by that integral.

Units  px, rad; of a field with a standard deviation of 1
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays

__all__ = ["ArcHats", "HiddenAlbedo", "hidden_albedo"]

DEEPEST_WIDTHS = 4.0  # of the PSF: K is 2 % there
# Points of Gauss-Legendre: from the limb inward, and over each half of what two pieces lie apart
ARCS, TURNS = 12, 5
FARTHEST = 4  # pieces: from there on less than a hundredth


@dataclass(frozen=True, slots=True, eq=False)
class HiddenAlbedo:
    """The integral as a sum over pairs of places on two pieces of limb.

    Attributes
    ----------
    weight : (p,) array
        Of each pair, px^2.
    apart_rad : (l, p) array
        Distance of each pair on the body, of pieces that are 0, 1, ... pieces apart.
    pieces
        That the limb has, n.
    """

    weight: FloatArray
    apart_rad: FloatArray
    pieces: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def covariance_px2(self, length_rad: float) -> FloatArray:
        """Return the covariance (n, n) of the pieces' steps for a field of a correlation length."""
        by_lag = np.exp(-self.apart_rad / length_rad) @ self.weight
        lag = np.abs(np.subtract.outer(np.arange(self.pieces), np.arange(self.pieces)))
        lag = np.minimum(lag, self.pieces - lag)
        return np.where(lag <= FARTHEST, by_lag[np.minimum(lag, FARTHEST)], 0.0)


def _hats(share: FloatArray, node_rad: FloatArray) -> FloatArray:
    """Return hat functions (k, n) of the arc at shares of the limb's radius."""
    arc = np.arccos(np.clip(share, 0.0, 1.0))
    up = np.clip((arc - node_rad[:-1, None]) / np.diff(node_rad)[:, None], 0.0, 1.0)
    hats = np.concatenate([np.ones((1, len(arc))), up])
    hats[:-1] -= up
    return np.asarray(hats)


@dataclass(frozen=True, slots=True, eq=False)
class ArcHats:
    """Hat functions of the arc from the limb, alike in all directions; `node_rad` (k,) are their peaks, from 0 upward."""

    node_rad: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def count(self) -> int:
        """Number of hats, k."""
        return len(self.node_rad)

    def at(self, share: FloatArray, angle_rad: FloatArray) -> FloatArray:  # noqa: ARG002  pieces have their own
        """Return the hats (k, n) at shares (n,) of the limb's radius in directions (n,)."""
        return _hats(share, self.node_rad)


def hidden_albedo(radius_px: float, width_px: float, node_rad: FloatArray, pieces: int) -> HiddenAlbedo:
    """Return the steps of limb of a disk.

    Parameters
    ----------
    width_px
        Sigma of the PSF, the pixel's own width included.
    node_rad : (k,) array
        Arcs from the limb at which the albedo has nodes.
    pieces
        That the limb has.
    """
    deepest = np.arccos(max(1.0 - DEEPEST_WIDTHS * width_px / radius_px, np.cos(node_rad[-1])))
    point, share = np.polynomial.legendre.leggauss(ARCS)
    arc = 0.5 * deepest * (point + 1.0)
    within = np.cos(arc)
    # An edge is moved by what lies at a depth, and depths grow with the sine of the arc.
    kernel = np.exp(-0.25 * (radius_px * (1.0 - within) / width_px) ** 2)
    kernel *= 0.5 * deepest * share * radius_px * np.sin(arc)
    arc = np.concatenate([arc, node_rad])
    weight = np.concatenate([kernel, -_hats(within, node_rad) @ kernel])
    turn, part = _turns_apart(pieces)
    cosine = np.cos(arc)[:, None] * np.cos(arc), np.sin(arc)[:, None] * np.sin(arc)
    between = cosine[0][..., None, None] * np.cos(turn) + cosine[1][..., None, None]
    apart = np.arccos(np.clip(between, -1.0, 1.0))  # (arc, arc, lag, turn)
    pairs = (weight[:, None] * weight)[..., None] * part
    return HiddenAlbedo(pairs.ravel(), np.moveaxis(apart, 2, 0).reshape(FARTHEST + 1, -1), pieces)


def _turns_apart(pieces: int) -> tuple[FloatArray, FloatArray]:
    """Return angles (lags, t) by which rays of two pieces differ, and how often each does (t,)."""
    point, share = np.polynomial.legendre.leggauss(TURNS)
    half = 0.5 * (point + 1.0)
    beside = np.concatenate([-half[::-1], half])
    often = np.concatenate([share[::-1], share]) * 0.5 * (1.0 - np.abs(beside))
    width = 2.0 * np.pi / pieces
    return (np.arange(FARTHEST + 1)[:, None] + beside) * width, often
