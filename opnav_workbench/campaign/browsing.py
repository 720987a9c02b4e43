"""What a page about a campaign shows: counts, reasons to look, a page of pictures, what they were made with, what changed.

Every question asks the archive for what is shown and no more, so that 100,000 pictures are as quick as ten.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from opnav_workbench.campaign.schema import tables

__all__ = ["Overview", "Page", "changes_page", "made_with_rows", "overview", "picture", "pictures_page"]

CHANGES_SHOWN = 500
LIKE_SIGNS = str.maketrans({sign: f"\\{sign}" for sign in "\\%_"})


@dataclass(frozen=True, slots=True)
class Overview:
    """A campaign in numbers.

    Attributes
    ----------
    counts
        Pictures by status.
    first_utc, last_utc
        Of the pictures; empty where none has a time.
    reasons
        Pictures that need an analyst: name and reasons, in the order of time.
    changed
        How many pictures have been processed again.
    """

    counts: Mapping[str, int]
    first_utc: str
    last_utc: str
    reasons: tuple[Mapping[str, Any], ...]
    changed: int


@dataclass(frozen=True, slots=True)
class Page:
    """Some pictures of many.

    Attributes
    ----------
    rows
        ``id, image, utc, status, attention, n_stars, delta_pixel, delta_line, delta_twist_deg, rms_px`` and ``bodies``
        (their ``body, method, status, residual_pixel, residual_line, sigma_pixel, sigma_line``).
    total
        How many there are in all.
    """

    rows: tuple[Mapping[str, Any], ...]
    total: int


def overview(connection: sa.Connection) -> Overview:
    """Return a campaign in numbers."""
    images, history = tables["images"], tables["history"]
    counts = connection.execute(sa.select(images.c.status, sa.func.count()).group_by(images.c.status)).all()
    first, last = connection.execute(sa.select(sa.func.min(images.c.utc), sa.func.max(images.c.utc))).one()
    query = sa.select(images.c.image, images.c.attention).where(_flagged()).order_by(images.c.et)
    reasons = tuple({"name": image, "attention": attention} for image, attention in connection.execute(query))
    changed = connection.execute(sa.select(sa.func.count(sa.distinct(history.c.key)))).scalar_one()
    return Overview({str(s): n for s, n in counts}, first or "", last or "", reasons, changed)


def _flagged() -> "sa.ColumnElement[bool]":
    return sa.cast(tables["images"].c.attention, sa.Text) != "[]"


def pictures_page(
    connection: sa.Connection, *, start: int = 0, count: int = 100, status: str = "", words: str = ""
) -> Page:
    """Return some pictures, in the order of time.

    Parameters
    ----------
    status
        Only these; "attention": those that need an analyst.
    words
        Only those whose name, reasons or time hold all of these.
    """
    images, pointings = tables["images"], tables["pointings"]
    chosen = []
    if status == "attention":
        chosen.append(_flagged())
    elif status:
        chosen.append(images.c.status == status)
    texts = (images.c.image, images.c.utc, sa.cast(images.c.attention, sa.Text))
    for word in words.split():
        pattern = f"%{word.translate(LIKE_SIGNS)}%"
        chosen.append(sa.or_(*[text.like(pattern, escape="\\") for text in texts]))
    total = connection.execute(sa.select(sa.func.count()).select_from(images).where(*chosen)).scalar_one()
    moved = [pointings.c[n] for n in ("n_stars", "delta_pixel", "delta_line", "delta_twist_deg", "rms_px")]
    shown = [images.c[name] for name in ("id", "image", "utc", "status", "attention")]
    query = sa.select(*shown, *moved).select_from(images.outerjoin(pointings)).where(*chosen)
    query = query.order_by(images.c.et, images.c.image).limit(count).offset(start)
    rows = [dict(row) for row in connection.execute(query).mappings()]
    bodies = _bodies(connection, [row["id"] for row in rows])
    return Page(tuple({**row, "bodies": bodies.get(row["id"], [])} for row in rows), total)


def _bodies(connection: sa.Connection, ids: list[int]) -> dict[int, list[dict[str, Any]]]:
    bodies = tables["bodies"]
    names = ("body", "method", "status", "residual_pixel", "residual_line")
    variances = {axis: bodies.c[f"covariance_oc_{axis}_{axis}"] for axis in ("pixel", "line")}
    columns: list[sa.ColumnElement[Any]] = [bodies.c.image_id, *[bodies.c[name] for name in names]]
    columns += [variance.label(f"sigma_{axis}") for axis, variance in variances.items()]
    query = sa.select(*columns).where(bodies.c.image_id.in_(ids)).order_by(bodies.c.position)
    found: dict[int, list[dict[str, Any]]] = {}
    for row in connection.execute(query).mappings():
        sigmas = {
            name: None if row[name] is None else row[name] ** 0.5 for name in ("sigma_pixel", "sigma_line")
        }
        found.setdefault(row["image_id"], []).append({**row, **sigmas})
    return found


def picture(connection: sa.Connection, number: int) -> dict[str, Any] | None:
    """Return a picture by its number in the archive, with its folder, messages, provenance and bodies; None: none such."""
    images, made = tables["images"], tables["provenance"]
    query = (
        sa.select(images, made.c.version, made.c.catalog, made.c.kernels)
        .select_from(images.outerjoin(made))
        .where(images.c.id == number)
    )
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else {**row, "bodies": _bodies(connection, [number]).get(number, [])}


def made_with_rows(connection: sa.Connection) -> list[dict[str, Any]]:
    """Return what pictures were made with: version, catalog and kernels of each kind of night, with pictures and times."""
    images, made = tables["images"], tables["provenance"]
    groups = (made.c.version, made.c.catalog, made.c.kernels)
    query = (
        sa.select(*groups, sa.func.count().label("pictures"), sa.func.min(images.c.utc).label("first_utc"))
        .add_columns(sa.func.max(images.c.utc).label("last_utc"))
        .join_from(made, images)
        .group_by(*groups)
        .order_by(sa.desc("pictures"))
    )
    return [dict(row) for row in connection.execute(query).mappings()]


def changes_page(connection: sa.Connection) -> list[dict[str, Any]]:
    """Return what was processed again, the latest first: picture, its status before and now, and when."""
    images, history = tables["images"], tables["history"]
    query = (
        sa.select(images.c.id, images.c.image, history.c.status.label("before"), images.c.status)
        .add_columns(history.c.processed_utc.label("made_before"), images.c.processed_utc)
        .join_from(history, images, history.c.key == images.c.key)
        .order_by(images.c.processed_utc.desc(), history.c.processed_utc.desc())
        .limit(CHANGES_SHOWN)
    )
    return [dict(row) for row in connection.execute(query).mappings()]
