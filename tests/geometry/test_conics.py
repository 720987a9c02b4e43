"""Limb and terminator against SPICE's ellipsoid routines, ellipses against points drawn on them."""

import numpy as np
import pytest
import spiceypy
from hypothesis import assume, given
from hypothesis import strategies as st

from opnav_workbench import geometry as geo

BENNU_KM = np.array([0.283065, 0.271215, 0.249720])
FLAT_KM = np.array([180.0, 120.0, 60.0])
CAMERA_FROM_BODY = geo.rotation_from_vector([0.4, -1.2, 0.8])
VIEWS = pytest.mark.parametrize(
    ("radii", "position"),
    [(BENNU_KM, [0.3, -0.2, 6.6]), (FLAT_KM, [150.0, 60.0, 300.0]), (FLAT_KM, [1e4, -2e4, -1e6])],
)


def _miss_rad(cone, directions):
    """Angles by which directions miss the cone: its quadratic form over the form's gradient."""
    form = np.einsum("ni,ij,nj->n", directions, cone, directions)
    return np.abs(form) / np.linalg.norm(2 * directions @ cone, axis=1)


def _limit_rad(radii, position):
    """Rounding of a direction over the body's angular size: 1e-12 rad where Bennu fills 200 LORRI pixels."""
    return 1e-15 * np.linalg.norm(position) / radii.min()


def _camera_in_body(position):
    return -CAMERA_FROM_BODY.T @ np.asarray(position, float)


def _spice_limb(radii, position, n=60):
    """Unit directions, camera frame, through points of the limb ellipse that SPICE's edlimb finds."""
    camera = _camera_in_body(position)
    center, major, minor = spiceypy.el2cgv(spiceypy.edlimb(*radii, camera))
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    points = center + np.cos(angles) * major + np.sin(angles) * minor
    return geo.unit((points - camera) @ CAMERA_FROM_BODY.T)


@VIEWS
def test_limb_cone_holds_the_limb_that_spice_finds(radii, position):
    cone = geo.limb_cone(position, radii, CAMERA_FROM_BODY)
    spice = _spice_limb(radii, position)
    assert _miss_rad(cone, spice).max() < _limit_rad(radii, position)
    np.testing.assert_array_equal(cone, cone.T)
    toward = geo.unit(position)
    assert toward @ cone @ toward < 0.0


@VIEWS
def test_limb_points_touch_the_body(radii, position):
    camera = _camera_in_body(position)
    limb = geo.limb_points(position, radii, CAMERA_FROM_BODY, n=90)
    np.testing.assert_allclose(np.linalg.norm(limb, axis=1), 1.0, rtol=0, atol=1e-15)
    limb_ellipse = spiceypy.edlimb(*radii, camera)
    normal, constant = spiceypy.pl2nvc(spiceypy.psv2pl(*spiceypy.el2cgv(limb_ellipse)))
    for direction in limb @ CAMERA_FROM_BODY:
        point = camera + direction * (constant - normal @ camera) / (normal @ direction)
        surface, altitude = spiceypy.nearpt(point, *radii)
        assert abs(altitude) < 1e-10 * np.linalg.norm(position)
        slant = spiceypy.surfnm(*radii, surface) @ direction
        assert abs(slant) < 1e-8  # the line of sight lies in the tangent plane


@VIEWS
def test_limb_points_run_once_around(radii, position):
    limb = geo.limb_points(position, radii, CAMERA_FROM_BODY, n=40)
    toward = geo.unit(position)
    east, north = geo.tangent_basis(*geo.radec_from_unit(toward))
    turns = np.unwrap(np.arctan2(limb @ east, limb @ north))
    steps = np.diff(turns)
    assert np.all(steps > 0) or np.all(steps < 0)
    assert 1.8 * np.pi < abs(turns[-1] - turns[0]) < 2 * np.pi


def test_limb_of_a_sphere_is_a_circle_at_the_arcsine():
    position = np.array([300.0, -400.0, 1200.0])
    limb = geo.limb_points(position, [65.0] * 3, CAMERA_FROM_BODY, n=16)
    np.testing.assert_allclose(
        geo.angle_between(limb, position), np.arcsin(65.0 / 1300.0), rtol=0, atol=1e-15
    )


@VIEWS
def test_terminator_points_stand_where_the_sun_grazes(radii, position):
    """n . s = 0 at the point where SPICE's surfpt first meets the body: on the terminator, and in view."""
    camera, sun_camera = _camera_in_body(position), np.array([4.0e5, 2.5e5, -0.5e5])
    arc = geo.terminator_points(position, radii, CAMERA_FROM_BODY, sun_camera, n=41)
    assert arc.shape == (41, 3)
    sun = CAMERA_FROM_BODY.T @ sun_camera
    for direction in (arc @ CAMERA_FROM_BODY)[1:-1]:  # the ends lie on the limb, where surfpt is a coin toss
        point = spiceypy.surfpt(camera, direction, *radii)
        grazing = spiceypy.surfnm(*radii, point) @ geo.unit(sun - point)
        assert abs(grazing) < 1e-8


@VIEWS
def test_terminator_runs_from_limb_to_limb(radii, position):
    cone = geo.limb_cone(position, radii, CAMERA_FROM_BODY)
    ends = geo.terminator_points(position, radii, CAMERA_FROM_BODY, [4e5, 2.5e5, -0.5e5], n=9)[[0, -1]]
    assert _miss_rad(cone, ends).max() < _limit_rad(radii, position)
    assert geo.angle_between(*ends) > 0.5 * radii.min() / np.linalg.norm(position)


@pytest.mark.parametrize("phase_deg", [20.0, 60.0, 90.0, 130.0])
def test_terminator_of_a_far_sphere_bulges_by_the_cosine_of_the_phase(phase_deg):
    """Middle of the arc: R cos(phase) from the center, toward night (gibbous) or day (crescent)."""
    phase = np.radians(phase_deg)
    sun = 1e9 * np.array([np.sin(phase), 0.0, -np.cos(phase)])
    arc = geo.terminator_points([0, 0, 1e7], [1000.0] * 3, np.eye(3), sun, n=181)
    middle = arc[90] / arc[90, 2] * 1e7
    np.testing.assert_allclose(middle[:2], [-1000.0 * np.cos(phase), 0.0], rtol=0, atol=0.2)


def test_no_terminator_at_full_and_new_phase():
    """Exactly in line with a Sun farther than the camera, and on the other side, camera near the body."""
    for sun in ([0.0, 0.0, -1e8], [0.0, 0.0, 1e8]):
        arc = geo.terminator_points([0.0, 0.0, 5e3], [1000.0] * 3, np.eye(3), sun)
        assert arc.shape == (0, 3)


def test_whole_terminator_is_seen_from_behind_a_near_lamp():
    lamp, camera_distance = 2000.0, 9000.0
    ring = geo.terminator_points([0, 0, camera_distance], [1000.0] * 3, np.eye(3), [0, 0, -lamp], n=24)
    assert ring.shape == (24, 3)
    height = camera_distance - 1000.0**2 / lamp
    radius = 1000.0 * np.sqrt(1 - (1000.0 / lamp) ** 2)
    np.testing.assert_allclose(
        geo.angle_between(ring, [0, 0, 1.0]), np.arctan2(radius, height), rtol=0, atol=1e-15
    )
    assert geo.angle_between(ring[0], ring[-1]) == pytest.approx(
        geo.angle_between(ring[0], ring[1]), rel=1e-12
    )


def test_a_viewer_inside_the_body_is_refused():
    with pytest.raises(ValueError, match=r"camera is not outside the body: 0\.5 body radii"):
        geo.limb_cone([0, 0, 30.0], FLAT_KM, np.eye(3))
    with pytest.raises(ValueError, match="camera is not outside"):
        geo.limb_points([0, 0, 60.0], FLAT_KM, np.eye(3))
    with pytest.raises(ValueError, match="Sun is not outside"):
        geo.terminator_points([0, 0, 600.0], FLAT_KM, np.eye(3), [90.0, 0, 0])


@pytest.mark.parametrize("radii", [[1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 1.0, -1.0], [1.0, np.nan, 1.0]])
def test_bad_radii_are_refused(radii):
    with pytest.raises(ValueError, match="three positive numbers"):
        geo.limb_cone([0, 0, 10.0], radii, np.eye(3))


def test_a_mirror_is_no_attitude():
    with pytest.raises(ValueError, match="determinant -1"):
        geo.limb_points([0, 0, 10.0], [1, 1, 1], np.diag([1.0, 1, -1]))


def _conic_of(center, semi_axes, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    axes = np.array([[cos, sin], [-sin, cos]])
    to_unit_circle = np.eye(3)
    to_unit_circle[:2, :2] = axes / np.asarray(semi_axes)[:, None]
    to_unit_circle[:2, 2] = -to_unit_circle[:2, :2] @ center
    return to_unit_circle.T @ np.diag([1.0, 1.0, -1.0]) @ to_unit_circle


@pytest.mark.slow
@given(
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.floats(0.1, 5),
    st.floats(0.1, 0.95),
    st.floats(-np.pi / 2, np.pi / 2, exclude_min=True),
    st.sampled_from([1.0, -1.0, 1e-9, -1e12]),
)
def test_ellipse_comes_back_from_its_conic(center, major, ratio, angle, scale):
    assume(abs(angle) < np.pi / 2 - 1e-9)
    ellipse = geo.ellipse_from_conic(scale * _conic_of(center, [major, ratio * major], angle))
    np.testing.assert_allclose(ellipse.center, center, rtol=0, atol=1e-11)
    np.testing.assert_allclose(ellipse.semi_axes, [major, ratio * major], rtol=1e-10)
    assert ellipse.angle_rad == pytest.approx(angle, rel=0, abs=1e-11)
    assert not ellipse.center.flags.writeable


def test_ellipse_standing_upright():
    ellipse = geo.ellipse_from_conic(np.diag([4.0, 1.0, -4.0]))
    np.testing.assert_allclose(ellipse.semi_axes, [2.0, 1.0])
    assert ellipse.angle_rad == pytest.approx(np.pi / 2, abs=1e-15)


@pytest.mark.parametrize(
    ("conic", "match"),
    [
        (np.diag([1.0, -1.0, -1.0]), "parabola or hyperbola"),
        (np.array([[1.0, 0, 0], [0, 0, -0.5], [0, -0.5, 0]]), "parabola or hyperbola"),
        (np.zeros((3, 3)), "parabola or hyperbola"),
        (np.diag([1.0, 2.0, 3.0]), "no real points"),
        (np.diag([-1.0, -2.0, 0.0]), "no real points"),
        (np.full((3, 3), np.nan), "finite"),
        (np.eye(2), "shape"),
    ],
)
def test_conics_that_are_no_ellipses_are_refused(conic, match):
    with pytest.raises(ValueError, match=match):
        geo.ellipse_from_conic(conic)


def test_limb_points_project_onto_the_ellipse_of_the_cone():
    """A camera that looks along -Z: plane coordinates u = (x, y) / |z|, so s = diag(1, 1, -1) u."""
    position = np.array([2.0, -1.0, -9.0])
    looking = np.diag([1.0, 1.0, -1.0])
    cone = geo.limb_cone(position, [3.0, 2.0, 1.5], CAMERA_FROM_BODY)
    ellipse = geo.ellipse_from_conic(looking.T @ cone @ looking)
    limb = geo.limb_points(position, [3.0, 2.0, 1.5], CAMERA_FROM_BODY, n=50)
    plane = limb[:, :2] / np.abs(limb[:, 2:]) - ellipse.center
    cos, sin = np.cos(ellipse.angle_rad), np.sin(ellipse.angle_rad)
    u, v = (plane @ [[cos, -sin], [sin, cos]] / ellipse.semi_axes).T
    np.testing.assert_allclose(u**2 + v**2, 1.0, rtol=0, atol=1e-12)


def test_a_limb_reaching_behind_the_camera_is_no_ellipse():
    with pytest.raises(ValueError, match="parabola or hyperbola"):
        geo.ellipse_from_conic(geo.limb_cone([0, 5.0, 1.0], [3.0, 3.0, 3.0], np.eye(3)))


@given(st.floats(0.0, 0.9), st.floats(1e-3, 0.5))
def test_sphere_center_offset_agrees_with_the_ellipse(off_axis, angular_radius):
    assume(off_axis + angular_radius < 1.3)
    position = np.array([np.sin(off_axis), 0.0, np.cos(off_axis)])
    ellipse = geo.ellipse_from_conic(geo.limb_cone(position, [np.sin(angular_radius)] * 3, np.eye(3)))
    offset = ellipse.center[0] - np.tan(off_axis)
    assert geo.sphere_center_offset(off_axis, angular_radius) == pytest.approx(offset, rel=1e-6, abs=1e-11)


@pytest.mark.parametrize(("off_axis", "radius"), [(1.5, 0.2), (2.5, 0.1), (np.nan, 0.1)])
def test_sphere_center_offset_needs_a_closed_limb(off_axis, radius):
    with pytest.raises(ValueError, match="does not close"):
        geo.sphere_center_offset(off_axis, radius)


def test_limb_of_a_barely_resolved_body_keeps_its_size():
    """One LORRI pixel across at the corner of the picture: its size is still good to 1e-5 of itself."""
    position, radius = 1e9 * geo.unit([3.6e-3, 0.0, 1.0]), 2500.0
    ellipse = geo.ellipse_from_conic(geo.limb_cone(position, [radius] * 3, np.eye(3)))
    assert ellipse.semi_axes[1] == pytest.approx(2.5e-6 * (1 + 3.6e-3**2 / 2), rel=1e-5)
    np.testing.assert_allclose(ellipse.center, [3.6e-3, 0.0], rtol=0, atol=1e-13)
