"""Bodies in the layout of ``result.json``: what was observed, how, how well, and what is to be known of it."""

from typing import Any

import numpy as np

from opnav_workbench.bodycenters import BodyCenter, describe_body_flags
from opnav_workbench.bodycenters.limb_scan_results import LimbScans
from opnav_workbench.observables import Observable
from opnav_workbench.session.state import SessionState

__all__ = ["bodies_of"]


def bodies_of(state: SessionState) -> list[dict[str, Any]]:
    """Return one mapping per observable; an observable belongs to the body's center at the same place."""
    pairs = zip(state.observables, state.bodies, strict=True) if state.observables else ()
    return [_body(observable, center) for observable, center in pairs]


def _body(o: Observable, center: BodyCenter) -> dict[str, Any]:
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
        "joint_covariance_px2": _joint(o),
        "diameter_px": o.diameter_px,
        "measured_diameter_px": o.measured_diameter_px,
        "diameter_sigma_px": center.diameter_sigma_px,
        "range_km": o.range_km,
        "measured_range_km": center.range_km,
        "range_sigma_km": center.range_sigma_km,
        "brightness_scale": center.brightness_scale,
        "partials_px_per_km": o.partials_px_per_km,
        "ra_deg": o.ra_deg,
        "dec_deg": o.dec_deg,
        "apparent_ra_deg": o.apparent_ra_deg,
        "apparent_dec_deg": o.apparent_dec_deg,
        "residual_arcsec": o.residual_arcsec,
        "snr": o.snr,
        "chi2_reduced": center.chi2_reduced,
        "scans_used": len(center.detail.used) if isinstance(center.detail, LimbScans) else None,
        "flags": describe_body_flags(center.flags) if center.flags else "",
        "status": o.status,
        "messages": o.messages,
    }


def _joint(o: Observable) -> dict[str, Any] | None:
    """Return the covariances (2, 2) px^2 of a center with those found jointly with it, by name; None without."""
    return {name: np.asarray(cross) for name, cross in o.center_cross_px2.items()} or None
