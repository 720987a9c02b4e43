"""Smear of a frame-transfer detector without shutter: light that falls while the charge moves along its columns.

Forward   After the exposure each row moves, one row every ``transfer_s / n_line``, out over the line that it is read
          `toward`, and gathers the light of all rows between. Before the exposure the rows that come in, one every
          ``scrub_s / n_line``, have gathered the light of all rows on the other side. With s the electrons of the
          exposure itself, a = transfer_s / (n_line exposure_s) and b = scrub_s / (n_line exposure_s), toward line 0

              r_i = s_i + a sum(s_k, k < i) + b sum(s_k, k > i)

Backward  With S_i the sum up to line i and T the whole one, S_i = g S_(i-1) + (r_i - b T) / (1 - b),
          g = 1 - (a - b) / (1 - b): a recursion that is linear in r and T, and T = S_(n-1) closes it.

A star's smear thus has transfer_s / exposure_s of its electrons, evenly over its column when both times are equal (and
then r = (1 - a) s + a T).
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import CameraError

__all__ = ["Transfer"]


@dataclass(frozen=True, slots=True)
class Transfer:
    """Times and direction of the charge transfer, relative to the exposure.

    Attributes
    ----------
    after : float
        Transfer time of all lines after the exposure, over the exposure time.
    before : float
        The same of the clearing before it.
    toward_first : bool
        Whether the rows leave over line 0 (else over the last one).

    Raises
    ------
    CameraError
        A line of clearing takes as long as the exposure, which cannot be undone.
    """

    after: float
    before: float
    toward_first: bool = True

    @classmethod
    def of(
        cls, transfer_s: float, scrub_s: float, exposure_s: float, *, toward_first: bool = True
    ) -> "Transfer":
        """Return the transfer of an exposure."""
        return cls(transfer_s / exposure_s, scrub_s / exposure_s, toward_first)

    def smear(self, electrons: FloatArray) -> FloatArray:
        """Return what the transfers add to the expected electrons (n_line, n_pixel) of an exposure."""
        a, b = self._per_line(electrons)
        if a == b:
            return np.asarray(a * (electrons.sum(axis=0) - electrons))
        rows = electrons if self.toward_first else electrons[::-1]
        through = np.cumsum(rows, axis=0)
        added = a * (through - rows) + b * (through[-1] - through)
        return np.asarray(added if self.toward_first else added[::-1])

    def remove(self, smeared: FloatArray) -> FloatArray:
        """Return the electrons (n_line, n_pixel) of the exposure, given those with smear: what calibration does."""
        from scipy.signal import lfilter  # noqa: PLC0415  a third of a second, for unequal times only

        a, b = self._per_line(smeared)
        if a == b:
            total = smeared.sum(axis=0) / (1.0 - a + a * len(smeared))
            return np.asarray((smeared - a * total) / (1.0 - a))
        rows = smeared if self.toward_first else smeared[::-1]
        growth = 1.0 - (a - b) / (1.0 - b)
        filtered = np.asarray(lfilter([1.0], [1.0, -growth], rows, axis=0)) / (1.0 - b)
        of_total = np.asarray(lfilter([1.0], [1.0, -growth], np.full(len(rows), b))) / (1.0 - b)
        total = filtered[-1] / (1.0 + of_total[-1])
        through = filtered - of_total[:, None] * total
        exposed = np.diff(through, axis=0, prepend=0.0)
        return np.asarray(exposed if self.toward_first else exposed[::-1])

    def _per_line(self, electrons: FloatArray) -> tuple[float, float]:
        lines = len(electrons)
        a, b = self.after / lines, self.before / lines
        if not (a < 1.0 and b < 1.0):
            raise CameraError(
                f"frame transfer: a line moves in {max(a, b):.3g} exposure times; give a longer exposure or a "
                "shorter transfer_s."
            )
        return a, b
