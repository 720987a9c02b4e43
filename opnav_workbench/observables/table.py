"""Observables as an astropy table with units and descriptions, and as an ECSV file."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from opnav_workbench.arrays import FloatArray
from opnav_workbench.files import atomic_path
from opnav_workbench.observables.observable import Observable

__all__ = ["observables_table", "write_ecsv"]

NO_PAIR = np.full(2, np.nan)
NO_PARTIALS = np.full((2, 3), np.nan)


def _pair(values: FloatArray | None, index: int) -> float:
    return float((NO_PAIR if values is None else values)[index])


def _partial(values: FloatArray | None, row: int, column: int) -> float:
    return float((NO_PARTIALS if values is None else values)[row, column])


Column = tuple[str, Any, str, Callable[[Observable], Any]]

COLUMNS: tuple[Column, ...] = (
    ("image", None, "picture file", lambda o: o.image),
    ("utc", None, "mid-exposure, UTC", lambda o: o.utc),
    ("et", u.s, "mid-exposure, TDB seconds past J2000", lambda o: o.et),
    ("body", None, "target", lambda o: o.name),
    ("method", None, "centerfinder", lambda o: o.method),
    ("status", None, "ok, uncertain, not_detected, off_detector, saturated or failed", lambda o: o.status),
    ("reference_body", None, "body that the spacecraft position refers to", lambda o: o.reference_body),
    ("pixel_o", u.pix, "observed pixel (0-based, integer = pixel center)", lambda o: _pair(o.observed_px, 0)),
    ("line_o", u.pix, "observed line", lambda o: _pair(o.observed_px, 1)),
    ("pixel_c", u.pix, "computed pixel, solved pointing", lambda o: o.predicted_px[0]),
    ("line_c", u.pix, "computed line, solved pointing", lambda o: o.predicted_px[1]),
    ("pixel_a_priori", u.pix, "computed pixel, a priori pointing", lambda o: o.a_priori_px[0]),
    ("line_a_priori", u.pix, "computed line, a priori pointing", lambda o: o.a_priori_px[1]),
    ("pixel_oc", u.pix, "observed minus computed pixel", lambda o: _pair(o.residual_px, 0)),
    ("line_oc", u.pix, "observed minus computed line", lambda o: _pair(o.residual_px, 1)),
    ("sigma_pixel", u.pix, "1 sigma of the observed pixel", lambda o: np.sqrt(o.covariance_px2[0, 0])),
    ("sigma_line", u.pix, "1 sigma of the observed line", lambda o: np.sqrt(o.covariance_px2[1, 1])),
    (
        "covariance_pixel_line",
        u.pix**2,
        "covariance of observed pixel and line",
        lambda o: o.covariance_px2[0, 1],
    ),
    (
        "sigma_pixel_oc",
        u.pix,
        "1 sigma of observed minus computed pixel, pointing included",
        lambda o: np.sqrt(o.total_covariance_px2[0, 0]),
    ),
    (
        "sigma_line_oc",
        u.pix,
        "1 sigma of observed minus computed line, pointing included",
        lambda o: np.sqrt(o.total_covariance_px2[1, 1]),
    ),
    (
        "covariance_oc",
        u.pix**2,
        "covariance of observed minus computed pixel and line, pointing included",
        lambda o: o.total_covariance_px2[0, 1],
    ),
    *(
        (
            f"d{axis}_d{name}",
            u.pix / u.km,
            f"d({axis})/d({name} of the spacecraft relative to the reference body, J2000)",
            lambda o, r=row, c=column: _partial(o.partials_px_per_km, r, c),
        )
        for row, axis in enumerate(("pixel", "line"))
        for column, name in enumerate("xyz")
    ),
    *(
        (
            f"d{axis}_drotation_{name}",
            u.pix / u.rad,
            f"d({axis})/d(small rotation of the attitude about the camera frame's {name} axis)",
            lambda o, r=row, c=column: _partial(o.partials_px_per_rad, r, c),
        )
        for row, axis in enumerate(("pixel", "line"))
        for column, name in enumerate("xyz")
    ),
    ("ra", u.deg, "observed right ascension, J2000, stellar aberration removed", lambda o: o.ra_deg),
    ("dec", u.deg, "observed declination, J2000, stellar aberration removed", lambda o: o.dec_deg),
    ("apparent_ra", u.deg, "observed right ascension, J2000, as seen", lambda o: o.apparent_ra_deg),
    ("apparent_dec", u.deg, "observed declination, J2000, as seen", lambda o: o.apparent_dec_deg),
    (
        "ra_cosdec_oc",
        u.arcsec,
        "observed minus computed RA times cos(Dec)",
        lambda o: _pair(o.residual_arcsec, 0),
    ),
    ("dec_oc", u.arcsec, "observed minus computed declination", lambda o: _pair(o.residual_arcsec, 1)),
    ("diameter", u.pix, "predicted diameter", lambda o: o.diameter_px),
    ("measured_diameter", u.pix, "measured diameter", lambda o: o.measured_diameter_px),
    ("snr", u.one, "flux over its sigma", lambda o: o.snr),
    ("messages", None, "what the analyst must know", lambda o: "; ".join(o.messages)),
)


def observables_table(observables: Sequence[Observable]) -> QTable:
    """Return observables as a table: one row each, every column with description and, for numbers, unit.

    Unknown numbers are nan. An empty text is written as "-": ECSV cannot tell it from a masked value.

    Examples
    --------
    >>> observables_table([]).colnames[:4]
    ['image', 'utc', 'et', 'body']
    """
    table = QTable()
    for name, unit, description, value in COLUMNS:
        values = [value(o) for o in observables]
        if unit is None:
            table[name] = np.array([text or "-" for text in values], dtype=str)
        else:
            table[name] = u.Quantity(np.array(values, dtype=float), unit)
        table[name].info.description = description
    return table


def write_ecsv(observables: Sequence[Observable], path: str | Path) -> None:
    """Write `observables_table` as ECSV, whole or not at all."""
    with atomic_path(path) as temporary:
        observables_table(observables).write(temporary, format="ascii.ecsv", overwrite=True)
