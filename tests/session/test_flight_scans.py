"""MVIC's and LEISA's scans by the attitude that the spacecraft flew: kernels of real pictures, words of their headers."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

from opnav_workbench.camera import Camera, RowTiming, row_sweep
from opnav_workbench.camera.readout import read_out
from opnav_workbench.errors import CameraError
from opnav_workbench.kernels import KernelSet, camera_attitude, et_from_utc
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation import load_picture_scenario, read_truth, simulate

GENERIC = ("naif0012.tls", "pck00011.tpc", "new_horizons_1454.tsc", "nh_v220.tf", "nh_soc_misc_v002.tf")
# Slice of kernels, header or words of it, mid-exposure, camera, lines a line time.
SCANS = {
    "mvic": ("mc3_0034948318_0x536_sci_1", "2007-02-28T06:00:23.454", "MVIC CH4", (1.0, 1.02)),
    "leisa": ("lsb_0296962438_0x53c_eng", "2015-06-18T19:44:31.849", "LEISA", (0.85, 1.02)),
}
LEISA_WORDS = {
    "MISSION": "New Horizons",
    "INSTRU": "lei",
    "EXPTIME": 1.0 / 1.16822,
}  # its label's FrameRate, Hz


def kernels(data_dir: Path, name: str) -> list[Path]:
    slices = data_dir / "spice/slices" / SCANS[name][0]
    return [
        *(data_dir / "spice/generic" / file for file in GENERIC),
        *sorted(p for p in slices.iterdir() if p.suffix in (".bsp", ".bc")),
    ]


@pytest.mark.realdata
@pytest.mark.parametrize("name", SCANS)
def test_a_flight_scan_moves_a_line_in_the_line_time_that_its_header_tells(data_dir, name):
    """The CK and the header have nothing to do with each other: the line time is right, and the scan's axis the lines'."""
    _, utc, camera_name, (least, most) = SCANS[name]
    header = LEISA_WORDS
    if name == "mvic":
        header = dict(fits.getheader(data_dir / "images/cropped/mc3_0034948318_0x536_sci_1_cropped.fits"))
    camera = load_mission("new_horizons").camera_for(header)
    assert (camera.name, camera.rows.tdi_lines) == (camera_name, 32 if name == "mvic" else 1)
    camera = replace(camera, n_line=256)
    with KernelSet(kernels(data_dir, name)):
        et = et_from_utc(utc)
        sweep = row_sweep(
            camera.rows, 256, camera.pixel_scale_rad, lambda t: camera_attitude(camera.frame, et + t)
        )
    swept, middle = replace(camera, sweep=sweep), 0.5 * (camera.n_pixel - 1)
    places = np.column_stack([np.full(250, middle), np.arange(250.0)])
    steps = np.diff(swept.unproject(places), axis=0) / camera.pixel_scale_rad
    moved = np.abs(steps @ camera.focal_from_camera.T)[:, :2]
    assert least < np.median(moved[:, 1]) < most
    assert (
        np.median(moved[:, 0]) < 0.1 if name == "mvic" else np.median(moved[:, 0]) < 0.35
    )  # LEISA's drifts across


ARRAYS = {"pan2": 4, "pan1": 5, "red": 6, "blue": 7, "nir": 8, "ch4": 9}


@pytest.mark.realdata
@pytest.mark.parametrize("array", ARRAYS)
def test_an_array_bends_as_its_addendum_says(data_dir, array):
    """By the formulas of ISIS' camera: series along the line, residual polynomials of sample, without their constants."""
    text = (data_dir / "spice/generic/mvicAddendum004.ti").read_text()

    def numbers(key):
        return np.array(
            re.search(rf"{re.escape(key)}\s*=\s*\(([^)]*)\)", text)[1].replace(",", " ").split(), float
        )

    pixel = np.linspace(12.0, 5011.0, 60)
    sample = pixel - 12.0 + 1.0
    x_mm, half = 0.013 * (sample - 2500.5), 32.5
    terms = [(i, d - i) for d in range(1, 6) for i in range(d + 1)]
    series = numbers("INS-98900_DISTORTION_COEF_X")
    bent = sum(
        c * eval_legendre(i, x_mm / half) * eval_legendre(j, 0.0)
        for c, (i, j) in zip(series, terms, strict=True)
    )
    column, row = (numbers(f"INS-9890{ARRAYS[array]}_RESIDUAL_{axis}_DIST_COEF") for axis in ("COL", "ROW"))
    moved = [sum(c[k] * sample**k for k in range(1, 6)) * 0.013 for c in (column, row)]
    ideal = np.column_stack([x_mm + half * bent + moved[0], moved[1], np.full(len(pixel), 657.5)])
    camera = Camera.from_yaml(kernels_meta_dir() / f"new_horizons/cameras/mvic_{array}.yaml")
    seen = camera.unproject(np.column_stack([pixel, np.full(len(pixel), 15.5)])) @ camera.focal_from_camera.T
    off_px = (seen[:, :2] / seen[:, 2:] - ideal[:, :2] / ideal[:, 2:]) / camera.pixel_scale_rad
    assert np.abs(off_px).max() < 1e-3
    assert np.ptp(moved[1]) / 0.013 > 0.5  # the residual is not nothing


@pytest.mark.slow
@pytest.mark.realdata
def test_a_scan_of_stars_flown_as_in_2007_is_solved(data_dir, tmp_path):
    """Simulated with the flight CK at each line's own time; the camera is mounted 5 px and 0.05 deg off."""
    files = []
    for number, path in enumerate(kernels(data_dir, "mvic")):  # SPICE allows 80 letters in a metakernel
        files.append(f"k{number}{path.suffix}")
        (tmp_path / files[-1]).symlink_to(path.resolve())
    listed = "\n".join(f"'{file}'" for file in files)
    (tmp_path / "f.tm").write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = (\n{listed}\n)\n\\begintext\n")
    picture = {
        "name": "scan",
        "utc": SCANS["mvic"][1],
        "camera": "mvic_pan1",
        "exposure_s": 32 * 0.0185,
        "targets": [],
    }
    error = {"source": "error", "shift_px": [4.0, -3.0], "twist_deg": 0.05}
    scenario = {
        "mission": "new_horizons", "kernels": str(tmp_path / "f.tm"), "catalog": "bundled", "magnitude_limit": 10.5,
        "seed": 3, "attitude": {"actual": error, "motion": {"from_kernels": True}}, "pictures": [picture],
    }  # fmt: skip
    (tmp_path / "pictures.yaml").write_text(yaml.safe_dump(scenario))
    simulate(load_picture_scenario(tmp_path / "pictures.yaml"), tmp_path / "out", jobs=1)
    truth = read_truth(tmp_path / "out/scan.fit")
    assert np.median(truth.objects["smear"][truth.objects["on_detector"]].value) == pytest.approx(
        1.0, abs=0.1
    )
    with KernelSet(tmp_path / "f.tm"):
        session = ImageSession.open(tmp_path / "out/scan.fit", "new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
    pointing = session.state.pointing
    assert (session.result()["status"], pointing.n_stars >= 30, pointing.rms_px < 0.05) == ("ok", True, True)
    off = Rotation.from_matrix(pointing.camera_from_j2000 @ truth.camera_from_j2000.T).as_rotvec()
    assert np.linalg.norm(off[1:]) / session.context.camera.pixel_scale_rad < 0.02
    assert abs(off[0]) < np.radians(0.001)


def test_lines_of_a_charge_that_follows_the_scan_belong_to_a_scanner():
    for wrong in ({"tdi_lines": 0, "detector_line": 1.0}, {"tdi_lines": 32}):
        with pytest.raises(CameraError, match="tdi_lines is"):
            RowTiming(0.01, **wrong)
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/mvic_red.yaml")
    read = read_out(camera, size=(5024, 77), line_time_s=0.02)
    assert (read.rows, read.n_line) == (RowTiming(0.02, 15.5, 32), 77)


def test_a_header_may_tell_the_lines_of_a_scan_alone():
    mission = load_mission("new_horizons")
    words = {
        "MISSION": "New Horizons",
        "INSTRU": "mvi",
        "SCANTYPE": "TDI",
        "DETECTOR": "NIR",
        "EXPTIME": 0.64,
    }
    for more, lines in (({}, 1024), ({"NAXIS1": 5000, "NAXIS2": 77}, 77)):
        camera = mission.camera_for(words | more)
        assert (camera.name, camera.n_pixel, camera.n_line) == ("MVIC NIR", 5024, lines)
        assert camera.rows == RowTiming(0.02, 15.5, 32)
        assert mission.camera_as_read("mvic_nir", mission.readout_told(words | more)).n_line == lines


def test_leisa_sees_red_stars_brighter_than_their_v():
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/leisa.yaml")
    camera.require_photometry()
    blue, red = (float(camera.electrons(8.0 + camera.color.offset(b_v), 0.856)) for b_v in (0.0, 1.5))
    assert red / blue == pytest.approx(10.0 ** (0.4 * 2.3 * 1.5), rel=1e-6)
    assert 10.0 < blue < 1000.0  # V = 8 is near what it sees at all
