"""Star identification on random fields with cosmic rays, missing stars, and pointing off by up to 60 px."""

from dataclasses import dataclass

import numpy as np
import pytest

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars import Detections, identify

ZERO_POINT = 20.0
COSMIC_RAYS = 30
UNKNOWN_STARS = 10  # detected, but in no catalog
RIGHT_PX = 1.0


def move(points, center, shift, twist):
    """Turn points about the center by a twist, positive from +pixel toward +line, then shift them."""
    c, s = np.cos(twist), np.sin(twist)
    return (points - center) @ np.array([[c, s], [-s, c]]) + center + shift


@dataclass
class Field:
    predicted: np.ndarray
    magnitude: np.ndarray
    detections: Detections
    center: np.ndarray
    shift: np.ndarray
    twist: float
    truth: np.ndarray  # detection of each star, -1 where it has none


def random_field(rng, size, stars, missing=0.2, max_shift=60.0, max_twist_deg=0.3):
    """Stars on the detector at least `stars`, the density continued around it."""
    center, margin = np.full(2, (size - 1) / 2.0), 70.0
    n = max(stars, rng.poisson(stars * (1.0 + 2.0 * margin / size) ** 2))
    angle, radius = rng.uniform(0.0, 2.0 * np.pi), max_shift * np.sqrt(rng.uniform())
    shift, twist = (
        radius * np.array([np.cos(angle), np.sin(angle)]),
        np.radians(rng.uniform(-1, 1) * max_twist_deg),
    )
    while True:
        predicted = rng.uniform(-margin, size - 1 + margin, (n, 2))
        observed = move(predicted, center, shift, twist)
        on = np.all((observed > 0.0) & (observed < size - 1.0), axis=1)
        if on.sum() >= stars:
            break
        n += 1
    magnitude = 12.0 + np.log(rng.uniform(1e-3, 1.0, n))
    seen = on & (rng.uniform(size=n) > missing)
    others = COSMIC_RAYS + UNKNOWN_STARS
    xy = np.vstack(
        [observed[seen] + rng.normal(0.0, 0.2, (seen.sum(), 2)), rng.uniform(0.0, size - 1.0, (others, 2))]
    )
    mag = np.r_[magnitude[seen] - ZERO_POINT + rng.normal(0.0, 0.3, seen.sum()),
                rng.uniform(-13.0, -7.5, COSMIC_RAYS), rng.uniform(-8.5, -7.5, UNKNOWN_STARS)]  # fmt: skip
    order = np.argsort(mag)
    truth = np.full(n, -1)
    truth[seen] = np.argsort(order)[: seen.sum()]
    return Field(predicted, magnitude, make_detections(xy[order], mag[order]), center, shift, twist, truth)


def make_detections(xy, mag):
    one = np.ones(len(xy))
    return Detections(
        np.asarray(xy, float), 10.0 ** (-0.4 * np.asarray(mag)), 50.0 * one, one, np.zeros(len(xy), int)
    )


@pytest.mark.slow(keep=["1024-None"])
@pytest.mark.parametrize(
    ("size", "zero_point"), [(1024, None), (1024, ZERO_POINT), (256, None), (256, ZERO_POINT)]
)
def test_random_fields_are_identified(size, zero_point):
    rng = np.random.default_rng([size, 0 if zero_point is None else 1])
    right, pairs, wrong_pairs = 0, 0, 0
    fields = 100
    for _ in range(fields):
        field = random_field(rng, size, int(rng.integers(5, 25)))
        found = identify(
            field.predicted,
            field.magnitude,
            field.detections,
            center_px=field.center,
            zero_point_mag=zero_point,
        )
        good = np.hypot(*(found.shift_px - field.shift)) < RIGHT_PX
        right += good
        assert good or not found.sure, found.message
        if good and found.sure:
            pairs += len(found.pairs)
            wrong_pairs += np.sum(field.truth[found.pairs[:, 0]] != found.pairs[:, 1])
            assert abs(found.twist_rad - field.twist) < np.radians(0.3)
    assert right >= 0.99 * fields
    assert wrong_pairs <= 0.01 * pairs


def test_pairs_are_one_to_one_and_twist_is_measured():
    field = random_field(np.random.default_rng(3), 1024, 25, missing=0.0)
    found = identify(field.predicted, field.magnitude, field.detections, center_px=field.center)
    assert len(set(found.pairs[:, 0])) == len(set(found.pairs[:, 1])) == len(found.pairs) >= 25
    assert abs(found.twist_rad - field.twist) < np.radians(0.02)
    np.testing.assert_allclose(found.shift_px, field.shift, atol=0.2)
    assert abs(found.zero_point_mag - ZERO_POINT) < 0.3
    assert found.confidence > 0.999


@pytest.mark.slow
def test_few_stars_never_give_a_confident_wrong_answer():
    rng = np.random.default_rng(4)
    sure, sure_wrong, wrong = 0, 0, 0
    for _ in range(150):
        field = random_field(rng, 256, int(rng.integers(1, 5)), missing=0.4)
        found = identify(field.predicted, field.magnitude, field.detections, center_px=field.center)
        bad = len(found.pairs) > 0 and np.hypot(*(found.shift_px - field.shift)) > RIGHT_PX
        sure += found.sure
        sure_wrong += bad and found.sure
        wrong += bad
    assert wrong > 10  # the fields are hard enough to be mistaken
    assert sure > 20  # and good enough to be sure of some
    assert sure_wrong == 0


def test_a_wrong_sky_is_not_identified():
    rng = np.random.default_rng(5)
    for _ in range(40):
        field = random_field(rng, 1024, 12)
        elsewhere = rng.uniform(0.0, 1023.0, field.predicted.shape)
        found = identify(elsewhere, field.magnitude, field.detections, center_px=field.center)
        assert not found.sure, found.message


def test_one_star_is_taken_by_brightness_and_nearness_and_never_for_sure():
    xy = [[110.0, 95.0], [103.0, 100.0], [118.0, 120.0], [30.0, 30.0]]
    seen = make_detections(xy, [-9.8, -6.0, -13.5, -4.0])
    found = identify([[100.0, 100.0]], [10.0], seen, center_px=(127.5, 127.5), zero_point_mag=ZERO_POINT)
    assert found.pairs.tolist() == [[0, 0]]
    np.testing.assert_allclose(found.shift_px, [10.0, -5.0], atol=1e-4)
    assert 0.5 < found.confidence < 0.999
    assert not found.sure
    assert "brightness and nearness only" in found.message
    assert "not sure" in found.message
    blind = identify([[100.0, 100.0]], [10.0], seen, center_px=(127.5, 127.5))
    assert blind.pairs.tolist() == [[0, 1]]
    assert blind.confidence < 0.8


def test_one_star_without_a_detection_of_its_brightness_is_not_identified():
    seen = make_detections([[103.0, 100.0]], [-5.0])
    found = identify([[100.0, 100.0]], [10.0], seen, center_px=(127.5, 127.5), zero_point_mag=ZERO_POINT)
    assert len(found.pairs) == 0
    assert found.confidence == 0.0
    assert "brightness" in found.message


def test_nothing_predicted_or_nothing_detected_is_said():
    seen = make_detections([[103.0, 100.0]], [-9.0])
    none = make_detections(np.zeros((0, 2)), np.zeros(0))
    assert "no predicted star" in identify(np.zeros((0, 2)), [], seen, center_px=(127.5, 127.5)).message
    empty = identify([[1.0, 2.0]], [9.0], none, center_px=(127.5, 127.5))
    assert "no star detected" in empty.message
    assert empty.confidence == 0.0


def test_limits_are_kept():
    rng = np.random.default_rng(6)
    field = random_field(rng, 1024, 20, max_shift=0.0)
    far = field.predicted - [45.0, 0.0]
    near = identify(far, field.magnitude, field.detections, center_px=field.center, max_shift_px=20.0)
    assert near.confidence < 0.5
    wide = identify(far, field.magnitude, field.detections, center_px=field.center)
    np.testing.assert_allclose(wide.shift_px, [45.0, 0.0], atol=0.5)


def test_an_unknown_magnitude_does_no_harm():
    field = random_field(np.random.default_rng(7), 1024, 15)
    magnitude = field.magnitude.copy()
    magnitude[::5] = np.nan
    found = identify(field.predicted, magnitude, field.detections, center_px=field.center)
    np.testing.assert_allclose(found.shift_px, field.shift, atol=0.5)


def test_bad_input_is_refused():
    seen = make_detections([[103.0, 100.0]], [-9.0])
    with pytest.raises(CenterfindingError, match="magnitudes"):
        identify([[1.0, 2.0]], [9.0, 9.0], seen, center_px=(127.5, 127.5))
    with pytest.raises(CenterfindingError, match="limits"):
        identify([[1.0, 2.0]], [9.0], seen, center_px=(127.5, 127.5), max_shift_px=-1.0)


def test_a_pattern_of_the_wrong_brightness_is_less_sure():
    """A ghost of all stars has their pattern, fainter than the camera's zero point tells."""
    rng = np.random.default_rng(11)
    predicted, mag = rng.uniform(30.0, 220.0, (3, 2)), rng.uniform(7.5, 9.5, 3)
    doubt = []
    for fainter in (0.0, 1.2):
        seen = make_detections(predicted + np.array([3.0, 2.0]), mag + fainter - ZERO_POINT)
        found = identify(predicted, mag, seen, center_px=(127.5, 127.5), zero_point_mag=ZERO_POINT)
        assert len(found.pairs) == 3
        doubt.append(1.0 - found.confidence)
    assert doubt[1] > 3.0 * doubt[0]
