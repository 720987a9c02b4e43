"""From where the body seems to be to within a pixel of it: scans over a wide range of lags, with the model in one dimension.

Flow   place -> fan -> data along it, profiles of rays -> correlation over lags -> center and size that most lags agree with

No picture is rendered here. The size is solved for along with the center, so that a body of another size than predicted is
noticed, and its center found with the limb where it is.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.limb_scan.fan import STEP_PX, ScanFan, ScanSampler, lay_fan
from opnav_workbench.bodies.limb_scan.matching import ScanSystem, correlate_scans, correlation_peaks
from opnav_workbench.bodies.limb_scan.view import ScanProfiles, scan_profiles
from opnav_workbench.bodies.neighbours import edge_reach, without_others
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.bodies.subarray import choose_subarray

__all__ = ["Acquisition", "acquire"]

SIZE_SHARE = 0.4  # of the radius: how far the limb may be from where it is predicted
MIN_LAG_PX = 6.0
MODEL_ERROR = 0.03  # of the peak: what profiles in one dimension differ from the picture
ALLOWED_ROUGHNESS = 0.3  # relative scatter of the albedo that is allowed for while it is unknown
MIN_PEAK = 0.5  # correlation below which a scan has met nothing like the limb
ROUNDS = 4
NEAR_PX = 0.2  # what a step s along a limb of radius r, seen as straight, is off by at most: s^2 / 2 r
SIZE_NOTICED = 0.01  # relative, and
SIZE_NOTICED_PX = 1.0  # difference of the limb from the predicted one: less is left to the rendered model
SMALLEST_SIZED_PX = 8.0  # radius; smaller bodies show brightness and place, hardly their size
NARROWINGS = 8  # of the distance that counts as near
NEAREST_PX = 0.5
FEWEST = 5  # scans that must agree


@dataclass(frozen=True, slots=True, eq=False)
class Acquisition:
    """Where the limb puts the body.

    Attributes
    ----------
    center_px : (2,) array
    range_scale
        Range over that of the model which gives the body its size; 1 unless the limb is clearly elsewhere.
    agreeing
        Share of the scans across the lit limb that agree with the center.
    """

    center_px: FloatArray
    range_scale: float
    fan: ScanFan
    profiles: ScanProfiles
    agreeing: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def acquire(
    picture: BodyPicture, silhouette: Silhouette, center_px: FloatArray, range_scale: float, n_scans: int
) -> Acquisition:
    """Find a body's center to about a pixel, starting from its place.

    Raises
    ------
    CenterfindingError
        The body leaves what the camera model covers.
    """
    center, agreeing = np.asarray(center_px, dtype=np.float64), 0.0
    other_size = False
    for turn in range(ROUNDS):
        fan = lay_fan(picture, silhouette, center, range_scale, n_scans)
        profiles = scan_profiles(picture, silhouette.name, fan, center, range_scale)
        share = SIZE_SHARE if turn == 0 else 0.5 * SIZE_SHARE**turn
        lags = max(MIN_LAG_PX, share * float(np.median(fan.limb_px)))
        lag, known = _lags(picture, silhouette.name, fan, profiles, center, int(np.ceil(lags / STEP_PX)))
        if known.sum() < FEWEST:
            break
        step, size, agreeing = _consensus(fan, lag, known, lags, other_size=other_size)
        center = center + step
        radius = float(np.median(fan.limb_px))
        if size != 0.0:
            range_scale, other_size = range_scale / (1.0 + size), True
        if abs(size) * radius < SIZE_NOTICED_PX and step @ step < 2.0 * radius * NEAR_PX:
            break
    return Acquisition(center, range_scale, fan, profiles, agreeing)


def _lags(
    picture: BodyPicture, name: str, fan: ScanFan, profiles: ScanProfiles, center: FloatArray, reach: int
) -> tuple[FloatArray, BoolArray]:
    """Return the lag of each scan (n,), and which of them crossed the lit limb."""
    far = float(STEP_PX * (fan.first.max() + fan.n_samples + reach)) + edge_reach(picture)
    window = choose_subarray(picture, name, Circle(center, far), margin=0.0).window
    cutout = without_others(picture, name, center, window)
    sampler = ScanSampler(fan.places(center, fan.distances(reach, reach)), window)
    data, blocked = sampler.sample(cutout.data_dn), sampler.blocked(cutout.use)
    model = profiles.total
    inside = slice(reach, reach + fan.n_samples)
    brightness = _brightness(data[:, inside], model, blocked[:, inside])
    noise2 = float(np.mean(cutout.noise_dn**2)) + brightness * model / cutout.gain_e_per_dn
    noise2 = noise2 + (MODEL_ERROR * brightness) ** 2
    outward = -np.gradient(model, STEP_PX, axis=1)
    slope = outward[..., None] * fan.direction[:, None, :]
    system = ScanSystem(
        data[:, inside],
        brightness * model,
        brightness * slope,
        fan.direction,
        brightness * profiles.parts,
        noise2 / STEP_PX,
        np.zeros(model.shape, dtype=bool),
        np.ones(len(fan)),
    )
    correlation = correlate_scans(system, brightness * model, data, blocked, ALLOWED_ROUGHNESS)
    lag, peak = correlation_peaks(correlation, np.asarray(STEP_PX * np.arange(-reach, reach + 1)))
    return lag, fan.crosses_limb & ~fan.covered & (peak > MIN_PEAK)


def _brightness(data: FloatArray, model: FloatArray, blocked: BoolArray) -> float:
    free = ~blocked
    under = float(np.sum(model[free] ** 2))
    scale = float(np.sum(data[free] * model[free])) / under if under > 0.0 else 0.0
    return max(scale, np.finfo(float).tiny ** 0.25)


def _consensus(
    fan: ScanFan, lag: FloatArray, known: BoolArray, reach_px: float, *, other_size: bool
) -> tuple[FloatArray, float, float]:
    """Return step (2,), relative change of size and share of scans that agree, by weights that narrow."""
    bend = (np.roll(fan.limb_px, -1) - np.roll(fan.limb_px, 1)) / (4.0 * np.pi / len(fan))
    across = np.stack([-fan.direction[:, 1], fan.direction[:, 0]], axis=-1)
    motion = fan.direction - (bend / fan.limb_px)[:, None] * across  # of the limb along the scan
    columns, offset = np.concatenate([motion, fan.limb_px[:, None]], axis=1)[known], lag[known]
    radius = float(np.median(fan.limb_px))
    solution = _robust(columns, offset, reach_px)
    if radius < SMALLEST_SIZED_PX or not (
        other_size or abs(solution[2]) > max(SIZE_NOTICED, SIZE_NOTICED_PX / radius)
    ):  # the size that is expected stays; then the center is the one that goes with it
        solution = np.append(_robust(columns[:, :2], offset, reach_px), 0.0)
    residual = np.abs(offset - columns @ solution)
    return solution[:2], float(solution[2]), float(np.mean(residual < 3.0 * NEAREST_PX))


def _robust(columns: FloatArray, offset: FloatArray, near: float) -> FloatArray:
    """Return the solution (p,) that most offsets (n,) agree with, by weights that narrow to `NEAREST_PX`."""
    steady = 1e-6 * np.diag(np.sum(columns**2, axis=0))
    solution: FloatArray = np.zeros(columns.shape[1])
    for _ in range(NARROWINGS):
        weight = 1.0 / (1.0 + ((offset - columns @ solution) / near) ** 2) ** 2
        weighted = columns * weight[:, None]
        solution = np.asarray(np.linalg.solve(columns.T @ weighted + steady, weighted.T @ offset))
        near = max(0.5 * near, NEAREST_PX)
    return solution
