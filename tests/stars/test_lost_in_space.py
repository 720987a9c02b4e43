"""Star fields solved without an attitude; the big exam is ``lost_exam.py`` beside this file, run by hand."""

from dataclasses import replace

import numpy as np
import pytest
from lost_exam import camera, detections, draw_field, error_px, random_attitude, random_dots

from opnav_workbench.camera import FisheyeDistortion
from opnav_workbench.stars.lost_in_space import index_of_stars, solve_lost
from opnav_workbench.stars.lost_in_space.patterns import ORDERS, code_of, named_orders
from opnav_workbench.stars.lost_in_space.verification import DetectionMap

STARS, MISSING = 4000, 0.2  # one in ten square degrees: fields from 13 deg on
WIDTHS_DEG = (13.0, 16.0, 20.0)


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(STARS, 3))
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    return vectors, 8.0 + 2.0 * np.log10(rng.uniform(0.0, 1.0, STARS))  # ten times as many in two magnitudes


@pytest.fixture(scope="module")
def index(sky, tmp_path_factory):
    known = np.random.default_rng(2).random(STARS) >= MISSING
    return index_of_stars(sky[0][known], sky[1][known], folder=tmp_path_factory.mktemp("index"))


def test_codes_know_neither_place_nor_order_but_the_mirror():
    rng = np.random.default_rng(3)
    threes = rng.normal([0.0, 0.0, 20.0], 1.0, (50, 3, 3))
    threes /= np.linalg.norm(threes, axis=2)[:, :, None]

    def codes(of):
        rows, orders = named_orders(of)
        assert rows.tolist() == list(range(50))
        return code_of(np.take_along_axis(of, ORDERS[orders][:, :, None], axis=1))[0]

    turned = threes[:, [2, 0, 1]] @ random_attitude(rng).T
    np.testing.assert_allclose(codes(turned), codes(threes), atol=1e-9)
    np.testing.assert_allclose(codes(threes * [1.0, -1.0, 1.0]), codes(threes) * [1.0, -1.0], atol=1e-9)


def test_codes_are_places_in_the_plane_half_way_between_a_and_b():
    """By gnomonic projection, which small and large triangles share."""
    a, b = np.array([-0.3, 0.0, 1.0]), np.array([0.3, 0.0, 1.0])
    c = np.array([-0.1, 0.2, 1.0])
    three = np.stack([v / np.linalg.norm(v) for v in (a, b, c)])[None]
    code, angle = code_of(three @ random_attitude(np.random.default_rng(7)).T)
    np.testing.assert_allclose(code[0], [0.2 / 0.6, 0.2 / 0.6], atol=1e-12)
    np.testing.assert_allclose(angle, 2.0 * np.arctan(0.3), atol=1e-12)


def test_noise_gives_triangles_of_two_equal_sides_both_names():
    three = np.array([[[0.0, 0.0, 100.0], [10.0, 0.0, 100.0], [5.02, 6.0, 100.0]]])
    three /= np.linalg.norm(three, axis=2)[:, :, None]
    assert len(named_orders(three)[0]) == 1
    assert len(named_orders(three, slack=0.02)[0]) == 2


@pytest.mark.parametrize("width_deg", WIDTHS_DEG)
def test_fields_with_false_and_missing_stars(sky, index, width_deg):
    rng = np.random.default_rng(int(width_deg))
    for _ in range(4):
        field = draw_field(rng, *sky, width_deg=width_deg, n_stars=12)
        answer = solve_lost(index, detections(field.places_px, field.flux), camera(field.told_focal_px))
        assert answer.camera_from_j2000 is not None, answer.message
        assert error_px(field, answer) < 3.0
        np.testing.assert_allclose(
            answer.camera_from_j2000 @ answer.camera_from_j2000.T, np.eye(3), atol=1e-9
        )
        assert abs(answer.focal_scale * field.told_focal_px / field.focal_px - 1.0) < 6.0 * answer.focal_sigma


def test_a_fisheye_that_sees_all_in_front_of_it(sky, index):
    """Its corners see nothing, and a plane holds but a part of its sky."""
    rng = np.random.default_rng(8)
    attitude = random_attitude(rng)
    optics = camera(320.0)
    lens = replace(optics, distortion=FisheyeDistortion(optics.focal_length_mm))
    assert np.isnan(lens.unproject([0.0, 0.0])).all()
    places = lens.project(sky[0] @ attitude.T)
    seen = np.flatnonzero(lens.on_detector(places))
    seen = seen[np.argsort(sky[1][seen])[:150]]
    answer = solve_lost(
        index, detections(places[seen] + rng.normal(0.0, 0.05, (150, 2)), 10.0 ** (-0.4 * sky[1][seen])), lens
    )
    assert answer.camera_from_j2000 is not None, answer.message
    np.testing.assert_allclose(answer.camera_from_j2000, attitude, atol=0.5 * lens.pixel_scale_rad)


def test_mirrored_pictures_are_told_and_not_solved(sky, index):
    field = draw_field(np.random.default_rng(4), *sky, width_deg=15.0, n_stars=16)
    places = field.places_px * [1.0, -1.0] + [0.0, 1023.0]
    answer = solve_lost(index, detections(places, field.flux), camera(field.told_focal_px))
    assert answer.camera_from_j2000 is None
    # The camera's line axis the other way round, in a frame of the other hand: what it solved is the true attitude.
    np.testing.assert_allclose(answer.mirrored, field.camera_from_j2000, atol=1e-3)


def test_the_map_of_detections_tells_the_nearest_and_nothing_far_off():
    seen = np.array([[0.0, 0.0], [0.006, 0.0], [0.2, -0.1]])  # the first two nearer than the reach of either
    drawn = DetectionMap.drawn(seen, 0.01)
    asked = np.array([[0.001, 0.0], [0.005, 0.001], [0.2, -0.095], [0.1, 0.1], [-0.02, 0.0]])
    rotations = np.stack([np.eye(3), random_attitude(np.random.default_rng(6))])
    # That stand there by these attitudes, at scale 1
    stars = np.column_stack([asked, np.ones(5)]) @ rotations
    axes = drawn.axes(rotations, np.ones(2))
    found = drawn.near(stars.astype(np.float32), axes)
    np.testing.assert_array_equal(found, [[0, 1, 2, -1, -1]] * 2)
    half = drawn.axes(rotations, np.full(2, 2.0))  # a place counts half as far
    np.testing.assert_array_equal(
        drawn.near((np.column_stack([2.0 * asked, np.ones(5)]) @ rotations).astype(np.float32), half), found
    )
    np.testing.assert_array_equal(drawn.near(-stars.astype(np.float32), axes), np.full((2, 5), -1))  # behind


def test_dots_get_no_answer(index, sample):
    rng = np.random.default_rng(5)
    for number in range(sample.trials(15)):
        focal = 512.0 / np.tan(np.radians(0.5 * WIDTHS_DEG[number % 3]))
        answer = solve_lost(index, detections(*random_dots(rng)), camera(focal), try_mirrored=False)
        assert answer.camera_from_j2000 is None, answer.message


def test_damaged_bands_are_made_again(sky, tmp_path):
    some = sky[0][:200], sky[1][:200]
    made = index_of_stars(*some, folder=tmp_path).band(0)
    (path,) = tmp_path.glob("*-band0.opnavindex")
    whole = path.read_bytes()
    for at in (20, len(whole) // 2):  # header and content
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        np.testing.assert_array_equal(index_of_stars(*some, folder=tmp_path).band(0).patterns, made.patterns)
        assert path.read_bytes() == whole


def test_detections_in_one_place_have_no_pattern(index):
    """No four of them are wide enough; the search ended in a traceback."""
    places = 500.0 + np.linspace(0.0, 0.5, 12)[:, None] * [1.0, 2.0]
    assert (
        solve_lost(index, detections(places, np.linspace(100.0, 1.0, 12)), camera(2e4)).camera_from_j2000
        is None
    )
