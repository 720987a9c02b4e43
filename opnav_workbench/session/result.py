"""The result of a session as plain values: the layout of ``result.json``.

Residuals are observed minus predicted; missing values are None.  An entry of ``bodies`` is one observable: what was
observed, how, how well, and what is to be known of it.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import BodyCenter, describe_body_flags
from opnav_workbench.bodies.results import LimbScans
from opnav_workbench.camera import Camera
from opnav_workbench.format_versions import stamped
from opnav_workbench.geometry import quaternion_from_matrix
from opnav_workbench.kernels import KernelSet
from opnav_workbench.observables import Observable, Origin
from opnav_workbench.observables.observing import is_outside
from opnav_workbench.scene import AssistedBody
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs, InputSource
from opnav_workbench.session.pointing import (
    current_observables,
    field_is_sure,
    is_without_sky,
    pointing_doubt,
)
from opnav_workbench.session.state import MEASURED_STATUSES, SessionState, has_center
from opnav_workbench.stars.pointing import PointingSolution
from opnav_workbench.version import __version__

if TYPE_CHECKING:
    from opnav_workbench.landmarks import LandmarkSolution, PoseSolution

__all__ = ["body_results", "kernel_entries", "origin_of", "result_dict"]


# ---- Bodies.


def body_results(observables: Sequence[Observable], centers: Sequence[BodyCenter]) -> list[dict[str, Any]]:
    """Return one mapping per observable; an observable belongs to the body's center at the same place."""
    return [_body_result(o, center) for o, center in zip(observables, centers, strict=True)]


def _body_result(o: Observable, center: BodyCenter) -> dict[str, Any]:
    return {
        "name": o.name,
        "method": o.method,
        "a_priori": o.a_priori_px,
        "predicted": o.predicted_px,
        "observed": o.observed_px,
        "residual_px": o.residual_px,
        "covariance_px2": o.covariance_px2,
        "noise_covariance_px2": center.noise_covariance_px2,
        "covariance_with_pointing_px2": o.total_covariance_px2,
        "joint_covariance_px2": _joint_covariances(o),
        "diameter_px": o.diameter_px,
        "measured_diameter_px": o.measured_diameter_px,
        "diameter_sigma_px": center.diameter_sigma_px,
        "range_km": o.range_km,
        "measured_range_km": o.measured_range_km,
        "range_sigma_km": o.range_sigma_km,
        "brightness_scale": center.brightness_scale,
        "partials_px_per_km": o.partials_px_per_km,
        "ra_deg": o.ra_deg,
        "dec_deg": o.dec_deg,
        "apparent_ra_deg": o.apparent_ra_deg,
        "apparent_dec_deg": o.apparent_dec_deg,
        "residual_arcsec": o.residual_arcsec,
        "snr": o.snr,
        "chi2_reduced": center.chi2_reduced,
        "second_reading": _second_reading(center),
        "scans_used": len(center.detail.used) if isinstance(center.detail, LimbScans) else None,
        "flags": describe_body_flags(center.flags) if center.flags else "",
        "status": o.status,
        "messages": o.messages,
    }


def _second_reading(center: BodyCenter) -> dict[str, Any] | None:
    """Return the same center read in another way, and how far it lies from it; None where there is none."""
    second = center.second
    if second is None:
        return None
    return {
        "method": second.method,
        "observed": second.pixel_line,
        "covariance_px2": second.covariance_px2,
        "difference_sigmas": second.difference_sigmas,
    }


def _joint_covariances(o: Observable) -> dict[str, Any] | None:
    """Return the covariances (2, 2) px^2 of a center with those found jointly with it, by name; None without."""
    return {name: np.asarray(cross) for name, cross in o.center_cross_px2.items()} or None


# ---- Landmarks.


def landmark_result(solution: "LandmarkSolution") -> dict[str, Any]:
    """Return the landmarks of one body as plain values, with the pose that they agree on."""
    centers = solution.centers
    covariance, residual, partials = solution.covariance_px2, centers.residual_px, centers.partials
    points = [
        {
            "id": str(centers.id[row]),
            "place_km": centers.place_km[row],
            "predicted": centers.predicted_px[row],
            "observed": centers.observed_px[row] if centers.measured[row] else None,
            "residual_px": residual[row] if centers.measured[row] else None,
            "covariance_px2": covariance[row] if centers.measured[row] else None,
            "correlation": centers.correlation[row],
            "emission_deg": centers.emission_deg[row],
            "incidence_deg": centers.incidence_deg[row],
            "sample_over_pixel": centers.ratio[row],
            "partials_px_per_km": partials.spacecraft_px_per_km[row],
            "attitude_partials_px_per_rad": partials.attitude_px_per_rad[row],
            "body_partials_px_per_rad": partials.body_px_per_rad[row],
            "place_partials_px_per_km": partials.place_px_per_km[row],
            "status": solution.status[row],
            "reason": solution.reason[row],
        }
        for row in range(len(centers))
    ]
    return {
        "body": centers.body,
        "maplets": centers.source,
        "common_covariance_px2": centers.common_covariance_px2,
        "laws": list(centers.laws),
        "law_share": centers.law_share,
        "position_sigma_km": centers.position_sigma_km,
        "start_km": centers.start_km,
        "not_searched": dict(centers.not_searched),
        "pose": _pose(solution.pose),
        "messages": list(solution.messages),
        "points": points,
    }


def _pose(pose: "PoseSolution | None") -> dict[str, Any] | None:
    if pose is None:
        return None
    return {
        "position_km": pose.position_km,
        "position_body_km": pose.position_body_km,
        "quaternion_camera_from_j2000": quaternion_from_matrix(pose.camera_from_j2000),
        "covariance": pose.covariance,
        "position_shift_km": pose.position_shift_km,
        "attitude_shift_rad": pose.attitude_shift_rad,
        "rms_px": pose.rms_px,
        "chi2_reduced": pose.chi2_reduced,
        "excess_sigma_px": pose.excess_sigma_px,
        "n_landmarks": pose.n_landmarks,
    }


# ---- The whole.


def result_dict(context: Context, source: InputSource, inputs: Inputs, state: SessionState) -> dict[str, Any]:
    """Return everything found as plain values; residual = observed minus predicted, missing values are None."""
    frame = context.picture
    observables = current_observables(context, inputs, state)
    found = {
        "image": frame.name,
        "sha256": frame.sha256,
        "utc": inputs.utc,
        "et": inputs.et,
        "exposure_s": frame.exposure_s,
        "mission": context.mission.name,
        "camera": context.camera.name,
        **({} if (readout := context.mission.readout_told(frame.header)) is None else {"readout": readout}),
        "status": overall_status(
            context.camera, state, observables, without_sky=is_without_sky(inputs, state)
        ),
        "messages": list(state.messages),
        "identification": _identification(state),
        "pointing": _pointing(state.pointing),
        "stars": _star_results(context, state),
        "bodies": body_results(observables, state.bodies),
        **({"landmarks": [landmark_result(one) for one in state.landmarks]} if state.landmarks else {}),
        "provenance": _provenance(context, source, inputs, state),
    }
    return stamped("result", found)


def overall_status(
    camera: Camera, state: SessionState, observables: Sequence[Observable], *, without_sky: bool = False
) -> str:
    """Return ``ok``, ``partial`` or ``failed``; the state's messages say what is missing.

    ``ok`` is a sure pointing, its twist solved, with every target that was looked for either found for sure by one method
    at least, or outside the field, where there is nothing to find. Landmarks that agree on a pose are a part of it, and so,
    without any attitude (`is_without_sky`), is what is measured in the picture.
    """
    if state.pointing is None:
        measured = without_sky and any(o.observed_px is not None for o in observables)
        return "partial" if measured or any(one.pose is not None for one in state.landmarks) else "failed"
    told = {o.name: [p for p in observables if p.name == o.name] for o in observables}
    found = not state.skipped_targets and all(_found_or_outside(camera, of_one) for of_one in told.values())
    complete = found and state.pointing.twist_solved and not pointing_doubt(state)
    return "ok" if complete else "partial"


def _found_or_outside(camera: Camera, of_one: Sequence[Observable]) -> bool:
    sure = any(o.status == "ok" for o in of_one)
    return sure or all(
        o.observed_px is None and is_outside(camera, o.predicted_px, o.diameter_px) for o in of_one
    )


def _identification(state: SessionState) -> dict[str, Any] | None:
    found = state.star_field
    if found is None:
        return None
    return {
        "search": found.search,
        "confidence": found.confidence,
        "sure": field_is_sure(state),
        "shift_px": found.shift_px,
        "twist_deg": np.degrees(found.twist_rad),
    }


def _pointing(p: PointingSolution | None) -> dict[str, Any] | None:
    if p is None:
        return None
    return {
        "ra_deg": np.degrees(p.ra_rad),
        "dec_deg": np.degrees(p.dec_rad),
        "twist_deg": np.degrees(p.twist_rad),
        "quaternion_camera_from_j2000": quaternion_from_matrix(p.camera_from_j2000),
        "covariance_rad2": p.covariance_rad2,
        "delta_pixel": p.delta_pixel,
        "delta_line": p.delta_line,
        "delta_twist_deg": np.degrees(p.delta_twist_rad),
        "iterations": [
            {
                "delta_pixel": i.delta_pixel,
                "delta_line": i.delta_line,
                "delta_twist_deg": np.degrees(i.delta_twist_rad),
            }
            for i in p.iterations
        ],
        "rms_px": p.rms_px,
        "n_stars": p.n_stars,
        "model": p.model,
        "excess_sigma_px": p.excess_sigma_px,
        "chi2_reduced": p.chi2_reduced,
        "twist_solved": p.twist_solved,
    }


def _star_results(context: Context, state: SessionState) -> list[dict[str, Any]]:
    stars, centers = state.a_priori, state.centers
    if stars is None:
        return []
    predicted = stars.pixel_line
    if state.pointing is not None:
        predicted = stars.places(context.camera, state.pointing.camera_from_j2000)
    turns = None if state.pointing is None else state.pointing.catalog_turns_rad
    rows, measured = [], has_center(state)
    for i in range(len(stars)):
        seen = measured[i] and state.status[i].status in MEASURED_STATUSES
        observed = centers.pixel_line[i] if centers is not None and seen else None
        rows.append(
            {
                "id": str(stars.id[i]),
                "mag": stars.mag[i],
                "a_priori": stars.pixel_line[i],
                "predicted": predicted[i],
                "observed": observed,
                "sigma_px": None if centers is None or not seen else _sigmas(centers.covariance_px2[i]),
                "residual_px": None if observed is None else observed - predicted[i],
                "snr": None if centers is None else centers.snr[i],
                "status": state.status[i].status,
                "reason": state.status[i].reason,
                "turn_by_catalog_rad": None if turns is None or not turns[i : i + 1].any() else turns[i],
                "method": None
                if centers is None
                else state.star_methods.get(str(stars.id[i]), centers.method),
            }
        )
    return rows


def _sigmas(covariance: FloatArray) -> FloatArray:
    return np.sqrt(np.diag(covariance))


def kernel_entries() -> list[dict[str, str]]:
    """Return name and SHA-256 of every kernel that is loaded."""
    active = KernelSet.active()
    return [] if active is None else [{"file": k.path.name, "sha256": k.sha256} for k in active.kernels()]


def origin_of(context: Context, source: InputSource) -> Origin:
    """Return what observables of a session say of their origin."""
    return Origin(
        mission=context.mission.name,
        camera=context.camera.name,
        version=__version__,
        catalog=source.catalog,
        kernels=tuple((entry["file"], entry["sha256"]) for entry in kernel_entries()),
        images=(context.picture.name,),
    )


def _described(name: str, body: AssistedBody) -> dict[str, Any]:
    return {
        "body": name,
        "center_px": body.center_px,
        "radius_px": body.radius_px,
        "range_km": body.range_km,
        "radii_km": body.radii_km,
        "phase_deg": np.degrees(body.phase_rad),
        "sun_deg": np.degrees(body.sun_angle_rad),
        "lighting_sigma_deg": np.degrees(body.lighting_sigma_rad),
        "north_deg": None if body.north_angle_rad is None else np.degrees(body.north_angle_rad),
        "sub_observer_deg": np.degrees(body.sub_observer_rad),
    }


def _provenance(context: Context, source: InputSource, inputs: Inputs, state: SessionState) -> dict[str, Any]:
    return {
        "version": __version__,
        "kernels": kernel_entries(),
        "catalog": source.catalog,
        **({"catalog_found": inputs.catalog_found} if inputs.catalog_found else {}),
        "attitude_source": inputs.attitude_source,
        "observer_source": inputs.observer.source,
        "image_notes": list(context.picture.messages),
        **({"contradictions": list(state.contradictions)} if state.contradictions else {}),
        "settings": context.settings.to_dict(),
        "decisions": [
            {"star": star, "verdict": verdict, "reason": reason}
            for star, (verdict, reason) in state.decisions.items()
        ],
        "placed_stars": [{"star": star, "observed": place} for star, place in state.placed.items()],
        **(
            {"described_bodies": [_described(*one) for one in state.assisted.items()]}
            if state.assisted
            else {}
        ),
        "circles": [
            {"body": name, "center_px": circle.center_px, "radius_px": circle.radius_px}
            for name, circle in state.circles.items()
        ],
        "limb_scans": [
            {"body": name, "numbers": choice.numbers, "reason": choice.reason}
            for name, choice in state.scan_choices.items()
        ],
        **(
            {
                "landmark_decisions": [
                    {"landmark": name, "verdict": verdict, "reason": reason}
                    for name, (verdict, reason) in state.landmark_decisions.items()
                ]
            }
            if state.landmark_decisions
            else {}
        ),
        "notes": list(state.user_notes),
    }
