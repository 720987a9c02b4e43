"""Star lists: a few stars by name with full astrometry, as a person writes them down (YAML).

Used for stars that are themselves targets, such as Proxima Centauri seen from New Horizons.
"""

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog.priors import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.catalog.table import StarTable
from opnav_workbench.errors import CatalogError
from opnav_workbench.yaml_file import read_model

__all__ = ["read_star_list"]


class _Star(BaseModel):
    """One star as written in the file; motions include cos(dec) as catalogs give them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    ra_deg: float = Field(ge=0.0, lt=360.0)
    dec_deg: float = Field(ge=-90.0, le=90.0)
    epoch_jyear: float
    pmra_mas_yr: float = 0.0
    pmdec_mas_yr: float = 0.0
    parallax_mas: float = Field(default=0.0, ge=0.0)
    rv_km_s: float | None = None
    mag: float
    band: str = "V"
    sigma_position_mas: float = Field(default=0.1, ge=0.0)
    sigma_parallax_mas: float = Field(default=0.1, ge=0.0)
    sigma_motion_mas_yr: float = Field(default=0.1, ge=0.0)
    source: str = ""


class _StarList(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    stars: list[_Star] = Field(min_length=1)


def read_star_list(path: str | Path) -> StarTable:
    """Read a YAML star list (key ``stars``: name, ra_deg, dec_deg, epoch_jyear, mag and optional astrometry).

    Parameters
    ----------
    path : path to a YAML file

    Returns
    -------
    StarTable
        One row a star, ``id`` its name.

    Raises
    ------
    CatalogError
        The file is missing, is not YAML, or a value is absent or out of range (named).
    """
    return _table(read_model(path, _StarList, "star list", CatalogError).stars)


def _table(stars: list[_Star]) -> StarTable:
    def column(name: str) -> FloatArray:
        return np.array([getattr(star, name) for star in stars], dtype=np.float64)

    position, parallax, motion = (
        column(f"sigma_{name}") * RAD_PER_MAS for name in ("position_mas", "parallax_mas", "motion_mas_yr")
    )
    return StarTable(
        id=np.array([star.name for star in stars]),
        ra_rad=column("ra_deg") * RAD_PER_DEG,
        dec_rad=column("dec_deg") * RAD_PER_DEG,
        pmra_rad_yr=column("pmra_mas_yr") * RAD_PER_MAS,
        pmdec_rad_yr=column("pmdec_mas_yr") * RAD_PER_MAS,
        parallax_rad=column("parallax_mas") * RAD_PER_MAS,
        rv_km_s=column("rv_km_s"),
        mag=column("mag"),
        band=np.array([star.band for star in stars]),
        epoch_jyear=column("epoch_jyear"),
        sigma=np.stack([position, position, parallax, motion, motion], axis=-1),
        motion_known=np.ones(len(stars), dtype=bool),
    )
