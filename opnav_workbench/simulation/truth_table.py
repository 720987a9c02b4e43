"""The table of what a picture shows: a row for every star and body, with its place, its light and its trail."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable, vstack
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.simulation.starlight import Trails

__all__ = ["BodyTruth", "body_rows", "star_rows", "truth_table"]

# Every column of the table: unit and description, in the order of the file.
COLUMNS: dict[str, tuple[Any, str]] = {
    "kind": (None, "star or body"),
    "id": (None, "catalog designation, or SPICE name"),
    "pixel": (u.pix, "center at mid-exposure, horizontal; of a body its center of figure"),
    "line": (u.pix, "center at mid-exposure, vertical"),
    "mean_pixel": (
        u.pix,
        "mean place of the light over the exposure, horizontal; of a body its center of light",
    ),
    "mean_line": (u.pix, "mean place of the light over the exposure, vertical"),
    "smear": (u.pix, "length of the trail"),
    "flux": (u.electron, "electrons of the whole image, on and off the detector"),
    "mag": (u.mag, "V magnitude"),
    "on_detector": (None, "whether the center falls on a pixel"),
    "occulted": (None, "whether a body hides it, wholly or for the larger part"),
    "occulted_fraction": (None, "hidden part of its light"),
    "diameter": (u.pix, "diameter of the disk, 0 for a star"),
}


@dataclass(frozen=True, slots=True, eq=False)
class BodyTruth:
    """A body in a picture.

    Attributes
    ----------
    name : str
    center_px : (2,) array
        Center of figure at mid-exposure.
    light_px : (2,) array
        Center of its light over the exposure; nan where none reaches the detector.
    flux_e : float
    mag : float
        nan where it is not known.
    diameter_px : float
    on_detector : bool
    occulted_fraction : float
        Part of its light that other bodies hide.
    smear_px : float
    """

    name: str
    center_px: FloatArray
    light_px: FloatArray
    flux_e: float
    mag: float
    diameter_px: float
    on_detector: bool
    occulted_fraction: float = 0.0
    smear_px: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)


def star_rows(
    ids: ArrayLike,
    mag: ArrayLike,
    flux_e: ArrayLike,
    trails: Trails,
    on_detector: ArrayLike,
    occulted: ArrayLike,
) -> QTable:
    """Return the rows of n stars; every argument has n elements."""
    hidden = np.asarray(occulted, dtype=bool)
    return _table(
        kind=np.full(len(hidden), "star"),
        id=np.asarray(ids, dtype=np.str_),
        pixel=trails.middle_px[:, 0],
        line=trails.middle_px[:, 1],
        mean_pixel=trails.mean_px[:, 0],
        mean_line=trails.mean_px[:, 1],
        smear=trails.length_px,
        flux=flux_e,
        mag=mag,
        on_detector=np.asarray(on_detector, dtype=bool),
        occulted=hidden,
        occulted_fraction=hidden.astype(np.float64),
        diameter=np.zeros(len(hidden)),
    )


def body_rows(bodies: Sequence[BodyTruth]) -> QTable:
    """Return the rows of bodies."""
    centers, light = (
        np.array([getattr(b, name) for b in bodies], dtype=np.float64).reshape(-1, 2)
        for name in ("center_px", "light_px")
    )
    hidden = np.array([b.occulted_fraction for b in bodies], dtype=np.float64)
    return _table(
        kind=np.full(len(bodies), "body"),
        id=np.array([b.name for b in bodies], dtype=np.str_),
        pixel=centers[:, 0],
        line=centers[:, 1],
        mean_pixel=light[:, 0],
        mean_line=light[:, 1],
        smear=[b.smear_px for b in bodies],
        flux=[b.flux_e for b in bodies],
        mag=[b.mag for b in bodies],
        on_detector=np.array([b.on_detector for b in bodies], dtype=bool),
        occulted=hidden > 0.5,
        occulted_fraction=hidden,
        diameter=[b.diameter_px for b in bodies],
    )


def truth_table(stars: QTable, bodies: QTable) -> QTable:
    """Return one table of both, bodies first; every column has a description, and a unit where it has one."""
    full = [part for part in (bodies, stars) if len(part)]
    if len(full) < 2:
        return full[0] if full else stars
    return vstack(full, metadata_conflicts="silent")


def _table(**columns: Any) -> QTable:
    table = QTable()
    for name, (unit, text) in COLUMNS.items():
        values = columns[name]
        table[name] = values if unit is None else np.asarray(values, dtype=np.float64) * unit
        table[name].info.description = text
    return table
