"""States, attitudes, times and instrument values against the made-up mission, astropy and closed formulas."""

import numpy as np
import pytest
import spiceypy
from astropy.time import Time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import (
    KernelSet,
    body_attitude,
    body_frame,
    body_id,
    body_name,
    body_radii_km,
    camera_attitude,
    et_from_sclk,
    et_from_utc,
    instrument_values,
    sclk_from_et,
    state,
    utc_from_et,
)

pytestmark = pytest.mark.usefixtures("empty_pool")
LIGHT_KM_S = 299792.458
TICK_S = 1.0 / 65536.0
NAIF_TDB_ERROR_S = 5e-5  # SPICE's one-term formula against the full series that astropy uses
SHARED = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=100
)


# ---------- states


def test_geometric_states_are_those_that_were_written(toy):
    with KernelSet(toy.files):
        found = state("TOYBODY", 123.0, "TOYCRAFT")
        by_number = state(2999999, 123.0, -999)
    assert_allclose(found.position_km, toy.body_km(123.0) - toy.craft_km(123.0), rtol=0, atol=1e-9)
    assert_allclose(found.velocity_km_s, [-11.0, -1.0, 1.5], rtol=0, atol=1e-12)
    assert_allclose(found.light_time_s, np.linalg.norm(found.position_km) / LIGHT_KM_S, rtol=1e-15)
    assert np.array_equal(found.position_km, by_number.position_km)
    assert not found.position_km.flags.writeable


@pytest.mark.parametrize(("correction", "tolerance_s"), [("CN", 1e-9), ("LT", 1e-4)])
def test_light_time_solves_its_equation(toy, correction, tolerance_s):
    et = 50.0
    with KernelSet(toy.files):
        found = state("TOYBODY", et, "TOYCRAFT", correction=correction)
    seen = toy.body_km(et - found.light_time_s) - toy.craft_km(et)
    assert abs(np.linalg.norm(seen) / LIGHT_KM_S - found.light_time_s) < tolerance_s
    assert_allclose(found.position_km, seen, rtol=0, atol=1e-4)


def test_stellar_aberration_turns_towards_the_observers_velocity(toy):
    """First-order shift v/c sin(angle), here up to 3.5e-5 rad; second order is 1e-9 rad."""
    with KernelSet(toy.files):
        seen, apparent = (
            state("TOYBODY", 50.0, "TOYCRAFT", correction=c).position_km for c in ("CN", "CN+S")
        )
    u = seen / np.linalg.norm(seen)
    velocity = np.array([10.0, 3.0, -1.0])
    expected = u + (velocity - u * (u @ velocity)) / LIGHT_KM_S
    assert_allclose(
        apparent / np.linalg.norm(apparent), expected / np.linalg.norm(expected), rtol=0, atol=2e-9
    )


def test_states_in_another_frame(toy):
    """x axis at RA 120 deg, as in the attitude of that body below."""
    c, s = np.cos(np.radians(120.0)), np.sin(np.radians(120.0))
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    with KernelSet(toy.files):
        found = state("TOYBODY", 50.0, "TOYCRAFT", frame="TOYBODY_FIXED")
        assert_allclose(found.position_km, turn @ (toy.body_km(50.0) - toy.craft_km(50.0)), rtol=0, atol=1e-8)
        with pytest.raises(
            KernelError, match="without the angular rates that a velocity in TOY_CAMERA needs"
        ):
            state("TOYBODY", 50.0, "TOYCRAFT", frame="TOY_CAMERA")


def test_radii_names_and_numbers(toy):
    with KernelSet(toy.files):
        assert body_radii_km("TOYBODY").tolist() == [30.0, 20.0, 10.0]
        assert body_radii_km(2999999).tolist() == [30.0, 20.0, 10.0]
        assert body_id("toycraft") == body_id("-999") == body_id(-999) == -999
        assert body_name(-999) == "TOYCRAFT"
        assert body_name(-98765) == "-98765"
        assert body_name(2**40) == str(2**40)
    assert body_id("PLUTO") == 999
    with pytest.raises(KernelError, match="unknown"):
        body_id("TOYCRAFT")  # its FK is gone
    with pytest.raises(KernelError, match="unknown"):
        body_id(2**40)


# ---------- attitudes


@pytest.mark.parametrize("et", [0.5, 33.3, 99.0, 250.0])
def test_camera_attitude_takes_j2000_to_the_camera(toy, et):
    camera_from_bus = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    with KernelSet(toy.files):
        found = camera_attitude("TOY_CAMERA", et)
    # Between the records the CK turns evenly; clock rounding is 1.5e-5 s at 0.01 rad/s.
    assert_allclose(found, camera_from_bus @ toy.bus_from_j2000(et), rtol=0, atol=2e-7)
    assert not found.flags.writeable


def test_body_attitude_takes_the_frame_tied_to_the_body(toy):
    """Pole at declination 90 deg, prime meridian 30 deg from the node at RA 90 deg: x axis at RA 120 deg."""
    with KernelSet(toy.files):
        assert body_frame("TOYBODY") == "TOYBODY_FIXED"
        assert body_frame("PLUTO") == "IAU_PLUTO"
        found = body_attitude("TOYBODY", 77.0)
    c, s = np.cos(np.radians(120.0)), np.sin(np.radians(120.0))
    assert_allclose(found, [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], rtol=0, atol=1e-15)


def test_a_frame_named_after_the_body_will_do(toy, tmp_path):
    """A numbered body whose IAU frame no kernel ties to it."""
    frame = tmp_path / "iau.tf"
    frame.write_text(
        "KPL/FK\n\\begindata\nNAIF_BODY_NAME += 'TOY MOON'\nNAIF_BODY_CODE += 2999998\n"
        "FRAME_IAU_TOY_MOON = 1999998\nFRAME_1999998_NAME = 'IAU_TOY_MOON'\nFRAME_1999998_CLASS = 2\n"
        "FRAME_1999998_CLASS_ID = 2999998\nFRAME_1999998_CENTER = 2999999\nBODY2999998_POLE_RA = 0\n"
        "BODY2999998_POLE_DEC = 90\nBODY2999998_PM = 0\n\\begintext\n"
    )
    with KernelSet([*toy.files, frame]):
        assert body_frame("TOY MOON") == "IAU_TOY_MOON"
        assert_allclose(body_attitude("TOY MOON", 0.0)[0], [0.0, 1.0, 0.0], rtol=0, atol=1e-15)


# ---------- times


@pytest.mark.parametrize(
    "utc",
    [
        "2015-07-14T11:49:57",
        "2007-02-28T13:14:22.331",
        "2016-12-31T23:59:60.5",
        "1998-12-31T23:59:59.9",
        "2025-03-20",
    ],
)
def test_et_agrees_with_astropy(toy, utc):
    with KernelSet(toy.lsk):
        et = et_from_utc(utc)
    expected = (Time(utc, scale="utc").tdb - Time("2000-01-01T12:00:00", scale="tdb")).sec
    assert abs(et - expected) < NAIF_TDB_ERROR_S


def test_all_ways_to_write_a_utc_mean_the_same(toy):
    with KernelSet(toy.lsk):
        times = {
            et_from_utc(text)
            for text in (
                "2007-02-28T13:14:22.4",
                "2007-02-28T13:14:22.4Z",
                "2007-02-28T13:14:22.4z",
                "2007-02-28 13:14:22.4 UTC",
                "2007-02-28T13:14:22.400+00:00",
                "2007-059T13:14:22.4",
                "2007-059T13:14:22.4Z",
                "2007 FEB 28 13:14:22.4",
                " 2007-02-28T13:14:22.4 ",
            )
        }
    assert len(times) == 1


@pytest.mark.slow
@given(et=st.floats(-3e8, 1.5e9))
@SHARED
def test_utc_returns_to_et(toy, et):
    with KernelSet(toy.lsk):
        assert abs(et_from_utc(utc_from_et(et, 6)) - et) < 1.5e-6


def test_utc_digits(toy):
    with KernelSet(toy.lsk):
        et = et_from_utc("2015-07-14T11:49:57.123456")
        assert utc_from_et(et) == "2015-07-14T11:49:57.123"
        assert utc_from_et(et, 0) == "2015-07-14T11:49:57"
        assert utc_from_et(et, 6) == "2015-07-14T11:49:57.123456"


@given(et=st.floats(-9e5, 1e9))
@SHARED
def test_clock_readings_return_to_et(toy, et):
    with KernelSet(toy.files):
        reading = sclk_from_et(-999, et)
        assert abs(et_from_sclk(-999, reading) - et) <= TICK_S
    assert reading.startswith("1/")


def test_clock_readings_follow_the_clocks_definition(toy):
    """Counts of 1 s from et = -1e6, 65536 subcounts each; partitions may be left out."""
    with KernelSet(toy.files):
        assert sclk_from_et(-999, 0.25) == "1/0001000000:16384"
        assert abs(et_from_sclk(-999, "1/1000000:16384") - 0.25) < 1e-9
        assert abs(et_from_sclk(-999, "1000000:16384") - 0.25) < 1e-9


# ---------- instruments


def test_instrument_values_are_all_of_one_instrument(toy):
    with KernelSet(toy.files):
        values = instrument_values(-999100)
    assert dict(values) == {"INS-999100_FOV_FRAME": ("TOY_CAMERA",), "INS-999100_PIXELS": (1024.0, 512.0)}
    with pytest.raises(TypeError):
        values["INS-999100_PIXELS"] = (1.0,)


def test_more_pool_names_than_one_page(toy, tmp_path, monkeypatch):
    monkeypatch.setattr("opnav_workbench.kernels.pool.NAMES_PER_CALL", 7)
    ik = tmp_path / "big.ti"
    ik.write_text(
        "KPL/IK\n\\begindata\n" + "".join(f"INS-7_V{i} = {i}\n" for i in range(21)) + "\\begintext\n"
    )
    with KernelSet(ik):
        assert len(instrument_values(-7)) == 21
        assert spiceypy.expool("INS-7_V20")
