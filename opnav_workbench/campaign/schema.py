"""Tables of the campaign archive (SQLite), their columns and units, and where in ``result.json`` each value comes from.

One table of `Column`s makes the SQL schema, takes a result apart, and labels what queries return.  Keys of a result that
no column names are kept too, in the column ``extra`` of their row, so that a newer version's results lose nothing.

images ─┬─ pointings (at most one)   provenance (one)
        ├─ stars   bodies   observables   decisions   journal      (in the order of the result)
history    what stood before, one row a picture and content
observable_columns   units and descriptions of the observables' columns, as their files state them
readings   when a folder's files were written that were read, and what they held: as long as both stand it is not read again
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import sqlalchemy as sa

__all__ = [
    "APPLICATION_ID",
    "BODIES",
    "IMAGES",
    "PARTS",
    "POINTINGS",
    "PROVENANCE",
    "SCHEMA_VERSION",
    "STARS",
    "Column",
    "metadata",
    "row_of",
    "tables",
]


ColumnKind = Literal["text", "number", "whole", "flag", "json"]


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the archive.

    Attributes
    ----------
    kind : {"text", "number", "whole", "flag", "json"}
    unit
        As astropy reads it; empty for none.
    source
        Keys and indices that lead to the value in ``result.json``; empty: the column's own name.
    """

    name: str
    kind: ColumnKind
    unit: str = ""
    description: str = ""
    source: tuple[str | int, ...] = ()

    @property
    def path(self) -> tuple[str | int, ...]:
        """Keys and indices that lead to the value."""
        return self.source or (self.name,)


def _pair(key: str, name: str, description: str) -> tuple[Column, Column]:
    """Columns of a [pixel, line] of the result."""
    return (
        Column(f"{name}_pixel", "number", "pix", f"{description}, pixel", (key, 0)),
        Column(f"{name}_line", "number", "pix", f"{description}, line", (key, 1)),
    )


def _covariance(key: str, name: str, description: str) -> tuple[Column, Column, Column]:
    """Columns of a symmetric 2 x 2 of the result."""
    return (
        Column(f"{name}_pixel_pixel", "number", "pix2", f"{description}, pixel with pixel", (key, 0, 0)),
        Column(f"{name}_pixel_line", "number", "pix2", f"{description}, pixel with line", (key, 0, 1)),
        Column(f"{name}_line_line", "number", "pix2", f"{description}, line with line", (key, 1, 1)),
    )


IMAGES: tuple[Column, ...] = (
    Column("image", "text", "", "picture file"),
    Column("sha256", "text", "", "of the picture file"),
    Column("utc", "text", "", "mid-exposure, UTC"),
    Column("et", "number", "s", "mid-exposure, TDB seconds past J2000"),
    Column("exposure_s", "number", "s", "exposure time"),
    Column("mission", "text", "", "mission"),
    Column("camera", "text", "", "camera"),
    Column("status", "text", "", "ok, partial or failed"),
    Column("messages", "json", "", "what the analyst must know"),
)
POINTINGS: tuple[Column, ...] = (
    Column("ra_deg", "number", "deg", "boresight right ascension, J2000"),
    Column("dec_deg", "number", "deg", "boresight declination, J2000"),
    Column("twist_deg", "number", "deg", "position angle of increasing line at the boresight"),
    Column("delta_pixel", "number", "pix", "observed minus a priori pointing, pixel"),
    Column("delta_line", "number", "pix", "observed minus a priori pointing, line"),
    Column("delta_twist_deg", "number", "deg", "solved minus a priori twist"),
    Column("rms_px", "number", "pix", "root mean square star residual"),
    Column("n_stars", "whole", "", "stars in use"),
    Column("model", "text", "", "pointing model"),
    Column("excess_sigma_px", "number", "pix", "star centering error beyond the covariances"),
    Column("chi2_reduced", "number", "", "reduced chi-squared of the star residuals"),
    Column("twist_solved", "flag", "", "whether the stars determine the twist"),
    Column("quaternion_camera_from_j2000", "json", "", "SPICE style, scalar first"),
    Column("covariance_rad2", "json", "", "attitude covariance, rad2, camera frame"),
    Column("iterations", "json", "", "steps of the solution"),
)
STARS: tuple[Column, ...] = (
    Column("star", "text", "", "catalog designation", ("id",)),
    Column("mag", "number", "mag", "magnitude in the camera's band"),
    *_pair("a_priori", "a_priori", "computed with the a priori pointing"),
    *_pair("predicted", "predicted", "computed with the solved pointing"),
    *_pair("observed", "observed", "observed center"),
    *_pair("sigma_px", "sigma", "1 sigma of the observed center"),
    *_pair("residual_px", "residual", "observed minus computed"),
    Column("snr", "number", "", "flux over its sigma"),
    Column("status", "text", "", "used, rejected, not_detected, saturated, off_detector or blended"),
    Column("reason", "text", "", "why it is not used"),
    Column("method", "text", "", "centerfinder"),
)
BODIES: tuple[Column, ...] = (
    Column("body", "text", "", "target", ("name",)),
    Column("method", "text", "", "centerfinder"),
    Column("status", "text", "", "ok, uncertain, not_detected, off_detector, saturated or failed"),
    *_pair("a_priori", "a_priori", "computed with the a priori pointing"),
    *_pair("predicted", "predicted", "computed with the solved pointing"),
    *_pair("observed", "observed", "observed center of figure"),
    *_pair("residual_px", "residual", "observed minus computed"),
    *_covariance("covariance_px2", "covariance", "covariance of the center"),
    *_covariance("covariance_with_pointing_px2", "covariance_oc", "covariance of O-C, pointing included"),
    Column("diameter_px", "number", "pix", "predicted diameter"),
    Column("measured_diameter_px", "number", "pix", "measured diameter"),
    Column("ra_deg", "number", "deg", "observed right ascension, J2000, stellar aberration removed"),
    Column("dec_deg", "number", "deg", "observed declination, J2000, stellar aberration removed"),
    Column("apparent_ra_deg", "number", "deg", "observed right ascension, J2000, as seen"),
    Column("apparent_dec_deg", "number", "deg", "observed declination, J2000, as seen"),
    Column("ra_cosdec_oc_arcsec", "number", "arcsec", "O-C of RA times cos(Dec)", ("residual_arcsec", 0)),
    Column("dec_oc_arcsec", "number", "arcsec", "O-C of declination", ("residual_arcsec", 1)),
    Column("snr", "number", "", "flux over its sigma"),
    Column("partials_px_per_km", "json", "", "d(pixel, line) / d(spacecraft position), J2000"),
    Column("messages", "json", "", "what the analyst must know"),
)
PROVENANCE: tuple[Column, ...] = (
    Column("version", "text", "", "of the program"),
    Column("catalog", "text", "", "catalog spec"),
    Column("attitude_source", "text", "", "kernels or header; none: the stars told it; unknown: nothing did"),
    Column("observer_source", "text", "", "kernels or header; none: the stars told it; unknown: nothing did"),
    Column("kernels", "json", "", "files and their SHA-256"),
    Column("settings", "json", "", "of the session"),
    Column("image_notes", "json", "", "what the reader said of the file"),
)


def row_of(values: Mapping[str, Any], columns: Sequence[Column], also: Sequence[str] = ()) -> dict[str, Any]:
    """Return the row of a part of a result; keys that no column names (nor `also`) go to ``extra``.

    Examples
    --------
    >>> row = row_of({"id": "HIP 1", "observed": None, "color": 0.4}, STARS)
    >>> row["star"], row["observed_pixel"], row["extra"]
    ('HIP 1', None, {'color': 0.4})
    """
    known = {column.path[0] for column in columns} | set(also)
    row = {column.name: _value(values, column) for column in columns}
    row["extra"] = {key: value for key, value in values.items() if key not in known}
    return row


def _value(values: Mapping[str, Any], column: Column) -> Any:
    """Follow a column's path; what is missing, or null on the way, is None.

    Raises
    ------
    TypeError
        The value is of another kind than the column.
    """
    value: Any = values
    for step in column.path:
        value = value.get(step) if isinstance(value, Mapping) else value[step]
        if value is None:
            return None
    return _checked(value, column)


def _checked(value: Any, column: Column) -> Any:
    if column.kind == "number" and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    kinds: dict[str, type | tuple[type, ...]] = {"text": str, "whole": int, "flag": bool, "json": object}
    if column.kind == "number" or not isinstance(value, kinds[column.kind]):
        raise TypeError(f"{'.'.join(map(str, column.path))} is {value!r}, not a {column.kind}")
    return value


# ---- The tables, made from these columns.

SCHEMA_VERSION = 3
APPLICATION_ID = 0x4F504E56  # "OPNV": says to `file` and to us whose database this is

metadata = sa.MetaData()
JSON = sa.JSON(none_as_null=True)
TYPES: dict[str, sa.types.TypeEngine[Any]] = {
    "text": sa.Text(),
    "number": sa.Float(),
    "whole": sa.Integer(),
    "flag": sa.Boolean(),
    "json": JSON,
}


def _columns(columns: Sequence[Column]) -> list["sa.Column[Any]"]:
    return [sa.Column(column.name, TYPES[column.kind]) for column in columns]


def _of_image(name: str, *columns: "sa.Column[Any]", single: bool = False) -> sa.Table:
    """A table of rows that belong to a picture and go with it; `position` keeps their order."""
    owner: sa.Column[Any] = sa.Column(
        "image_id", sa.ForeignKey("images.id", ondelete="CASCADE"), primary_key=True
    )
    order = [] if single else [sa.Column("position", sa.Integer, primary_key=True)]
    return sa.Table(name, metadata, owner, *order, *columns)


def _of_result(name: str, columns: Sequence[Column], *, single: bool = False) -> sa.Table:
    """A table of rows that stand in ``result.json``."""
    return _of_image(name, *_columns(columns), sa.Column("extra", JSON), single=single)


sa.Table(
    "images",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("key", sa.Text, nullable=False, unique=True),  # the picture's own, wherever it was processed
    *_columns(IMAGES),
    sa.Column("attention", JSON, nullable=False),  # why an analyst should look; empty: need not
    sa.Column("extra", JSON),
    sa.Column("path", sa.Text),  # of the picture, as the session knew it
    sa.Column("folder", sa.Text, nullable=False, index=True),
    sa.Column("content_sha256", sa.Text, nullable=False),
    sa.Column("processed_utc", sa.Text, nullable=False),
    sa.Column("ingested_utc", sa.Text, nullable=False),
    sa.Index("images_by_time", "et"),
)
PARTS: tuple[str, ...] = tuple(
    table.name
    for table in (
        _of_result("pointings", POINTINGS, single=True),
        _of_result("provenance", PROVENANCE, single=True),
        _of_result("stars", STARS),
        _of_result("bodies", BODIES),
        _of_image(
            "observables",
            sa.Column("body", sa.Text),
            sa.Column("method", sa.Text),
            sa.Column("cells", JSON, nullable=False),
        ),
        _of_image(
            "decisions",
            sa.Column("subject", sa.Text),
            sa.Column("verdict", sa.Text),
            sa.Column("reason", sa.Text),
            sa.Column("extra", JSON),
        ),
        _of_image(
            "journal",
            sa.Column("step", sa.Text, nullable=False),
            sa.Column("parameters", JSON),
            sa.Column("reason", sa.Text),
            sa.Column("outcome", sa.Text),
            sa.Column("time_utc", sa.Text),
            sa.Column("extra", JSON),
        ),
    )
)
sa.Table(
    "observable_columns",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("unit", sa.Text),
    sa.Column("description", sa.Text),
    sa.Column("position", sa.Integer, nullable=False),
)
sa.Table(
    "history",
    metadata,
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("content_sha256", sa.Text, primary_key=True),
    sa.Column("image", sa.Text),
    sa.Column("status", sa.Text),
    sa.Column("summary", JSON),
    sa.Column("folder", sa.Text),
    sa.Column("processed_utc", sa.Text),
    sa.Column("ingested_utc", sa.Text),
)
sa.Table(
    "readings",
    metadata,
    sa.Column("folder", sa.Text, primary_key=True),
    sa.Column("moment", sa.Text, nullable=False),
    sa.Column("content_sha256", sa.Text, nullable=False),
)
tables: dict[str, sa.Table] = dict(metadata.tables)
