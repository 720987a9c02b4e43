"""Shape files: OBJ and cmod as they are in the wild, DSK written and read, and damaged ones refused in one line."""

import struct

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.dsk_files import read_dsk, write_dsk
from opnav_workbench.kernels.shape_files import read_shape

CORNERS = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
PLATES = np.array([[0, 1, 3], [0, 2, 1], [0, 3, 2], [1, 2, 3]])
BODY_FROM_CELESTIA = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])

TEXT = """#celmodel__ascii
# a tetrahedron
material
diffuse 0.5 0.5 0.5
texture0 "gray.*"
end_material
mesh
vertexdesc
normal f3
position f3
color0 ub4
end_vertexdesc
vertices 4
0 0 1 1 1 1 9 9 9 9
0 0 1 -1 -1 1 9 9 9 9
0 0 1 -1 1 -1 9 9 9 9
0 0 1 1 -1 -1 9 9 9 9
trilist 0 6
0 1 3 0 2 1
trifan 0 4
3 2 0 1
linelist 0 2
0 1
end_mesh
"""


def binary_cmod(groups, corners=CORNERS):
    out = b"#celmodel_binary"
    out += struct.pack("<hhhfff", 1001, 1003, 7, 1.0, 0.5, 0.5)  # material, diffuse, color
    out += struct.pack("<hhhh", 1007, 0, 5, 5) + b"a.png" + struct.pack("<hh", 1015, 0)  # texture, blend
    out += struct.pack("<hhf", 1005, 1, 20.0) + struct.pack("<h", 1002)
    out += struct.pack("<hh", 1009, 1011) + struct.pack("<hhhh", 5, 1, 0, 2) + struct.pack("<h", 1012)
    out += struct.pack("<hI", 1013, len(corners))
    for corner in corners:
        out += struct.pack("<ff", 0.1, 0.2) + struct.pack("<fff", *corner)
    for kind, index in groups:
        out += struct.pack("<hII", kind, 0, len(index)) + struct.pack(f"<{len(index)}I", *index)
    return out + struct.pack("<h", 1010)


def same_plates(found, expected):
    """Plates are the same but for which corner comes first."""

    def key(plates):
        return {tuple(np.roll(p, -int(np.argmin(p))).tolist()) for p in np.asarray(plates)}

    return key(found) == key(expected)


def test_obj_with_texture_indices_polygons_and_negative_numbers(tmp_path):
    text = "# cube\nmtllib a.mtl\ng default\n"
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    text += "".join(f"v {x} {y} {z} 1.0\n" for x, y, z in corners) + "vn 0 0 1\nvt 0 0\n"
    text += (
        "f 1/1/1 2/1/1 4/1/1 3/1/1\nf 5//1 7//1 8//1 6//1\nf -8 -4 -3 -7\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    )
    (tmp_path / "cube.obj").write_text(text)
    vertices, plates = read_shape(tmp_path / "cube.obj", "m")
    np.testing.assert_allclose(vertices, np.array(corners) / 1000.0)
    assert plates.shape == (12, 3)
    a, b, c = (vertices[plates[:, k]] for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(1e-9)


def test_text_and_binary_cmod(tmp_path):
    (tmp_path / "text.cmod").write_text(TEXT)
    binary = binary_cmod([(0, [0, 1, 3, 0, 2, 1]), (1, [0, 3, 2, 1]), (3, [0, 1])])
    (tmp_path / "binary.cmod").write_bytes(binary)
    for name in ("text.cmod", "binary.cmod"):
        vertices, plates = read_shape(tmp_path / name)
        np.testing.assert_allclose(vertices, CORNERS @ BODY_FROM_CELESTIA.T, err_msg=name)
        assert len(plates) == 4
    assert same_plates(read_shape(tmp_path / "text.cmod")[1], [[0, 1, 3], [0, 2, 1], [3, 2, 0], [3, 0, 1]])
    # The second triangle of a strip 0 3 2 1 is 3 1 2: wound as the first.
    strip = read_shape(tmp_path / "binary.cmod")[1]
    assert same_plates(strip, [[0, 1, 3], [0, 2, 1], [0, 3, 2], [1, 2, 3]])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"", "empty"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"plate 0 refers to vertices \[0, 1, 8\]"),
        ("a.obj", b"v 0 0 x\n", "line 1"),
        ("a.obj", b"v 0 0\n", "line 1"),
        ("a.obj", b"v 0 0 0\nf 1 2\n", "line 2.*three corners"),
        ("a.obj", b"v 0 0 0\nf 0 1 1\n", "counts from 1"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0 is not finite"),
        ("a.stl", b"solid", "neither an OBJ file nor a cmod file"),
        ("a.cmod", b"#celmodel__ascii\nmesh\nvertexdesc\nposition f3\n", "ends early or is damaged"),
        ("a.cmod", b"#celmodel__ascii\nfoo\n", "'foo' where a material or mesh"),
        ("a.cmod", binary_cmod([(0, [0, 1, 3])])[:100], "bytes were announced"),
        ("a.cmod", binary_cmod([(0, [0, 1])]), "multiple of three"),
        ("a.cmod", binary_cmod([(0, [0, 1, 7])]), "refers to vertices"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(KernelError, match=message) as caught:
        read_shape(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


def test_unknown_units_and_missing_files(tmp_path):
    with pytest.raises(KernelError, match=r"unit 'ft' is unknown; use km, m, cm"):
        read_shape(tmp_path / "a.obj", "ft")
    with pytest.raises(KernelError, match="cannot be read"):
        read_shape(tmp_path / "none.obj")
    with pytest.raises(KernelError, match="no such file"):
        read_dsk(tmp_path / "none.bds")


def test_dsk_is_written_whole_and_spice_meets_it(tmp_path):
    path = tmp_path / "tetra.bds"
    write_dsk(path, CORNERS * 100.0, PLATES, 999, "IAU_PLUTO", comment="A tetrahedron, for a test.")
    vertices, plates = read_dsk(path)
    np.testing.assert_array_equal(vertices, CORNERS * 100.0)
    np.testing.assert_array_equal(plates, PLATES)
    assert [p.name for p in tmp_path.iterdir()] == ["tetra.bds"]
    with KernelSet(path):
        place, found = spiceypy.dskxv(
            False,
            "PLUTO",
            [],
            0.0,
            "IAU_PLUTO",
            [[1e3, 1e3, 1e3], [1e3, 0.0, 0.0]],
            [[-1.0, -1, -1], [1.0, 0, 0]],
        )
    assert list(found) == [1, 0]
    np.testing.assert_allclose(place[0], [100.0, 100.0, 100.0], atol=1e-9)
    write_dsk(path, CORNERS, PLATES, 999, "IAU_PLUTO")  # replaces
    assert read_dsk(path)[0].max() == 1.0


def test_dsk_that_cannot_be_written_leaves_nothing(tmp_path):
    path = tmp_path / "bad.bds"
    with pytest.raises(KernelError, match="refers to vertices"):
        write_dsk(path, CORNERS, PLATES + 2, 999, "IAU_PLUTO")
    with pytest.raises(KernelError, match="unknown to SPICE"):
        write_dsk(path, CORNERS, PLATES, 999, "IAU_NOWHERE")
    with pytest.raises(KernelError, match="no extent"):
        write_dsk(path, np.zeros((4, 3)), PLATES, 999, "IAU_PLUTO")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "text.bds").write_text("no DSK")
    with pytest.raises(KernelError):
        read_dsk(tmp_path / "text.bds")


@pytest.mark.realdata
def test_bennu_files_agree_with_each_other(data_dir, tmp_path):
    radar = read_shape(data_dir / "shapes" / "BennuUntextured.obj")
    laser = read_shape(data_dir / "shapes" / "bennu.cmod")
    assert radar[0].shape == (1348, 3)
    assert laser[1].shape == (49152, 3)

    def equator(vertices):
        """Mean radius of the equatorial belt in 36 sectors of east longitude, less its mean."""
        radius = np.linalg.norm(vertices, axis=1)
        longitude = np.degrees(np.arctan2(vertices[:, 1], vertices[:, 0])) % 360.0
        belt = np.abs(vertices[:, 2]) < 0.25 * radius
        sector = (longitude // 10.0).astype(int)
        mean = np.array([radius[belt & (sector == k)].mean() for k in range(36)])
        return mean - mean.mean()

    a, b = equator(radar[0]), equator(laser[0])
    likeness = [a @ np.roll(b, k) / np.sqrt((a @ a) * (b @ b)) for k in range(36)]
    # Celestia's axes are understood: the two shapes lie on each other, neither turned nor mirrored.
    assert np.argmax(likeness) in {35, 0, 1}
    assert max(likeness) > 0.85
    write_dsk(tmp_path / "bennu.bds", *laser, 2101955, "IAU_BENNU")
    np.testing.assert_array_equal(read_dsk(tmp_path / "bennu.bds")[0], laser[0])


# ---- Tables of numbers: plate tables and Gaskell's ICQ.


def plate_table(kind: str) -> str:
    numbered = [f"{i} {x:.3f} {y:.3f} {z:.3f}" for i, (x, y, z) in enumerate(CORNERS, start=1)]
    bare = [f"{x:.3f}D0 {y:.3f}D0 {z:.3f}D0" for x, y, z in CORNERS]
    plates = [" ".join(map(str, plate + 1)) for plate in PLATES]
    rows = {
        "plt": ["4", *numbered, "4", *(f"{i} {plate}" for i, plate in enumerate(plates, start=1))],
        "tab": ["4 4", *numbered, *(f"{i} {plate}" for i, plate in enumerate(plates, start=1))],
        "ver": ["4 4", *bare, *(f"3\n{plate}" for plate in plates)],
        "txt": ["4", *bare, "4", *plates],
    }
    return "\r\n".join(rows[kind]) + "\r\n"


@pytest.mark.parametrize("kind", ["plt", "tab", "ver", "txt"])
def test_plate_tables(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    path.write_text(plate_table(kind))
    vertices, plates = read_shape(path, "m")
    np.testing.assert_allclose(vertices, CORNERS / 1000.0)
    np.testing.assert_array_equal(plates, PLATES)


def test_what_editors_and_other_programs_make_of_a_shape(tmp_path):
    """Comments, vertices counted from 0, marks of an encoding, and lines that go on in the next one."""
    rows = [f"{i} {x:.3f} {y:.3f} {z:.3f}" for i, (x, y, z) in enumerate(CORNERS)]
    rows += [f"{i} {' '.join(map(str, plate))}" for i, plate in enumerate(PLATES)]
    obj = "".join(f"v {x} {y} {z}  # a corner\n" for x, y, z in CORNERS.tolist())
    obj += "".join("f {} {} \\\n  {} # a plate\n".format(*(plate + 1)) for plate in PLATES)
    for name, content in (
        ("zero.plt", "\n".join(["# made by hand", f"{len(CORNERS)} {len(PLATES)}", *rows]).encode()),
        ("mark.obj", b"\xef\xbb\xbf" + obj.encode()),
        ("wide.obj", obj.encode("utf-16")),
    ):
        (tmp_path / name).write_bytes(content)
        vertices, plates = read_shape(tmp_path / name)
        np.testing.assert_allclose(vertices, CORNERS)
        np.testing.assert_array_equal(plates, PLATES)


def icq_text(side: int, radii: tuple[float, float, float]) -> str:
    """The points of a cube's faces, drawn onto an ellipsoid; each face begins at another corner and may be mirrored."""
    ends = np.linspace(-1.0, 1.0, side + 1)
    u, v = np.meshgrid(ends, ends, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, u, v), (u, -one, v), (-one, v, u), (v, one, u), (u, v, one), (-u, v, -one)]
    points = np.concatenate([np.stack(face, axis=-1).reshape(-1, 3) for face in faces])
    points *= np.array(radii) / np.linalg.norm(points, axis=1)[:, None]
    return f"{side}\n" + "\n".join(" ".join(f"{x:.5f}" for x in point) for point in points)


def test_gaskells_shapes_are_closed_and_of_the_right_size(tmp_path):
    side, radii = 24, (3.0, 2.0, 1.5)
    path = tmp_path / "a.icq"
    path.write_text(icq_text(side, radii))
    vertices, plates = read_shape(path)
    assert len(vertices) == 6 * side**2 + 2
    assert len(plates) == 12 * side**2
    corners = vertices[plates]
    volume = np.einsum("pi,pi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * np.prod(radii), rel=0.01)
    edges = np.concatenate([plates[:, [0, 1]], plates[:, [1, 2]], plates[:, [2, 0]]])
    back = {(int(b), int(a)) for a, b in edges}
    assert len(back) == len(edges)  # no edge runs the same way twice
    assert all((int(a), int(b)) in back for a, b in edges)  # each has a plate on its other side


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("5\n1 2 3\n", "it announces 5 vertices, but rows of 3 numbers follow, 1 of them"),
        ("1\n1 2 3\n9\n1 1 1\n", "it announces 9 plates, but 1 rows follow"),
        ("4 4\nx y z\n", "no shape file|could not convert"),
        ("1\n1 2 3\n1\n1 2 1.5\n", "expected three whole ones"),
        ("no numbers\n", "ICQ"),
    ],
)
def test_tables_that_are_none(tmp_path, text, said):
    path = tmp_path / "a.plt"
    path.write_text(text)
    with pytest.raises(KernelError, match=said) as caught:
        read_shape(path)
    assert all(kind in str(caught.value) for kind in ("OBJ", "cmod", "plate tables", "ICQ", "DSK"))
