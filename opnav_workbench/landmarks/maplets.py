"""Maplets: small patches of a body's surface, each a grid of heights and albedo with its place, axes and scale.

Frame  body-fixed for places; a maplet's own axes are east, north and up of its mean plane
Units  km

Row i, column j of a grid of m by m samples stands at ``place + ((j - h) east + (i - h) north) scale + height up``, with
h = (m - 1) / 2 and m odd: the middle sample is the landmark, and its height is 0. Heights that are not known are nan.

The file is a NumPy archive (``.npz``) without pickle: the arrays of `Maplets`, and ``format_version``, ``kind``, ``body``
and ``source``.
"""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path
from opnav_workbench.format_versions import FORMAT_KEY, PRESENT_VERSION, as_of_today
from opnav_workbench.npz_file import NpzDamage, read_npz

__all__ = ["Maplets"]

KIND = "maplets"
SMALLEST_GRID = 5
AXES_TOLERANCE = 1e-6
# Heights to 1e-7 of a maplet's width and albedo to 1e-7: half the size of the file.
STORED_SINGLE = ("heights_km", "albedo")
ARRAYS = ("id", "place_km", "axes", "scale_km", "heights_km", "albedo", "sigma_km")


@dataclass(frozen=True, slots=True, eq=False)
class Maplets:
    """n patches of a body's surface, of m by m samples each; arrays are read-only.

    Attributes
    ----------
    body
        SPICE name.
    id : (n,) array of str
        Each name once.
    place_km : (n, 3) array
        The middle sample, body-fixed.
    axes : (n, 3, 3) array
        Unit vectors east, north and up in rows, body-fixed.
    scale_km : (n,) array
        Between neighboring samples.
    heights_km : (n, m, m) array
        Above the plane through the middle sample; nan where not known.
    albedo : (n, m, m) array
        Normal albedo, or relative to any mean: brightness is fitted.
    sigma_km : (n, 3) array
        1 sigma of the place along east, north and up.
    source
        What the maplets were made from.

    Raises
    ------
    MissionError
        Shapes that do not fit together, values that are not finite, axes that do not turn, ids that repeat.
    """

    body: str
    id: NDArray[np.str_]
    place_km: FloatArray
    axes: FloatArray
    scale_km: FloatArray
    heights_km: FloatArray
    albedo: FloatArray
    sigma_km: FloatArray
    source: str = ""

    def __post_init__(self) -> None:
        names = np.array([str(name) for name in np.atleast_1d(self.id)], dtype=np.str_)
        object.__setattr__(self, "id", names)
        for field in ARRAYS[1:]:
            object.__setattr__(self, field, np.asarray(getattr(self, field), dtype=np.float64))
        self._check_shapes()
        self._check_values()
        freeze_arrays(self, in_file_order=True)

    def _check_shapes(self) -> None:
        n, m = len(self.id), self.heights_km.shape[-1] if self.heights_km.ndim == 3 else 0
        shapes = {
            "place_km": (n, 3),
            "axes": (n, 3, 3),
            "scale_km": (n,),
            "heights_km": (n, m, m),
            "albedo": (n, m, m),
            "sigma_km": (n, 3),
        }
        for field, shape in shapes.items():
            found = getattr(self, field).shape
            if found != shape:
                raise MissionError(f"maplets of {self.body}: {field} has shape {found}, not {shape}.")
        if m < SMALLEST_GRID or m % 2 == 0:
            raise MissionError(
                f"maplets of {self.body} have {m} samples a side; an odd number of {SMALLEST_GRID} or more is needed."
            )

    def _check_values(self) -> None:
        what = f"maplets of {self.body}"
        for field in ("place_km", "axes", "scale_km", "albedo", "sigma_km"):
            if not np.isfinite(getattr(self, field)).all():
                raise MissionError(f"{what}: {field} holds values that are not finite.")
        if len(set(self.id.tolist())) != len(self.id):
            raise MissionError(f"{what}: an id stands twice; every landmark needs its own.")
        if np.any(self.scale_km <= 0.0) or np.any(self.sigma_km < 0.0) or np.any(self.albedo < 0.0):
            raise MissionError(f"{what}: scale_km must be positive, sigma_km and albedo not negative.")
        turned = self.axes @ np.swapaxes(self.axes, 1, 2) - np.eye(3)
        if len(self.id) and (np.abs(turned).max() > AXES_TOLERANCE or np.any(np.linalg.det(self.axes) < 0.0)):
            raise MissionError(f"{what}: axes are no right-handed unit vectors.")

    def __len__(self) -> int:
        return len(self.id)

    @property
    def samples(self) -> int:
        """Samples along a side."""
        return int(self.heights_km.shape[-1])

    @property
    def half_width_km(self) -> FloatArray:
        """Half the side of each maplet (n,), from its middle sample to its last."""
        return np.asarray(0.5 * (self.samples - 1) * self.scale_km)

    @property
    def place_covariance_km2(self) -> FloatArray:
        """Covariances of the places (n, 3, 3), body-fixed."""
        scaled = self.axes * self.sigma_km[:, :, None]
        return np.asarray(np.swapaxes(scaled, 1, 2) @ scaled)

    def take(self, rows: ArrayLike | slice) -> "Maplets":
        """Return some of them, by index, mask or slice."""
        chosen: Any = rows if isinstance(rows, slice) else np.asarray(rows)
        arrays = {field: getattr(self, field)[chosen] for field in ARRAYS}
        return Maplets(self.body, **arrays, source=self.source)

    def points_km(self) -> FloatArray:
        """Return the body-fixed places of all samples (n, m, m, 3); nan where the height is not known."""
        step = np.arange(self.samples) - 0.5 * (self.samples - 1)
        along = step[None, :, None] * self.scale_km[:, None, None]
        east, north, up = (self.axes[:, k, None, None, :] for k in range(3))
        return np.asarray(
            self.place_km[:, None, None, :]
            + along[:, None, :] * east
            + along[:, :, None] * north
            + self.heights_km[..., None] * up
        )

    def write(self, path: str | PathLike[str]) -> Path:
        """Write them, whole or not at all; return the path.

        Raises
        ------
        SessionError
            The file cannot be written; an older one is unchanged.
        """
        arrays = {field: getattr(self, field) for field in ARRAYS}
        arrays |= {field: arrays[field].astype(np.float32) for field in STORED_SINGLE}
        head = {FORMAT_KEY: np.array(PRESENT_VERSION[KIND]), "kind": np.array(KIND)}
        head |= {"body": np.array(self.body), "source": np.array(self.source)}
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **head, **arrays)
        return Path(path)

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Self:
        """Read maplets that `write` wrote.

        Raises
        ------
        MissionError
            The file is missing or damaged, or holds something else.
        """
        advice = "make one with opnav landmarks make"
        try:
            content = read_npz(path)
        except OSError as error:
            raise MissionError(
                f"maplets {path} cannot be read: {error.strerror or error}; {advice}."
            ) from error
        except NpzDamage as error:
            raise MissionError(f"maplets {path} cannot be read ({error}); {advice}.") from error
        missing = [name for name in ("kind", "body", *ARRAYS) if name not in content]
        if missing or str(content["kind"]) != KIND:
            raise MissionError(f"{path} holds no maplets (without {', '.join(missing) or KIND}); {advice}.")
        version = content.get(FORMAT_KEY)
        as_of_today(
            KIND, {} if version is None else {FORMAT_KEY: version.tolist()}, f"maplets {path}", MissionError
        )
        try:
            arrays = {field: content[field] for field in ARRAYS}
            return cls(str(content["body"]), **arrays, source=str(content.get("source", "")))
        except (MissionError, ValueError, TypeError) as error:
            raise MissionError(f"{path}: {error}") from error
