"""`check_kernels`: windows, gaps and overlaps as they were written, and at a time what is missing and what helps."""

import numpy as np
import pytest
import spiceypy
from numpy.testing import assert_allclose

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import check_kernels

pytestmark = pytest.mark.usefixtures("empty_pool")
EIGHT = ("LSK", "SCLK", "PCK", "FK", "IK", "target SPK", "spacecraft SPK", "CK")
TICK_S = 1.0 / 65536.0
SERVED = 25.0  # et at which spacecraft, body, bus and platform of the toy mission are all known


def _row(check, kind, body):
    return next(row for row in check.rows if (row.kind, row.body) == (kind, body))


def _one(problems, *words):
    (found,) = [p for p in problems if all(word in p for word in words)]
    return found


def test_all_eight_kinds_and_every_window(toy):
    check = check_kernels(toy.files)
    assert tuple(k.kind for k in check.kinds) == EIGHT
    assert all(len(k.files) == 1 and not k.remedy for k in check.kinds)
    assert check.ok
    assert {(r.kind, r.body, r.name) for r in check.rows} == {
        ("spacecraft SPK", -999, "TOYCRAFT"), ("target SPK", 2999999, "TOYBODY"),
        ("CK", -999000, "TOY_BUS"), ("CK", -999200, "TOY_PLATFORM"),
    }  # fmt: skip
    craft, bus = _row(check, "spacecraft SPK", -999), _row(check, "CK", -999000)
    assert_allclose(craft.windows_et, [(-1000.0, 1000.0), (2000.0, 3000.0)])
    assert_allclose(craft.gaps_et, [(1000.0, 2000.0)])
    assert_allclose(bus.gaps_et, [(100.0, 200.0)], atol=TICK_S)
    assert not craft.overlaps_et.size
    assert not craft.gaps_et.flags.writeable
    assert [k.kind for k in check.kernels] == ["LSK", "SCLK", "FK", "PCK", "IK", "SPK", "CK"]


def test_a_time_that_is_served(toy):
    check = check_kernels(toy.files, SERVED)
    assert check.ok, check.problems
    assert check.et == SERVED


def test_gaps_before_between_and_after_are_named_with_their_ends(toy):
    between = check_kernels(toy.files, 1500.0)
    assert not between.ok
    craft = _one(between.problems, "spacecraft SPK of TOYCRAFT")
    assert "gap from 2000-01-01T12:15:35.816 UTC to 2000-01-01T12:32:15.816 UTC" in craft
    assert "load an SPK that covers 2000-01-01T12:23:55.816 UTC" in craft
    assert "ends at" in _one(between.problems, "CK of TOY_BUS")
    before = check_kernels(toy.files, -1001.0)
    assert "begins only at 2000-01-01T11:42:15.816 UTC" in _one(before.problems, "spacecraft SPK")
    assert _row(between, "spacecraft SPK", -999).gap_at(1500.0) == (1000.0, 2000.0)
    assert _row(before, "spacecraft SPK", -999).gap_at(-1001.0) == (-np.inf, -1000.0)


def test_times_may_be_utc_clock_reading_or_et(toy):
    utc = check_kernels(toy.files, "2000-01-01T11:59:20.816")
    clock = check_kernels(toy.files, f"1/{1_000_000 + 25}:00000")
    number = check_kernels(toy.files, "25.0")
    assert_allclose([utc.et, clock.et, number.et], SERVED, atol=1e-3)
    with pytest.raises(KernelError, match="needs the SCLK kernel of the spacecraft"):
        check_kernels(toy.without(".tsc", ".bc"), "1/1000025:00000")
    with pytest.raises(KernelError, match="yesterday"):
        check_kernels(toy.files, "yesterday")


@pytest.mark.parametrize(
    ("suffix", "kind", "remedy"),
    [(".tls", "LSK", "naif0012.tls"), (".tsc", "SCLK", "clock kernel"), (".tpc", "PCK", "pck00011.tpc"),
     (".tf", "FK", "frame kernel"), (".ti", "IK", "camera files"), (".bc", "CK", "attitude")],
)  # fmt: skip
def test_a_missing_kind_is_named_with_its_remedy(toy, suffix, kind, remedy):
    check = check_kernels(toy.without(suffix))
    missing = next(k for k in check.kinds if not k.files)
    assert missing.kind == kind
    assert remedy in missing.remedy
    assert remedy in _one(check.problems, f"{kind}: none")
    assert not check.ok


def test_a_ck_that_cannot_be_dated_is_a_problem_not_a_crash(toy):
    check = check_kernels(toy.without(".tsc"), SERVED)
    assert not check.ok
    assert _one(check.problems, "times of the CK of TOY_BUS")
    assert len(_row(check, "CK", -999000).windows_et) == 0
    assert len(_row(check, "spacecraft SPK", -999).windows_et) == 2


def _more(path, body, start, stop, center=0):
    handle = spiceypy.spkopn(str(path), "more", 0)
    et = np.linspace(start, stop, 5)
    spiceypy.spkw13(handle, body, center, "J2000", start, stop, "s", 3, 5, [[1.0, 0, 0, 0, 0, 0]] * 5, et)
    spiceypy.spkcls(handle)
    return path


def test_overlaps_and_which_file_wins(toy, tmp_path):
    later = _more(tmp_path / "later.bsp", -999, 900.0, 2500.0)
    craft = _row(check_kernels([*toy.files, later]), "spacecraft SPK", -999)
    assert_allclose(craft.windows_et, [(-1000.0, 3000.0)])
    assert_allclose(craft.overlaps_et, [(900.0, 1000.0), (2000.0, 2500.0)])
    assert craft.overlap_at(950.0) == (900.0, 1000.0)
    assert craft.overlap_at(1500.0) is None
    assert [p.name for p in craft.files_at(950.0)] == ["toy.bsp", "later.bsp"]
    assert [p.name for p in craft.files_at(1500.0)] == ["later.bsp"]


def test_bodies_without_a_tie_to_the_barycenter(toy, tmp_path):
    loose = _more(tmp_path / "loose.bsp", 2999998, -1000.0, 1000.0, center=2999997)
    problem = _one(check_kernels([*toy.files, loose], SERVED).problems, "2999998")
    assert "do not connect" in problem
    assert "load a planetary ephemeris" in problem


def test_only_what_is_asked_about_counts(toy, tmp_path):
    short = _more(tmp_path / "short.bsp", 2999998, -1.0, 1.0)
    files = [*toy.files, short]
    assert not check_kernels(files, SERVED).ok
    asked = {"spacecraft": -999, "targets": ["TOYBODY"], "frame": "TOY_CAMERA"}
    check = check_kernels(files, SERVED, **asked)
    assert check.ok, check.problems
    assert [r.body for r in check.rows if r.needed] == [-999, 2999999, -999000]
    assert "CK of TOY_BUS" in _one(check_kernels(files, 150.0, **asked).problems, "CK")


def test_a_target_nobody_holds_or_knows(toy):
    asked = {"spacecraft": -999, "frame": "TOY_CAMERA"}
    held = check_kernels(toy.files, SERVED, targets=["MARS"], **asked)
    assert "target SPK of MARS: none; load an SPK that covers" in _one(held.problems, "target SPK")
    unknown = check_kernels(toy.files, SERVED, targets=["TOYBODDY"], **asked)
    assert "TOYBODY" in _one(unknown.problems, "'TOYBODDY' is unknown")
    frame = check_kernels(toy.files, SERVED, frame="TOY_CAMRA")
    assert "TOY_CAMERA" in _one(frame.problems, "TOY_CAMRA is unknown")


def test_light_time_counts_for_targets(toy, tmp_path):
    """0.74 s of light time: half a second after the window begins, the light seen then had left before it."""
    late = _more(tmp_path / "late.bsp", 2999998, 24.0, 100.0)
    for et, served in ((24.5, False), (26.0, True)):
        check = check_kernels([*toy.files, late], et, spacecraft=-999, targets=[2999998], frame="TOY_CAMERA")
        assert _row(check, "target SPK", 2999998).covers(et)
        assert any("light time" in p for p in check.problems) is not served


def test_a_target_without_size_or_rotation(toy):
    check = check_kernels(toy.without(".tpc"), SERVED, spacecraft=-999, targets=["TOYBODY"])
    assert _one(check.problems, "RADII")
    assert all("Loaded kernels" not in p and "\n" not in p for p in check.problems)


def test_a_clock_without_a_partition_for_the_time(toy, tmp_path):
    text = toy.path(".tsc").read_text().replace("281474976710655.0", "65536000.0")
    short = tmp_path / "short.tsc"
    short.write_text(text)
    check = check_kernels([*toy.without(".tsc", ".bc"), short], SERVED)
    assert _one(check.problems, "reading of clock -999")


def test_text_kernels_that_do_not_say_their_kind_count_by_their_variables(toy, tmp_path):
    nameless = tmp_path / "bodies.txt"
    nameless.write_text(toy.path(".tpc").read_text().replace("KPL/PCK\n", ""))
    check = check_kernels([*toy.without(".tpc"), nameless])
    assert check.ok, check.problems


def test_kernels_that_are_not_whole_or_not_there(toy, tmp_path):
    cut = tmp_path / "cut.bsp"
    cut.write_bytes(toy.path(".bsp").read_bytes()[:3000])
    with pytest.raises(KernelError, match=r"cut\.bsp is not a whole kernel"):
        check_kernels([*toy.without(".bsp"), cut])
    with pytest.raises(KernelError, match="missing"):
        check_kernels(tmp_path / "none.tm")


def test_the_axis_of_a_drawing_holds_craft_attitude_and_the_time_asked(toy):
    assert_allclose(check_kernels(toy.files).plot_span_et(), (-1000.0, 3000.0))
    assert_allclose(check_kernels(toy.files, 9000.0).plot_span_et(), (-1000.0, 9000.0))
    assert check_kernels(toy.lsk).plot_span_et() == (0.0, 1.0)


# -- flight kernels ------------------------------------------------------------------------------------------------


def _flight(data_dir, s):
    generic = data_dir / "spice" / "generic"
    return [*(generic / name for name in s.generic), data_dir / "spice" / "slices" / s.folder]


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["lorri", "mvic", "mapcam", "dawn", "cassini", "hayabusa2"])
def test_flight_slices_serve_their_picture(data_dir, flight_slices, name):
    s = flight_slices[name]
    check = check_kernels(
        _flight(data_dir, s), s.utc, spacecraft=s.spacecraft, targets=[s.target], frame=s.frame
    )
    assert not [p for p in check.problems if "none; add" not in p]


@pytest.mark.realdata
def test_the_gap_between_a_picture_and_its_light_time(data_dir, flight_slices):
    """The MVIC slice holds the picture of 04:02 and the light that left Pluto 4.4 h before; between is nothing."""
    check = check_kernels(_flight(data_dir, flight_slices["mvic"]), "2015-06-03T02:00:00")
    ck = _row(check, "CK", -98000)
    assert_allclose(np.diff(ck.gap_at(check.et)), 4.37 * 3600, atol=60)
    text = _one(check.problems, "CK of NH_SPACECRAFT")
    assert "gap from 2015-06-02T23:40:36.546 UTC to 2015-06-03T04:02:39.124 UTC" in text
    assert not check.ok
