"""Gaussian PSFs: the paper's ellipse of two widths and an angle, or one whose shape varies over the detector.

Normalised to one and integrated over pixels. Over the detector the shape follows a polynomial or a grid, as that of
`covariance_from_shape`: the mean width (root of the mean of both variances, px) and the ellipticities e1 and e2, which
unlike an angle pass smoothly through a round PSF.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays, readonly
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.integrals import (
    box_integrals,
    box_values,
    covariance_from_shape,
    ellipse_from_shape,
    shape_from_ellipse,
)
from opnav_workbench.psf.protocol import PsfGradient, cell_shift, checked_centers, require_positive

__all__ = ["FieldPsf", "GaussianPsf", "GridShape", "PolynomialShape"]


# ---- The elliptical Gaussian of the paper.

REACH_SIGMAS = 5.6  # less than 5e-8 of the flux lies outside a square of this half-side


@dataclass(frozen=True, slots=True)
class GaussianPsf:
    """An elliptical Gaussian; shares are exact for axes along pixel and line, else good to 1e-9.

    Attributes
    ----------
    sigma_major_px, sigma_minor_px
        Standard deviations along both axes, before integration over pixels.
    angle_rad
        Of the major axis, from +pixel toward +line.

    Raises
    ------
    CameraError
        A width that is not positive, or an angle that is not finite.

    Examples
    --------
    >>> GaussianPsf(0.5, 0.5).box([[3.0, 4.0]], [[2, 3]], 3)[0].round(4)
    array([[0.0247, 0.1074, 0.0247],
           [0.1074, 0.4661, 0.1074],
           [0.0247, 0.1074, 0.0247]])
    """

    sigma_major_px: float
    sigma_minor_px: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        require_positive(
            "Gaussian PSF", sigma_major_px=self.sigma_major_px, sigma_minor_px=self.sigma_minor_px
        )
        if not np.isfinite(self.angle_rad):
            raise CameraError(f"Gaussian PSF: angle_rad is {self.angle_rad}; give a finite angle.")

    @property
    def shape(self) -> FloatArray:
        """Log scale, e1, e2 (3,): see `covariance_from_shape`."""
        return shape_from_ellipse(np.array([self.sigma_major_px, self.sigma_minor_px, self.angle_rad]))

    @property
    def half_size_px(self) -> float:
        """Half the side of the square that holds all but 5e-8 of the flux."""
        return REACH_SIGMAS * float(self.sigma_px.max())

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations along pixel and along line, (2,)."""
        return readonly(np.sqrt(covariance_from_shape(*self.shape)[[0, 2]]))

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the shares (n, size, size); see `Psf.box`."""
        centers = checked_centers(center_px)
        shape = np.broadcast_to(self._tidy_shape(), (len(centers), 3))
        return box_values(centers, shape, np.asarray(first, dtype=np.float64), size)

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares and their derivatives; see `Psf.gradient`."""
        centers = checked_centers(center_px)
        shape = np.broadcast_to(self._tidy_shape(), (len(centers), 3))
        boxes = box_integrals(centers, shape, np.asarray(first, dtype=np.float64), size)
        return PsfGradient(boxes.value, boxes.d_pixel, boxes.d_line)

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the shares in cells of 1/subsample px, (k, k); see `Psf.kernel`."""
        shift = cell_shift(subsample, shift_px)
        fine = replace(
            self,
            sigma_major_px=self.sigma_major_px * subsample,
            sigma_minor_px=self.sigma_minor_px * subsample,
        )
        reach = int(np.ceil(fine.half_size_px + np.abs(shift).max()))
        cells = fine.box(shift[None], np.full((1, 2), -reach), 2 * reach + 1)[0]
        return np.asarray(cells / cells.sum())

    def at(self, pixel_line: ArrayLike) -> "GaussianPsf":  # noqa: ARG002 - the protocol's signature
        """Return itself."""
        return self

    def _tidy_shape(self) -> FloatArray:
        """Return `shape` with the rounding of a quarter turn removed, so that it counts as axis-aligned."""
        log_scale, e1, e2 = self.shape
        return np.array([log_scale, e1, 0.0 if abs(e2) < 1e-15 else e2])


# ---- A Gaussian PSF whose width and shape vary over the detector, by a polynomial or on a grid.

TERMS_OF_DEGREE = (1, 3, 6, 10, 15)  # 1; x, y; x^2, x y, y^2; ...
FIELD_MARGIN = 1.1  # places further off the detector (its half size is 1) have the shape of this margin
FIELD_PROBES = 41  # places along each axis where a field is checked, and its widest PSF sought


class ShapeField(Protocol):
    """Shape of a Gaussian as a function of the place on the detector."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Detector size (pixels, lines)."""
        ...

    def shape(self, pixel_line: FloatArray) -> FloatArray:
        """Return (n, 3) sigma_px, e1, e2 at places (n, 2)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialShape:
    """Shape by polynomials in x and y, which run from -1 to 1 across the detector.

    Attributes
    ----------
    size_px : (int, int)
        Detector size (pixels, lines).
    sigma_px, e1, e2 : (m,) arrays
        Coefficients of 1, x, y, x^2, x y, y^2, x^3 ...; m is 1, 3, 6, 10 or 15.

    Examples
    --------
    >>> wider_at_edges = PolynomialShape((1024, 1024), [0.8, 0, 0, 0.1, 0, 0.1])
    >>> wider_at_edges.shape(np.array([[511.5, 511.5], [1023.5, 511.5]])).round(3).tolist()
    [[0.8, 0.0, 0.0], [0.9, 0.0, 0.0]]
    """

    size_px: tuple[int, int]
    sigma_px: FloatArray
    e1: FloatArray | tuple[float, ...] = (0.0,)
    e2: FloatArray | tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        _check_detector_size(self.size_px)
        for name in ("sigma_px", "e1", "e2"):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or len(values) not in TERMS_OF_DEGREE or not np.isfinite(values).all():
                raise CameraError(
                    f"PSF polynomial: {name} has shape {values.shape}; give "
                    f"{', '.join(map(str, TERMS_OF_DEGREE))} finite coefficients."
                )
            object.__setattr__(self, name, values)
        freeze_arrays(self)

    def shape(self, pixel_line: FloatArray) -> FloatArray:
        """Return (n, 3) sigma_px, e1, e2 at places (n, 2)."""
        size = np.array(self.size_px)
        x, y = np.clip((2.0 * np.asarray(pixel_line) + 1.0) / size - 1.0, -FIELD_MARGIN, FIELD_MARGIN).T
        return np.stack(
            [_polynomial(np.asarray(c), x, y) for c in (self.sigma_px, self.e1, self.e2)], axis=-1
        )


@dataclass(frozen=True, slots=True, eq=False)
class GridShape:
    """Shape interpolated bilinearly between the nodes of a grid, constant beyond it.

    Attributes
    ----------
    size_px : (int, int)
        Detector size (pixels, lines).
    pixel, line : (p,), (q,) arrays
        Places of the nodes, increasing.
    sigma_px : (q, p) array
        Indexed [line, pixel].
    e1, e2 : (q, p) arrays or None
        None: round.
    """

    size_px: tuple[int, int]
    pixel: FloatArray
    line: FloatArray
    sigma_px: FloatArray
    e1: FloatArray | None = None
    e2: FloatArray | None = None

    def __post_init__(self) -> None:
        _check_detector_size(self.size_px)
        for name in ("pixel", "line"):
            nodes = np.array(getattr(self, name), dtype=np.float64)
            if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0.0).all():
                raise CameraError(f"PSF grid: {name} is {nodes.tolist()}; give two or more, increasing.")
            object.__setattr__(self, name, nodes)
        wanted = (len(self.line), len(self.pixel))
        for name in ("sigma_px", "e1", "e2"):
            given = getattr(self, name)
            values = np.zeros(wanted) if given is None else np.array(given, dtype=np.float64)
            if values.shape != wanted or not np.isfinite(values).all():
                raise CameraError(
                    f"PSF grid: {name} has shape {values.shape}; give {wanted} (line, pixel) finite."
                )
            object.__setattr__(self, name, values)
        freeze_arrays(self)

    def shape(self, pixel_line: FloatArray) -> FloatArray:
        """Return (n, 3) sigma_px, e1, e2 at places (n, 2)."""
        places = np.asarray(pixel_line, dtype=np.float64)
        (i, u), (j, v) = _grid_fraction(self.pixel, places[:, 0]), _grid_fraction(self.line, places[:, 1])
        values = np.stack([np.asarray(a) for a in (self.sigma_px, self.e1, self.e2)], axis=-1)
        u, v = u[:, None], v[:, None]
        upper = values[j, i] * (1.0 - u) + values[j, i + 1] * u
        lower = values[j + 1, i] * (1.0 - u) + values[j + 1, i + 1] * u
        return np.asarray(upper * (1.0 - v) + lower * v)


@dataclass(frozen=True, slots=True)
class FieldPsf:
    """An elliptical Gaussian whose shape is taken from a field at the place of each point.

    Attributes
    ----------
    field
        A `PolynomialShape` or a `GridShape`.

    Raises
    ------
    CameraError
        Somewhere on the detector the width is not positive, or the ellipticity 1 or more.

    Examples
    --------
    >>> psf = FieldPsf(PolynomialShape((1024, 1024), [0.8, 0, 0, 0.1, 0, 0.1]))
    >>> psf.at([1023.5, 511.5]).sigma_px.round(3)
    array([0.9, 0.9])
    """

    field: ShapeField

    def __post_init__(self) -> None:
        sigma, e1, e2 = self._probed()
        if not sigma.min() > 0.0 or not np.hypot(e1, e2).max() < 1.0:
            raise CameraError(
                f"PSF field: width down to {sigma.min():.3g} px and ellipticity up to {np.hypot(e1, e2).max():.3g} "
                "on the detector; the width must stay positive and the ellipticity below 1."
            )

    @property
    def half_size_px(self) -> float:
        """Half the side of the square that holds the widest PSF of the detector."""
        variances = covariance_from_shape(*self._log(np.stack(self._probed(), axis=-1)).T)[[0, 2]]
        return REACH_SIGMAS * float(np.sqrt(variances.max()))

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations along pixel and line (2,) at the middle of the detector."""
        return self._middle().sigma_px

    def box(self, center_px: ArrayLike, first: ArrayLike, size: int) -> FloatArray:
        """Return the shares (n, size, size), each with the shape at its own center; see `Psf.box`."""
        centers = checked_centers(center_px)
        shapes = self._log(self.field.shape(centers))
        return box_values(centers, shapes, np.asarray(first, dtype=np.float64), size)

    def gradient(self, center_px: ArrayLike, first: ArrayLike, size: int) -> PsfGradient:
        """Return the shares and their derivatives, the shape of each held; see `Psf.gradient`."""
        centers = checked_centers(center_px)
        shapes = self._log(self.field.shape(centers))
        boxes = box_integrals(centers, shapes, np.asarray(first, dtype=np.float64), size)
        return PsfGradient(boxes.value, boxes.d_pixel, boxes.d_line)

    def kernel(self, subsample: int, shift_px: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Return the kernel at the middle of the detector; take that of `at` elsewhere. See `Psf.kernel`."""
        return self._middle().kernel(subsample, shift_px)

    def at(self, pixel_line: ArrayLike) -> GaussianPsf:
        """Return the Gaussian at a place (2,) on the detector."""
        shape = self._log(self.field.shape(np.asarray(pixel_line, dtype=np.float64)[None]))[0]
        return GaussianPsf(*(float(v) for v in ellipse_from_shape(*shape)))

    def _middle(self) -> GaussianPsf:
        return self.at((np.array(self.field.size_px) - 1.0) / 2.0)

    def _probed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shape on a fine grid over the detector and its margin."""
        n_pixel, n_line = self.field.size_px
        along = 0.5 * (1.0 + FIELD_MARGIN * np.linspace(-1.0, 1.0, FIELD_PROBES))
        pixel, line = np.meshgrid(along * n_pixel - 0.5, along * n_line - 0.5)
        sigma, e1, e2 = self.field.shape(np.stack([pixel.ravel(), line.ravel()], axis=-1)).T
        return sigma, e1, e2

    @staticmethod
    def _log(shape: FloatArray) -> FloatArray:
        """Take (n, 3) sigma_px, e1, e2 to log scale, e1, e2."""
        return np.concatenate([np.log(shape[:, :1]), shape[:, 1:]], axis=1)


def _check_detector_size(size_px: tuple[int, int]) -> None:
    if not min(size_px) > 0:
        raise CameraError(f"PSF field: detector size is {size_px}; give pixels and lines.")


def _polynomial(coefficients: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    degree = TERMS_OF_DEGREE.index(len(coefficients))
    powers = [(n - q, q) for n in range(degree + 1) for q in range(n + 1)]
    terms = (c * x**p * y**q for c, (p, q) in zip(coefficients, powers, strict=True))
    return np.asarray(sum(terms, np.zeros_like(x)))


def _grid_fraction(nodes: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Index of the node below each place, and the fraction of the way to the next, clipped to the grid."""
    below = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    fraction = (at - nodes[below]) / (nodes[below + 1] - nodes[below])
    return below, np.clip(fraction, 0.0, 1.0)
