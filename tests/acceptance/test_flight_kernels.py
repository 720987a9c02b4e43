"""Flight kernel slices: the boresight of a picture against its FITS header, and targets predicted on the detector."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.mission import load_mission
from opnav_workbench.scene import body_target, observer_from_kernels, predict_body
from opnav_workbench.spice import KernelSet, camera_attitude, et_from_utc

pytestmark = pytest.mark.realdata

NEW_HORIZONS = ("naif0012.tls", "new_horizons_1454.tsc", "pck00011.tpc", "nh_v220.tf")


@dataclass(frozen=True)
class Picture:
    """A flight picture's kernels and what it shows."""

    folder: str
    generic: tuple[str, ...]
    mission: str
    camera: str
    target: str
    utc: str
    diameter_px: tuple[float, float]  # allowed range of the predicted diameter


PICTURES = {
    "MapCam at Bennu": Picture(
        "20190303T100344S990_map_iofL2pan_V001",
        ("naif0012.tls", "orx_sclkscet_00065.tsc", "bennu_v16.tpc", "orx_v14.tf", "orx_ocams_v07.ti"),
        "osiris_rex",
        "mapcam",
        "BENNU",
        "2019-03-03T10:59:42.951",
        # 565 x 535 x 508 m at 6.6 km: 80 mrad, 68 microrad a pixel
        (1100.0, 1300.0),
    ),
    "MVIC at Pluto": Picture(
        "mpf_0295610274_0x539_sci",
        (*NEW_HORIZONS, "nh_ralph_v100u.ti"),
        "new_horizons",
        "mvic_framing",
        "PLUTO",
        "2015-06-03T04:07:03.124",
        # 2377 km at 5.0e7 km: 47 microrad, 19.8 microrad a pixel
        (2.2, 2.8),
    ),
}


def _kernels(data_dir: Path, generic: tuple[str, ...], folder: str) -> list[Path]:
    spice = data_dir / "spice"
    inside = sorted(
        p for p in (spice / "slices" / folder).iterdir() if p.suffix in {".bsp", ".bc", ".ti", ".tpc"}
    )
    return [*(spice / "generic" / name for name in generic), *inside]


@pytest.mark.parametrize("name", PICTURES)
def test_target_is_predicted_on_the_detector(name, data_dir):
    picture = PICTURES[name]
    mission = load_mission(picture.mission)
    (choice,) = [c for c in mission.cameras if c.file.stem == picture.camera]
    camera = Camera.from_yaml(choice.file)
    with KernelSet(_kernels(data_dir, picture.generic, picture.folder)):
        et = et_from_utc(picture.utc)
        observer = observer_from_kernels(mission.spacecraft_id, et)
        target = body_target(picture.target, mission.spacecraft_id, et)
        body = predict_body(target, observer, camera, camera_attitude(camera.frame, et))
    assert body.on_detector
    assert picture.diameter_px[0] < body.diameter_px < picture.diameter_px[1]
    assert len(body.limb_px) > 0


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
