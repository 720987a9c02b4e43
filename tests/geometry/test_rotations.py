"""Attitudes and directions against SPICE, and round trips up to the poles."""

import numpy as np
import pytest
import scipy
import spiceypy
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from opnav_workbench import geometry as geo
from opnav_workbench.geometry import rotations

ROUNDING_RAD = 1e-14
LORRI = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]])  # boresight -Z: mirrored, determinant -1
PLAIN = np.eye(3)
POLYCAM_LIKE = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
ODD = geo.rotation_from_vector([0.3, -1.1, 0.7])  # a camera whose focal axes are no coordinate axes
FOCAL_AXES = pytest.mark.parametrize("focal", [LORRI, PLAIN, POLYCAM_LIKE, ODD, LORRI @ ODD])

right_ascensions = st.floats(0.0, 2 * np.pi, exclude_max=True)
declinations = st.floats(-np.pi / 2, np.pi / 2)
rotation_vectors = st.tuples(*[st.floats(-1.8, 1.8)] * 3).map(np.array)


def _angle_difference(a, b):
    return abs((a - b + np.pi) % (2 * np.pi) - np.pi)


def _random_rotations(n, seed=1):
    """Rotations from QR factorisations: no code shared with the package."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    return q * np.linalg.det(q)[:, None, None]


def test_directions_agree_with_spice():
    rng = np.random.default_rng(2)
    ra, dec = rng.uniform(0, 2 * np.pi, 50), rng.uniform(-np.pi / 2, np.pi / 2, 50)
    directions = geo.unit_from_radec(ra, dec)
    assert directions.shape == (50, 3)
    np.testing.assert_allclose(
        directions, [spiceypy.radrec(1.0, a, d) for a, d in zip(ra, dec, strict=True)], rtol=0, atol=1e-15
    )
    back = np.transpose([spiceypy.recrad(d)[1:] for d in directions])
    np.testing.assert_allclose(geo.radec_from_unit(7.0 * directions), back, rtol=0, atol=1e-15)


@given(right_ascensions, st.floats(1e-9, 0.1), st.sampled_from([-1.0, 1.0]))
def test_declination_keeps_its_digits_at_the_poles(ra, polar_distance, side):
    direction = [np.sin(polar_distance) * np.cos(ra), np.sin(polar_distance) * np.sin(ra), 0.0]
    direction[2] = side * np.cos(polar_distance)
    back_ra, back_dec = geo.radec_from_unit(direction)
    assert abs(back_dec) == pytest.approx(np.pi / 2 - polar_distance, rel=0, abs=3e-16)
    assert _angle_difference(back_ra, ra) < 2e-15


@pytest.mark.parametrize("tiny", [-1e-20, -1e-300, -0.0])
def test_right_ascension_stays_below_one_turn(tiny):
    ra, _ = geo.radec_from_unit([1.0, tiny, 0.0])
    assert 0.0 <= ra < 2 * np.pi


@given(right_ascensions, declinations)
@example(0.0, np.pi / 2)
@example(1.0, -np.pi / 2)
def test_tangent_basis_is_right_handed_and_points_east_and_north(ra, dec):
    east, north = geo.tangent_basis(ra, dec)
    np.testing.assert_allclose(np.cross(east, north), geo.unit_from_radec(ra, dec), rtol=0, atol=1e-15)
    step = 1e-6
    ahead = geo.unit_from_radec(ra, dec + step) - geo.unit_from_radec(ra, dec - step)
    np.testing.assert_allclose(ahead / (2 * step), north, rtol=0, atol=1e-9)
    assert east[2] == 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-15, 1e-9, 0.1, np.pi / 2, 3.0, np.pi - 1e-9])
def test_angle_between_from_nothing_to_half_a_turn(angle):
    a = geo.unit_from_radec(0.0, 0.4) * 5.0
    east, _ = geo.tangent_basis(0.0, 0.4)
    b = 0.01 * (np.cos(angle) * a / 5.0 + np.sin(angle) * east)
    assert geo.angle_between(a, b) == pytest.approx(angle, rel=1e-12, abs=1e-16)


def test_angle_between_broadcasts():
    assert geo.angle_between(np.ones((4, 1, 3)), np.ones((5, 3))).shape == (4, 5)


@pytest.mark.slow(keep=["focal0", "focal2"])
@FOCAL_AXES
@given(ra=right_ascensions, dec=st.floats(-1.5, 1.5), twist=right_ascensions)
def test_pointing_round_trip(focal, ra, dec, twist):
    attitude = geo.camera_from_j2000(ra, dec, twist, focal)
    np.testing.assert_allclose(attitude @ attitude.T, np.eye(3), rtol=0, atol=1e-15)
    assert np.linalg.det(attitude) == pytest.approx(1.0, rel=0, abs=1e-14)
    back = geo.pointing_angles(attitude, focal)
    assert back[1] == pytest.approx(dec, rel=0, abs=ROUNDING_RAD)
    # RA and twist carry no more than the matrix's rounding over the distance from the pole.
    assert _angle_difference(back[0], ra) < ROUNDING_RAD / np.cos(dec)
    assert _angle_difference(back[2], twist) < ROUNDING_RAD / np.cos(dec)


@pytest.mark.slow(keep=["focal0", "focal3"])
@FOCAL_AXES
@given(
    ra=right_ascensions,
    polar_distance=st.sampled_from([0.0, 1e-16, 1e-12, 1e-8, 1e-4]),
    south=st.booleans(),
    twist=right_ascensions,
)
def test_pointing_round_trip_at_the_poles(focal, ra, polar_distance, south, twist):
    dec = (np.pi / 2 - polar_distance) * (-1 if south else 1)
    attitude = geo.camera_from_j2000(ra, dec, twist, focal)
    angles = geo.pointing_angles(attitude, focal)
    assert angles[1] == pytest.approx(dec, rel=0, abs=ROUNDING_RAD)
    np.testing.assert_allclose(geo.camera_from_j2000(*angles, focal), attitude, rtol=0, atol=ROUNDING_RAD)
    # At the pole only this combination of RA and twist is observable.
    kept = twist + ra if south else twist - ra
    back = angles[2] + angles[0] if south else angles[2] - angles[0]
    assert _angle_difference(back, kept) < ROUNDING_RAD + 2 * polar_distance**2


@given(right_ascensions, st.floats(-1.5, 1.5), right_ascensions)
def test_pointing_agrees_with_spice_euler_angles(ra, dec, twist):
    """A plain camera, +Z boresight: its +Y (line) at position angle `twist` is a third turn of pi + twist."""
    spice = spiceypy.eul2m(np.pi - twist, np.pi / 2 - dec, ra, 3, 2, 3)
    boresight, line = spice[2], spice[1]
    east, north = geo.tangent_basis(ra, dec)
    wanted = geo.pointing_angles(spice, PLAIN)
    np.testing.assert_allclose(geo.unit_from_radec(*wanted[:2]), boresight, rtol=0, atol=1e-15)
    assert _angle_difference(np.arctan2(line @ east, line @ north), wanted[2]) < 1e-13
    np.testing.assert_allclose(geo.camera_from_j2000(*wanted, PLAIN), spice, rtol=0, atol=2e-15)


def test_focal_axes_of_lorri_point_where_they_should():
    """At (RA 0, Dec 0) and twist 0 line runs north and pixel west; a quarter turn brings line to the east."""
    attitude = geo.camera_from_j2000(0.0, 0.0, 0.0, LORRI)
    np.testing.assert_allclose(attitude.T @ [0, 0, -1], [1, 0, 0], atol=1e-15)  # boresight
    np.testing.assert_allclose(attitude.T @ [0, 1, 0], [0, 0, 1], atol=1e-15)  # line: north
    np.testing.assert_allclose(attitude.T @ [1, 0, 0], [0, -1, 0], atol=1e-15)  # pixel: west
    turned = geo.camera_from_j2000(0.0, 0.0, np.pi / 2, LORRI)
    np.testing.assert_allclose(turned.T @ [0, 1, 0], [0, 1, 0], atol=1e-15)  # line: east


def test_mirrored_camera_reverses_pixel_only():
    plain = PLAIN @ geo.camera_from_j2000(1.0, 0.3, 2.0, PLAIN)
    mirrored = LORRI @ geo.camera_from_j2000(1.0, 0.3, 2.0, LORRI)
    np.testing.assert_allclose(mirrored, plain * np.array([[-1], [1], [1]]), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("focal", "match"),
    [(2 * np.eye(3), "not orthonormal"), (np.ones((3, 3)), "not orthonormal"), (np.eye(2), "shape")],
)
def test_bad_focal_axes_are_refused(focal, match):
    with pytest.raises(ValueError, match=match):
        geo.camera_from_j2000(0.0, 0.0, 0.0, focal)


def test_bad_attitudes_are_refused():
    with pytest.raises(ValueError, match="determinant -1"):
        geo.pointing_angles(LORRI, LORRI)
    with pytest.raises(ValueError, match="not orthonormal"):
        geo.quaternion_from_matrix(np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match="finite"):
        geo.camera_from_j2000(np.nan, 0.0, 0.0, PLAIN)


def test_quaternions_agree_with_spice():
    matrices = _random_rotations(200)
    quaternions = geo.quaternion_from_matrix(matrices)
    assert quaternions.shape == (200, 4)
    np.testing.assert_allclose(quaternions, [spiceypy.m2q(m) for m in matrices], rtol=0, atol=5e-15)
    scaled = -3.0 * quaternions
    np.testing.assert_allclose(geo.matrix_from_quaternion(scaled), matrices, rtol=0, atol=2e-15)
    spice = [spiceypy.q2m(q) for q in quaternions]
    np.testing.assert_allclose(geo.matrix_from_quaternion(quaternions), spice, rtol=0, atol=2e-15)


@given(rotation_vectors)
def test_quaternion_scalar_is_never_negative(vector):
    quaternion = geo.quaternion_from_matrix(geo.rotation_from_vector(vector))
    assert quaternion[0] >= 0.0
    assert not np.any(np.signbit(quaternion) & (quaternion == 0.0))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_survive(axis):
    matrix = -np.eye(3)
    matrix[axis, axis] = 1.0
    quaternion = geo.quaternion_from_matrix(matrix)
    assert abs(quaternion[1 + axis]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(geo.matrix_from_quaternion(quaternion), matrix, rtol=0, atol=1e-15)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_bad_quaternions_are_refused(bad):
    with pytest.raises(ValueError, match="gives no rotation"):
        geo.matrix_from_quaternion([[1.0, 0, 0, 0], bad])


@given(rotation_vectors)
def test_rotation_vector_agrees_with_spice_and_comes_back(vector):
    angle = float(np.linalg.norm(vector))
    matrix = geo.rotation_from_vector(vector)
    if angle > 0.0:
        np.testing.assert_allclose(matrix, spiceypy.axisar(vector, angle), rtol=0, atol=2e-15)
    if angle < np.pi - 1e-3:
        np.testing.assert_allclose(geo.vector_from_rotation(matrix), vector, rtol=0, atol=2e-12)


def test_small_rotation_vectors_turn_vectors_actively():
    small, vector = np.array([1e-9, -2e-9, 3e-9]), np.array([0.2, 0.5, -0.7])
    turned = geo.rotation_from_vector(small) @ vector
    np.testing.assert_allclose(turned - vector, np.cross(small, vector), rtol=0, atol=2e-16)


def test_rotations_are_vectorised():
    vectors = np.random.default_rng(3).normal(size=(2, 5, 3)) * 0.5
    matrices = geo.rotation_from_vector(vectors)
    assert matrices.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(geo.vector_from_rotation(matrices), vectors, rtol=0, atol=1e-14)
    assert geo.quaternion_from_matrix(matrices).shape == (2, 5, 4)
    assert geo.rotation_from_vector(np.empty((0, 3))).shape == (0, 3, 3)


def test_zero_vectors_have_no_direction():
    with pytest.raises(ValueError, match="zero vector"):
        geo.unit([[1.0, 0, 0], [0, 0, 0]])


def test_stacks_of_attitudes_are_those_of_single_ones():
    focal = np.diag([1.0, -1.0, 1.0])
    ra, dec, twist = np.array([[0.1, 3.0, 6.2], [-1.5, 0.0, 1.2], [0.3, 2.0, 5.0]])
    stack = geo.camera_from_j2000(ra, dec, twist, focal)
    for i in range(3):
        assert stack[i] == pytest.approx(geo.camera_from_j2000(ra[i], dec[i], twist[i], focal), abs=1e-15)
    assert geo.camera_from_j2000(0.1, dec, 0.3, focal).shape == (3, 3, 3)
    np.testing.assert_allclose(geo.pointing_angle_arrays(stack, focal), [ra, dec, twist], atol=1e-14)


# ---- Few rotations are worked out one by one, many by SciPy: nobody shall see which.

ULPS = 0 if scipy.__version__.startswith("1.17.") else 4  # as it rounds


def vectors_of_every_length(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    vectors = rng.normal(size=(n, 3))
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    vectors *= 10.0 ** rng.uniform(-9.0, 0.0, (n, 1))
    near_half_turns = slice(0, n, 3)
    vectors[near_half_turns] *= (
        np.pi * (1.0 - 10.0 ** rng.uniform(-17, -1, (len(vectors[near_half_turns]), 1)))
    ) / np.linalg.norm(vectors[near_half_turns], axis=1)[:, None]
    return vectors


def test_few_rotations_round_as_many_do():
    rng = np.random.default_rng(3)
    for vector in vectors_of_every_length(300):
        made = geo.rotation_from_vector(vector)
        np.testing.assert_array_max_ulp(made, Rotation.from_rotvec(vector).as_matrix(), ULPS)
        printed = made + rng.normal(0.0, 10.0 ** rng.uniform(-17.0, -7.5), (3, 3))  # not quite orthogonal
        for matrix in (made, printed):
            by_scipy = Rotation.from_matrix(matrix[None])
            xyzw = np.roll(geo.quaternion_from_matrix(matrix), -1)
            expected = by_scipy.as_quat()[0]
            np.testing.assert_array_max_ulp(xyzw, np.copysign(1.0, expected[3]) * expected + 0.0, ULPS)
            np.testing.assert_array_max_ulp(geo.vector_from_rotation(matrix), by_scipy.as_rotvec()[0], ULPS)
        wxyz = rng.normal(0.0, 10.0 ** rng.uniform(-3.0, 3.0), 4)
        expected = Rotation.from_quat(np.roll(wxyz, -1)).as_matrix()
        np.testing.assert_array_max_ulp(geo.matrix_from_quaternion(wxyz), expected, ULPS)


def test_a_half_turn_has_one_vector_however_many_are_asked():
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-0.6, 0.8, 0.0], [0.0, -0.6, 0.8]])
    turns = 2.0 * axes[:, :, None] * axes[:, None] - np.eye(3)
    one_by_one = np.array([geo.vector_from_rotation(turn) for turn in turns])
    together = geo.vector_from_rotation(np.tile(turns, (rotations.FEW, 1, 1)))[: len(turns)]
    np.testing.assert_array_equal(one_by_one, together)
    np.testing.assert_allclose(np.abs(one_by_one), np.pi * np.abs(axes), rtol=0, atol=1e-14)


def test_shapes_of_none_one_and_many():
    for shape in ((), (0,), (3,), (rotations.FEW + 1,), (2, 3)):
        vectors = np.full((*shape, 3), 0.1)
        matrices = geo.rotation_from_vector(vectors)
        assert matrices.shape == (*shape, 3, 3)
        assert geo.quaternion_from_matrix(matrices).shape == (*shape, 4)
        assert geo.matrix_from_quaternion(np.ones((*shape, 4))).shape == (*shape, 3, 3)
        np.testing.assert_allclose(geo.vector_from_rotation(matrices), vectors, rtol=0, atol=1e-15)
