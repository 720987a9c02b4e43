"""Where landmarks appear, how they are lit and seen, which can be found, and how their places move.

A landmark is a point of the rigid body that the target's state describes: as everywhere in this package, the body stands
and is turned as when the light left its center. A point nearer than that by h leaves its light h / c later; for a body
that orbits the Sun with 30 km/s that is 1e-4 h, 0.025 m on Bennu.

Frame  J2000; places body-fixed; small rotations about the axes of the frame that they turn
Units  km, rad, px
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, CenterfindingError
from opnav_workbench.geometry import aberration_jacobian, apparent_direction, unit
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.render import BodyModel
from opnav_workbench.render.ellipsoid import Ellipsoid, Surface
from opnav_workbench.render.shape import PlateSurface
from opnav_workbench.targets import TargetState

__all__ = [
    "LandmarkPartials",
    "LandmarkPrediction",
    "WholeBody",
    "body_axes",
    "landmark_partials",
    "landmark_places",
    "pixel_size_km",
    "predict_landmarks",
]

# Beyond the first a patch is foreshortened to a third. Beyond the second terrain that is finer than a maplet's lengthens all
# shadows, so that landmarks stand away from the Sun by more than their sigmas: 0.04 px at 68 deg, 0.1 px at 76 deg, and a
# tenth of that with the true heights (tests/landmarks/landmark_exam.py).
MOST_EMISSION_DEG, MOST_INCIDENCE_DEG = 72.0, 70.0
# Of a body's mean radius: how far the terrain of a maplet may stand over or under the shape that hides and shades it.
CLEARANCE = 0.004
LEAST_PIXELS = 8.0  # width of a maplet in the picture
RATIOS = (0.2, 4.0)  # of sample to pixel: coarser shows nothing of the picture's detail


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPartials:
    """How (pixel, line) of n landmarks move; arrays are read-only.

    Attributes
    ----------
    spacecraft_px_per_km : (n, 2, 3) array
        With the spacecraft's position, J2000; attitude and body held fixed.
    attitude_px_per_rad : (n, 2, 3) array
        With the error of the attitude, ``true = rotation_from_vector(eps) @ camera_from_j2000``.
    body_px_per_rad : (n, 2, 3) array
        With that of the body's orientation (pole, prime meridian), ``true = rotation_from_vector(phi) @ body_from_j2000``.
    place_px_per_km : (n, 2, 3) array
        With the landmark's place, body-fixed.
    """

    spacecraft_px_per_km: FloatArray
    attitude_px_per_rad: FloatArray
    body_px_per_rad: FloatArray
    place_px_per_km: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPrediction:
    """What a picture should show of n landmarks; arrays are read-only.

    Attributes
    ----------
    pixel_line : (n, 2) array
        Px; nan behind the camera.
    emission_rad, incidence_rad : (n,) arrays
        Of the maplets' planes.
    range_km : (n,) array
    ratio : (n,) array
        Sample of the maplet over pixel of the picture, on the surface.
    reason : (n,) array of str
        Why one cannot be found; empty for those that can.
    """

    id: NDArray[np.str_]
    pixel_line: FloatArray
    emission_rad: FloatArray
    incidence_rad: FloatArray
    range_km: FloatArray
    ratio: FloatArray
    reason: NDArray[np.str_]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def usable(self) -> BoolArray:
        """Visible, well lit, and of a resolution that suits (n,)."""
        return np.asarray(self.reason == "")


def body_axes(target: TargetState) -> FloatArray:
    """Return ``body_from_j2000`` of a target.

    Raises
    ------
    CenterfindingError
        It is not known.
    """
    if target.body_from_j2000 is None:
        raise CenterfindingError(
            f"{target.name}: its orientation is unknown, so no landmark on it can be predicted; give kernels with its "
            "pole and spin."
        )
    return target.body_from_j2000


def landmark_places(
    place_km: FloatArray,
    target: TargetState,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
) -> FloatArray:
    """Return (pixel, line) (..., 2) of body-fixed places (..., 3); nan where the camera cannot see."""
    seen = target.position_km + place_km @ body_axes(target)
    return camera.project(apparent_direction(seen, velocity_km_s) @ camera_from_j2000.T)


def landmark_partials(
    place_km: FloatArray,
    target: TargetState,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
) -> LandmarkPartials:
    """Return how the places (n, 2) px of body-fixed points (n, 3) move; the light time is held fixed."""
    turn = body_axes(target)
    seen = target.position_km + place_km @ turn
    distance = np.linalg.norm(seen, axis=1)[:, None, None]
    toward = unit(seen)
    of_unit = (np.eye(3) - toward[:, :, None] * toward[:, None, :]) / distance
    in_camera = apparent_direction(toward, velocity_km_s) @ camera_from_j2000.T
    of_direction = camera.project_jacobian(in_camera) @ camera_from_j2000
    of_seen = of_direction @ aberration_jacobian(toward, velocity_km_s) @ of_unit
    of_place = of_seen @ turn.T
    x, y, z = place_km.T
    zero = np.zeros_like(x)
    # A body turned by phi carries a point r to r - phi x r in J2000 = r + [r] phi.
    crossed = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    return LandmarkPartials(-of_seen, camera.attitude_jacobian(in_camera), of_place @ crossed, of_place)


def pixel_size_km(camera: Camera, range_km: FloatArray) -> FloatArray:
    """Return what a pixel covers across the line of sight (n,)."""
    return np.asarray(camera.pixel_scale_rad * range_km)


@dataclass(frozen=True, slots=True, eq=False)
class WholeBody:
    """The body's surface before the camera and under the Sun: what hides and shades parts of it.

    Attributes
    ----------
    camera_km, to_sun : (3,) arrays
        Body-fixed: where the camera stands, and the unit vector to the Sun.
    lift_km
        By how much terrain may stand under the surface that stands for the body.
    """

    surface: Surface
    camera_km: FloatArray
    to_sun: FloatArray
    lift_km: float

    @classmethod
    def of(cls, model: BodyModel) -> "WholeBody | None":
        """Return that of a model; None where no shape or size is known, or the camera stands within the sphere about it.

        Raises
        ------
        CenterfindingError
            The body's orientation or the Sun is not known.
        """
        target = model.target
        turn = body_axes(target)
        if target.sun_position_km is None:
            raise CenterfindingError(
                f"{target.name}: where the Sun stands is unknown, so its landmarks cannot be drawn."
            )
        camera_km, sun_km = -turn @ target.position_km, turn @ target.sun_position_km
        try:
            if model.shape is not None:
                surface: Surface = PlateSurface(model.shape, camera_km, sun_km)
            elif target.radii_km is not None and np.all(target.radii_km > 0.0):
                surface = Ellipsoid(np.asarray(target.radii_km), camera_km, sun_km)
            else:
                return None
        except CameraError:
            return None
        return cls(surface, camera_km, unit(sun_km), CLEARANCE * surface.bounding_km)

    def hides_and_shades(
        self,
        points_km: FloatArray,
        camera_free_km: FloatArray | float = 0.0,
        sun_free_km: FloatArray | float = 0.0,
    ) -> tuple[BoolArray, BoolArray]:
        """Tell which body-fixed points (3, n) are hidden from the camera, and which from the Sun.

        Parameters
        ----------
        camera_free_km, sun_free_km : (n,) arrays or float
            How far from each point, toward camera and Sun, others know the terrain better than this surface does: nothing
            there hides or shades.
        """
        rays = points_km - self.camera_km[:, None]
        met = self.surface.first_hits(rays)
        hidden = np.zeros(points_km.shape[1], dtype=bool)
        free = np.broadcast_to(np.maximum(camera_free_km, self.lift_km), hidden.shape)
        hidden[met.ray] = met.distance < 1.0 - free[met.ray] / np.linalg.norm(rays[:, met.ray], axis=0)
        start = points_km + np.maximum(sun_free_km, self.lift_km) * self.to_sun[:, None]
        return hidden, ~self.surface.sunlit(start)


def predict_landmarks(
    maplets: Maplets,
    model: BodyModel,
    camera: Camera,
    camera_from_j2000: FloatArray,
    velocity_km_s: FloatArray,
    *,
    most_emission_deg: float = MOST_EMISSION_DEG,
    most_incidence_deg: float = MOST_INCIDENCE_DEG,
    whole: WholeBody | None = None,
) -> LandmarkPrediction:
    """Predict which landmarks a picture shows, and where.

    Parameters
    ----------
    model
        The body: where it is, how it is turned and lit; its shape, or its ellipsoid, hides and shades.
    velocity_km_s : (3,) array
        Of the spacecraft with respect to the solar-system barycenter.
    most_emission_deg, most_incidence_deg
        What is seen or lit more obliquely is left out.
    whole
        Of the same model, where it is at hand.

    Raises
    ------
    CenterfindingError
        The body's orientation or the Sun is not known.
    """
    target = model.target
    turn = body_axes(target)
    places = landmark_places(maplets.place_km, target, camera, camera_from_j2000, velocity_km_s)
    whole = WholeBody.of(model) if whole is None else whole
    to_camera = -turn @ target.position_km - maplets.place_km
    assert target.sun_position_km is not None
    to_sun = turn @ target.sun_position_km - maplets.place_km
    up = maplets.axes[:, 2]
    emission = np.arccos(np.clip(np.sum(unit(to_camera) * up, axis=1), -1.0, 1.0))
    incidence = np.arccos(np.clip(np.sum(unit(to_sun) * up, axis=1), -1.0, 1.0))
    distance = np.linalg.norm(to_camera, axis=1)
    pixel_km = pixel_size_km(camera, distance)
    ratio = maplets.scale_km / pixel_km
    reason = np.full(len(maplets), "", dtype=object)
    wide = 2.0 * maplets.half_width_km / pixel_km
    for why, wrong in (
        (
            "too coarse or too fine for this picture",
            (ratio < RATIOS[0]) | (ratio > RATIOS[1]) | (wide < LEAST_PIXELS),
        ),
        (f"incidence above {most_incidence_deg:g} deg", incidence > np.radians(most_incidence_deg)),
        (f"emission above {most_emission_deg:g} deg", emission > np.radians(most_emission_deg)),
        ("on the night side", incidence > 0.5 * np.pi),
        ("turned away", emission > 0.5 * np.pi),
        ("off the detector", ~camera.on_detector(places)),
    ):
        reason[wrong] = why
    open_rows = np.flatnonzero(reason == "")
    if whole is not None and len(open_rows):
        hidden, dark = whole.hides_and_shades(maplets.place_km[open_rows].T)
        reason[open_rows[dark]] = "in shadow"
        reason[open_rows[hidden]] = "hidden by the body"
    return LandmarkPrediction(
        maplets.id, places, emission, incidence, distance, ratio, np.asarray(reason, dtype=np.str_)
    )
