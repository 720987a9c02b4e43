"""The columns of observables: names, units and descriptions that every file format shares, and rows of plain values.

`FIELDS` says how each field of an `Observable` becomes columns. A covariance is written as sigmas and covariances, a
matrix element by element. An unknown number is nan, and an array that is not there is nan throughout.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_value
from opnav_workbench.observables.explanation import ASTROMETRIC
from opnav_workbench.observables.observable import Observable

__all__ = ["ALWAYS_ARRAYS", "COLUMNS", "FIELDS", "ExportColumn", "row_of", "rows_to_observables"]


# ---- The columns of observables: names, units and descriptions that every file format shares.

AXES = ("pixel", "line")
XYZ = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """One column.

    Attributes
    ----------
    unit
        As astropy writes it ("pix s / km"), empty for a pure number; None for text.
    index
        Element of the field's array; empty for a number.
    sigma
        The square root of the element is written.
    """

    name: str
    unit: str | None
    description: str
    index: tuple[int, ...] = ()
    sigma: bool = False


@dataclass(frozen=True, slots=True)
class ExportField:
    """A field of `Observable` and its columns."""

    name: str
    unit: str | None
    description: str
    columns: tuple[ExportColumn, ...]
    shape: tuple[int, ...] = ()


def _text_field(name: str, description: str, column: str = "") -> ExportField:
    return ExportField(name, None, description, (ExportColumn(column or name, None, description),))


def _number_field(name: str, unit: str, description: str, column: str = "") -> ExportField:
    return ExportField(name, unit, description, (ExportColumn(column or name, unit, description),))


def _vector_field(name: str, unit: str, description: str, *columns: tuple[str, str]) -> ExportField:
    made = (ExportColumn(column, unit, words, (i,)) for i, (column, words) in enumerate(columns))
    return ExportField(name, unit, description, tuple(made), (len(columns),))


def _xyz_field(name: str, unit: str, description: str, pattern: str) -> ExportField:
    return _vector_field(
        name, unit, description, *((pattern.format(a), f"{description}: {a} component, J2000") for a in XYZ)
    )


def _partials_field(name: str, unit: str, pattern: str, of: str) -> ExportField:
    """d(pixel, line) by something with components x, y, z."""
    made = (
        ExportColumn(f"d{axis}_d{pattern.format(a)}", unit, f"d({axis})/d({of.format(a)})", (row, i))
        for row, axis in enumerate(AXES)
        for i, a in enumerate(XYZ)
    )
    what = of.format("x, y, z")
    return ExportField(name, unit, f"d(pixel, line)/d({what})", tuple(made), (2, 3))


def _squared(unit: str) -> str:
    return f"{unit}2"


def _covariance_field(name: str, unit: str, description: str, names: tuple[str, str, str]) -> ExportField:
    """Return a (2, 2) covariance as two sigmas and the covariance."""
    first, second, mixed = names
    made = (
        ExportColumn(first, unit, f"1 sigma, {description}: first", (0, 0), sigma=True),
        ExportColumn(second, unit, f"1 sigma, {description}: second", (1, 1), sigma=True),
        ExportColumn(mixed, _squared(unit), f"covariance, {description}", (0, 1)),
    )
    return ExportField(name, _squared(unit), f"covariance, {description}", made, (2, 2))


def _attitude_field() -> ExportField:
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    words = "covariance of the solved attitude about the camera frame's axes"
    made = (
        ExportColumn(
            f"attitude_covariance_{XYZ[i]}{XYZ[j]}", _squared("rad"), f"{words} {XYZ[i]} and {XYZ[j]}", (i, j)
        )
        for i, j in pairs
    )
    return ExportField("attitude_covariance_rad2", _squared("rad"), words, tuple(made), (3, 3))


def _sky_field() -> ExportField:
    made = (
        ExportColumn(f"d{axis}_d{sky}", "pix / rad", f"d({axis})/d({words}) at the observed place", (row, i))
        for row, axis in enumerate(AXES)
        for i, (sky, words) in enumerate((("ra_cosdec", "RA cos(Dec)"), ("dec", "Dec")))
    )
    words = "d(pixel, line)/d(RA cos(Dec), Dec) at the observed place, aberration removed"
    return ExportField("sky_partials_px_per_rad", "pix / rad", words, tuple(made), (2, 2))


FIELDS: tuple[ExportField, ...] = (
    _text_field("image", "picture file"),
    _text_field("utc", "mid-exposure, UTC"),
    _number_field("et", "s", "mid-exposure, TDB seconds past J2000"),
    _text_field("name", "target", "body"),
    _text_field("method", "centerfinder"),
    _text_field("status", "ok, uncertain, not_detected, off_detector, saturated or failed"),
    _text_field("observer", "spacecraft"),
    _text_field("reference_body", "body that the spacecraft position refers to"),
    _vector_field(
        "observed_px",
        "pix",
        "observed center of figure (pixel, line), 0-based, integer = pixel center",
        ("pixel_o", "observed pixel (0-based, integer = pixel center)"),
        ("line_o", "observed line"),
    ),
    _vector_field(
        "predicted_px",
        "pix",
        "computed place, solved pointing",
        ("pixel_c", "computed pixel, solved pointing"),
        ("line_c", "computed line, solved pointing"),
    ),
    _vector_field(
        "a_priori_px",
        "pix",
        "computed place, a priori pointing",
        ("pixel_a_priori", "computed pixel, a priori pointing"),
        ("line_a_priori", "computed line, a priori pointing"),
    ),
    _vector_field(
        "residual_px",
        "pix",
        "observed minus computed place",
        ("pixel_oc", "observed minus computed pixel"),
        ("line_oc", "observed minus computed line"),
    ),
    _covariance_field(
        "covariance_px2",
        "pix",
        "observed pixel and line",
        ("sigma_pixel", "sigma_line", "covariance_pixel_line"),
    ),
    _covariance_field(
        "total_covariance_px2",
        "pix",
        "observed minus computed pixel and line, pointing included",
        ("sigma_pixel_oc", "sigma_line_oc", "covariance_oc"),
    ),
    _text_field("light_time", "fixed or solved: what the partials do with the light time"),
    _partials_field(
        "partials_px_per_km", "pix / km", "{}", "{} of the spacecraft relative to the reference body, J2000"
    ),
    _partials_field(
        "partials_px_per_rad",
        "pix / rad",
        "rotation_{}",
        "small rotation of the attitude about the camera frame's {} axis",
    ),
    _partials_field(
        "target_partials_px_per_km", "pix / km", "target_{}", "{} of the target at mid-exposure, J2000"
    ),
    _partials_field(
        "target_partials_px_per_km_s",
        "pix s / km",
        "target_v{}",
        "velocity {} of the target at mid-exposure, J2000",
    ),
    _sky_field(),
    _attitude_field(),
    _number_field("ra_deg", "deg", f"observed right ascension, J2000, {ASTROMETRIC}", "ra"),
    _number_field("dec_deg", "deg", f"observed declination, J2000, {ASTROMETRIC}", "dec"),
    _number_field(
        "apparent_ra_deg", "deg", "observed right ascension, J2000, apparent: as seen", "apparent_ra"
    ),
    _number_field(
        "apparent_dec_deg", "deg", "observed declination, J2000, apparent: as seen", "apparent_dec"
    ),
    _vector_field(
        "residual_arcsec",
        "arcsec",
        "observed minus computed (RA cos(Dec), Dec)",
        ("ra_cosdec_oc", "observed minus computed RA times cos(Dec)"),
        ("dec_oc", "observed minus computed declination"),
    ),
    _covariance_field(
        "residual_covariance_arcsec2",
        "arcsec",
        "observed minus computed RA cos(Dec) and Dec, pointing included",
        ("sigma_ra_cosdec_oc", "sigma_dec_oc", "covariance_ra_cosdec_dec_oc"),
    ),
    _number_field("diameter_px", "pix", "predicted diameter", "diameter"),
    _number_field("measured_diameter_px", "pix", "measured diameter", "measured_diameter"),
    _number_field("diameter_sigma_px", "pix", "1 sigma of the measured diameter", "sigma_diameter"),
    _xyz_field(
        "diameter_partials_px_per_km", "pix / km", "d(diameter)/d(spacecraft position)", "ddiameter_d{}"
    ),
    _number_field("range_km", "km", "predicted distance from spacecraft to body", "range"),
    _number_field(
        "measured_range_km",
        "km",
        "distance from the body's size, its radius taken as known",
        "measured_range",
    ),
    _number_field("range_sigma_km", "km", "1 sigma of the measured distance", "sigma_range"),
    _xyz_field("range_partials", "", "d(range)/d(spacecraft position), km/km", "drange_d{}"),
    _xyz_field("position_km", "km", f"computed, spacecraft to body, {ASTROMETRIC}", "position_{}"),
    _xyz_field(
        "observer_velocity_km_s",
        "km / s",
        "spacecraft relative to the solar-system barycenter",
        "observer_v{}",
    ),
    _xyz_field(
        "target_velocity_km_s",
        "km / s",
        "body relative to the solar-system barycenter when the light left",
        "target_velocity_{}",
    ),
    _number_field("snr", "", "flux over its sigma"),
    _text_field(
        "center_cross_px2", "JSON: covariance (px^2) of this center with those of bodies found jointly"
    ),
    _text_field("messages", "what the analyst must know; separated by semicolons"),
)
COLUMNS: tuple[ExportColumn, ...] = tuple(column for field in FIELDS for column in field.columns)

assert {field.name for field in FIELDS} == {field.name for field in fields(Observable)}


# ---- An observable as one row of plain values, and back.

# Without these there is no observable; any other column may be missing from a file.
NEEDED_COLUMNS = ("image", "et", "body", "status", "pixel_c", "line_c")
# Arrays that are always there, with nan where nothing is known; the others are None then.
ALWAYS_ARRAYS = frozenset({"a_priori_px", "predicted_px", "covariance_px2", "total_covariance_px2"})


def row_of(observable: Observable) -> dict[str, Any]:
    """Return an observable as column name to text or float (nan where nothing is known)."""
    row: dict[str, Any] = {}
    for field in FIELDS:
        value = _plain_text(field, getattr(observable, field.name))
        for column in field.columns:
            row[column.name] = value if column.unit is None else _column_number(column, value)
    return row


def _plain_text(field: ExportField, value: Any) -> Any:
    if field.name == "messages":
        return "; ".join(message.replace("; ", ", ") for message in value)
    if field.name == "center_cross_px2":
        return json.dumps({name: cross.tolist() for name, cross in value.items()}) if value else ""
    return value


def _column_number(column: ExportColumn, value: Any) -> float:
    number = np.nan if value is None else float(np.asarray(value, float)[column.index])
    return float(np.sqrt(number)) if column.sigma else number


def rows_to_observables(rows: Iterable[Mapping[str, Any]], source: str) -> tuple[Observable, ...]:
    """Return the observables of rows as `row_of` makes them.

    Parameters
    ----------
    source
        The file, for messages.

    Raises
    ------
    SessionError
        A column that an observable needs is missing, or a value is not of its kind.
    """
    made = []
    for number, row in enumerate(rows):
        missing = [name for name in NEEDED_COLUMNS if name not in row]
        if missing:
            raise SessionError(
                f"{source} holds no observables: it has no column {', '.join(missing)}. Give a file that "
                "opnav process or opnav export wrote."
            )
        try:
            made.append(Observable(**{field.name: _field_value(field, row) for field in FIELDS}))
        except (ValueError, TypeError, IndexError, AttributeError) as error:
            raise SessionError(f"{source}, row {number}: {error}. Export the observables again.") from error
    return tuple(made)


def _field_value(field: ExportField, row: Mapping[str, Any]) -> Any:
    if field.unit is None:
        return _text_value(field, str(row.get(field.columns[0].name, "") or ""))
    numbers = [_number_in(row, column) for column in field.columns]
    if not field.shape:
        return numbers[0]
    if all(np.isnan(numbers)) and field.name not in ALWAYS_ARRAYS:
        return None
    array = np.full(field.shape, np.nan)
    for column, number in zip(field.columns, numbers, strict=True):
        array[column.index] = number**2 if column.sigma else number
        if len(field.columns) < array.size:  # a covariance: what is below the diagonal is not written
            array[column.index[::-1]] = array[column.index]
    return array


def _number_in(row: Mapping[str, Any], column: ExportColumn) -> float:
    value = row.get(column.name, np.nan)
    if value is None or value == "":
        return np.nan
    try:
        return float(value)
    except ValueError as error:
        raise ValueError(f"{column.name}: {value!r} is no number") from error


def _text_value(field: ExportField, text: str) -> Any:
    if field.name == "messages":
        return tuple(text.split("; ")) if text else ()
    if field.name == "center_cross_px2":
        return {name: np.array(cross) for name, cross in json_value(text).items()} if text else {}
    return text
