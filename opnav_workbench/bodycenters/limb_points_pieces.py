"""A limb divided into pieces of equal length, and the pixels about each.

Frame  (pixel, line); depth and offset are positive outward
Units  px
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.silhouette import TURN, Outline

__all__ = ["LimbPieces", "limb_pieces", "reach_px"]

PIECE_PX = 2.0  # as long as the PSF is wide: shorter pieces do not tell more
LEAST_PIECES, MOST_PIECES = 8, 360
PSF_REACH, RIM_PX = 3.0, 1.5  # sigmas of the PSF, and pixels beyond, to both sides of the limb


@dataclass(frozen=True, slots=True, eq=False)
class LimbPieces:
    """Pieces of limb of equal length, and the pixels about them.

    Attributes
    ----------
    angle_rad : (n,) array
        Of their middles about the center.
    point_px : (n, 2) array
        Middles on the predicted limb.
    normal : (n, 2) array
        Outward unit vectors.
    length_px : float
    pixel, line : (m,) arrays of int
        Pixels of the picture near the limb.
    piece : (m,) array of int
        The piece that each belongs to.
    depth_px : (m,) array
        Distance from the limb, positive outward.
    complete : (n,) array of bool
        Whether the piece lies on the detector with all its pixels.
    """

    angle_rad: FloatArray
    point_px: FloatArray
    normal: FloatArray
    length_px: float
    pixel: IntArray
    line: IntArray
    piece: IntArray
    depth_px: FloatArray
    complete: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)


def reach_px(picture: BodyPicture) -> float:
    """Return how far to both sides of the limb its light tells where it is, px."""
    return PSF_REACH * float(np.max(picture.psf.sigma_px)) + RIM_PX


def limb_pieces(
    outline: Outline, shape: tuple[int, ...], reach: float, offset_px: FloatArray | None = None
) -> LimbPieces:
    """Divide a limb into pieces, and the pixels within `reach` px of it among them.

    Parameters
    ----------
    outline : Outline
    shape : (int, int)
        Lines and pixels of the picture.
    reach : float
    offset_px : (n,) array, optional
        Where the limb of each piece really is, along its normal, if that is known; the pixels about it are taken.
    """
    stretch = np.hypot(outline.radius_px, outline.slope_px)
    travelled = np.concatenate([[0.0], np.cumsum(stretch) * TURN / len(stretch)])
    total = float(travelled[-1])
    n = int(np.clip(round(total / PIECE_PX), LEAST_PIECES, MOST_PIECES))
    grid = np.append(outline.angle_rad, np.pi)
    angle = np.interp((np.arange(n) + 0.5) * total / n, travelled, grid)
    offset = np.zeros(n) if offset_px is None else offset_px
    pixel, line = _near(outline, shape, reach + float(np.abs(offset).max()))
    away = np.stack([pixel, line], axis=-1) - outline.center_px
    at, radius = np.arctan2(away[:, 1], away[:, 0]), np.hypot(away[:, 0], away[:, 1])
    own = outline.radius(at)
    lean = own / np.interp(at, outline.angle_rad, stretch, period=TURN)
    depth = (radius - own) * lean
    piece = np.minimum((np.interp(at, grid, travelled) * n / total).astype(np.int64), n - 1)
    near = np.abs(depth - offset[piece]) <= reach
    point = outline.points(angle)
    normal = _normals(outline, angle)
    seen, size = point + offset[:, None] * normal, np.array(shape[::-1])
    whole = np.all((seen >= reach - 0.5) & (seen <= size - 0.5 - reach), axis=1)
    return LimbPieces(
        angle, point, normal, total / n,
        pixel[near], line[near], piece[near], depth[near], whole,
    )  # fmt: skip


def _near(outline: Outline, shape: tuple[int, ...], reach: float) -> tuple[IntArray, IntArray]:
    """Return (pixel, line) of the pixels in the rectangle around the limb."""
    low, high = outline.center_px - outline.reach_px[:2], outline.center_px + outline.reach_px[2:]
    first = np.clip(np.floor(low - reach), 0, None).astype(int)
    last = np.clip(np.ceil(high + reach), None, np.array(shape[::-1]) - 1).astype(int)
    line, pixel = np.mgrid[first[1] : last[1] + 1, first[0] : last[0] + 1]
    return pixel.ravel(), line.ravel()


def _normals(outline: Outline, angle: FloatArray) -> FloatArray:
    radius = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=TURN)
    cos, sin = np.cos(angle), np.sin(angle)
    normal = np.stack([slope * sin + radius * cos, radius * sin - slope * cos], axis=-1)
    return np.asarray(normal / np.hypot(radius, slope)[:, None])
