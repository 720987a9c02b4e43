"""Errors of landmarks along and across the direction to the Sun, by incidence: the bottom lines of the exams."""

from itertools import pairwise

import numpy as np

EDGES_DEG = (10.0, 30.0, 45.0, 55.0, 65.0, 72.0, 80.0)


class SunTable:
    """Errors and covariances of landmarks, gathered from pictures."""

    def __init__(self):
        self._parts = []

    def add(self, centers, up, sun, error_px, rows):
        """Take in landmarks of a picture.

        `centers` of the solution, `up` (n, 3) and `sun` (3,) body-fixed unit vectors, errors (n, 2), and which rows count.
        """
        level = sun - (up @ sun)[:, None] * up
        along = np.einsum("nij,nj->ni", centers.partials.place_px_per_km, level)
        along /= np.linalg.norm(along, axis=1)[:, None]
        self._parts.append(
            (along[rows], error_px[rows], centers.covariance_px2[rows], centers.incidence_deg[rows])
        )

    def lines(self):
        """Return one line a range of incidence."""
        along, error, covariance, incidence = (np.concatenate(p) for p in zip(*self._parts, strict=True))
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        for low, high in (*pairwise(EDGES_DEG), (EDGES_DEG[0], 70.0)):
            inside = (incidence >= low) & (incidence < high)
            if inside.any():
                words = [
                    f"{name} {self._line(axis[inside], error[inside], covariance[inside])}"
                    for name, axis in (("toward the Sun", along), ("across", across))
                ]
                yield f"incidence {low:.0f} to {high:.0f} deg, {inside.sum()} landmarks: {'; '.join(words)}"

    @staticmethod
    def _line(axis, error, covariance):
        off = np.sum(axis * error, axis=1)
        sigma = np.sqrt(np.einsum("ni,nij,nj->n", axis, covariance, axis))
        return (
            f"mean {off.mean():+.3f} rms {np.sqrt(np.mean(off**2)):.3f} px, "
            f"error/sigma {np.sqrt(np.mean((off / sigma) ** 2)):.2f}"
        )
