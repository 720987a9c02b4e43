"""Two archives of the same pictures held beside each other: two nights, two kernel sets, two versions of the program.

Both solutions rest on the same pixels, so their difference is not expected to be of one sigma: it says how far a change of
kernels, catalog, options or program moved the answer, in units of what either solution claims to know.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table

from opnav_workbench.arrays import FloatArray
from opnav_workbench.campaign.archive import Campaign
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry.rotations import matrix_from_quaternion, vector_from_rotation

__all__ = ["Comparison", "Difference", "compare"]

POINTING = "pointing"
SOURCES = ("attitude_source", "observer_source")
AXES = {POINTING: ("x", "y", "z")}  # of the camera; of bodies pixel and line


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """What moved between two solutions of one picture: its attitude, or the O-C of a body.

    Attributes
    ----------
    what
        "pointing", or "BODY, method".
    moved : ndarray, (3,) or (2,)
        Second minus first. Pointing: rotation vector about the camera's axes, rad; a body's O-C: pixel, line, px.
    sigma : ndarray, the same
        One sigma of such a solution: root of the mean of both variances.
    sigmas
        Length of `moved` in the metric of the mean covariance.
    """

    image: str
    et: float
    what: str
    moved: FloatArray
    sigma: FloatArray
    sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two archives, picture by picture.

    Attributes
    ----------
    pictures
        How many are in both.
    only_first, only_second
        Names of the others.
    statuses
        Pictures whose status changed: name, status in the first, in the second.
    bodies
        The same of bodies: picture, "BODY, method", status in the first ("none": not there), in the second.
    made_with
        What the pictures of both were made with and differs: what, in the first, in the second.
    differences
        In the order of time.
    """

    pictures: int
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    statuses: tuple[tuple[str, str, str], ...]
    bodies: tuple[tuple[str, str, str, str], ...]
    made_with: tuple[tuple[str, str, str], ...]
    differences: tuple[Difference, ...]

    def of(self, what: str) -> tuple[Difference, ...]:
        """Return the differences of the pointing, or of a body."""
        return tuple(d for d in self.differences if d.what == what)

    def table(self, above: float = 0.0) -> Table:
        """Return the differences of more than so many sigmas, the largest first: a row a component."""
        rows = [
            (d.image, d.what, axis, float(moved), unit, float(sigma), d.sigmas)
            for d in sorted(self.differences, key=lambda d: -d.sigmas)
            if d.sigmas > above
            for axis, moved, sigma in zip(axes_of(d.what), d.moved, d.sigma, strict=True)
            for unit in (unit_of(d.what),)
        ]
        names = ("image", "what", "axis", "moved", "unit", "sigma", "sigmas")
        kinds = (str, str, str, float, str, float, float)
        return Table(rows=rows or None, names=names, dtype=kinds)


def axes_of(what: str) -> tuple[str, ...]:
    """Return the names of a difference's components."""
    return AXES.get(what, ("pixel", "line"))


def unit_of(what: str) -> str:
    """Return the unit of a difference's components."""
    return "rad" if what == POINTING else "px"


def compare(first: Campaign, second: Campaign) -> Comparison:
    """Hold two archives beside each other; pictures are the same by their content, wherever they were.

    Raises
    ------
    SessionError
        They have no picture in common.
    """
    one, other = first.solutions(), second.solutions()
    both = sorted(one.keys() & other.keys(), key=lambda key: (one[key]["et"] or 0.0, one[key]["image"]))
    if not both:
        raise SessionError(
            f"{first.path} ({len(one)} pictures) and {second.path} ({len(other)}) have no picture in common."
        )
    pairs = [(one[key], other[key]) for key in both]
    return Comparison(
        pictures=len(both),
        only_first=_names(one, other),
        only_second=_names(other, one),
        statuses=tuple(
            (a["image"], a["status"], b["status"]) for a, b in pairs if a["status"] != b["status"]
        ),
        bodies=tuple(change for a, b in pairs for change in _changed_bodies(a, b)),
        made_with=_made_with([a for a, _ in pairs], [b for _, b in pairs]),
        differences=tuple(difference for a, b in pairs for difference in _differences(a, b)),
    )


def _names(of: Mapping[str, Mapping[str, Any]], without: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(sorted(row["image"] for key, row in of.items() if key not in without))


def _changed_bodies(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    found = []
    for what in dict.fromkeys((*a["bodies"], *b["bodies"])):
        before, now = (row["bodies"].get(what, {}).get("status", "none") for row in (a, b))
        if before != now:
            found.append((a["image"], what, before, now))
    return found


def _differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[Difference]:
    found = []
    if a["quaternion"] and b["quaternion"]:
        turned = matrix_from_quaternion(b["quaternion"]) @ matrix_from_quaternion(a["quaternion"]).T
        covariance = _mean(a["covariance"], b["covariance"])
        found.append(_difference(a, POINTING, vector_from_rotation(turned), covariance))
    for what in (name for name in a["bodies"] if name in b["bodies"]):
        before, now = a["bodies"][what], b["bodies"][what]
        if before["residual"] is not None and now["residual"] is not None:
            covariance = _mean(before["covariance"], now["covariance"])
            moved = np.subtract(now["residual"], before["residual"])
            found.append(_difference(a, what, moved, covariance))
    return found


def _mean(first: Any, second: Any) -> FloatArray:
    """Return the mean of two covariances; nan where one is not known."""
    known = [np.asarray(value, dtype=np.float64) for value in (first, second) if value is not None]
    return np.asarray(0.5 * (known[0] + known[1])) if len(known) == 2 else np.full((3, 3), np.nan)


def _difference(row: Mapping[str, Any], what: str, moved: FloatArray, covariance: FloatArray) -> Difference:
    covariance = covariance[: len(moved), : len(moved)]
    length = np.nan
    if np.isfinite(covariance).all():
        length = float(np.sqrt(max(float(moved @ np.linalg.pinv(covariance, hermitian=True) @ moved), 0.0)))
    et = np.nan if row["et"] is None else float(row["et"])
    return Difference(row["image"], et, what, moved, np.sqrt(np.diagonal(covariance)), length)


# ---- What the two were made with.


def _made_with(first: list[Any], second: list[Any]) -> tuple[tuple[str, str, str], ...]:
    one, other = _inputs(first), _inputs(second)
    names = sorted(one.keys() | other.keys())
    return tuple(
        (name, one.get(name, "none"), other.get(name, "none"))
        for name in names
        if one.get(name) != other.get(name)
    )


def _inputs(rows: list[Mapping[str, Any]]) -> dict[str, str]:
    """Return what pictures were made with: what, and its value or digest; several values with their counts."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        told = {name.replace("_", " "): row[name] for name in ("version", "catalog", *SOURCES)}
        told |= {"pointing model": row["model"]} if row["model"] else {}
        told |= {f"setting {name}": value for name, value in (row["settings"] or {}).items()}
        for name, value in told.items():
            found.setdefault(name, Counter())[str("none" if value in (None, "") else value)] += 1
        for kernel in row["kernels"] or ():
            digest = str(kernel.get("sha256") or "unknown")[:12]
            found.setdefault(f"kernel {Path(str(kernel.get('file'))).name}", Counter())[digest] += 1
    return {
        name: next(iter(values))
        if len(values) == 1
        else ", ".join(f"{value} ({count})" for value, count in sorted(values.items()))
        for name, values in found.items()
    }
