"""What a simulated picture really shows: three files beside the picture, none of which a flight reader looks at.

``NAME.truth.json``   attitudes, centers of bodies, seed, settings, numbers of the detector
``NAME.truth.ecsv``   a row for every star and body: place, light, trail, whether it is hidden
``NAME.truth.fits``   the scene's electrons without noise, and the cosmic rays
"""

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from astropy.table import QTable

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, write_json
from opnav_workbench.geometry import quaternion_from_matrix
from opnav_workbench.simulation.cosmic_rays import CosmicRayHits
from opnav_workbench.simulation.truth_table import BodyTruth, body_rows, star_rows, truth_table

__all__ = [
    "BodyTruth",
    "Truth",
    "body_rows",
    "read_truth",
    "star_rows",
    "truth_paths",
    "truth_table",
    "write_truth",
]

SUFFIXES = (".truth.json", ".truth.ecsv", ".truth.fits")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a simulated picture really shows.

    Attributes
    ----------
    picture : Path
    mission, camera, utc : str
        Names, and mid-exposure.
    et, exposure_s : float
    camera_from_j2000 : (3, 3) array
        True attitude at mid-exposure.
    predicted_camera_from_j2000 : (3, 3) array
        What the header says.
    objects : QTable
        See `truth_table`.
    seed : int
    settings : mapping
        What made the picture, as plain values: effects, attitude, perturbations.
    exposure : mapping
        What the detector did: `Exposed.summary`.
    cosmic_rays : CosmicRayHits
    noiseless_electrons : (n_line, n_pixel) array or None
        None where it was not asked for.
    """

    picture: Path
    mission: str
    camera: str
    utc: str
    et: float
    exposure_s: float
    camera_from_j2000: FloatArray
    predicted_camera_from_j2000: FloatArray
    objects: QTable
    seed: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    exposure: Mapping[str, Any] = field(default_factory=dict)
    cosmic_rays: CosmicRayHits = field(default_factory=CosmicRayHits.none)
    noiseless_electrons: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def bodies(self) -> dict[str, FloatArray]:
        """True centers of figure (2,), px, by name."""
        rows = self.objects[self.objects["kind"] == "body"]
        centers = np.stack([rows["pixel"].value, rows["line"].value], axis=-1)
        return {str(name): center for name, center in zip(rows["id"], centers, strict=True)}

    @property
    def stars(self) -> int:
        """Number of stars on the detector."""
        return int(np.sum((self.objects["kind"] == "star") & self.objects["on_detector"]))


def write_truth(truth: Truth) -> tuple[Path, Path, Path]:
    """Write the truth beside its picture; return the JSON, ECSV and FITS files.

    Raises
    ------
    SessionError
        A file cannot be written.
    """
    description, table, image = truth_paths(truth.picture)
    with atomic_path(image) as temporary:
        _fits(truth).writeto(temporary, overwrite=True)
    with atomic_path(table) as temporary:
        truth.objects.write(temporary, format="ascii.ecsv", overwrite=True)
    write_json(description, _description(truth))
    return description, table, image


def truth_paths(picture: str | PathLike[str]) -> tuple[Path, Path, Path]:
    """Return the truth files (JSON, ECSV, FITS) of a picture, or of any of them."""
    path = Path(picture)
    stem = path.name.split(".truth.")[0] if ".truth." in path.name else path.stem
    json_, ecsv, fits_ = (path.with_name(stem + suffix) for suffix in SUFFIXES)
    return json_, ecsv, fits_


def _description(truth: Truth) -> dict[str, Any]:
    return {
        "picture": truth.picture.name,
        "mission": truth.mission,
        "camera": truth.camera,
        "utc": truth.utc,
        "et": truth.et,
        "exposure_s": truth.exposure_s,
        "camera_from_j2000": truth.camera_from_j2000,
        "quaternion_camera_from_j2000": quaternion_from_matrix(truth.camera_from_j2000),
        "predicted_camera_from_j2000": truth.predicted_camera_from_j2000,
        "predicted_quaternion_camera_from_j2000": quaternion_from_matrix(truth.predicted_camera_from_j2000),
        "bodies": truth.bodies,
        "stars_on_detector": truth.stars,
        "seed": truth.seed,
        "settings": truth.settings,
        "exposure": truth.exposure,
        "objects": truth_paths(truth.picture)[1].name,
        "noiseless_electrons": truth_paths(truth.picture)[2].name,
    }


def _fits(truth: Truth) -> Any:
    light = truth.noiseless_electrons
    # 32 bits hold every electron count to 6e-8 of itself, far below its noise.
    primary = fits.PrimaryHDU(None if light is None else light.astype(np.float32))
    primary.header["BUNIT"] = ("electron", "Scene without noise or detector effects")
    hits = truth.cosmic_rays
    columns = [
        fits.Column(name, "D", unit=unit, array=array)
        for name, unit, array in (
            ("START_PIXEL", "pixel", hits.start_px[:, 0]),
            ("START_LINE", "pixel", hits.start_px[:, 1]),
            ("END_PIXEL", "pixel", hits.end_px[:, 0]),
            ("END_LINE", "pixel", hits.end_px[:, 1]),
            ("ELECTRONS", "electron", hits.electrons),
        )
    ]
    return fits.HDUList([primary, fits.BinTableHDU.from_columns(columns, name="COSMIC RAYS")])


def read_truth(path: str | PathLike[str]) -> Truth:
    """Read the truth of a picture.

    Parameters
    ----------
    path : path-like
        The picture, or one of its truth files.

    Raises
    ------
    SessionError
        A file is missing or damaged.
    """
    description, table, image = truth_paths(path)
    try:
        values = json.loads(description.read_text(encoding="utf-8"))
        objects = _read_table(table)
        with fits.open(image, memmap=False) as hdus:
            light = None if hdus[0].data is None else hdus[0].data.astype(np.float64)
            hits = _hits(hdus["COSMIC RAYS"].data)
        return _truth(description.with_name(values["picture"]), values, objects, light, hits)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SessionError(
            f"truth of {Path(path).name} cannot be read ({type(error).__name__}: {error}); it needs "
            f"{description.name}, {table.name} and {image.name} in one folder."
        ) from error


def _read_table(path: Path) -> QTable:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return QTable.read(path, format="ascii.ecsv")


def _hits(rows: Any) -> CosmicRayHits:
    start, end = (
        np.stack([rows[f"{which}_PIXEL"], rows[f"{which}_LINE"]], axis=-1).astype(np.float64)
        for which in ("START", "END")
    )
    return CosmicRayHits(start, end, rows["ELECTRONS"].astype(np.float64))


def _truth(
    picture: Path, values: Mapping[str, Any], objects: QTable, light: FloatArray | None, hits: CosmicRayHits
) -> Truth:
    plain = ("mission", "camera", "utc", "et", "exposure_s", "seed", "settings", "exposure")
    return Truth(
        picture=picture,
        camera_from_j2000=np.array(values["camera_from_j2000"], dtype=np.float64),
        predicted_camera_from_j2000=np.array(values["predicted_camera_from_j2000"], dtype=np.float64),
        objects=objects,
        cosmic_rays=hits,
        noiseless_electrons=light,
        **{name: values[name] for name in plain},
    )
