"""Missions: names and files, and which camera a header belongs to."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from opnav_workbench.camera import Camera
from opnav_workbench.camera.support_data import read_support_data
from opnav_workbench.errors import CameraError, MissionError
from opnav_workbench.image.header import Header, KeywordMap
from opnav_workbench.mission import load_mission, mission_names
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

LORRI = {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"}
EVERY_MISSION = pytest.mark.parametrize("name", mission_names())


def mission_file(folder, **changes):
    text = (kernels_meta_dir() / "generic" / "mission.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text) | changes
    (folder / "cameras").mkdir(exist_ok=True)
    camera = (kernels_meta_dir() / "generic/cameras/pinhole.yaml").read_text(encoding="utf-8")
    (folder / "cameras" / "pinhole.yaml").write_text(camera, encoding="utf-8")
    (folder / "mission.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return folder / "mission.yaml"


@EVERY_MISSION
def test_every_mission_is_complete(name):
    mission = load_mission(name)
    assert mission.name == name
    assert mission.spacecraft_id < 0
    assert mission.path.is_file()
    for choice in mission.cameras:
        assert Camera.from_yaml(choice.file).n_pixel > 0
    if mission.target_stars is not None:
        assert mission.target_stars.is_file()
    KeywordMap(**mission.keywords)


@EVERY_MISSION
def test_camera_ids_and_frames_belong_to_the_spacecraft(name):
    mission = load_mission(name)
    cameras = [Camera.from_yaml(choice.file) for choice in mission.cameras]
    # raw and corrected pictures of one camera differ in their size or in what a DN is
    assert len({(camera.instrument_id, camera.n_line, camera.bits) for camera in cameras}) == len(cameras)
    for camera in cameras:
        assert str(camera.instrument_id).startswith(str(mission.spacecraft_id))


def test_mission_by_file_and_by_folder(tmp_path):
    path = mission_file(tmp_path, name="mine")
    assert load_mission(path).name == load_mission(tmp_path).name == load_mission(str(path)).name == "mine"
    assert load_mission(path).camera_for({}).name == "Generic pinhole"


@pytest.mark.parametrize(
    ("asked", "hint"),
    [
        ("new_horizon", "mean new_horizons"),
        ("OSIRIS-REX", "mean osiris_rex"),
        ("no/such/file.yaml", "generic, hayabusa, hayabusa2, juno, .*near, new_horizons"),
    ],
)
def test_an_unknown_mission_lists_the_known_ones(asked, hint):
    with pytest.raises(MissionError, match=hint) as caught:
        load_mission(asked)
    assert "new_horizons" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cameras": []}, "cameras: .*at least 1"),
        ({"clock_id": "x"}, "clock_id: .*integer"),
        ({"extra": 1}, "extra: unknown field"),
        ({"keywords": {"exposure": "EXPTIME"}}, "keywords: .*unknown exposure; known are .*bits, "),
        ({"keywords": {"quaternion": ["A", "B"]}}, "keywords: .*quaternion .*list of 4 keywords"),
        ({"keywords": {"exposure_scale": "ms"}}, "keywords.exposure_scale: .*valid number"),
        ({"target_surfaces": {"A": {"size_sigma": 0.0}}}, "target_surfaces.A.size_sigma: .*greater than 0"),
        ({"target_surfaces": {"A": {"axes_sigma": 5}}}, "target_surfaces.A.axes_sigma: .*less than 1"),
        ({"target_surfaces": {"A": {"limb_roughness": np.nan}}}, "limb_roughness: .*finite"),
        ({"target_surfaces": {"A": {"size_sigm": 0.1}}}, "unknown field, did you mean size_sigma"),
    ],
)
def test_schema_errors_name_file_and_field(tmp_path, changes, message):
    with pytest.raises(MissionError, match=message) as caught:
        load_mission(mission_file(tmp_path, **changes))
    assert "mission.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_camera_by_header():
    mission = load_mission("new_horizons")
    assert mission.camera_for(LORRI).name == "LORRI 4x4"
    assert mission.camera_for(LORRI | {"SFORMAT": " 1x1 "}).name == "LORRI 1x1"
    mvic = {"MISSION": "NEW HORIZONS", "INSTRU": "mvi", "SCANTYPE": "FRAMING"}
    assert mission.camera_for(mvic).name == "MVIC framing"
    osiris = load_mission("osiris_rex")
    assert osiris.camera_for({"HOSTNAME": "OREX", "CAMERAID": 0}).name == "MapCam pan"
    assert osiris.camera_for({"HOSTNAME": "OSIRIS-REX", "CAMERAID": "2"}).name == "PolyCam infinity"


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (LORRI | {"SFORMAT": "2X2"}, "SFORMAT = '2X2'.*lorri_1x1, lorri_4x4, mvic_framing"),
        (LORRI | {"MISSION": "Cassini"}, "MISSION = 'Cassini'"),
        ({}, "no INSTRU, no MISSION, no SCANTYPE, no SFORMAT"),
    ],
)
def test_a_picture_of_no_camera_is_refused(header, message):
    with pytest.raises(CameraError, match=message):
        load_mission("new_horizons").camera_for(header)


def test_values_may_be_alternatives_and_the_first_camera_that_fits_is_taken(tmp_path):
    choice = {"file": "cameras/pinhole.yaml", "match": {"CAM": [1, "two"], "GAIN": 0.5}}
    mission = load_mission(mission_file(tmp_path, cameras=[choice]))
    for value in (1, 1.0, "1", "TWO"):
        assert mission.camera_for({"CAM": value, "GAIN": 0.5}).n_pixel == 1024
    with pytest.raises(CameraError, match="CAM = 3"):
        mission.camera_for({"CAM": 3, "GAIN": 0.5})


READOUT = {"binning": "BIN", "binning_values": {"HALF": 2}, "first_is": 1} | {
    name: name.upper() for name in ("first_pixel", "first_line", "n_pixel", "n_line")
}


def test_header_words_tell_window_and_binning_of_one_camera_file(tmp_path):
    """Binned 2 x 2 from pixel 101, line 201 (counted from 1) on: each picture's pixel sees what four of the detector see."""
    choice = {"file": "cameras/pinhole.yaml", "match": {}, "readout": READOUT}
    mission = load_mission(mission_file(tmp_path, cameras=[choice]))
    whole = mission.camera_for({})
    assert (whole.n_pixel, whole.n_line) == (1024, 1024)
    part = mission.camera_for(
        {"BIN": "half", "FIRST_PIXEL": 101, "FIRST_LINE": "201", "N_PIXEL": 400, "N_LINE": 300}
    )
    assert (part.n_pixel, part.n_line, part.name) == (400, 300, whole.name)
    seen = whole.project(part.unproject([[0.0, 0.0], [399.0, 299.0]]))
    np.testing.assert_allclose(
        seen, [[100.5, 200.5], [898.5, 798.5]], rtol=0, atol=1e-9
    )  # middles of four pixels
    assert part.psf.sigma_px == whole.psf.sigma_px / 2
    for header, message in (
        ({"BIN": "x"}, "no whole number BIN"),
        ({"FIRST_PIXEL": 900, "N_PIXEL": 400, "N_LINE": 1}, "not on its detector"),
    ):
        with pytest.raises(CameraError, match=message):
            mission.camera_for(header)


def test_words_of_a_window_are_found_in_any_case(tmp_path):
    choice = {"file": "cameras/pinhole.yaml", "readout": {"n_pixel": "n_pixel", "n_line": "n_line"}}
    mission = load_mission(mission_file(tmp_path, cameras=[choice]))
    part = mission.camera_for(Header({"N_PIXEL": 400, "N_LINE": 300}))
    assert (part.n_pixel, part.n_line) == (400, 300)


@pytest.mark.realdata
def test_a_binned_picture_of_mercury_is_the_camera_of_its_image_support_data(data_dir):
    """The label says binned on the chip; ALE's camera differs by the focal length of that temperature only."""
    folder = data_dir / "spice/instruments"
    label = (folder / "messenger_mdis/EN1072174528M_pds3.lbl").read_text(encoding="ascii", errors="replace")
    words = dict(re.findall(r"^ *([A-Z:_]+) *= *(\S+)", label, flags=re.MULTILINE))
    camera = load_mission("messenger").camera_for(words)
    theirs = read_support_data(folder / "isds/messmdis_isd.json").camera
    assert (camera.n_pixel, camera.n_line) == (512, 512) == (theirs.n_pixel, theirs.n_line)
    assert theirs.focal_length_mm == pytest.approx(camera.focal_length_mm, rel=1e-3)
    points = np.stack(np.meshgrid(np.linspace(-0.5, 511.5, 9), np.linspace(-0.5, 511.5, 9)), axis=-1).reshape(
        -1, 2
    )
    warmed = replace(camera, focal_length_mm=theirs.focal_length_mm)
    assert np.abs(warmed.project(theirs.unproject(points)) - points).max() < 0.02


def test_a_broken_camera_file_is_named(tmp_path):
    path = mission_file(tmp_path, cameras=[{"file": "cameras/none.yaml"}])
    with pytest.raises(CameraError, match=r"none\.yaml cannot be read"):
        load_mission(path).camera_for({})


def test_magnitude_of_a_target_as_the_spacecraft_sees_it():
    """Pluto alone, without Charon, is about V = 14.1 at opposition 28.8 au from the Earth."""
    au_km = 149597870.7
    pluto = TargetState(
        name="PLUTO",
        position_km=np.array([28.8 * au_km, 0.0, 0.0]),
        radii_km=None,
        body_from_j2000=None,
        sun_position_km=np.array([-29.8 * au_km, 0.0, 0.0]),
        covariance_km2=None,
        magnitude=None,
    )
    mission = load_mission("new_horizons")
    assert mission.with_magnitude(pluto).magnitude == pytest.approx(14.1, abs=0.3)
    assert mission.with_magnitude(replace(pluto, name="NIX")).magnitude is None


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "camera"),
    [
        ("lorri_interstellar/lor_0449855930_0x633_pwcs2.fits", "LORRI 4x4"),
        ("cropped/lor_0034974380_0x630_sci_1_cropped.fit", "LORRI 1x1"),
        ("cropped/mpf_0035126517_0x539_sci_1_cropped.fits", "MVIC framing"),
    ],
)
def test_flight_headers_find_their_camera(data_dir, file, camera):
    from astropy.io import fits

    header = dict(fits.getheader(data_dir / "images" / file))
    mission = load_mission("new_horizons")
    assert mission.camera_for(header).name == camera
    keywords = mission.keywords
    named = [
        keywords[k] for k in ("exposure_s", "et", "utc", "sclk", "target", "instrument", "geometry_quality")
    ]
    assert set(named) | set(keywords["quaternion"]) | set(keywords["sun_position"]) <= set(header)


@pytest.mark.realdata
def test_sun_keywords_point_from_the_spacecraft_to_the_sun(data_dir):
    """On 2020-04-22 New Horizons was 47 au out, at RA 287, Dec -21 deg as seen from the Sun, and leaving."""
    from astropy.io import fits

    header = fits.getheader(data_dir / "images/lorri_interstellar/lor_0449855930_0x633_pwcs2.fits")
    keywords = load_mission("new_horizons").keywords
    sun = np.array([header[k] for k in keywords["sun_position"]])
    velocity = np.array([header[k] for k in keywords["sun_velocity"]])
    from_sun = -sun
    assert np.linalg.norm(sun) / 149597870.7 == pytest.approx(47.12, abs=0.01)
    assert np.degrees(np.arctan2(from_sun[1], from_sun[0])) % 360 == pytest.approx(287.9, abs=0.2)
    assert -velocity @ from_sun > 0  # it moves away


def test_mission_bodies_are_known_to_spice():
    import spiceypy

    for name in ("new_horizons", "osiris_rex"):
        mission = load_mission(name)
        assert spiceypy.bodn2c(mission.spacecraft_name) == mission.spacecraft_id
        for body in (mission.reference_body, *mission.default_targets):
            spiceypy.bodn2c(body)


def test_a_mission_says_how_well_a_figure_is_known(tmp_path):
    path = mission_file(tmp_path, target_surfaces={"MOON": {"size_sigma": 0.002, "limb_roughness": 0.01}})
    moon = load_mission(path).target_surfaces["MOON"]
    assert (moon.size_sigma, moon.axes_sigma, moon.limb_roughness) == (0.002, None, 0.01)


def test_figures_that_cassini_measured_are_known_better_than_on_a_first_approach():
    for surface in load_mission("cassini").target_surfaces.values():
        assert surface.size_sigma < 0.01
        assert surface.axes_sigma < 0.01


def test_a_readout_that_was_told_is_found_again(tmp_path):
    choice = {"file": "cameras/pinhole.yaml", "match": {}, "readout": READOUT}
    mission = load_mission(mission_file(tmp_path, cameras=[choice]))
    header = {"BIN": "half", "FIRST_PIXEL": 101, "FIRST_LINE": 201, "N_PIXEL": 400, "N_LINE": 300}
    told = json.loads(json.dumps(mission.readout_told(header)))  # as a result keeps it
    name = mission.camera_names[0]
    assert repr(mission.camera_as_read(name, told)) == repr(mission.camera_for(header))
    assert mission.camera_as_read(name, None).n_pixel == 1024
    with pytest.raises(CameraError, match="is no readout"):
        mission.camera_as_read(name, {"binning": [1]})
    assert mission.camera_for({}).n_pixel == 1024
    del header["FIRST_LINE"]  # where the window begins: it would be taken as at the detector's edge
    with pytest.raises(
        CameraError, match=r"no FIRST_LINE, by which .* the picture has 300 of the detector's 512 lines"
    ):
        mission.camera_for(header)
    assert mission.camera_for({"BIN": "half", "N_PIXEL": 512, "N_LINE": 512}).n_line == 512
