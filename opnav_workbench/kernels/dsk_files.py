"""Shape models as SPICE kernels: DSK files of type 2 (triangular plates), written and read.

Source: NAIF, DSK Required Reading.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import spiceypy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.calls import spice_call
from opnav_workbench.kernels.files import kernel_file
from opnav_workbench.kernels.pool import loaded_files
from opnav_workbench.kernels.shape_files import checked_shape
from opnav_workbench.kernels.states import body_id
from opnav_workbench.kernels.writing import new_das, require_frame
from opnav_workbench.paths import is_file

__all__ = ["is_dsk", "read_dsk", "shape_file_of", "write_dsk"]

DSK_WORD = b"DAS/DSK"
LATITUDINAL = 1  # coordinate system of the coverage
GENERAL_SURFACE = 2  # data class: not known to be single-valued in longitude and latitude
PLATE_TYPE = 2
ALL_TIME_S = 1e11  # three thousand years to both sides of J2000
FINE_VOXEL_PLATES = 1.0  # side of a fine voxel in mean plate sizes; SPICE's rays are quickest there
MOST_COARSE_VOXELS = 40  # along an axis: SPICE allows 100 000 in all
# Room for the voxel tables: grown until they fit.
ROOM_GROWTH = (1, 4, 16, 64)


def write_dsk(
    path: str | os.PathLike[str],
    vertices_km: ArrayLike,
    plates: ArrayLike,
    body_id: int,
    frame: str,
    surface_id: int = 1,
    comment: str = "",
) -> None:
    """Write a closed shape as a DSK file, and read it back.

    Parameters
    ----------
    path : path-like
        An older file of that name is replaced once the new one is whole.
    vertices_km : (n, 3) array_like
        In `frame`, from the body's center.
    plates : (m, 3) array_like of int
        Rows of `vertices_km`, 0-based, counterclockwise from outside.
    body_id
        NAIF id of the body, such as 2101955.
    frame
        Body-fixed frame centered on the body, such as IAU_BENNU.
    comment
        Goes into the file's comment area: where the numbers come from.

    Raises
    ------
    KernelError
        The shape is empty, refers to missing vertices or has no extent; the frame is unknown to SPICE; the folder
        cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "tetrahedron.bds")
    ...     write_dsk(file, corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], 999, "IAU_PLUTO")
    ...     read_dsk(file)[1].tolist()
    [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    """
    vertices, index = checked_shape(vertices_km, plates, f"shape for {Path(path).name}")
    require_frame(frame)
    one_based = np.ascontiguousarray(index + 1, dtype=np.int32)
    with new_das(path, spiceypy.dskopn, lambda handle: spiceypy.dskcls(handle, True), comment) as handle:
        doubles, integers = _spatial_index(vertices, one_based)
        parameters = np.zeros(10)
        low, high = spiceypy.dskrb2(vertices, one_based, LATITUDINAL, parameters)
        spiceypy.dskw02(
            handle, body_id, surface_id, GENERAL_SURFACE, frame, LATITUDINAL, parameters,
            -np.pi, np.pi, -0.5 * np.pi, 0.5 * np.pi, low, high, -ALL_TIME_S, ALL_TIME_S,
            vertices, one_based, doubles, integers,
        )  # fmt: skip
    back = read_dsk(path)
    if not (np.array_equal(back[0], vertices) and np.array_equal(back[1], index)):
        raise KernelError(f"{path}: what SPICE reads back differs from the shape; the file is not usable.")


def is_dsk(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file is a DSK: by its content, which is tried out first, or by its name where it cannot be read.

    Raises
    ------
    KernelError
        It is a DSK that is damaged.
    """
    if not is_file(path):  # a pipe would block
        return str(path).lower().endswith((".bds", ".dsk"))
    try:
        with Path(path).open("rb") as stream:
            begins = stream.read(len(DSK_WORD)) == DSK_WORD
    except OSError:
        return str(path).lower().endswith((".bds", ".dsk"))
    return begins and kernel_file(Path(path)).kind == "DSK"


def read_dsk(path: str | os.PathLike[str]) -> tuple[FloatArray, IntArray]:
    """Return the vertices (n, 3), km, and plates (m, 3), 0-based, of all segments of a DSK file.

    Raises
    ------
    KernelError
        The file cannot be read, or has a segment of another type than 2.
    """
    if not is_file(path):
        raise KernelError(f"shape {path}: no such file; give a DSK (.bds) file.")
    vertices: list[FloatArray] = []
    plates: list[IntArray] = []
    known = 0
    with spice_call(f"reading {path}"):
        handle = spiceypy.dasopr(str(path))
        try:
            for segment in dla_segments(handle):
                points, index = _segment(handle, segment, path)
                vertices.append(points)
                plates.append(index + known)
                known += len(points)
        finally:
            spiceypy.dascls(handle)
    if not vertices:
        raise KernelError(f"shape {path} holds no segment; give a DSK file of type 2.")
    return np.concatenate(vertices), np.concatenate(plates)


def shape_file_of(body: str | int) -> Path | None:
    """Return the DSK among the loaded kernels that holds a body's shape, the last loaded; None without one.

    Raises
    ------
    KernelError
        Nobody knows the body, or a DSK cannot be read.
    """
    number = body_id(body)
    with spice_call("reading shapes of bodies"):
        shapes = [file.path for file in loaded_files() if file.kind == "DSK"]
        return next((p for p in reversed(shapes) if number in set(spiceypy.dskobj(str(p)))), None)


def dla_segments(handle: int) -> Iterator[Any]:
    """Yield the segments of a DSK open for reading; lock held."""
    try:
        segment = spiceypy.dlabfs(handle)
        while True:
            yield segment
            segment = spiceypy.dlafns(handle, segment)
    except spiceypy.NotFoundError:
        return


def _segment(handle: int, segment: Any, path: str | os.PathLike[str]) -> tuple[FloatArray, IntArray]:
    kind = spiceypy.dskgd(handle, segment).dtype
    if kind != PLATE_TYPE:
        raise KernelError(f"shape {path}: a segment of DSK type {kind}; type 2 (plates) is needed.")
    n_vertices, n_plates = spiceypy.dskz02(handle, segment)
    points = np.asarray(spiceypy.dskv02(handle, segment, 1, n_vertices), dtype=np.float64)
    index = np.asarray(spiceypy.dskp02(handle, segment, 1, n_plates), dtype=np.int64)
    return points, index - 1


def _spatial_index(vertices: FloatArray, one_based: Any) -> tuple[Any, Any]:
    """Return SPICE's voxel tables, which its ray casting searches."""
    extent = np.ptp(vertices, axis=0).max()
    plate = np.ptp(vertices[one_based - 1], axis=1).max(axis=1).mean()
    if not plate > 0.0:
        raise KernelError("the shape has no extent; check its vertices and their unit.")
    fine = extent / (FINE_VOXEL_PLATES * plate)
    coarse = max(1, int(np.ceil(fine / MOST_COARSE_VOXELS)))
    tables = 20_000 + 40 * len(one_based)
    for growth in ROOM_GROWTH:
        room = growth * tables
        try:
            doubles, integers = spiceypy.dskmi2(
                vertices, one_based, FINE_VOXEL_PLATES, coarse, room, room, room, False,
                2 * room + len(vertices) + 100_010,
            )  # fmt: skip
        except spiceypy.SpiceyError:
            spiceypy.reset()
            if growth == ROOM_GROWTH[-1]:
                raise
        else:
            return doubles, integers
    raise AssertionError("unreachable")
