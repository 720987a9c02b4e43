"""The columns of observables: names, units and descriptions that every file format shares.

`FIELDS` says how each field of an `Observable` becomes columns. A covariance is written as sigmas and covariances, a
matrix element by element.
"""

from dataclasses import dataclass, fields
from typing import Any

from astropy import units as u

from opnav_workbench.observables.observable import Observable

__all__ = ["COLUMNS", "FIELDS", "Column", "Field"]

AXES = ("pixel", "line")
XYZ = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Column:
    """One column.

    Attributes
    ----------
    name : str
    unit : astropy unit or None
        None for text.
    description : str
    index : tuple of int
        Element of the field's array; empty for a number.
    sigma : bool
        The square root of the element is written.
    """

    name: str
    unit: Any
    description: str
    index: tuple[int, ...] = ()
    sigma: bool = False


@dataclass(frozen=True, slots=True)
class Field:
    """A field of `Observable` and its columns."""

    name: str
    unit: Any
    description: str
    columns: tuple[Column, ...]
    shape: tuple[int, ...] = ()


def _text(name: str, description: str, column: str = "") -> Field:
    return Field(name, None, description, (Column(column or name, None, description),))


def _number(name: str, unit: Any, description: str, column: str = "") -> Field:
    return Field(name, unit, description, (Column(column or name, unit, description),))


def _vector(name: str, unit: Any, description: str, *columns: tuple[str, str]) -> Field:
    made = (Column(column, unit, words, (i,)) for i, (column, words) in enumerate(columns))
    return Field(name, unit, description, tuple(made), (len(columns),))


def _xyz(name: str, unit: Any, description: str, pattern: str) -> Field:
    return _vector(
        name, unit, description, *((pattern.format(a), f"{description}: {a} component, J2000") for a in XYZ)
    )


def _partials(name: str, by: Any, pattern: str, of: str) -> Field:
    """d(pixel, line) by something with components x, y, z."""
    made = (
        Column(f"d{axis}_d{pattern.format(a)}", u.pix / by, f"d({axis})/d({of.format(a)})", (row, i))
        for row, axis in enumerate(AXES)
        for i, a in enumerate(XYZ)
    )
    what = of.format("x, y, z")
    return Field(name, u.pix / by, f"d(pixel, line)/d({what})", tuple(made), (2, 3))


def _covariance(name: str, unit: Any, description: str, names: tuple[str, str, str]) -> Field:
    """Return a (2, 2) covariance as two sigmas and the covariance."""
    first, second, mixed = names
    made = (
        Column(first, unit, f"1 sigma, {description}: first", (0, 0), sigma=True),
        Column(second, unit, f"1 sigma, {description}: second", (1, 1), sigma=True),
        Column(mixed, unit**2, f"covariance, {description}", (0, 1)),
    )
    return Field(name, unit**2, f"covariance, {description}", made, (2, 2))


def _attitude() -> Field:
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    words = "covariance of the solved attitude about the camera frame's axes"
    made = (
        Column(f"attitude_covariance_{XYZ[i]}{XYZ[j]}", u.rad**2, f"{words} {XYZ[i]} and {XYZ[j]}", (i, j))
        for i, j in pairs
    )
    return Field("attitude_covariance_rad2", u.rad**2, words, tuple(made), (3, 3))


def _sky() -> Field:
    made = (
        Column(f"d{axis}_d{sky}", u.pix / u.rad, f"d({axis})/d({words}) at the observed place", (row, i))
        for row, axis in enumerate(AXES)
        for i, (sky, words) in enumerate((("ra_cosdec", "RA cos(Dec)"), ("dec", "Dec")))
    )
    words = "d(pixel, line)/d(RA cos(Dec), Dec) at the observed place, aberration removed"
    return Field("sky_partials_px_per_rad", u.pix / u.rad, words, tuple(made), (2, 2))


FIELDS: tuple[Field, ...] = (
    _text("image", "picture file"),
    _text("utc", "mid-exposure, UTC"),
    _number("et", u.s, "mid-exposure, TDB seconds past J2000"),
    _text("name", "target", "body"),
    _text("method", "centerfinder"),
    _text("status", "ok, uncertain, not_detected, off_detector, saturated or failed"),
    _text("observer", "spacecraft"),
    _text("reference_body", "body that the spacecraft position refers to"),
    _vector(
        "observed_px",
        u.pix,
        "observed center of figure (pixel, line), 0-based, integer = pixel center",
        ("pixel_o", "observed pixel (0-based, integer = pixel center)"),
        ("line_o", "observed line"),
    ),
    _vector(
        "predicted_px",
        u.pix,
        "computed place, solved pointing",
        ("pixel_c", "computed pixel, solved pointing"),
        ("line_c", "computed line, solved pointing"),
    ),
    _vector(
        "a_priori_px",
        u.pix,
        "computed place, a priori pointing",
        ("pixel_a_priori", "computed pixel, a priori pointing"),
        ("line_a_priori", "computed line, a priori pointing"),
    ),
    _vector(
        "residual_px",
        u.pix,
        "observed minus computed place",
        ("pixel_oc", "observed minus computed pixel"),
        ("line_oc", "observed minus computed line"),
    ),
    _covariance(
        "covariance_px2",
        u.pix,
        "observed pixel and line",
        ("sigma_pixel", "sigma_line", "covariance_pixel_line"),
    ),
    _covariance(
        "total_covariance_px2",
        u.pix,
        "observed minus computed pixel and line, pointing included",
        ("sigma_pixel_oc", "sigma_line_oc", "covariance_oc"),
    ),
    _text("light_time", "fixed or solved: what the partials do with the light time"),
    _partials("partials_px_per_km", u.km, "{}", "{} of the spacecraft relative to the reference body, J2000"),
    _partials(
        "partials_px_per_rad",
        u.rad,
        "rotation_{}",
        "small rotation of the attitude about the camera frame's {} axis",
    ),
    _partials("target_partials_px_per_km", u.km, "target_{}", "{} of the target at mid-exposure, J2000"),
    _partials(
        "target_partials_px_per_km_s",
        u.km / u.s,
        "target_v{}",
        "velocity {} of the target at mid-exposure, J2000",
    ),
    _sky(),
    _attitude(),
    _number(
        "ra_deg", u.deg, "observed right ascension, J2000, stellar aberration removed, light time not", "ra"
    ),
    _number(
        "dec_deg", u.deg, "observed declination, J2000, stellar aberration removed, light time not", "dec"
    ),
    _number("apparent_ra_deg", u.deg, "observed right ascension, J2000, as seen", "apparent_ra"),
    _number("apparent_dec_deg", u.deg, "observed declination, J2000, as seen", "apparent_dec"),
    _vector(
        "residual_arcsec",
        u.arcsec,
        "observed minus computed (RA cos(Dec), Dec)",
        ("ra_cosdec_oc", "observed minus computed RA times cos(Dec)"),
        ("dec_oc", "observed minus computed declination"),
    ),
    _covariance(
        "residual_covariance_arcsec2",
        u.arcsec,
        "observed minus computed RA cos(Dec) and Dec, pointing included",
        ("sigma_ra_cosdec_oc", "sigma_dec_oc", "covariance_ra_cosdec_dec_oc"),
    ),
    _number("diameter_px", u.pix, "predicted diameter", "diameter"),
    _number("measured_diameter_px", u.pix, "measured diameter", "measured_diameter"),
    _number("diameter_sigma_px", u.pix, "1 sigma of the measured diameter", "sigma_diameter"),
    _xyz("diameter_partials_px_per_km", u.pix / u.km, "d(diameter)/d(spacecraft position)", "ddiameter_d{}"),
    _number("range_km", u.km, "predicted distance from spacecraft to body", "range"),
    _number(
        "measured_range_km",
        u.km,
        "distance from the body's size, its radius taken as known",
        "measured_range",
    ),
    _number("range_sigma_km", u.km, "1 sigma of the measured distance", "sigma_range"),
    _xyz("range_partials", u.km / u.km, "d(range)/d(spacecraft position), km/km", "drange_d{}"),
    _xyz("position_km", u.km, "spacecraft to body, light time removed, no stellar aberration", "position_{}"),
    _xyz(
        "observer_velocity_km_s",
        u.km / u.s,
        "spacecraft relative to the solar-system barycenter",
        "observer_v{}",
    ),
    _xyz(
        "target_velocity_km_s",
        u.km / u.s,
        "body relative to the solar-system barycenter when the light left",
        "target_velocity_{}",
    ),
    _number("snr", u.one, "flux over its sigma"),
    _text("center_cross_px2", "JSON: covariance (px^2) of this center with those of bodies found jointly"),
    _text("messages", "what the analyst must know; separated by semicolons"),
)
COLUMNS: tuple[Column, ...] = tuple(column for field in FIELDS for column in field.columns)

assert {field.name for field in FIELDS} == {field.name for field in fields(Observable)}
