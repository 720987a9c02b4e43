"""What a limb scan keeps of every scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays

__all__ = ["NOT_CHOSEN", "REJECTED", "USED", "LimbScans"]

USED, NOT_CHOSEN, REJECTED = "used", "not_chosen", "rejected"


@dataclass(frozen=True, slots=True, eq=False)
class LimbScans:
    """n scans that radiate from a center, and what each of them says of it; the detail of a limb-scan center.

    Scan k leaves the center at ``360 k / n`` degrees from +pixel toward +line, whatever the picture shows, so that its
    number means the same in every run.

    Attributes
    ----------
    start_px : (2,) array
        Where the scans begin: the center (pixel, line) of the last iteration.
    angle_rad : (n,) array
        From +pixel toward +line.
    distance_px : (m,) array
        Of the points along every scan from its start, uniform.
    places_px : (n, m, 2) array
        The points (pixel, line).
    data_dn, model_dn : (n, m) arrays
        Brightness there: the picture less its background (nan without usable pixels), and the model at the mean
        brightness of the scans used.
    limb_px, edge_px : (n,) arrays
        Distance of the predicted limb, and of the outermost lit point: the limb itself or the terminator; nan where
        the scan meets no light.
    correlation : (n, k) array
        Of data with model at the last iteration, albedo and background taken out; nan where masked.
    lag_px : (k,) array
        Positive where the data lie farther out than the model.
    offset_px : (n,) array
        Of the data from the model along the scan: the maximum of its correlation, sub-sample; nan without one.
    sigma_px : (n,) array
        Its uncertainty from noise and albedo.
    motion : (n, 2) array
        Offset along the scan per px that the center moves along pixel and along line: the limb's normal over its cosine
        with the scan.
    brightness : (n,) array
        Data over model, near the limb.
    unevenness : (n,) array
        Relative scatter of the albedo along and beside the scan, inside of the limb, noise taken out; nan without one.
    residual_px : (n,) array
        Offset less what the solved center explains.
    status : (n,) array of str
        ``used``, ``not_chosen`` or ``rejected``.
    reason : (n,) array of str
        Why.
    roughness : float
        Relative scatter of the albedo across the limb that the data speak for.
    iterations : tuple of (float, float)
        Steps of the center (pixel, line).
    summary : tuple of str
        How the set of scans was chosen.
    """

    start_px: FloatArray
    angle_rad: FloatArray
    distance_px: FloatArray
    places_px: FloatArray
    data_dn: FloatArray
    model_dn: FloatArray
    limb_px: FloatArray
    edge_px: FloatArray
    correlation: FloatArray
    lag_px: FloatArray
    offset_px: FloatArray
    sigma_px: FloatArray
    motion: FloatArray
    brightness: FloatArray
    unevenness: FloatArray
    residual_px: FloatArray
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    roughness: float
    iterations: tuple[tuple[float, float], ...]
    summary: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)

    @property
    def used(self) -> NDArray[np.int64]:
        """Numbers of the scans that made the center."""
        return np.flatnonzero(self.status == USED)
