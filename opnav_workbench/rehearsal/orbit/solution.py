"""The team's estimate in orbit: place and velocity, the body's rotation, the map's size, in one batch over all pictures.

A picture's attitude is that of its stars, or the one carried from a neighbor, or the predicted one with the camera's own
uncertainty; the batch solves for it in any case. Landmarks are those that were accepted in the pictures' results. The
spacecraft's place at a later time follows by two-body motion of the correction.

Frame  J2000
Units  km, km/s, rad, rad/s; sizes of the map as logarithms
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.camera import Camera
from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation import kepler
from opnav_workbench.estimation.body import (
    BodyKnowledge,
    BodyRotation,
    BodySighting,
    BodySolution,
    LandmarkReading,
    solve_body,
)
from opnav_workbench.estimation.body.knowledge import MAP, POLE, POSITION, SPIN, VELOCITY
from opnav_workbench.geometry import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from opnav_workbench.kernels import KernelSet, body_attitude, camera_attitude, et_from_utc, state
from opnav_workbench.landmarks import Maplets
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.rehearsal.results import NOT_REPORTED, PictureResult, picture_results
from opnav_workbench.rehearsal.solution import checked_array, read_solution_file, write_solution_file
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.version import __version__

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrbitContent, OrtPackage, OrtPicture

__all__ = ["GROUPS", "OrbitGroup", "OrbitSolution", "solve_orbit_rehearsal"]

SCHEMA = "opnav_ort_orbit_1"
FROM_STARS, CARRIED, PREDICTED = "stars", "carried", "landmarks"  # what tells a picture's attitude
LEAST_PROBABILITY = 1e-3


@dataclass(frozen=True, slots=True)
class OrbitGroup:
    """Parameters that belong together, where they stand in an `OrbitSolution`."""

    name: str
    columns: slice
    labels: tuple[str, ...]
    unit: str


GROUPS = (
    OrbitGroup("spacecraft position", slice(0, 3), ("x", "y", "z"), "km"),
    OrbitGroup("spacecraft velocity", slice(3, 6), ("x", "y", "z"), "km/s"),
    OrbitGroup("pole", slice(6, 8), ("toward east", "toward north"), "rad"),
    OrbitGroup("prime meridian", slice(8, 9), ("",), "rad"),
    OrbitGroup("spin rate", slice(9, 10), ("",), "rad/s"),
    OrbitGroup("map's size", slice(10, 13), ("x", "y", "z"), "of it"),
)
COUNT = 13
SHAPES = {
    "correction": (COUNT,),
    "sigma_before": (COUNT,),
    "covariance": (COUNT, COUNT),
    "place_before_km": (3,),
    "place_km": (3,),
    "place_covariance_before_km2": (3, 3),
    "place_covariance_km2": (3, 3),
}
NUMBERS = ("chi2", "probability")
TEXTS = ("package", "epoch_utc", "predict_utc", "body", "made_by")
TUPLES = ("words", "messages", "left_out")


@dataclass(frozen=True, slots=True, eq=False)
class OrbitSolution:
    """The solution of a rehearsal in orbit; arrays are read-only.

    Attributes
    ----------
    package
        Name of the rehearsal.
    epoch_utc
        Of state and prime meridian.
    correction, sigma_before : (13,) arrays
        True minus believed, in the order of `GROUPS`, and its a priori sigma.
    covariance : (13, 13) array
    predict_utc
        When the spacecraft's place is predicted for.
    place_before_km, place_km : (3,) arrays
        Of the spacecraft from the body then, J2000, as believed before and as solved.
    place_covariance_before_km2, place_covariance_km2 : (3, 3) arrays
    chi2, degrees_of_freedom, probability
        Of the measurements' fit and of what was believed, together.
    attitudes : mapping of str to mapping
        By picture: ``quaternion_camera_from_j2000``, ``covariance_rad2``, ``source`` (stars, carried, landmarks) and
        ``n_landmarks``.
    words
        What the pictures tell, and what they do not.
    pictures
        SHA-256 of the files that it rests on, by picture and file.
    """

    package: str
    epoch_utc: str
    body: str
    correction: FloatArray
    sigma_before: FloatArray
    covariance: FloatArray
    predict_utc: str
    place_before_km: FloatArray
    place_km: FloatArray
    place_covariance_before_km2: FloatArray
    place_covariance_km2: FloatArray
    chi2: float
    degrees_of_freedom: int
    probability: float
    attitudes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    pictures: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    made_by: str = f"opnav_workbench {__version__}"

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of the parameters (13,)."""
        return tuple(f"{group.name} {label}".strip() for group in GROUPS for label in group.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Return their units (13,)."""
        return tuple(group.unit for group in GROUPS for _ in group.labels)

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations (13,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def write(self, path: str | Path) -> None:
        """Write it as JSON, whole or not at all.

        Raises
        ------
        SessionError
            A number of it is not finite, or the file cannot be written.
        """
        write_solution_file(path, SCHEMA, {name: getattr(self, name) for name in self.__slots__})

    @classmethod
    def read(cls, path: str | Path) -> "OrbitSolution":
        """Read what `write` wrote, or what a team filled in after its layout.

        Raises
        ------
        SessionError
            It cannot be read, lacks a field, or holds numbers of the wrong shape, or a matrix that is no covariance.
        """
        return cls(**read_solution_file(path, SCHEMA, "a rehearsal in orbit", _checked))


def _checked(content: Mapping[str, Any]) -> dict[str, Any]:
    fields: dict[str, Any] = {
        name: checked_array(name, content[name], shape) for name, shape in SHAPES.items()
    }
    fields |= {name: float(content[name]) for name in NUMBERS} | {name: str(content[name]) for name in TEXTS}
    fields |= {name: tuple(map(str, content.get(name, ()))) for name in TUPLES}
    attitudes = {
        str(name): dict(one)
        | {
            "quaternion_camera_from_j2000": checked_array(
                "quaternion", one["quaternion_camera_from_j2000"], (4,)
            ),
            "covariance_rad2": checked_array("covariance_rad2", one["covariance_rad2"], (3, 3)),
        }
        for name, one in content.get("attitudes", {}).items()
    }
    freedom = int(content["degrees_of_freedom"])
    return fields | {
        "attitudes": attitudes,
        "degrees_of_freedom": freedom,
        "pictures": content.get("pictures", {}),
    }


# ---- From pictures' results to the batch.


def solve_orbit_rehearsal(package: "OrtPackage", results: str | Path) -> OrbitSolution:
    """Estimate what a rehearsal in orbit asks for from what a team found in its pictures.

    Parameters
    ----------
    results
        Folder of the pictures' folders, each with ``result.json``.

    Raises
    ------
    SessionError
        The folder or a file in it cannot be read.
    EstimationError
        It is no rehearsal in orbit, no picture has landmarks, or they contradict each other.
    """
    orbit = package.orbit
    if orbit is None:
        raise EstimationError(f"{package.name} is a rehearsal of a flyby; solve_rehearsal is for those.")
    found = picture_results((p.name for p in package.pictures), results)
    maplets, mission = Maplets.read(package.maps["maplets"]), load_mission(package.mission)
    with KernelSet(package.metakernel):
        epoch = et_from_utc(package.epoch_utc)
        relative = _relative(mission, orbit.body, epoch)
        transition = kepler(relative, orbit.gm_km3_s2)
        pairs = zip(package.pictures, found, strict=True)
        seen = [_sighting(orbit.body, maplets, mission, picture, result) for picture, result in pairs]
        rotation = BodyRotation.from_attitudes(lambda et: body_attitude(orbit.body, et), epoch)
        solved = solve_body([s for s in seen if isinstance(s, BodySighting)], rotation, _known(package, orbit),
                            transition=transition)  # fmt: skip
        later = et_from_utc(orbit.predict_utc)
        place = _relative(mission, orbit.body, later)[:3]
    return _solution(package, orbit, found, seen, solved, place, transition(epoch, later)[:3])


def _relative(mission: Mission, body: str, et: float) -> FloatArray:
    found = state(mission.spacecraft_id, et, body)
    return np.concatenate([found.position_km, found.velocity_km_s])


def _known(package: "OrtPackage", orbit: "OrbitContent") -> BodyKnowledge:
    position, velocity = (package.parameters[f"spacecraft_{name}"] for name in ("position", "velocity"))
    return BodyKnowledge(
        position_sigma_km=float(np.mean(position)),
        velocity_sigma_km_s=float(np.mean(velocity)),
        pole_sigma_deg=orbit.pole_sigma_deg,
        meridian_sigma_deg=orbit.meridian_sigma_deg,
        spin_sigma=orbit.spin_sigma,
        map_sigma=orbit.map_sigma,
    )


def _sighting(
    body: str, maplets: Maplets, mission: Mission, picture: "OrtPicture", found: PictureResult
) -> BodySighting | str:
    """Return what a picture shows of the body's landmarks, or why nothing."""
    if found.status == NOT_REPORTED:
        return found.messages[0]
    reading = _reading(body, maplets, found)
    if isinstance(reading, str):
        return reading
    camera, et = mission.camera_named(picture.camera), et_from_utc(picture.utc)
    attitude, covariance = _attitude(camera, et, found)
    return BodySighting(
        image=picture.name,
        et=et,
        target=body_target(body, mission.spacecraft_id, et),
        camera=camera,
        camera_from_j2000=attitude,
        attitude_covariance_rad2=covariance,
        velocity_km_s=observer_from_kernels(mission.spacecraft_id, et).velocity_km_s,
        landmarks=reading,
    )


def _reading(body: str, maplets: Maplets, found: PictureResult) -> LandmarkReading | str:
    looked = [one for one in found.result.get("landmarks") or () if str(one["body"]).upper() == body.upper()]
    points = [p for one in looked for p in one["points"] if p["status"] == "accepted"]
    if not points:
        why = next(
            (m for one in looked for m in one["messages"]), found.messages[0] if found.messages else ""
        )
        return f"no landmark accepted{f' ({why})' if why else ''}"
    row = {name: i for i, name in enumerate(maplets.id.tolist())}
    unknown = [str(p["id"]) for p in points if p["id"] not in row]
    if unknown:
        raise SessionError(
            f"{found.name}: landmark {unknown[0]} is not one of the package's map; find them with that."
        )
    rows = [row[p["id"]] for p in points]
    return LandmarkReading(
        maplets.id[rows],
        maplets.place_km[rows],
        maplets.place_covariance_km2[rows],
        np.array([p["observed"] for p in points]),
        np.array([p["covariance_px2"] for p in points]),
        np.array(looked[0]["common_covariance_px2"]),
    )


def _attitude(camera: Camera, et: float, found: PictureResult) -> tuple[FloatArray, FloatArray]:
    pointing = found.result.get("pointing")
    if pointing and found.sure:
        return (
            matrix_from_quaternion(pointing["quaternion_camera_from_j2000"]),
            np.array(pointing["covariance_rad2"]),
        )
    return camera_attitude(camera.frame, et), camera.a_priori_covariance_rad2


def _source(found: PictureResult) -> str:
    pointing = found.result.get("pointing")
    if not (pointing and found.sure):
        return PREDICTED
    return FROM_STARS if pointing.get("n_stars") else CARRIED


# ---- From the batch to the solution.

KEPT = (*range(POSITION.columns.start, VELOCITY.columns.stop), *range(POLE.columns.start, SPIN.columns.stop),
        *range(MAP.columns.start, MAP.columns.stop))  # fmt: skip
SIGNS = np.array([-1.0] * 6 + [1.0] * 7)  # the batch moves the body, the rehearsal the spacecraft


def _solution(
    package: "OrtPackage",
    orbit: "OrbitContent",
    found: Sequence[PictureResult],
    seen: Sequence[BodySighting | str],
    solved: BodySolution,
    place_km: FloatArray,
    carried: FloatArray,
) -> OrbitSolution:
    covariance, before = (
        symmetric(SIGNS[:, None] * matrix[np.ix_(KEPT, KEPT)] * SIGNS)
        for matrix in (solved.covariance, solved.a_priori_covariance)
    )
    step = solved.a_priori_rotation.step_to(solved.rotation)
    correction = np.concatenate([-solved.state.state, step, solved.state.map_log])
    probability = solved.probability
    messages = solved.messages
    if probability < LEAST_PROBABILITY:
        words = (
            f"chi-squared {solved.chi2:.0f} for {solved.degrees_of_freedom} degrees of freedom: sigmas are too small, or "
            "something is wrong that is not estimated"
        )
        messages = (*messages, words)
    names = [p.name for p in package.pictures]
    sources = {name: _source(one) for name, one in zip(names, found, strict=True)}
    return OrbitSolution(
        package=package.name,
        epoch_utc=package.epoch_utc,
        body=orbit.body,
        correction=correction,
        sigma_before=np.sqrt(np.diag(before)),
        covariance=covariance,
        predict_utc=orbit.predict_utc,
        place_before_km=place_km,
        place_km=place_km + carried @ correction[:6],
        place_covariance_before_km2=symmetric(carried @ before[:6, :6] @ carried.T),
        place_covariance_km2=symmetric(carried @ covariance[:6, :6] @ carried.T),
        chi2=solved.chi2,
        degrees_of_freedom=solved.degrees_of_freedom,
        probability=probability,
        attitudes=_attitudes(seen, solved, sources),
        words=solved.words,
        messages=messages,
        left_out=tuple(f"{n}: {why}" for n, why in zip(names, seen, strict=True) if isinstance(why, str)),
        pictures={p.name: p.sha256 for p in found if p.sha256},
    )


def _attitudes(
    seen: Sequence[BodySighting | str], solved: BodySolution, sources: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    by_name = {s.image: s for s in seen if isinstance(s, BodySighting)}
    out = {}
    for name, turned, covariance in zip(
        solved.images, solved.state.attitudes, solved.attitude_covariances, strict=True
    ):
        sighting = by_name[name]
        reading = sighting.landmarks
        out[name] = {
            "quaternion_camera_from_j2000": quaternion_from_matrix(
                rotation_from_vector(turned) @ sighting.camera_from_j2000
            ),
            "covariance_rad2": symmetric(np.asarray(covariance)),
            "source": sources[name],
            "n_landmarks": 0 if reading is None else len(reading),
        }
    return out
