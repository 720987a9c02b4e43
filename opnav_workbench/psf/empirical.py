"""A PSF given as an oversampled template, such as one extracted from bright stars."""

from dataclasses import dataclass, field
from os import PathLike
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.errors import CameraError
from opnav_workbench.files import atomic_path
from opnav_workbench.psf.extraction import cells_from_stars
from opnav_workbench.psf.table import PixelTable, TablePsf

__all__ = ["EmpiricalPsf"]


@dataclass(frozen=True, slots=True, eq=False)
class EmpiricalPsf(TablePsf):
    """A template of the light itself, before integration over pixels; pixel shares are its own cells summed.

    Attributes
    ----------
    samples : (k, k) array
        Light in square cells of 1/oversampling px, [line, pixel], k odd, the point at the middle of the middle
        cell. Their sum is normalised to 1.
    oversampling : int
        Cells a pixel. Four cells to the full width at half maximum keep shares good to 4e-4, nine to 2e-5.

    Raises
    ------
    CameraError
        Samples that are not square with an odd side, not finite, or without positive sum.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> psf = EmpiricalPsf(GaussianPsf(0.9, 0.7).kernel(8), 8)
    >>> difference = psf.box([[4.3, 4.6]], [[0, 0]], 9) - GaussianPsf(0.9, 0.7).box([[4.3, 4.6]], [[0, 0]], 9)
    >>> bool(abs(difference).max() < 2e-5)
    True
    """

    samples: FloatArray
    oversampling: int
    _table: PixelTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = PixelTable.from_cells(self.samples, self.oversampling)
        samples = np.array(self.samples, dtype=np.float64)
        object.__setattr__(self, "samples", readonly(samples / samples.sum()))
        object.__setattr__(self, "_table", table)

    @classmethod
    def from_stars(
        cls,
        image: ArrayLike,
        bad: ArrayLike | None,
        centers: ArrayLike,
        fluxes: ArrayLike,
        oversampling: int,
        *,
        half_size_px: float = 6.0,
    ) -> Self:
        """Extract the PSF from many stars of an image by least squares; see `cells_from_stars`.

        Parameters
        ----------
        image : (n_line, n_pixel) array_like
            With its background removed.
        bad : (n_line, n_pixel) array_like of bool, optional
            Pixels to leave out, also saturated ones.
        centers : (n, 2) array_like
            Stars, (pixel, line), good to a few hundredths of a pixel.
        fluxes : (n,) array_like
            Their fluxes, in the unit of the image. Their common scale does not matter.
        oversampling : int
            Cells a pixel; the stars' sub-pixel phases must fill them, which 5 * oversampling^2 stars do.
        half_size_px : float
            Half the side of the template.

        Raises
        ------
        CameraError
            Fewer usable pixels than cells, or arrays that do not fit together.
        """
        return cls(
            cells_from_stars(image, bad, centers, fluxes, oversampling, half_size_px=half_size_px),
            oversampling,
        )

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a template that `save` wrote.

        Raises
        ------
        CameraError
            The file cannot be read or holds no template.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(file["samples"], int(file["oversampling"]))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CameraError(
                f"PSF template {path} cannot be read: {error}; give an npz file with samples and oversampling."
            ) from error

    def save(self, path: str | PathLike[str]) -> None:
        """Write the template as an npz file with the arrays ``samples`` and ``oversampling``."""
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, samples=self.samples, oversampling=self.oversampling)
