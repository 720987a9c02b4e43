"""FITS files as the mission writes them, so that flight readers take a simulated picture for one of their own.

Beside the picture stand its error plane and its quality plane, in the codes of the mission's own table.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path
from opnav_workbench.image import KeywordMap
from opnav_workbench.mission import Mission
from opnav_workbench.simulation.detector import Exposure
from opnav_workbench.simulation.flight_header import FlightRecord, flight_cards, wcs_cards

__all__ = ["QUALITY_CODES", "dark_columns_of", "write_flight_fits"]


# ---- The quality plane of a simulated picture, in the codes of the mission's own table.


@dataclass(frozen=True, slots=True)
class QualityCodes:
    """What a pipeline writes for a pixel that is saturated, lost or defective."""

    saturated: int
    lost: int
    defective: int


# For each table of `opnav_workbench.image.masks.QUALITY_TABLES`. Where every set bit means "bad", saturation is left to
# the picture's level: a bright star's core is a lower bound, not a bad pixel.
QUALITY_CODES: Mapping[str, QualityCodes] = MappingProxyType(
    {
        "any_nonzero": QualityCodes(saturated=0, lost=1, defective=2),
        "new_horizons_lorri": QualityCodes(saturated=16, lost=32, defective=32),
        "new_horizons_mvic": QualityCodes(saturated=8, lost=-1, defective=4),
    }
)


def quality_plane(exposure: Exposure, table: str, housekeeping_pixels: int = 0) -> NDArray[np.int16]:
    """Return the quality codes (n_line, n_pixel) of a picture.

    Parameters
    ----------
    table
        Name of the mission's table.
    housekeeping_pixels
        Pixels at the start of line 0 that carry telemetry.
    """
    codes = QUALITY_CODES[table]
    plane = np.where(exposure.saturated, codes.saturated, 0)
    if exposure.flag_defects:
        plane = np.where(exposure.defective, plane | codes.defective, plane)
    lost = exposure.lost.copy()
    lost[0, :housekeeping_pixels] = True
    return np.where(lost, codes.lost, plane).astype(np.int16)


# ---- FITS files as the mission writes them.

LARGEST_RAW = 65535  # what 16 bits hold


def dark_columns_of(mission: Mission, camera: Camera) -> int:
    """Return how many covered columns a raw picture of a camera has at its right end.

    Examples
    --------
    >>> from opnav_workbench.mission import load_mission
    >>> mission = load_mission("new_horizons")
    >>> dark_columns_of(
    ...     mission, mission.camera_for({"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"})
    ... )
    4
    """
    columns = KeywordMap(**mission.keywords).dark_columns
    return next((k for width, k in columns.items() if width - k == camera.n_pixel), 0)


def write_flight_fits(path: str | PathLike[str], exposure: Exposure, record: FlightRecord) -> Path:
    """Write a picture as the mission would have: header, picture, and the error and quality planes that it names.

    Calibrated pictures are 32-bit floating point; raw ones whole numbers of 16 bits, with their dark columns if the
    exposure has any, and without an error plane.

    Parameters
    ----------
    path : path-like
    record
        The predicted attitude goes into the header, never the true one.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissionError
        A card that FITS cannot hold, or a raw value beyond 16 bits.
    SessionError
        The file cannot be written; nothing is left behind.
    """
    names = KeywordMap(**record.mission.keywords)
    hdus = fits.HDUList([fits.PrimaryHDU(_pixels(exposure))])
    _fill(hdus[0].header, exposure, record)
    quality = quality_plane(exposure, names.quality_table, names.housekeeping_pixels)
    planes: list[tuple[Any, NDArray[Any]]] = [(names.quality_extension, _unsigned(_wide(quality, exposure)))]
    if exposure.level == "calibrated":
        planes.insert(0, (names.error_extension, exposure.error_dn.astype(np.float32)))
    for name, plane in planes:
        if isinstance(name, str):
            hdus.append(fits.ImageHDU(plane))
            hdus[-1].header["EXTNAME"] = name  # as an argument it would be turned into capitals
    final = Path(path)
    with atomic_path(final) as temporary:
        hdus.writeto(temporary, overwrite=True)
    return final


def _pixels(exposure: Exposure) -> NDArray[Any]:
    if exposure.level == "calibrated":
        return exposure.image_dn.astype(np.float32)
    raw = np.hstack([exposure.image_dn, exposure.dark_columns_dn])
    if raw.min() < 0.0 or raw.max() > LARGEST_RAW:
        raise MissionError(
            f"raw values {raw.min():g}..{raw.max():g} DN do not fit 16 bits; switch the converter (adc) on and give "
            "its bits and a bias."
        )
    return np.rint(raw).astype(np.uint16)


def _wide(quality: NDArray[np.int16], exposure: Exposure) -> NDArray[np.int16]:
    """Add the dark columns of a raw picture, all good."""
    dark = exposure.dark_columns_dn.shape[1] if exposure.level == "raw" else 0
    return np.pad(quality, ((0, 0), (0, dark)))


def _unsigned(quality: NDArray[np.int16]) -> NDArray[Any]:
    """Return the plane as flight files have it: unsigned, unless the mission's codes are negative."""
    return quality if quality.min() < 0 else quality.astype(np.uint16)


def _fill(header: Any, exposure: Exposure, record: FlightRecord) -> None:
    cards = [
        (card.keyword, card.value, card.comment)
        for card in flight_cards(record, exposure.values, exposure.level)
    ]
    cards += [(k, v, "") for k, v in wcs_cards(record.camera, record.camera_from_j2000).items()]
    for keyword, value, comment in cards:
        long_ = len(keyword) > 8
        try:
            header[f"HIERARCH {keyword}" if long_ else keyword] = (value, comment)
        except (ValueError, TypeError) as error:
            raise MissionError(f"header card {keyword} = {value!r} cannot stand in FITS: {error}.") from error
