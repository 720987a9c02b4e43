"""Simulated approach pictures: read back as flight pictures, with a truth that only the truth file knows."""

import json
from dataclasses import replace

import numpy as np
import pytest
import spiceypy
from astropy.io import fits

from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS, DEMO_PICTURES, simulate_picture
from opnav_workbench.scene import observer_from_header, observer_from_kernels

LORRI = DEMO_PICTURES[0]
SPACECRAFT = -98


@pytest.fixture(scope="module")
def mission():
    return load_mission("new_horizons")


@pytest.fixture(scope="module")
def kernels():
    with KernelSet(DEMO_KERNELS) as loaded:
        yield loaded


@pytest.fixture(scope="module")
def simulated(kernels, mission, tmp_path_factory):
    return simulate_picture(LORRI, mission, DEMO_CATALOG, tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def frame(simulated, mission):
    return read_image(simulated.picture, KeywordMap(**mission.keywords))


@pytest.mark.parametrize("request_", DEMO_PICTURES, ids=lambda r: r.name)
def test_the_flight_reader_takes_it_for_one_of_its_own(kernels, mission, tmp_path, request_):
    truth = simulate_picture(request_, mission, DEMO_CATALOG, tmp_path)
    frame = read_image(truth.picture, KeywordMap(**mission.keywords))
    et = spiceypy.str2et(request_.utc)
    camera = mission.camera_for(frame.header)
    assert frame.image_dn.shape == (camera.n_line, camera.n_pixel)
    assert frame.et == pytest.approx(et, abs=1e-6)
    assert frame.utc == request_.utc
    assert frame.exposure_s == request_.exposure_s
    assert spiceypy.scs2e(SPACECRAFT, frame.sclk) == pytest.approx(et, abs=2e-5)  # one tick
    attitude = spiceypy.pxform("J2000", camera.frame, et)
    assert frame.header_geometry.camera_from_j2000 == pytest.approx(attitude, abs=1e-12)
    assert truth.predicted_camera_from_j2000 == pytest.approx(attitude, abs=1e-12)
    assert not frame.bad[5:].any()  # line 0 of LORRI begins with telemetry


def test_header_gives_the_observer_that_the_kernels_give(frame):
    from_header = observer_from_header(frame, frame.et)
    from_kernels = observer_from_kernels(SPACECRAFT, frame.et)
    # The header's Sun is the one of 4.5 light hours ago (it moves 13 m/s: 210 km) and VSOP's barycenter is 120 km
    # off: 2e-11 rad of parallax for the nearest star.
    assert from_header.position_km == pytest.approx(from_kernels.position_km, abs=400.0)
    assert from_header.velocity_km_s == pytest.approx(from_kernels.velocity_km_s, abs=1e-4)
    assert from_header.source == "header"


def test_truth_file_says_what_the_picture_shows(simulated):
    truth = json.loads((simulated.picture.parent / "lorri_4x4.truth.json").read_text())
    assert truth["picture"] == simulated.picture.name
    assert np.array(truth["camera_from_j2000"]) == pytest.approx(simulated.camera_from_j2000, abs=0.0)
    assert sorted(truth["bodies"]) == ["CHARON", "PLUTO"]
    assert truth["bodies"]["PLUTO"] == simulated.bodies["PLUTO"].tolist()
    assert truth["stars_on_detector"] == simulated.n_stars > 3


def test_bodies_are_at_their_true_places(simulated, frame):
    pixel, line = simulated.bodies["PLUTO"]
    p0, l0 = round(pixel), round(line)
    box = frame.image_dn[l0 - 2 : l0 + 3, p0 - 2 : p0 + 3] - LORRI.sky_dn
    rows, columns = np.mgrid[l0 - 2 : l0 + 3, p0 - 2 : p0 + 3]
    center = np.array([(box * columns).sum(), (box * rows).sum()]) / box.sum()
    # The predicted attitude would put it pixels away; phase 15 deg moves its light by a tenth of 0.5 px.
    assert center == pytest.approx([pixel, line], abs=0.1)
    apparent, _ = spiceypy.spkpos("PLUTO", frame.et, "J2000", "CN+S", str(SPACECRAFT))
    x, y, z = simulated.camera_from_j2000 @ apparent
    ideal = 127.5 + 2618.4775964615382691 * 19.2352138955143523 * np.array([x, y]) / -z
    assert [pixel, line] == pytest.approx(ideal, abs=0.2)  # but for the distortion, 0.1 px at the corners


def test_the_header_does_not_leak_the_true_attitude(simulated, frame):
    true = simulated.camera_from_j2000.copy()
    assert (
        np.abs(true - simulated.predicted_camera_from_j2000).max() > 1e-5
    )  # rad: there is something to hide
    numbers = []
    with fits.open(simulated.picture) as hdus:
        for hdu in hdus:
            numbers += [v for v in hdu.header.values() if isinstance(v, float)]
    assert len(numbers) >= 11
    secrets = np.concatenate([true.ravel(), spiceypy.m2q(true.copy()), spiceypy.m2q(true.T.copy())])
    secrets = np.abs(np.concatenate([secrets, np.degrees(secrets), *simulated.bodies.values()]))
    assert np.abs(np.abs(numbers)[:, None] - secrets).min() > 1e-9
    public = np.abs(spiceypy.m2q(simulated.predicted_camera_from_j2000.copy()))
    assert np.abs(np.abs(numbers)[:, None] - public).min(axis=0).max() < 1e-9  # the test would notice


def test_seeds_are_repeatable_and_differ(simulated, kernels, mission, tmp_path):
    again = simulate_picture(LORRI, mission, DEMO_CATALOG, tmp_path)
    assert again.picture.read_bytes() == simulated.picture.read_bytes()
    other = simulate_picture(LORRI.reseeded(3), mission, DEMO_CATALOG, tmp_path)
    assert other.picture.read_bytes() != simulated.picture.read_bytes()
    assert np.abs(other.camera_from_j2000 - simulated.camera_from_j2000).max() > 1e-6


def test_a_mission_with_few_and_other_keywords(kernels, mission, tmp_path):
    keywords = {
        "required": {"MISSION": ["New Horizons", "NH"]},
        "exposure_s": "EXPMS",
        "exposure_scale": 0.001,
        "utc": "DATE_OBS",
        "time_reference": "start",
    }
    other = replace(mission, keywords=keywords)
    request = replace(LORRI, exposure_s=10.0)
    truth = simulate_picture(request, other, DEMO_CATALOG, tmp_path)
    frame = read_image(truth.picture, KeywordMap(**keywords))
    assert frame.header["EXPMS"] == 10000.0
    assert frame.header["MISSION"] == "New Horizons"
    assert frame.header["DATE_OBS"] == "2015-04-09T11:59:55.000"
    assert frame.exposure_s == 10.0
    assert frame.et == pytest.approx(spiceypy.str2et(LORRI.utc), abs=1e-3)  # mid-exposure again
    assert frame.header_geometry is None


def test_the_clock_is_asked_by_its_own_id(kernels, mission, tmp_path):
    """A clock that the kernels do not know leaves the header without a reading."""
    truth = simulate_picture(LORRI, replace(mission, clock_id=-98999), DEMO_CATALOG, tmp_path)
    with fits.open(truth.picture) as hdus:
        assert "/" not in str(hdus[0].header["SPCSCLK"])
    frame = read_image(truth.picture, KeywordMap(**mission.keywords))
    assert frame.et == pytest.approx(spiceypy.str2et(LORRI.utc), abs=1e-6)


def test_a_target_of_unknown_brightness_shines_by_its_albedo(kernels, mission, tmp_path):
    dark = replace(mission, target_photometry={})
    dim, bright = (simulate_picture(LORRI, m, DEMO_CATALOG, tmp_path / m.name) for m in (dark, mission))
    assert dim.bodies["PLUTO"] == pytest.approx(bright.bodies["PLUTO"], abs=1e-9)
    flux = [float(t.objects["flux"][list(t.objects["id"]).index("PLUTO")].value) for t in (dim, bright)]
    assert (
        0.2 < flux[0] / flux[1] < 5.0
    )  # geometric albedo 0.33 of a Lambert sphere against the measured magnitude
    assert np.isnan(dim.objects["mag"][list(dim.objects["id"]).index("PLUTO")].value)
