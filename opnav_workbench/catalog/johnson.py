"""Johnson V and B-V of stars, as far as they are known: what `bands` makes and `StarTable` holds."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Johnson"]


class Johnson(NamedTuple):
    """Johnson V and B-V with 1 sigma, columns (n,) as `StarTable` has them; nan where unknown."""

    v_mag: FloatArray
    v_sigma: FloatArray
    b_v: FloatArray
    b_v_sigma: FloatArray

    @classmethod
    def unknown(cls, n: int) -> "Johnson":
        """Return n stars of which nothing is known."""
        return cls(*np.full((4, n), np.nan))

    @classmethod
    def concatenate(cls, parts: Sequence["Johnson"]) -> "Johnson":
        """Return the stars of all parts one after the other."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def columns(self) -> dict[str, Any]:
        """Return the columns by name, for `StarTable`."""
        return self._asdict()

    def or_else(self, other: "Johnson") -> "Johnson":
        """Return these values, and those of `other` where V or B-V is unknown here."""
        no_v, no_color = np.isnan(self.v_mag), np.isnan(self.b_v)
        if not (no_v.any() or no_color.any()):
            return self
        return Johnson(
            np.where(no_v, other.v_mag, self.v_mag),
            np.where(no_v, other.v_sigma, self.v_sigma),
            np.where(no_color, other.b_v, self.b_v),
            np.where(no_color, other.b_v_sigma, self.b_v_sigma),
        )

    def or_at(self, rows: IntArray, other: "Johnson") -> "Johnson":
        """Return these values, and in some rows, where V or B-V is unknown here, those of `other`, one a row."""
        columns = [column.copy() for column in self]
        for column, values in zip(columns, self.take(rows).or_else(other), strict=True):
            column[rows] = values
        return Johnson(*columns)

    def better_of(self, other: "Johnson") -> "Johnson":
        """Return, of each star and quantity, the value of the smaller sigma."""
        worse_v = ~(self.v_sigma <= np.nan_to_num(other.v_sigma, nan=np.inf))
        worse_color = ~(self.b_v_sigma <= np.nan_to_num(other.b_v_sigma, nan=np.inf))
        return Johnson(
            np.where(worse_v, other.v_mag, self.v_mag),
            np.where(worse_v, other.v_sigma, self.v_sigma),
            np.where(worse_color, other.b_v, self.b_v),
            np.where(worse_color, other.b_v_sigma, self.b_v_sigma),
        )

    def take(self, rows: IntArray | BoolArray) -> "Johnson":
        """Return the chosen rows."""
        return Johnson(*(column[rows] for column in self))
