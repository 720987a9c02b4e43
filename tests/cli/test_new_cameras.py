"""Which camera of instrument kernels made a picture: by its size, or refused with those that would."""

import pytest

from opnav_workbench.commissioning.cameras import Numbers, camera_of_kernels
from opnav_workbench.errors import CameraError

KERNEL = "KPL/IK\n\\begindata\n"


def camera(number: int, name: str, pixels: int) -> str:
    words = {
        "FOV_FRAME": f"'{name}'", "INSTRUMENT_NAME": f"'{name}'", "BORESIGHT": "( 0 0 1 )", "FOV_REF_VECTOR": "( 1 0 0 )",
        "FOV_SHAPE": "'RECTANGLE'", "FOV_ANGLE_UNITS": "'DEGREES'", "FOV_REF_ANGLE": "2.0", "FOV_CROSS_ANGLE": "2.0",
        "PIXEL_SAMPLES": str(pixels), "PIXEL_LINES": str(pixels),
    }  # fmt: skip
    return "".join(f"INS{number}_{key} = {value}\n" for key, value in words.items())


@pytest.fixture
def kernel(tmp_path):
    path = tmp_path / "probe.ti"
    path.write_text(
        KERNEL + camera(-999100, "PROBE_NAC", 1024) + camera(-999200, "PROBE_WAC", 512) + "\\begintext\n"
    )
    return [str(path)]


def test_a_picture_s_size_chooses(kernel):
    assert camera_of_kernels(kernel, None, (512, 512), Numbers()).instrument_id == -999200
    assert camera_of_kernels(kernel, "nac", (1024, 1024), Numbers()).instrument_id == -999100


@pytest.mark.parametrize(
    ("wanted", "shape", "said"),
    [
        (
            None,
            (300, 400),
            r"no camera in these kernels makes 400 x 300 pixels: .* make 512 x 512, 1024 x 1024; give th",
        ),
        (
            "-999100",
            (512, 512),
            r"PROBE_NAC \(-999100\) makes 1024 x 1024 .*PROBE_WAC.*: --instrument -999200\.",
        ),
        (
            "-999100",
            (300, 400),
            r"none of these kernels makes that size: give a whole picture of this camera, or its numb",
        ),
    ],
)
def test_a_picture_of_another_size_is_refused_with_a_way_out(kernel, wanted, shape, said):
    with pytest.raises(CameraError, match=said):
        camera_of_kernels(kernel, wanted, shape, Numbers())


def test_a_scan_has_any_number_of_lines(kernel):
    assert camera_of_kernels(kernel, "-999100", (7, 1024), Numbers(scans=True)).n_pixel == 1024
