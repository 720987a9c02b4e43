"""Where scans run: their directions, where each meets the limb or the terminator, and pictures sampled along them.

Flow   center -> directions -> predicted limb along each -> outermost lit point -> window of samples about that
Frame  (pixel, line); angles from +pixel toward +line; distances from the center, px

Scans are laid out relative to a center, and stay the same as the center moves by a few pixels. Data and model are
interpolated between pixels with the same cubic convolution, so that it leaves no offset between them; the weights of the
pixels are kept, and what noise a sum over samples has follows exactly from them.

References: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding"; Keys (1981), IEEE
Trans. ASSP 29, 1153, doi:10.1109/TASSP.1981.1163711, for the convolution.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.neighbours import edge_reach, near_bodies
from opnav_workbench.bodies.picture import BodyPicture, displaced_model, pixel_rays, placed_models
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.render import Lambert
from opnav_workbench.render.body import PlacedBody

__all__ = [
    "N_SCANS",
    "STEP_PX",
    "ScanFan",
    "ScanSampler",
    "lay_fan",
]


# ---- Where scans run: their directions, and where each meets the limb or the terminator.

N_SCANS = 180  # one every 2 deg: as far apart as the PSF is wide on a disk of 100 px
STEP_PX = 0.5  # between samples: half a pixel loses nothing of a PSF that pixels resolve
# Depth of a scan inside the limb: surface seen within 25 deg of grazing. Deeper, light tells of albedo, not of the limb.
DEPTH_SHARE = 0.09  # of the radius, 1 - cos(25 deg)
PSF_REACH = 3.5  # sigma of the PSF to each side of an edge, and
RIM_PX = 2.0  # samples that show albedo and background
LIMB_SHARE = 0.005  # the lit surface ends within so much of the limb, or within
LIMB_PX = 0.5  # where a scan crosses the lit limb; else it crosses the terminator
CUSP_SHARE = (
    0.15  # of the largest cosine of incidence along the limb: nearer to the cusps limb and terminator mix
)
GRAZE = 1e-4  # of the distance, by which a point on the limb is moved onto the surface
PROBES = 48  # along a scan from limb to center, closer together near the limb
HALVINGS = 5  # of the distance between two probes

LitAt = Callable[[FloatArray], BoolArray]  # distances (n, k) along the scans -> whether light is seen


@dataclass(frozen=True, slots=True, eq=False)
class ScanFan:
    """n scans about a center.

    Attributes
    ----------
    angle_rad : (n,) array
    direction : (n, 2) array
        Unit vectors (pixel, line).
    limb_px : (n,) array
        Distance of the predicted limb.
    edge_px : (n,) array
        Distance of the outermost lit point; nan where the scan meets no light.
    crosses_limb : (n,) array of bool
        The outermost lit point is on the limb, not on the terminator or near a cusp where both meet.
    covered : (n,) array of bool
        Another body hides or shades the body where the scan meets its edge.
    first : (n,) array of int
        Sample where each window begins: distance ``STEP_PX * first``.
    n_samples
        Of a window.
    """

    angle_rad: FloatArray
    direction: FloatArray
    limb_px: FloatArray
    edge_px: FloatArray
    crosses_limb: BoolArray
    covered: BoolArray
    first: IntArray
    n_samples: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)

    def distances(self, before: int = 0, after: int = 0) -> FloatArray:
        """Return the distances (n, w) of the windows' samples, with some more before and after."""
        steps = np.arange(-before, self.n_samples + after)
        return np.asarray(STEP_PX * (self.first[:, None] + steps))

    def places(self, center_px: FloatArray, distance_px: FloatArray) -> FloatArray:
        """Return points (n, w, 2) at distances (n, w) or (w,) along the scans from a center."""
        distance = np.broadcast_to(distance_px, (len(self), np.shape(distance_px)[-1]))
        return np.asarray(center_px + self.direction[:, None, :] * distance[..., None])


def scan_angles(n_scans: int) -> FloatArray:
    """Return the angles (n,) of the scans, rad from +pixel toward +line.

    Examples
    --------
    >>> np.degrees(scan_angles(4)).round(6).tolist()
    [0.0, 90.0, 180.0, 270.0]
    """
    return np.asarray(np.arange(n_scans) * (2.0 * np.pi / n_scans))


def lay_fan(
    picture: BodyPicture, silhouette: Silhouette, center_px: FloatArray, range_scale: float, n_scans: int
) -> ScanFan:
    """Lay out scans about a center.

    Raises
    ------
    CenterfindingError
        The body there leaves what the camera model covers.
    """
    name = silhouette.name
    angle = scan_angles(n_scans)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    limb = silhouette.at(center_px, range_scale).radius(angle)
    pixel_scale = picture.camera.pixel_scale_rad
    body = PlacedBody(displaced_model(picture, name, center_px, range_scale), pixel_scale)

    def lit(distance: FloatArray) -> BoolArray:
        places = center_px + direction[:, None, :] * distance[..., None]
        rays = pixel_rays(picture, places.reshape(-1, 2))
        return np.asarray(body.radiance(rays).reshape(distance.shape) > 0.0)

    edge = _outermost_lit(lit, limb)
    crosses = limb - edge < np.maximum(LIMB_PX, LIMB_SHARE * limb)
    if not crosses.all():
        plain = replace(body.model, law=Lambert(), albedo=1.0)
        rays = pixel_rays(picture, center_px + direction * (limb * (1.0 - GRAZE))[:, None])
        incidence = PlacedBody(plain, pixel_scale).radiance(rays)
        crosses &= incidence > CUSP_SHARE * incidence.max(initial=0.0)
    reach = edge_reach(picture)
    inward = max(DEPTH_SHARE * float(np.median(limb)), reach)
    anchor = np.where(np.isfinite(edge), edge, limb)
    first = np.maximum(np.floor((anchor - inward) / STEP_PX).astype(np.int64), 0)
    covered = _covered(picture, name, center_px, range_scale, center_px + direction * anchor[:, None])
    n_samples = int(np.ceil((inward + reach) / STEP_PX)) + 1
    return ScanFan(angle, direction, limb, edge, crosses, covered, first, n_samples)


def _outermost_lit(lit: LitAt, limb_px: FloatArray) -> FloatArray:
    """Return the outermost distance (n,) at which scans see light, by bisection; nan where they see none."""
    depth = (np.arange(PROBES) / (PROBES - 1.0)) ** 2
    inside = 1e-3  # of a pixel: a ray on the limb itself meets nothing
    distance = limb_px[:, None] * (1.0 - depth) - inside
    seen = lit(distance)
    index = seen.argmax(axis=1)
    rows = np.arange(len(limb_px))
    near, far = distance[rows, index], distance[rows, np.maximum(index - 1, 0)]
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        bright = lit(middle[:, None])[:, 0]
        near, far = np.where(bright, middle, near), np.where(bright, far, middle)
    return np.where(seen.any(axis=1), np.where(index == 0, limb_px, near), np.nan)


def _covered(
    picture: BodyPicture, name: str, center_px: FloatArray, range_scale: float, places_px: FloatArray
) -> BoolArray:
    """Tell at which points (n, 2) of its edge another body hides or shades a body."""
    if len(picture.models) == 1:
        return np.zeros(len(places_px), dtype=bool)
    places = {name: center_px, **near_bodies(picture, name, center_px)}
    models = [m for m in placed_models(picture, places, {name: range_scale}) if not m.is_point]
    placed = [PlacedBody(model, picture.camera.pixel_scale_rad) for model in models]
    own = next(body for body in placed if body.model.target.name == name)
    inner = center_px + (places_px - center_px) * (1.0 - 0.5 * DEPTH_SHARE)
    rays = pixel_rays(picture, inner)
    alone = own.radiance(rays)
    own.note_occulters(placed)
    together = own.radiance(rays)
    covered = np.abs(alone - together) > 0.01 * alone
    for body in placed:  # one behind it shows beside its limb
        if body is not own:
            covered |= body.blocks(pixel_rays(picture, places_px), np.full(len(places_px), np.inf))
    return np.asarray(covered)


# ---- Pictures along scans: interpolated between pixels, with the weights of the pixels kept.

BLOCKED_SHARE = 0.05  # of a sample's weight on unusable pixels


class ScanSampler:
    """Samples of a window's planes at places on the detector.

    Parameters
    ----------
    places_px : (..., 2) array
        (pixel, line).
    window : (int, int, int, int)
        First pixel, first line, pixels, lines of the planes.

    Examples
    --------
    >>> sampler = ScanSampler(np.array([[[11.5, 7.0], [12.5, 7.0]]]), (10, 5, 6, 4))
    >>> sampler.sample(np.tile(np.arange(6.0), (4, 1)))
    array([[1.5, 2.5]])
    """

    def __init__(self, places_px: FloatArray, window: tuple[int, int, int, int]) -> None:
        first_pixel, first_line, self._n_pixel, self._n_line = window
        self.shape = places_px.shape[:-1]
        self._pixel, pixel_weight = _taps(places_px[..., 0] - first_pixel)
        self._line, line_weight = _taps(places_px[..., 1] - first_line)
        self._outside = self._out_of_window()
        weight = line_weight[..., :, None] * pixel_weight[..., None, :]
        self._weight = weight.reshape(*self.shape, 16)
        lines = np.clip(self._line, 0, self._n_line - 1)
        pixels = np.clip(self._pixel, 0, self._n_pixel - 1)
        index = lines[..., :, None] * self._n_pixel + pixels[..., None, :]
        self._index = index.reshape(*self.shape, 16)

    def _out_of_window(self) -> BoolArray:
        off_pixel = (self._pixel[..., 1] < 0) | (self._pixel[..., 2] >= self._n_pixel)
        off_line = (self._line[..., 1] < 0) | (self._line[..., 2] >= self._n_line)
        return np.asarray(off_pixel | off_line)

    def sample(self, plane: FloatArray) -> FloatArray:
        """Return the values (...,) of a plane (n_line, n_pixel); beyond its edge the edge's values count."""
        return np.asarray(np.einsum("...k,...k->...", plane.reshape(-1)[self._index], self._weight))

    def blocked(self, usable: BoolArray) -> BoolArray:
        """Tell which samples (...,) rest on pixels that are not usable, or lie outside of the window."""
        lost = (~usable).astype(np.float64)
        share = np.einsum("...k,...k->...", lost.reshape(-1)[self._index], np.abs(self._weight))
        return np.asarray(self._outside | (share > BLOCKED_SHARE))

    def pixel_weights(self, sample_weight: FloatArray) -> csr_matrix:
        """Return the weights (n, pixels) of the window's pixels in sums over samples (n, w) with given weights."""
        n = self.shape[0]
        values = (sample_weight[..., None] * self._weight).reshape(n, -1)
        index = self._index.reshape(n, -1)
        rows = np.repeat(np.arange(n), index.shape[1])
        size = (n, self._n_line * self._n_pixel)
        return csr_matrix((values.ravel(), (rows, index.ravel())), shape=size)


def _taps(place: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Return the four pixels (..., 4) about places (...,), and their weights."""
    below = np.floor(place)
    pixel = below.astype(np.int64)[..., None] + np.arange(-1, 3)
    t = (place - below)[..., None] - np.arange(-1.0, 3.0)
    return pixel, _keys(np.abs(t))


def _keys(t: FloatArray) -> FloatArray:
    near = (1.5 * t - 2.5) * t * t + 1.0
    far = ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0
    return np.where(t < 1.0, near, np.where(t < 2.0, far, 0.0))
