"""The truth of a rehearsal in the parameters that the team estimates, as plain values to seal."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.pointing import attitude_shift
from opnav_workbench.rehearsal.ort_perturb import OrtCase, OrtGeometry
from opnav_workbench.rehearsal.ort_scenario import OrtScenario
from opnav_workbench.rehearsal.ort_truth_pictures import truth_values
from opnav_workbench.rehearsal.ort_truth_words import words_of
from opnav_workbench.simulation import Truth
from opnav_workbench.spice import state

__all__ = ["sealed_values"]

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
    truths : mapping of str to Truth
        By picture.
    cameras : mapping of str to Camera
        By picture, as calibrated.
    spacecraft : int
    """
    errors = {name: _attitude_error(truth, cameras[name]) for name, truth in truths.items()}
    values = {
        "parameters": {name: case.offsets.get(name, np.zeros(3)) for name in scenario.parameters},
        "predicted_state_km": geometry.relative_state,
        "relative_state_km": geometry.relative_state + case.relative(),
        "b_plane": _flyby(case, geometry),
        "states_km": {
            name: _state(truth.et, scenario, case, geometry, spacecraft) for name, truth in truths.items()
        },
        "lost": dict.fromkeys(case.missing, MISSING) | dict.fromkeys(case.truncated, TRUNCATED),
        "attitude_errors": errors,
        "camera_errors": _camera_errors(case),
    }
    return {
        **values,
        "words": words_of(scenario, case, geometry, values, truths),
        "seed": case.seed,
        "scenario": scenario.model_dump(mode="json"),
        "pictures": {name: truth_values(truth) for name, truth in truths.items()},
    }


def _flyby(case: OrtCase, geometry: OrtGeometry) -> dict[str, dict[str, float]]:
    nominal = geometry.flyby()
    predicted = nominal.in_axes_of(nominal)
    true = geometry.flyby(case.relative()).in_axes_of(nominal)
    return {
        name: {"predicted": float(p), "true": float(t), "shift": float(t - p)}
        for name, p, t in zip(FLYBY, predicted, true, strict=True)
    }


def _state(
    et: float, scenario: OrtScenario, case: OrtCase, geometry: OrtGeometry, spacecraft: int
) -> FloatArray:
    seen, later_s = state(spacecraft, et, scenario.b_plane), et - geometry.epoch_et
    predicted = np.concatenate([seen.position_km, seen.velocity_km_s])
    return np.asarray(predicted + case.offset("spacecraft", later_s) - case.offset("target", later_s))


def _attitude_error(truth: Truth, camera: Camera) -> list[float]:
    shift = attitude_shift(camera, truth.predicted_camera_from_j2000, truth.camera_from_j2000)
    return [shift.delta_pixel, shift.delta_line, float(np.degrees(shift.delta_twist_rad))]


def _camera_errors(case: OrtCase) -> dict[str, float]:
    errors = {"focal length, relative": case.focal_length, "distortion at the corners, px": case.corner_px}
    return {words: value for words, value in errors.items() if value != 0.0}
