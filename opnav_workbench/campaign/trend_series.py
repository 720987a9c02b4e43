"""Trends over a campaign: O-C of each body, pointing error, star residuals and detections, with outliers flagged."""

from dataclasses import dataclass

import numpy as np
from astropy.table import Table

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.campaign.archive import Campaign
from opnav_workbench.campaign.detection_curve import Completeness, completeness
from opnav_workbench.campaign.outliers import Screened, screen
from opnav_workbench.session import MEASURED_STATUSES
from opnav_workbench.session.state import TRUSTED_STATUSES

__all__ = ["Series", "Trends", "detections", "trends"]

ON_DETECTOR = (*MEASURED_STATUSES, "not_detected")  # of a star that was on the detector
BODY_FILTERS = ("body", "method", "status")  # filters that choose among bodies
# What trends are made of: to read all that is known of 10,000 pictures takes three times as long.
POINTING_COLUMNS = ("image", "et", "delta_pixel", "delta_line", "delta_twist_deg", "twist_solved", "rms_px")
BODY_COLUMNS = (
    *("image", "et", "body", "method", "status", "residual_pixel", "residual_line"),
    *("covariance_oc_pixel_pixel", "covariance_oc_line_line"),
)
STAR_COLUMNS = ("status", "mag")


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Values over time; arrays (n,) are read-only, oldest first.

    Attributes
    ----------
    et
        TDB seconds past J2000.
    value, sigma
        `sigma` is nan where it is not known.
    screened
        Level and outliers.
    """

    name: str
    unit: str
    image: tuple[str, ...]
    et: FloatArray
    value: FloatArray
    sigma: FloatArray
    screened: Screened

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.value)

    @property
    def outlier(self) -> BoolArray:
        """Which points are off, (n,)."""
        return self.screened.outlier


@dataclass(frozen=True, slots=True, eq=False)
class Trends:
    """All trends of a campaign.

    Attributes
    ----------
    bodies : mapping of "BODY, method" to (pixel, line) Series
    pointing
        Pixel, line, twist.
    residual
        Root mean square star residual of each picture.
    """

    bodies: dict[str, tuple[Series, Series]]
    pointing: tuple[Series, Series, Series]
    residual: Series
    detections: Completeness

    def outliers(self) -> tuple[tuple[str, str, float], ...]:
        """Return (picture, series, deviation in robust sigmas) of all flagged points."""
        all_series = [*(s for pair in self.bodies.values() for s in pair), *self.pointing, self.residual]
        return tuple(
            (series.image[i], series.name, float(series.screened.deviation[i]))
            for series in all_series
            for i in np.flatnonzero(series.outlier)
        )


def trends(campaign: Campaign, **filters: str | None) -> Trends:
    """Return the trends of a campaign's pictures.

    Parameters
    ----------
    filters
        As of `Campaign.bodies`; those that tell bodies apart do not choose among pictures.
    """
    of_pictures = {name: value for name, value in filters.items() if name not in BODY_FILTERS}
    pointings = campaign.query("pointings", POINTING_COLUMNS, **of_pictures)
    return Trends(
        bodies=body_series(campaign.query("bodies", BODY_COLUMNS, **filters)),
        pointing=pointing_series(pointings),
        residual=residual_series(pointings),
        detections=detections(campaign.query("stars", STAR_COLUMNS, **of_pictures)),
    )


def body_series(bodies: Table) -> dict[str, tuple[Series, Series]]:
    """Return O-C (pixel, line) of each body and method, with the sigmas of O-C; `bodies` as of `Campaign.bodies`."""
    series = {}
    measured = bodies[np.isin(bodies["status"], TRUSTED_STATUSES) & np.isfinite(bodies["residual_pixel"])]
    for body, method in sorted(set(zip(measured["body"], measured["method"], strict=True))):
        rows = measured[(measured["body"] == body) & (measured["method"] == method)]
        name = f"{body}, {method}"
        pair = [
            _series(
                rows,
                f"{name}: O-C {axis}",
                "px",
                rows[f"residual_{axis}"],
                np.sqrt(np.asarray(rows[f"covariance_oc_{axis}_{axis}"])),
            )
            for axis in ("pixel", "line")
        ]
        series[name] = (pair[0], pair[1])
    return series


def pointing_series(pointings: Table) -> tuple[Series, Series, Series]:
    """Return observed minus a priori pointing: pixel, line (px) and twist (deg)."""
    solved = np.ma.filled(pointings["twist_solved"], fill_value=False).astype(bool)
    return (
        _series(pointings, "pointing error, pixel", "px", pointings["delta_pixel"]),
        _series(pointings, "pointing error, line", "px", pointings["delta_line"]),
        _series(pointings[solved], "pointing error, twist", "deg", pointings["delta_twist_deg"][solved]),
    )


def residual_series(pointings: Table) -> Series:
    """Return the root mean square star residual of each picture, px."""
    return _series(pointings, "star residual", "px", pointings["rms_px"])


def detections(stars: Table) -> Completeness:
    """Return detections against magnitude of the stars that were on the detector; `stars` as of `Campaign.stars`."""
    placed = stars[np.isin(stars["status"], ON_DETECTOR)] if len(stars) else stars
    found = np.isin(placed["status"], MEASURED_STATUSES)
    return completeness(np.asarray(placed["mag"], dtype=np.float64), found)


def _series(rows: Table, name: str, unit: str, value: object, sigma: object = None) -> Series:
    order = np.argsort(np.asarray(rows["et"]), kind="stable")
    et, y = np.asarray(rows["et"], dtype=np.float64)[order], np.asarray(value, dtype=np.float64)[order]
    s = None if sigma is None else np.asarray(sigma, dtype=np.float64)[order]
    images = tuple(str(image) for image in np.asarray(rows["image"])[order])
    sigmas = np.full(len(y), np.nan) if s is None else s
    return Series(name, unit, images, et, y, sigmas, screen(et, y, s))
