"""`brief`: bodies, centers, types, spans, comments and variables, against SPICE's own answers and what was written."""

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import SpkSegment, brief, packaged_leap_seconds, write_spk
from opnav_workbench.kernels.contents import COMMENT_LINES
from opnav_workbench.kernels.dsk_files import write_dsk

pytestmark = pytest.mark.usefixtures("empty_pool")


def _utc(et, lsk):
    spiceypy.furnsh(str(lsk))
    text = spiceypy.et2utc(et, "ISOC", 3)
    spiceypy.kclear()
    return f"{text} UTC"


def test_spk(toy):
    told = brief(toy.path(".bsp"), [toy.path(".tf")])
    craft, body = told.rows
    assert (craft.number, craft.name, craft.relative_to) == (-999, "TOYCRAFT", "SOLAR SYSTEM BARYCENTER")
    assert (craft.frame, craft.data_type, craft.n_segments) == ("J2000", 13, 2)
    expected = [(-1000.0, 1000.0), (2000.0, 3000.0)]
    assert craft.spans == tuple(tuple(_utc(t, toy.lsk) for t in span) for span in expected)
    assert (body.number, len(body.spans)) == (2999999, 1)
    assert told.size == toy.path(".bsp").stat().st_size


def test_names_are_numbers_where_nobody_gives_them(toy):
    assert brief(toy.path(".bsp")).rows[0].name == "-999"


def test_ck_in_ticks_and_with_its_clock_in_utc(toy):
    bus, platform = brief(toy.path(".bc")).rows
    assert (bus.number, bus.relative_to, bus.data_type) == (-999000, "J2000", 3)
    assert bus.spans == (("tick 65536000000", "tick 65555660800"),)  # 1e6 s and 1e6 + 300 s of 65536 ticks
    bus, platform = brief(toy.path(".bc"), [toy.path(".tsc"), toy.path(".tf")]).rows
    assert (bus.name, platform.relative_to, bus.note) == ("TOY_BUS", "TOY_BUS", "no rates")
    assert bus.spans == ((_utc(0.0, toy.lsk), _utc(300.0, toy.lsk)),)


def test_segments_that_touch_are_one_stretch(tmp_path):
    states = np.zeros((4, 6))
    states[:, 0] = 1.0
    parts = [SpkSegment(-999, 10, np.linspace(a, a + 30, 4), states) for a in (60.0, 0.0, 30.0, 200.0)]
    write_spk(tmp_path / "parts.bsp", parts, "First line.\n\nSecond line.")
    told = brief(tmp_path / "parts.bsp")
    (row,) = told.rows
    assert (row.relative_to, row.n_segments) == ("SUN", 4)
    assert [start[11:19] for start, _ in row.spans] == ["11:58:55", "12:02:15"]
    assert [stop[11:19] for _, stop in row.spans] == ["12:00:25", "12:02:45"]
    assert told.comments == ("First line.", "Second line.")


def test_dsk(tmp_path):
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    plates = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    write_dsk(tmp_path / "rock.bds", corners, plates, 999, "IAU_PLUTO", 7)
    (row,) = brief(tmp_path / "rock.bds").rows
    assert (row.number, row.name, row.relative_to, row.data_type) == (999, "PLUTO", "IAU_PLUTO", 2)
    assert row.note == "surface 7, 4 vertices, 4 plates"
    assert row.spans == ()


def test_text_kernels(toy):
    told = brief(toy.path(".tpc"))
    assert told.file.kind == "PCK"
    assert [(v.name, v.count, v.first) for v in told.variables][-1] == ("BODY2999999_RADII", 3, "30.0")
    assert len(told.variables) == 4  # nothing of the leap seconds that helped
    names = brief(toy.path(".tf")).variables
    assert ("NAIF_BODY_NAME", 2, "TOYCRAFT") in [(v.name, v.count, v.first) for v in names]


def test_comments_leave_out_labels_rules_and_blanks(tmp_path):
    text = "KPL/FK\n\\beginlabel\nPDS = 3\n\\endlabel\n\nTitle  of it\n=====\n" + "line\n" * 50
    path = tmp_path / "a.tf"
    path.write_text(text + "\\begindata\nA = 1\n\\begintext\n")
    comments = brief(path).comments
    assert comments[:2] == ("Title of it", "line")
    assert len(comments) == COMMENT_LINES


def test_metakernel(toy, tmp_path):
    path = tmp_path / "a.tm"
    path.write_text(f"KPL/MK\nAll of it.\n\\begindata\nKERNELS_TO_LOAD = ( '{toy.lsk}' 'none.bsp' )\n")
    told = brief(path)
    assert told.comments == ("All of it.",)
    assert [p.name for p in told.listed] == [toy.lsk.name, "none.bsp"]


def test_nothing_stays_loaded_and_nothing_is_lost(toy):
    spiceypy.furnsh(str(toy.path(".tpc")))
    brief(toy.path(".bsp"), [toy.path(".tsc")])
    assert spiceypy.ktotal("ALL") == 1
    assert spiceypy.gdpool("BODY2999999_RADII", 0, 3).tolist() == [30.0, 20.0, 10.0]
    spiceypy.kclear()


def test_not_a_kernel_and_a_cut_one(toy, tmp_path):
    (tmp_path / "a.bsp").write_text("<html>")
    with pytest.raises(KernelError, match="is not a SPICE kernel"):
        brief(tmp_path / "a.bsp")
    (tmp_path / "cut.tls").write_text("KPL/LSK\n\nLEAPSECONDS KERNEL FILE\n")
    with pytest.raises(KernelError, match=r"'KPL/LSK' but has no \\begindata"):
        brief(tmp_path / "cut.tls")
    (tmp_path / "cut.bc").write_bytes(toy.path(".bc").read_bytes()[:2500])
    with pytest.raises(KernelError, match="not a whole kernel"):
        brief(tmp_path / "cut.bc")
    with pytest.raises(KernelError, match="cannot read"):
        brief(tmp_path / "none.bsp")
    with packaged_leap_seconds() as lsk, pytest.raises(KernelError, match=r"none\.tsc"):
        brief(lsk, [tmp_path / "none.tsc"])


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["de440_excerpt_2006_2030.bsp", "pluto_system_from_swe_2014_2017.bsp"])
def test_bodies_and_spans_are_those_that_spice_finds(data_dir, name):
    path = data_dir / "spice" / "derived" / name
    told = brief(path)
    assert {row.number for row in told.rows} == set(spiceypy.spkobj(str(path)))
    with packaged_leap_seconds() as lsk:
        for row in told.rows:
            window = spiceypy.spkcov(str(path), row.number)
            ends = [(window[i], window[i + 1]) for i in range(0, len(window), 2)]
            assert row.spans == tuple((_utc(a, lsk), _utc(b, lsk)) for a, b in ends)
