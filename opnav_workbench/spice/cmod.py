"""Celestia's cmod format, text and binary: the corners and triangles of all its meshes.

A file is a header, materials and meshes; a mesh is a description of its vertices (each attribute's meaning and format),
the vertices, and groups of indices that form triangles, lines or points. Only positions and triangles are taken.

Source: Celestia wiki, "CMOD File" and "Binary CMOD specification".
"""

import struct
from collections.abc import Iterator

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["CMOD_HEADERS", "read_cmod"]

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


class _Bytes:
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
    stream = _Bytes(content)
    while not stream.done:
        token = stream.short()
        if token == MATERIAL:
            _skip_material(stream)
        elif token == MESH:
            yield _binary_mesh(stream)
        else:
            raise ValueError(f"token {token} where a material or mesh should begin")


def _skip_material(stream: _Bytes) -> None:
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


def _binary_mesh(stream: _Bytes) -> Mesh:
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
