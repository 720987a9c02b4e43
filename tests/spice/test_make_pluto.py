"""The New Horizons approach scenario: real geometry, offline, small; compared with what it was made from."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest
import spiceypy

from opnav_workbench.geometry.rotations import angle_between
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.spice import (
    KernelSet,
    body_attitude,
    body_radii_km,
    camera_attitude,
    et_from_utc,
    sclk_from_et,
    state,
)
from opnav_workbench.spice.make import make_kernels

SCENARIO = kernels_meta_dir() / "new_horizons" / "pluto_approach.yaml"
LORRI_PIXEL_RAD = 4.963571e-6
PAPER_EPOCHS = ("2015-07-09T04:29:00", "2015-07-12T08:46:57")
BUILD_LIMIT_S = 5.0
YAML_LIMIT_BYTES = 60_000
KERNELS_LIMIT_BYTES = 1_000_000


@pytest.fixture(scope="module")
def metakernel(tmp_path_factory):
    return make_kernels(SCENARIO, tmp_path_factory.mktemp("pluto"), actual=True)


@pytest.fixture
def loaded(metakernel):
    with KernelSet(metakernel) as kernels:
        yield kernels


def pixel_line(body, et):
    """Offset from the boresight in 1x1 pixels; LORRI looks along -Z, +X along pixel, +Y along line."""
    x, y, z = state(body, et, "NH", "NH_LORRI_1X1", "CN+S").position_km
    return np.array([x, y]) / -z / LORRI_PIXEL_RAD


def test_small_and_quick(tmp_path):
    assert SCENARIO.stat().st_size < YAML_LIMIT_BYTES
    start = time.perf_counter()
    make_kernels(SCENARIO, tmp_path)
    assert time.perf_counter() - start < BUILD_LIMIT_S
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < KERNELS_LIMIT_BYTES


@pytest.mark.parametrize(
    ("utc", "range_km", "pluto_px", "charon_px"),
    # Ranges and diameters of a straight line through the published closest approach, 13 695 km from Pluto
    [(PAPER_EPOCHS[0], 6.318e6, 75.8, 38.7), (PAPER_EPOCHS[1], 2.533e6, 189.1, 96.4)],
)
def test_geometry_at_the_epochs_of_the_paper(loaded, utc, range_km, pluto_px, charon_px):
    et = et_from_utc(utc)
    pluto = state("PLUTO", et, "NH", "J2000", "CN+S")
    distance_km = np.linalg.norm(pluto.position_km)
    assert distance_km == pytest.approx(range_km, rel=1e-3)
    assert 2 * body_radii_km("PLUTO")[0] / distance_km / LORRI_PIXEL_RAD == pytest.approx(pluto_px, abs=0.2)
    assert 2 * body_radii_km("CHARON")[0] / distance_km / LORRI_PIXEL_RAD == pytest.approx(charon_px, abs=0.5)
    assert np.linalg.norm(state("PLUTO", et, "NH").velocity_km_s) == pytest.approx(13.78, abs=0.05)
    sun = state("SUN", et, "PLUTO").position_km
    phase = np.degrees(angle_between(sun, -pluto.position_km))
    assert phase == pytest.approx(15.0, abs=1.0)


def test_bodies_stay_in_the_field(loaded):
    for et in np.arange(et_from_utc("2015-07-01T00:00:00"), et_from_utc("2015-07-11T10:00:00"), 7200.0):
        for body, radius_km in (("PLUTO", 1188.3), ("CHARON", 606.0)):
            radius_px = radius_km / np.linalg.norm(state(body, et, "NH").position_km) / LORRI_PIXEL_RAD
            assert np.abs(pixel_line(body, et)).max() + radius_px < 512.0
    for et in np.arange(et_from_utc("2015-07-11T10:30:00"), et_from_utc("2015-07-13T12:00:00"), 3600.0):
        assert pixel_line("PLUTO", et) == pytest.approx([-60.0, 40.0], abs=0.05)


def test_pointing_gap_is_a_gap(loaded):
    assert loaded.covers_attitude("NH_LORRI", et_from_utc("2015-07-11T09:59:59"))
    assert not loaded.covers_attitude("NH_LORRI", et_from_utc("2015-07-11T10:15:00"))
    assert loaded.covers_attitude("NH_LORRI", et_from_utc("2015-07-11T10:30:01"))


def test_actual_pointing_is_off_as_told(loaded, metakernel):
    et = et_from_utc(PAPER_EPOCHS[1])
    predicted = camera_attitude("NH_LORRI_1X1", et)
    with KernelSet(metakernel.with_name("pluto_approach_actual.tm")):
        x, y, z = camera_attitude("NH_LORRI_1X1", et) @ -predicted[2]
    # 1e-3 px: the kernel's focal length over pixel size is not quite its printed IFOV
    assert np.array([x, y]) / -z / LORRI_PIXEL_RAD == pytest.approx([14.3, -9.6], abs=1e-3)


def test_body_frames_and_light_time_to_the_sun(loaded):
    et = et_from_utc("2015-07-01T00:00:01")  # light left the Sun 4.5 h before the span
    assert 16000.0 < state("SUN", et, "NH", "J2000", "CN+S").light_time_s < 17000.0
    state("EARTH", et, "NH", "J2000", "CN+S")
    to_charon = body_attitude("PLUTO", et) @ state("CHARON", et, "PLUTO").position_km
    longitude = np.degrees(np.arctan2(to_charon[1], to_charon[0]))
    # Pluto's prime meridian faces Charon; the spin constants of WGCCRE 2015 miss it by 1.47 deg, all year
    assert longitude == pytest.approx(1.47, abs=0.05)


def test_opens_by_name_and_again_from_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    with KernelSet("new_horizons/pluto_approach") as kernels:
        assert kernels.covers_attitude("NH_LORRI_4X4", et_from_utc(PAPER_EPOCHS[0]))
    code = (
        "import json; from opnav_workbench.spice import *;"
        "kernels = KernelSet('new_horizons/pluto_approach'); kernels.__enter__();"
        f"print(json.dumps(camera_attitude('NH_LORRI', et_from_utc('{PAPER_EPOCHS[0]}')).tolist()))"
    )
    there = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout
    with KernelSet("new_horizons/pluto_approach"):
        here = camera_attitude("NH_LORRI", et_from_utc(PAPER_EPOCHS[0]))
    assert np.abs(np.array(json.loads(there)) - here).max() < 1e-15


# ---- against the kernels that the numbers come from

DERIVED = (
    "naif0012.tls", "de440_excerpt_2006_2030.bsp", "pluto_system_from_swe_2014_2017.bsp",
    "new_horizons_from_horizons.bsp",
)  # fmt: skip
# Before this time the derived file holds the orbit before the maneuver of 2015-06-30, joined in two hours.
HORIZONS_ARC_START = "2015-07-02T04:00:00"


@pytest.fixture
def derived(data_dir):
    folder = data_dir / "spice"
    return [folder / ("generic" if name.endswith("tls") else "derived") / name for name in DERIVED]


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("target", "center", "start", "tolerance_km"),
    [
        (-98, 0, HORIZONS_ARC_START, 1.0),
        (-98, 9, HORIZONS_ARC_START, 1.0),
        (9, 0, "2015-06-30T18:00:00", 1.0),
        (10, 0, "2015-06-30T18:00:00", 1.0),
        (399, 0, "2015-06-30T18:00:00", 1.0),
        (999, 9, "2015-06-30T18:00:00", 0.1),
        (901, 999, "2015-06-30T18:00:00", 0.1),
        (902, 9, "2015-06-30T18:00:00", 0.5),
        (903, 9, "2015-06-30T18:00:00", 0.5),
    ],
)
def test_trajectories_reproduce_their_sources(metakernel, derived, target, center, start, tolerance_km):
    with KernelSet(metakernel):
        times = np.arange(et_from_utc(start), et_from_utc("2015-07-13T12:00:00"), 1234.5)
        ours = [state(target, t, center) for t in times]
    with KernelSet(derived):
        source = [state(target, t, center) for t in times]
    error_km = [np.linalg.norm(a.position_km - b.position_km) for a, b in zip(ours, source, strict=True)]
    error_km_s = [
        np.linalg.norm(a.velocity_km_s - b.velocity_km_s) for a, b in zip(ours, source, strict=True)
    ]
    assert max(error_km) < tolerance_km
    assert max(error_km_s) < 1e-5


@pytest.mark.realdata
def test_first_day_is_the_same_orbit_without_the_maneuver(metakernel, derived):
    """Before the Horizons arc, our orbit must be ballistic: gravity of Sun, planets and Pluto alone."""
    with KernelSet([*derived, metakernel.with_name("pluto_approach_spacecraft.bsp")], extra=[]):
        gm = {10: 1.3271244004e11, 5: 1.26712764e8, 6: 3.7940584e7, 7: 5.794556e6, 8: 6.8365e6, 9: 975.5}
        for et in np.linspace(et_from_utc("2015-07-01T00:00:00"), et_from_utc("2015-07-03T00:00:00"), 9):
            step_s = 3600.0
            v0, v1 = (state(-98, et + h, 0).velocity_km_s for h in (-step_s, step_s))
            pulls = [
                g * r / np.linalg.norm(r) ** 3
                for g, r in ((g, state(b, et, -98).position_km) for b, g in gm.items())
            ]
            assert (v1 - v0) / (2 * step_s) == pytest.approx(np.sum(pulls, axis=0), abs=2e-11)


@pytest.mark.realdata
def test_frames_and_clock_agree_with_the_flight_kernels(metakernel, data_dir):
    generic = data_dir / "spice" / "generic"
    epochs = ("2015-07-01T00:00:00", "2015-07-05T00:00:00", *PAPER_EPOCHS, "2015-07-13T12:00:00")
    pairs = (("NH_SPACECRAFT", "NH_LORRI_1X1"), ("NH_LORRI_1X1", "NH_LORRI_4X4"))
    pool = [
        f"INS-9830{i}_{n}"
        for i in (1, 2)
        for n in ("OOC_KMAT", "OOC_EM", "OOC_CCD_CENTER", "OOC_FOCAL_LENGTH")
    ]

    def look():
        clocks = [spiceypy.scencd(-98, sclk_from_et(-98, et_from_utc(utc))) for utc in epochs]
        matrices = [spiceypy.pxform(a, b, et_from_utc(epochs[0])) for a, b in pairs]
        fields = [spiceypy.getfov(i, 9)[4] for i in (-98301, -98302)]
        return np.array(clocks), matrices, fields, [spiceypy.gdpool(name, 0, 9) for name in pool]

    with KernelSet(metakernel):
        ours = look()
    flight = ("naif0012.tls", "new_horizons_1454.tsc", "nh_v220.tf", "nh_lorri_v201.ti")
    with KernelSet([generic / name for name in flight]):
        theirs = look()
    assert np.abs(ours[0] - theirs[0]).max() <= 10  # ticks of 20 microseconds
    for a, b in zip([*ours[1], *ours[2], *ours[3]], [*theirs[1], *theirs[2], *theirs[3]], strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-13)
