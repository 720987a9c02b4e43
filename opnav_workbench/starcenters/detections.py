"""What blind detection finds in an image."""

from dataclasses import dataclass

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays

__all__ = ["Detections"]


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Sources of an image, brightest first."""

    pixel_line: FloatArray  # (m, 2) good to about 0.1 px
    flux_dn: FloatArray  # (m,) total flux of a star with the given PSF
    snr: FloatArray  # (m,)
    sharpness: FloatArray  # (m,) largest pixel's part of the flux in its 3 x 3, over the most a star can have
    flags: IntArray  # (m,) sum of StarFlag
    limit_dn: float = float("nan")  # total flux of a star at the threshold, where the noise is usual

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.flags)

    def take(self, rows: IntArray | BoolArray) -> "Detections":
        """Return some of the detections, in the given order."""
        return Detections(
            self.pixel_line[rows], self.flux_dn[rows], self.snr[rows], self.sharpness[rows], self.flags[rows],
            self.limit_dn,
        )  # fmt: skip
