"""What the horizon fit hands over beside the center: limb points, the ellipse of the model, and a free one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.geometry import Ellipse

__all__ = ["FreeEllipse", "LimbEllipse"]


@dataclass(frozen=True, slots=True, eq=False)
class FreeEllipse:
    """An ellipse of any center, size and orientation through the limb points, to check the body's model with.

    Attributes
    ----------
    ellipse, model : Ellipse
        Through the points, and the model's limb; px, distortion removed (pinhole camera of the same focal length).
    axes : (2, 2) array
        Rows: unit vectors (pixel, line) along the model's major and minor axis.
    ratio, ratio_sigma : (2,) arrays
        Radius of the free ellipse over the model's along these axes.
    residual_rms_px : float
        Of the points used.
    """

    ellipse: Ellipse
    model: Ellipse
    axes: FloatArray
    ratio: FloatArray
    ratio_sigma: FloatArray
    residual_rms_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class LimbEllipse:
    """Limb points of a body and what they were fitted with, in order along the limb.

    Attributes
    ----------
    angle_rad : (n,) array
        Of each piece of limb about the center, from +pixel toward +line.
    points_px : (n, 2) array
        Observed limb (pixel, line); nan where none was found.
    predicted_px : (n, 2) array
        The model's limb at the solution.
    normal : (n, 2) array
        Outward unit vectors.
    residual_px, sigma_px : (n,) arrays
        Observed minus predicted along the normal, and its noise.
    height : (n,) array
        Brightness, data over model.
    status : (n,) array of str
        ``used``, ``not_chosen`` (no lit limb there) or ``rejected``.
    reason : (n,) array of str
        Why not used, in plain words; empty for used ones.
    outline_px : (m, 2) array
        The model's limb at the solution, all around.
    rms_px : float
        Of the residuals used.
    rough_px : float
        Standard deviation of the limb about its model beyond the noise.
    rough_arc_px : float
        Length along the limb over which it is correlated.
    lit_arc_rad : float
        Angle about the center that the points used cover.
    covariance : (3, 3) array
        Of center pixel, line (px) and logarithm of the range; zeros where the range was not solved for.
    km_per_px : float
        At the body's center.
    free : FreeEllipse or None
        None where the points do not determine one, and for shape models.
    iterations : tuple of (float, float)
        Steps of the center, px.
    """

    angle_rad: FloatArray
    points_px: FloatArray
    predicted_px: FloatArray
    normal: FloatArray
    residual_px: FloatArray
    sigma_px: FloatArray
    height: FloatArray
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    outline_px: FloatArray
    rms_px: float
    rough_px: float
    rough_arc_px: float
    lit_arc_rad: float
    covariance: FloatArray
    km_per_px: float
    free: FreeEllipse | None
    iterations: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)
