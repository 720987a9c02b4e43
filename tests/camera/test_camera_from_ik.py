"""Cameras from instrument kernels: flight kernels against our camera files, and kernels with angles alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from opnav_workbench.camera import Camera, NoDistortion, PsfPrior, SipDistortion
from opnav_workbench.errors import CameraError
from opnav_workbench.kernels import KernelSet, instrument_values
from opnav_workbench.resources import kernels_meta_dir

FOV = {
    "INS-999100_FOV_FRAME": ("TEST_CAMERA",),
    "INS-999100_BORESIGHT": (0.0, 0.0, 1.0),
    "INS-999100_FOV_REF_VECTOR": (1.0, 0.0, 0.0),
    "INS-999100_FOV_CLASS_SPEC": ("ANGLES",),
    "INS-999100_FOV_REF_ANGLE": (2.0,),
    "INS-999100_FOV_CROSS_ANGLE": (1.0,),
    "INS-999100_FOV_ANGLE_UNITS": ("DEGREES",),
    "INS-999100_PIXEL_SAMPLES": (2048.0,),
    "INS-999100_PIXEL_LINES": (1024.0,),
}

ADDENDUM = FOV | {
    "INS-999100_FOCAL_LENGTH": (150.0,),
    "INS-999100_TRANSX": (0.0, 0.0, 0.014),
    "INS-999100_TRANSY": (0.0, -0.014, 0.0),
    "INS-999100_BORESIGHT_SAMPLE": (1024.5,),
    "INS-999100_BORESIGHT_LINE": (512.0,),
}


def with_changes(**changes):
    values = FOV | {f"INS-999100_{key}": value for key, value in changes.items()}
    return {key: value for key, value in values.items() if value is not None}


@pytest.fixture
def pool(data_dir):
    """Function (kernel files, instrument id) -> its pool variables; the pool is empty before and after."""
    import spiceypy

    def read(files, instrument_id):
        spiceypy.kclear()
        for file in files:
            spiceypy.furnsh(str(data_dir / "spice" / file))
        names = spiceypy.gnpool(f"INS{instrument_id}_*", 0, 200)
        values = {}
        for name in names:
            n, kind = spiceypy.dtpool(name)
            read_one = spiceypy.gcpool if kind == "C" else spiceypy.gdpool
            values[name] = tuple(read_one(name, 0, n))
        return values

    yield read
    spiceypy.kclear()


def shipped(name):
    return Camera.from_yaml(kernels_meta_dir() / name)


def grid(camera, n=25):
    axes = (np.linspace(-0.5, size - 0.5, n) for size in (camera.n_pixel, camera.n_line))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def difference_px(camera, other):
    """Largest shift on the detector between two descriptions of one camera."""
    points = grid(camera)
    return np.abs(other.project(camera.unproject(points)) - points).max()


@pytest.mark.realdata
@pytest.mark.parametrize(("binning", "instrument_id"), [("1x1", -98301), ("4x4", -98302)])
def test_lorri_from_its_kernel_is_our_camera_file(pool, binning, instrument_id):
    values = pool(["generic/nh_lorri_v201.ti"], instrument_id)
    camera = Camera.from_ik(values, instrument_id)
    ours = shipped(f"new_horizons/cameras/lorri_{binning}.yaml")
    assert difference_px(ours, camera) < 1e-6
    assert camera.frame == f"NH_LORRI_{binning.upper()}"
    assert (camera.n_pixel, camera.n_line, camera.aperture_m) == (ours.n_pixel, ours.n_line, ours.aperture_m)
    assert Camera.from_ik(values, instrument_id, frame="NH_LORRI").frame == ours.frame == "NH_LORRI"


@pytest.mark.realdata
@pytest.mark.parametrize(("instrument_id", "tolerance_px"), [(-98301, 1e-6), (-98302, 1e-6)])
def test_the_kernels_sip_coefficients_are_its_owen_coefficients(pool, instrument_id, tolerance_px):
    values = pool(["generic/nh_lorri_v201.ti"], instrument_id)
    owen = Camera.from_ik(values, instrument_id)
    keywords = {key.partition("_SIP_")[2]: value[0] for key, value in values.items() if "_SIP_" in key}
    sip = SipDistortion.from_keywords(keywords, owen.pixel_from_mm)
    assert difference_px(owen, Camera.from_ik(values, instrument_id, distortion=sip)) < tolerance_px


@pytest.mark.realdata
def test_the_kernels_fortran_fragment_gives_our_pixels(pool):
    """Its text projects with FL / VECTOR(3); LORRI looks along -Z, so the sky is at |VECTOR(3)|."""
    values = pool(["generic/nh_lorri_v201.ti"], -98301)
    focal, kmat, em, center = (
        np.array(values[f"INS-98301_OOC_{key}"]) for key in ("FOCAL_LENGTH", "KMAT", "EM", "CCD_CENTER")
    )
    camera = Camera.from_ik(values, -98301)
    for vector in camera.unproject([[12.0, 1000.0], [700.0, 30.0]]):
        x, y = focal / abs(vector[2]) * vector[:2]
        terms = np.array([[x * (x * x + y * y), x * y, x * x], [y * (x * x + y * y), y * y, x * y]])
        expected = kmat.reshape(2, 2, order="F") @ (np.array([x, y]) + terms @ em) + center
        np.testing.assert_allclose(camera.project(vector), expected, rtol=0, atol=1e-9)


@pytest.mark.realdata
def test_mapcam_from_ik_and_isis_addendum_is_our_camera_file(pool):
    addendum = "slices/20190303T100344S990_map_iofL2pan_V001/orex_ocams_addendum_v10.ti"
    values = pool(["generic/orx_ocams_v07.ti", addendum], -64364)
    assert difference_px(shipped("osiris_rex/cameras/mapcam.yaml"), Camera.from_ik(values, -64364)) < 1e-6


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("instrument_id", "file", "tolerance_px"),
    # The flight kernel has no distortion and the geometric center; PolyCam's 628.77 mm are 0.02 % from 628.9.
    [(-64364, "mapcam", 2.5), (-64593, "polycam", 1.5)],
)
def test_ocams_without_distortion_is_near_our_camera_file(pool, instrument_id, file, tolerance_px):
    ours = shipped(f"osiris_rex/cameras/{file}.yaml")
    camera = Camera.from_ik(pool(["generic/orx_ocams_v07.ti"], instrument_id), instrument_id)
    np.testing.assert_array_equal(camera.focal_from_camera, ours.focal_from_camera)
    np.testing.assert_array_equal(camera.center_pixel_line, [511.5, 511.5])
    assert camera.frame == ours.frame
    assert difference_px(ours, camera) < tolerance_px


def test_an_addendum_of_isis_says_how_the_detector_lies():
    """X = 0.014 line, Y = -0.014 sample: pixels run along -Y, lines along +X; samples and lines count from 1."""
    camera = Camera.from_ik(ADDENDUM | {"INS-999100_OD_K": (0.0, 2e-5, 0.0)}, -999100)
    np.testing.assert_array_equal(camera.focal_from_camera, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(camera.center_pixel_line, [1023.5, 511.0])
    sample = camera.project([0.0, -0.014 * 100 * (1 - 2e-5 * 1.4**2) / 150.0, 1.0])
    np.testing.assert_allclose(sample, [1123.5, 511.0], rtol=0, atol=1e-9)
    assert not camera.guesses
    assert {origin.field for origin in camera.origins} >= {
        "focal_from_camera",
        "center_pixel_line",
        "distortion",
    }


def test_what_was_guessed_stands_in_the_camera_file(tmp_path):
    camera = Camera.from_ik(FOV, -999100)
    camera.to_yaml(tmp_path / "camera.yaml")
    assert Camera.from_yaml(tmp_path / "camera.yaml").guesses == camera.guesses != ()


DAWN = "slices/FC21A0038582_15170161546F6F"
INSTRUMENTS = "instruments"
FLIGHT = {  # kernels in loading order, instrument: pixel and line axes, center counted from 0, distortion
    "Dawn FC2": (
        [f"{DAWN}/dawn_fc_v10.ti", f"{DAWN}/dawnfcAddendum002.ti"], -203120, [[1, 0, 0], [0, 1, 0]], (511.5, 511.5), 8.4e-6
    ),
    "AMICA": (
        [f"{INSTRUMENTS}/hayabusa_amica/amica31.ti", f"{INSTRUMENTS}/hayabusa_amica/amicaAddendum002.ti"],
        -130102, [[1, 0, 0], [0, -1, 0]], (511.5, 511.5), 2.8e-5,
    ),
    "UVVIS A": (
        [f"{INSTRUMENTS}/clementine_uvvis/clem_uvvis_beta_ik_v04.ti"], -40021, [[1, 0, 0], [0, 1, 0]], (191.5, 143.5), None
    ),
    "ONC-T": (
        ["slices/hyb2_onc_20151203_084458_w2f_l2a/hyb2_onc_v00.ti",
         "slices/hyb2_onc_20151203_084458_w2f_l2a/hyb2oncAddendum0001.ti"],
        -37100, [[1, 0, 0], [0, 1, 0]], (522.9, 489.5), 9.28e-9 / 0.013**2,
    ),
    "JunoCam blue": (
        [f"{INSTRUMENTS}/juno_junocam/juno_junocam_v03.ti", f"{INSTRUMENTS}/juno_junocam/junoAddendum005.ti"],
        -61501, [[1, 0, 0], [0, 1, 0]], (813.71, 157.98), -5.9624209455667325e-08 / 0.0074**2,
    ),
}  # fmt: skip


@pytest.mark.realdata
@pytest.mark.parametrize("name", FLIGHT)
def test_flight_kernels_are_read_with_axes_center_and_distortion(pool, name):
    """What the comments of each kernel say, checked by hand; the cubic term is (distorted - ideal) / r^3, per mm^2."""
    files, number, axes, center, cubic = FLIGHT[name]
    camera = Camera.from_ik(pool(files, number), number)
    np.testing.assert_array_equal(camera.focal_from_camera[:2], axes)
    np.testing.assert_allclose(camera.center_pixel_line, center, rtol=0, atol=1e-9)
    if cubic is not None:
        shift = camera.distortion.distort([0.5, 0.0])[0] - 0.5
        assert shift / 0.5**3 == pytest.approx(cubic, rel=0.01)


@pytest.mark.realdata
def test_mvic_from_its_field_of_view_and_pixel_angle(pool):
    values = pool(["generic/nh_ralph_v100u.ti"], -98203)
    ours = shipped("new_horizons/cameras/mvic_framing.yaml")
    camera = Camera.from_ik(
        values, -98203, n_pixel=5024, n_line=128, focal_from_camera=ours.focal_from_camera
    )
    assert camera.frame == ours.frame
    assert camera.pixel_scale_rad == pytest.approx(19.8e-6, rel=1e-12)
    assert difference_px(ours, camera) < 8.0  # 19.8 microrad, rounded, and no distortion
    with pytest.raises(CameraError, match="gives no PIXEL_SAMPLES; give n_pixel"):
        Camera.from_ik(values, -98203)


def test_field_of_view_edges_are_detector_edges():
    camera = Camera.from_ik(FOV, -999100)
    assert (camera.name, camera.frame) == ("TEST_CAMERA", "TEST_CAMERA")
    assert isinstance(camera.distortion, NoDistortion)
    edges = np.tan(np.radians([2.0, 1.0]))
    np.testing.assert_allclose(camera.project([edges[0], 0.0, 1.0]), [2047.5, 511.5], rtol=0, atol=1e-9)
    # Unless told, lines run along boresight x pixel: shown with the first line on top, the picture is not mirrored.
    np.testing.assert_allclose(camera.project([0.0, edges[1], 1.0]), [1023.5, 1023.5], rtol=0, atol=1e-9)
    (guess,) = [origin for origin in camera.guesses if origin.field == "focal_from_camera"]
    assert "no keyword says how the detector lies" in guess.text


def test_axes_can_be_given():
    """Turned by 90 deg: the reference angle then belongs to the lines."""
    turned = Camera.from_ik(
        FOV, -999100, pixel_direction=[0, 1, 0], line_direction=[1, 0, 0], n_pixel=1024, n_line=2048
    )
    edges = np.tan(np.radians([2.0, 1.0]))
    np.testing.assert_allclose(turned.project([0.0, edges[1], 1.0]), [1023.5, 1023.5], rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned.project([edges[0], 0.0, 1.0]), [511.5, 2047.5], rtol=0, atol=1e-9)
    downward = Camera.from_ik(FOV, -999100, pixel_direction=[1, 0, 0], line_direction=[0, 1, 0])
    np.testing.assert_array_equal(downward.focal_from_camera, np.eye(3))


def test_corner_vectors_and_circles_give_the_field():
    corners = np.array([[0.2, 0.1, 1.0], [-0.2, 0.1, 1.0], [-0.2, -0.1, 1.0], [0.2, -0.1, 1.0]])
    camera = Camera.from_ik(with_changes(FOV_BOUNDARY_CORNERS=tuple(corners.ravel())), -999100)
    np.testing.assert_allclose(camera.project([0.2, 0.0, 1.0]), [2047.5, 511.5], rtol=0, atol=1e-9)
    circle = Camera.from_ik(with_changes(FOV_CROSS_ANGLE=None, PIXEL_LINES=(2048,)), -999100)
    np.testing.assert_allclose(np.diag(circle.pixel_from_mm), circle.pixel_from_mm[0, 0], rtol=1e-14)


def test_keys_without_prefix_and_scalars_are_understood():
    bare = {key.removeprefix("INS-999100_"): value for key, value in FOV.items()}
    bare |= {"FOV_FRAME": "TEST_CAMERA", "PIXEL_LINES": 1024}
    assert difference_px(Camera.from_ik(FOV, -999100), Camera.from_ik(bare, -999100)) < 1e-12


def test_focal_length_in_metres_and_pixel_size_in_micrometres():
    camera = Camera.from_ik(
        with_changes(FOCAL_LENGTH=(0.5,), FOCAL_LENGTH_UNITS=("m",), PIXEL_SIZE=(10.0,), IFOV=(20.0,)),
        -999100,
    )
    assert camera.focal_length_mm == 500.0
    assert camera.pixel_scale_rad == pytest.approx(20e-6, rel=1e-12)


def test_overrides_replace_what_the_kernel_gives():
    camera = Camera.from_ik(FOV, -999100, name="mine", psf=PsfPrior(0.5, 0.1), gain_e_per_dn=3.0)
    assert (camera.name, camera.psf.sigma_px, camera.gain_e_per_dn) == ("mine", 0.5, 3.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, r"no INS-999100_\* variables; load the instrument kernel"),
        (with_changes(PIXEL_SAMPLES=None), "no PIXEL_SAMPLES; give n_pixel"),
        (with_changes(FOV_FRAME=None), "no FOV_FRAME; give the frame"),
        (with_changes(BORESIGHT=None), "no BORESIGHT"),
        (with_changes(BORESIGHT=(0.0, 0.0)), "BORESIGHT .* has 2 values; 3 expected"),
        (with_changes(FOV_REF_VECTOR=(0.0, 0.0, 2.0)), "no direction across the boresight"),
        (with_changes(FOV_REF_ANGLE=None), "no FOV_REF_ANGLE"),
        (with_changes(FOV_ANGLE_UNITS=("GRADS",)), "FOV_ANGLE_UNITS 'GRADS'; one of DEGREES"),
        (with_changes(FOV_REF_ANGLE=("wide",)), "FOV_REF_ANGLE .* not numeric"),
        # 0.010 can only be mm, and would be right
        (with_changes(FOCAL_LENGTH=(500.0,), PIXEL_SIZE=(0.020,), IFOV=(20.0,)), "IFOV 20.0 .* check units"),
        (with_changes(FOCAL_LENGTH=(500.0,), PIXEL_SIZE=(0.5,)), "no size of a pixel in um, mm or m"),
        (
            with_changes(FOCAL_LENGTH=(500.0,)),
            "no TRANSX, PIXEL_PITCH, PIXEL_SIZE or IFOV; give pixel_from_mm",
        ),
        (ADDENDUM | {"INS-999100_FOCAL_LENGTH": None}, "no FOCAL_LENGTH; give focal_length_mm"),
        (ADDENDUM | {"INS-999100_OD_K": (1e-5,)}, "OD_K .* 1 values, 3 make"),
        (with_changes(FOCAL_LENGTH=(1.0,), FOCAL_LENGTH_UNITS=("feet",)), "FOCAL_LENGTH_UNITS 'feet'"),
    ],
)
def test_what_is_missing_or_wrong_is_named(values, message):
    values = {key: value for key, value in values.items() if value is not None}
    with pytest.raises(CameraError, match=message):
        Camera.from_ik(values, -999100)


def test_directions_that_are_not_at_right_angles_are_refused():
    with pytest.raises(CameraError, match="not at right angles"):
        Camera.from_ik(FOV, -999100, pixel_direction=[1, 0, 0], line_direction=[1, 0.2, 0])


def test_field_of_a_pixel_in_radians_along_both_axes():
    """As Dawn's kernel gives it; a value a thousand times off is still refused."""
    optics = {"FOCAL_LENGTH": (150.07,), "PIXEL_SIZE": (14.004, 13.995), "IFOV": (9.3242e-05, 9.3184e-05)}
    camera = Camera.from_ik(with_changes(**optics), -999100)
    assert np.diag(camera.pixel_from_mm) == pytest.approx([1.0 / 0.014004, 1.0 / 0.013995])
    with pytest.raises(CameraError, match=r"IFOV 0.093 microrad"):
        Camera.from_ik(with_changes(**optics | {"IFOV": (0.093, 0.093)}), -999100)


# ---- Kernels made by hand: other units, other ways to tell the field of view, detectors that lie otherwise.

HALF_RAD = (np.arctan(0.05), np.arctan(0.04))
BY_HAND = {
    "FOV_FRAME": "PROBE_CAM",
    "BORESIGHT": (0.0, 0.0, 1.0),
    "PIXEL_SAMPLES": 1000,
    "PIXEL_LINES": 800,
    "FOCAL_LENGTH": 100.0,
    "PIXEL_SIZE": 10.0,
    "FOV_REF_VECTOR": (1.0, 0.0, 0.0),
    "FOV_REF_ANGLE": HALF_RAD[0],
    "FOV_CROSS_ANGLE": HALF_RAD[1],
    "FOV_ANGLE_UNITS": "RADIANS",
}
ANGULAR = tuple(key for key in BY_HAND if key.startswith("FOV_") and key != "FOV_FRAME")


def by_hand(*left_out: str, **changes) -> Camera:
    values = {key: value for key, value in (BY_HAND | changes).items() if key not in left_out}
    return Camera.from_ik({f"INS-999100_{key}": value for key, value in values.items()}, -999100)


def corners(x: float, y: float, turn=None) -> list[float]:
    """A field of view by its corners, tangents, in a frame that is turned."""
    vectors = np.array([[x, y, 1.0], [-x, y, 1.0], [-x, -y, 1.0], [x, -y, 1.0]])
    return (vectors if turn is None else vectors @ np.asarray(turn).T).ravel().tolist()


@pytest.mark.realdata
def test_a_line_of_lroc_has_the_distortion_that_its_kernel_says(data_dir):
    """lro_lroc_v18.ti, "LROC NAC Distortion Model Parameters": xc = xd / (1 + k1 r^2), one coefficient."""
    with KernelSet([data_dir / "spice/instruments/lro_lroc/lro_lroc_v18.ti"]):
        camera = Camera.from_ik(instrument_values(-85600), -85600)
    pixels = np.linspace(0.0, 5063.0, 99)
    directions = camera.unproject(np.column_stack([pixels, np.full(99, camera.center_pixel_line[1])]))
    measured_mm = (pixels + 1.0 - 2548.0) * 7.0e-3  # BORESIGHT_SAMPLE, PIXEL_PITCH
    corrected_mm = measured_mm / (1.0 + 1.81e-5 * measured_mm**2)
    along = directions @ camera.focal_from_camera[0] / (directions @ camera.boresight) * 699.62
    np.testing.assert_allclose(along, corrected_mm, rtol=0, atol=1e-5 * 7.0e-3)


@pytest.mark.parametrize(
    "changes",
    [
        {"PIXEL_SIZE": 0.01},
        {"PIXEL_SIZE": 1e-5},
        {"FOCAL_LENGTH": 0.1, "FOCAL_LENGTH_UNITS": "Meter"},
        {"FOCAL_LENGTH": 10.0, "FOCAL_LENGTH_UNITS": "CM"},
        *(
            {
                "FOV_ANGLE_UNITS": unit,
                "FOV_REF_ANGLE": HALF_RAD[0] / rad,
                "FOV_CROSS_ANGLE": HALF_RAD[1] / rad,
            }
            for unit, rad in (("deg", np.pi / 180.0), ("ARCMINUTES", np.pi / 10800.0), ("milliradians", 1e-3))
        ),
    ],
)
def test_units_of_kernels(changes):
    for left_out in ((), () if "FOV_ANGLE_UNITS" not in changes else ("FOCAL_LENGTH", "PIXEL_SIZE")):
        assert by_hand(*left_out, **changes).pixel_scale_rad == pytest.approx(1e-4, rel=1e-6)


@pytest.mark.parametrize("ifov", [100.0, 1e-4, 0.1, (100.0, 100.0)])
def test_an_ifov_in_the_unit_that_makes_the_field_of_view(ifov):
    camera = by_hand("FOCAL_LENGTH", "PIXEL_SIZE", IFOV=ifov)
    assert camera.pixel_scale_rad == pytest.approx(1e-4)
    if ifov != 0.1:  # without a field of view, microradians or radians
        bare = by_hand("FOCAL_LENGTH", "PIXEL_SIZE", "FOV_REF_ANGLE", IFOV=ifov)
        assert bare.pixel_scale_rad == pytest.approx(1e-4)


@pytest.mark.parametrize(
    "changes",
    [
        {"FOCAL_LENGTH": 10.0},
        {"PIXEL_SIZE": 1e-3},
        {"FOV_ANGLE_UNITS": "DEGREES"},
        {"TRANSX": (0.0, 10.0, 0.0), "TRANSY": (0.0, 0.0, 10.0)},
        {"TRANSX": (0.0, 1e-5, 0.0), "TRANSY": (0.0, 0.0, 1e-5)},
    ],
)
def test_units_that_make_another_field_of_view_are_refused(changes):
    with pytest.raises(
        CameraError,
        match=r"deg, but the kernel.s field of view is [0-9.]+ x [0-9.]+ deg.*; check the units and the number",
    ):
        by_hand(**changes)


def test_a_field_of_view_of_a_strip_is_none_of_another_unit():
    assert by_hand(FOV_CROSS_ANGLE=HALF_RAD[1] / 50.0).pixel_scale_rad == pytest.approx(1e-4)


@pytest.mark.parametrize("key", ["FOV_BOUNDARY_CORNERS", "FOV_BOUNDARY"])
def test_a_field_of_view_by_its_corners_alone(key):
    camera = by_hand(*ANGULAR, "BORESIGHT", **{key: corners(0.05, 0.04)})
    np.testing.assert_allclose(camera.focal_from_camera, np.eye(3), atol=1e-12)
    assert by_hand(
        *ANGULAR, "FOCAL_LENGTH", "PIXEL_SIZE", **{key: corners(0.05, 0.04)}
    ).pixel_scale_rad == pytest.approx(1e-4)


def test_a_detector_that_lies_across():
    """Its longer side runs along Y: so do its pixels, however the kernel tells the field of view."""
    by_angles = by_hand(FOV_REF_ANGLE=HALF_RAD[1], FOV_CROSS_ANGLE=HALF_RAD[0])
    by_corners = by_hand(*ANGULAR, FOV_BOUNDARY_CORNERS=corners(0.04, 0.05))
    for camera in (by_angles, by_corners):
        np.testing.assert_allclose(camera.focal_from_camera, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
        (how,) = [o.how for o in camera.origins if o.field == "focal_from_camera"]
        assert how == "guessed"


def test_boresights_along_other_axes():
    along_x = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # columns: pixel, line, boresight
    camera = by_hand(*ANGULAR, BORESIGHT=(1.0, 0.0, 0.0), FOV_BOUNDARY_CORNERS=corners(0.05, 0.04, along_x))
    np.testing.assert_allclose(camera.focal_from_camera, along_x.T, atol=1e-12)
    turned = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    oblique = by_hand(
        *ANGULAR, BORESIGHT=tuple(turned[:, 2]), FOV_BOUNDARY_CORNERS=corners(0.05, 0.04, turned)
    )
    np.testing.assert_allclose(oblique.focal_from_camera, turned.T, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"FOCAL_LENGTH": 0.0}, "FOCAL_LENGTH of the instrument kernel is 0"),
        ({"PIXEL_SAMPLES": 1000.5}, "1000.5, no number of pixels; give n_pixel"),
        ({"PIXEL_LINES": -3}, "-3, no number of pixels; give n_line"),
        ({"PIXEL_SAMPLES": 1e12}, "1e\\+12, no number of pixels"),
        ({"FOV_ANGLE_UNITS": "FURLONGS"}, None),
    ],
)
def test_numbers_that_cannot_be(changes, said):
    if said is None:  # other numbers of the kernel do without it
        assert by_hand(**changes).pixel_scale_rad == pytest.approx(1e-4)
        with pytest.raises(CameraError, match="FOV_ANGLE_UNITS 'FURLONGS'"):
            by_hand("FOCAL_LENGTH", "PIXEL_SIZE", **changes)
        return
    with pytest.raises(CameraError, match=said):
        by_hand(**changes)


def test_matrices_of_isis_for_another_boresight_are_left_aside_aloud():
    """NEAR's camera looks along X in its kernel, and its addendum has matrices for one that looks along Z."""
    camera = by_hand(
        *ANGULAR, TRANSX=(0.0, 0.01, 0.0), TRANSY=(0.0, 0.0, -0.01), BORESIGHT=(1.0, 0.0, 0.0),
        FOV_BOUNDARY_CORNERS=[1.0, 0.05, 0.04, 1.0, -0.05, 0.04, 1.0, -0.05, -0.04, 1.0, 0.05, -0.04],
    )  # fmt: skip
    np.testing.assert_allclose(camera.focal_from_camera, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-12)
    told = [o.text for o in camera.origins if (o.field, o.how) == ("focal_from_camera", "guessed")]
    assert any("suit a camera that looks along Z" in text for text in told)


def test_a_detector_beside_the_axis():
    """HRSC: each line has its own BORESIGHT in the frame of the head, and matrices that put it there."""
    camera = by_hand(
        *ANGULAR, TRANSX=(0.0, 0.01, 0.0), TRANSY=(-30.0, 0.0, 0.01), BORESIGHT=(0.0, -30.0, 100.0), PIXEL_LINES=1,
        BORESIGHT_SAMPLE=500.5, BORESIGHT_LINE=1.0,
    )  # fmt: skip
    np.testing.assert_allclose(camera.focal_from_camera, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera.center_pixel_line, [499.5, 3000.0])
    seen = camera.unproject([499.5, 0.0])
    np.testing.assert_allclose(seen, np.array([0.0, -30.0, 100.0]) / np.hypot(30.0, 100.0), atol=1e-9)


def test_pixels_of_a_picture_that_see_a_part_of_the_field():
    """A window of the picture's size; more than the field of view they cannot see."""
    values = {f"INS-999100_{key}": value for key, value in BY_HAND.items() if not key.startswith("PIXEL_S")}
    values["INS-999100_PIXEL_PITCH"] = 0.01
    camera = Camera.from_ik(values, -999100, n_pixel=200, n_line=160)
    assert any("a window? If they are binned" in o.text for o in camera.origins)
    with pytest.raises(CameraError, match="check the units and the number of pixels"):
        Camera.from_ik(values, -999100, n_pixel=5000, n_line=4000)
