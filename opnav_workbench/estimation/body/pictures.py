"""From pictures to a body: outlines read, the batch solved, and the outlines read again with the body that came out.

What a disk's fit says of a figure that is five percent off is good to first order; the second reading begins where the first
solution ends, and the last finds almost nothing left to correct.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies import BodyPicture
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import CenterfindingError, EstimationError
from opnav_workbench.estimation.body.design import BodyState
from opnav_workbench.estimation.body.knowledge import BodyKnowledge
from opnav_workbench.estimation.body.rotation import BodyRotation
from opnav_workbench.estimation.body.sightings import BodySighting, landmark_reading, read_outline
from opnav_workbench.estimation.body.solution import BodySolution, solve_body
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.landmarks import LandmarkSolution
from opnav_workbench.targets import TargetState

__all__ = ["SequencePicture", "solve_body_from_pictures", "solved_picture"]

PASSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class SequencePicture:
    """One picture of a sequence.

    Attributes
    ----------
    image, et
        Mid-exposure, TDB seconds past J2000.
    picture
        With a model of the body, and the attitude that the stars gave.
    attitude_covariance_rad2 : (3, 3) array
        Of that attitude.
    landmarks
        Of the body, where they were looked for.
    """

    image: str
    et: float
    picture: BodyPicture
    attitude_covariance_rad2: FloatArray
    landmarks: LandmarkSolution | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)


def solve_body_from_pictures(
    pictures: Sequence[SequencePicture],
    name: str,
    rotation: BodyRotation,
    knowledge: BodyKnowledge | None = None,
    *,
    radii_km: FloatArray | None = None,
    transition: Transition = straight_line,
    passes: int = PASSES,
    say: Callable[[str, str], None] = lambda _name, _words: None,
) -> BodySolution:
    """Solve for a body from pictures of it, reading their outlines anew with what came out.

    Parameters
    ----------
    pictures
        Of one approach, each with a model of the body.
    name
        Of the body.
    rotation, knowledge, radii_km, transition
        As `solve_body`.
    passes
        How often outlines are read.
    say
        Called with a picture's name and a few words before it is read.

    Raises
    ------
    EstimationError
        No picture shows an outline or landmarks, or too much does not fit.
    CenterfindingError
        A picture has no model of the body.
    """
    if not pictures:
        raise EstimationError("no pictures to solve a body from; give those of an approach.")
    first = pictures[0].picture.model(name).target.radii_km if radii_km is None else radii_km
    if first is None:
        raise EstimationError(f"the size of {name} is unknown; give its radii, km.")
    believed = np.asarray(first, float)
    knowledge = knowledge or BodyKnowledge()
    solution: BodySolution | None = None
    for number in range(1, passes + 1):
        sightings = []
        for one in pictures:
            say(one.image, f"reading its outline, pass {number} of {passes}")
            sightings.append(_sighting(one, name, rotation, believed, solution, transition))
        _require_one(sightings)
        solution = solve_body(
            sightings, rotation, knowledge, radii_km=believed, transition=transition,
            start=None if solution is None else _start(solution, sightings),
        )  # fmt: skip
    assert solution is not None
    left = tuple(f"{s.image}: {s.note}" for s in sightings if s.note)
    return replace(solution, messages=(*solution.messages, *left))


def _require_one(sightings: Sequence[BodySighting]) -> None:
    if all(s.outline is None and s.landmarks is None for s in sightings):
        why = "; ".join(f"{s.image}: {s.note}" for s in sightings[:2])
        raise EstimationError(f"none of {len(sightings)} pictures shows an outline that can be used ({why}).")


def _sighting(
    one: SequencePicture,
    name: str,
    rotation: BodyRotation,
    radii_km: FloatArray,
    solution: BodySolution | None,
    transition: Transition,
) -> BodySighting:
    """Return what a picture shows of the body, read with the best model of it that there is."""
    sighting = _before_reading(one, name, rotation, radii_km)
    picture = _picture_with(one, name, sighting, solution, transition)
    try:
        outline, note = read_outline(picture, name)
    except CenterfindingError as error:  # of one picture: the others go on
        outline, note = None, str(error)
    return replace(sighting, outline=outline, note=note)


def _before_reading(
    one: SequencePicture, name: str, rotation: BodyRotation, radii_km: FloatArray
) -> BodySighting:
    """Return a picture's view of the body as it is believed, without the outline."""
    return BodySighting(
        image=one.image,
        et=one.et,
        target=_placed(one.picture.model(name).target, rotation, radii_km, one.et),
        camera=one.picture.camera,
        camera_from_j2000=one.picture.camera_from_j2000,
        attitude_covariance_rad2=np.asarray(one.attitude_covariance_rad2),
        velocity_km_s=one.picture.observer_velocity_km_s,
        landmarks=None if one.landmarks is None else landmark_reading(one.landmarks),
    )


def _picture_with(
    one: SequencePicture,
    name: str,
    sighting: BodySighting,
    solution: BodySolution | None,
    transition: Transition,
) -> BodyPicture:
    """Return a picture with a plain model of the body: as believed, or as a solution has it."""
    own = one.picture.model(name)
    plain = replace(own, target=sighting.target, shape=None, albedo=1.0)
    model = plain if solution is None else solution.model(plain, sighting, transition)
    return one.picture.with_model(model)


def solved_picture(
    one: SequencePicture, name: str, solution: BodySolution, transition: Transition = straight_line
) -> BodyPicture:
    """Return a picture of the sequence with the body's size, place and rotation and the attitude as solved."""
    sighting = _before_reading(one, name, solution.a_priori_rotation, solution.a_priori_radii_km)
    picture = _picture_with(one, name, sighting, solution, transition)
    error = solution.state.attitudes[solution.images.index(one.image)]
    return replace(picture, camera_from_j2000=rotation_from_vector(error) @ picture.camera_from_j2000)


def _placed(target: TargetState, rotation: BodyRotation, radii_km: FloatArray, et: float) -> TargetState:
    turn = rotation.body_from_j2000(et - target.range_km / SPEED_OF_LIGHT_KM_S)
    return replace(target, radii_km=radii_km, body_from_j2000=turn)


def _start(solution: BodySolution, sightings: Sequence[BodySighting]) -> BodyState:
    """Return a solution as the start of another: of pictures that may not be the same ones."""
    known = dict(zip(solution.images, solution.state.attitudes, strict=True))
    seen = [s for s in sightings if s.outline is not None or s.landmarks is not None]
    attitudes = np.array([known.get(s.image, np.zeros(3)) for s in seen]).reshape(-1, 3)
    names = dict.fromkeys(n for s in seen if s.landmarks is not None for n in s.landmarks.id.tolist())
    places = {n: solution.state.places_km.get(n, np.zeros(3)) for n in names}
    return replace(solution.state, attitudes=attitudes, places_km=places)
