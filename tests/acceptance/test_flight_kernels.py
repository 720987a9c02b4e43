"""Flight kernel slices: the boresight of a picture against its FITS header, and targets predicted on the detector."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import spiceypy

from opnav_workbench.camera import Camera
from opnav_workbench.camera.support_data import read_support_data
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.pds_label import parse_pds_label
from opnav_workbench.kernels import KernelSet, camera_attitude, et_from_utc, instrument_values, state
from opnav_workbench.mission import load_mission
from opnav_workbench.scene import geometry_report

pytestmark = pytest.mark.realdata

NEW_HORIZONS = ("naif0012.tls", "new_horizons_1454.tsc", "pck00011.tpc", "nh_v220.tf")


@dataclass(frozen=True)
class Picture:
    """A flight picture's kernels and what it shows."""

    folder: str
    generic: tuple[str, ...]
    spacecraft: int
    camera: tuple[str, str] | int  # mission and camera file, or NAIF id of the instrument in its IK
    target: str
    utc: str  # middle of the exposure
    # allowed ranges
    range_km: tuple[float, float]
    diameter_px: tuple[float, float]


PICTURES = {
    "LORRI at Io": Picture(
        "lor_0034974380_0x630_sci_1",
        (*NEW_HORIZONS, "nh_lorri_v201.ti"),
        -98,
        ("new_horizons", "lorri_1x1"),
        "IO",
        "2007-02-28T13:14:22.331",
        (2.41e6, 2.42e6),
        # 3643 km at 2.4165e6 km: 1.508 mrad, 4.964 microrad a pixel
        (303.0, 305.0),
    ),
    "MapCam at Bennu": Picture(
        "20190303T100344S990_map_iofL2pan_V001",
        ("naif0012.tls", "orx_sclkscet_00065.tsc", "bennu_v16.tpc", "orx_v14.tf", "orx_ocams_v07.ti"),
        -64,
        ("osiris_rex", "mapcam"),
        "BENNU",
        "2019-03-03T10:59:42.951",
        (6.5, 6.7),
        # 565 x 535 x 508 m at 6.6 km: 80 mrad, 68 microrad a pixel
        (1100.0, 1300.0),
    ),
    "MVIC at Pluto": Picture(
        "mpf_0295610274_0x539_sci",
        (*NEW_HORIZONS, "nh_ralph_v100u.ti"),
        -98,
        ("new_horizons", "mvic_framing"),
        "PLUTO",
        "2015-06-03T04:07:03.124",
        (4.9e7, 5.1e7),
        # 2377 km at 5.0e7 km: 47 microrad, 19.8 microrad a pixel
        (2.2, 2.8),
    ),
    "Cassini at Enceladus": Picture(
        "N1702360370_1",
        ("naif0012.tls", "pck00011.tpc"),
        -82,
        -82360,
        "ENCELADUS",
        "2011-12-12T05:02:22.073",  # the label's IMAGE_MID_TIME
        (24400.0, 24450.0),
        # 513 x 503 x 497 km at 24 419 km: 20.6 mrad, 5.99 microrad a pixel; more than the detector
        (3400.0, 3500.0),
    ),
    "Dawn at Ceres": Picture(
        "FC21A0038582_15170161546F6F",
        ("naif0012.tls",),
        -203,
        -203120,
        "CERES",
        "2015-06-19T16:15:47.245",
        (4860.0, 4880.0),
        # 964 x 892 km at 4870 km: 195 mrad, 93.2 microrad a pixel; more than the detector
        (2050.0, 2250.0),
    ),
    "Hayabusa2 at Earth": Picture(
        "hyb2_onc_20151203_084458_w2f_l2a",
        ("naif0012.tls", "pck00011.tpc"),
        -37,
        ("hayabusa2", "onc_w2"),
        "EARTH",
        "2015-12-03T08:44:58.166",
        (36100.0, 36200.0),
        # 12,756 km at 36,160 km: 353 mrad, 1.15 mrad a pixel
        (300.0, 313.0),
    ),
}


def _kernels(data_dir: Path, generic: tuple[str, ...], folder: str) -> list[Path]:
    spice = data_dir / "spice"
    inside = sorted(
        p
        for p in (spice / "slices" / folder).iterdir()
        if p.suffix in {".bsp", ".bc", ".ti", ".tf", ".tpc", ".tsc"}
    )
    return [*(spice / "generic" / name for name in generic), *inside]


def _camera(of: tuple[str, str] | int) -> Camera:
    if isinstance(of, int):
        return Camera.from_ik(instrument_values(of), of)
    mission, name = of
    return load_mission(mission).camera_named(name)


@pytest.mark.parametrize("name", PICTURES)
def test_target_is_predicted_on_the_detector(name, data_dir):
    picture = PICTURES[name]
    with KernelSet(_kernels(data_dir, picture.generic, picture.folder)):
        camera = _camera(picture.camera)
        report = geometry_report(et_from_utc(picture.utc), picture.spacecraft, [picture.target], camera)
        (body,) = report.bodies
        direction = spiceypy.spkpos(picture.target, report.et, camera.frame, "CN+S", str(picture.spacecraft))[
            0
        ]
    assert report.notes == ()
    assert picture.range_km[0] < body.range_km < picture.range_km[1]
    assert picture.diameter_px[0] < body.diameter_px < picture.diameter_px[1]
    # Far targets stand on the detector; one that is larger than the detector covers its middle.
    off = np.hypot(*(np.array([body.pixel, body.line]) - camera.center_pixel_line))
    assert body.on_detector or off < body.diameter_px / 2
    # Two ways to apply stellar aberration: SPICE's and the package's, with the velocity 1e-4 c to 1e-8 of the angle
    np.testing.assert_allclose([body.pixel, body.line], camera.project(direction), atol=2e-3)


def test_lorri_boresight_at_io_equals_the_header(data_dir):
    """2007-02-28T13:14:22: right ascension, declination and twist within 1e-6 deg of the FITS header."""
    mission = load_mission("new_horizons")
    path = data_dir / "images" / "cropped" / "lor_0034974380_0x630_sci_1_cropped.fit"
    frame = read_image(path, KeywordMap(**mission.keywords))
    camera = mission.camera_for(frame.header)
    kernels = _kernels(data_dir, (*NEW_HORIZONS, "nh_lorri_v201.ti"), "lor_0034974380_0x630_sci_1")
    with KernelSet(kernels):
        ra, dec, twist = pointing_angles(camera_attitude(camera.frame, frame.et), camera.focal_from_camera)
    header = frame.header
    assert np.degrees(ra) == pytest.approx(float(header["SPCBRRA"]), abs=1e-6)
    assert np.degrees(dec) == pytest.approx(float(header["SPCBRDEC"]), abs=1e-6)
    assert np.degrees(twist) == pytest.approx(float(header["SPCPAYIN"]), abs=1e-6)


@dataclass(frozen=True)
class Stated:
    """Which kernels ISIS attached to a picture's label, as ALE's file of it states camera, attitude and place."""

    picture: str
    isd: str
    camera: tuple[str, str]
    apart_km: float = 1e-9


STATED = (
    Stated("LORRI at Io", "nhlorri_isd", ("new_horizons", "lorri_1x1"), apart_km=1e-3),  # of 2.4 million
    Stated("MapCam at Bennu", "osirisrex_isd", ("osiris_rex", "mapcam"), apart_km=1e-6),
    Stated("Cassini at Enceladus", "cassiniiss_isd", ("cassini", "iss_nac")),
    Stated("Dawn at Ceres", "dawnfc_isd", ("dawn", "fc2")),
    Stated("Dawn at Ceres", "dawnfc_isis_isd", ("dawn", "fc2")),
    Stated("Hayabusa2 at Earth", "hayabusa2_isd", ("hayabusa2", "onc_w2")),
)


@pytest.mark.parametrize("stated", STATED, ids=lambda stated: stated.isd)
def test_attitude_and_place_are_those_that_isis_attached_to_the_label(stated, data_dir):
    """Missions' files and kernels against another program's answer for the same picture."""
    picture = PICTURES[stated.picture]
    theirs = read_support_data(data_dir / f"spice/instruments/isds/{stated.isd}.json")
    camera = _camera(stated.camera)
    with KernelSet(_kernels(data_dir, picture.generic, picture.folder)):
        ours = camera_attitude(camera.frame, theirs.et)
        if theirs.places.craft_observes:  # MapCam's addendum says so
            place = -state(picture.target, theirs.et, picture.spacecraft, correction="LT+S").position_km
        else:
            place = state(picture.spacecraft, theirs.et, picture.target, correction="LT+S").position_km
    across = np.cross(camera.boresight @ ours, theirs.camera.boresight @ theirs.camera_from_j2000)
    assert np.linalg.norm(across) < 1e-9  # LORRI's frame in ISIS looks the other way along its axis
    assert np.linalg.norm(place - theirs.position_km) < stated.apart_km


def test_what_isis_wrote_of_cassini_is_the_same_convention_with_other_ephemerides(data_dir):
    """0.56 km apart at 24,400 km, where ALE with the slice's kernels is a micrometer apart.

    ISIS' tables were written with another reconstruction of the trajectory and of the satellites (their label names it). The
    Sun as seen from Enceladus shows it: 0.54 km apart, where each part of the correction, left out, is 48,000 km or moves it
    by 0.8 km. What the moon is apart goes into the spacecraft's velocity from it, too. Taken out, only light time and
    aberration at the body leave millimeters a second of it.
    """
    picture = PICTURES["Cassini at Enceladus"]
    theirs = read_support_data(data_dir / "spice/instruments/isds/cassiniiss_isis_isd.json")
    with KernelSet(_kernels(data_dir, picture.generic, picture.folder)):
        sun = state("SUN", theirs.et, picture.target, correction="LT+S")
        place = state(picture.spacecraft, theirs.et, picture.target, correction="LT+S")
        moon_km_s = sun.velocity_km_s - theirs.sun_velocity_km_s  # theirs minus ours
        others = [
            state(picture.spacecraft, theirs.et, picture.target, correction=by) for by in ("NONE", "LT")
        ]
        seen = state(picture.target, theirs.et, picture.spacecraft, correction="LT+S")  # at the spacecraft

    def apart_km_s(velocity):
        return np.linalg.norm(theirs.velocity_km_s - velocity + moon_km_s)

    assert np.linalg.norm(sun.position_km - theirs.sun_position_km) == pytest.approx(0.54, abs=0.01)
    assert np.linalg.norm(place.position_km - theirs.position_km) == pytest.approx(0.56, abs=0.01)
    assert apart_km_s(place.velocity_km_s) < 5e-6
    assert min(apart_km_s(other.velocity_km_s) for other in others) > 2e-4
    assert apart_km_s(-seen.velocity_km_s) > 5e-4


def test_dawn_points_as_its_label_says(data_dir):
    """The archive's label of the raw picture, written by the camera's team: three decimals of a degree."""
    picture = PICTURES["Dawn at Ceres"]
    (path,) = (data_dir / "spice/slices" / picture.folder).glob("*_pds3.lbl")
    label = parse_pds_label(path.read_bytes()).values
    camera = _camera(("dawn", "fc2"))
    with KernelSet(_kernels(data_dir, picture.generic, picture.folder)):
        middle = et_from_utc(str(label["START_TIME"])) + 0.5 * float(label["EXPOSURE_DURATION"]) / 1000.0
        angles = pointing_angles(camera_attitude(camera.frame, middle), camera.focal_from_camera)
    ra, dec, twist = np.degrees(angles)
    assert ra == pytest.approx(label["RIGHT_ASCENSION"], abs=2e-3)
    assert dec == pytest.approx(label["DECLINATION"], abs=2e-3)
    assert -twist % 360.0 == pytest.approx(label["TWIST_ANGLE"], abs=2e-3)  # it counts the other way
