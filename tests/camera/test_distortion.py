"""Distortion models against their published equations, other implementations, and finite differences."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from astropy.wcs import Sip
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import eval_legendre

from opnav_workbench.camera import (
    BrownDistortion,
    CahvorDistortion,
    Camera,
    FisheyeDistortion,
    ForwardSipDistortion,
    LegendreDistortion,
    NoDistortion,
    OwenDistortion,
    RadialDistortion,
    RationalDistortion,
    SipDistortion,
    TaylorDistortion,
)
from opnav_workbench.camera.distortion import reach_mm
from opnav_workbench.camera.lens_models import centered
from opnav_workbench.errors import CameraError
from opnav_workbench.resources import kernels_meta_dir

LORRI_K = 76.9408555820574094  # px/mm
LORRI = OwenDistortion(e2_per_mm2=2.71725397e-5, e5_per_mm=-1.90343926e-5, e6_per_mm=-2.88066477e-5)
SIX_TERMS = OwenDistortion(2e-5, 3e-5, -4e-6, 5e-7, -6e-5, 7e-5)
MAPCAM = BrownDistortion(125.2, k1=0.91096, k2=-14.48, k3=-0.017173, p1=4.2536e-3, p2=1.1334e-3)
EVERY_BROWN_TERM = BrownDistortion(
    8.0, 0.05, -0.02, 0.01, 0.02, -0.01, 0.005, 0.003, -0.002, 0.004, 0.001, -0.003, 0.002
)
SIP_MATRIX = np.array([[77.0, 0.4], [-0.3, 76.5]])
REVERSE = {(3, 0): 4.6e-9, (1, 2): 4.6e-9, (1, 1): -2.5e-7, (2, 0): -3.7e-7}
REVERSE_B = {(2, 1): 4.6e-9, (0, 3): 4.6e-9, (0, 2): -2.5e-7, (1, 1): -3.7e-7}
# (of x, of y), written out from the ISIS camera model
MVIC_DEGREES = [(0, 1), (1, 0), (0, 2), (1, 1), (2, 0), (0, 3), (1, 2), (2, 1), (3, 0), (0, 4)]
MVIC_DEGREES += [(1, 3), (2, 2), (3, 1), (4, 0), (0, 5), (1, 4), (2, 3), (3, 2), (4, 1), (5, 0)]
# Of MESSENGER MDIS NAC (as ALE has it) and of TGO CaSSIS
TAYLOR_X = (0.0, 1.0018542696, 0.0, 0.0, -5.0944404749e-4, 0.0, 1.0040104715e-5, 0.0, 1.0040104715e-5, 0.0)
TAYLOR_Y = (0.0, 0.0, 1.0, 9.060010595e-4, 0.0, 3.5748426266e-4, 0.0, 1.0040104715e-5, 0.0, 1.0040104715e-5)
CASSIS = (
    (
        0.00376130530948266,
        -0.0134154156065812,
        -1.86749521007237e-05,
        1.00021352681836,
        -4.32362371703953e-04,
        -9.48e-4,
    ),
    (
        9.9842559363676e-05,
        0.00373543707958162,
        -0.0133299918873929,
        -2.15311328389359e-04,
        0.995296015537294,
        -0.01835,
    ),
    (
        -3.13320167004204e-05,
        -7.35655125749807e-06,
        -1.57664245066771e-05,
        0.00373549465439151,
        -0.0141671946930935,
        1.0,
    ),
)


def mvic() -> LegendreDistortion:
    distortion = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/mvic_framing.yaml").distortion
    assert isinstance(distortion, LegendreDistortion)
    return distortion


MODELS = {
    "none": (NoDistortion(), (7.0, 7.0)),
    "owen": (LORRI, (7.0, 7.0)),
    "owen, six terms": (SIX_TERMS, (7.0, 7.0)),
    "brown, MapCam": (MAPCAM, (4.5, 4.5)),
    "brown, every term": (EVERY_BROWN_TERM, (2.5, 2.0)),
    "sip, reverse": (SipDistortion.from_coefficients(SIP_MATRIX, REVERSE, REVERSE_B), (7.0, 7.0)),
    "sip, forward": (ForwardSipDistortion.from_coefficients(SIP_MATRIX, REVERSE, REVERSE_B), (7.0, 7.0)),
    "legendre": (mvic(), (32.0, 0.82)),
    "radial, four terms": (RadialDistortion(-0.014, 1e-4, -2e-6, 1e-8), (7.0, 7.0)),
    "taylor, MDIS": (TaylorDistortion(TAYLOR_X, TAYLOR_Y), (7.2, 7.2)),
    "rational, CaSSIS": (RationalDistortion(*CASSIS), (10.0, 10.0)),
    "fisheye": (FisheyeDistortion(8.0, -0.02, 0.004, -0.001, 2e-4), (4.0, 4.0)),
    "cahvor": (CahvorDistortion(34.0, [0.02, -0.01, 1.0], 1e-4, 0.05, -0.3), (6.0, 6.0)),
    "cahvore, by angle": (
        CahvorDistortion(8.0, [0.02, -0.01, 1.0], 1e-4, 0.02, -0.01, linearity=0.0),
        (3.5, 3.5),
    ),
    "cahvore, by sine": (
        CahvorDistortion(8.0, [0.02, -0.01, 1.0], 0.0, 0.02, 0.0, linearity=-0.6),
        (3.5, 3.5),
    ),
}
each_model = pytest.mark.parametrize(("model", "half_mm"), MODELS.values(), ids=MODELS.keys())


def grid(half_mm, n=15):
    x, y = (np.linspace(-h, h, n) for h in half_mm)
    return np.stack(np.meshgrid(x, y), axis=-1)


@each_model
def test_undistort_inverts_to_1e_12_mm(model, half_mm):
    ideal = grid(half_mm)
    np.testing.assert_allclose(model.undistort(model.distort(ideal)), ideal, rtol=0, atol=3e-12)
    np.testing.assert_allclose(model.distort(model.undistort(ideal)), ideal, rtol=0, atol=1.1e-12)


@each_model
def test_jacobian_equals_central_differences(model, half_mm):
    ideal = grid(half_mm)
    step_mm = 1e-4
    columns = [
        (model.distort(ideal + step_mm * axis) - model.distort(ideal - step_mm * axis)) / (2 * step_mm)
        for axis in np.eye(2)
    ]
    np.testing.assert_allclose(model.jacobian(ideal), np.stack(columns, axis=-1), rtol=0, atol=2e-8)


@each_model
def test_shapes_pass_through_and_nan_stays_where_it_is(model, half_mm):
    assert model.distort([0.1, 0.2]).shape == (2,)
    assert model.jacobian(np.zeros((4, 3, 2))).shape == (4, 3, 2, 2)
    assert model.undistort(np.zeros((0, 2))).shape == (0, 2)
    points = np.array([[0.3, 0.2], [np.nan, 0.2], [0.1, 0.1]])
    for result in (model.distort(points), model.undistort(points)):
        np.testing.assert_array_equal(np.isfinite(result).all(axis=1), [True, False, True])


def test_lorri_distortion_as_published():
    """Distorted minus ideal at the corner pixels of the 1x1 frame: facts of the 2013 calibration."""
    corners_px = np.array([[0.0, 0.0], [1023.0, 1023.0]])
    distorted = (corners_px - 511.5) / LORRI_K
    shift_px = (distorted - LORRI.undistort(distorted)) * LORRI_K
    np.testing.assert_allclose(shift_px, [[-1.38, -1.38], [1.06, 1.06]], rtol=0, atol=0.005)


def test_owen_six_terms_term_by_term():
    x, y = 3.0, -4.0  # r = 5
    for name, power, radial in (
        ("e1_per_mm", 5.0, False),
        ("e2_per_mm2", 25.0, True),
        ("e3_per_mm3", 125.0, False),
        ("e4_per_mm4", 625.0, True),
        ("e5_per_mm", y, True),
        ("e6_per_mm", x, True),
    ):
        shift = OwenDistortion(**{name: 1e-6}).distort([x, y]) - [x, y]
        expected = np.array([x, y]) if radial else np.array([-y, x])
        np.testing.assert_allclose(shift, 1e-6 * power * expected, rtol=1e-8, atol=1e-14)


def test_brown_follows_the_opencv_documentation():
    m = EVERY_BROWN_TERM
    for x, y in ((0.11, -0.23), (-0.2, 0.05)):
        r2 = x**2 + y**2
        ratio = (1 + m.k1 * r2 + m.k2 * r2**2 + m.k3 * r2**3) / (1 + m.k4 * r2 + m.k5 * r2**2 + m.k6 * r2**3)
        u = x * ratio + 2 * m.p1 * x * y + m.p2 * (r2 + 2 * x**2) + m.s1 * r2 + m.s2 * r2**2
        v = y * ratio + m.p1 * (r2 + 2 * y**2) + 2 * m.p2 * x * y + m.s3 * r2 + m.s4 * r2**2
        result = m.distort(np.array([x, y]) * m.focal_mm) / m.focal_mm
        np.testing.assert_allclose(result, [u, v], rtol=0, atol=1e-15)


def test_a_fisheye_sees_equal_angles_at_equal_distances():
    """Kannala and Brandt: the radius is the focal length times the angle, with the odd polynomial of OpenCV's fisheye."""
    lens = FisheyeDistortion(8.0, -0.02, 0.004)
    for degrees in (1.0, 30.0, 60.0, 80.0):
        angle = np.radians(degrees)
        place = 8.0 * np.tan(angle) * np.array([0.6, -0.8])
        radius = 8.0 * angle * (1.0 - 0.02 * angle**2 + 0.004 * angle**4)
        np.testing.assert_allclose(lens.distort(place), radius * np.array([0.6, -0.8]), rtol=0, atol=1e-12)
        np.testing.assert_allclose(lens.undistort(lens.distort(place)), place, rtol=1e-10)
    assert np.isnan(
        FisheyeDistortion(8.0).undistort([8.0 * np.radians(91.0), 0.0])
    ).all()  # behind the image plane


def test_a_fisheye_whose_circle_lies_within_its_detector():
    """Corners see nothing, and the camera is one; a lens that folds within its circle is none."""
    names = {"name": "SKY", "frame": "SKY", "instrument_id": -1, "n_pixel": 1024, "n_line": 1024}
    optics = {"focal_length_mm": 3.2, "center_pixel_line": [511.5, 511.5], "pixel_from_mm": 100.0 * np.eye(2)}
    camera = Camera(**names, **optics, focal_from_camera=np.eye(3), distortion=FisheyeDistortion(3.2))
    assert np.isnan(camera.unproject([0.0, 0.0])).all()
    assert camera.half_diagonal_rad == pytest.approx(0.5 * np.pi)
    place = camera.project([np.sin(1.55), 0.0, np.cos(1.55)])  # 89 deg
    np.testing.assert_allclose(place, [511.5 + 320.0 * 1.55, 511.5], rtol=0, atol=1e-9)
    np.testing.assert_allclose(camera.unproject(place), [np.sin(1.55), 0.0, np.cos(1.55)], rtol=0, atol=1e-12)
    with pytest.raises(CameraError, match="folds over inside the detector"):
        replace(camera, distortion=FisheyeDistortion(3.2, -0.3))


@pytest.mark.parametrize("name", ["rational, CaSSIS", "taylor, shifted"])
def test_a_distortion_can_be_counted_from_where_the_boresight_falls(name):
    shifted = TaylorDistortion((0.02, *TAYLOR_X[1:]), (-0.01, *TAYLOR_Y[1:]))
    model = shifted if name == "taylor, shifted" else RationalDistortion(*CASSIS)
    lens, moved_mm = centered(model)
    assert np.abs(lens.distort([0.0, 0.0])).max() < 1e-12 < np.abs(moved_mm).max()
    points = grid((6.0, 6.0))
    np.testing.assert_allclose(lens.distort(points) + moved_mm, model.distort(points), rtol=0, atol=1e-10)


def test_cahvor_moves_what_lies_across_its_axis():
    """As Di and Li write it: P' = P + mu lambda, lambda across O, mu of |lambda|^2 over (P . O)^2."""
    axis = np.array([0.02, -0.01, 1.0]) / np.linalg.norm([0.02, -0.01, 1.0])
    direction = np.array([0.1, 0.05, 1.0])
    along = direction @ axis
    across = direction - along * axis
    ratio = across @ across / along**2
    moved = direction + (1e-4 + 0.05 * ratio - 0.3 * ratio**2) * across
    lens = CahvorDistortion(34.0, axis, 1e-4, 0.05, -0.3)
    np.testing.assert_allclose(
        lens.distort(34.0 * direction[:2]), 34.0 * moved[:2] / moved[2], rtol=0, atol=1e-12
    )


def test_a_camera_from_cahvor_vectors_projects_as_their_quotients_do():
    """pixel = P'.H / P'.A, line = P'.V / P'.A of the moved direction, whatever the vectors' skew; and back."""
    a = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    h, v = np.array([1900.0, 15.0, 700.0]), np.array([-20.0, 1880.0, 310.0])
    o, r = np.array([0.11, -0.19, 1.0]) / np.linalg.norm([0.11, -0.19, 1.0]), (1e-4, 0.03, 0.01)
    names = {"name": "MAST", "frame": "MAST", "instrument_id": -76001, "n_pixel": 1344, "n_line": 1200}
    camera = Camera.from_cahvor(a, h, v, o, r, **names)
    for direction in ([0.1, -0.2, 1.0], [0.4, 0.1, 1.0], [-0.3, -0.4, 1.2]):
        along = np.array(direction) @ o
        across = direction - along * o
        ratio = across @ across / along**2
        moved = direction + (r[0] + r[1] * ratio + r[2] * ratio**2) * across
        expected = np.array([moved @ h, moved @ v]) / (moved @ a)
        np.testing.assert_allclose(camera.project(direction), expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            camera.unproject(expected), direction / np.linalg.norm(direction), rtol=0, atol=1e-11
        )
    plain = Camera.from_cahvor(a, h, v, **names)
    np.testing.assert_allclose(
        plain.project([0.4, 0.1, 1.0]), np.array([h, v]) @ [0.4, 0.1, 1.0] / (a @ [0.4, 0.1, 1.0])
    )
    with pytest.raises(CameraError, match="A has length 2"):
        Camera.from_cahvor(2.0 * a, h, v, **names)


def test_radial_owen_is_radial_brown_with_k1_of_e2_times_focal_squared():
    focal_mm, e2 = 2618.4776, 2.7e-5
    points = grid((7.0, 7.0))
    brown = BrownDistortion(focal_mm, k1=e2 * focal_mm**2)
    np.testing.assert_allclose(
        brown.distort(points), OwenDistortion(e2_per_mm2=e2).distort(points), rtol=0, atol=1e-12
    )


def test_owen_is_its_sip_equivalent_exactly():
    """NAIF nh_lorri_v201.ti: AP_3_0 = e2/Kx^2, AP_1_2 = e2/Ky^2, AP_1_1 = e5/Ky, AP_2_0 = e6/Kx."""
    kx, ky = LORRI_K, 76.5
    ap = {(3, 0): LORRI.e2_per_mm2 / kx**2, (1, 2): LORRI.e2_per_mm2 / ky**2}
    bp = {(2, 1): LORRI.e2_per_mm2 / kx**2, (0, 3): LORRI.e2_per_mm2 / ky**2}
    ap |= {(1, 1): LORRI.e5_per_mm / ky, (2, 0): LORRI.e6_per_mm / kx}
    bp |= {(0, 2): LORRI.e5_per_mm / ky, (1, 1): LORRI.e6_per_mm / kx}
    sip = SipDistortion.from_coefficients(np.diag([kx, ky]), ap, bp)
    points = grid((7.0, 7.0))
    np.testing.assert_allclose(sip.distort(points), LORRI.distort(points), rtol=0, atol=1e-14)
    np.testing.assert_allclose(sip.jacobian(points), LORRI.jacobian(points), rtol=0, atol=1e-14)


def matrix(coefficients):
    square = np.zeros((4, 4))
    for powers, value in coefficients.items():
        square[powers] = value
    return square


def test_sip_agrees_with_astropy_both_ways():
    reverse = SipDistortion.from_coefficients(SIP_MATRIX, REVERSE, REVERSE_B)
    forward = ForwardSipDistortion.from_coefficients(SIP_MATRIX, REVERSE, REVERSE_B)
    a, b = matrix(REVERSE), matrix(REVERSE_B)
    astropy_sip = Sip(a, b, a, b, np.zeros(2))  # offsets from pixel (0, 0), counted from 1
    offsets_px = grid((500.0, 500.0)).reshape(-1, 2)
    offsets_mm = offsets_px @ np.linalg.inv(SIP_MATRIX).T
    from_reverse = reverse.distort(offsets_mm) @ SIP_MATRIX.T
    from_forward = forward.undistort(offsets_mm) @ SIP_MATRIX.T
    np.testing.assert_allclose(from_reverse, astropy_sip.foc2pix(offsets_px, 1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(from_forward, astropy_sip.pix2foc(offsets_px, 1), rtol=0, atol=1e-9)


@each_model
def test_distortions_are_the_same_where_their_values_are(model, half_mm):
    again = copy.deepcopy(model)
    assert [name for name, (other, _) in MODELS.items() if other == again] == [
        name for name, (other, _) in MODELS.items() if other is model
    ]
    assert hash(again) == hash(model)


@each_model
def test_the_reach_ends_where_the_first_of_all_rings_folds(model, half_mm):
    focal_mm = getattr(model, "focal_mm", 10.0 * half_mm[0])
    radii = focal_mm * np.geomspace(1e-3, 20.0, 200)
    angles = 2.0 * np.pi * np.arange(16) / 16
    with np.errstate(all="ignore"):
        jacobian = model.jacobian(radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        symmetric = 0.5 * (jacobian + np.swapaxes(jacobian, -1, -2))
    holds = np.isfinite(symmetric).all(axis=(-1, -2))
    least = np.where(
        holds, np.linalg.eigvalsh(np.where(holds[..., None, None], symmetric, 0.0))[..., 0], -1.0
    )
    folded = (least <= model.least_stretch).any(axis=1)
    expected = radii[max(folded.argmax() - 1, 0)] if folded.any() else np.inf
    assert reach_mm(model, focal_mm) == pytest.approx(expected, rel=1e-12)


def test_sip_from_header_keywords():
    header = {"AP_ORDER": 3, "BP_ORDER": 3, "CRPIX1": 128.5}
    header |= {f"AP_{p}_{q}": c for (p, q), c in REVERSE.items()}
    header |= {f"BP_{p}_{q}": c for (p, q), c in REVERSE_B.items()}
    points = grid((7.0, 7.0))
    expected = SipDistortion.from_coefficients(SIP_MATRIX, REVERSE, REVERSE_B).distort(points)
    np.testing.assert_array_equal(SipDistortion.from_keywords(header, SIP_MATRIX).distort(points), expected)
    with pytest.raises(CameraError, match="A_p_q"):
        ForwardSipDistortion.from_keywords(header, SIP_MATRIX)


def test_legendre_equals_a_plain_sum():
    model = mvic()
    half_x, half_y = model.half_size_mm
    for x, y in ((-31.0, 0.4), (12.0, -0.8), (0.0, 0.0), (30.0, 0.83)):
        p = [eval_legendre(i, x / half_x) * eval_legendre(j, y / half_y) for i, j in MVIC_DEGREES]
        expected = (
            x + half_x * np.dot(model.x_coefficients, p),
            y + half_y * np.dot(model.y_coefficients, p),
        )
        np.testing.assert_allclose(model.undistort([x, y]), expected, rtol=0, atol=1e-13)


def test_legendre_goes_on_unchanged_beyond_its_area():
    model = mvic()
    edge, beyond = np.array([[32.5, 0.4], [10.0, -0.832]]), np.array([[40.0, 0.4], [10.0, -5.0]])
    np.testing.assert_allclose(
        model.undistort(beyond) - beyond, model.undistort(edge) - edge, rtol=0, atol=1e-13
    )


def test_a_point_with_no_origin_is_nan():
    barrel = BrownDistortion(100.0, k1=-1.0)  # r (1 - r^2) reaches 0.385 at most
    assert np.isnan(barrel.undistort([50.0, 0.0])).all()
    np.testing.assert_allclose(barrel.distort(barrel.undistort([30.0, 0.0])), [30.0, 0.0], rtol=0, atol=1e-12)


@given(
    coefficients=st.tuples(*[st.floats(-1.0, 1.0)] * 6),
    x=st.floats(-7.0, 7.0),
    y=st.floats(-7.0, 7.0),
)
def test_any_small_owen_distortion_is_inverted(coefficients, x, y):
    scales = (1e-3, 1e-4, 1e-5, 1e-6, 1e-3, 1e-3)  # each up to 5 % at 7 mm
    model = OwenDistortion(*(c * s for c, s in zip(coefficients, scales, strict=True)))
    np.testing.assert_allclose(model.undistort(model.distort([x, y])), [x, y], rtol=0, atol=3e-12)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: BrownDistortion(0.0), "focal_mm is 0.0"),
        (
            lambda: LegendreDistortion([32.5, 0.8], np.zeros(19), np.zeros(20)),
            r"x_coefficients has shape \(19,\)",
        ),
        (lambda: LegendreDistortion([32.5, 0.0], np.zeros(20), np.zeros(20)), "half_size_mm has a zero"),
        (lambda: FisheyeDistortion(-1.0), "focal_mm is -1"),
        (lambda: TaylorDistortion(np.zeros(9), np.zeros(10)), "give 10 numbers"),
        (lambda: CahvorDistortion(34.0, [0.0, 0.0, 0.0]), "an axis with a direction"),
        (lambda: SipDistortion.from_coefficients(np.eye(2), {(6, 4): 1.0}, {(1, 1): 0.0}), "order 10"),
    ],
)
def test_impossible_values_are_refused(build, message):
    with pytest.raises(CameraError, match=message):
        build()
