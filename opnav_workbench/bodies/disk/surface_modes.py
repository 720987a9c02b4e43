"""The albedo of a disk that is not much wider than the PSF: smooth modes of all that is in sight, each spread as light is.

A piece of limb shows no light of its own there: what lies on one side shines on the other, and a patch is seen as a shift
of all light. An albedo that changed from piece to piece would not be believed of such a picture, and so no patch at all.

Modes   Polynomials in the plane of the sky, orthonormal over the disk in sight. Their amplitudes have the covariance of the
        field on the body, projected onto them; what they leave out of it the PSF hides.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import linalg
from scipy.interpolate import CubicSpline

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_cells import piece_angles
from opnav_workbench.bodies.disk.limb_field import (
    ALBEDO,
    APART,
    BLOCK,
    BROAD_RAD,
    HEMISPHERES,
    LENGTH,
    Amplitudes,
    FieldPrior,
    relief_covariance,
)
from opnav_workbench.bodies.disk.ring import RingPrior, ring_prior

__all__ = ["SurfaceField", "SurfaceModes", "surface_field"]

# A polynomial of degree n has half waves of 2 / n of the radius: the PSF leaves 5 % of the first that is not among them.
DEGREE, DEGREE_BY_WIDTHS, HIGHEST_DEGREE = 2.0, 1.2, 10
PLACES = 300  # on the disk, for the projection
LENGTHS_RAD = np.geomspace(0.05, 1.2, 16)  # of the correlation, between which its projection is a spline
RIM = 0.9  # of the radius: where the albedo counts as that of the limb


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceModes:
    """Polynomials over a disk of radius 1.

    Attributes
    ----------
    powers : (k, 2) array of int
        Of the monomials.
    mix : (k, k) array
        What the monomials have of each polynomial.
    """

    powers: np.ndarray
    mix: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def count(self) -> int:
        """Number of modes, k."""
        return len(self.powers)

    def at(self, share: FloatArray, angle_rad: FloatArray) -> FloatArray:
        """Return the modes (k, n) at shares (n,) of the limb's radius in directions (n,)."""
        return self.mix.T @ _monomials(self.powers, share * np.cos(angle_rad), share * np.sin(angle_rad))


def _monomials(powers: np.ndarray, x: FloatArray, y: FloatArray) -> FloatArray:
    most = int(powers.max(initial=0)) + 1
    by_x, by_y = (np.vander(v, most, increasing=True).T for v in (x, y))
    return np.asarray(by_x[powers[:, 0]] * by_y[powers[:, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceField:
    """The field of a small disk whose limb has j pieces: k modes, and the heights of the pieces.

    Attributes
    ----------
    parts
    pieces
        Number of pieces of limb, j.
    patches
        Covariance (k, k) of the amplitudes of patches by the logarithm of their length, for a standard deviation of 1.
    broad : (k, k) array
        That of hemispheres, as much as they may differ.
    """

    parts: SurfaceModes
    pieces: int
    patches: CubicSpline
    broad: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def split(self, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what pieces have of their own (0, j, c), and what the amplitudes have (k, j, c), of parts of the light."""
        return parts[:0], parts

    def ring(self, prior: FieldPrior, brightness_dn: float) -> RingPrior:  # noqa: ARG002  heights are no light
        """Return the precision of the heights as a ring of blocks of `BLOCK` pieces."""
        covariance = relief_covariance(prior, np.arange(2 * BLOCK), self.pieces)
        return ring_prior(covariance[:BLOCK, :BLOCK], covariance[BLOCK:, :BLOCK], self.pieces // BLOCK)

    def amplitudes(self, prior: FieldPrior) -> Amplitudes:
        """Return the covariance of the amplitudes."""
        at, variance = float(np.log(prior.length_rad)), prior.albedo**2
        patches, broad = variance * self.patches(at), prior.hemispheres**2 * self.broad
        changes = {ALBEDO: 2.0 * patches, LENGTH: variance * self.patches(at, 1), HEMISPHERES: 2.0 * broad}
        return Amplitudes.correlated(patches + broad, changes)

    def albedo(self, own: FloatArray, amplitudes: FloatArray) -> FloatArray:  # noqa: ARG002  pieces have none
        """Return the albedo of the parts of the light (1, k), which is that of all pieces."""
        return amplitudes[None]

    def at_limb(self, albedo: FloatArray) -> FloatArray:
        """Return the albedo near the limb (j, 1) of that of the parts."""
        angle = piece_angles(self.pieces)
        return (albedo @ self.parts.at(np.full(self.pieces, RIM), angle)).T

    def at_rim(self, albedo: FloatArray) -> FloatArray:
        """Return that of all light (j,), the first mode's."""
        return np.full(self.pieces, albedo[0, 0])

    def part_covariance(self, prior: FieldPrior, brightness_dn: float) -> FloatArray:
        """Return the covariance (k, k) of the parts of a piece."""
        return brightness_dn**2 * self.amplitudes(prior).covariance

    def scattered(
        self, prior: FieldPrior, brightness_dn: float, shares: FloatArray, parts: FloatArray, limb: FloatArray
    ) -> FloatArray:
        """Return the covariance (n, n) that the field gives to sums of parts (n, k) and of heights (n,).

        `shares` (n, j) are those of the pieces.
        """
        heights = shares * limb[:, None]
        relief = relief_covariance(prior, np.arange(self.pieces), self.pieces)
        field = self.part_covariance(prior, brightness_dn)
        return np.asarray(parts @ field @ parts.T + heights @ relief @ heights.T)


def surface_field(radius_px: float, width_px: float, pieces: int, hemispheres: float) -> SurfaceField:
    """Return the field of a small disk.

    Parameters
    ----------
    width_px
        Sigma of the PSF, the pixel's own width included.
    pieces
        That the limb has, so many times `BLOCK`.
    hemispheres
        What whole hemispheres may differ by, relative.
    """
    degree = round(DEGREE + DEGREE_BY_WIDTHS * radius_px / width_px)
    modes, patches, broad = _projected(min(degree, HIGHEST_DEGREE))
    return SurfaceField(modes, pieces, patches, hemispheres**2 * broad)


@lru_cache(maxsize=HIGHEST_DEGREE)
def _projected(degree: int) -> tuple[SurfaceModes, CubicSpline, FloatArray]:
    """Return the modes up to a degree, and the covariances of their amplitudes: `SurfaceField`."""
    powers = np.array([(a, n - a) for n in range(degree + 1) for a in range(n + 1)])
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(PLACES)  # as seeds of a sunflower: even over the disk
    share = np.sqrt((np.arange(PLACES) + 0.5) / PLACES)
    x, y = share * np.cos(turn), share * np.sin(turn)
    q, r = np.linalg.qr(_monomials(powers, x, y).T)
    upward = np.sign(np.diag(r))  # the first mode is 1, not -1: the brightness of the disk
    q, r, root = q * upward, r * upward[:, None], np.sqrt(PLACES)
    mix = linalg.solve_triangular(r, np.eye(len(powers))) * root
    place = np.stack([x, y, np.sqrt(1.0 - share**2)])
    cosine = np.clip(place.T @ place, -1.0, 1.0)

    def projected(field: FloatArray) -> FloatArray:
        own = np.asarray(q.T @ field @ q) / PLACES
        return own + APART * float(np.trace(own)) / len(own) * np.eye(len(own))

    apart = np.arccos(cosine)
    patches = np.stack([projected(np.exp(-apart / length)) for length in LENGTHS_RAD])
    broad = projected(np.exp((cosine - 1.0) / BROAD_RAD**2))
    return SurfaceModes(powers, mix), CubicSpline(np.log(LENGTHS_RAD), patches), broad
