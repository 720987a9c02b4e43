"""Scenario to kernels: a made-up mission read back through SPICE, and scenario files that are wrong."""

import copy
import json
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import erfa
import numpy as np
import pytest
import spiceypy
import yaml
from hypothesis import given
from hypothesis import strategies as st

from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import KernelError, MissionError, OpNavError
from opnav_workbench.geometry.aiming import aim
from opnav_workbench.kernels import (
    KernelSet,
    camera_attitude,
    et_from_sclk,
    et_from_utc,
    instrument_values,
    sclk_from_et,
    state,
)
from opnav_workbench.kernels.making.make import make_kernels
from opnav_workbench.kernels.making.scenario import load_scenario
from opnav_workbench.kernels.time import et_from_tdb_datetime

PIXEL_RAD = 10e-6 / 0.1
ATTITUDE_TOLERANCE_RAD = 1e-12
MINI = {
    "mission": "rock_probe",
    "name": "orbit",
    "description": "A made-up probe about a made-up rock.",
    "span": {"start": "2031-03-01T00:00:00", "end": "2031-03-02T00:00:00"},
    "spacecraft": {
        "name": "ROCK PROBE", "id": -999, "aliases": ["RP"], "frame": {"name": "RP_BUS", "id": -999000},
    },
    "clock": {"id": -999, "start": "2031-01-01T00:00:00", "subcounts": 256},
    "frames": [
        {
            "name": "RP_NAVCAM", "id": -999100, "relative_to": "RP_BUS",
            "matrix": [[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]],
        }
    ],
    "instruments": [
        {
            "name": "RP_NAVCAM", "id": -999100, "frame": "RP_NAVCAM", "focal_length_mm": 100.0,
            "pixel_size_um": 10.0, "n_pixel": 1000, "n_line": 800,
        }
    ],
    "bodies": [
        {
            "name": "TEST ROCK", "id": 3999999, "source": "made up", "radii_km": [0.3, 0.28, 0.25],
            "gm_km3_s2": 5e-9,
            "pole_ra_deg": [86.0], "pole_dec_deg": [-60.0], "prime_meridian_deg": [140.0, 2011.0],
            "frame": {"name": "TEST_ROCK_FIXED", "id": 3999001},
        },
        {"name": "SUN", "id": 10, "source": "none"},
    ],
    "trajectories": [
        {"kind": "epv00", "target": 10},
        {"kind": "epv00", "target": 399},
        {
            "kind": "kepler", "target": "TEST ROCK", "center": "SUN", "source": "made up",
            "epoch": "2031-03-01T00:00:00", "gm_km3_s2": 1.32712440018e11, "periapsis_km": 1.3e8,
            "eccentricity": 0.2, "inclination_deg": 6.0, "node_deg": 2.0, "argument_deg": 66.0,
            "mean_anomaly_deg": 100.0,
        },
        {
            "kind": "kepler", "target": "RP", "center": "TEST ROCK", "source": "made up",
            "epoch": "2031-03-01T00:00:00", "gm_km3_s2": 5e-9, "periapsis_km": 1.0,
            "eccentricity": 0.3, "inclination_deg": 90.0, "node_deg": 10.0, "argument_deg": 0.0,
            "mean_anomaly_deg": 0.0,
        },
    ],
    "pointing": {
        "instrument": "RP_NAVCAM",
        "actual": {"shift_px": [12.5, -7.25], "twist_deg": 0.4},
        "windows": [
            {
                "start": "2031-03-01T01:00:00", "end": "2031-03-01T02:00:00", "step_s": 60.0,
                "track": ["TEST ROCK"], "twist_deg": 30.0, "offset_px": [100.0, -50.0],
            },
            {
                "start": "2031-03-01T02:00:30", "end": "2031-03-01T03:00:00",
                "ra_deg": 123.0, "dec_deg": -45.0, "twist_deg": 200.0,
            },
        ],
    },
}  # fmt: skip


def changed(path: str, value) -> dict:
    """The scenario with one field set; the value ... removes it."""
    scenario = copy.deepcopy(MINI)
    place = scenario
    *parents, last = [int(p) if p.isdigit() else p for p in path.split(".")]
    for part in parents:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return scenario


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    return make_kernels(MINI, tmp_path_factory.mktemp("mini") / "kernels", actual=True)


@pytest.fixture
def loaded(built):
    with KernelSet(built) as kernels:
        yield kernels


def test_all_kinds_are_there_and_loaded(loaded, built):
    kinds = [k.kind for k in loaded.kernels() if k.kind != "META"]
    assert sorted(kinds) == sorted(["LSK", "PCK", "FK", "IK", "SCLK", "SPK", "SPK", "CK"])
    assert not [p for p in built.parent.iterdir() if p.name.startswith(".")]
    assert not [k for k in loaded.kernels() if "actual" in k.path.name]


def test_times(loaded):
    start = et_from_utc("2031-01-01T00:00:00")
    assert sclk_from_et(-999, start + 100.5) == "1/0000000100:128"
    assert et_from_sclk(-999, "1/0000000100:128") == pytest.approx(start + 100.5, abs=1e-6)


def test_tdb_needs_no_leap_seconds(loaded):
    moment = datetime.fromisoformat("2031-03-01T12:34:56.789")
    assert et_from_tdb_datetime(moment) == pytest.approx(
        spiceypy.str2et("2031 MAR 01 12:34:56.789 TDB"), abs=1e-6
    )


def test_sun_and_earth_follow_the_series(loaded):
    et = et_from_utc("2031-03-01T13:00:00")
    heliocentric, barycentric = erfa.epv00(2451545.0, et / 86400.0)
    earth_from_sun_km = state(399, et, 10).position_km
    assert np.linalg.norm(earth_from_sun_km - heliocentric["p"] * AU_KM) < 1e-3
    assert np.linalg.norm(state(399, et, 0).position_km - barycentric["p"] * AU_KM) < 1e-3
    assert np.linalg.norm(state(399, et, 0).velocity_km_s - barycentric["v"] * AU_KM / 86400.0) < 1e-9


@pytest.mark.parametrize(
    ("index", "target", "center", "tolerance_km"), [(2, 3999999, 10, 1e-3), (3, -999, 3999999, 1e-6)]
)
def test_kepler_orbits_between_nodes(loaded, index, target, center, tolerance_km):
    t = MINI["trajectories"][index]
    epoch = spiceypy.str2et("2031 MAR 01 00:00:00 TDB")
    angles = np.radians([t["inclination_deg"], t["node_deg"], t["argument_deg"], t["mean_anomaly_deg"]])
    elements = [t["periapsis_km"], t["eccentricity"], *angles, epoch, t["gm_km3_s2"]]
    for et in epoch + np.linspace(0.0, 86400.0, 97):
        truth = spiceypy.conics(elements, et)
        got = state(target, et, center)
        assert np.linalg.norm(got.position_km - truth[:3]) < tolerance_km
        assert np.linalg.norm(got.velocity_km_s - truth[3:]) < tolerance_km / 60.0


def test_target_stands_where_the_plan_puts_it(loaded):
    for utc in ("2031-03-01T01:00:00", "2031-03-01T01:30:00", "2031-03-01T02:00:00"):
        x, y, z = state("TEST ROCK", et_from_utc(utc), "RP", "RP_NAVCAM", "CN+S").position_km
        # 1e-2 px: the rock is 1.5 km away, and SPICE's light time is rounded to 6e-8 s, in which it moves 2e-6 km
        assert [x / z / PIXEL_RAD, y / z / PIXEL_RAD] == pytest.approx([100.0, -50.0], abs=1e-2)


def test_fixed_direction_and_twist(loaded):
    camera = camera_attitude("RP_NAVCAM", et_from_utc("2031-03-01T02:30:00"))
    ra, dec = np.radians([123.0, -45.0])
    assert camera[2] == pytest.approx(spiceypy.radrec(1.0, ra, dec), abs=ATTITUDE_TOLERANCE_RAD)
    north = np.array([0.0, 0.0, 1.0]) - camera[2] * camera[2, 2]
    east = np.cross(north, camera[2])
    position_angle = np.degrees(np.arctan2(camera[1] @ east, camera[1] @ north)) % 360.0
    assert position_angle == pytest.approx(200.0, abs=1e-9)


def test_no_attitude_between_windows_or_outside(loaded):
    for utc in ("2031-03-01T00:59:00", "2031-03-01T02:00:15", "2031-03-01T03:00:30"):
        with pytest.raises(KernelError):
            camera_attitude("RP_NAVCAM", et_from_utc(utc))


def test_actual_attitude_moves_the_sky_as_told(loaded, built):
    et = et_from_utc("2031-03-01T02:30:00")
    predicted = camera_attitude("RP_NAVCAM", et)
    with KernelSet(built.with_name("orbit_actual.tm")):
        actual = camera_attitude("RP_NAVCAM", et)
    x, y, z = actual @ predicted[2]  # the sky at the predicted boresight
    assert [x / z / PIXEL_RAD, y / z / PIXEL_RAD] == pytest.approx([12.5, -7.25], abs=1e-4)
    twists = []
    for camera in (predicted, actual):
        north = np.array([0.0, 0.0, 1.0]) - camera[2] * camera[2, 2]
        twists.append(np.degrees(np.arctan2(camera[1] @ np.cross(north, camera[2]), camera[1] @ north)))
    assert twists[1] - twists[0] == pytest.approx(0.4, abs=1e-9)


FOCAL_AXES = (
    np.eye(3),
    np.diag([1.0, 1.0, -1.0]),
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
)
angles = st.floats(0.0, 6.28)
offsets = st.floats(-0.2, 0.2)  # ten degrees


@given(angles, st.floats(-1.3, 1.3), angles, offsets, offsets, st.sampled_from(FOCAL_AXES))
def test_aim_holds_offset_and_twist(ra, dec, twist, x, y, focal):
    direction = np.array(spiceypy.radrec(7.0, ra, dec))
    attitude = aim(direction, twist, focal, (x, y))
    seen = focal @ attitude @ direction
    assert seen[:2] / seen[2] == pytest.approx([x, y], abs=1e-12)
    _, line, boresight = focal @ attitude
    north = np.array([0.0, 0.0, 1.0]) - boresight * boresight[2]
    position_angle = np.arctan2(line @ np.cross(north, boresight), line @ north)
    assert abs(np.exp(1j * position_angle) - np.exp(1j * twist)) < 1e-12
    assert np.linalg.det(attitude) == pytest.approx(1.0, abs=1e-12)


@given(angles, st.sampled_from([90.0, -90.0, 90.0 - 1e-9, 89.999999]), angles)
def test_aim_at_the_poles(ra, dec, twist):
    direction = np.array(spiceypy.radrec(1.0, ra, np.radians(dec)))
    assert (aim(direction, twist, np.eye(3)) @ direction)[:2] == pytest.approx([0.0, 0.0], abs=1e-14)


def test_plan_that_no_attitude_fulfils(tmp_path):
    window = MINI["pointing"]["windows"][1] | {"dec_deg": 89.999, "twist_deg": 0.0, "offset_px": [400.0, 0.0]}
    with pytest.raises(MissionError, match=r"pointing.windows.1: declination 89.9990 deg cannot be held"):
        make_kernels(changed("pointing.windows.1", window), tmp_path)


def test_camera_body_and_names(loaded):
    values = instrument_values(-999100)
    assert values["INS-999100_PIXEL_SAMPLES"] == (1000,)
    assert values["INS-999100_CCD_CENTER"] == (499.5, 399.5)
    assert spiceypy.bodvrd("TEST ROCK", "RADII", 3)[1].tolist() == [0.3, 0.28, 0.25]
    assert spiceypy.cidfrm(3999999)[1] == "TEST_ROCK_FIXED"
    pole = spiceypy.pxform("J2000", "TEST_ROCK_FIXED", 0.0)[2]
    assert pole == pytest.approx(spiceypy.radrec(1.0, np.radians(86.0), np.radians(-60.0)), abs=1e-14)
    assert [spiceypy.bodn2c(n) for n in ("ROCK PROBE", "RP", "RP_NAVCAM")] == [-999, -999, -999100]


def test_read_in_a_new_process_from_inside_the_folder(built, loaded):
    et = et_from_utc("2031-03-01T01:30:00")
    code = (
        "import json, spiceypy; spiceypy.furnsh('orbit.tm'); et = spiceypy.str2et('2031-03-01T01:30:00');"
        "print(json.dumps([et, spiceypy.pxform('J2000', 'RP_NAVCAM', et).tolist(),"
        " spiceypy.spkpos('TEST ROCK', et, 'J2000', 'CN+S', 'RP')[0].tolist(), spiceypy.sce2s(-999, et)]))"
    )
    arguments = [sys.executable, "-c", code]
    answer = subprocess.run(arguments, check=True, capture_output=True, cwd=built.parent).stdout
    et_there, camera, position, clock = json.loads(answer)
    assert et_there == et
    assert np.abs(np.array(camera) - camera_attitude("RP_NAVCAM", et)).max() < ATTITUDE_TOLERANCE_RAD
    assert np.abs(position - state("TEST ROCK", et, "RP", "J2000", "CN+S").position_km).max() < 1e-6
    assert clock == sclk_from_et(-999, et)


def test_same_scenario_same_bytes_and_old_files_replaced(built, tmp_path):
    again = make_kernels(MINI, tmp_path / "again", actual=True)
    make_kernels(MINI, tmp_path / "again", actual=True)
    names = sorted(p.name for p in built.parent.iterdir())
    assert sorted(p.name for p in again.parent.iterdir()) == names
    for name in names:
        assert (again.parent / name).read_bytes() == (built.parent / name).read_bytes(), name


def test_pool_is_left_as_it_was(built, tmp_path):
    with KernelSet(built):
        before = spiceypy.ktotal("ALL")
        make_kernels(MINI, tmp_path)
        assert spiceypy.ktotal("ALL") == before
        camera_attitude("RP_NAVCAM", et_from_utc("2031-03-01T02:30:00"))


def test_yaml_file_and_mapping_give_the_same_scenario(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(MINI))
    assert load_scenario(path) == load_scenario(MINI)
    unquoted = yaml.safe_dump(MINI).replace("'2031-03-01T01:00:00'", "2031-03-01T03:00:00+02:00")
    path.write_text(unquoted)  # YAML reads it as a time with a zone
    assert load_scenario(path) == load_scenario(MINI)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("mission", ..., "mission: this field is required"),
        ("colour", "red", "colour: unknown field"),
        ("name", "../escape", "name: String should match"),
        ("span.end", "2031-02-01T00:00:00", "span: end 2031-02-01"),
        ("span.start", "yesterday", "span.start: "),
        ("spacecraft.id", 999, "spacecraft.id: Input should be less than 0"),
        ("spacecraft.frame.name", "lower", "spacecraft.frame.name: String should match"),
        ("clock.start", ..., "clock: give either start or correlation"),
        ("clock.subcounts", 0, "clock.subcounts: "),
        ("clock.partitions", [[0, 1000000], [500000, 2000000]], "clock: partitions.1: .* overlaps"),
        ("clock.partitions", [[5, 5]], "clock: partitions.0: .* no interval"),
        ("span.end", 1.9e9, "span.end: .* is a number; write a calendar time"),
        ("instruments.0.distortion", {"model": "owen", "k1": 1.0}, "instruments.0.distortion.*k1: unknown"),
        ("trajectories.2.spk_type", 3, "trajectories.2.spk_type: "),
        ("trajectories.2.start", "2031-04-01T00:00:00", r"trajectories.2 \(TEST ROCK\): start and end leave"),
        ("frames.0.matrix", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "frames.0.matrix: .*mirrors"),
        ("frames.0.matrix.0.0", 7.0, "frames.0.matrix: .*not orthonormal"),
        ("frames.0.relative_to", "ELSEWHERE", "frames.0.relative_to: ELSEWHERE"),
        ("instruments.0.frame", "ELSEWHERE", "instruments.0.frame: ELSEWHERE"),
        ("instruments.0.focal_length_mm", -1.0, "instruments.0.focal_length_mm: Input should be greater"),
        ("instruments.0.keywords", {"bad key": 1.0}, "instruments.0.keywords"),
        (
            "instruments.0.focal_from_camera",
            [[1, 0, 0], [1, 0, 0], [0, 0, 1]],
            "instruments.0.focal_from_camera",
        ),
        ("bodies.0.radii_km", [1.0, 1.0], "bodies.0.radii_km.2: this field is required"),
        ("bodies.0.pole_ra_deg", [], "bodies.0: pole_ra_deg, pole_dec_deg"),
        ("bodies.0.gm_km3_s2", float("nan"), "bodies.0.gm_km3_s2: "),
        ("trajectories.0.kind", "magic", "trajectories.0: .*magic"),
        ("trajectories.0.target", 5, "trajectories.0.target: Input should be 10 or 399"),
        ("trajectories.2.eccentricity", -0.1, "trajectories.2.eccentricity: "),
        ("trajectories.2.center", "VULCAN", "trajectories.2.center: 'VULCAN' is not a body"),
        ("trajectories.3.target", 10, "trajectories: none has the spacecraft -999"),
        ("trajectories.3.step_s", 0.001, r"trajectories.3 \(RP\): step_s: a table of .* states"),
        ("pointing.instrument", "OTHER", "pointing.instrument: OTHER"),
        ("pointing.windows", [], "pointing.windows: "),
        ("pointing.windows.0.track", ["VULCAN"], "pointing.windows.0.track: 'VULCAN'"),
        ("pointing.windows.0.track", [], "pointing.windows.0: give either track or both"),
        ("pointing.windows.1.dec_deg", ..., "pointing.windows.1: give either track or both"),
        ("pointing.windows.1.start", "2031-03-01T01:30:00", "pointing.windows.1.start: before"),
        ("pointing.windows.1.end", "2031-03-05T00:00:00", "pointing.windows.1.end: after the end"),
        ("pointing.windows.0.end", "2031-03-01T00:30:00", "pointing.windows.0: end 2031-03-01T00:30:00"),
    ],
)
def test_the_wrong_field_is_named(tmp_path, path, value, message):
    with pytest.raises(MissionError, match=message) as caught:
        make_kernels(changed(path, value), tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


STATES = {"kind": "states", "target": -999, "center": 3999999, "source": "made up"}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([["2031-03-01T00:00:00", 1, 2, 3, 4, 5, 6]], "trajectories.0.rows: Tuple should have at least 2"),
        ([["2031-03-01T00:00:00", 1, 2, 3, 4, 5, 6]] * 2, "trajectories.0: rows.1: .* is not after"),
        (
            [["2031-03-01T00:00:00Z", 1, 2, 3, 4, 5, 6]] * 2,
            "trajectories.0.rows.0.0: this epoch has no time zone",
        ),
        ([["2031-03-01T00:00:00", 1, 2, 3, 4, 5]] * 2, "trajectories.0.rows.0.6: this field is required"),
        (
            [["2031-03-01T00:00:00", 1, 2, 3, 4, 5, "x"]] * 2,
            "trajectories.0.rows.0.6: Input should be a valid number",
        ),
    ],
)
def test_the_wrong_row_is_named(rows, message):
    with pytest.raises(MissionError, match=message):
        load_scenario(changed("trajectories.0", STATES | {"rows": rows}))


def test_table_in_utc_and_in_tdb(tmp_path):
    rows = [[f"2031-03-0{d}T00:00:00", 10.0, 0.0, 0.0, 0.0, 1e-5, 0.0] for d in (1, 2)]
    for scale, offset_s in (("TDB", 0.0), ("UTC", 69.184)):
        scenario = changed("trajectories.3", STATES | {"rows": rows, "time_scale": scale})
        with KernelSet(make_kernels(scenario, tmp_path / scale)) as kernels:
            start = kernels.coverage("SPK")
            first = next(c.intervals_et[0, 0] for c in start if c.body == -999)
            assert first - spiceypy.str2et("2031 MAR 01 00:00:00 TDB") == pytest.approx(offset_s, abs=0.01)


def test_several_wrong_fields_are_counted():
    with pytest.raises(MissionError, match=r"mission: .*; name: .*; span: .*; and 6 more$"):
        load_scenario({})


@pytest.mark.parametrize("text", ["a: [1", "\x00", "- just\n- a list\n", "", "text"])
def test_files_that_are_no_scenario(tmp_path, text):
    path = tmp_path / "s.yaml"
    path.write_text(text)
    with pytest.raises(MissionError, match=r"s\.yaml") as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)


def test_file_that_is_not_there(tmp_path):
    with pytest.raises(MissionError, match=r"nothing.yaml cannot be read: .*No such file"):
        load_scenario(tmp_path / "nothing.yaml")


def test_target_without_a_trajectory_leaves_nothing(tmp_path):
    scenario = changed("bodies.1", {"name": "SUN", "id": 10, "source": "none"})
    scenario["bodies"].append({"name": "GHOST", "id": 3999998, "source": "none"})
    scenario["pointing"]["windows"][0]["track"] = ["GHOST"]
    with pytest.raises(KernelError, match="3999998"):
        make_kernels(scenario, tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(KernelError, match="cannot write kernels"):
        make_kernels(MINI, tmp_path / "file" / "out")


OCTAHEDRON = """
v 300 0 0
v -300 0 0
v 0 280 0
v 0 -280 0
v 0 0 250
v 0 0 -250
f 1 3 5
f 3 2 5
f 2 4 5
f 4 1 5
f 3 1 6
f 2 3 6
f 4 2 6
f 1 4 6
"""


def test_shape_beside_the_scenario_becomes_a_dsk(tmp_path):
    (tmp_path / "rock.obj").write_text(OCTAHEDRON)
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(changed("bodies.0.shape", {"file": "rock.obj", "unit": "m"})))
    with KernelSet(make_kernels(path, tmp_path / "out")) as kernels:
        assert "DSK" in [k.kind for k in kernels.kernels()]
        et = et_from_utc("2031-03-01T12:00:00")
        hits, found = spiceypy.dskxv(
            False,
            "TEST ROCK",
            [],
            et,
            "TEST_ROCK_FIXED",
            [[5.0, 0.0, 0.0], [0.05, 0.0, -9.0]],
            [[-1, 0, 0], [0, 0, 1]],
        )
    assert list(found) == [True, True]
    assert hits[0] == pytest.approx([0.3, 0.0, 0.0], abs=1e-9)
    assert hits[1] == pytest.approx([0.05, 0.0, -0.25 * (1 - 0.05 / 0.3)], abs=1e-9)


@pytest.mark.parametrize("text", [None, "no shape", "v 1 0 0\nf 1 2 3\n"])
def test_shape_that_is_none(tmp_path, text):
    if text is not None:
        (tmp_path / "rock.obj").write_text(text)
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(changed("bodies.0.shape", {"file": "rock.obj"})))
    with pytest.raises(OpNavError, match=r"rock\.obj") as caught:
        make_kernels(path, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "out").iterdir())


def test_scenario_without_bodies_trajectories(tmp_path):
    """The targets' ephemeris may come from elsewhere."""
    scenario = changed("pointing.windows", [MINI["pointing"]["windows"][1]])
    rows = [[f"2031-03-0{d}T00:00:00", 1e8, 0.0, 0.0, 0.0, 1e-5, 0.0] for d in (1, 2)]
    scenario["trajectories"] = [STATES | {"rows": rows, "center": 0}]
    make_kernels(scenario, tmp_path)
    assert not (tmp_path / "orbit_bodies.bsp").exists()
    with KernelSet(tmp_path / "orbit.tm"):
        assert state(-999, et_from_utc("2031-03-01T12:00:00"), 0).position_km[0] == pytest.approx(1e8)


def test_bodies_of_which_nothing_is_known_make_no_pck(tmp_path):
    scenario = copy.deepcopy(MINI)
    scenario["bodies"] = [{key: body[key] for key in ("name", "id", "source")} for body in MINI["bodies"]]
    metakernel = make_kernels(scenario, tmp_path)
    assert not (tmp_path / "orbit.tpc").exists()
    assert "tpc" not in metakernel.read_text()
    with KernelSet(metakernel) as kernels:
        assert "PCK" not in {file.kind for file in kernels.kernels()}
        assert state("TEST ROCK", et_from_utc("2031-03-01T12:00:00"), "SUN").position_km.shape == (3,)


def test_distortion_and_clock_as_the_scenario_says(tmp_path):
    owen = {"model": "owen", "e2_per_mm2": 2.5e-5, "e5_per_mm": -1.9e-5, "e6_per_mm": 3.1e-5}
    scenario = changed("instruments.0.distortion", owen)
    scenario["instruments"][0]["focal_from_camera"] = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
    scenario["clock"]["delimiter"] = "."
    with KernelSet(make_kernels(scenario, tmp_path)):
        camera = Camera.from_ik(instrument_values(-999100), -999100)
        assert sclk_from_et(-999, et_from_utc("2031-03-01T00:00:00")) == "1/0005097600.000"
    assert camera.focal_from_camera.tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
    assert camera.center_pixel_line.tolist() == [499.5, 399.5]
    assert camera.project([1e-3, 2e-3, 1.0]) == pytest.approx(
        # 0.2 mm along pixel, 0.1 mm along line, moved by the factor of the formula, 100 px/mm
        np.array([499.5, 399.5])
        + 100 * np.array([0.2, 0.1]) * (1 + 2.5e-5 * 0.05 - 1.9e-5 * 0.1 + 3.1e-5 * 0.2),
        abs=1e-9,
    )
