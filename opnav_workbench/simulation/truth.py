"""What a simulated picture really shows: three files beside the picture, none of which a flight reader looks at.

``NAME.truth.json``   attitudes, centers of bodies, seed, settings, numbers of the detector
``NAME.truth.ecsv``   a row for every star and body: place, light, trail, whether it is hidden
``NAME.truth.fits``   the scene's electrons without noise, and the cosmic rays
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.io import fits
from astropy.table import QTable, vstack
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, json_value, text_of, write_json
from opnav_workbench.geometry import quaternion_from_matrix
from opnav_workbench.simulation.charge import CosmicRayHits
from opnav_workbench.simulation.picture import Trails

__all__ = [
    "BodyTruth",
    "Truth",
    "body_rows",
    "objects_from_ecsv",
    "read_truth",
    "star_rows",
    "truth_from_values",
    "truth_paths",
    "truth_table",
    "write_truth",
]


# ---- The table of what a picture shows.

# Every column of the table: unit and description, in the order of the file.
TRUTH_COLUMNS: dict[str, tuple[Any, str]] = {
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
    center_px : (2,) array
        Center of figure at mid-exposure.
    light_px : (2,) array
        Center of its light over the exposure; nan where none reaches the detector.
    mag
        nan where it is not known.
    occulted_fraction
        Part of its light that other bodies hide.
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
    return _truth_rows(
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
    return _truth_rows(
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


def _truth_rows(**columns: Any) -> QTable:
    table = QTable()
    for name, (unit, text) in TRUTH_COLUMNS.items():
        values = columns[name]
        table[name] = values if unit is None else np.asarray(values, dtype=np.float64) * unit
        table[name].info.description = text
    return table


# ---- What a simulated picture really shows.

# Of a truth, as they stand in its file and in a sealed one.
PLAIN_FIELDS = ("mission", "camera", "utc", "et", "exposure_s", "seed", "settings", "exposure")
ATTITUDE_FIELDS = ("camera_from_j2000", "predicted_camera_from_j2000")
SUFFIXES = (".truth.json", ".truth.ecsv", ".truth.fits")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a simulated picture really shows.

    Attributes
    ----------
    mission, camera, utc
        Names, and mid-exposure.
    camera_from_j2000 : (3, 3) array
        True attitude at mid-exposure.
    predicted_camera_from_j2000 : (3, 3) array
        What the header says.
    objects
        See `truth_table`.
    settings
        What made the picture, as plain values: effects, attitude, perturbations.
    exposure
        What the detector did: `Exposure.summary`.
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
    def n_stars(self) -> int:
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
        _truth_image(truth).writeto(temporary, overwrite=True)
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
        "stars_on_detector": truth.n_stars,
        "seed": truth.seed,
        "settings": truth.settings,
        "exposure": truth.exposure,
        "objects": truth_paths(truth.picture)[1].name,
        "noiseless_electrons": truth_paths(truth.picture)[2].name,
    }


def _truth_image(truth: Truth) -> Any:
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
        values = json_value(text_of(description))
        objects = objects_from_ecsv(table)
        with fits.open(image, memmap=False) as hdus:
            light = None if hdus[0].data is None else hdus[0].data.astype(np.float64)
            hits = _hits_from_rows(hdus["COSMIC RAYS"].data)
        return truth_from_values(description.with_name(values["picture"]), values, objects, light, hits)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SessionError(
            f"truth of {Path(path).name} cannot be read ({type(error).__name__}: {error}); it needs "
            f"{description.name}, {table.name} and {image.name} in one folder."
        ) from error


def objects_from_ecsv(source: Path | list[str]) -> QTable:
    """Return the table of what a picture shows from a file, or from its lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return QTable.read(source, format="ascii.ecsv")


def _hits_from_rows(rows: Any) -> CosmicRayHits:
    start, end = (
        np.stack([rows[f"{which}_PIXEL"], rows[f"{which}_LINE"]], axis=-1).astype(np.float64)
        for which in ("START", "END")
    )
    return CosmicRayHits(start, end, rows["ELECTRONS"].astype(np.float64))


def truth_from_values(
    picture: Path, values: Mapping[str, Any], objects: QTable, light: FloatArray | None, hits: CosmicRayHits
) -> Truth:
    """Return a truth from its plain values and arrays."""
    matrices: dict[str, Any] = {name: np.array(values[name], dtype=np.float64) for name in ATTITUDE_FIELDS}
    return Truth(
        picture=picture,
        objects=objects,
        cosmic_rays=hits,
        noiseless_electrons=light,
        **matrices,
        **{name: values[name] for name in PLAIN_FIELDS},
    )
