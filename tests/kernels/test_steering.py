"""Pointing plans through SPICE: where the aim falls on the detector, how fast the camera turns, and where nothing is."""

from datetime import datetime, timedelta

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.geometry import pointing_angles, rotation_from_vector, unit_from_radec
from opnav_workbench.kernels import KernelSet, camera_attitude, make_kernels
from opnav_workbench.kernels.making.scenario import load_scenario

PIXEL_RAD = 1e-4
FOCAL = np.diag([1.0, 1.0, -1.0])
BETWEEN_RAD = 1.1e-9  # the default tolerance between attitudes, and rounding
RATE_TOLERANCE_RAD_S = 1e-11
ROCK = {"track": ["TEST ROCK"], "twist_deg": 30.0}
FIXED = {"ra_deg": 200.0, "dec_deg": -40.0, "twist_deg": 75.0}


def window(start, length_s, **fields):
    begin = datetime.fromisoformat(f"2031-03-01T{start}")
    return {"start": begin.isoformat(), "end": (begin + timedelta(seconds=length_s)).isoformat()} | fields


def times(start, length_s, n=41):
    first = spiceypy.str2et(f"2031-03-01T{start}")
    return np.linspace(first, first + length_s, n)


def seen_px(body, et):
    """Where a body appears, px from the boresight, with SPICE's own calls only."""
    apparent, _ = spiceypy.spkpos(body, et, "J2000", "CN+S", "ROCK PROBE")
    return tangents(apparent, et)


def tangents(direction, et):
    a, b, c = FOCAL @ spiceypy.pxform("J2000", "RP_NAVCAM", et) @ direction
    return np.array([a, b]) / c / PIXEL_RAD


def ck_rate(et):
    _, rate, _ = spiceypy.ckgpav(-999000, spiceypy.sce2c(-999, et), 0.0, "J2000")
    return rate


@pytest.fixture
def built(tmp_path, probe):
    """Return a function that makes kernels of windows and opens them."""
    opened = []

    def make(*windows):
        opened.append(KernelSet(make_kernels(probe(*windows), tmp_path)))
        return opened[-1].__enter__()

    yield make
    for kernels in opened:
        kernels.__exit__(None, None, None)


# -- aims ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=["offset1"])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (120.0, -300.0)])
def test_tracked_target_stays_where_it_should(built, offset):
    built(window("11:20:00", 3600.0, offset_px=offset, **ROCK))
    for et in times("11:20:00", 3600.0, 101):  # through the nearest point at noon, and between attitudes
        np.testing.assert_allclose(seen_px("TEST ROCK", et), offset, atol=BETWEEN_RAD / PIXEL_RAD)
        angles = pointing_angles(camera_attitude("RP_NAVCAM", et), FOCAL)
        assert angles[2] == pytest.approx(np.radians(30.0), abs=2 * BETWEEN_RAD)


def test_several_targets_are_held_in_the_middle(built):
    built(window("10:00:00", 600.0, track=["TEST ROCK", "TEST MOON"]))
    for et in times("10:00:00", 600.0, 7):
        seen = [spiceypy.spkpos(b, et, "J2000", "CN+S", "ROCK PROBE")[0] for b in ("TEST ROCK", "TEST MOON")]
        middle = sum(v / np.linalg.norm(v) for v in seen)
        np.testing.assert_allclose(tangents(middle, et), 0.0, atol=BETWEEN_RAD / PIXEL_RAD)


def test_fixed_direction_needs_few_attitudes(built):
    kernels = built(window("01:00:00", 3600.0, **FIXED))
    for et in times("01:00:00", 3600.0, 9):
        angles = pointing_angles(camera_attitude("RP_NAVCAM", et), FOCAL)
        assert np.degrees(angles) == pytest.approx([200.0, -40.0, 75.0], abs=1e-10)
        assert ck_rate(et) == pytest.approx(np.zeros(3), abs=1e-18)
    ck = next(p for p in kernels.paths if p.suffix == ".bc")
    assert ck.stat().st_size < 20_000


def test_near_target_does_not_ask_for_more_than_rounding_allows(tmp_path, probe):
    """At 5 km, SPICE's light times jump the target by 1e-6 rad: the tolerance must not be sought below that."""
    scenario = probe(window("12:00:00", 600.0, **ROCK))
    rows = [
        ["2031-02-28T12:00:00", 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        ["2031-03-02T12:00:00", 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
    scenario["trajectories"][2]["rows"] = rows
    with KernelSet(make_kernels(scenario, tmp_path)):
        assert np.abs(seen_px("TEST ROCK", times("12:00:00", 600.0)[7])).max() * PIXEL_RAD < 5e-6


# -- rates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=["track", "scan"])
@pytest.mark.parametrize(
    "plan",
    [
        ROCK,
        FIXED | {"scan": {"rate_deg_s": 0.02, "direction": [1.0, 2.0]}},
        ROCK | {"scan": {"rate_deg_s": 0.01, "position_angle_deg": 200.0, "start_px": [50.0, 80.0]}},
        ROCK | {"mosaic": {"columns": 3, "rows": 2, "dwell_s": 60.0, "slew_s": 40.0}},
    ],
    ids=["track", "scan", "scan of target", "mosaic"],
)
def test_rates_are_the_motion_of_the_attitude(built, plan):
    """SPICE's own rates from the CK against differences of attitudes; both ends and kinks of a slew included."""
    built(window("11:50:00", 900.0, **plan))
    h = 0.5
    slews = "mosaic" in plan
    for et in times("11:50:00", 900.0, 37)[1:-1]:
        before, after = (spiceypy.pxform("J2000", "RP_BUS", et + d) for d in (-h, h))
        mean = spiceypy.raxisa(after.T @ before)
        mean = np.array(mean[0]) * mean[1] / (2 * h)
        # Curvature of the motion over h: a slew of 0.1 rad in 40 s jerks by 60 * 0.1 / 40^3 rad/s^3.
        tolerance = 60 * 0.1 / 40**3 * h**2 + 1e-6 / h if slews else 2e-9 / h
        assert ck_rate(et) == pytest.approx(mean, abs=tolerance)


def test_rates_of_tracking_against_differences_of_spice_directions(built):
    """The turn of the line of sight itself, by SPICE positions: rates to 1e-11 rad/s, at the ends too."""
    built(window("11:30:00", 3600.0, track=["TEST ROCK"], twist_deg=0.0))

    def direction(et):
        v, _ = spiceypy.spkpos("TEST ROCK", et, "J2000", "CN+S", "ROCK PROBE")
        return v / np.linalg.norm(v)

    for et in times("11:30:00", 3600.0, 9):
        h = 4.0
        slope = (
            8 * (direction(et + h) - direction(et - h)) - direction(et + 2 * h) + direction(et - 2 * h)
        ) / (12 * h)
        across = np.cross(direction(et), slope)
        rate = ck_rate(et)
        rate = rate - direction(et) * (
            rate @ direction(et)
        )  # the roll that keeps the twist is another matter
        # Between attitudes SPICE's rates are linear; at the ends and at attitudes they are exact.
        assert rate == pytest.approx(
            across, abs=RATE_TOLERANCE_RAD_S + 2e-10 * (et not in times("11:30:00", 3600.0, 2))
        )


# -- patterns ------------------------------------------------------------------------------------------------------


def test_mosaic_dwells_on_its_grid(built):
    plan = {"columns": 3, "rows": 2, "overlap": 0.1, "dwell_s": 30.0, "slew_s": 20.0}
    built(window("12:00:00", 400.0, mosaic=plan, offset_px=(10.0, -20.0), **ROCK))
    start = times("12:00:00", 1.0)[0]
    steps = 0.9 * 1000, 0.9 * 800
    grid = [(-1, -0.5), (0, -0.5), (1, -0.5), (1, 0.5), (0, 0.5), (-1, 0.5)]  # there and back
    for number, (column, row) in enumerate(grid):
        for part in (0.0, 0.4, 1.0):
            place = seen_px("TEST ROCK", start + 50.0 * number + 30.0 * part)
            expected = moved((10.0, -20.0), (column * steps[0], row * steps[1]))
            np.testing.assert_allclose(place, expected, atol=3 * BETWEEN_RAD / PIXEL_RAD)
    last = seen_px("TEST ROCK", start + 399.9)  # held to the window's end
    np.testing.assert_allclose(last, expected, atol=3 * BETWEEN_RAD / PIXEL_RAD)


def moved(place, offset):
    """Where a place goes when the boresight's sky goes to `offset` without roll: independent of the package."""
    angle = np.arctan(np.hypot(*offset) * PIXEL_RAD)
    toward = np.array([*offset, 0.0]) / (np.hypot(*offset) or 1.0)
    axis = np.cross([0.0, 0.0, 1.0], toward)
    x, y, z = (
        spiceypy.axisar(axis, angle) @ [*np.multiply(place, PIXEL_RAD), 1.0]
        if angle
        else [*np.multiply(place, PIXEL_RAD), 1.0]
    )
    return np.array([x, y]) / z / PIXEL_RAD


def test_raster_starts_each_row_anew_and_detectors_touch_without_overlap():
    from opnav_workbench.kernels.making.scenario import Mosaic

    mosaic = Mosaic(columns=2, rows=2, dwell_s=1.0, slew_s=1.0, order="raster")
    assert list(mosaic.places_px(1000, 800)) == [(-500, -400), (500, -400), (-500, 400), (500, 400)]


def test_list_of_offsets_and_slews_at_rest_at_both_ends(built):
    offsets = {"list_px": [[0.0, 0.0], [800.0, 0.0], [0.0, -600.0]], "dwell_s": 100.0, "slew_s": 40.0}
    built(window("03:00:00", 400.0, offsets=offsets, **FIXED))
    aim, start = unit_from_radec(np.radians(200.0), np.radians(-40.0)), times("03:00:00", 1.0)[0]
    for number, place in enumerate(offsets["list_px"]):
        np.testing.assert_allclose(tangents(aim, start + 140.0 * number + 50.0), place, atol=1e-8)
        assert ck_rate(start + 140.0 * number + 50.0) == pytest.approx(np.zeros(3), abs=1e-15)
    middle = start + 120.0  # quintic: half way, at 15/8 of the mean rate
    angle = np.arctan(0.08)
    np.testing.assert_allclose(
        tangents(aim, middle), [np.tan(angle / 2) / PIXEL_RAD, 0.0], atol=1e-6 / PIXEL_RAD
    )
    assert np.linalg.norm(ck_rate(middle)) == pytest.approx(15 / 8 * angle / 40.0, rel=1e-4)
    for et in (start + 100.0, start + 140.0):
        assert np.linalg.norm(ck_rate(et)) < 1e-6


@pytest.mark.parametrize("direction", [[1.0, 0.0], [-3.0, 4.0]])
def test_scan_on_the_detector(built, direction):
    """Fixed aim: it goes evenly along a great circle from the start offset, at exactly the rate."""
    scan = {"rate_deg_s": 0.05, "direction": direction, "start_px": [-100.0, 30.0]}
    built(window("04:00:00", 120.0, scan=scan, **FIXED))
    aim = unit_from_radec(np.radians(200.0), np.radians(-40.0))
    start = times("04:00:00", 1.0)[0]
    np.testing.assert_allclose(tangents(aim, start), [-100.0, 30.0], atol=1e-9)
    first = spiceypy.pxform("J2000", "RP_NAVCAM", start)
    toward = FOCAL.T @ [*np.array(direction) / np.hypot(*direction), 0.0]
    axis = np.cross([0.0, 0.0, -1.0], toward)
    for et in start + np.array([0.0, 13.0, 60.0, 120.0]):
        turned = rotation_from_vector(axis * np.radians(0.05) * (et - start)) @ first
        assert np.abs(turned - spiceypy.pxform("J2000", "RP_NAVCAM", et)).max() < 1e-9
        assert np.linalg.norm(ck_rate(et)) == pytest.approx(np.radians(0.05), rel=1e-9)


@pytest.mark.slow(keep=["False-0.0", "False-222.0"])
@pytest.mark.parametrize("angle", [0.0, 90.0, 222.0])
@pytest.mark.parametrize("mirrored", [True, False])
def test_scan_on_the_sky_moves_the_boresight_toward_its_position_angle(tmp_path, probe, angle, mirrored):
    scenario = probe(
        window("04:00:00", 60.0, scan={"rate_deg_s": 0.02, "position_angle_deg": angle}, **FIXED)
    )
    focal = np.diag([1.0, 1.0, -1.0 if mirrored else 1.0])
    scenario["instruments"][0]["focal_from_camera"] = focal.tolist()
    with KernelSet(make_kernels(scenario, tmp_path)):
        start = times("04:00:00", 1.0)[0]
        (ra0, dec0, _), (ra, dec, _) = (
            pointing_angles(camera_attitude("RP_NAVCAM", et), focal) for et in (start, start + 1.0)
        )
    moved_deg = np.degrees([(ra - ra0) * np.cos(dec0), dec - dec0])
    expected = 0.02 * np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    assert moved_deg == pytest.approx(expected, abs=1e-5)  # second order over 0.02 deg


def test_scan_over_the_pole(built):
    scan = {"rate_deg_s": 0.1, "direction": [0.0, -1.0]}
    built(window("05:00:00", 300.0, ra_deg=10.0, dec_deg=85.0, scan=scan))
    rates = [np.linalg.norm(ck_rate(et)) for et in times("05:00:00", 300.0, 13)]
    assert rates == pytest.approx([np.radians(0.1)] * 13, rel=1e-9)


# -- gaps ----------------------------------------------------------------------------------------------------------


def test_no_attitude_in_a_gap(built):
    built(window("01:00:00", 600.0, **FIXED), window("01:20:00", 600.0, **ROCK))
    camera_attitude("RP_NAVCAM", times("01:00:00", 600.0)[-1])
    with pytest.raises(
        KernelError, match=r"outside the loaded CKs of RP_BUS.*which cover 2031-03-01T01:00:00"
    ) as caught:
        camera_attitude("RP_NAVCAM", times("01:10:00", 600.0)[20])
    assert "\n" not in str(caught.value)


def test_windows_that_touch_keep_their_own_attitudes(built):
    built(window("01:00:00", 600.0, **FIXED), window("01:10:00", 600.0, **ROCK))
    edge = times("01:10:00", 1.0)[0]
    aim = unit_from_radec(np.radians(200.0), np.radians(-40.0))
    np.testing.assert_allclose(tangents(aim, edge - 0.0013), 0.0, atol=1e-6)
    np.testing.assert_allclose(seen_px("TEST ROCK", edge), 0.0, atol=1e-6)
    np.testing.assert_allclose(seen_px("TEST ROCK", edge + 1.0), 0.0, atol=BETWEEN_RAD / PIXEL_RAD)


def test_given_step_is_kept(built):
    kernels = built(window("01:00:00", 600.0, step_s=7.0, **ROCK))
    ck = next(p for p in kernels.paths if p.suffix == ".bc")
    handle = spiceypy.dafopr(str(ck))
    spiceypy.dafbfs(handle)
    spiceypy.daffna()
    _, integers = spiceypy.dafus(spiceypy.dafgs(), 2, 6)
    n_intervals, n = spiceypy.dafgda(handle, int(integers[5]) - 1, int(integers[5]))
    spiceypy.dafcls(handle)
    assert (n_intervals, n) == (1, 89)  # 0, 7, ... 595, 600, and both ends widened


# -- what cannot be ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"mosaic": {"columns": 3, "rows": 3, "dwell_s": 60, "slew_s": 60}}, "9 places need 1020 s, the window has 600 s"),
        ({"mosaic": {"columns": 0, "rows": 3, "dwell_s": 1, "slew_s": 1}}, "mosaic.columns: "),
        ({"mosaic": {"columns": 999, "rows": 999, "dwell_s": 1, "slew_s": 1}}, "999 x 999 places; 10000 at most"),
        ({"mosaic": {"columns": 1, "rows": 1, "dwell_s": 1, "slew_s": 1, "overlap": 1.0}}, "overlap: "),
        ({"offsets": {"list_px": [], "dwell_s": 1, "slew_s": 1}}, "offsets.list_px: "),
        ({"scan": {"rate_deg_s": 1.0}}, "give either direction"),
        ({"scan": {"rate_deg_s": 1.0, "direction": [0, 0]}}, "points nowhere"),
        ({"scan": {"rate_deg_s": 0.0, "direction": [1, 0]}}, "scan.rate_deg_s: "),
        (
            {"scan": {"rate_deg_s": 1.0, "direction": [1, 0]}, "offsets": {"list_px": [[0, 0]], "dwell_s": 1, "slew_s": 1}},
            "give one of mosaic, offsets and scan",
        ),
        ({"step_s": 0.0}, "step_s: "),
    ],
)  # fmt: skip
def test_plans_that_are_wrong_name_the_field(probe, fields, message):
    with pytest.raises(MissionError, match=message) as caught:
        load_scenario(probe(window("01:00:00", 600.0, **FIXED, **fields)))
    assert "\n" not in str(caught.value)
    assert "pointing.windows.0" in str(caught.value)


def test_tolerance_that_no_file_can_keep(tmp_path, probe):
    mosaic = {"columns": 2, "rows": 1, "dwell_s": 100.0, "slew_s": 0.001}
    with pytest.raises(MissionError, match=r"pointing.windows.0: the attitude turns too fast"):
        make_kernels(probe(window("01:00:00", 300.0, mosaic=mosaic, **FIXED)), tmp_path)
    assert not list(tmp_path.iterdir())
