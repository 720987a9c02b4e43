"""The geometry report against SPICE's own calls, and against what the paper says of two epochs."""

import json

import numpy as np
import pytest
import spiceypy
from astropy import units as u

from opnav_workbench.errors import KernelError
from opnav_workbench.files import json_text
from opnav_workbench.geometry import unit_from_radec
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.scene import geometry_report, predict_body

CRAFT = -98
UTC = "2015-07-09T04:29:00"
KM, KM_S, DEG = 1e-6, 1e-12, 1e-9
BODIES = ("PLUTO", "CHARON")


@pytest.fixture(scope="module")
def camera():
    return load_mission("new_horizons").camera_named("lorri_1x1")


@pytest.fixture(scope="module")
def kernels():
    with KernelSet("new_horizons/pluto_approach") as opened:
        yield opened


@pytest.fixture(scope="module")
def et(kernels):
    return spiceypy.str2et(UTC)


@pytest.fixture(scope="module")
def report(kernels, camera, et):
    return geometry_report(
        et, "NEW HORIZONS", BODIES, camera, clock_id=CRAFT, center="SUN", frame="ECLIPJ2000"
    )


def test_times(report, et):
    assert report.et == et
    assert report.utc == "2015-07-09T04:29:00.000"
    assert report.sclk == spiceypy.sce2s(CRAFT, et)
    assert spiceypy.scs2e(CRAFT, report.sclk) == pytest.approx(et, abs=2e-5)  # a tick is 20 us


def test_states(report, et):
    states, _ = spiceypy.spkezr("-98", et, "ECLIPJ2000", "NONE", "SUN")
    assert report.spacecraft_km == pytest.approx(states[:3], abs=KM)
    assert report.spacecraft_km_s == pytest.approx(states[3:], abs=KM_S)
    for body in report.bodies:
        states, _ = spiceypy.spkezr("-98", et, "ECLIPJ2000", "NONE", body.name)
        assert body.spacecraft_km == pytest.approx(states[:3], abs=KM)
        assert body.spacecraft_km_s == pytest.approx(states[3:], abs=KM_S)
        states, _ = spiceypy.spkezr(body.name, et, "ECLIPJ2000", "NONE", "SUN")
        assert body.body_km == pytest.approx(states[:3], abs=KM)
        assert body.body_km_s == pytest.approx(states[3:], abs=KM_S)
        assert body.id == spiceypy.bodn2c(body.name)


def test_attitude(report, et):
    matrix = spiceypy.pxform("J2000", "NH_LORRI", et)
    pointing = report.pointing
    assert pointing.camera_from_j2000 == pytest.approx(matrix, abs=1e-15)
    assert pointing.j2000_from_camera == pytest.approx(spiceypy.pxform("NH_LORRI", "J2000", et), abs=1e-15)
    quaternion = spiceypy.m2q(np.array(matrix))
    assert pointing.quaternion_camera_from_j2000 == pytest.approx(
        quaternion * np.sign(quaternion[0]), abs=1e-14
    )
    boresight = spiceypy.pxform("NH_LORRI", "J2000", et) @ [0.0, 0.0, -1.0]
    _, ra, dec = spiceypy.recrad(boresight)
    assert (pointing.ra_deg, pointing.dec_deg) == pytest.approx((np.degrees(ra), np.degrees(dec)), abs=DEG)
    line = spiceypy.pxform("NH_LORRI", "J2000", et) @ [0.0, 1.0, 0.0]
    north = np.array([0.0, 0.0, 1.0]) - boresight * boresight[2]
    twist = np.degrees(np.arctan2(line @ np.cross(north, boresight), line @ north)) % 360.0
    assert pointing.twist_deg == pytest.approx(twist, abs=DEG)


@pytest.mark.parametrize("name", BODIES)
def test_bodies(report, et, name):
    body = report.body(name.lower())
    position, light_time = spiceypy.spkpos(name, et, "J2000", "CN", "-98")
    assert body.range_km == pytest.approx(np.linalg.norm(position), abs=KM)
    assert body.light_time_s == pytest.approx(light_time, abs=1e-9)
    apparent, _ = spiceypy.spkpos(name, et, "J2000", "CN+S", "-98")
    _, ra, dec = spiceypy.recrad(apparent)
    assert (body.ra_deg, body.dec_deg) == pytest.approx((np.degrees(ra), np.degrees(dec)), abs=DEG)
    assert body.phase_deg == pytest.approx(np.degrees(spiceypy.phaseq(et, name, "SUN", "-98", "CN")), abs=DEG)
    sun, _ = spiceypy.spkpos("SUN", et, "J2000", "CN+S", "-98")
    assert body.elongation_deg == pytest.approx(np.degrees(spiceypy.vsep(sun, apparent)), abs=DEG)
    lit, _ = spiceypy.spkpos("SUN", et - light_time, "J2000", "CN", name)
    assert body.sun_distance_km == pytest.approx(np.linalg.norm(lit), abs=1e-3)


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize(
    ("point", "call"), [("sub_observer", spiceypy.subpnt), ("sub_solar", spiceypy.subslr)]
)
def test_points_on_the_bodies(report, et, name, point, call):
    xyz, _, _ = call("INTERCEPT/ELLIPSOID", name, et, f"IAU_{name}", "CN+S", "-98")
    _, lon, lat = spiceypy.reclat(xyz)
    found = getattr(report.body(name), point)
    assert found.lon_deg == pytest.approx(np.degrees(lon) % 360.0, abs=DEG)
    assert found.lat_deg == pytest.approx(np.degrees(lat), abs=DEG)
    assert found.position_km == pytest.approx(xyz, abs=KM)


def test_place_and_size_on_the_detector(report, camera, et):
    """The pinhole with LORRI's distortion, from SPICE's apparent direction; the size of a sphere."""
    for body in report.bodies:
        seen = spiceypy.pxform("J2000", "NH_LORRI", et) @ unit_from_radec(
            *np.radians([body.ra_deg, body.dec_deg])
        )
        assert (body.pixel, body.line) == pytest.approx(
            camera.project(seen), abs=1e-5
        )  # two aberration formulas
        radius = spiceypy.bodvrd(body.name, "RADII", 3)[1][0]
        sphere = 2.0 * np.tan(np.arcsin(radius / body.range_km)) / camera.pixel_scale_rad
        assert body.diameter_px == pytest.approx(sphere, rel=2e-3)  # distortion, and a polygon for the limb
        assert body.on_detector


@pytest.mark.parametrize(
    ("utc", "range_km", "diameter_px"),
    [("2015-07-09T04:29:00", 6.32e6, 76), ("2015-07-12T08:46:57", 2.53e6, 189)],
)
def test_epochs_of_the_paper(kernels, camera, utc, range_km, diameter_px):
    report = geometry_report(spiceypy.str2et(utc), CRAFT, ["PLUTO"], camera)
    pluto = report.body("PLUTO")
    assert pluto.range_km == pytest.approx(range_km, rel=2e-3)
    assert pluto.diameter_px == pytest.approx(diameter_px, abs=0.5)
    assert pluto.phase_deg == pytest.approx(15.0, abs=0.5)
    assert pluto.on_detector


def test_table_has_units_descriptions_and_the_epoch(report):
    table = report.table()
    assert list(table["name"]) == list(BODIES)
    assert all(table[column].info.description for column in table.colnames)
    assert table["range"].unit == u.km
    assert table["phase"][0].to_value(u.deg) == report.bodies[0].phase_deg
    assert table["spacecraft_velocity"].unit == u.km / u.s
    assert table["sub_solar_lat"][1].to_value(u.deg) == report.bodies[1].sub_solar.lat_deg
    assert table.meta["et"] == report.et
    assert table.meta["pointing"]["twist_deg"] == report.pointing.twist_deg


def test_plain_values_go_through_json(report):
    plain = report.as_dict()
    back = json.loads(json_text(plain))
    assert back == json.loads(json.dumps(plain, allow_nan=False))
    assert back["bodies"][0]["range_km"] == report.bodies[0].range_km
    assert back["bodies"][1]["sub_observer"]["lon_deg"] == report.bodies[1].sub_observer.lon_deg
    assert back["pointing"]["j2000_from_camera"] == report.pointing.camera_from_j2000.T.tolist()


def test_text_shows_what_an_analyst_asks(report):
    text = str(report)
    pluto = report.body("PLUTO")
    for shown in (
        "2015-07-09T04:29:00.000",
        report.sclk,
        f"{pluto.diameter_px:.3f}",
        f"{pluto.phase_deg:.4f}",
    ):
        assert shown in text
    assert f"{report.pointing.twist_deg:.7f}" in text
    assert f"{report.pointing.j2000_from_camera[2, 0]:.10f}" in text
    assert max(map(len, text.splitlines())) <= 100


def test_without_attitude_sizes_remain_and_a_note_says_why(kernels, camera):
    gap = spiceypy.str2et("2015-07-11T10:15:00")  # the plan's windows leave half an hour
    report = geometry_report(gap, CRAFT, ["PLUTO", "NIX"], camera)
    assert report.pointing is None
    assert "no attitude" in report.notes[0]
    assert "2015-07-11T10:00:00" in report.notes[0]
    pluto, nix = report.bodies
    assert pluto.diameter_px == pytest.approx(131.07, abs=0.2)
    assert np.isnan(pluto.pixel)
    assert not pluto.on_detector
    assert nix.sub_observer is None  # its spin is not known
    assert report.as_dict()["bodies"][0]["pixel"] is None
    assert "note: no attitude" in report.text()


def test_without_camera_and_clock(kernels, et):
    report = geometry_report(et, CRAFT, ["PLUTO"])
    assert report.pointing is None
    assert report.sclk is None
    assert report.notes == ()
    assert np.isnan(report.bodies[0].diameter_px)
    assert report.bodies[0].range_km == pytest.approx(6.3196e6, rel=1e-4)


def test_a_clock_that_is_not_loaded_is_a_note(kernels, et):
    report = geometry_report(et, CRAFT, [], clock_id=-64)
    assert report.sclk is None
    assert "no clock reading" in report.notes[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bodies": ["VULCAN"]}, "'VULCAN' is unknown"),
        ({"bodies": ["MARS"]}, "MARS"),
        ({"center": "NOWHERE"}, "'NOWHERE' is unknown"),
        ({"frame": "NO_FRAME"}, "NO_FRAME"),
        ({"spacecraft": "VOYAGER 9"}, "VOYAGER 9"),
    ],
)
def test_what_the_kernels_do_not_know(kernels, et, changes, message):
    arguments = {"et": et, "spacecraft": CRAFT, "bodies": ["PLUTO"]} | changes
    with pytest.raises(KernelError, match=message) as caught:
        geometry_report(**arguments)
    assert "\n" not in str(caught.value)


def test_a_body_that_is_not_in_the_report(report):
    with pytest.raises(KernelError, match="holds no 'NIX'; it holds PLUTO, CHARON"):
        report.body("NIX")


def test_predicted_place_is_that_of_a_session(report, camera, et):
    """The report and `predict_body` are one prediction."""
    from opnav_workbench.scene import body_target, observer_from_kernels

    seen = predict_body(
        body_target("PLUTO", CRAFT, et),
        observer_from_kernels(CRAFT, et),
        camera,
        report.pointing.camera_from_j2000,
    )
    assert (report.bodies[0].pixel, report.bodies[0].line) == tuple(seen.pixel_line)
