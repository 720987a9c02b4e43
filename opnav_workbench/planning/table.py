"""A plan as a table and as files: ECSV for programs that read tables, JSON with every star and reason."""

from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.files import atomic_path, plain_values, write_json
from opnav_workbench.planning.approach import Approach
from opnav_workbench.planning.bodies import TargetPlan
from opnav_workbench.planning.columns import COLUMNS, rows_of
from opnav_workbench.planning.picture import PicturePlan, Prospect
from opnav_workbench.planning.plan import Plan
from opnav_workbench.planning.stars import StarPlan

__all__ = ["catalog_words", "plan_document", "plan_table", "write_plan"]

NO_TEXT = "-"  # ECSV cannot tell an empty text from a masked value


def plan_table(plan: Plan) -> QTable:
    """Return a plan as a table: a row for each picture and target, every column with unit and description.

    Unknown numbers are nan; an empty text is "-".
    """
    rows, table = rows_of(plan.pictures), QTable()
    for column in COLUMNS:
        values = [column.value(row) for row in rows]
        if column.unit is None:
            table[column.name] = np.array([text or NO_TEXT for text in values], dtype=str)
        else:
            table[column.name] = u.Quantity(np.array(values, dtype=float), column.unit)
        table[column.name].info.description = column.description
    table.meta |= {
        "description": plan.sequence.description,
        "catalog": catalog_words(plan),
        "version": plan.version,
    }
    return table


def catalog_words(plan: Plan) -> str:
    """Say which catalog the stars are from, and how deep it goes compared with the pictures."""
    name = plan.catalog.get("name", plan.sequence.catalog)
    seen = [p.prospect for p in plan.pictures if p.prospect is not None]
    depth = [p.catalog_mag for p in seen if np.isfinite(p.catalog_mag)]
    if not depth:
        return f"{name} ({plan.catalog.get('n_stars', 'unknown number of')} stars)"
    words = f"{name}, to about magnitude {min(depth):.1f} here"
    deeper = max(p.limit_mag for p in seen) - min(depth)
    if deeper > 0.5:
        words += (
            f"; the pictures reach {max(p.limit_mag for p in seen):.1f}: they will show more stars than are counted, "
            "and a deeper catalog (--catalog) makes better plans"
        )
    return words


def plan_document(plan: Plan) -> dict[str, Any]:
    """Return everything about a plan as plain values for JSON; what is unknown is None."""
    document = {
        "description": plan.sequence.description,
        "mission": plan.sequence.mission,
        "kernels": plan.sequence.kernels,
        "catalog": {**dict(plan.catalog), "words": catalog_words(plan)},
        "sun": plan.sequence.sun.model_dump(mode="json"),
        "limits": plan.sequence.limits.model_dump(mode="json"),
        "counts": {grade: plan.count(grade) for grade in ("good", "marginal", "bad")},
        "pictures": [_picture(picture) for picture in plan.pictures],
        "searches": [_search(approach) for approach in plan.searches],
        "provenance": {"opnav_workbench": plan.version},
    }
    values = plain_values(document)
    assert isinstance(values, dict)
    return values


def write_plan(plan: Plan, out: Path) -> tuple[Path, Path]:
    """Write ``plan.ecsv`` and ``plan.json``; return their paths.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    table, document = out / "plan.ecsv", out / "plan.json"
    with atomic_path(table) as temporary:
        plan_table(plan).write(temporary, format="ascii.ecsv", overwrite=True)
    write_json(document, plan_document(plan))
    return table, document


def _picture(plan: PicturePlan) -> dict[str, Any]:
    head = {
        "name": plan.name,
        "utc": plan.utc,
        "exposure_s": plan.picture.exposure_s,
        "pointing": plan.pointing_words,
        "verdict": plan.verdict.grade,
        "reasons": list(plan.verdict.reasons),
    }
    return head if plan.prospect is None else head | _prospect(plan.prospect)


def _prospect(p: Prospect) -> dict[str, Any]:
    attitude = None
    if p.pointing is not None:
        attitude = {
            "sigma_px": p.pointing.sigma_px,
            "sigma_arcsec": p.pointing.sigma_arcsec,
            "twist_sigma_deg": p.pointing.twist_sigma_deg,
            "twist_solved": p.pointing.twist_solved,
            "covariance_rad2": p.pointing.covariance_rad2,
            "n_stars": p.pointing.n_stars,
        }
    best = None
    if p.best is not None:
        best = {"exposure_s": p.best.best_s, "limited_by": p.best.limited_by}
    return {
        "camera": p.camera.name,
        "et": p.et,
        "camera_from_j2000": p.camera_from_j2000,
        "ra_deg": p.ra_deg,
        "dec_deg": p.dec_deg,
        "twist_deg": p.twist_deg,
        "elongation_deg": p.elongation_deg,
        "stray_light_dn": p.stray_light_dn,
        "limit_mag": p.limit_mag,
        "catalog_mag": p.catalog_mag,
        "attitude": attitude,
        "stars": _stars(p.stars),
        "targets": [_target(target) for target in p.targets],
        "others": [
            {"name": v.name, "pixel_line": [v.pixel, v.line], "diameter_px": v.diameter_px, "mag": v.mag}
            for v in p.visitors
        ],
        "best_exposure": best,
    }


def _stars(stars: StarPlan) -> list[dict[str, Any]]:
    sigma = np.sqrt(np.diagonal(stars.covariance_px2, axis1=1, axis2=2))
    catalog = np.sqrt(np.diagonal(stars.catalog_covariance_px2, axis1=1, axis2=2))
    columns = (stars.id, stars.mag, stars.pixel_line, stars.snr, sigma, catalog, stars.status)
    names = ("id", "mag", "pixel_line", "snr", "sigma_px", "catalog_sigma_px", "status")
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _target(t: TargetPlan) -> dict[str, Any]:
    return {
        "name": t.name,
        "pixel_line": t.prediction.pixel_line,
        "on_detector": t.prediction.on_detector,
        "diameter_px": t.prediction.diameter_px,
        "phase_deg": float(np.degrees(t.prediction.phase_rad)),
        "range_km": t.prediction.range_km,
        "mag": t.mag,
        "flux_dn": t.flux_dn,
        "peak_dn": t.peak_dn,
        "snr": t.snr,
        "saturated": t.saturated,
        "occulted": t.occulted,
        "method": t.method,
        "center_sigma_px": t.center_sigma_px,
        "sigma_px": t.sigma_px,
        "sigma_arcsec": t.sigma_arcsec,
        "sigma_km": t.sigma_km,
        "km_per_px": t.km_per_px,
    }


def _search(approach: Approach) -> dict[str, Any]:
    names = ("stack", "utc", "mag", "range_km", "phase_deg", "elongation_deg", "limiting_mag", "words")
    return {
        "name": approach.search.name,
        "target": approach.search.target,
        "camera": approach.search.camera,
        "exposure_s": approach.search.exposure_s,
        "snr": approach.search.snr,
        "problem": approach.problem,
        "detections": [{name: getattr(d, name) for name in names} for d in approach.detections],
        "curve": {
            "et": approach.et,
            "mag": approach.mag,
            "snr": approach.snr,
            "diameter_px": approach.diameter_px,
            "elongation_deg": approach.elongation_deg,
        },
    }
