"""Pictures in which every star is seen twice, told from those in which detections only happen to be so far apart."""

import numpy as np
import pytest

from opnav_workbench.stars import Detections, StarFlag, identify, second_images

# About along a line: which image is the upper one differs from star to star.
OFFSET_PX = np.array([-7.9, 0.02])
RANDOM_PICTURES = 100


def seen_twice(rng, stars=5, share=0.5, others=12, size_px=1024.0):
    """Detections of stars, their second images and other sources, brightest first; which of them are second images."""
    places, mag = rng.uniform(20.0, size_px - 20.0, (stars, 2)), rng.uniform(8.0, 11.0, stars)
    strewn = rng.uniform(0.0, size_px, (others, 2))
    where = np.vstack([places, places + OFFSET_PX, strewn]) + rng.normal(0.0, 0.1, (2 * stars + others, 2))
    looks = np.r_[mag, mag - 2.5 * np.log10(share), rng.uniform(8.0, 12.0, others)]
    looks = looks + rng.normal(0.0, 0.05, len(looks))
    order, ones = np.argsort(looks), np.ones(len(looks))
    second = np.isin(order, np.arange(stars, 2 * stars))
    detections = Detections(where, 10.0 ** (-0.4 * looks), ones, ones, np.zeros(len(looks), int)).take(order)
    return detections, np.flatnonzero(second)


@pytest.mark.parametrize("share", [0.7, 0.3, 0.05])
def test_fainter_images_are_told(share):
    rng = np.random.default_rng(int(100 * share))
    for _ in range(20):
        detections, second = seen_twice(rng, share=share)
        twice = second_images(detections)
        assert twice.clear
        assert set(second) <= set(twice.second)
        np.testing.assert_allclose(twice.offset_px, OFFSET_PX, atol=0.3)
        assert abs(twice.fainter_mag + 2.5 * np.log10(share)) < 0.2


def test_of_equal_images_none_is_the_star():
    rng = np.random.default_rng(5)
    found = [second_images(seen_twice(rng, share=1.0)[0]) for _ in range(40)]
    assert all(twice is not None and not twice.clear for twice in found)


def test_sources_strewn_at_random_are_seen_once():
    rng = np.random.default_rng(6)
    for _ in range(RANDOM_PICTURES):
        detections, _ = seen_twice(rng, stars=0, others=int(rng.integers(2, 300)))
        assert second_images(detections) is None


def test_three_of_many_are_chance_and_crowds_of_false_detections_too():
    rng = np.random.default_rng(7)
    assert second_images(seen_twice(rng, stars=3, others=280)[0]) is None
    for _ in range(20):  # a hundred detections on a body that nobody has masked
        crowd, others = rng.uniform(500.0, 560.0, (100, 2)), rng.uniform(0.0, 1024.0, (20, 2))
        ones = np.ones(120)
        assert (
            second_images(Detections(np.vstack([crowd, others]), ones, ones, ones, np.zeros(120, int)))
            is None
        )


def test_saturated_images_are_not_compared():
    detections, _ = seen_twice(np.random.default_rng(8), share=0.4)
    flags = np.full(len(detections), int(StarFlag.SATURATED))
    twice = second_images(
        Detections(detections.pixel_line, detections.flux_dn, detections.snr, detections.sharpness, flags)
    )
    assert not twice.clear


def test_an_identification_with_a_rival_in_other_detections_is_not_sure():
    """As where the camera turned between two stops: no difference is common to all stars."""
    rng = np.random.default_rng(9)
    stars = rng.uniform(100.0, 900.0, (8, 2))
    c, s = np.cos(np.radians(0.4)), np.sin(np.radians(0.4))
    turned = (stars - 511.5) @ np.array([[c, s], [-s, c]]) + 511.5 + [9.0, 4.0]
    places = np.vstack([stars[:7], turned])  # one of the first images is lost
    ones, mag = np.ones(15), np.full(8, 9.0)
    both = Detections(places, ones, ones, ones, np.zeros(15, int))
    limits = {"center_px": (511.5, 511.5), "max_twist_rad": np.radians(0.6)}
    assert identify(stars, mag, both.take(np.arange(7)), **limits).sure
    assert identify(stars, mag, both.take(np.arange(7, 15)), **limits).sure
    found = identify(stars, mag, both, **limits)
    assert len(found.pairs) >= 7
    assert found.confidence <= 0.5
