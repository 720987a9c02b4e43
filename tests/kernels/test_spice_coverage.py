"""What kernels cover: windows as written, and answers that agree with SPICE at every time."""

import math

import pytest
import spiceypy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels import coverage as cover

pytestmark = pytest.mark.usefixtures("empty_pool")
TICK_S = 1.0 / 65536.0
SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=80)


def test_windows_are_those_that_were_written(toy):
    with KernelSet(toy.files) as kernels:
        found = {(c.kind, c.body): c for c in kernels.coverage()}
    assert set(found) == {("SPK", -999), ("SPK", 2999999), ("CK", -999000), ("CK", -999200)}
    expected = {
        ("SPK", -999): [(-1000.0, 1000.0), (2000.0, 3000.0)],
        ("SPK", 2999999): [(-5000.0, 5000.0)],
        ("CK", -999000): [(0.0, 100.0), (200.0, 300.0)],
        ("CK", -999200): [(0.0, 50.0)],
    }
    for key, spans in expected.items():
        assert_allclose(found[key].intervals_et, spans, rtol=0, atol=TICK_S)
        assert not found[key].intervals_et.flags.writeable
        assert found[key].path == toy.path(".bsp" if key[0] == "SPK" else ".bc")
    assert found["SPK", -999].name == "TOYCRAFT"
    assert found["CK", -999000].name == "TOY_BUS"


def test_files_merge_and_each_is_named(toy, tmp_path):
    path = tmp_path / "more.bsp"
    handle = spiceypy.spkopn(str(path), "more", 0)
    et = [900.0, 1200.0, 1500.0, 1800.0]
    spiceypy.spkw13(handle, -999, 0, "J2000", 900.0, 1800.0, "s", 3, 4, [[1.0, 0, 0, 0, 0, 0]] * 4, et)
    spiceypy.spkcls(handle)
    with KernelSet([*toy.files, path]) as kernels:
        craft = next(c for c in kernels.coverage("SPK") if c.body == -999)
        assert {c.kind for c in kernels.coverage("SPK")} == {"SPK"}
    assert_allclose(craft.intervals_et, [(-1000.0, 1800.0), (2000.0, 3000.0)])
    assert craft.paths == (toy.path(".bsp"), path)


def test_more_windows_than_spices_default_room(tmp_path, toy, monkeypatch):
    monkeypatch.setattr(cover, "WINDOW_SIZES", (2, 20, 2000))
    with KernelSet(toy.files) as kernels:
        craft = next(c for c in kernels.coverage("SPK") if c.body == -999)
    assert len(craft.intervals_et) == 2
    monkeypatch.setattr(cover, "WINDOW_SIZES", (2,))
    with KernelSet(toy.files) as kernels, pytest.raises(KernelError, match="coverage"):
        kernels.coverage("SPK")


def test_the_table_has_one_row_per_window(toy):
    with KernelSet(toy.files) as kernels:
        table = kernels.coverage_table()
    assert len(table) == 6
    assert table["start_et"].unit == "s"
    bus = table[table["name"] == "TOY_BUS"]
    assert list(bus["start_utc"]) == ["2000-01-01T11:58:55.816", "2000-01-01T12:02:15.816"]
    assert set(bus["files"]) == {"toy.bc"}


def test_a_set_without_windows_gives_an_empty_table(toy):
    with KernelSet(toy.lsk) as kernels:
        assert kernels.coverage() == ()
        assert len(kernels.coverage_table()) == 0


def test_only_the_open_set_answers(toy):
    outer = KernelSet(toy.files)
    with pytest.raises(KernelError, match="no kernels are loaded"):
        outer.coverage()
    with outer, KernelSet(toy.lsk), pytest.raises(KernelError, match="not the open one"):
        outer.coverage()


def test_chains_lead_through_fixed_offsets_and_cks_on_cks(toy):
    with KernelSet(toy.files):
        chain = {
            f: cover.ck_structures(cover.frame_number(f)) for f in ("TOY_CAMERA", "TOY_PLATFORM", "J2000")
        }
    assert chain == {"TOY_CAMERA": (-999000,), "TOY_PLATFORM": (-999200, -999000), "J2000": ()}


def test_has_attitude_asks_for_a_ck_for_the_whole_chain(toy):
    with KernelSet(toy.files) as kernels:
        assert kernels.has_attitude("TOY_CAMERA")
        assert kernels.has_attitude("TOY_PLATFORM")
        assert kernels.has_attitude("TOYBODY_FIXED")  # needs no CK
        with pytest.raises(KernelError, match="the frame NOWHERE is unknown"):
            kernels.has_attitude("NOWHERE")
    with KernelSet(toy.without(".bc")) as kernels:
        assert not kernels.has_attitude("TOY_CAMERA")
    with KernelSet(toy.without(".tsc", ".tls")) as kernels:
        assert kernels.has_attitude("TOY_CAMERA")  # no clock needed to know that a CK is there


@pytest.mark.parametrize("missing", [".tsc", ".tf"])
def test_covers_attitude_needs_clock_and_frames(toy, missing):
    with KernelSet(toy.without(missing)) as kernels, pytest.raises(KernelError, match=r"SCLK|FK"):
        kernels.covers_attitude("TOY_CAMERA", 10.0)


@pytest.mark.slow
@given(et=st.floats(-500.0, 500.0), frame=st.sampled_from(["TOY_CAMERA", "TOY_PLATFORM", "TOYBODY_FIXED"]))
@SHARED
def test_covers_attitude_agrees_with_spice(toy, et, frame):
    spans = {
        "TOY_CAMERA": [(0, 100), (200, 300)],
        "TOY_PLATFORM": [(0, 50)],
        "TOYBODY_FIXED": [(-math.inf, math.inf)],
    }
    inside = any(a + TICK_S < et < b - TICK_S for a, b in spans[frame])
    outside = all(et < a - TICK_S or et > b + TICK_S for a, b in spans[frame])
    with KernelSet(toy.files) as kernels:
        answer = kernels.covers_attitude(frame, et)
        try:
            spiceypy.pxform("J2000", frame, et)
            works = True
        except spiceypy.SpiceyError:
            works = False
    assert answer == works
    assert not (inside and not answer)
    assert not (outside and answer)


@pytest.mark.slow
@given(et=st.floats(-6000.0, 6000.0))
@SHARED
def test_covers_state_agrees_with_what_was_written(toy, et):
    expected = -1000.0 <= et <= 1000.0 or 2000.0 <= et <= 3000.0
    with KernelSet(toy.files) as kernels:
        assert kernels.covers_state("TOYBODY", "TOYCRAFT", et) == expected
        assert not kernels.covers_state("PLUTO", "TOYCRAFT", et)


def test_covers_state_with_light_time_looks_back(toy):
    with KernelSet(toy.files) as kernels:
        assert kernels.covers_state("TOYBODY", 0, -5000.0)
        assert not kernels.covers_state("TOYBODY", 0, -5000.0, "CN")  # known only one light time (2 s) later
        assert kernels.covers_state("TOYBODY", 0, -4990.0, "CN")
        with pytest.raises(KernelError, match="'NOBODY' is unknown"):
            kernels.covers_state("NOBODY", 0, 0.0)


def test_a_time_before_the_clock_started_is_not_covered(toy):
    with KernelSet(toy.files) as kernels:
        assert not kernels.covers_attitude("TOY_CAMERA", -2e6)
