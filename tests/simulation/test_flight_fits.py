"""Simulated files read back as flight files: image, planes, header, world coordinates."""

from dataclasses import replace

import numpy as np
import pytest
import spiceypy
import yaml
from astropy.io import fits
from astropy.wcs import WCS

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import open_catalog
from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.image import QUALITY_TABLES, KeywordMap, read_image, read_quality
from opnav_workbench.kernels import KernelSet, camera_attitude, et_from_utc
from opnav_workbench.mission import load_mission
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.scene import observer_from_kernels, predict_stars
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation.attitude_path import sky_turn
from opnav_workbench.simulation.detector import expose
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.flight_fits import QUALITY_CODES, dark_columns_of, write_flight_fits
from opnav_workbench.simulation.flight_header import FlightRecord, flight_cards, wcs_cards
from opnav_workbench.simulation.picture import add_stars

UTC = "2015-04-09T12:00:00.000"
EXPOSURE_S = 0.1
IDENTITIES = {
    "1X1": {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"},
    "4X4": {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"},
    "MVIC": {"MISSION": "New Horizons", "INSTRU": "mvi", "SCANTYPE": "FRAMING"},
}
SETTINGS = DetectorEffects.model_validate(
    {
        "bias": {"level_dn": 538.0},
        "full_well": {"electrons": 80_000.0},
        "lost_data": {"lines": 1},
        "sky": {"level_dn": 1.0},
        "bad_pixels": {"hot_fraction": 1e-3, "dead_fraction": 0.0, "flagged": True},
    }
)


@pytest.fixture(scope="module")
def kernels():
    with KernelSet("new_horizons/pluto_opnav") as loaded:
        yield loaded


@pytest.fixture(scope="module")
def mission():
    return load_mission("new_horizons")


@pytest.fixture
def record(kernels, mission):
    return record_of(mission, "4X4")


def record_of(mission, mode):
    camera, et = mission.camera_for(IDENTITIES[mode]), et_from_utc(UTC)
    attitude = camera_attitude(camera.frame, et)
    return FlightRecord(mission, camera, et, EXPOSURE_S, attitude, IDENTITIES[mode], target="PLUTO")


def exposed_of(record, **options):
    light = np.zeros((record.camera.n_line, record.camera.n_pixel))
    light[30:40, 30:40] = 300.0
    light[20, 25] = 400_000.0
    columns = dark_columns_of(record.mission, record.camera) if options.get("level") == "raw" else 0
    return expose(
        light, record.camera, SETTINGS, exposure_s=EXPOSURE_S, seed=5, dark_columns=columns, **options
    )


@pytest.mark.parametrize("mode", sorted(IDENTITIES))
def test_the_flight_reader_gets_back_what_was_written(kernels, mission, tmp_path, mode):
    record = record_of(mission, mode)
    exposed = exposed_of(record)
    path = write_flight_fits(tmp_path / "a.fit", exposed, record)
    assert [p.name for p in tmp_path.iterdir()] == ["a.fit"]
    frame = read_image(path, KeywordMap(**mission.keywords))
    assert np.array_equal(frame.image_dn, exposed.image_dn.astype(np.float32))
    assert np.array_equal(frame.error_dn, exposed.error_dn.astype(np.float32))
    assert frame.error_dn.min() > 0.0
    assert mission.camera_for(frame.header).name == record.camera.name
    assert frame.et == record.et
    assert frame.utc == UTC
    assert frame.exposure_s == EXPOSURE_S
    assert frame.header_geometry.camera_from_j2000 == pytest.approx(record.camera_from_j2000, abs=1e-14)
    assert frame.header_geometry.quality == "PREDICT"
    assert frame.header["SIMULATE"] is True
    assert not [m for m in frame.messages if "remark" in m or "no " in m.split(":")[0]]
    sun, _ = spiceypy.spkezr("SUN", record.et, "J2000", "LT", "-98")
    assert frame.header_geometry.spacecraft_from_sun_km == pytest.approx(-sun[:3], rel=1e-12)
    assert spiceypy.scs2e(-98, frame.sclk) == pytest.approx(record.et, abs=2e-5)


def test_masks_come_back(record, tmp_path):
    exposed = exposed_of(record)
    frame = read_image(
        write_flight_fits(tmp_path / "a.fit", exposed, record), KeywordMap(**record.mission.keywords)
    )
    housekeeping = np.zeros_like(frame.bad)
    housekeeping[0, :34] = True
    assert exposed.lost.any()
    assert exposed.defective.any()
    assert np.array_equal(frame.bad, exposed.lost | exposed.defective | housekeeping)
    assert exposed.saturated.sum() > 3
    assert np.array_equal(frame.saturated, exposed.saturated & ~exposed.lost & ~housekeeping)


@pytest.mark.parametrize("mode", ["1X1", "4X4"])
def test_raw_pictures_are_whole_numbers_with_dark_columns(kernels, mission, tmp_path, mode):
    record = record_of(mission, mode)
    exposed = exposed_of(record, level="raw")
    path = write_flight_fits(tmp_path / "raw.fit", exposed, record)
    with fits.open(path) as hdus:
        assert hdus[0].data.dtype == np.uint16
        assert hdus[0].data.shape[1] == {"1X1": 1028, "4X4": 257}[mode]
        assert hdus[0].data.max() <= 4095
        assert "BIASCORR" not in hdus[0].header
        assert [h.name for h in hdus] == ["PRIMARY", "LORRI Quality flag image"]
        dark = hdus[0].data[:, record.camera.n_pixel :]
    assert np.median(dark) == 538.0
    frame = read_image(path, KeywordMap(**mission.keywords))
    assert np.array_equal(frame.image_dn, exposed.image_dn)
    assert np.array_equal(frame.bad[1:], (exposed.lost | exposed.defective)[1:])


def test_raw_numbers_that_no_file_holds_are_refused(record, tmp_path):
    light = np.full((256, 256), 1e8)
    settings = DetectorEffects.model_validate({"adc": False, "bias": {"level_dn": 538.0}, "full_well": False})
    exposed = expose(light, record.camera, settings, exposure_s=1.0, seed=0, level="raw")
    with pytest.raises(MissionError, match=r"do not fit 16 bits.*adc"):
        write_flight_fits(tmp_path / "a.fit", exposed, record)
    assert not list(tmp_path.iterdir())


def test_nothing_is_left_where_nothing_can_be_written(record, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(SessionError, match="cannot write"):
        write_flight_fits(tmp_path / "file" / "a.fit", exposed_of(record), record)


def test_the_same_picture_is_the_same_file(record, tmp_path):
    first, second = (write_flight_fits(tmp_path / n, exposed_of(record), record) for n in ("a.fit", "b.fit"))
    assert first.read_bytes() == second.read_bytes()


def test_pointing_cards_agree_with_spice(record, tmp_path):
    header = fits.getheader(write_flight_fits(tmp_path / "a.fit", exposed_of(record), record))
    matrix = spiceypy.pxform("NH_LORRI", "J2000", record.et)
    _, ra, dec = spiceypy.recrad(matrix @ [0.0, 0.0, -1.0])
    assert header["SPCBRRA"] == pytest.approx(np.degrees(ra), abs=1e-11)
    assert header["SPCBRDEC"] == pytest.approx(np.degrees(dec), abs=1e-11)
    quaternion = spiceypy.m2q(np.array(matrix))
    assert [header[f"SPCQ{x}"] for x in "AXYZ"] == pytest.approx(quaternion, abs=1e-13)
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    for keyword, axis in (("SPCPAXIN", matrix[:, 0]), ("SPCPAYIN", matrix[:, 1]), ("SPCEMEN", matrix[:, 1])):
        angle = np.degrees(np.arctan2(axis @ east, axis @ north)) % 360.0
        assert header[keyword] == pytest.approx(angle, abs=1e-9), keyword
    assert header["SPCPAZIN"] == -999.0


def test_target_and_time_cards_agree_with_spice(record, tmp_path):
    header = fits.getheader(write_flight_fits(tmp_path / "a.fit", exposed_of(record), record))
    seen, light_time = spiceypy.spkezr("PLUTO", record.et, "J2000", "LT", "-98")
    assert [header[f"SPCTSC{x}"] for x in "XYZ"] == pytest.approx(-seen[:3], rel=1e-12)
    assert [header[f"SPCTSCV{x}"] for x in "XYZ"] == pytest.approx(-seen[3:], rel=1e-9)
    assert header["SPCTRANG"] == pytest.approx(np.linalg.norm(seen[:3]), rel=1e-12)
    sub = spiceypy.pxform("J2000", "IAU_PLUTO", record.et - light_time) @ -seen[:3]
    _, lon, lat = spiceypy.reclat(sub)
    assert header["SPCTSCLA"] == pytest.approx(np.degrees(lat), abs=1e-8)
    assert header["SPCTSCLO"] == pytest.approx(np.degrees(lon) % 360.0, abs=1e-8)
    sun, _ = spiceypy.spkezr("SUN", record.et, "J2000", "LT", "-98")
    assert header["SPCSSCRN"] == pytest.approx(np.linalg.norm(sun[:3]), rel=1e-12)
    assert header["SPCUTCID"] == "2015-099T12:00:00.000"
    assert header["SPCUTCJD"] == "JD 2457122.0000000"
    assert header["TARGET"] == "PLUTO"
    assert header["SPCCBTID"] == 999
    assert header["STOPMET"] - header["STARTMET"] == pytest.approx(EXPOSURE_S, abs=4e-5)
    assert (header["RDNOISE"], header["CCDGAIN"], header["BIASLEVL"]) == (1.1, 22.0, 538.0)
    assert header["PHOTZPT"] == record.camera.zero_point_mag


def test_a_star_field_has_no_target(record, tmp_path):
    path = write_flight_fits(tmp_path / "a.fit", exposed_of(record), replace(record, target=None))
    header = fits.getheader(path)
    assert header["SPCTCB"] == "UNKNOWN"
    assert header["SPCTSCX"] == -1e32  # as flight headers say
    frame = read_image(path, KeywordMap(**record.mission.keywords))
    assert frame.header_geometry.spacecraft_from_sun_km is not None


@pytest.mark.realdata
def test_keywords_are_those_of_flight_headers(record, tmp_path, data_dir):
    """Every card that is not our own stands in a flight header, with a value of the same kind."""
    flight = fits.getheader(sorted((data_dir / "images/lorri_interstellar").glob("*.fits"))[0])
    ours = fits.getheader(write_flight_fits(tmp_path / "a.fit", exposed_of(record), record))
    own = {"SIMULATE", "WCSAXES"}
    extra = {
        k for k in ours if k not in flight and k not in own and not k.startswith(("A_", "B_", "AP_", "BP_"))
    }
    assert not extra - {"BZERO", "BSCALE"}
    for keyword, value in ours.items():
        if keyword in flight and keyword not in ("SPCESCJD", "SPCSSCJD") and value != -1e32:
            both = isinstance(value, str), isinstance(flight[keyword], str)
            assert both[0] == both[1], keyword
    read = ("EXPTIME", "SPCSCET", "SPCUTCAL", "SPCSCLK", "SPCBRRA", "SPCBRDEC", "SPCEMEN", "SPCQA", "SPCSSCX",
            "SPCTSCX", "SPCTRANG", "PHOTZPT", "RDNOISE", "CCDGAIN", "BIASLEVL", "SFORMAT", "INSTRU", "MISSION",
            "HOSTNAME", "SPCMETDL", "RSOLAR", "PSOLAR", "TARGET", "MET", "SPCSSCVX")  # fmt: skip
    assert not [k for k in read if k not in ours]
    order = [
        k
        for k in ours
        if k in flight and not k.startswith(("CD", "CR", "CT", "CU", "A_", "B_", "AP", "BP", "RAD"))
    ]
    places = [list(flight).index(k) for k in order]
    assert np.mean(np.diff(places) > 0) > 0.97  # in the order of flight headers


@pytest.mark.realdata
def test_a_flight_frame_s_own_cards_come_out_of_its_own_kernels_numbers(data_dir):
    """Position angles and angles to the Sun of a real header, from its quaternion and Sun vector."""
    header = fits.getheader(sorted((data_dir / "images/lorri_interstellar").glob("*.fits"))[0])
    mission = load_mission("new_horizons")
    camera = mission.camera_for(header)
    attitude = spiceypy.q2m([header[f"SPCQ{x}"] for x in "AXYZ"]).T
    record = FlightRecord(mission, camera, header["SPCSCET"], header["EXPTIME"], attitude, IDENTITIES["4X4"])
    exposed = expose(np.zeros((256, 256)), camera, SETTINGS, exposure_s=header["EXPTIME"], seed=1)
    cards = {c.keyword: c.value for c in flight_cards(record, exposed.values, "calibrated")}
    for keyword in (
        "SPCBRRA",
        "SPCBRDEC",
        "SPCEMEN",
        "SPCPAXIN",
        "SPCPAYIN",
        "SPCPAZIN",
        "PA_XINST",
        "SPCQA",
        "SPCQZ",
    ):
        assert cards[keyword] == pytest.approx(header[keyword], abs=1e-9), keyword
    for keyword in (
        "SPCUTCAL",
        "SPCUTCID",
        "SPCUTCJD",
        "SPCSCET",
        "EXPTIME",
        "SPCSCNAM",
        "SPCINSTR",
        "SFORMAT",
    ):
        assert cards[keyword] == header[keyword], keyword
    assert "SPCSSCX" in cards  # no kernels are open: there, and marked as missing
    assert cards["SPCSSCX"] == -1e32


def test_missions_without_a_template_have_their_keywords(kernels, tmp_path):
    mission = load_mission("osiris_rex")
    camera = replace(
        mission.camera_for({"HOSTNAME": "OREX", "CAMERAID": 2}), gain_e_per_dn=4.6, read_noise_dn=8.0
    )
    record = FlightRecord(
        mission, camera, et_from_utc(UTC), 2.5, np.eye(3), {"HOSTNAME": "OREX", "CAMERAID": 2}
    )
    exposed = expose(np.ones((1024, 1024)), camera, DetectorEffects(), exposure_s=2.5, seed=1)
    frame = read_image(
        write_flight_fits(tmp_path / "p.fits", exposed, record), KeywordMap(**mission.keywords)
    )
    assert frame.exposure_s == 2.5
    assert frame.et == pytest.approx(record.et, abs=1e-3)
    assert frame.header["EXPTIME"] == 2500.0
    assert frame.header["DATE_OBS"] == "2015-04-09T11:59:58.750"
    assert "SPCBRRA" not in frame.header


def test_a_template_that_asks_for_the_unknown_is_named(record, tmp_path):
    (tmp_path / "headers").mkdir()
    (tmp_path / "headers" / "own.yaml").write_text(
        yaml.safe_dump({"groups": [{"cards": [["NOISE", "=loudness", ""]]}]})
    )
    mission = replace(record.mission, path=tmp_path / "mission.yaml")
    with pytest.raises(MissionError, match=r"own\.yaml: NOISE: unknown quantity 'loudness'"):
        flight_cards(replace(record, mission=mission), exposed_of(record).values, "calibrated")


@pytest.mark.parametrize("table", sorted(QUALITY_TABLES))
def test_quality_codes_mean_what_the_reader_takes_them_for(table):
    codes = QUALITY_CODES[table]
    bad, saturated, _ = read_quality(
        [[0, codes.saturated, codes.lost, codes.defective]], QUALITY_TABLES[table]
    )
    assert bad.tolist() == [[False, False, True, True]]
    assert saturated.tolist() == [[False, codes.saturated != 0, False, False]]
    assert sorted(QUALITY_CODES) == sorted(QUALITY_TABLES)


# -- world coordinates -------------------------------------------------------------------------------------------------


def mirrored():
    return Camera(
        name="M",
        frame="M",
        instrument_id=-1,
        n_pixel=1024,
        n_line=1000,
        focal_length_mm=628.9,
        center_pixel_line=[512.0, 490.0],
        pixel_from_mm=[[117.6, 0.3], [-0.2, 116.0]],
        focal_from_camera=[[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    )


CAMERAS = {
    "LORRI 1x1": (lambda m: m.camera_for(IDENTITIES["1X1"]), 1e-3),
    "LORRI 4x4": (lambda m: m.camera_for(IDENTITIES["4X4"]), 1e-3),
    "MVIC": (
        lambda m: m.camera_for(IDENTITIES["MVIC"]),
        0.03,
    ),  # order 7 of 5000 x 128 pixels of a Legendre series
    "PolyCam": (lambda _: load_mission("osiris_rex").camera_for({"HOSTNAME": "OREX", "CAMERAID": 2}), 1e-3),
    "mirrored": (lambda _: mirrored(), 1e-6),
}


@pytest.mark.parametrize("name", sorted(CAMERAS))
@pytest.mark.parametrize("dec_deg", [-88.0, 12.0])
def test_world_coordinates_agree_with_the_camera(mission, name, dec_deg):
    make, tolerance_px = CAMERAS[name]
    camera = make(mission)
    towards = spiceypy.eul2m(0.4, np.pi / 2 - np.radians(dec_deg), 2.2, 3, 2, 3)  # +Z at (2.2, dec)
    attitude = camera.focal_from_camera.T @ np.diag([1, 1, 1.0]) @ towards
    if np.linalg.det(attitude) < 0.0:  # a mirrored detector: the camera frame itself is right-handed
        attitude = camera.focal_from_camera.T @ np.diag([-1, 1, 1.0]) @ towards
    header = fits.Header(wcs_cards(camera, attitude))
    wcs = WCS(header)
    x, y = np.meshgrid(np.linspace(0, camera.n_pixel - 1, 14), np.linspace(0, camera.n_line - 1, 14))
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    ra, dec = np.radians(wcs.all_pix2world(points, 0)).T
    sky = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    assert camera.project(sky @ attitude.T) == pytest.approx(points, abs=tolerance_px)
    back = wcs.all_world2pix(np.degrees(np.stack([ra, dec], axis=-1)), 0, tolerance=1e-7)
    assert back == pytest.approx(points, abs=1e-5)
    if wcs.sip is not None:
        offsets = wcs.sip_pix2foc(points, 0)
        undone = wcs.sip_foc2pix(offsets, 0)
        assert undone == pytest.approx(points, abs=2.0 * tolerance_px + 1e-3)
    assert ("SIP" in header["CTYPE1"]) == (name != "mirrored")


# -- the whole way -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["calibrated", "raw"])
def test_a_session_takes_the_file_and_finds_how_the_camera_really_stood(record, tmp_path, level):
    camera, et = record.camera, record.et
    true = sky_turn(camera, [6.0, -4.0, 0.0]) @ record.camera_from_j2000
    ra, dec = (float(a) for a in radec_from_unit(true.T @ camera.boresight))
    table = open_catalog("bundled").cone(ra, dec, 1.1 * camera.half_diagonal_rad, et_s=et)
    stars = predict_stars(table, et, observer_from_kernels(-98, et), camera, true, 10.0)
    light = np.zeros((256, 256))
    flux = 22.0 * EXPOSURE_S * 10.0 ** (0.4 * (18.97 - stars.mag))
    add_stars(light, stars.pixel_line, flux, GaussianPsf(0.45, 0.45))
    settings = DetectorEffects.model_validate({"bias": {"level_dn": 538.0}, "sky": {"level_dn": 1.0}})
    columns = dark_columns_of(record.mission, record.camera) if level == "raw" else 0
    exposed = expose(
        light, camera, settings, exposure_s=EXPOSURE_S, seed=1, level=level, dark_columns=columns
    )
    session = ImageSession.open(
        write_flight_fits(tmp_path / "a.fit", exposed, record), mission="new_horizons"
    )
    session.predict()
    session.find_stars()
    session.repoint()
    assert session.state.pointing.delta_pixel == pytest.approx(6.0, abs=0.1)
    assert session.state.pointing.delta_line == pytest.approx(-4.0, abs=0.1)
