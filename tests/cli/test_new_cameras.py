"""Which camera of instrument kernels made a picture: by its size, or refused with those that would."""

import pytest

from opnav_workbench.commissioning.cameras import Numbers, PictureWords, camera_of_kernels
from opnav_workbench.errors import CameraError

KERNEL = "KPL/IK\n\\begindata\n"


def camera(number: int, name: str, pixels: int, half_deg: float = 2.0) -> str:
    words = {
        "FOV_FRAME": f"'{name}'", "INSTRUMENT_NAME": f"'{name}'", "BORESIGHT": "( 0 0 1 )", "FOV_REF_VECTOR": "( 1 0 0 )",
        "FOV_SHAPE": "'RECTANGLE'", "FOV_ANGLE_UNITS": "'DEGREES'",
        "FOV_REF_ANGLE": f"{half_deg}", "FOV_CROSS_ANGLE": f"{half_deg}",
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


def test_a_line_of_pixels_is_a_scanner_s(tmp_path):
    """As kernels of CTX and HRSC have them, PIXEL_LINES = 1: no frame, and a scan has lines of its own number."""
    path, one = (
        tmp_path / "scan.ti",
        camera(-74021, "CTX", 5000).replace("PIXEL_LINES = 5000", "PIXEL_LINES = 1"),
    )
    path.write_text(KERNEL + one.replace("CROSS_ANGLE = 2.0", "CROSS_ANGLE = 0.0004") + "\\begintext\n")
    for shape in (None, (700, 5000)):
        with pytest.raises(CameraError, match="a line scanner\\? --line-scan --line-time-s"):
            camera_of_kernels([str(path)], None, shape, Numbers())
    for numbers, shape, lines in (
        (Numbers(scans=True), None, 1024),
        (Numbers(scans=True), (700, 5000), 700),
        (Numbers(scans=True, size=(5000, 300)), None, 300),
    ):
        made = camera_of_kernels([str(path)], None, shape, numbers)
        assert (made.n_pixel, made.n_line, made.center_pixel_line[1]) == (5000, lines, 0.0)


def test_a_focal_length_in_m_is_told(tmp_path):
    path = tmp_path / "metres.ti"
    words = "INS-74699_FOCAL_LENGTH = 12.0\nINS-74699_PIXEL_PITCH = 0.012\n"
    path.write_text(KERNEL + camera(-74699, "HIRISE", 2048, 0.0586) + words + "\\begintext\n")
    with pytest.raises(CameraError, match="a focal length in m, or pixels in um"):
        camera_of_kernels([str(path)], None, None, Numbers())


@pytest.fixture
def filters(tmp_path):
    """Two cameras of one size; each has a clear filter like the camera itself, and two of other lengths."""
    path, text = tmp_path / "wheel.ti", KERNEL
    for first, name in ((-999100, "PROBE_FC1"), (-999200, "PROBE_FC2")):
        for number, half_deg in enumerate((2.0, 2.0, 2.01, 2.02)):
            text += camera(first - number, name, 512, half_deg)
    path.write_text(text + "\\begintext\n")
    return [str(path)]


def test_a_picture_s_words_choose_camera_and_filter(filters):
    def chosen(*words):
        return camera_of_kernels(filters, None, (512, 512), Numbers(), PictureWords(*words))

    found = chosen(("FRAMING CAMERA", "FC2"), ("3",))
    assert found.instrument_id == -999203
    assert "the picture's instrument is FC2; the picture's filter is 3" in " ".join(map(str, found.origins))
    assert chosen(("fc-1",), ("1",)).instrument_id == -999101
    with pytest.raises(
        CameraError, match=r"4 cameras .* -999200 .*, -999201 .*, -999202 .*, -999203 .*--instrument -9992"
    ):
        chosen(("FC2",), ("CLEAR",))
    with pytest.raises(CameraError, match=r"8 cameras"):
        chosen(("another",), ("7",))
    guess = chosen(("FC2",), ())  # no word of a filter: the camera itself, and what that may cost
    assert guess.instrument_id == -999200
    (said,) = (o.text for o in guess.origins if o.field == "instrument_id")
    assert "with one of the 3 others places are up to 3.6 px off" in said
    with pytest.raises(CameraError, match=r"8 cameras"):
        chosen()


def test_filters_of_the_same_optics_are_one_camera(tmp_path):
    path = tmp_path / "alike.ti"
    path.write_text(
        KERNEL + "".join(camera(n, "PROBE_FC", 512) for n in (-999100, -999101, -999102)) + "\\begintext\n"
    )
    found = camera_of_kernels([str(path)], None, None, Numbers())
    assert found.instrument_id == -999100
    assert "-999101, -999102 see the same to 0.01 px" in " ".join(map(str, found.origins))


def test_kernels_without_a_size_say_what_to_give_at_the_prompt(tmp_path):
    path = tmp_path / "addendum.ti"
    path.write_text(
        KERNEL + "".join(f"INS{n}_FOCAL_LENGTH = 100.0\n" for n in (-999100, -999101)) + "\\begintext\n"
    )
    with pytest.raises(
        CameraError, match=r"no PIXEL_SAMPLES \(-999\d+, -999\d+\); give a picture .--image. or --size"
    ) as told:
        camera_of_kernels([str(path)], None, None, Numbers())
    assert "argument" not in str(told.value)


@pytest.mark.realdata
def test_dawn_s_label_chooses_its_camera_and_filter(data_dir):
    """Eighteen numbers in the flight kernel; INSTRUMENT_ID and FILTER_NUMBER of the picture's label leave one."""
    (kernel,) = (data_dir / "spice/slices").glob("FC21A*/dawn_fc_v10.ti")
    words = PictureWords(("FC2",), ("6",))
    found = camera_of_kernels([str(kernel)], None, (1024, 1024), Numbers(), words)
    assert (found.instrument_id, found.focal_length_mm) == (-203126, 150.08)
