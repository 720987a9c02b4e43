"""Columns of a plan's table: names, units, descriptions, and what stands in them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy import units as u

from opnav_workbench.planning.bodies import TargetPlan
from opnav_workbench.planning.picture import PicturePlan, Prospect

__all__ = ["COLUMNS", "Column", "Row", "rows_of"]

NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Row:
    """One picture and one of its targets; None where there is none."""

    plan: PicturePlan
    target: TargetPlan | None

    @property
    def prospect(self) -> Prospect | None:
        """What the picture is expected to be."""
        return self.plan.prospect


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
        for target in ((plan.prospect.targets if plan.prospect else ()) or (None,))
    )


def _picture(value: Callable[[Prospect], Any], missing: Any = NAN) -> Callable[[Row], Any]:
    return lambda row: missing if row.prospect is None else value(row.prospect)


def _target(value: Callable[[TargetPlan], Any], missing: Any = NAN) -> Callable[[Row], Any]:
    return lambda row: missing if row.target is None else value(row.target)


def _pointing(value: Callable[[Any], Any]) -> Callable[[Row], Any]:
    return _picture(lambda p: NAN if p.pointing is None else value(p.pointing))


def _mags(prospect: Prospect, pick: Callable[[Any], Any]) -> float:
    usable = prospect.stars.mag[prospect.stars.usable]
    return float(pick(usable)) if len(usable) else NAN


NONE = u.dimensionless_unscaled
COLUMNS: tuple[Column, ...] = (
    Column("picture", None, "name", lambda r: r.plan.name),
    Column("utc", None, "mid-exposure, UTC", lambda r: r.plan.utc),
    Column("camera", None, "name", _picture(lambda p: p.camera.name, "")),
    Column("exposure", u.s, "exposure", lambda r: r.plan.picture.exposure_s),
    Column("pointing", None, "as planned", lambda r: r.plan.pointing_words),
    Column("verdict", None, "good, marginal or bad", lambda r: r.plan.verdict.grade),
    Column("reason", None, "why not good", lambda r: r.plan.verdict.words),
    Column("ra", u.deg, "boresight, J2000", _picture(lambda p: p.ra_deg)),
    Column("dec", u.deg, "boresight, J2000", _picture(lambda p: p.dec_deg)),
    Column("twist", u.deg, "position angle of increasing line", _picture(lambda p: p.twist_deg)),
    Column("elongation", u.deg, "boresight to Sun", _picture(lambda p: p.elongation_deg)),
    Column("stray_light", NONE, "scattered sunlight as stated, DN", _picture(lambda p: p.stray_light_dn)),
    Column("stars", NONE, "usable", _picture(lambda p: int(p.stars.usable.sum()), 0)),
    Column("catalog_stars", NONE, "of the catalog, on the detector", _picture(lambda p: len(p.stars), 0)),
    Column("saturated_stars", NONE, "saturated", _picture(lambda p: p.stars.count("saturated"), 0)),
    Column("brightest", u.mag, "usable star, camera band", _picture(lambda p: _mags(p, np.min))),
    Column("faintest", u.mag, "usable star, camera band", _picture(lambda p: _mags(p, np.max))),
    Column("limit", u.mag, "star of the limiting SNR", _picture(lambda p: p.limit_mag)),
    Column("catalog_limit", u.mag, "depth of the catalog here", _picture(lambda p: p.catalog_mag)),
    Column("pointing_sigma_pixel", u.pix, "expected, along pixel", _pointing(lambda a: a.sigma_px[0])),
    Column("pointing_sigma_line", u.pix, "expected, along line", _pointing(lambda a: a.sigma_px[1])),
    Column("pointing_sigma_ra", u.arcsec, "expected, RA cos Dec", _pointing(lambda a: a.sigma_arcsec[0])),
    Column("pointing_sigma_dec", u.arcsec, "expected, Dec", _pointing(lambda a: a.sigma_arcsec[1])),
    Column("twist_sigma", u.deg, "expected", _pointing(lambda a: a.twist_sigma_deg)),
    Column("target", None, "name", _target(lambda t: t.name, "")),
    Column("pixel", u.pix, "predicted center", _target(lambda t: t.prediction.pixel_line[0])),
    Column("line", u.pix, "predicted center", _target(lambda t: t.prediction.pixel_line[1])),
    Column("diameter", u.pix, "apparent", _target(lambda t: t.prediction.diameter_px)),
    Column(
        "phase", u.deg, "Sun - target - spacecraft", _target(lambda t: np.degrees(t.prediction.phase_rad))
    ),
    Column("range", u.km, "spacecraft to target", _target(lambda t: t.prediction.range_km)),
    Column("mag", u.mag, "V of the target", _target(lambda t: t.mag)),
    Column("snr", NONE, "of the target", _target(lambda t: t.snr)),
    Column("peak", NONE, "brightest pixel of the target, DN", _target(lambda t: t.peak_dn)),
    Column("saturated", NONE, "share of the target's pixels", _target(lambda t: t.saturated)),
    Column("method", None, "of the center, where the albedo is not known", _target(lambda t: t.method, "")),
    Column("center_sigma_pixel", u.pix, "of the measured center", _target(lambda t: t.center_sigma_px[0])),
    Column("center_sigma_line", u.pix, "of the measured center", _target(lambda t: t.center_sigma_px[1])),
    Column("sigma_pixel", u.pix, "observed minus predicted", _target(lambda t: t.sigma_px[0])),
    Column("sigma_line", u.pix, "observed minus predicted", _target(lambda t: t.sigma_px[1])),
    Column("sigma_ra", u.arcsec, "target's direction, RA cos Dec", _target(lambda t: t.sigma_arcsec[0])),
    Column("sigma_dec", u.arcsec, "target's direction, Dec", _target(lambda t: t.sigma_arcsec[1])),
    Column("sigma_km", u.km, "larger axis at the target's distance", _target(lambda t: t.sigma_km)),
    Column(
        "others",
        None,
        "other bodies in the field",
        _picture(lambda p: ", ".join(v.name for v in p.visitors), ""),
    ),
    Column(
        "best_exposure",
        u.s,
        "exposure of the smallest error",
        _picture(lambda p: p.best.best_s if p.best else NAN),
    ),
    Column(
        "limited_by",
        None,
        "what ends longer exposures",
        _picture(lambda p: p.best.limited_by if p.best else "", ""),
    ),
)
