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
from opnav_workbench.bodies.disk.limb_light import hats

__all__ = ["HiddenAlbedo", "hidden_albedo"]

DEEPEST_WIDTHS = 4.0  # of the PSF: K is 2 % there
DEPTHS, ALONG = 6, 3  # points of Gauss-Legendre: in depth, and along a piece


@dataclass(frozen=True, slots=True, eq=False)
class HiddenAlbedo:
    """The integral as a sum over m places on a piece of limb.

    Attributes
    ----------
    weight : (m,) array
        Of the field at each place, px.
    apart_rad : (n // 2 + 1, m, m) array
        From each place of a piece to those of the piece so many pieces on.
    pieces
        n.
    """

    weight: FloatArray
    apart_rad: FloatArray
    pieces: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def covariance_px2(self, length_rad: float) -> FloatArray:
        """Return the covariance (n, n) of the pieces' steps for a field of a correlation length."""
        by_lag = np.einsum("i,lij,j->l", self.weight, np.exp(-self.apart_rad / length_rad), self.weight)
        lag = np.abs(np.subtract.outer(np.arange(self.pieces), np.arange(self.pieces)))
        return np.asarray(by_lag[np.minimum(lag, self.pieces - lag)])


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
    point, share = np.polynomial.legendre.leggauss(DEPTHS)
    deepest = min(DEEPEST_WIDTHS * width_px, radius_px * (1.0 - np.cos(node_rad[-1])))
    depth = 0.5 * deepest * (point + 1.0)
    kernel = 0.5 * deepest * share * np.exp(-0.25 * (depth / width_px) ** 2)
    within = 1.0 - depth / radius_px
    arc = np.concatenate([np.arccos(within), node_rad])
    weight = np.concatenate([kernel, -hats(within, node_rad) @ kernel])
    along, part = np.polynomial.legendre.leggauss(ALONG)
    turn = along * (np.pi / pieces)
    place = _on_body(arc[:, None], turn).reshape(-1, 3)
    lags = np.arange(pieces // 2 + 1) * (2.0 * np.pi / pieces)
    beside = _on_body(arc[None, :, None], turn + lags[:, None, None]).reshape(len(lags), -1, 3)
    cosine = np.einsum("ic,ljc->lij", place, beside)
    return HiddenAlbedo(
        np.multiply.outer(weight, 0.5 * part).ravel(), np.arccos(np.clip(cosine, -1.0, 1.0)), pieces
    )


def _on_body(arc_rad: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return unit vectors (..., 3) at arcs from the limb and angles along it."""
    cosine, sine = np.cos(arc_rad), np.sin(arc_rad)
    x, y, z = np.broadcast_arrays(cosine * np.cos(turn_rad), cosine * np.sin(turn_rad), sine)
    return np.stack([x, y, z], axis=-1)
