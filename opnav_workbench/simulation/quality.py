"""The quality plane of a simulated picture, in the codes of the mission's own table."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.simulation.detector import Exposed

__all__ = ["QUALITY_CODES", "QualityCodes", "quality_plane"]


@dataclass(frozen=True, slots=True)
class QualityCodes:
    """What a pipeline writes for a pixel that is saturated, lost or defective."""

    saturated: int
    lost: int
    defective: int


# For each table of `opnav_workbench.image.masks.QUALITY_TABLES`. Where every set bit means "bad", saturation is left to
# the picture's level: a bright star's core is a lower bound, not a bad pixel.
QUALITY_CODES: Mapping[str, QualityCodes] = MappingProxyType(
    {
        "any_nonzero": QualityCodes(saturated=0, lost=1, defective=2),
        "new_horizons_lorri": QualityCodes(saturated=16, lost=32, defective=32),
        "new_horizons_mvic": QualityCodes(saturated=8, lost=-1, defective=4),
    }
)


def quality_plane(exposed: Exposed, table: str, housekeeping_pixels: int = 0) -> NDArray[np.int16]:
    """Return the quality codes (n_line, n_pixel) of a picture.

    Parameters
    ----------
    exposed : Exposed
    table : str
        Name of the mission's table.
    housekeeping_pixels : int
        Pixels at the start of line 0 that carry telemetry.
    """
    codes = QUALITY_CODES[table]
    plane = np.where(exposed.saturated, codes.saturated, 0)
    if exposed.flag_defects:
        plane = np.where(exposed.defective, plane | codes.defective, plane)
    lost = exposed.lost.copy()
    lost[0, :housekeeping_pixels] = True
    return np.where(lost, codes.lost, plane).astype(np.int16)
