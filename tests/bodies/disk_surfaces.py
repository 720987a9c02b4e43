"""Surfaces for the truth of disks: scattering laws, and albedo or relief on the unit sphere, none of them the package's.

A surface is asked at unit vectors (n, 3) of the body's frame, those of its ellipsoid shrunk to a sphere: `albedo` gives the
factor of the law, `slope` the tangential gradient of the relief (height over radius per radian), or None.

Families: ``uniform``; ``blobs_S``, caps of radius S rad with sharp edges, two albedos; ``field_small``, ``field_mid``,
``field_steep``, Gaussian random fields of three spectra; ``craters``, bowls with rims in relief alone; ``map_N``, the real
maps of the data folder, stretched.
"""

from functools import cache
from pathlib import Path

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

MAPS = (
    "Charon.jpg",
    "Pluto.jpg",
    "hs-2010-06-f-full_jpg.jpg",
    "hs-2010-06-g-full_jpg.jpg",
    "pluto-bjorn-20150719-filled.png",
)
BLOB_SIZES = ("0.05", "0.1", "0.2", "0.35", "0.6", "1.0")
FIELDS = ("small", "mid", "steep")
DARKEST = 0.05  # of the mean albedo: fields are clipped there
GRID, GRID_SIDE = 128, 2.5  # cells of the cube in which fields are drawn, its side in radii


# ---- Laws: reflectance from the cosines of incidence and emission and the phase angle, in any unit.


def lambert(mu0, mu, phase):
    return mu0


def lommel_seeliger(mu0, mu, phase):
    return mu0 / (mu0 + mu)


def lunar_lambert(share):
    return lambda mu0, mu, phase: share * 2.0 * mu0 / (mu0 + mu) + (1.0 - share) * mu0


def minnaert(k):
    return lambda mu0, mu, phase: mu0**k * np.maximum(mu, 1e-4) ** (k - 1.0)


def hapke(w, surge=1.0, width=0.06, asymmetry=-0.25):
    """Hapke's law of 1981 for a smooth surface: single scattering with an opposition surge, and multiple scattering."""
    gamma = np.sqrt(1.0 - w)

    def h(x):
        return (1.0 + 2.0 * x) / (1.0 + 2.0 * x * gamma)

    def law(mu0, mu, phase):
        b = surge / (1.0 + np.tan(0.5 * phase) / width)
        p = (1.0 - asymmetry**2) / (1.0 + 2.0 * asymmetry * np.cos(np.pi - phase) + asymmetry**2) ** 1.5
        return mu0 / (mu0 + mu) * ((1.0 + b) * p + h(mu0) * h(mu) - 1.0)

    return law


LAWS = {
    "lambert": lambert,
    "lommel_seeliger": lommel_seeliger,
    "lunar_0.3": lunar_lambert(0.3),
    "lunar_0.6": lunar_lambert(0.6),
    "minnaert_0.6": minnaert(0.6),
    "minnaert_0.8": minnaert(0.8),
    "hapke_dark": hapke(0.25),
    "hapke_bright": hapke(0.9, surge=0.6),
}


# ---- Surfaces.


class Uniform:
    def albedo(self, q):
        return np.ones(len(q))

    def slope(self, q):
        return None


class Blobs(Uniform):
    """Caps of one radius thrown at random until half of the sphere is covered; low or high, with sharp edges."""

    def __init__(self, radius_rad, contrast, rng):
        number = max(round(np.log(2.0) / np.sin(0.5 * radius_rad) ** 2), 2)
        centers = rng.normal(size=(number, 3))
        self.tree = cKDTree(centers / np.linalg.norm(centers, axis=1)[:, None])
        self.reach = 2.0 * np.sin(0.5 * radius_rad)
        self.low, self.high = rng.permutation([1.0 / contrast, 1.0])

    def albedo(self, q):
        far = np.isinf(self.tree.query(q, distance_upper_bound=self.reach)[0])
        return np.where(far, self.low, self.high)


class Field(Uniform):
    """A Gaussian field on the sphere, from one in a cube about it; +-2 sigma span the contrast."""

    def __init__(self, spectrum, contrast, rng):
        k = 2.0 * np.pi * np.fft.fftfreq(GRID, GRID_SIDE / GRID).astype(np.float32)
        k2 = k[:, None, None] ** 2 + k[None, :, None] ** 2 + np.abs(k[None, None, : GRID // 2 + 1]) ** 2
        amplitude = {
            "small": lambda: np.exp(-0.25 * k2 * 0.04**2),
            "mid": lambda: np.exp(-0.25 * k2 * 0.25**2),
            "steep": lambda: (k2 + 1.0) ** -1.25,
        }[spectrum]()
        white = fft.rfftn(rng.standard_normal((GRID, GRID, GRID), dtype=np.float32))
        self.cube = fft.irfftn(white * amplitude, s=(GRID,) * 3)
        sphere = rng.normal(size=(4000, 3))
        values = self._values(sphere / np.linalg.norm(sphere, axis=1)[:, None])
        self.mean, self.scale = values.mean(), 0.5 * (contrast - 1.0) / (contrast + 1.0) / values.std()

    def _values(self, q):
        at = (q.T * (GRID / GRID_SIDE) + 0.5 * GRID).astype(np.float32)
        return map_coordinates(self.cube, at, order=1, mode="grid-wrap")

    def albedo(self, q):
        return np.maximum(1.0 + self.scale * (self._values(q) - self.mean), DARKEST).astype(np.float64)


def bilinear(raster, q):
    """Values of a raster (n_lat, 2 n_lat, ...) of cells, north first and longitude from -180 deg, at unit vectors."""
    n_lat, n_lon = raster.shape[:2]
    line = np.arccos(np.clip(q[:, 2], -1.0, 1.0)) * (n_lat / np.pi) - 0.5
    pixel = (np.arctan2(q[:, 1], q[:, 0]) + np.pi) * (n_lon / (2.0 * np.pi)) - 0.5
    at = [np.clip(line, 0.0, n_lat - 1.0), pixel % n_lon]
    planes = raster.reshape(n_lat, n_lon, -1)
    padded = np.concatenate([planes, planes[:, :1]], axis=1)
    values = [map_coordinates(padded[..., i], at, order=1, mode="nearest") for i in range(planes.shape[2])]
    return np.stack(values, axis=-1).reshape(len(q), *raster.shape[2:])


class Craters(Uniform):
    """Bowls with rims, as many of each size as their areas allow; shades come from the slopes, bottoms may lie dark."""

    DEPTH = {3.0: 0.08, 9.0: 0.18}  # depth over diameter

    def __init__(self, contrast, diameter_px, rng):
        n_lat = int(np.clip(4.0 * diameter_px, 48, 600))
        lat = np.pi * (0.5 - (np.arange(n_lat) + 0.5) / n_lat)
        lon = 2.0 * np.pi * (np.arange(2 * n_lat) + 0.5) / (2 * n_lat) - np.pi
        self.q = np.stack(
            [
                np.cos(lat)[:, None] * np.cos(lon),
                np.cos(lat)[:, None] * np.sin(lon),
                np.repeat(np.sin(lat)[:, None], 2 * n_lat, 1),
            ],
            axis=-1,
        )
        self.lat, self.raster = lat, np.zeros((n_lat, 2 * n_lat, 3))
        radii = 0.05 * rng.uniform(0.0, 1.0, 140) ** (-1.0 / 2.0)
        for radius in np.minimum(radii, 0.35):
            center = rng.normal(size=3)
            self._dig(center / np.linalg.norm(center), radius, self.DEPTH[contrast] * rng.uniform(0.5, 1.0))
        del self.q

    def _dig(self, center, radius, depth):
        rows = np.abs(self.lat - np.arcsin(center[2])) < 2.0 * radius
        q = self.q[rows]
        cosine = q @ center
        near = cosine > np.cos(2.0 * radius)
        rho = np.arccos(np.clip(cosine[near], -1.0, 1.0)) / radius
        away = q[near] * cosine[near][:, None] - center
        away /= np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
        rise = np.where(rho < 1.0, 4.0 * depth * rho, -1.2 * depth * np.exp((1.0 - rho) / 0.35))
        part = self.raster[rows]
        part[near] += rise[:, None] * away
        self.raster[rows] = part

    def slope(self, q):
        return bilinear(self.raster, q)


class RealMap(Uniform):
    """A real map, stretched so that its 2nd and 98th percentiles stand at the contrast, turned at random in longitude."""

    def __init__(self, path, contrast, rng):
        grey = _grey(path)
        low, high = np.percentile(grey, [2.0, 98.0])
        level = np.clip((grey - low) / (high - low), 0.0, 1.0)
        self.raster = np.roll(1.0 + (contrast - 1.0) * level, rng.integers(grey.shape[1]), axis=1) / contrast

    def albedo(self, q):
        return bilinear(self.raster, q)


@cache
def _grey(path):
    from PIL import Image

    with Image.open(path) as image:
        grey = np.asarray(image.convert("L"), dtype=np.float64)
    unseen = grey < 6.0  # the polar night, which no camera mapped
    return np.where(unseen, np.median(grey[~unseen]), grey)


def make_surface(family, contrast, diameter_px, rng, data_dir: Path | None = None):
    """Return the surface of a family by name; contrast is that of its albedo (of craters: which depth)."""
    if family == "uniform":
        return Uniform()
    kind, _, rest = family.partition("_")
    if kind == "blobs":
        return Blobs(float(rest), contrast, rng)
    if kind == "field":
        return Field(rest, contrast, rng)
    if kind == "craters":
        return Craters(contrast, diameter_px, rng)
    return RealMap(Path(data_dir) / "maps" / MAPS[int(rest)], contrast, rng)
