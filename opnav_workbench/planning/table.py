"""A plan as a table and as files: ECSV for programs that read tables, JSON with every star and reason.

The columns of the table (names, units, descriptions, and what stands in them) are `COLUMNS`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.files import atomic_path, plain_values, write_json
from opnav_workbench.planning.approach import Approach
from opnav_workbench.planning.bodies import TargetPlan
from opnav_workbench.planning.picture import PicturePlan, PicturePrediction
from opnav_workbench.planning.plan import Plan
from opnav_workbench.planning.stars import StarPlan

__all__ = ["Column", "catalog_words", "plan_document", "plan_table", "rows_of", "write_plan"]


# ---- Columns of a plan's table: names, units, descriptions, and what stands in them.

NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Row:
    """One picture and one of its targets; None where there is none."""

    plan: PicturePlan
    target: TargetPlan | None

    @property
    def prediction(self) -> PicturePrediction | None:
        """What the picture is expected to be."""
        return self.plan.prediction


@dataclass(frozen=True, slots=True)
class Column:
    """A column; `unit` None for text."""

    name: str
    unit: Any
    description: str
    value: Callable[[Row], Any]


def rows_of(pictures: tuple[PicturePlan, ...]) -> tuple[Row, ...]:
    """Return a row for each picture and target, and one for a picture without."""
    return tuple(
        Row(plan, target)
        for plan in pictures
        for target in ((plan.prediction.targets if plan.prediction else ()) or (None,))
    )


def _of_prediction(value: Callable[[PicturePrediction], Any], missing: Any = NAN) -> Callable[[Row], Any]:
    return lambda row: missing if row.prediction is None else value(row.prediction)


def _of_target(value: Callable[[TargetPlan], Any], missing: Any = NAN) -> Callable[[Row], Any]:
    return lambda row: missing if row.target is None else value(row.target)


def _of_pointing(value: Callable[[Any], Any]) -> Callable[[Row], Any]:
    return _of_prediction(lambda p: NAN if p.pointing is None else value(p.pointing))


def _usable_magnitude(prediction: PicturePrediction, pick: Callable[[Any], Any]) -> float:
    usable = prediction.stars.mag[prediction.stars.usable]
    return float(pick(usable)) if len(usable) else NAN


UNITLESS = u.dimensionless_unscaled
COLUMNS: tuple[Column, ...] = (
    Column("picture", None, "name", lambda r: r.plan.name),
    Column("utc", None, "mid-exposure, UTC", lambda r: r.plan.utc),
    Column("camera", None, "name", _of_prediction(lambda p: p.camera.name, "")),
    Column("exposure", u.s, "exposure", lambda r: r.plan.picture.exposure_s),
    Column("pointing", None, "as planned", lambda r: r.plan.pointing_words),
    Column("verdict", None, "good, marginal or bad", lambda r: r.plan.verdict.grade),
    Column("reason", None, "why not good", lambda r: r.plan.verdict.words),
    Column("ra", u.deg, "boresight, J2000", _of_prediction(lambda p: p.ra_deg)),
    Column("dec", u.deg, "boresight, J2000", _of_prediction(lambda p: p.dec_deg)),
    Column("twist", u.deg, "position angle of increasing line", _of_prediction(lambda p: p.twist_deg)),
    Column("elongation", u.deg, "boresight to Sun", _of_prediction(lambda p: p.elongation_deg)),
    Column(
        "stray_light",
        UNITLESS,
        "scattered sunlight as stated, DN",
        _of_prediction(lambda p: p.stray_light_dn),
    ),
    Column("stars", UNITLESS, "usable", _of_prediction(lambda p: int(p.stars.usable.sum()), 0)),
    Column(
        "catalog_stars",
        UNITLESS,
        "of the catalog, on the detector",
        _of_prediction(lambda p: len(p.stars), 0),
    ),
    Column("saturated_stars", UNITLESS, "saturated", _of_prediction(lambda p: p.stars.count("saturated"), 0)),
    Column(
        "brightest", u.mag, "usable star, camera band", _of_prediction(lambda p: _usable_magnitude(p, np.min))
    ),
    Column(
        "faintest", u.mag, "usable star, camera band", _of_prediction(lambda p: _usable_magnitude(p, np.max))
    ),
    Column("limit", u.mag, "star of the limiting SNR", _of_prediction(lambda p: p.limit_mag)),
    Column("catalog_limit", u.mag, "depth of the catalog here", _of_prediction(lambda p: p.catalog_mag)),
    Column("pointing_sigma_pixel", u.pix, "expected, along pixel", _of_pointing(lambda a: a.sigma_px[0])),
    Column("pointing_sigma_line", u.pix, "expected, along line", _of_pointing(lambda a: a.sigma_px[1])),
    Column("pointing_sigma_ra", u.arcsec, "expected, RA cos Dec", _of_pointing(lambda a: a.sigma_arcsec[0])),
    Column("pointing_sigma_dec", u.arcsec, "expected, Dec", _of_pointing(lambda a: a.sigma_arcsec[1])),
    Column("twist_sigma", u.deg, "expected", _of_pointing(lambda a: a.twist_sigma_deg)),
    Column("target", None, "name", _of_target(lambda t: t.name, "")),
    Column("pixel", u.pix, "predicted center", _of_target(lambda t: t.prediction.pixel_line[0])),
    Column("line", u.pix, "predicted center", _of_target(lambda t: t.prediction.pixel_line[1])),
    Column("diameter", u.pix, "apparent", _of_target(lambda t: t.prediction.diameter_px)),
    Column(
        "phase", u.deg, "Sun - target - spacecraft", _of_target(lambda t: np.degrees(t.prediction.phase_rad))
    ),
    Column("range", u.km, "spacecraft to target", _of_target(lambda t: t.prediction.range_km)),
    Column("mag", u.mag, "V of the target", _of_target(lambda t: t.mag)),
    Column("snr", UNITLESS, "of the target", _of_target(lambda t: t.snr)),
    Column("peak", UNITLESS, "brightest pixel of the target, DN", _of_target(lambda t: t.peak_dn)),
    Column("saturated", UNITLESS, "share of the target's pixels", _of_target(lambda t: t.saturated)),
    Column(
        "method", None, "of the center, where the albedo is not known", _of_target(lambda t: t.method, "")
    ),
    Column("center_sigma_pixel", u.pix, "of the measured center", _of_target(lambda t: t.center_sigma_px[0])),
    Column("center_sigma_line", u.pix, "of the measured center", _of_target(lambda t: t.center_sigma_px[1])),
    Column("sigma_pixel", u.pix, "observed minus predicted", _of_target(lambda t: t.sigma_px[0])),
    Column("sigma_line", u.pix, "observed minus predicted", _of_target(lambda t: t.sigma_px[1])),
    Column("sigma_ra", u.arcsec, "target's direction, RA cos Dec", _of_target(lambda t: t.sigma_arcsec[0])),
    Column("sigma_dec", u.arcsec, "target's direction, Dec", _of_target(lambda t: t.sigma_arcsec[1])),
    Column("sigma_km", u.km, "larger axis at the target's distance", _of_target(lambda t: t.sigma_km)),
    Column(
        "others",
        None,
        "other bodies in the field",
        _of_prediction(lambda p: ", ".join(v.name for v in p.other_bodies), ""),
    ),
    Column(
        "best_exposure",
        u.s,
        "exposure of the smallest error",
        _of_prediction(lambda p: p.best_exposure.best_s if p.best_exposure else NAN),
    ),
    Column(
        "limited_by",
        None,
        "what ends longer exposures",
        _of_prediction(lambda p: p.best_exposure.limited_by if p.best_exposure else "", ""),
    ),
)


# ---- A plan as a table and as files: ECSV for programs that read tables, JSON with every star and reason.

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
    seen = [p.prediction for p in plan.pictures if p.prediction is not None]
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
        "pictures": [_picture_values(picture) for picture in plan.pictures],
        "searches": [_search_values(approach) for approach in plan.searches],
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


def _picture_values(plan: PicturePlan) -> dict[str, Any]:
    head = {
        "name": plan.name,
        "utc": plan.utc,
        "exposure_s": plan.picture.exposure_s,
        "pointing": plan.pointing_words,
        "verdict": plan.verdict.grade,
        "reasons": list(plan.verdict.reasons),
    }
    return head if plan.prediction is None else head | _prediction_values(plan.prediction)


def _prediction_values(p: PicturePrediction) -> dict[str, Any]:
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
    if p.best_exposure is not None:
        best = {"exposure_s": p.best_exposure.best_s, "limited_by": p.best_exposure.limited_by}
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
        "stars": _star_values(p.stars),
        "targets": [_target_values(target) for target in p.targets],
        "others": [
            {"name": v.name, "pixel_line": [v.pixel, v.line], "diameter_px": v.diameter_px, "mag": v.mag}
            for v in p.other_bodies
        ],
        "best_exposure": best,
    }


def _star_values(stars: StarPlan) -> list[dict[str, Any]]:
    sigma = np.sqrt(np.diagonal(stars.covariance_px2, axis1=1, axis2=2))
    catalog = np.sqrt(np.diagonal(stars.catalog_covariance_px2, axis1=1, axis2=2))
    columns = (stars.id, stars.mag, stars.pixel_line, stars.snr, sigma, catalog, stars.status)
    names = ("id", "mag", "pixel_line", "snr", "sigma_px", "catalog_sigma_px", "status")
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _target_values(t: TargetPlan) -> dict[str, Any]:
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


def _search_values(approach: Approach) -> dict[str, Any]:
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
