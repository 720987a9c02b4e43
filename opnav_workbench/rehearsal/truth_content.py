"""The truth of a rehearsal in the parameters that the team estimates.

It is told as plain values to seal, and in words for the moment of the reveal.
"""

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.constants import DAY_S
from opnav_workbench.kernels import et_from_utc, state
from opnav_workbench.rehearsal.case import OrtCase, OrtGeometry
from opnav_workbench.rehearsal.comparison import boresight_shift
from opnav_workbench.rehearsal.scenario import OrtScenario
from opnav_workbench.rehearsal.sealed_truth import picture_truth_values
from opnav_workbench.simulation import Truth

__all__ = ["predicted_utc", "sealed_values"]


# ---- What was perturbed, in words, for the moment of the reveal.


def perturbation_words(
    scenario: OrtScenario,
    case: OrtCase,
    geometry: OrtGeometry,
    values: Mapping[str, Any],
    truths: Mapping[str, Truth],
) -> list[str]:
    """Return a line for each perturbation; `values` are the sealed ones so far."""
    lines = [*_state_words(case, geometry), *_body_words(case)]
    if values["b_plane"]:
        lines += _flyby_words(scenario, values["b_plane"])
    lines += [
        *_attitude_words(scenario, values["attitude_errors"]),
        *_light_words(case),
        *_picture_words(case, truths),
    ]
    return lines or ["Nothing was perturbed but attitude and stars, by their usual errors."]


def _state_words(case: OrtCase, geometry: OrtGeometry) -> Iterator[str]:
    for name, offset in case.offsets.items():
        mover, _, quantity = name.partition("_")
        who = f"the target barycenter ({case.target})" if mover == "target" else "the spacecraft"
        unit, scale = ("km", 1.0) if quantity == "position" else ("m/s", 1e3)
        size, sunward = scale * float(np.linalg.norm(offset)), scale * float(offset @ geometry.sunward)
        vector = ", ".join(f"{scale * x:+.4g}" for x in offset)
        toward = f"; {sunward:+.4g} {unit} of it toward the Sun" if mover == "target" else ""
        yield f"{quantity.capitalize()} of {who}: {size:.4g} {unit} off the predicted ({vector} J2000{toward})."


def _body_words(case: OrtCase) -> Iterator[str]:
    if case.body_step.any():
        tilt, phase = np.degrees(np.hypot(*case.body_step[:2])), np.degrees(case.body_step[2])
        yield (
            f"Orientation of {case.target}: pole {tilt:.3f} deg off, prime meridian {phase:+.3f} deg, spin "
            f"{np.degrees(case.body_step[3]) * DAY_S:+.3g} deg/day."
        )
    if case.map_log.any():
        sizes = ", ".join(f"{np.expm1(x):+.2%}" for x in case.map_log)
        yield f"Map of {case.target}: too large by {sizes} along its axes, smoothed, its landmarks' places scattered."


def _flyby_words(scenario: OrtScenario, flyby: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    t, r, time = (flyby[name]["shift"] for name in ("b_dot_t_km", "b_dot_r_km", "time_of_flight_s"))
    if any(abs(value) > 1e-6 for value in (t, r, time)):
        yield (
            f"Flyby of {scenario.b_plane}: B.T {t:+.1f} km, B.R {r:+.1f} km, time of flight {time:+.2f} s against the "
            "predicted."
        )


def _attitude_words(scenario: OrtScenario, errors: Mapping[str, Any]) -> Iterator[str]:
    if scenario.perturbations.attitude is not None:
        sizes = [float(np.hypot(pixel, line)) for pixel, line, _ in errors.values()]
        twists = [abs(twist) for *_, twist in errors.values()]
        yield f"Attitude: off by {min(sizes):.0f} to {max(sizes):.0f} px, and by up to {max(twists):.2f} deg in twist."


def _light_words(case: OrtCase) -> Iterator[str]:
    if case.albedo_seeds:
        yield f"Albedo: {', '.join(case.albedo_seeds)} mottled, not uniform."
    if case.focal_length:
        yield f"Camera: focal length {case.focal_length:+.3%} off the calibration."
    if case.corner_px:
        yield f"Camera: distortion of {case.corner_px:+.2f} px at the corners that the calibration does not have."


def _picture_words(case: OrtCase, truths: Mapping[str, Truth]) -> Iterator[str]:
    if case.missing:
        yield f"Lost images: {', '.join(case.missing)}."
    if case.truncated:
        yield f"Images received in part: {', '.join(case.truncated)}."
    if case.gaps:
        yield f"Data gaps in {', '.join(case.gaps)}."
    if case.storm:
        hits = ", ".join(f"{name} ({len(truths[name].cosmic_rays)} hits)" for name in case.storm)
        yield f"Cosmic-ray storm in {hits}."


# ---- The truth of a rehearsal in the parameters that the team estimates, as plain values to seal.

FLYBY = ("b_dot_t_km", "b_dot_r_km", "time_of_flight_s")
MISSING = "not received"
TRUNCATED = "received in part: the file ends early"


def sealed_values(
    scenario: OrtScenario,
    case: OrtCase,
    geometry: OrtGeometry,
    truths: Mapping[str, Truth],
    cameras: Mapping[str, Camera],
    spacecraft: int,
) -> dict[str, Any]:
    """Return the fields of `OrtTruth` as plain values; inside the active predicted kernels.

    Parameters
    ----------
    scenario, case, geometry
    truths
        By picture.
    cameras
        By picture, as calibrated.
    """
    errors = {
        name: boresight_shift(truth.predicted_camera_from_j2000, truth.camera_from_j2000, cameras[name])
        for name, truth in truths.items()
    }
    values = {
        "parameters": {name: case.offsets.get(name, np.zeros(3)) for name in scenario.parameters},
        "predicted_state_km": geometry.relative_state,
        "relative_state_km": geometry.relative_state + case.relative_state_error(),
        "b_plane": {} if scenario.orbit is not None else _flyby_values(case, geometry),
        "states_km": {
            name: _true_state(truth.et, scenario, case, geometry, spacecraft)
            for name, truth in truths.items()
        },
        "lost": dict.fromkeys(case.missing, MISSING) | dict.fromkeys(case.truncated, TRUNCATED),
        "attitude_errors": errors,
        "camera_errors": _camera_errors(case),
    }
    if scenario.orbit is not None:
        values["orbit"] = _orbit_values(scenario, case, geometry, spacecraft)
    return {
        **values,
        "words": perturbation_words(scenario, case, geometry, values, truths),
        "seed": case.seed,
        "scenario": scenario.model_dump(mode="json"),
        "pictures": {name: picture_truth_values(truth) for name, truth in truths.items()},
    }


def _flyby_values(case: OrtCase, geometry: OrtGeometry) -> dict[str, dict[str, float]]:
    nominal = geometry.flyby()
    predicted = nominal.in_axes_of(nominal)
    true = geometry.flyby(case.relative_state_error()).in_axes_of(nominal)
    return {
        name: {"predicted": float(p), "true": float(t), "shift": float(t - p)}
        for name, p, t in zip(FLYBY, predicted, true, strict=True)
    }


def predicted_utc(scenario: OrtScenario) -> str:
    """Return when the spacecraft's place in orbit is asked for."""
    assert scenario.orbit is not None
    last = datetime.fromisoformat(scenario.sequence()[-1].time)
    return (last + timedelta(hours=scenario.orbit.predict_hours)).isoformat(timespec="seconds")


def _orbit_values(
    scenario: OrtScenario, case: OrtCase, geometry: OrtGeometry, spacecraft: int
) -> dict[str, Any]:
    """Return what is true of the body and of the orbit; the landmarks' true places come from the map."""
    et = et_from_utc(predicted_utc(scenario))
    return {
        "body_step": case.body_step,
        "map_log": -case.map_log,  # what makes the team's map right
        "predicted_place_km": _true_state(et, scenario, case, geometry, spacecraft)[:3],
    }


def _true_state(
    et: float, scenario: OrtScenario, case: OrtCase, geometry: OrtGeometry, spacecraft: int
) -> FloatArray:
    seen, later_s = state(spacecraft, et, scenario.center), et - geometry.epoch_et
    predicted = np.concatenate([seen.position_km, seen.velocity_km_s])
    return np.asarray(predicted + case.offset("spacecraft", later_s) - case.offset("target", later_s))


def _camera_errors(case: OrtCase) -> dict[str, float]:
    errors = {"focal length, relative": case.focal_length, "distortion at the corners, px": case.corner_px}
    return {words: value for words, value in errors.items() if value != 0.0}
