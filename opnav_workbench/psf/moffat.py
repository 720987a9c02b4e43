"""The Moffat profile: a core with the wings that a Gaussian lacks."""

from dataclasses import dataclass, field

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.protocol import require_positive
from opnav_workbench.psf.table import PixelTable, TablePsf

__all__ = ["MoffatPsf"]

CELLS_PER_FWHM = 20  # interpolation good to 1e-7 of the flux
MIN_OVERSAMPLING = 4
NODES_PER_CELL = 4  # Gauss-Legendre: exact to 1e-12 for cells of 1/20 of the width


@dataclass(frozen=True, slots=True)
class MoffatPsf(TablePsf):
    """A round Moffat profile, ``(1 + r^2 / a^2)^-beta``; shares are good to 1e-6 of the flux.

    Its wings never end. Where less than `cut_share` of the light is left outside, they are cut off (on a square
    about the point) and the rest is normalised to 1.

    Attributes
    ----------
    fwhm_px : float
        Full width at half maximum, before integration over pixels.
    beta : float
        Above 1; 2.5 to 5 for telescopes, a Gaussian as it grows.
    cut_share : float
        Share of the light beyond the cut.

    References
    ----------
    Moffat (1969), A&A 3, 455; Trujillo et al. (2001), doi 10.1046/j.1365-8711.2001.04937.x.

    Examples
    --------
    >>> psf = MoffatPsf(fwhm_px=2.0, beta=3.0)
    >>> psf.box([[5.0, 5.0]], [[4, 4]], 3)[0].round(3)
    array([[0.049, 0.081, 0.049],
           [0.081, 0.146, 0.081],
           [0.049, 0.081, 0.049]])
    """

    fwhm_px: float
    beta: float
    cut_share: float = 1e-3
    _table: PixelTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_positive("Moffat PSF", fwhm_px=self.fwhm_px, cut_share=self.cut_share)
        if not 1.0 < self.beta < np.inf or self.cut_share >= 1.0:
            raise CameraError(
                f"Moffat PSF: beta is {self.beta} and cut_share {self.cut_share}; give beta > 1 (else the light "
                "is infinite) and a share below 1."
            )
        per_px = max(MIN_OVERSAMPLING, int(np.ceil(CELLS_PER_FWHM / self.fwhm_px)))
        object.__setattr__(self, "_table", PixelTable.from_cells(self._cells(per_px), per_px))

    def _cells(self, per_px: int) -> FloatArray:
        """Shares in cells of 1/per_px px (not normalised), one quadrant computed and mirrored."""
        scale = self.fwhm_px / (2.0 * np.sqrt(2.0 ** (1.0 / self.beta) - 1.0)) * per_px
        reach = int(np.ceil(scale * np.sqrt(self.cut_share ** (-1.0 / (self.beta - 1.0)) - 1.0)))
        t, w = np.polynomial.legendre.leggauss(NODES_PER_CELL)
        at2 = ((np.arange(reach + 1)[:, None] + 0.5 * t) / scale) ** 2
        quadrant = sum(
            a * b * (1.0 + at2[:, None, i] + at2[None, :, j]) ** -self.beta
            for i, a in enumerate(w)
            for j, b in enumerate(w)
        )
        half = np.concatenate([quadrant[:0:-1], quadrant])
        return np.asarray(np.concatenate([half[:, :0:-1], half], axis=1))
