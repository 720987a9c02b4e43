"""Optical distortion: from ideal (gnomonic) focal-plane coordinates to those on the detector, and back.

Flow   direction -> ideal (x, y) mm -> here -> distorted (x, y) mm -> pixel
Axes   x along increasing pixel, y along increasing line, origin at the boresight
Units  mm in and out; what the coefficients carry stands with each model

`OwenDistortion`        the JPL OpNav model (LORRI)
`BrownDistortion`       Brown-Conrady in OpenCV's full form (OSIRIS-REx)
`SipDistortion`, `ForwardSipDistortion`    the SIP polynomials of FITS headers, reverse and forward
`LegendreDistortion`    the series of New Horizons' MVIC
More stand in `lens_models`: radial as in ISIS, polynomials in mm, fisheye, CAHVOR.

A model is written in one direction, the one its coefficients are published in; the other is found by Newton's method with
the analytic Jacobian. A polynomial folds back far from the detector; `reach_mm` says how far from the boresight it holds,
so that directions beyond do not appear on the detector.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike, NDArray

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import CameraError

__all__ = [
    "BrownDistortion",
    "DirectDistortion",
    "Distortion",
    "ForwardSipDistortion",
    "InverseDistortion",
    "LegendreDistortion",
    "NoDistortion",
    "OwenDistortion",
    "SipDistortion",
    "reach_mm",
    "sip_powers",
    "sip_terms",
]


# ---- Optical distortion: from ideal (gnomonic) focal-plane coordinates to those on the detector, and back.

CONVERGED_MM = 1e-12  # five orders below what 1e-6 px needs, four above rounding on a 30 mm detector
ROUNDING = 4.0 * np.finfo(np.float64).eps  # a point far off the detector cannot be known better
MAX_NEWTON_STEPS = 50  # Newton needs 3 to 6; more means that the point has no origin under this model


class Distortion(ABC):
    """An optical distortion; every method takes (..., 2) mm, and a point it cannot map becomes nan."""

    __slots__ = ()

    least_stretch: ClassVar[float] = (
        0.1  # d(distorted)/d(ideal) below this is no camera's any more, and soon folds
    )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Distortion):
            return NotImplemented
        return type(other) is type(self) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash((type(self), self._values()))

    def _values(self) -> tuple[Any, ...]:
        """Return what two distortions that are the same have in common."""
        values = (getattr(self, item.name) for item in fields(self))  # type: ignore[arg-type]
        return tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in values)

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
    e1_per_mm, e3_per_mm3
        Pinwheel terms.
    e2_per_mm2, e4_per_mm4
        Radial terms.
    e5_per_mm, e6_per_mm
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
        return _columns(x + radial * x - pinwheel * y, y + radial * y + pinwheel * x)

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
        return _matrices(
            1.0 + radial + radial_x * x - twist * x * y,
            radial_y * x - pinwheel - twist * y * y,
            radial_x * y + pinwheel + twist * x * x,
            1.0 + radial + radial_y * y + twist * x * y,
        )


@dataclass(frozen=True, slots=True)
class BrownDistortion(DirectDistortion):
    """The Brown-Conrady model in the full form of OpenCV: rational radial, tangential and thin-prism terms.

    Coefficients are dimensionless: they act on tangents of angles (x, y)/focal_mm. OpenCV's ``fx, fy``
    divided by the focal length are the diagonal of ``Camera.pixel_from_mm``.

    Parameters
    ----------
    focal_mm
        Focal length, mm.
    k1, k2, k3, k4, k5, k6
        Radial: (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
    p1, p2
        Tangential.
    s1, s2, s3, s4
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
        return _columns(u, v) * self.focal_mm

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
        return _matrices(uu, shear + prism_u * y, shear + prism_v * x, vv)


def _columns(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return vectors (..., 2) of their two components: `np.stack` of few points costs more than what is stacked."""
    out = np.empty((*first.shape, 2))
    out[..., 0], out[..., 1] = first, second
    return out


def _matrices(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Return matrices (..., 2, 2) of rows (a, b) and (c, d)."""
    out = np.empty((*a.shape, 2, 2))
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = a, b, c, d
    return out


def inverse_2x2(matrices: FloatArray) -> FloatArray:
    """Return the inverses of matrices (..., 2, 2); a singular one becomes nan or inf, and no exception."""
    a, b, c, d = (matrices[..., i, j] for i in (0, 1) for j in (0, 1))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(_matrices(d, -b, -c, a) / (a * d - b * c)[..., None, None])


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
        for _ in range(MAX_NEWTON_STEPS):
            error = function(points[pending]) - goal[pending]
            far = ~(np.abs(error).max(axis=-1, initial=0.0) < tolerance[pending])
            pending, error = pending[far], error[far]
            if len(pending) == 0:
                break
            points[pending] -= (inverse_2x2(jacobian(points[pending])) @ error[..., None])[..., 0]
    points[pending] = np.nan
    return points.reshape(target.shape)


# ---- Distortion given by polynomials: the SIP convention of FITS headers, and the Legendre series of MVIC.

LEGENDRE_DEGREE = 5
# Degrees (in x, in y) of the coefficients as the kernel lists them: total degree 1 to 5, x degree rising.
LEGENDRE_TERMS = tuple((i, n - i) for n in range(1, LEGENDRE_DEGREE + 1) for i in range(n + 1))
SIP_MAX_ORDER = 9  # the SIP convention's own limit

SipCoefficients = Mapping[tuple[int, int], float]  # value of u^p v^q by (p, q), px^(1 - p - q)


@dataclass(frozen=True, slots=True, eq=False)
class _SipPolynomials:
    """The map u' = u + f(u, v), v' = v + g(u, v) of pixel offsets from the boresight, acting on mm."""

    KEYWORDS: ClassVar[tuple[str, str]]  # prefixes of the header keywords along pixel and along line

    pixel_from_mm: FloatArray
    f: FloatArray
    g: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixel_from_mm", readonly(self.pixel_from_mm, (2, 2), "pixel_from_mm"))
        for name in ("f", "g"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None, None), name))

    @classmethod
    def from_coefficients(cls, pixel_from_mm: ArrayLike, f: SipCoefficients, g: SipCoefficients) -> Self:
        """Return the model of coefficients keyed by the powers (p, q) of u and v.

        Parameters
        ----------
        pixel_from_mm : (2, 2) array_like
            The camera's matrix, px/mm.
        f, g : mapping
            Coefficients along pixel and along line, px^(1 - p - q).
        """
        return cls(
            np.asarray(pixel_from_mm, dtype=np.float64), _coefficient_matrix(f), _coefficient_matrix(g)
        )

    @classmethod
    def from_keywords(cls, keywords: Mapping[str, Any], pixel_from_mm: ArrayLike) -> Self:
        """Return the model of a FITS header's keywords: ``AP_3_0``, ``BP_0_2``... or ``A_3_0``, ``B_0_2``...

        Raises
        ------
        CameraError
            The keywords hold no such coefficients.
        """
        along_pixel, along_line = (_sip_coefficients(keywords, prefix) for prefix in cls.KEYWORDS)
        return cls.from_coefficients(pixel_from_mm, along_pixel, along_line)

    def _map(self, xy_mm: ArrayLike) -> FloatArray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        shifts, _, mm_from_pixel = _sip_series(self)
        shift = _series_at(shifts, xy @ self.pixel_from_mm.T)
        return np.asarray(xy + shift @ mm_from_pixel.T)

    def _map_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        _, slopes, mm_from_pixel = _sip_series(self)
        rows = _series_at(slopes, xy @ self.pixel_from_mm.T).reshape(*xy.shape[:-1], 2, 2)
        return np.asarray(np.eye(2) + mm_from_pixel @ rows @ self.pixel_from_mm)


@lru_cache(maxsize=16)
def _sip_series(model: _SipPolynomials) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients [p, q, series] of f and g, those of df/du, df/dv, dg/du, dg/dv, and mm per pixel (2, 2)."""
    slopes = [np.asarray(polynomial.polyder(c, axis=axis)) for c in (model.f, model.g) for axis in (0, 1)]
    return (
        _stacked([model.f, model.g]),
        _stacked(slopes),
        readonly(np.linalg.inv(model.pixel_from_mm)),
    )


def _stacked(matrices: Sequence[NDArray[Any]]) -> FloatArray:
    """Matrices of coefficients as one array [p, q, series]; what the smaller ones lack is zero."""
    stacked = np.zeros((*np.max([matrix.shape for matrix in matrices], axis=0), len(matrices)))
    for index, matrix in enumerate(matrices):
        stacked[: matrix.shape[0], : matrix.shape[1], index] = matrix
    return readonly(stacked)


def _series_at(coefficients: FloatArray, uv: FloatArray) -> FloatArray:
    """Evaluate polynomials [p, q, series] at points (..., 2), all at once: an array (..., series)."""
    u, v = uv[..., 0].ravel(), uv[..., 1].ravel()
    values = polynomial.polyval(v, polynomial.polyval(u, coefficients), tensor=False)
    return np.ascontiguousarray(values.T, dtype=np.float64).reshape(*uv.shape[:-1], coefficients.shape[-1])


@dataclass(frozen=True, slots=True, eq=False)
class SipDistortion(_SipPolynomials, DirectDistortion):
    """SIP distortion from its reverse polynomials AP, BP, which give distorted from ideal pixel offsets.

    Build it with `from_coefficients` or `from_keywords`. The inverse is numerical: forward coefficients A, B
    of the same header agree with it to their fit error only.

    References
    ----------
    Shupe et al. (2005), ADASS XIV, ASP Conf. Ser. 347, 491.

    Examples
    --------
    >>> lens = SipDistortion.from_coefficients([[76.9, 0], [0, 76.9]], {(3, 0): 4.6e-9}, {(2, 1): 4.6e-9})
    >>> (lens.distort([[6.0, 0.0]]) * 76.9).round(3)  # 461.4 px, and 4.6e-9 * 461.4^3 = 0.452 px
    array([[461.852,   0.   ]])
    """

    KEYWORDS: ClassVar[tuple[str, str]] = ("AP", "BP")

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        return self._map(xy_mm)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        return self._map_jacobian(xy_mm)


@dataclass(frozen=True, slots=True, eq=False)
class ForwardSipDistortion(_SipPolynomials, InverseDistortion):
    """SIP distortion from its forward polynomials A, B, which give ideal from distorted pixel offsets.

    For headers that carry no reverse polynomials; `distort` is their numerical inverse. Build it with
    `from_coefficients` or `from_keywords`.

    References
    ----------
    Shupe et al. (2005), ADASS XIV, ASP Conf. Ser. 347, 491.
    """

    KEYWORDS: ClassVar[tuple[str, str]] = ("A", "B")

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        return self._map(xy_mm)

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        return self._map_jacobian(xy_mm)


def _coefficient_matrix(coefficients: SipCoefficients) -> FloatArray:
    """Coefficients as a matrix [p, q]."""
    order = max((p + q for p, q in coefficients), default=0)
    if order > SIP_MAX_ORDER:
        raise CameraError(
            f"SIP coefficients of order {order}; the convention ends at {SIP_MAX_ORDER}, check the keys."
        )
    matrix = np.zeros((max(order, 1) + 1,) * 2)  # at least 2 x 2, so that it has derivatives
    for powers, value in coefficients.items():
        matrix[powers] = value
    return matrix


def sip_powers(order: int) -> list[tuple[int, int]]:
    """Return the powers of pixel and line offset that SIP polynomials of an order have."""
    return [(p, q) for p in range(order + 1) for q in range(order + 1 - p)]


def sip_terms(offsets: FloatArray, order: int) -> FloatArray:
    """Return the terms (n, k) of SIP polynomials at offsets (n, 2), in the order of `sip_powers`."""
    u, v = offsets.T
    return np.stack([u**p * v**q for p, q in sip_powers(order)], axis=1)


def _sip_coefficients(keywords: Mapping[str, Any], name: str) -> dict[tuple[int, int], float]:
    found = {
        (p, q): float(keywords[f"{name}_{p}_{q}"])
        for p, q in sip_powers(SIP_MAX_ORDER)
        if f"{name}_{p}_{q}" in keywords
    }
    if not found:
        raise CameraError(
            f"no SIP coefficients {name}_p_q among these keywords; take a header whose CTYPE ends in -SIP."
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class LegendreDistortion(InverseDistortion):
    """Legendre series in coordinates scaled to -1..1, as published for New Horizons' MVIC.

    With X = x / half_width, Y = y / half_height on the detector, the ideal coordinates are

        x_ideal = half_width (X + sum over k of c_x[k] P_i(X) P_j(Y))
        y_ideal = half_height (Y + sum over k of c_y[k] P_i(X) P_j(Y))

    over the 20 pairs of degrees (i, j) = (0,1) (1,0) (0,2) (1,1) (2,0) (0,3) ... (5,0). Beyond the
    calibrated area the correction of the nearest point of its edge applies: polynomials run away there.

    Parameters
    ----------
    half_size_mm : (2,) array
        Half width and half height of the calibrated area, mm; negative where the series' axis runs against
        the detector's (MVIC: its y axis points to decreasing line).
    x_coefficients, y_coefficients : (20,) arrays
        Dimensionless (fractions of half width and half height).

    References
    ----------
    Instrument addendum kernel mvicAddendum004.ti (``INS-98900_DISTORTION_COEF_X`` and ``_Y``), after
    "Calculation of distortion in MVIC frame images"; order, scale and direction as in the ISIS camera model
    NewHorizonsMvicFrameCameraDistortionMap.
    """

    half_size_mm: FloatArray
    x_coefficients: FloatArray
    y_coefficients: FloatArray

    def __post_init__(self) -> None:
        count = len(LEGENDRE_TERMS)
        for name, shape in (
            ("half_size_mm", (2,)),
            ("x_coefficients", (count,)),
            ("y_coefficients", (count,)),
        ):
            try:
                object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
            except ValueError as error:
                raise CameraError(f"Legendre distortion: {error}; give as many values as that.") from error
        if not np.all(self.half_size_mm != 0.0):
            raise CameraError(
                "Legendre distortion: half_size_mm has a zero; give the calibrated area's half size in mm."
            )

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        x, y = np.moveaxis(np.clip(xy / self.half_size_mm, -1.0, 1.0), -1, 0)
        series, _, _ = _legendre_series(self.x_coefficients.tobytes(), self.y_coefficients.tobytes())
        shift = _both_axes(x, y, series)
        return np.asarray(xy + self.half_size_mm * shift)

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        scaled = np.asarray(xy_mm, dtype=np.float64) / self.half_size_mm
        x, y = np.moveaxis(np.clip(scaled, -1.0, 1.0), -1, 0)
        _, *slopes_of = _legendre_series(self.x_coefficients.tobytes(), self.y_coefficients.tobytes())
        slopes = np.stack([_both_axes(x, y, slope) for slope in slopes_of], axis=-1)
        inside = (np.abs(scaled) <= 1.0)[..., None, :]  # clipped: no slope along that axis
        scale = self.half_size_mm[:, None] / self.half_size_mm
        return np.asarray(np.eye(2) + np.where(inside, slopes, 0.0) * scale)


@lru_cache(maxsize=16)
def _legendre_series(
    x_coefficients: bytes, y_coefficients: bytes
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients [degree in x, degree in y, axis], and those of the slopes along x and along y."""
    series = np.zeros((LEGENDRE_DEGREE + 1, LEGENDRE_DEGREE + 1, 2))
    for axis, coefficients in enumerate((x_coefficients, y_coefficients)):
        for (i, j), value in zip(LEGENDRE_TERMS, np.frombuffer(coefficients), strict=True):
            series[i, j, axis] = value
    along_x, along_y = (legendre.legder(series, axis=axis) for axis in (0, 1))
    return readonly(series), readonly(along_x), readonly(along_y)


def _both_axes(x: FloatArray, y: FloatArray, series: FloatArray) -> FloatArray:
    """Evaluate the series of both axes, [degree in x, degree in y, axis], at points (...): an array (..., 2)."""
    return np.ascontiguousarray(np.moveaxis(legendre.legval2d(x, y, series), 0, -1))


# ---- How far from the boresight a distortion model holds.

REACH_RAYS = 16
REACH_RADII = 200
RINGS_AT_A_TIME = 20  # a factor of 2.7 in radius
MIN_TANGENT, MAX_TANGENT = 1e-3, 20.0  # of the angle from the boresight: up to 87 deg, in steps of 5 %
_TANGENTS = np.geomspace(MIN_TANGENT, MAX_TANGENT, REACH_RADII)
_ANGLES = np.linspace(0.0, 2.0 * np.pi, REACH_RAYS, endpoint=False)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)


@lru_cache(maxsize=128)
def reach_mm(distortion: Distortion, focal_length_mm: float) -> float:
    """Return the ideal radius, mm, up to which `distortion` maps one to one along every ray.

    Infinite where it does so up to 87 deg from the boresight. Found once for each distortion: cameras are varied.
    """
    radii = focal_length_mm * _TANGENTS
    # Ring by ring outward, some at a time: beyond its fold a model is asked nothing, where Newton's method would only fail.
    for first in range(0, REACH_RADII, RINGS_AT_A_TIME):
        points = radii[first : first + RINGS_AT_A_TIME, None, None] * _CIRCLE
        with np.errstate(all="ignore"):
            folded = ~(_least_stretch(distortion.jacobian(points)) > distortion.least_stretch).all(axis=1)
        if folded.any():
            return float(radii[max(first + int(folded.argmax()) - 1, 0)])
    return np.inf


def _least_stretch(jacobian: FloatArray) -> FloatArray:
    """Smaller eigenvalue of the symmetric part of matrices (..., 2, 2)."""
    half_trace = 0.5 * (jacobian[..., 0, 0] + jacobian[..., 1, 1])
    half_difference = 0.5 * (jacobian[..., 0, 0] - jacobian[..., 1, 1])
    shear = 0.5 * (jacobian[..., 0, 1] + jacobian[..., 1, 0])
    return np.asarray(half_trace - np.hypot(half_difference, shear))
