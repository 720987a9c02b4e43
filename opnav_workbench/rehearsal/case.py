"""The case of one rehearsal: every perturbation as the seed draws it, in the parameters that the team estimates.

Each kind has random numbers of its own, by its name, so that one perturbation more or less changes no other. Straight
lines (in orbit, two-body motion) carry an offset from the epoch to the pictures, as they carry the estimate back: the truth
is what the solution's own model can say. What the Sun's tide would make of an offset is a share GM t^2 / 2 r^3 of it: at
Pluto some millionths in a month, at Bennu half a percent in a week.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.constants import SUN_ID
from opnav_workbench.errors import MissionError
from opnav_workbench.estimation import BPlane, b_plane, b_plane_partials, kepler, straight_line
from opnav_workbench.estimation.body import BodyRotation
from opnav_workbench.geometry import unit
from opnav_workbench.kernels import body_attitude, body_gm_km3_s2, et_from_utc, state
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.scenario import (
    BodyError,
    Distribution,
    OrtEntry,
    OrtPerturbations,
    OrtScenario,
)
from opnav_workbench.simulation.randomness import seed_of_name

__all__ = ["OrtCase", "OrtGeometry", "draw_case", "geometry_at_epoch", "perturbation_random"]

TARGETING_PASSES = 8  # Newton's steps to a B-plane point; each squares the error
TARGETED = 1e-6  # km and s


@dataclass(frozen=True, slots=True, eq=False)
class OrtGeometry:
    """What the predicted kernels say at the epoch; arrays are read-only.

    Attributes
    ----------
    relative_state : (6,) array
        Spacecraft relative to the body of the B-plane, km and km/s, J2000, geometric.
    gm_km3_s2
        Of that body; 0 where the kernels do not say.
    sunward : (3,) array
        From the perturbed barycenter (else the body of the B-plane) to the Sun, unit vector.
    """

    epoch_et: float
    relative_state: FloatArray
    gm_km3_s2: float
    sunward: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def flyby(self, correction: FloatArray | None = None) -> BPlane:
        """Return the B-plane of the predicted flyby, or of one with a correction (6,)."""
        moved = self.relative_state + (np.zeros(6) if correction is None else correction)
        return b_plane(moved[:3], moved[3:], self.gm_km3_s2)


@dataclass(frozen=True, slots=True)
class OrtCase:
    """What is true of one rehearsal and not predicted.

    Attributes
    ----------
    offsets : mapping of str to (3,) array
        By the estimator's parameters, true minus predicted at the epoch: km, km/s, J2000.
    target
        Body or barycenter that the target's offsets move.
    shifts_px : mapping of str to (pixel, line, twist_deg)
        Attitude errors by picture; empty: each has a random one of the camera's a priori size.
    albedo_seeds
        Bodies with a mottled surface.
    focal_length, corner_px
        Camera faults: relative, px.
    missing, truncated, gaps, storm
        Pictures that do not arrive, arrive in part, have data gaps, have a storm.
    body_step : (4,) array
        From the believed rotation of the body in orbit to the true one: pole east and north, phase (rad), rate (rad/s), as
        `opnav_workbench.estimation.body.BodyRotation.turned` takes it.
    map_log : (3,) array
        Logarithms of the size of the team's map over the true surface, along the body's axes.
    terrain_seed
        Of a made surface, and of what is wrong with the map.
    orbit : ((6,) array, float), optional
        Predicted state relative to the body at the epoch and its GM, about which offsets grow.
    """

    seed: int
    offsets: Mapping[str, FloatArray]
    target: str
    shifts_px: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    albedo_seeds: Mapping[str, int] = field(default_factory=dict)
    focal_length: float = 0.0
    corner_px: float = 0.0
    missing: tuple[str, ...] = ()
    truncated: tuple[str, ...] = ()
    gaps: tuple[str, ...] = ()
    storm: tuple[str, ...] = ()
    storm_rate_per_cm2_s: float = 0.0
    body_step: FloatArray = field(default_factory=lambda: np.zeros(4))
    map_log: FloatArray = field(default_factory=lambda: np.zeros(3))
    terrain_seed: int = 0
    orbit: tuple[FloatArray, float] | None = None

    def offset(self, mover: str, later_s: float) -> FloatArray:
        """Return the offset (6,), km and km/s, of ``target`` or ``spacecraft`` so long after the epoch."""
        none = np.zeros(3)
        parts = [self.offsets.get(f"{mover}_{quantity}", none) for quantity in ("position", "velocity")]
        transition = straight_line if self.orbit is None else kepler(*self.orbit)
        return np.asarray(transition(0.0, later_s) @ np.concatenate(parts))

    def relative_state_error(self) -> FloatArray:
        """Return how the spacecraft's state relative to the target is off at the epoch (6,)."""
        return self.offset("spacecraft", 0.0) - self.offset("target", 0.0)


def perturbation_random(seed: int, name: str) -> np.random.Generator:
    """Return the random numbers of one kind of perturbation.

    Examples
    --------
    >>> first, second = (perturbation_random(7, "albedo").random() for _ in range(2))
    >>> first == second
    True
    """
    return np.random.default_rng([seed, seed_of_name(name)])


def geometry_at_epoch(scenario: OrtScenario, mission: Mission) -> OrtGeometry:
    """Return the predicted geometry, from the active kernels.

    Raises
    ------
    KernelError
        They do not cover spacecraft or target at the epoch, or do not know the body.
    EstimationError
        There is no flyby of the body.
    """
    epoch = et_from_utc(scenario.epoch_utc)
    found = state(mission.spacecraft_id, epoch, scenario.center)
    moved = scenario.perturbations.target_barycenter
    sun = state(SUN_ID, epoch, scenario.center if moved is None else moved.body)
    geometry = OrtGeometry(
        epoch_et=epoch,
        relative_state=np.concatenate([found.position_km, found.velocity_km_s]),
        gm_km3_s2=body_gm_km3_s2(scenario.center),
        sunward=unit(sun.position_km),
    )
    if scenario.orbit is None:
        geometry.flyby()
    return geometry


def draw_case(scenario: OrtScenario, geometry: OrtGeometry, seed: int) -> OrtCase:
    """Draw a rehearsal's case.

    Parameters
    ----------
    seed
        Not negative; the same one gives the same case.

    Raises
    ------
    MissionError
        A negative seed, or a B-plane target that the trajectory cannot be moved to.
    """
    if seed < 0:
        raise MissionError(f"seed {seed} is negative; give 0 or a positive whole number.")
    p = scenario.perturbations
    names = [picture.name for picture in scenario.sequence()]
    missing, truncated = _draw_losses(p, names, seed)
    arrived = [name for name in names if name not in (*missing, *truncated)]
    camera = p.camera
    rng = perturbation_random(seed, "camera")
    storm = p.cosmic_ray_storm
    return OrtCase(
        seed=seed,
        offsets=_draw_offsets(p, geometry, seed),
        target=scenario.center if p.target_barycenter is None else p.target_barycenter.body,
        shifts_px=_draw_attitudes(p, scenario.sequence(), seed),
        albedo_seeds=_draw_albedo_seeds(p, seed),
        focal_length=0.0 if camera is None else draw_amount(camera.focal_length, rng),
        corner_px=0.0 if camera is None else draw_amount(camera.corner_px, rng),
        missing=missing,
        truncated=truncated,
        gaps=() if p.data_gaps is None else _draw_pictures(arrived, p.data_gaps.pictures, seed, "data_gaps"),
        storm=() if storm is None else _draw_pictures(arrived, storm.pictures, seed, "cosmic_ray_storm"),
        storm_rate_per_cm2_s=0.0
        if storm is None
        else draw_amount(storm.rate_per_cm2_s, perturbation_random(seed, "storm")),
        **({} if scenario.orbit is None else _draw_body(p, scenario.orbit.body, geometry, seed)),
    )


def _draw_body(p: OrtPerturbations, body: str, geometry: OrtGeometry, seed: int) -> dict[str, Any]:
    """Return what is wrong with the believed body in orbit about it, and what its offsets grow about."""
    wrong, rng = p.body or BodyError(), perturbation_random(seed, "body")
    rate = BodyRotation.from_attitudes(lambda et: body_attitude(body, et), geometry.epoch_et).rate_rad_s
    degrees = [draw_amount(amount, rng) for amount in (*wrong.pole_deg, wrong.meridian_deg)]
    return {
        "body_step": np.array([*np.radians(degrees), draw_amount(wrong.spin, rng) * rate]),
        "map_log": np.log1p(_draw_vector(wrong.map_scale, rng)),
        "terrain_seed": int(perturbation_random(seed, "terrain").integers(2**31)),
        "orbit": (geometry.relative_state, geometry.gm_km3_s2),
    }


def draw_amount(amount: Distribution, rng: np.random.Generator) -> float:
    """Draw a number."""
    if amount.normal is not None:
        value = float(rng.normal(amount.mean, amount.normal))
    else:
        low, high = amount.uniform or (0.0, 0.0)
        value = float(rng.uniform(low, high))
    turned = bool(rng.random() < 0.5)
    return -value if amount.either_sign and turned else value


# -- states --------------------------------------------------------------------------------------------------------


def _draw_offsets(p: OrtPerturbations, geometry: OrtGeometry, seed: int) -> dict[str, FloatArray]:
    offsets: dict[str, FloatArray] = {}
    if p.target_barycenter is not None:
        shift, rng = p.target_barycenter, perturbation_random(seed, "target_barycenter")
        toward_sun = draw_amount(shift.toward_sun_km, rng) * geometry.sunward
        offsets["target_position"] = (
            toward_sun
            + _draw_any_direction(shift.any_direction_km, rng)
            + _draw_vector(shift.position_km, rng)
        )
        offsets["target_velocity"] = _draw_vector(shift.velocity_km_s, rng)
    craft = np.zeros(6)
    if p.spacecraft_ephemeris is not None:
        error, rng = p.spacecraft_ephemeris, perturbation_random(seed, "spacecraft_ephemeris")
        craft[:3] = _draw_any_direction(error.any_direction_km, rng) + _draw_vector(error.position_km, rng)
        craft[3:] = _draw_vector(error.velocity_km_s, rng)
    craft[:3] += _b_plane_displacement(p, geometry, seed)
    offsets |= {"spacecraft_position": craft[:3], "spacecraft_velocity": craft[3:]}
    return {name: offset for name, offset in offsets.items() if offset.any()}


def _draw_vector(amounts: Sequence[Distribution], rng: np.random.Generator) -> FloatArray:
    return np.array([draw_amount(amount, rng) for amount in amounts])


def _draw_any_direction(length: Distribution, rng: np.random.Generator) -> FloatArray:
    direction = unit(rng.standard_normal(3))
    return np.asarray(draw_amount(length, rng) * direction)


def _b_plane_displacement(p: OrtPerturbations, geometry: OrtGeometry, seed: int) -> FloatArray:
    """Return the displacement (3,), km, of a trajectory whose flyby has the drawn B-plane point and time of flight.

    The velocity stays, and with it the asymptote's direction but for the target's pull.
    """
    shift = np.zeros(3)
    if p.b_plane_target is not None:
        rng = perturbation_random(seed, "b_plane_target")
        shift[:2] = (
            draw_amount(p.b_plane_target.b_dot_t_km, rng),
            draw_amount(p.b_plane_target.b_dot_r_km, rng),
        )
    shift[2] = draw_amount(p.time_of_flight_s, perturbation_random(seed, "time_of_flight"))
    moved = np.zeros(3)
    if not shift.any():
        return moved
    nominal = geometry.flyby()
    wanted = nominal.in_axes_of(nominal) + shift
    for _ in range(TARGETING_PASSES):
        correction = np.concatenate([moved, np.zeros(3)])
        miss = wanted - geometry.flyby(correction).in_axes_of(nominal)
        if np.abs(miss).max() < TARGETED:
            return moved
        at = geometry.relative_state + correction
        partials = b_plane_partials(at[:3], at[3:], geometry.gm_km3_s2)[:, :3]
        moved = moved + np.linalg.solve(partials, miss)
    raise MissionError(
        f"perturbations: no trajectory has B.T {wanted[0]:.0f} km, B.R {wanted[1]:.0f} km at {wanted[2]:.0f} s after the "
        "epoch; make b_plane_target and time_of_flight_s smaller."
    )


# -- pictures ------------------------------------------------------------------------------------------------------


def _draw_attitudes(
    p: OrtPerturbations, pictures: Sequence[OrtEntry], seed: int
) -> dict[str, tuple[float, float, float]]:
    if p.attitude is None:
        return {}
    found, first, last = {}, "", -np.inf
    for picture in pictures:  # in the order of their times
        now = datetime.fromisoformat(picture.time).timestamp()
        first = picture.name if not first or now - last > p.attitude.held_s else first
        last = now
        rng = perturbation_random(seed, f"attitude/{first}" if p.attitude.every_picture else "attitude")
        angle = rng.uniform(0.0, 2.0 * np.pi)
        length = draw_amount(p.attitude.shift_px, rng)
        twist = draw_amount(p.attitude.twist_deg, rng)
        found[picture.name] = (float(length * np.cos(angle)), float(length * np.sin(angle)), twist)
    return found


def _draw_albedo_seeds(p: OrtPerturbations, seed: int) -> dict[str, int]:
    bodies = () if p.albedo is None else p.albedo.bodies
    return {name: int(perturbation_random(seed, f"albedo/{name.upper()}").integers(2**31)) for name in bodies}


def _draw_losses(
    p: OrtPerturbations, names: Sequence[str], seed: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    if p.lost_images is None:
        return (), ()
    lost = p.lost_images
    open_to_loss = [name for name in names if name not in lost.spare]
    gone = list(perturbation_random(seed, "lost_images").permutation(open_to_loss))
    missing, truncated = gone[: lost.missing], gone[lost.missing : lost.missing + lost.truncated]
    return tuple(sorted(map(str, missing))), tuple(sorted(map(str, truncated)))


def _draw_pictures(names: Sequence[str], count: int, seed: int, kind: str) -> tuple[str, ...]:
    chosen = perturbation_random(seed, kind).permutation(list(names))[:count]
    return tuple(sorted(map(str, chosen)))
