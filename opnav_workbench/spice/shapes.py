"""Shape files: Wavefront OBJ and Celestia cmod (text and binary) as vertices and triangular plates.

Sources: Wavefront, "Object files (.obj)", appendix B1 of the Advanced Visualizer manual; Celestia wiki, "CMOD File" and
"Binary CMOD specification" (A. Tribick). An OBJ file counts as body-fixed as it stands. Celestia turns bodies about its
+y axis and counts longitude from -x, so that a cmod point (x, y, z) is (-x, z, y) in the body-fixed frame. (Bennu's laser
shape in cmod, taken so, lies on its radar shape in OBJ.)
"""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.errors import KernelError
from opnav_workbench.spice.cmod import CMOD_HEADERS, read_cmod

__all__ = ["UNIT_KM", "checked_shape", "read_shape"]

UNIT_KM = {"km": 1.0, "m": 1e-3, "cm": 1e-5}
SUFFIXES = ".obj and .cmod"


def read_shape(path: str | os.PathLike[str], unit: str = "km") -> tuple[FloatArray, IntArray]:
    r"""Read a shape model.

    Parameters
    ----------
    path : path-like
        An ``.obj`` or ``.cmod`` file; polygons with more than three corners are cut into triangles.
    unit : {"km", "m", "cm"}
        Unit of the file's coordinates; neither format says.

    Returns
    -------
    vertices_km : (n, 3) array
        Body-fixed.
    plates : (m, 3) array of int
        Rows of `vertices_km`, 0-based.

    Raises
    ------
    KernelError
        The file cannot be read or parsed, is empty, or has plates that refer to vertices which are not there.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "tetrahedron.obj")
    ...     text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    ...     _ = file.write_text(text)
    ...     vertices, plates = read_shape(file, "m")
    >>> float(vertices.max()), plates[0].tolist()
    (0.001, [0, 2, 1])
    """
    if unit not in UNIT_KM:
        raise KernelError(f"shape {path}: unit {unit!r} is unknown; use {', '.join(UNIT_KM)}.")
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise KernelError(
            f"shape {path} cannot be read: {error.strerror or error}; give {SUFFIXES} files."
        ) from error
    try:
        vertices, plates = _parsed(content, Path(path).suffix.lower())
    except (ValueError, IndexError) as error:
        raise KernelError(f"shape {path}: {error}; give a whole {SUFFIXES} file.") from error
    return checked_shape(vertices * UNIT_KM[unit], plates, f"shape {path}")


def checked_shape(vertices_km: ArrayLike, plates: ArrayLike, what: str) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3) and plates (m, 3) as arrays that fit together.

    Raises
    ------
    KernelError
        Empty, of another shape, not finite, or plates that refer to vertices which are not there.
    """
    try:
        vertices, index = np.array(vertices_km, dtype=np.float64, order="C"), np.asarray(plates)
    except (TypeError, ValueError) as error:
        raise KernelError(f"{what}: {error}; give (n, 3) vertices and (m, 3) plates.") from error
    if vertices.size == 0 or index.size == 0:
        raise KernelError(
            f"{what} is empty ({len(vertices)} vertices, {len(index)} plates); a body needs four plates at least."
        )
    if vertices.ndim != 2 or index.ndim != 2 or vertices.shape[1] != 3 or index.shape[1] != 3:
        raise KernelError(
            f"{what}: vertices {vertices.shape} and plates {index.shape}; (n, 3) and (m, 3) are needed."
        )
    if not np.isfinite(vertices).all():
        raise KernelError(f"{what}: vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} is not finite.")
    if index.dtype.kind not in "iu":
        raise KernelError(f"{what}: plates are {index.dtype}; whole numbers are needed.")
    wrong = np.flatnonzero(((index < 0) | (index >= len(vertices))).any(axis=1))
    if len(wrong):
        raise KernelError(
            f"{what}: plate {int(wrong[0])} refers to vertices {index[wrong[0]].tolist()}, but they go from 0 to "
            f"{len(vertices) - 1} ({len(wrong)} such plates); the file is damaged."
        )
    return vertices, np.array(index, dtype=np.int64, order="C")


def _parsed(content: bytes, suffix: str) -> tuple[FloatArray, IntArray]:
    if content.startswith(CMOD_HEADERS):
        vertices, plates = read_cmod(content)
        return vertices[:, [0, 2, 1]] * np.array([-1.0, 1.0, 1.0]), plates
    if suffix == ".obj":
        return _read_obj(content.decode("utf-8", errors="replace"))
    raise ValueError(f"neither an OBJ file nor a cmod file (it begins with {content[:16]!r})")


def _read_obj(text: str) -> tuple[FloatArray, IntArray]:
    vertices: list[tuple[float, float, float]] = []
    plates: list[tuple[int, int, int]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        try:
            if words and words[0] == "v":
                vertices.append((float(words[1]), float(words[2]), float(words[3])))
            elif words and words[0] == "f":
                plates.extend(_obj_face(words[1:], len(vertices)))
        except (ValueError, IndexError) as error:
            raise ValueError(f"line {number}, {line.strip()[:40]!r}: {error}") from error
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(plates, dtype=np.int64).reshape(
        -1, 3
    )


def _obj_face(words: list[str], known: int) -> list[tuple[int, int, int]]:
    """Return the triangles of a face; OBJ counts vertices from 1, or back from the latest with negative numbers."""
    given = [int(word.split("/", 1)[0]) for word in words]
    if len(given) < 3:
        raise ValueError("a face needs three corners")
    if 0 in given:
        raise ValueError("vertex 0 does not exist: OBJ counts from 1")
    corner = [n - 1 if n > 0 else known + n for n in given]
    return [(corner[0], corner[k], corner[k + 1]) for k in range(1, len(corner) - 1)]
