"""Arrays inside frozen results: read-only float64, with shapes checked where data enters."""

from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "freeze_arrays",
    "gauss_legendre",
    "pixel_runs",
    "readonly",
    "symmetric",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def readonly(
    values: ArrayLike, shape: tuple[int | None, ...] | None = None, name: str = "array"
) -> FloatArray:
    """Return a read-only float64 view (or copy) of `values`, its shape checked.

    Parameters
    ----------
    values : array_like
        Anything numpy turns into float64.
    shape
        Required shape; None stands for any length along that axis.
    name
        Used in the error message.

    Raises
    ------
    ValueError
        The shape differs from the one required.

    Examples
    --------
    >>> readonly([1, 2, 3], (3,)).flags.writeable
    False
    """
    array = np.asarray(values, dtype=np.float64)
    if shape is not None and not _fits(array.shape, shape):
        wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"{name} has shape {array.shape}, expected {wanted}")
    view = array.view()
    view.setflags(write=False)
    return view


def _fits(actual: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(actual) == len(wanted) and all(
        w is None or a == w for a, w in zip(actual, wanted, strict=True)
    )


def freeze_arrays(instance: Any, *, in_file_order: bool = False) -> None:
    """Make every array field of a frozen dataclass read-only; call it from ``__post_init__``.

    Parameters
    ----------
    in_file_order
        Copy transposed and strided arrays row by row, as they come back from a file: matrix products round by the layout
        in memory, and what is read back should compute to the same bits.
    """
    for field in fields(instance):
        value = getattr(instance, field.name)
        if isinstance(value, np.ndarray):
            view = np.ascontiguousarray(value).view() if in_file_order and value.ndim else value.view()
            view.setflags(write=False)
            object.__setattr__(instance, field.name, view)


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a (stack of) square matrices, so that covariances stay exact."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))


@lru_cache(maxsize=64)
def gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights (count,) of Gauss and Legendre on -1..1, read-only; found once, for it costs an eigenproblem.

    Examples
    --------
    >>> nodes, weights = gauss_legendre(3)
    >>> round(float(np.sum(weights * nodes**4)), 12)
    0.4
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return readonly(nodes), readonly(weights)


def pixel_runs(mask: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return line, first and one-past-last pixel (n,) of each run of marked pixels along lines.

    Examples
    --------
    >>> [part.tolist() for part in pixel_runs(np.array([[False, True, True, False], [True, False, False, True]]))]
    [[0, 1, 1], [1, 0, 3], [3, 1, 4]]
    """
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    line, first = np.nonzero(steps == 1)
    _, past = np.nonzero(steps == -1)
    return line, first, past
