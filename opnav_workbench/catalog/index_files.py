"""Index files of Astrometry.net: the directions of their stars and the columns beside them.

An index file is a FITS file. Its star tree stores unit vectors as opaque bytes in the byte order that the
header card ENDIAN tells: the table ``kdtree_data_stars`` has n rows of three numbers, and
``kdtree_range_stars`` seven doubles: lower corner (3), upper corner (3) and the number of tree units per
data unit. Integer rows decode as ``lower + row / scale``; ``KDT_DATA`` names the type (double, float, u32,
u16). The FITS table of AN_FILE 'TAGALONG' has one row a star, in the order of the tree.

Source: the file headers themselves (program build-astrometry-index).
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog.priors import RAD_PER_MAS
from opnav_workbench.errors import CatalogError

__all__ = ["read_index"]

TREE_TYPES = {"double": "f8", "float": "f4", "u32": "u4", "u16": "u2"}
BYTE_ORDERS = {"04:03:02:01": "<", "01:02:03:04": ">"}
UNIT_TOLERANCE = 1e-3  # a direction decoded from 16 bit integers has a length within 3e-5 of one
RANGE_DOUBLES = 7

Header = Mapping[str, Any]


def read_index(file: Path) -> tuple[FloatArray, float, dict[str, NDArray[Any]]]:
    """Return unit vectors (n, 3), the step of their storage in mas, and the columns beside them by name.

    Raises
    ------
    CatalogError
        The file is no whole index file.
    """
    try:
        with warnings.catch_warnings(), fits.open(file, memmap=True) as hdus:
            warnings.simplefilter("ignore")  # a shortened file warns first and is refused below
            tables = {hdu.header.get("TTYPE1", hdu.name): hdu for hdu in hdus[1:]}
            tags = [hdu for hdu in hdus[1:] if hdu.header.get("AN_FILE") == "TAGALONG"]
            xyz, quantum_mas = _directions(file, hdus[0].header, tables)
            columns = {} if not tags else {c.name: np.asarray(tags[0].data[c.name]) for c in tags[0].columns}
    except (OSError, TypeError, ValueError, KeyError, IndexError) as error:
        reason = " ".join(str(error).split())
        raise CatalogError(
            f"{file} is not a whole Astrometry.net index file ({reason}); copy it again or narrow the glob."
        ) from error
    return xyz, quantum_mas, columns


def _directions(file: Path, primary: Header, tables: Mapping[str, Any]) -> tuple[FloatArray, float]:
    """Return the stars' unit vectors (n, 3) and the step of their storage in mas."""
    data, limits = tables["kdtree_data_stars"], tables["kdtree_range_stars"]
    tree = tables["kdtree_header_stars"].header if "kdtree_header_stars" in tables else {}
    order = BYTE_ORDERS[str(tree.get("ENDIAN", primary.get("ENDIAN", "04:03:02:01"))).strip()]
    kind = str(tree.get("KDT_DATA", "")).strip() or {24: "double", 12: "u32", 6: "u16"}[data.header["NAXIS1"]]
    rows = _bytes_as(file, data, order + TREE_TYPES[kind]).reshape(-1, 3)
    box = _bytes_as(file, limits, order + "f8")
    if box.size != RANGE_DOUBLES:
        raise ValueError(f"kdtree_range_stars holds {box.size} numbers, not {RANGE_DOUBLES}")
    integers = rows.dtype.kind == "u"
    xyz = box[:3] + rows / box[6] if integers else rows.astype(np.float64)
    length = np.linalg.norm(xyz, axis=1)
    if not np.all(np.abs(length - 1.0) < UNIT_TOLERANCE):
        raise ValueError(
            f"its star vectors have lengths from {length.min():.4g} to {length.max():.4g}, not 1"
        )
    step = 1.0 / float(box[6]) if integers else float(np.finfo(rows.dtype).eps)
    return xyz / length[:, None], step / RAD_PER_MAS


def _bytes_as(file: Path, hdu: Any, dtype: str) -> NDArray[Any]:
    """Return the bytes of a one-column table as numbers; astropy would take them for text."""
    size = int(hdu.header["NAXIS1"]) * int(hdu.header["NAXIS2"])
    with file.open("rb") as stream:
        stream.seek(hdu.fileinfo()["datLoc"])
        content = stream.read(size)
    if len(content) != size or size == 0:
        raise ValueError(f"{hdu.header['TTYPE1']} has {len(content)} of {size} bytes")
    return np.frombuffer(content, dtype=dtype)
