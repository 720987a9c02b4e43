"""Lost over a body: where the camera stands, from the lit silhouette alone, so that landmarks can be predicted.

The body's lit part in the picture has a middle and an area; so has the body as it would be drawn from a trial place. The
trial's direction is moved by the difference of the middles, and its range by the root of the areas' ratio, until both
agree. Attitude, orientation and the Sun's direction are taken as known; an outline that is not quite the shape's leaves
some percent of range, and some hundredths of the diameter across.

Frame  J2000; (pixel, line)
Units  km, px
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture, displaced_model, pixel_rays
from opnav_workbench.errors import CameraError, CenterfindingError
from opnav_workbench.landmarks.finder import LARGEST_RADIUS_PX, find_landmarks
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.landmarks.results import LandmarkSolution
from opnav_workbench.render import BodyModel
from opnav_workbench.render.body import PlacedBody

__all__ = ["SilhouettePlace", "find_lost_landmarks", "place_from_silhouette"]

GRID = 192  # points along a side of the square about the body
BRIGHT_SHARE, BRIGHT_QUANTILE = 0.2, 0.95  # lit is what has a fifth of the brightness of the brightest
NOISE_SIGMAS = 6.0
MOST_STEPS, STEP_SHARE = 12, 2e-3  # of the diameter
LEAST_DIAMETER_PX = 20.0
ACROSS_SHARE, RANGE_SHARE = 0.02, 0.03  # 1 sigma: of the diameter, of the range


@dataclass(frozen=True, slots=True, eq=False)
class SilhouettePlace:
    """Where a body is, as its silhouette tells; arrays are read-only.

    Attributes
    ----------
    position_km : (3,) array
        Of the body from the spacecraft, J2000.
    covariance_km2 : (3, 3) array
    center_px : (2,) array
        (pixel, line) of its center of figure.
    diameter_px
        Of a circle with the area of its lit part.
    """

    position_km: FloatArray
    covariance_km2: FloatArray
    center_px: FloatArray
    diameter_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


def place_from_silhouette(picture: BodyPicture, name: str) -> SilhouettePlace:
    """Return where a body is, from its lit silhouette; its state in the picture's models may be far off.

    Raises
    ------
    CenterfindingError
        Nothing lit is seen, it is too small, it reaches off the picture, or the trial places do not settle.
    """
    seen_px, seen_area = _lit_part(picture)
    scale = 1.0
    place = seen_px
    for _ in range(MOST_STEPS):
        try:
            model = displaced_model(picture, name, place, scale)
            middle, area = _drawn_part(picture, model)
        except CameraError:  # within the sphere about the shape: start from farther away
            scale *= 2.0
            continue
        step = seen_px - middle
        nearer = float(np.sqrt(area / seen_area))
        # A body that is twice as far has half the step to its center.
        place, scale = place + step, scale * nearer
        if np.hypot(*step) < STEP_SHARE * np.sqrt(seen_area) and abs(nearer - 1.0) < STEP_SHARE:
            break
    else:
        raise CenterfindingError(
            f"{name}: its silhouette does not settle on a place; its orientation, the Sun or the attitude may be wrong."
        )
    return _place(picture, displaced_model(picture, name, place, scale), place, seen_area)


def _place(picture: BodyPicture, model: BodyModel, center_px: FloatArray, area: float) -> SilhouettePlace:
    position = model.target.position_km
    range_km, diameter = float(np.linalg.norm(position)), 2.0 * float(np.sqrt(area / np.pi))
    toward = position / range_km
    across = ACROSS_SHARE * diameter * picture.camera.pixel_scale_rad * range_km
    along = np.outer(toward, toward)
    covariance = across**2 * (np.eye(3) - along) + (RANGE_SHARE * range_km) ** 2 * along
    return SilhouettePlace(position, covariance, center_px, diameter)


def _lit_part(picture: BodyPicture) -> tuple[FloatArray, float]:
    """Return middle (2,) and area of the largest lit area of the picture, px."""
    signal = np.nan_to_num(np.asarray(picture.signal_dn))
    floor = NOISE_SIGMAS * float(np.median(picture.noise_dn))
    bright = signal[(signal > floor) & ~picture.bad]
    if bright.size < LEAST_DIAMETER_PX**2 / 2.0:
        raise CenterfindingError("no lit body is seen in the picture; look at its exposure.")
    limit = max(floor, BRIGHT_SHARE * float(np.quantile(bright, BRIGHT_QUANTILE)))
    areas, count = ndimage.label((signal > limit) | picture.saturated)
    largest = 1 + int(np.argmax(np.bincount(areas.ravel())[1:])) if count else 0
    lit = ndimage.binary_fill_holes(areas == largest) if count else np.zeros(signal.shape, dtype=bool)
    area = float(lit.sum())
    if not area > LEAST_DIAMETER_PX**2 / 2.0:
        raise CenterfindingError(f"the largest lit area has {area:.0f} pixels; landmarks need a larger body.")
    if lit[[0, -1]].any() or lit[:, [0, -1]].any():
        raise CenterfindingError(
            "the lit body reaches off the picture, so its silhouette tells no place; give a better a priori position."
        )
    line, pixel = np.nonzero(lit)
    return np.array([pixel.mean(), line.mean()]), area


def _drawn_part(picture: BodyPicture, model: BodyModel) -> tuple[FloatArray, float]:
    """Return the same of a body's model, from rays on a square grid about it."""
    body = PlacedBody(model, picture.camera.pixel_scale_rad)
    half = 1.05 * np.tan(body.angular_radius_rad) / picture.camera.pixel_scale_rad
    apparent = picture.camera_from_j2000 @ model.target.position_km
    center = picture.camera.project(apparent[None])[0]
    at = half * ((2.0 * np.arange(GRID) + 1.0) / GRID - 1.0)
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    places = center + np.stack([x, y], axis=-1)
    rays = pixel_rays(picture, places)
    seen = np.isfinite(rays).all(axis=0)
    light = np.zeros(len(places))
    light[seen] = body.radiance(rays[:, seen])
    if not light.any():
        raise CenterfindingError(f"{model.target.name}: from no trial place a lit part of it can be seen.")
    lit = light > BRIGHT_SHARE * float(np.quantile(light[light > 0.0], BRIGHT_QUANTILE))
    lit = ndimage.binary_fill_holes(lit.reshape(GRID, GRID)).ravel()
    return places[lit].mean(axis=0), float(lit.sum()) * (2.0 * half / GRID) ** 2


def find_lost_landmarks(
    picture: BodyPicture, maplets: Maplets, *, attitude_covariance_rad2: FloatArray | None = None
) -> LandmarkSolution:
    """Find the landmarks of a body whose place nobody knows: from its silhouette first, then from its landmarks.

    Residuals are those from the silhouette's place; the pose is the landmarks' own. Parameters and errors as of
    `find_landmarks` and `place_from_silhouette`.
    """
    start = place_from_silhouette(picture, maplets.body)
    model = picture.model(maplets.body)
    target = model.target.standing_at(start.position_km)
    moved = tuple(replace(m, target=target) if m is model else m for m in picture.models)
    radius = float(np.clip(4.0 * ACROSS_SHARE * start.diameter_px, 8.0, LARGEST_RADIUS_PX))
    found = find_landmarks(
        replace(picture, models=moved),
        maplets,
        attitude_covariance_rad2=attitude_covariance_rad2,
        search_radius_px=radius,
    )
    return replace(found, centers=replace(found.centers, start_km=start.position_km))
