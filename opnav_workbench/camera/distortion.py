"""Optical distortion: from ideal (gnomonic) focal-plane coordinates to those on the detector, and back.

Flow   direction -> ideal (x, y) mm -> here -> distorted (x, y) mm -> pixel
Axes   x along increasing pixel, y along increasing line, origin at the boresight
Units  mm in and out; what the coefficients carry stands with each model

A model is written in one direction, the one its coefficients are published in; the other is found by Newton's
method with the analytic Jacobian.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import CameraError

__all__ = [
    "BrownDistortion",
    "DirectDistortion",
    "Distortion",
    "InverseDistortion",
    "NoDistortion",
    "OwenDistortion",
    "undistort",
]

CONVERGED_MM = 1e-12  # five orders below what 1e-6 px needs, four above rounding on a 30 mm detector
ROUNDING = 4.0 * np.finfo(np.float64).eps  # a point far off the detector cannot be known better
MAX_ITERATIONS = 50  # Newton needs 3 to 6; more means that the point has no origin under this model


class Distortion(ABC):
    """An optical distortion; every method takes (..., 2) mm, and a point it cannot map becomes nan."""

    __slots__ = ()

    @abstractmethod
    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""

    @abstractmethod
    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""

    @abstractmethod
    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""


class DirectDistortion(Distortion):
    """A distortion whose coefficients give distorted from ideal coordinates."""

    __slots__ = ()

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates by Newton's method, converged to 1e-12 mm (nan where it cannot be)."""
        return _newton(self.distort, self.jacobian, np.asarray(xy_mm, dtype=np.float64))


class InverseDistortion(Distortion):
    """A distortion whose coefficients give ideal from distorted coordinates."""

    __slots__ = ()

    @abstractmethod
    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector by Newton's method (nan where it does not converge)."""
        return _newton(self.undistort, self.undistort_jacobian, np.asarray(xy_mm, dtype=np.float64))

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        return inverse_2x2(self.undistort_jacobian(self.distort(xy_mm)))


def undistort(distortion: Distortion, xy_mm: ArrayLike) -> FloatArray:
    """Return the ideal coordinates (..., 2) mm of points (..., 2) mm on the detector; nan where none are.

    Examples
    --------
    >>> lens = OwenDistortion(e2_per_mm2=2.7e-5, e5_per_mm=-1.9e-5, e6_per_mm=-2.9e-5)
    >>> undistort(lens, lens.distort([[6.0, -3.0]])).round(12)
    array([[ 6., -3.]])
    """
    return distortion.undistort(xy_mm)


@dataclass(frozen=True, slots=True)
class NoDistortion(Distortion):
    """A pinhole: distorted and ideal coordinates are the same."""

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return a copy of `xy_mm`."""
        return np.array(xy_mm, dtype=np.float64)

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return a copy of `xy_mm`."""
        return np.array(xy_mm, dtype=np.float64)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return identity matrices."""
        shape = np.shape(xy_mm)[:-1]
        return np.broadcast_to(np.eye(2), (*shape, 2, 2)).copy()


@dataclass(frozen=True, slots=True)
class OwenDistortion(DirectDistortion):
    """The JPL OpNav model of W. Owen in its six-term form.

    With r^2 = x^2 + y^2, the point (x, y) moves by

        (e2 r^2 + e4 r^4 + e5 y + e6 x) (x, y) + (e1 r + e3 r^3) (-y, x)

    Parameters
    ----------
    e1_per_mm, e3_per_mm3 : float
        Pinwheel terms.
    e2_per_mm2, e4_per_mm4 : float
        Radial terms.
    e5_per_mm, e6_per_mm : float
        Detector tilt about the x and the y axis. LORRI is calibrated with e2, e5 and e6 alone.

    References
    ----------
    Owen, "Methods of optical navigation", AAS 11-215 (2011); Owen and O'Connell, JPL IOM 343L-11-002 (2011),
    in the comments of NAIF kernel nh_lorri_v201.ti, whose signs (line axis along +Y of NH_LORRI) these are.
    """

    e1_per_mm: float = 0.0
    e2_per_mm2: float = 0.0
    e3_per_mm3: float = 0.0
    e4_per_mm4: float = 0.0
    e5_per_mm: float = 0.0
    e6_per_mm: float = 0.0

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = self.e2_per_mm2 * r2 + self.e4_per_mm4 * r2 * r2 + self.e5_per_mm * y + self.e6_per_mm * x
        pinwheel = (self.e1_per_mm + self.e3_per_mm3 * r2) * np.sqrt(r2)
        return np.stack([x + radial * x - pinwheel * y, y + radial * y + pinwheel * x], axis=-1)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        r = np.sqrt(r2)
        radial = self.e2_per_mm2 * r2 + self.e4_per_mm4 * r2 * r2 + self.e5_per_mm * y + self.e6_per_mm * x
        pinwheel = (self.e1_per_mm + self.e3_per_mm3 * r2) * r
        steep = 2.0 * self.e2_per_mm2 + 4.0 * self.e4_per_mm4 * r2
        radial_x, radial_y = steep * x + self.e6_per_mm, steep * y + self.e5_per_mm
        # d(pinwheel)/dx = (e1/r + 3 e3 r) x; at the center e1 r has a kink, but it is multiplied by y = 0
        # there
        twist = np.divide(self.e1_per_mm, r, out=np.zeros_like(r), where=r > 0.0) + 3.0 * self.e3_per_mm3 * r
        top = np.stack(
            [1.0 + radial + radial_x * x - twist * x * y, radial_y * x - pinwheel - twist * y * y], -1
        )
        low = np.stack(
            [radial_x * y + pinwheel + twist * x * x, 1.0 + radial + radial_y * y + twist * x * y], -1
        )
        return np.stack([top, low], axis=-2)


@dataclass(frozen=True, slots=True)
class BrownDistortion(DirectDistortion):
    """The Brown-Conrady model in the full form of OpenCV: rational radial, tangential and thin-prism terms.

    Coefficients are dimensionless: they act on tangents of angles (x, y)/focal_mm. OpenCV's ``fx, fy``
    divided by the focal length are the diagonal of ``Camera.pixel_from_mm``.

    Parameters
    ----------
    focal_mm : float
        Focal length, mm.
    k1, k2, k3, k4, k5, k6 : float
        Radial: (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
    p1, p2 : float
        Tangential.
    s1, s2, s3, s4 : float
        Thin prism: s1 r^2 + s2 r^4 along pixel, s3 r^2 + s4 r^4 along line.

    References
    ----------
    OpenCV, "Camera Calibration and 3D Reconstruction" (calib3d).
    """

    focal_mm: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    def __post_init__(self) -> None:
        if not self.focal_mm > 0.0:
            raise CameraError(
                f"Brown distortion: focal_mm is {self.focal_mm}; give a positive focal length in mm."
            )

    def _radial(self, r2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radial factor and its derivative by r^2."""
        top = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        low = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
        top_slope = self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3)
        low_slope = self.k4 + r2 * (2.0 * self.k5 + r2 * 3.0 * self.k6)
        with np.errstate(divide="ignore", invalid="ignore"):
            return top / low, (top_slope * low - top * low_slope) / (low * low)

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64) / self.focal_mm
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial, _ = self._radial(r2)
        cross = 2.0 * x * y
        u = x * radial + self.p1 * cross + self.p2 * (r2 + 2.0 * x * x) + r2 * (self.s1 + r2 * self.s2)
        v = y * radial + self.p1 * (r2 + 2.0 * y * y) + self.p2 * cross + r2 * (self.s3 + r2 * self.s4)
        return np.stack([u, v], axis=-1) * self.focal_mm

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64) / self.focal_mm
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial, slope = self._radial(r2)
        prism_u = 2.0 * (self.s1 + 2.0 * r2 * self.s2)
        prism_v = 2.0 * (self.s3 + 2.0 * r2 * self.s4)
        shear = 2.0 * (x * y * slope + self.p1 * x + self.p2 * y)
        uu = radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x + prism_u * x
        vv = radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x + prism_v * y
        return np.stack(
            [np.stack([uu, shear + prism_u * y], -1), np.stack([shear + prism_v * x, vv], -1)], axis=-2
        )


def inverse_2x2(matrices: FloatArray) -> FloatArray:
    """Return the inverses of matrices (..., 2, 2); a singular one becomes nan or inf, and no exception."""
    a, b, c, d = (matrices[..., i, j] for i in (0, 1) for j in (0, 1))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], axis=-2)
        return np.asarray(adjugate / (a * d - b * c)[..., None, None])


def _newton(
    function: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    target: FloatArray,
) -> FloatArray:
    """Solve function(x) = target for points (..., 2), from the target on; nan where it does not converge."""
    goal = target.reshape(-1, 2)
    points = goal.copy()
    tolerance = CONVERGED_MM + ROUNDING * np.abs(goal).max(axis=-1, initial=0.0)
    finite = np.isfinite(goal).all(axis=-1)
    points[~finite] = np.nan
    pending = np.flatnonzero(finite)
    with np.errstate(all="ignore"):
        for _ in range(MAX_ITERATIONS):
            error = function(points[pending]) - goal[pending]
            far = ~(np.abs(error).max(axis=-1, initial=0.0) < tolerance[pending])
            pending, error = pending[far], error[far]
            if len(pending) == 0:
                break
            points[pending] -= (inverse_2x2(jacobian(points[pending])) @ error[..., None])[..., 0]
    points[pending] = np.nan
    return points.reshape(target.shape)
