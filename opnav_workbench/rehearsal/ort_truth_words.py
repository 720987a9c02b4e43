"""What was perturbed, in words, for the moment of the reveal."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from opnav_workbench.rehearsal.ort_perturb import OrtCase, OrtGeometry
from opnav_workbench.rehearsal.ort_scenario import OrtScenario
from opnav_workbench.simulation import Truth

__all__ = ["words_of"]


def words_of(
    scenario: OrtScenario,
    case: OrtCase,
    geometry: OrtGeometry,
    values: Mapping[str, Any],
    truths: Mapping[str, Truth],
) -> list[str]:
    """Return a line for each perturbation; `values` are the sealed ones so far."""
    lines = [*_states(case, geometry), *_flyby(scenario, values["b_plane"])]
    lines += [*_attitude(scenario, values["attitude_errors"]), *_light(case), *_pictures(case, truths)]
    return lines or ["Nothing was perturbed but the attitude, by its usual errors."]


def _states(case: OrtCase, geometry: OrtGeometry) -> Iterator[str]:
    for name, offset in case.offsets.items():
        mover, _, quantity = name.partition("_")
        who = f"the target barycenter ({case.target})" if mover == "target" else "the spacecraft"
        unit, scale = ("km", 1.0) if quantity == "position" else ("m/s", 1e3)
        size, sunward = scale * float(np.linalg.norm(offset)), scale * float(offset @ geometry.sunward)
        vector = ", ".join(f"{scale * x:+.4g}" for x in offset)
        toward = f"; {sunward:+.4g} {unit} of it toward the Sun" if mover == "target" else ""
        yield f"{quantity.capitalize()} of {who}: {size:.4g} {unit} off the predicted ({vector} J2000{toward})."


def _flyby(scenario: OrtScenario, flyby: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    t, r, time = (flyby[name]["shift"] for name in ("b_dot_t_km", "b_dot_r_km", "time_of_flight_s"))
    if any(abs(value) > 1e-6 for value in (t, r, time)):
        yield (
            f"Flyby of {scenario.b_plane}: B.T {t:+.1f} km, B.R {r:+.1f} km, time of flight {time:+.2f} s against the "
            "predicted."
        )


def _attitude(scenario: OrtScenario, errors: Mapping[str, Any]) -> Iterator[str]:
    if scenario.perturbations.attitude is not None:
        sizes = [float(np.hypot(pixel, line)) for pixel, line, _ in errors.values()]
        twists = [abs(twist) for *_, twist in errors.values()]
        yield f"Attitude: off by {min(sizes):.0f} to {max(sizes):.0f} px, and by up to {max(twists):.2f} deg in twist."


def _light(case: OrtCase) -> Iterator[str]:
    if case.albedo_seeds:
        yield f"Albedo: {', '.join(case.albedo_seeds)} mottled, not uniform."
    if case.focal_length:
        yield f"Camera: focal length {case.focal_length:+.3%} off the calibration."
    if case.corner_px:
        yield f"Camera: distortion of {case.corner_px:+.2f} px at the corners that the calibration does not have."


def _pictures(case: OrtCase, truths: Mapping[str, Truth]) -> Iterator[str]:
    if case.missing:
        yield f"Lost images: {', '.join(case.missing)}."
    if case.truncated:
        yield f"Images received in part: {', '.join(case.truncated)}."
    if case.gaps:
        yield f"Data gaps in {', '.join(case.gaps)}."
    if case.storm:
        hits = ", ".join(f"{name} ({len(truths[name].cosmic_rays)} hits)" for name in case.storm)
        yield f"Cosmic-ray storm in {hits}."
