"""Albedo maps: equirectangular pictures wrapped around a body.

Conventions (defaults; each can be changed): columns are equal steps of longitude and cover 360 deg, rows are equal steps
of planetocentric latitude and cover 180 deg; the first row lies at the north pole; longitude grows eastward (as the
body's right-handed frame turns) from `first_longitude_deg` at the left edge of the left column. Values stand for the
middles of their cells and are interpolated bilinearly, around the date line too; poleward of the last row's middle the
row itself is used. A pixel's value is the body's normal albedo, see `opnav_workbench.render.scattering`.
"""

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Self

import numpy as np
from astropy.io import fits
from numpy.typing import ArrayLike
from PIL import Image, UnidentifiedImageError

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import MissionError

__all__ = ["AlbedoMap"]

TURN = 2.0 * np.pi
LARGEST_PIXELS = 300_000_000  # 24 000 by 12 000, the largest global mosaics; more is a damaged header
ARRAY_SUFFIXES = {".npy"}
FITS_SUFFIXES = {".fits", ".fit", ".fts"}
GRAY_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0}


@dataclass(frozen=True, slots=True, eq=False)
class AlbedoMap:
    """Albedo against longitude and latitude; the array is read-only.

    Attributes
    ----------
    values : (n, 2 n) array
        Normal albedo, 0 or more.
    first_longitude_deg
        Longitude of the left edge of the map.
    east_positive
        Longitude grows to the east and columns run east; else columns run west.
    north_first
        The first row is at the north pole.

    Raises
    ------
    MissionError
        The array is not twice as wide as high, or holds negative or non-finite values.

    Examples
    --------
    >>> AlbedoMap([[0.2, 0.4, 0.6, 0.8], [0.2, 0.4, 0.6, 0.8]]).sample(np.radians([45.0, 90.0]), np.zeros(2))
    array([0.2, 0.3])
    """

    values: FloatArray
    first_longitude_deg: float = 0.0
    east_positive: bool = True
    north_first: bool = True

    def __post_init__(self) -> None:
        array = np.asarray(self.values, dtype=np.float64)
        _check_size(array.shape, "albedo map")
        low = float(np.min(array))
        if not (np.isfinite(array).all() and low >= 0.0):
            raise MissionError(
                f"albedo map: values from {low:.4g} to {float(np.max(array)):.4g}; every one must be finite and not "
                "negative."
            )
        if not np.isfinite(self.first_longitude_deg):
            raise MissionError(
                f"albedo map: first_longitude_deg is {self.first_longitude_deg}; give degrees."
            )
        object.__setattr__(self, "values", array)
        freeze_arrays(self)

    @classmethod
    def from_file(
        cls,
        path: str | PathLike[str],
        *,
        darkest: float = 0.0,
        brightest: float = 1.0,
        first_longitude_deg: float = 0.0,
        east_positive: bool = True,
        north_first: bool = True,
    ) -> Self:
        """Read a map from a picture (PNG, JPEG, TIFF, ... as gray), a FITS image or an ``.npy`` array.

        Parameters
        ----------
        path : path-like
        darkest, brightest
            Albedos of gray level 0 and of the highest level (255 or 65535) of a picture. Arrays and FITS images of
            floating point hold albedos already and are taken as they are.
        first_longitude_deg, east_positive, north_first
            See the class.

        Raises
        ------
        MissionError
            The file cannot be read, is not twice as wide as high, or `brightest` is below `darkest`.
        """
        if not 0.0 <= darkest <= brightest < np.inf:
            raise MissionError(
                f"albedo map {path}: darkest {darkest} and brightest {brightest}; they are not negative and ordered."
            )
        pixels = _read(Path(path))
        _check_size(pixels.shape, f"albedo map {path}")
        full_scale = GRAY_FULL_SCALE.get(pixels.dtype.name)
        values = pixels.astype(np.float64)
        if full_scale is not None:
            values = darkest + (brightest - darkest) * values / full_scale
        try:
            return cls(values, first_longitude_deg, east_positive, north_first)
        except MissionError as error:
            raise MissionError(f"{path}: {error}") from error

    @property
    def cell_rad(self) -> float:
        """Height of a cell, rad."""
        return float(np.pi / self.values.shape[0])

    def coarsened(self, cell_rad: float) -> "AlbedoMap":
        """Return the map in the largest cells up to `cell_rad` that means of its own give; itself if they are as large.

        What a picture cannot resolve is averaged beforehand, so that rays do not fall on it by chance.

        Examples
        --------
        >>> AlbedoMap(np.arange(72.0).reshape(6, 12)).coarsened(1.1).values
        array([[ 6.5,  8.5, 10.5, 12.5, 14.5, 16.5],
               [30.5, 32.5, 34.5, 36.5, 38.5, 40.5],
               [54.5, 56.5, 58.5, 60.5, 62.5, 64.5]])
        """
        rows = self.values.shape[0]
        wanted = max(1, min(int(cell_rad / self.cell_rad), rows))
        factor = max(n for n in range(1, wanted + 1) if rows % n == 0)
        if factor == 1:
            return self
        blocks = self.values.reshape(rows // factor, factor, 2 * rows // factor, factor)
        return replace(self, values=blocks.mean(axis=(1, 3)))

    def sample(self, longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> FloatArray:
        """Return albedos (n,) at east longitudes and planetocentric latitudes (n,), rad."""
        i, j, below, right, u, v = self._neighbors(longitude_rad, latitude_rad)
        flat = self.values.ravel()
        upper = flat[i + j] + u * (flat[i + right] - flat[i + j])
        lower = flat[below + j] + u * (flat[below + right] - flat[below + j])
        return np.asarray(upper + v * (lower - upper))

    def corners(self, longitude_rad: ArrayLike, latitude_rad: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return which cells (4, n), flat, `sample` reads at places (n,), and with what shares (4, n)."""
        i, j, below, right, u, v = self._neighbors(longitude_rad, latitude_rad)
        cells = np.stack([i + j, i + right, below + j, below + right])
        return cells, np.stack([(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v])

    def _neighbors(
        self, longitude_rad: ArrayLike, latitude_rad: ArrayLike
    ) -> tuple[IntArray, IntArray, IntArray, IntArray, FloatArray, FloatArray]:
        """Return rows and columns (n,), flat, of the cells about places, and where between their middles each lies."""
        rows, columns = self.values.shape
        turn = np.asarray(longitude_rad, dtype=np.float64) / TURN
        turn = (turn if self.east_positive else -turn) - np.radians(self.first_longitude_deg) / TURN
        below_pole = 0.5 - np.asarray(latitude_rad, dtype=np.float64) / np.pi
        down = below_pole if self.north_first else 1.0 - below_pole
        x = (turn - np.floor(turn)) * columns - 0.5
        y = np.clip(down * rows - 0.5, 0.0, rows - 1.0)
        left = np.floor(x)
        top = np.minimum(np.floor(y), max(rows - 2, 0))
        i = top.astype(np.int64) * columns
        j = left.astype(np.int64) % columns
        right = np.where(j + 1 == columns, 0, j + 1)
        return i, j, i + (columns if rows > 1 else 0), right, x - left, y - top

    def sample_points(self, points: FloatArray) -> FloatArray:
        """Return albedos (n,) at points (3, n), body-fixed, any unit."""
        x, y, z = points
        return self.sample(np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))


def _check_size(shape: tuple[int, ...], what: str) -> None:
    if len(shape) != 2 or shape[1] != 2 * shape[0] or shape[0] == 0:
        size = " x ".join(str(n) for n in reversed(shape)) or "a single number"
        raise MissionError(
            f"{what} is {size} (wide x high); an equirectangular map is twice as wide as high, such as 2048 x 1024."
        )


def _read(path: Path) -> np.ndarray:
    suffix = path.suffix.lower()
    try:
        if suffix in ARRAY_SUFFIXES:
            return np.asarray(np.load(path, allow_pickle=False))
        if suffix in FITS_SUFFIXES:
            return _read_fits(path)
        return _read_picture(path)
    except (OSError, ValueError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())
        raise MissionError(
            f"albedo map {path} cannot be read: {reason}; give a PNG, JPEG, FITS or .npy file."
        ) from error


def _read_fits(path: Path) -> np.ndarray:
    data = fits.getdata(path)
    if data is None:
        raise ValueError("it holds no image")
    return np.asarray(data, dtype=data.dtype.newbyteorder("="))


def _read_picture(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        if picture.width * picture.height > LARGEST_PIXELS:
            raise ValueError(f"{picture.width} x {picture.height} pixels is too large")
        wide = picture.mode.startswith("I")  # 16 bits a pixel
        gray = picture if wide else picture.convert("L")
        return np.asarray(gray).astype(np.uint16 if wide else np.uint8)
