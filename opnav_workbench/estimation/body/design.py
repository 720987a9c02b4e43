"""A picture's outline and landmarks as residuals with partials, for any body, trajectory and attitude.

Where a silhouette runs follows from the points of the surface that lines of sight touch: to first order it moves, across
itself, as those points do, for along the line of sight they do not show. So an outline has the partials of landmarks on the
limb, taken across it and gathered into its five numbers (`opnav_workbench.estimation.body.sightings`).

Frame  J2000; body-fixed places from the center of mass
Units  px, km, rad
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies import Outline
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.body.knowledge import (
    LIMB,
    MAP,
    OFFSET,
    POLE,
    POSITION,
    RADII,
    SHARED,
    SPIN,
    VELOCITY,
)
from opnav_workbench.estimation.body.rotation import BodyRotation
from opnav_workbench.estimation.body.sightings import BodySighting, LandmarkReading, OutlineReading
from opnav_workbench.geometry import (
    apparent_direction,
    least_turn,
    limb_on_surface,
    rotation_from_vector,
    unit,
)
from opnav_workbench.landmarks import LandmarkPartials, landmark_partials
from opnav_workbench.landmarks.prediction import landmark_places
from opnav_workbench.targets import TargetState

__all__ = ["BodyState", "Rows", "landmark_rows", "outline_rows", "spun_target"]

LIMB_POINTS = 96  # an ellipse's five numbers are smooth: twice as many change none by 1e-4 px
LEAST_WEIGHT = 0.02  # of a piece of limb that is dark: it is not seen, but ellipses are ellipses all around
ROTATION = (POLE.columns.start, SPIN.columns.stop)


@dataclass(frozen=True, slots=True, eq=False)
class BodyState:
    """Everything that is solved for.

    Attributes
    ----------
    state : (6,) array
        Correction of the body's place and velocity relative to the spacecraft at the epoch, J2000: true minus ephemeris.
    radii_km, offset_km : (3,) arrays
        Semi-axes; center of figure from the center of mass, body-fixed.
    limb_px
        By how much all limbs are read too far out.
    map_log : (3,) array
        Logarithms of the landmarks' scale along the body's axes.
    attitudes : (m, 3) array
        Error of each picture's attitude, ``true = rotation_from_vector(eps) @ camera_from_j2000``.
    places_km
        Correction of each landmark's place (3,), by its name.
    """

    state: FloatArray
    radii_km: FloatArray
    rotation: BodyRotation
    offset_km: FloatArray
    limb_px: float
    map_log: FloatArray
    attitudes: FloatArray
    places_km: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def moved(self, step: FloatArray) -> "BodyState":
        """Return the state after a step: what is shared, attitudes, landmarks in the order of `places_km`."""
        shared, rest = step[:SHARED], step[SHARED:]
        m = len(self.attitudes)
        attitudes = self.attitudes + rest[: 3 * m].reshape(m, 3)
        places = rest[3 * m :].reshape(-1, 3)
        return BodyState(
            self.state + shared[: VELOCITY.columns.stop],
            self.radii_km * np.exp(shared[RADII.columns]),
            self.rotation.turned(shared[slice(*ROTATION)]),
            self.offset_km + shared[OFFSET.columns],
            self.limb_px + float(shared[LIMB.columns][0]),
            self.map_log + shared[MAP.columns],
            attitudes,
            {name: old + new for (name, old), new in zip(self.places_km.items(), places, strict=True)},
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Residuals of one picture's outline or landmarks.

    Attributes
    ----------
    residual, covariance : (k,), (k, k) arrays
        Observed minus computed.
    by_shared, by_attitude : (k, 20), (k, 3) arrays
        How the computed values move with what all pictures share, and with the picture's attitude.
    by_place : (n, 2, 3) array or None
        Of n landmarks, with the place of each.
    """

    residual: FloatArray
    by_shared: FloatArray
    by_attitude: FloatArray
    covariance: FloatArray
    by_place: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def spun_target(sighting: BodySighting, state: BodyState, position_km: FloatArray) -> TargetState:
    """Return the body of a state at a place: turned as when the light left, and of its size."""
    emitted = sighting.et - float(np.linalg.norm(position_km)) / SPEED_OF_LIGHT_KM_S
    turn = state.rotation.body_from_j2000(emitted)
    return replace(sighting.target, position_km=position_km, body_from_j2000=turn, radii_km=state.radii_km)


def outline_rows(
    sighting: BodySighting,
    reading: OutlineReading,
    state: BodyState,
    attitude: FloatArray,
    transition: FloatArray,
) -> Rows:
    """Return the five residuals of an outline; `attitude` is the error of the picture's, `transition` (3, 6).

    Raises
    ------
    EstimationError
        The camera stands within the body.
    """
    target = spun_target(sighting, state, sighting.target.position_km + transition @ state.state)
    believed = rotation_from_vector(attitude) @ sighting.camera_from_j2000
    assert target.body_from_j2000 is not None
    turn = target.body_from_j2000
    center = turn @ target.position_km + state.offset_km  # of the figure, from the camera, body-fixed
    try:
        surface = limb_on_surface(center, state.radii_km, np.eye(3), LIMB_POINTS)
    except ValueError as error:
        raise EstimationError(f"{sighting.image}: {error}") from error
    places = surface + state.offset_km
    turned, step_px = _turned_onto(sighting, reading, believed, center @ turn)
    view = (target, sighting.camera, turned, sighting.velocity_km_s)
    gather, normal, gap = _gathered(reading, landmark_places(places, *view))
    gap = gap + normal @ step_px
    partials = _across(normal, landmark_partials(places, *view))
    across = _by_motion(sighting, target, state, partials, transition)
    across[:, RADII.columns] = partials.place_px_per_km * surface
    across[:, OFFSET.columns] = partials.place_px_per_km
    across[:, LIMB.columns] = 1.0
    by_shared = gather @ across
    bias = gather @ np.full(LIMB_POINTS, state.limb_px)
    residual = gather @ gap + reading.offset - bias
    return Rows(residual, by_shared, gather @ partials.attitude_px_per_rad, reading.covariance)


def landmark_rows(
    sighting: BodySighting,
    reading: LandmarkReading,
    state: BodyState,
    attitude: FloatArray,
    transition: FloatArray,
) -> Rows:
    """Return the 2 n residuals of landmarks, pixel and line of each in turn; parameters as of `outline_rows`."""
    target = spun_target(sighting, state, sighting.target.position_km + transition @ state.state)
    turned = rotation_from_vector(attitude) @ sighting.camera_from_j2000
    scaled = reading.place_km * np.exp(state.map_log)
    places = scaled + np.array([state.places_km[name] for name in reading.id.tolist()])
    view = (target, sighting.camera, turned, sighting.velocity_km_s)
    residual = reading.observed_px - landmark_places(places, *view)
    if not np.isfinite(residual).all():
        raise EstimationError(f"{sighting.image}: landmarks would lie beyond what the camera model covers.")
    partials = landmark_partials(places, *view)
    n = len(reading)
    flat = LandmarkPartials(
        partials.spacecraft_px_per_km.reshape(2 * n, 3),
        partials.attitude_px_per_rad.reshape(2 * n, 3),
        partials.body_px_per_rad.reshape(2 * n, 3),
        partials.place_px_per_km.reshape(2 * n, 3),
    )
    by_shared = _by_motion(sighting, target, state, flat, transition)
    by_shared[:, MAP.columns] = flat.place_px_per_km * np.repeat(scaled, 2, axis=0)
    covariance = np.tile(reading.common_covariance_px2, (n, n))
    for i in range(n):
        covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += reading.covariance_px2[i]
    return Rows(residual.ravel(), by_shared, flat.attitude_px_per_rad, covariance, partials.place_px_per_km)


def _turned_onto(
    sighting: BodySighting, reading: OutlineReading, believed: FloatArray, figure_km: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the attitude that sees the figure's center where the outline has it, and how far (2,) px that is from believed.

    So an outline is compared about its own center, however far off the trajectory is, and never beyond what the camera model
    covers.
    """
    camera = sighting.camera
    seen = unit(camera.unproject(reading.outline.center_px[None])[0])
    expected = unit(apparent_direction(figure_km, sighting.velocity_km_s) @ believed.T)
    along = float(seen @ expected)
    if not along > 0.0:
        raise EstimationError(f"{sighting.image}: its body would stand behind the camera.")
    step_px = camera.project_jacobian(seen[None])[0] @ (seen - expected / along)
    return rotation_from_vector(least_turn(expected, seen)) @ believed, np.asarray(step_px)


def _gathered(reading: OutlineReading, predicted: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what makes five numbers of steps across the limb (5, n), its normals (n, 2), and observed minus predicted."""
    outline = reading.outline
    if not np.isfinite(predicted).all():
        raise EstimationError(
            "a body would reach beyond what the camera model covers; give its size and range better."
        )
    away = predicted - outline.center_px
    angle = np.arctan2(away[:, 1], away[:, 0])
    wheel = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    radius = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=2.0 * np.pi)
    side = np.stack([-wheel[:, 1], wheel[:, 0]], axis=-1)
    normal = radius[:, None] * wheel - slope[:, None] * side
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    rise = np.einsum("ij,ij->i", normal, wheel)
    lit = np.interp(angle, outline.angle_rad, reading.lit, period=2.0 * np.pi)
    grown = np.stack([np.ones_like(angle), *Outline.waves(angle, slope / radius)])
    basis = np.column_stack([normal, (grown * radius * rise).T])
    weight = np.sqrt(np.maximum(lit, LEAST_WEIGHT))
    gather = np.linalg.pinv(basis * weight[:, None]) * weight
    return gather, normal, (radius - np.hypot(away[:, 0], away[:, 1])) * rise


def _across(normal: FloatArray, partials: LandmarkPartials) -> LandmarkPartials:
    """Return partials (n, 3) of steps across the limb."""
    return LandmarkPartials(
        *(
            np.einsum("ni,nij->nj", normal, matrix)
            for matrix in (
                partials.spacecraft_px_per_km,
                partials.attitude_px_per_rad,
                partials.body_px_per_rad,
                partials.place_px_per_km,
            )
        )
    )


def _by_motion(
    sighting: BodySighting,
    target: TargetState,
    state: BodyState,
    partials: LandmarkPartials,
    transition: FloatArray,
) -> FloatArray:
    """Return partials (k, 20) by trajectory and rotation."""
    out = np.zeros((len(partials.spacecraft_px_per_km), SHARED))
    moved = -partials.spacecraft_px_per_km @ transition
    out[:, POSITION.columns], out[:, VELOCITY.columns] = moved[:, :3], moved[:, 3:]
    emitted = sighting.et - target.range_km / SPEED_OF_LIGHT_KM_S
    out[:, slice(*ROTATION)] = partials.body_px_per_rad @ state.rotation.partials(emitted)
    return out
