"""What pieces of a limb share, and the light's derivatives by it: the columns of a disk's likelihood.

Flow   shape of a disk, tables of its light -> places about its outline -> columns
Units  relative to the brightness of the tables, by px, rad and shares; DN by `columns_dn`
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_cells import LimbPlaces, between_pieces, square_corners
from opnav_workbench.bodies.disk.limb_light import PLANES, LimbLight
from opnav_workbench.bodies.silhouette import TURN, Outline, Silhouette

__all__ = ["DiskShape", "TabulatedDisk", "Unknown", "columns_dn", "disk_columns"]


class Unknown(IntEnum):
    """What all pieces of limb share, in the order of `MarginalSolution.theta`."""

    BRIGHTNESS = 0
    PIXEL = 1
    LINE = 2
    SIZE = 3
    AXIS_COS = 4
    AXIS_SIN = 5
    LAW = 6
    LAW_2 = 7
    STRAIN_ZZ = 8
    STRAIN_XZ = 9
    STRAIN_YZ = 10
    BLUR = 11
    WINGS = 12
    HALO = 13
    LEVEL = 14
    SLOPE_PIXEL = 15
    SLOPE_LINE = 16


SHARED = len(Unknown)
CENTER = [Unknown.PIXEL, Unknown.LINE]
FIGURE = [Unknown.SIZE, Unknown.AXIS_COS, Unknown.AXIS_SIN]
SHARES = [Unknown.LAW, Unknown.LAW_2]
STRAY = [Unknown.WINGS, Unknown.HALO]
SHADING = [Unknown.STRAIN_ZZ, Unknown.STRAIN_XZ, Unknown.STRAIN_YZ]
STRAINED = [Unknown.AXIS_COS, Unknown.AXIS_SIN, *SHADING]
MEANT = [Unknown.BLUR, *STRAY, *SHARES, *STRAINED]  # of theta: shares of the planes between light and relief
TABLES = len(PLANES)
# Columns beyond what is shared and the place of the limb: hats of the albedo, shading by the strains of the outline, relief.
ALBEDO, SHADED, RELIEF = slice(SHARED + 1, -3), [-3, -2], -1
# Columns of what moves with the limb, or lights it otherwise: as bright as it is there.
LOCAL = [*CENTER, *FIGURE, *SHARES, *SHADING, Unknown.BLUR, SHARED, *SHADED, RELIEF]


@dataclass(frozen=True, slots=True, eq=False)
class DiskShape:
    """Outline of a disk, and the law that its light has.

    Attributes
    ----------
    center_px : (2,) array
    log_size
        Logarithm of the size over the model's.
    strain : (5,) array
        As `opnav_workbench.bodies.strained.STRAINS`; the first two change the outline's radius as cos 2a and sin 2a.
    law : (2,) array
        As `opnav_workbench.bodies.disk.limb_light.limb_light` has it.
    blur_px2
        Variance of the PSF along each axis beyond its own.
    rough_px : (j,) array
        Height of the limb at each piece.
    """

    center_px: FloatArray
    log_size: float
    strain: FloatArray
    law: FloatArray
    blur_px2: float
    rough_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedDisk:
    """Tables of light, the shape they were made with, and the silhouette of the body under its strain, `strain` (5,).

    `slant` (n,) is `Outline.slant` there; `lit` (j,) says which pieces of limb the light shows.
    """

    shape: DiskShape
    strain: FloatArray
    silhouette: Silhouette
    slant: FloatArray
    light: LimbLight
    lit: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def tabulated(self) -> FloatArray:
        """What of theta (p,) is in the tables of light already; 0 for all else."""
        theta = np.zeros(SHARED)
        theta[SHARES], theta[STRAINED], theta[Unknown.BLUR] = self.shape.law, self.strain, self.shape.blur_px2
        return theta

    def sloped(self, theta: FloatArray) -> "TabulatedDisk":
        """Return tables with the slopes of the light that a solution (p,) means, not of the one they were made with."""
        shares = np.append(1.0, (theta - self.tabulated)[MEANT])
        return replace(self, light=self.light.sloped(shares))

    def slant_at(self, angle_rad: FloatArray) -> FloatArray:
        """Return the outline's slope over its radius, without the heights of its pieces, at angles (m,)."""
        n = len(self.slant)
        return np.asarray(self.slant[np.mod(np.round((angle_rad + np.pi) * (n / TURN)), n).astype(np.int64)])

    def outline(self, shape: DiskShape, *, rough: bool = True) -> Outline:
        """Return the outline of a shape near the tabulated one, with the heights of its pieces or without."""
        # At the tabulated size: a camera's distortion is not in proportion to it.
        plain = self.silhouette.at(shape.center_px, float(np.exp(-self.shape.log_size)))
        height = between_pieces(plain.angle_rad, shape.rough_px) if rough else 0.0
        return plain.strained(
            shape.log_size - self.shape.log_size, shape.strain[:2] - self.strain[:2], height
        )


def disk_columns(
    made: TabulatedDisk,
    shape: DiskShape,
    outline: Outline,
    near: LimbPlaces,
    *,
    on_slopes: bool,
    spread_px: FloatArray | None = None,
) -> FloatArray:
    """Return the derivatives of the light at n places about an outline of a shape, as `DiskFit.columns` has them.

    `on_slopes` says whether the hats are those of slopes that face the Sun; the light is a mean over squares whose pixels
    have `spread_px` (n,) as their standard deviation.
    """
    spread_px = np.zeros_like(near.depth_px) if spread_px is None else spread_px
    waves = Outline.waves(near.angle_rad, made.slant_at(near.angle_rad))
    strain = (shape.strain[:2] - made.strain[:2]) @ waves
    grown = shape.log_size - made.shape.log_size + strain
    corners = square_corners(outline, near, spread_px)
    shrunk = np.exp(-grown)
    corners = corners._replace(depth_px=corners.depth_px * shrunk[corners.of, None])
    slopes, tables = made.light.over(near.angle_rad, near.depth_px * shrunk, corners)
    slope, turn, by_variance = slopes
    m0, blur, wings, halo, law, law_2, by_cos, by_sin, *shading, relief = tables[:TABLES]
    # Light S that a PSF p of the variance v spreads to L keeps its share of the radius; but p keeps its width, and under a
    # strain G the light loses x G grad L + v div G grad L (p * (x S) = x L + v grad L for a Gaussian p).
    reach = np.maximum(near.limb_px + near.depth_px, 1.0)
    by_psf = -2.0 * made.light.psf_variance_px2 * np.stack([by_variance, by_variance - slope / reach])
    size, in_plane = by_psf - slope * reach
    m0 = m0 + grown * by_psf[0] + strain * (by_psf[1] - by_psf[0])
    away = (np.stack([near.pixel, near.line]) - outline.center_px[:, None]) / (0.5 * outline.diameter_px)
    columns = [
        m0, *(slope * near.shift.T + turn * near.turn.T), size, *(in_plane * waves), law, law_2,
        *shading, blur, wings, halo, np.ones_like(m0), *away, -slope,
    ]  # fmt: skip
    hats = made.light.hats_of(tables, on_slopes=on_slopes)
    return np.concatenate([np.stack(columns), hats, np.stack([by_cos, by_sin, relief])])


def columns_dn(columns: FloatArray, brightness_dn: float, lit_dn: FloatArray) -> FloatArray:
    """Return `DiskFit.columns` (p, ...), DN, of a limb that is as bright as `lit_dn` (...)."""
    out = columns.copy()
    out[LOCAL] *= lit_dn
    out[STRAY] *= brightness_dn
    return out
