"""What a person looks at to judge a center: the data, the model, their difference, the correlation surface."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays

__all__ = ["StarImages"]


@dataclass(frozen=True, slots=True, eq=False)
class StarImages:
    """Boxes around n stars as a centerfinder saw them, indexed [star, line, pixel]."""

    first: IntArray  # (n, 2) pixel, line of the first pixel of each box
    data_dn: FloatArray  # (n, size, size), nan where bad, saturated or off the detector
    model_dn: FloatArray  # (n, size, size) star, its neighbors and background: template or fitted PSF
    sigma_dn: FloatArray  # (n, size, size) noise used for the weights, infinite where a pixel was left out
    # (n, size, size) of the matched filter (in sigmas) or cross-correlation, nan where not searched; else none
    surface: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return int(self.data_dn.shape[-1])

    @property
    def residual_dn(self) -> FloatArray:
        """Data minus model (n, size, size), nan where there are no data."""
        return self.data_dn - self.model_dn

    @property
    def weighted_residual(self) -> FloatArray:
        """Residual in sigmas (n, size, size), 0 where a pixel was left out."""
        return np.where(np.isfinite(self.sigma_dn), self.residual_dn / self.sigma_dn, 0.0)
