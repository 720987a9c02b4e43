"""Distortion as mapping programs, fisheye lenses and rovers' cameras state it.

`RadialDistortion`     radial as ISIS and Community Sensor Models have it: ideal from distorted coordinates
`TaylorDistortion`     polynomials of third degree (MESSENGER MDIS; "transverse" of Community Sensor Models)
`RationalDistortion`   quotients of polynomials of second degree (ExoMars TGO CaSSIS)
`FisheyeDistortion`    Kannala-Brandt: the angle, not its tangent, grows with the radius
`CahvorDistortion`     about an axis that is not the detector's: CAHVOR and, for what is far away, CAHVORE

Units, axes and the two directions are those of `opnav_workbench.camera.distortion`.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.camera.distortion import DirectDistortion, Distortion, InverseDistortion
from opnav_workbench.errors import CameraError

__all__ = [
    "CahvorDistortion",
    "FisheyeDistortion",
    "RadialDistortion",
    "RationalDistortion",
    "TaylorDistortion",
    "centered",
]


@dataclass(frozen=True, slots=True)
class RadialDistortion(InverseDistortion):
    """The radial model of ISIS: ``ideal = distorted (1 - k0 - k1 r^2 - k2 r^4 - k3 r^6)``, r mm as measured.

    References
    ----------
    ISIS, class CameraDistortionMap (``INS<id>_OD_K``); usgscsm, distortion type RADIAL.

    Examples
    --------
    >>> RadialDistortion(k1_per_mm2=1e-5).undistort([6.0, 0.0]).round(5)
    array([5.99784, 0.     ])
    """

    k0: float = 0.0
    k1_per_mm2: float = 0.0
    k2_per_mm4: float = 0.0
    k3_per_mm6: float = 0.0

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        factor, _ = self._factor(xy)
        return np.asarray(xy * factor[..., None])

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        factor, slope = self._factor(xy)
        return np.asarray(
            factor[..., None, None] * np.eye(2)
            + 2.0 * slope[..., None, None] * xy[..., :, None] * xy[..., None, :]
        )

    def _factor(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Ideal over distorted, and its derivative by r^2."""
        r2 = (xy * xy).sum(axis=-1)
        dr = self.k0 + r2 * (self.k1_per_mm2 + r2 * (self.k2_per_mm4 + r2 * self.k3_per_mm6))
        slope = self.k1_per_mm2 + r2 * (2.0 * self.k2_per_mm4 + r2 * 3.0 * self.k3_per_mm6)
        return 1.0 - dr, -slope


def _taylor_terms(xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The ten terms 1, x, y, x^2, xy, y^2, x^3, x^2 y, x y^2, y^3, and their slopes along x and y, (..., 10)."""
    x, y = xy[..., 0], xy[..., 1]
    one, zero = np.ones_like(x), np.zeros_like(x)
    terms = [one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
    along_x = [zero, one, zero, 2.0 * x, y, zero, 3.0 * x * x, 2.0 * x * y, y * y, zero]
    along_y = [zero, zero, one, zero, x, 2.0 * y, zero, x * x, 2.0 * x * y, 3.0 * y * y]
    return np.stack(terms, axis=-1), np.stack(along_x, axis=-1), np.stack(along_y, axis=-1)


def _set_coefficients(model: Distortion, shapes: dict[str, int]) -> None:
    for name, count in shapes.items():
        try:
            value = readonly(np.array(getattr(model, name), dtype=np.float64), (count,), name)
        except (TypeError, ValueError) as error:
            raise CameraError(f"{type(model).__name__}: {error}; give {count} numbers.") from error
        object.__setattr__(model, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class TaylorDistortion(DirectDistortion):
    """Distorted coordinates as polynomials of third degree of the ideal ones, mm.

    Attributes
    ----------
    x_coefficients, y_coefficients : (10,) arrays
        Of 1, x, y, x^2, x y, y^2, x^3, x^2 y, x y^2, y^3.

    References
    ----------
    MESSENGER MDIS instrument kernel msgr_mdis_v160.ti (``OD_T_X``, ``OD_T_Y``); usgscsm, distortion type TRANSVERSE.
    """

    x_coefficients: FloatArray
    y_coefficients: FloatArray

    def __post_init__(self) -> None:
        _set_coefficients(self, {"x_coefficients": 10, "y_coefficients": 10})

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        terms, _, _ = _taylor_terms(np.asarray(xy_mm, dtype=np.float64))
        return np.stack([terms @ self.x_coefficients, terms @ self.y_coefficients], axis=-1)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        _, along_x, along_y = _taylor_terms(np.asarray(xy_mm, dtype=np.float64))
        rows = [
            np.stack([along_x @ c, along_y @ c], axis=-1) for c in (self.x_coefficients, self.y_coefficients)
        ]
        return np.stack(rows, axis=-2)


@dataclass(frozen=True, slots=True, eq=False)
class RationalDistortion(InverseDistortion):
    """Ideal coordinates as quotients of quadratic polynomials of the distorted ones, mm.

    Attributes
    ----------
    x_numerator, y_numerator, denominator : (6,) arrays
        Coefficients of x^2, x y, y^2, x, y, 1.

    References
    ----------
    TGO CaSSIS instrument kernel em16_tgo_cassis_v07.ti (``OD_A1_CORR``, ``OD_A2_CORR``, ``OD_A3_CORR``).
    """

    x_numerator: FloatArray
    y_numerator: FloatArray
    denominator: FloatArray

    def __post_init__(self) -> None:
        _set_coefficients(self, {"x_numerator": 6, "y_numerator": 6, "denominator": 6})

    @property
    def polynomials(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Numerators along x and y, and the denominator."""
        return self.x_numerator, self.y_numerator, self.denominator

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        terms, _, _ = self._terms(np.asarray(xy_mm, dtype=np.float64))
        top = np.stack([terms @ self.x_numerator, terms @ self.y_numerator], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(top / (terms @ self.denominator)[..., None])

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        terms, along_x, along_y = self._terms(xy)
        low, ideal = terms @ self.denominator, self.undistort(xy)
        rows = [
            np.stack(
                [(s @ top - ideal[..., axis] * (s @ self.denominator)) / low for s in (along_x, along_y)],
                axis=-1,
            )
            for axis, top in enumerate((self.x_numerator, self.y_numerator))
        ]
        return np.stack(rows, axis=-2)

    @staticmethod
    def _terms(xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y = xy[..., 0], xy[..., 1]
        one, zero = np.ones_like(x), np.zeros_like(x)
        return (
            np.stack([x * x, x * y, y * y, x, y, one], axis=-1),
            np.stack([2.0 * x, y, zero, one, zero, zero], axis=-1),
            np.stack([zero, x, 2.0 * y, zero, one, zero], axis=-1),
        )


@dataclass(frozen=True, slots=True)
class FisheyeDistortion(DirectDistortion):
    """The fisheye of Kannala and Brandt: radius = focal length times ``t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)``.

    t is the angle from the boresight, rad. All directions in front of the camera are seen; at 90 deg and behind there are no
    gnomonic coordinates.

    References
    ----------
    Kannala & Brandt (2006), doi 10.1109/TPAMI.2006.153; coefficients as in OpenCV's fisheye module.

    Examples
    --------
    >>> lens = FisheyeDistortion(focal_mm=10.0)
    >>> float(lens.distort([10.0, 0.0])[0].round(6))  # 45 deg
    7.853982
    """

    least_stretch: ClassVar[float] = 1e-3  # the slope along the radius falls as cos^2

    focal_mm: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    def __post_init__(self) -> None:
        if not self.focal_mm > 0.0:
            raise CameraError(f"fisheye: focal_mm is {self.focal_mm}; give a positive focal length in mm.")

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        ratio, _ = self._ratio(np.hypot(xy[..., 0], xy[..., 1]) / self.focal_mm)
        return np.asarray(xy * ratio[..., None])

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates by Newton's method on the angle, which is better behaved than its tangent."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        radius = np.hypot(xy[..., 0], xy[..., 1]) / self.focal_mm
        angle = radius.copy()
        with np.errstate(all="ignore"):
            for _ in range(20):
                value, slope = self._radius(angle)
                angle = angle - (value - radius) / slope
            seen = (np.abs(self._radius(angle)[0] - radius) < 1e-12) & (angle < 0.5 * np.pi) & (angle >= 0.0)
            ratio = np.where(radius > 0.0, np.tan(angle) / np.where(radius > 0.0, radius, 1.0), 1.0)
        return np.asarray(xy * np.where(seen, ratio, np.nan)[..., None])

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        tangent = np.hypot(xy[..., 0], xy[..., 1]) / self.focal_mm
        ratio, along = self._ratio(tangent)
        unit = np.divide(
            xy, (tangent * self.focal_mm)[..., None], out=np.zeros_like(xy), where=tangent[..., None] > 0.0
        )
        outer = unit[..., :, None] * unit[..., None, :]
        return np.asarray(ratio[..., None, None] * np.eye(2) + (along - ratio)[..., None, None] * outer)

    def _radius(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius over focal length at an angle, and its slope."""
        t2 = angle * angle
        value = 1.0 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4)))
        slope = 1.0 + t2 * (3.0 * self.k1 + t2 * (5.0 * self.k2 + t2 * (7.0 * self.k3 + t2 * 9.0 * self.k4)))
        return angle * value, slope

    def _ratio(self, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distorted over ideal radius, and d(distorted)/d(ideal) along the radius."""
        radius, slope = self._radius(np.arctan(tangent))
        ratio = np.divide(radius, tangent, out=np.ones_like(tangent), where=tangent > 0.0)
        return ratio, slope / (1.0 + tangent * tangent)


@dataclass(frozen=True, slots=True, eq=False)
class CahvorDistortion(DirectDistortion):
    """Radial distortion about an axis of its own, as in the CAHVOR and CAHVORE models of rovers' cameras.

    With w the part of a direction along `axis` and u the part across, the direction becomes ``w + (1 + mu) u`` with
    ``mu = r0 + r1 c^2 + r2 c^4``; c is the tangent of the angle from the axis (`linearity` 1: CAHVOR), the angle (0) or its
    sine (-1), as a fisheye's CAHVORE has it, whose w is ``|u| / c``. The entrance pupil's way along the axis, CAHVORE's E,
    shifts only what is nearer than some hundred times the camera's size; it is left out.

    Attributes
    ----------
    focal_mm
        Of the camera.
    axis : (3,) array
        The model's O: unit vector in focal axes (pixel, line, boresight).

    References
    ----------
    Gennery (2006), doi 10.1007/s11263-006-5168-1; Di & Li (2004), doi 10.1029/2003JE002199.
    """

    focal_mm: float
    axis: FloatArray
    r0: float = 0.0
    r1: float = 0.0
    r2: float = 0.0
    linearity: float = 1.0

    least_stretch: ClassVar[float] = 1e-3

    def __post_init__(self) -> None:
        _set_coefficients(self, {"axis": 3})
        length = float(np.linalg.norm(self.axis))
        if not (self.focal_mm > 0.0 and length > 0.0 and -1.0 <= self.linearity <= 1.0):
            raise CameraError(
                "CAHVOR: give a positive focal_mm, an axis with a direction, linearity from -1 to 1."
            )
        object.__setattr__(self, "axis", readonly(self.axis / length, (3,), "axis"))

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        along, across = self._parts(np.asarray(xy_mm, dtype=np.float64))
        moved = self._moved(along, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.focal_mm * moved[..., :2] / moved[..., 2:])

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm, by complex steps."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        columns = []
        for axis in (0, 1):
            step = xy.astype(np.complex128)
            step[..., axis] += COMPLEX_STEP * 1j
            moved = self._moved(*self._parts(step))
            with np.errstate(divide="ignore", invalid="ignore"):
                columns.append((self.focal_mm * moved[..., :2] / moved[..., 2:]).imag / COMPLEX_STEP)
        return np.stack(columns, axis=-1)

    def _parts(self, xy: Any) -> tuple[Any, Any]:
        """A direction's length along the axis (...), and its part across (..., 3)."""
        vectors = np.concatenate([xy / self.focal_mm, np.ones((*xy.shape[:-1], 1))], axis=-1)
        along = vectors @ self.axis
        return along, vectors - along[..., None] * self.axis

    def _moved(self, along: Any, across: Any) -> Any:
        tangent2 = (across * across).sum(
            axis=-1
        ) / along**2  # of the angle from the axis; no square root at its zero
        if self.linearity == 1.0:
            chi2, depth = tangent2, along
        else:
            tangent = np.sqrt(tangent2 + TINY)
            angle = np.arctan(tangent)
            part = self.linearity
            chi = (
                np.sin(part * angle) / part
                if part < 0.0
                else (np.tan(part * angle) / part if part else angle)
            )
            chi2, depth = chi * chi, along * tangent / chi
        mu = self.r0 + chi2 * (self.r1 + chi2 * self.r2)
        return np.asarray(depth[..., None] * self.axis + (1.0 + mu)[..., None] * across)


def centered(model: Distortion) -> tuple[Distortion, FloatArray]:
    """Return a distortion that leaves the origin in place, and where the given one puts it, mm: both together are the same.

    A camera's center is where its boresight falls; kernels state polynomials that move it.
    """
    moved = np.asarray(model.distort(np.zeros(2)), dtype=np.float64)
    if isinstance(model, TaylorDistortion):
        zero = np.array([0.0] + 9 * [1.0])
        return TaylorDistortion(model.x_coefficients * zero, model.y_coefficients * zero), moved
    if isinstance(model, RationalDistortion):
        return RationalDistortion(*(_shifted(c, moved) for c in model.polynomials)), moved
    return model, np.zeros(2)


def _shifted(c: FloatArray, origin: FloatArray) -> FloatArray:
    """Coefficients of x^2, x y, y^2, x, y, 1 counted from another origin."""
    x, y = origin
    linear = [c[3] + 2.0 * c[0] * x + c[1] * y, c[4] + c[1] * x + 2.0 * c[2] * y]
    constant = c[5] + c[3] * x + c[4] * y + c[0] * x * x + c[1] * x * y + c[2] * y * y
    return np.array([c[0], c[1], c[2], *linear, constant])


COMPLEX_STEP = 1e-30
TINY = 1e-30  # of a squared tangent: keeps the quotient of two angles defined on the axis itself
