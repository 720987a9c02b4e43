"""What pieces of a limb have of their own: an albedo at some arcs from the limb, and the limb's height.

The albedo is a random field on the body: patches with a covariance that is exponential in the distance on it, as of a
surface that is divided by boundaries at random places, and hemispheres that differ, which are few smooth modes. Patches and
heights are a ring of blocks of pieces (`opnav_workbench.bodies.disk.ring`).

Order  piece, node; the last of q nodes is the height of the limb, px, all others are albedos

A disk that is not much wider than the PSF has no pieces that show light of their own:
`opnav_workbench.bodies.disk.surface_modes`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import factorial
from typing import NamedTuple, Protocol

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.crossings import RELIEF_RAD
from opnav_workbench.bodies.disk.hidden_albedo import ArcHats, HiddenAlbedo, hidden_albedo
from opnav_workbench.bodies.disk.limb_cells import piece_angles
from opnav_workbench.bodies.disk.limb_light import LightParts
from opnav_workbench.bodies.disk.ring import RingPrior, ring_prior
from opnav_workbench.bodies.silhouette import TURN

__all__ = [
    "ALBEDO",
    "APART",
    "BLOCK",
    "BROAD_RAD",
    "GRAIN",
    "HEMISPHERES",
    "LENGTH",
    "Amplitudes",
    "DiskField",
    "FieldPrior",
    "LimbField",
    "limb_field",
    "relief_covariance",
]

ALBEDO, LENGTH, GRAIN, ROUGH, HEMISPHERES = range(5)  # of the logarithms of a prior

BLOCK = 4  # pieces: with their neighbors they hold distances up to 7
BROAD_RAD = 1.0  # over which hemispheres differ: data of a small disk cannot tell that from another center
HIGHEST_DEGREE = 6  # of polynomials on a sphere: what is left out of the hemispheres is a thousandth
APART = 1e-6  # variance of a node by itself: at the middle of a small disk those of all pieces are one place
KEPT_VARIANCE = 1.0 - 1e-4  # by the modes of hemispheres
RIM_RAD = 0.3  # arc over which the albedo tells how bright a piece of limb is


@dataclass(frozen=True, slots=True)
class FieldPrior:
    """Hyperparameters of the random field.

    Attributes
    ----------
    albedo
        Relative standard deviation of the albedo.
    length_rad
        Over which it is correlated.
    grain
        Relative standard deviation of what differs from cell to cell.
    rough_px
        Standard deviation of the limb.
    on_slopes
        Whether the albedo is relative to the light of slopes that face the Sun: terrain shines where a smooth body has no
        light.
    hemispheres
        What whole hemispheres differ by over what they may: over the albedo sigma of the body's figure.
    """

    albedo: float
    length_rad: float
    grain: float
    rough_px: float
    on_slopes: bool = False
    hemispheres: float = 1.0

    def with_slopes(self, radius_px: float) -> "FieldPrior":
        """Return the prior with cells at least as uneven as slopes of the relief leave their light.

        Ground that rises by the limb's relief over its length is so steep, in radians, and its light differs by about as
        much. Light that happens to fit better is no evidence of where the center is.
        """
        return replace(self, grain=max(self.grain, self.rough_px / (RELIEF_RAD * radius_px)))

    def logarithms(self) -> FloatArray:
        """Return the logarithms (5,)."""
        return np.log([self.albedo, self.length_rad, self.grain, self.rough_px, self.hemispheres])

    @classmethod
    def from_logarithms(cls, values: FloatArray, *, on_slopes: bool = False) -> "FieldPrior":
        """Return the prior of logarithms (5,)."""
        albedo, length, grain, rough, hemispheres = (float(v) for v in np.exp(values))
        return cls(albedo, length, grain, rough, on_slopes, hemispheres)


class Amplitudes(NamedTuple):
    """What is believed of amplitudes that all pieces share.

    Attributes
    ----------
    covariance, precision : (r, r) arrays
        Relative.
    log_determinant
        Of the covariance.
    changes : mapping of int to (r, r) array
        Of the covariance, with those of the logarithms of a prior that it depends on.
    """

    covariance: FloatArray
    precision: FloatArray
    log_determinant: float
    changes: Mapping[int, FloatArray]

    @classmethod
    def correlated(cls, covariance: FloatArray, changes: Mapping[int, FloatArray]) -> "Amplitudes":
        """Return that of a covariance."""
        value, vector = np.linalg.eigh(covariance)
        return cls(covariance, (vector / value) @ vector.T, float(np.log(value).sum()), changes)

    @classmethod
    def alike(cls, sigma: float, count: int, logarithm: int) -> "Amplitudes":
        """Return that of independent ones with a standard deviation that one of the logarithms of a prior is of."""
        unit, variance = np.eye(count), np.full(count, sigma**2)
        covariance = variance * unit
        return cls(covariance, unit / variance, float(np.log(variance).sum()), {logarithm: 2.0 * covariance})


class DiskField(Protocol):
    """What a picture's light may differ by from that of an even disk of j pieces, in k parts of the light.

    Pieces have albedos of their own, which are a ring of blocks with their heights, and all pieces share r amplitudes.
    """

    @property
    def pieces(self) -> int:
        """Number of pieces, j."""

    @property
    def parts(self) -> LightParts:
        """Of the light, k."""

    def split(self, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what of parts (k, j, c) pieces have of their own (q - 1, j, c), and what the amplitudes have (r, j, c)."""

    def ring(self, prior: FieldPrior, brightness_dn: float) -> RingPrior:
        """Return the precision of what pieces have of their own, DN, and of their heights: blocks of `BLOCK` pieces."""

    def amplitudes(self, prior: FieldPrior) -> Amplitudes:
        """Return what is believed of the amplitudes."""

    def albedo(self, own: FloatArray, amplitudes: FloatArray) -> FloatArray:
        """Return the albedo of the parts (j, k), or (1, k) if pieces share it, by own (j, q - 1) and shared (r,)."""

    def at_limb(self, albedo: FloatArray) -> FloatArray:
        """Return the albedo on the body (j, m) at m places near each piece of limb."""

    def at_rim(self, albedo: FloatArray) -> FloatArray:
        """Return the albedo (j,) that tells how bright the light of each piece of limb is."""

    def part_covariance(self, prior: FieldPrior, brightness_dn: float) -> FloatArray:
        """Return the covariance (k, k) of the parts of a piece."""

    def scattered(
        self, prior: FieldPrior, brightness_dn: float, shares: FloatArray, parts: FloatArray, limb: FloatArray
    ) -> FloatArray:
        """Return the covariance (n, n) of sums of parts (n, k) and of heights (n,) of pieces that have `shares` (n, j)."""


def relief_covariance(prior: FieldPrior, pieces: np.ndarray, around: int) -> FloatArray:
    """Return the covariance (m, m) of the heights of some pieces (m,) of all that are around."""
    apart = np.abs(pieces[:, None] - pieces)
    turn = np.minimum(apart, around - apart) * (TURN / around)
    return np.asarray(prior.rough_px**2 * np.exp(-turn / RELIEF_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class LimbField:
    """The field of a limb of j pieces, with k albedos in each.

    Attributes
    ----------
    parts
        Hats of the albedo, k.
    place : (j, k, 3) array
        Of the nodes, on a unit sphere: x along pixel, y along line, z toward the camera.
    modes : (j, k, r) array
        Albedo of the hemispheres, for independent amplitudes of 1.
    hidden
        Albedo between the nodes.
    """

    parts: ArcHats
    place: FloatArray
    modes: FloatArray
    hidden: HiddenAlbedo

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def pieces(self) -> int:
        """Number of pieces, j."""
        return len(self.place)

    def ring(self, prior: FieldPrior, brightness_dn: float) -> RingPrior:
        """Return the precision of patches, DN, and heights as a ring of blocks of `BLOCK` pieces."""
        two = np.arange(2 * BLOCK)
        covariance = self._covariance(prior, brightness_dn, two)
        s = len(covariance) // 2
        return ring_prior(covariance[:s, :s], covariance[s:, :s], self.pieces // BLOCK)

    def split(self, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the parts as they are (k, j, c), and those of the hemispheres (r, j, c)."""
        return parts, np.matmul(parts.transpose(1, 2, 0), self.modes).transpose(2, 0, 1)

    def amplitudes(self, prior: FieldPrior) -> Amplitudes:
        """Return what is believed of the hemispheres."""
        return Amplitudes.alike(prior.hemispheres, self.modes.shape[-1], HEMISPHERES)

    def albedo(self, own: FloatArray, amplitudes: FloatArray) -> FloatArray:
        """Return the albedo of the parts (j, k)."""
        return np.asarray(own + self.modes @ amplitudes)

    def at_limb(self, albedo: FloatArray) -> FloatArray:
        """Return the albedo at the nodes (j, k): that of the parts."""
        return albedo

    def at_rim(self, albedo: FloatArray) -> FloatArray:
        """Return the mean albedo (j,) near the limb."""
        weight = np.exp(-self.parts.node_rad / RIM_RAD)
        return np.asarray(albedo @ weight / weight.sum())

    def part_covariance(self, prior: FieldPrior, brightness_dn: float) -> FloatArray:
        """Return the covariance (k, k) of the nodes of a piece."""
        return self._whole_covariance(prior, brightness_dn, np.arange(1))[:-1, :-1]

    def scattered(
        self, prior: FieldPrior, brightness_dn: float, shares: FloatArray, parts: FloatArray, limb: FloatArray
    ) -> FloatArray:
        """Return the covariance (n, n) that the field gives to sums of parts (n, k) and of heights (n,).

        `shares` (n, j) are those of the pieces.
        """
        seen = np.column_stack([parts, limb])
        response = (shares[:, :, None] * seen[:, None]).reshape(len(seen), -1)
        field = self._whole_covariance(prior, brightness_dn, np.arange(self.pieces))
        return np.asarray(response @ field @ response.T)

    def _whole_covariance(self, prior: FieldPrior, brightness_dn: float, pieces: np.ndarray) -> FloatArray:
        """Return the covariance of all that some pieces (m,) have, hemispheres included: (m q, m q)."""
        out = self._covariance(prior, brightness_dn, pieces)
        modes = self.modes[pieces]
        m, k, r = modes.shape
        flat = modes.reshape(m * k, r)
        broad = (prior.hemispheres * brightness_dn) ** 2 * (flat @ flat.T)
        out.reshape(m, k + 1, m, k + 1)[:, :-1, :, :-1] += broad.reshape(m, k, m, k)
        return out

    def _covariance(self, prior: FieldPrior, brightness_dn: float, pieces: np.ndarray) -> FloatArray:
        """Return the covariance of patches and heights of some pieces (m,): (m q, m q)."""
        m, k = len(pieces), self.place.shape[1]
        place = self.place[pieces].reshape(-1, 3)
        chord = np.arccos(np.clip(place @ place.T, -1.0, 1.0))
        patches = (prior.albedo * brightness_dn) ** 2 * np.exp(-chord / prior.length_rad)
        patches[np.diag_indices(len(patches))] *= 1.0 + APART
        rough = relief_covariance(prior, pieces, self.pieces)
        hidden = prior.albedo**2 * self.hidden.covariance_px2(prior.length_rad)
        out = np.zeros((m, k + 1, m, k + 1))
        out[:, :-1, :, :-1] = patches.reshape(m, k, m, k)
        out[:, -1, :, -1] = rough + hidden[np.ix_(pieces, pieces)]
        return out.reshape(m * (k + 1), -1)


def limb_field(
    radius_px: float, width_px: float, node_rad: FloatArray, pieces: int, hemispheres: float
) -> LimbField:
    """Return the field of a limb; parameters as of `hidden_albedo`, `pieces` so many times `BLOCK`.

    Parameters
    ----------
    hemispheres
        What whole hemispheres may differ by, relative.
    """
    angle = piece_angles(pieces)
    cos_b, sin_b = np.cos(node_rad), np.broadcast_to(np.sin(node_rad), (pieces, len(node_rad)))
    x, y = np.cos(angle)[:, None] * cos_b, np.sin(angle)[:, None] * cos_b
    place = np.stack([x, y, sin_b], axis=-1)
    modes = hemispheres * _broad_modes(place.reshape(-1, 3))
    hidden = hidden_albedo(radius_px, width_px, node_rad, pieces)
    return LimbField(ArcHats(node_rad), place, modes.reshape(*place.shape[:2], -1), hidden)


def _broad_modes(place: FloatArray) -> FloatArray:
    """Return modes (n, r) of a field with the covariance exp((cos - 1) / `BROAD_RAD`^2) at places (n, 3) on a sphere.

    With the exponential's power series every monomial x^a y^b z^c is a mode, of the variance 1 / (a! b! c!).
    """
    powers = [p for p in product(range(HIGHEST_DEGREE + 1), repeat=3) if sum(p) <= HIGHEST_DEGREE]
    scaled = place / BROAD_RAD
    each = [np.prod(scaled**p, axis=1) / np.sqrt(float(np.prod([factorial(e) for e in p]))) for p in powers]
    monomials = np.stack(each, axis=1) * np.exp(-0.5 / BROAD_RAD**2)
    variance, mix = np.linalg.eigh(monomials.T @ monomials)
    left = np.cumsum(variance)
    kept = left > (1.0 - KEPT_VARIANCE) * left[-1]
    return np.asarray(monomials @ mix[:, kept])
