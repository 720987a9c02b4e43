"""Gaussian fields on a ring of blocks, of which each is coupled to its neighbors alone.

A field on a closed curve with a covariance that depends on the distance along it, as a Markov chain of blocks closed to a
ring: covariances within a block and between neighbors are the field's, those farther off what follows from them with the
greatest entropy. Its precision is a ring of blocks too, and so is that of what data say of it, block by block. Such a
matrix is decomposed by cyclic reduction: every other block is eliminated, all of them at once, until few are left
(Gander & Golub 1997, "Cyclic reduction: history and applications").

Conventions: n blocks of size s; "before" is the block (i, i - 1), row first.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from opnav_workbench.arrays import FloatArray

__all__ = ["RingFactor", "RingPrior", "products", "ring_prior"]

FEWEST_HALVED, LEAST_HALVED = 6, 300  # blocks, and all their rows: fewer are decomposed as they are


class RingPrior(NamedTuple):
    """The precision of a field, alike everywhere: block of the diagonal (s, s), that before it, and its log determinant."""

    diagonal: FloatArray
    before: FloatArray
    log_determinant: float

    def times(self, x: FloatArray) -> FloatArray:
        """Return the precision times x (n, s, m)."""
        before, after = np.roll(x, 1, axis=0), np.roll(x, -1, axis=0)
        return np.asarray(self.diagonal @ x + self.before @ before + self.before.T @ after)

    def covariance_times(self, x: FloatArray) -> FloatArray:
        """Return the covariance times x (n, s, m)."""
        n = len(x)
        turn = np.exp(-2j * np.pi * np.arange(n // 2 + 1) / n)[:, None, None]
        waves = self.diagonal + turn * self.before + turn.conj() * self.before.T
        return np.asarray(np.fft.irfft(np.linalg.solve(waves, np.fft.rfft(x, axis=0)), n, axis=0))


def ring_prior(within: FloatArray, before: FloatArray, n: int) -> RingPrior:
    """Return the precision of a ring of n blocks with covariances (s, s) within a block and with the one before it."""
    root = linalg.cho_factor(within, lower=True, check_finite=False)
    carried = linalg.cho_solve(root, before.T, check_finite=False).T
    new = linalg.cholesky(within - carried @ before.T, lower=True, check_finite=False)
    precision = linalg.cho_solve((new, True), np.eye(len(new)), check_finite=False)
    toward = precision @ carried
    closed = np.eye(len(new)) - np.linalg.matrix_power(carried, n)
    log_determinant = 2.0 * (np.linalg.slogdet(closed)[1] - n * float(np.log(np.diag(new)).sum()))
    return RingPrior(precision + carried.T @ toward, -toward, log_determinant)


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Eliminated blocks: inverse roots (k, s, s), and what these carry to the left and to the right (k, s, 2 s)."""

    inverse_root: FloatArray
    carried: FloatArray


class RingFactor:
    """A decomposed ring of blocks: diagonal (n, s, s) and before (n, s, s), positive definite, n of 3 at least.

    Attributes
    ----------
    log_determinant
    """

    def __init__(self, diagonal: FloatArray, before: FloatArray) -> None:
        self._levels: list[_Level] = []
        self.log_determinant = 0.0
        s = diagonal.shape[1]
        while len(diagonal) % 2 == 0 and len(diagonal) >= FEWEST_HALVED and len(diagonal) * s > LEAST_HALVED:
            root = np.linalg.cholesky(diagonal[1::2])
            self.log_determinant += 2.0 * float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
            inverse = np.linalg.inv(root)
            right = np.swapaxes(np.roll(before[::2], -1, axis=0), 1, 2)
            carried = np.matmul(inverse, np.concatenate([before[1::2], right], axis=2))
            self._levels.append(_Level(inverse, carried))
            taken = np.matmul(np.swapaxes(carried, 1, 2), carried)
            diagonal = diagonal[::2] - taken[:, :s, :s] - np.roll(taken[:, s:, s:], 1, axis=0)
            before = -np.roll(taken[:, s:, :s], 1, axis=0)
        self._n = len(diagonal)
        whole = np.zeros((self._n, s, self._n, s))
        here = np.arange(self._n)
        whole[here, :, here] = diagonal
        whole[here, :, here - 1] += before
        whole[here - 1, :, here] += np.swapaxes(before, 1, 2)
        self._root = linalg.cholesky(whole.reshape(self._n * s, -1), lower=True, check_finite=False)
        self.log_determinant += 2.0 * float(np.log(np.diag(self._root)).sum())

    def halves(self, right: FloatArray) -> list[FloatArray]:
        """Return what is left of right sides (n, s, m), level by level: its products are those with the inverse."""
        s = right.shape[1]
        out: list[FloatArray] = []
        for level in self._levels:
            half = np.matmul(level.inverse_root, right[1::2])
            out.append(half)
            taken = np.matmul(np.swapaxes(level.carried, 1, 2), half)
            right = right[::2] - taken[:, :s] - np.roll(taken[:, s:], 1, axis=0)
        last = linalg.solve_triangular(
            self._root, right.reshape(len(self._root), -1), lower=True, check_finite=False
        )
        return [*out, last.reshape(right.shape)]

    def solved(self, halves: list[FloatArray]) -> FloatArray:
        """Return the solution (n, s, m) of right sides by their `halves`."""
        last = halves[-1]
        solved = linalg.solve_triangular(
            self._root, last.reshape(len(self._root), -1), lower=True, trans=1, check_finite=False
        )
        x: FloatArray = solved.reshape(last.shape)
        for level, half in zip(reversed(self._levels), reversed(halves[:-1]), strict=True):
            beside = np.concatenate([x, np.roll(x, -1, axis=0)], axis=1)
            odd = np.matmul(np.swapaxes(level.inverse_root, 1, 2), half - np.matmul(level.carried, beside))
            x = np.stack([x, odd], axis=1).reshape(-1, *x.shape[1:])
        return x

    def inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return the blocks (n, s, s) of the inverse on the diagonal, and those before them."""
        n, s = self._n, len(self._root) // self._n
        lower, _ = linalg.lapack.dpotri(self._root, lower=1)
        whole = lower + lower.T
        whole[np.diag_indices(len(whole))] *= 0.5
        here = np.arange(n)
        whole = whole.reshape(n, s, n, s)
        diagonal, before = whole[here, :, here], whole[here, :, here - 1]
        for level in reversed(self._levels):
            gain = np.matmul(np.swapaxes(level.inverse_root, 1, 2), level.carried)
            right, across = np.roll(diagonal, -1, axis=0), np.roll(before, -1, axis=0)
            beside = np.concatenate(
                [
                    np.concatenate([diagonal, np.swapaxes(across, 1, 2)], axis=2),
                    np.concatenate([across, right], axis=2),
                ],
                axis=1,
            )
            cross = -np.matmul(gain, beside)
            own = np.matmul(np.swapaxes(level.inverse_root, 1, 2), level.inverse_root)
            odd = own - np.matmul(cross, np.swapaxes(gain, 1, 2))
            left_of_even = np.roll(np.swapaxes(cross[:, :, s:], 1, 2), 1, axis=0)
            diagonal = np.stack([diagonal, odd], axis=1).reshape(-1, s, s)
            before = np.stack([left_of_even, cross[:, :, :s]], axis=1).reshape(-1, s, s)
        return diagonal, before


def products(left: list[FloatArray], right: list[FloatArray]) -> FloatArray:
    """Return the products (k, m) of the `halves` of right sides with k and m columns."""
    return np.asarray(
        np.sum([np.tensordot(a, b, axes=((0, 1), (0, 1))) for a, b in zip(left, right, strict=True)], axis=0)
    )
