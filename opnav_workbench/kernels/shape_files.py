"""Shape files: Wavefront OBJ, Celestia cmod (text and binary), PLT, VER and ICQ tables as vertices and triangular plates.

An OBJ file counts as body-fixed as it stands. A cmod file is a header, materials and meshes; a mesh is a description of
its vertices (each attribute's meaning and format), the vertices, and groups of indices that form triangles, lines or
points; only positions and triangles are taken. Celestia turns bodies about its +y axis and counts longitude from -x,
so that a cmod point (x, y, z) is (-x, z, y) in the body-fixed frame. (Bennu's laser shape in cmod, taken so, lies on its
radar shape in OBJ.)

PLT and VER tables are numbered vertices and plates (rows of four numbers), or a count of both, bare vertices, and plates
led by their number of corners; ICQ ("implicitly connected quadrilaterals") has the vertices of six faces of a cube, whose
squares are cut along the shorter diagonal. All count as body-fixed; a table is told by its numbers, not by its name.

Sources: Wavefront, "Object files (.obj)", appendix B1 of the Advanced Visualizer manual; Celestia wiki, "CMOD File" and
"Binary CMOD specification" (A. Tribick); NAIF, MKDSK User's Guide (plate formats 1, 2 and 4); Gaskell et al. (2008),
doi 10.1111/j.1945-5100.2008.tb00692.x, and the PDS Small Bodies Node's description of its ICQ files.
"""

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.errors import KernelError
from opnav_workbench.files import decoded
from opnav_workbench.paths import regular_size

__all__ = ["SHAPE_FORMATS", "UNIT_KM", "ShapeFile", "checked_shape", "read_shape"]


# ---- Celestia's cmod format, text and binary: the corners and triangles of all its meshes.

TEXT_HEADER, BINARY_HEADER = b"#celmodel__ascii", b"#celmodel_binary"
CMOD_HEADERS = (TEXT_HEADER, BINARY_HEADER)

END_MATERIAL, MATERIAL, MESH, END_MESH, VERTEXDESC, END_VERTEXDESC, VERTICES = (
    1002, 1001, 1009, 1010, 1011, 1012, 1013,
)  # fmt: skip
NUMBER_BYTES = {1: 4, 2: 8, 3: 12, 4: 16, 6: 4, 7: 12}  # of material values, by type; 5 is a string
MATERIAL_VALUES = {1003, 1004, 1005, 1006, 1014}  # tokens followed by one typed value
TEXTURE, BLEND = 1007, 1015
STRING_TYPE = 5
POSITION = 0
FORMAT_BYTES = (4, 8, 12, 16, 4)  # f1 f2 f3 f4 ub4
FORMAT_WORDS = {"f1": 1, "f2": 2, "f3": 3, "f4": 4, "ub4": 4}
GROUPS = ("trilist", "tristrip", "trifan", "linelist", "linestrip", "points", "sprites")

Mesh = tuple[FloatArray, list[tuple[str, IntArray]]]  # vertices (n, 3), groups of indices


def read_cmod(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3) in the file's own axes and unit, and plates (m, 3).

    Raises
    ------
    ValueError
        The content is no cmod file, or is damaged.
    """
    try:
        read = _text_meshes if content.startswith(TEXT_HEADER) else _binary_meshes
        meshes = list(read(content))
    except (struct.error, StopIteration, KeyError, UnicodeDecodeError, RuntimeError) as error:
        raise ValueError(f"the cmod file ends early or is damaged ({type(error).__name__})") from error
    vertices: list[FloatArray] = [np.empty((0, 3))]
    plates: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    known = 0
    for points, groups in meshes:
        for kind, index in groups:
            plates.append(_triangles(kind, index) + known)
        vertices.append(points)
        known += len(points)
    return np.concatenate(vertices), np.concatenate(plates)


def _triangles(kind: str, index: IntArray) -> IntArray:
    if kind == "trilist":
        if len(index) % 3:
            raise ValueError(f"a trilist of {len(index)} corners; triangles need a multiple of three")
        return index.reshape(-1, 3)
    if kind not in {"tristrip", "trifan"} or len(index) < 3:
        return np.empty((0, 3), dtype=np.int64)  # lines and points have no surface
    second, third = index[1:-1], index[2:]
    if kind == "trifan":
        return np.stack([np.full(len(second), index[0]), second, third], axis=-1)
    strip = np.stack([index[:-2], second, third], axis=-1)
    strip[1::2] = strip[1::2, ::-1]  # every other triangle of a strip is wound the other way
    return strip


class _ByteReader:
    """Little-endian values, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, len(BINARY_HEADER)

    @property
    def done(self) -> bool:
        return self._at >= len(self._content)

    def short(self) -> int:
        return int(self._unpack("<h")[0])

    def word(self) -> int:
        return int(self._unpack("<I")[0])

    def take(self, count: int) -> bytes:
        if self._at + count > len(self._content):
            raise ValueError(f"it ends at byte {len(self._content)}, where {count} more bytes were announced")
        self._at += count
        return self._content[self._at - count : self._at]

    def _unpack(self, form: str) -> tuple[int, ...]:
        return struct.unpack(form, self.take(struct.calcsize(form)))


def _binary_meshes(content: bytes) -> Iterator[Mesh]:
    stream = _ByteReader(content)
    while not stream.done:
        token = stream.short()
        if token == MATERIAL:
            _skip_material(stream)
        elif token == MESH:
            yield _binary_mesh(stream)
        else:
            raise ValueError(f"token {token} where a material or mesh should begin")


def _skip_material(stream: _ByteReader) -> None:
    while (token := stream.short()) != END_MATERIAL:
        if token == BLEND:
            stream.short()
            continue
        if token == TEXTURE:
            stream.short()  # which texture
        elif token not in MATERIAL_VALUES:
            raise ValueError(f"token {token} inside a material")
        kind = stream.short()
        stream.take(stream.short() & 0xFFFF if kind == STRING_TYPE else NUMBER_BYTES[kind])


def _binary_mesh(stream: _ByteReader) -> Mesh:
    if stream.short() != VERTEXDESC:
        raise ValueError("a mesh without a description of its vertices")
    size, position = 0, -1
    while (meaning := stream.short()) != END_VERTEXDESC:
        form = stream.short()
        if not 0 <= form < len(FORMAT_BYTES):
            raise ValueError(f"vertex format {form} is unknown")
        if meaning == POSITION:
            position = size
        size += FORMAT_BYTES[form]
    if position < 0 or stream.short() != VERTICES:
        raise ValueError("a mesh without vertex positions")
    count = stream.word()
    raw = np.frombuffer(stream.take(count * size), dtype=np.uint8).reshape(count, size)
    points = np.ascontiguousarray(raw[:, position : position + 12]).view("<f4").astype(np.float64)
    groups = []
    while (kind := stream.short()) != END_MESH:
        if not 0 <= kind < len(GROUPS):
            raise ValueError(f"group of unknown kind {kind}")
        stream.word()  # material
        index = np.frombuffer(stream.take(4 * stream.word()), dtype="<u4")
        groups.append((GROUPS[kind], index.astype(np.int64)))
    return points.reshape(-1, 3), groups


def _text_meshes(content: bytes) -> Iterator[Mesh]:
    lines = content.decode("utf-8").splitlines()[1:]
    words = iter([word for line in lines for word in line.split("#", 1)[0].split()])
    for word in words:
        if word == "material":
            while next(words) != "end_material":
                pass
        elif word == "mesh":
            yield _text_mesh(words)
        else:
            raise ValueError(f"{word!r} where a material or mesh should begin")


def _text_mesh(words: Iterator[str]) -> Mesh:
    if next(words) != "vertexdesc":
        raise ValueError("a mesh without a description of its vertices")
    size, position = 0, -1
    while (meaning := next(words)) != "end_vertexdesc":
        if meaning == "position":
            position = size
        size += FORMAT_WORDS[next(words)]
    if position < 0 or next(words) != "vertices":
        raise ValueError("a mesh without vertex positions")
    count = int(next(words))
    values = np.array([float(next(words)) for _ in range(count * size)]).reshape(count, size)
    groups = []
    while (kind := next(words)) != "end_mesh":
        if kind not in GROUPS:
            raise ValueError(f"group of unknown kind {kind!r}")
        next(words)  # material
        index = [int(next(words)) for _ in range(int(next(words)))]
        groups.append((kind, np.array(index, dtype=np.int64)))
    return values[:, position : position + 3], groups


# ---- Shape files: Wavefront OBJ and Celestia cmod (text and binary) as vertices and triangular plates.

LARGEST_BYTES = 1 << 29
UNIT_KM = {"km": 1.0, "m": 1e-3, "cm": 1e-5}
SHAPE_FORMATS = (
    "OBJ (.obj), Celestia (.cmod), plate tables (.plt, .ver, .tab), Gaskell's ICQ (.icq, .txt) and DSK (.bds)"
)


@dataclass(frozen=True, slots=True)
class ShapeFile:
    """A shape file and the unit of its coordinates: km, m or cm."""

    path: Path
    unit: str = "km"


def read_shape(path: str | os.PathLike[str], unit: str = "km") -> tuple[FloatArray, IntArray]:
    r"""Read a shape model.

    Parameters
    ----------
    path : path-like
        OBJ, cmod, plate table or ICQ; polygons with more than three corners are cut into triangles.
    unit : {"km", "m", "cm"}
        Unit of the file's coordinates; no format says.

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
        content = _content(Path(path))
    except OSError as error:
        raise KernelError(
            f"shape {path} cannot be read: {error.strerror or error}; shapes are {SHAPE_FORMATS}."
        ) from error
    try:
        vertices, plates = _parsed(content, Path(path).suffix.lower())
    except (ValueError, IndexError, OverflowError, MemoryError, struct.error) as error:
        raise KernelError(f"shape {path}: {error}; give a whole file, of {SHAPE_FORMATS}.") from error
    return checked_shape(vertices * UNIT_KM[unit], plates, f"shape {path}")


def _content(path: Path) -> bytes:
    """Return a file's bytes; a device, which never ends, is no file, and the largest shapes have some 300 MB."""
    if (size := regular_size(path)) > LARGEST_BYTES:
        raise KernelError(f"shape {path} has {size} bytes, more than {LARGEST_BYTES}; give a coarser one.")
    return path.read_bytes()


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
    text = decoded(content, errors="replace")
    if suffix == ".obj":
        return _read_obj(text)
    if TABLE_START.match(text := COMMENT_LINES.sub("", text)):
        return _read_table(text)
    raise ValueError(
        f"neither an OBJ file nor a cmod file, nor a table of plates (it begins with {content[:16]!r})"
    )


# ---- Tables of numbers: plate tables and ICQ.

TABLE_START = re.compile(r"\s*\d{1,9}(?:[ \t]+\d{1,9})?[ \t]*\r?\n")
COMMENT_LINES = re.compile(r"(?m)^[ \t]*[#;].*(?:\r?\n|\Z)")
CORNERS = 3
FACES = 6


def _read_table(text: str) -> tuple[FloatArray, IntArray]:
    """Return vertices and plates of a table, by the counts in its first line and the numbers in its rows."""
    lines = [line for line in text.replace("D", "E").splitlines() if line.strip()]
    counts = [int(word) for word in lines[0].split()]
    points = counts[0]
    on_cube = FACES * (points + 1) ** 2
    if len(counts) == 1 and len(lines) == 1 + on_cube:
        return _from_cube(_numbers(lines[1:], CORNERS), points)
    vertices = _numbers(lines[1 : 1 + points])
    if len(vertices) < points or vertices.shape[1] not in (CORNERS, CORNERS + 1):
        raise ValueError(
            f"it announces {points} vertices, but rows of {vertices.shape[1]} numbers follow, {len(vertices)} of them"
        )
    rest = lines[1 + points :]
    if len(counts) == 1:
        counts.append(int(rest.pop(0)))
    return vertices[:, -CORNERS:], _plates(rest, counts[1])


def _plates(lines: list[str], count: int) -> IntArray:
    """Return plates from rows of three corners, led by a number, or with their number of corners in a row before each."""
    if len(lines) == 2 * count:
        if set(_numbers(lines[::2], 1)[:, 0].tolist()) != {float(CORNERS)}:
            raise ValueError("a plate of more than three corners")
        lines = lines[1::2]
    if len(lines) < count or count == 0:
        raise ValueError(f"it announces {count} plates, but {len(lines)} rows follow")
    rows = _numbers(lines[:count])
    corners = rows[:, -CORNERS:]
    if rows.shape[1] not in (CORNERS, CORNERS + 1) or not np.array_equal(corners, np.rint(corners)):
        raise ValueError(f"plates of {rows.shape[1]} numbers, expected three whole ones")
    first = 0 if corners.min() == 0.0 else 1  # some count vertices from 0
    return corners.astype(np.int64) - first


def _numbers(lines: list[str], columns: int | None = None) -> FloatArray:
    """Return rows of numbers, all of one length, of which the first columns may be all that counts."""
    if not lines:
        return np.empty((0, columns or CORNERS))
    usecols = None if columns is None else range(columns)
    return np.loadtxt(lines, dtype=np.float64, ndmin=2, usecols=usecols, comments=None)


def _from_cube(points: FloatArray, side: int) -> tuple[FloatArray, IntArray]:
    """Return the shape of six faces of (side + 1)^2 points; what neighbors share is one vertex."""
    vertices, which = np.unique(points, axis=0, return_inverse=True)
    faces = which.reshape(FACES, side + 1, side + 1)
    a, b, c, d = faces[:, :-1, :-1], faces[:, :-1, 1:], faces[:, 1:, 1:], faces[:, 1:, :-1]
    one, other = (np.linalg.norm(vertices[p] - vertices[q], axis=-1) for p, q in ((a, c), (b, d)))
    near = one <= other
    first = np.where(near[..., None], np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(near[..., None], np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    plates = np.concatenate([first, second], axis=1).reshape(FACES, -1, CORNERS)
    corners = vertices[plates] - vertices.mean(axis=0)
    inward = np.einsum("fpi,fpi->f", corners[:, :, 0], np.cross(corners[:, :, 1], corners[:, :, 2])) < 0.0
    outward = np.where(inward[:, None, None], plates[..., ::-1], plates).reshape(-1, CORNERS)
    # At a pole, squares have a side without length.
    distinct = (outward != np.roll(outward, 1, axis=1)).all(axis=1)
    return vertices, outward[distinct]


CONTINUED = re.compile(r"\\[ \t]*\r?\n")


def _read_obj(text: str) -> tuple[FloatArray, IntArray]:
    vertices: list[tuple[float, float, float]] = []
    plates: list[tuple[int, int, int]] = []
    for number, line in enumerate(CONTINUED.sub(" ", text).splitlines(), start=1):
        words = line.partition("#")[0].split()
        try:
            if words and words[0] == "v":
                vertices.append((float(words[1]), float(words[2]), float(words[3])))
            elif words and words[0] == "f":
                plates.extend(_obj_face(words[1:], len(vertices)))
        except (ValueError, IndexError) as error:
            why = "it has too few numbers" if isinstance(error, IndexError) else error
            raise ValueError(f"line {number}, {line.strip()[:40]!r}: {why}") from error
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
