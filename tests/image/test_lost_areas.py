"""Rectangles of one value, which never arrived, are told from quiet and dark skies."""

import numpy as np
import pytest

from opnav_workbench.image.planes import lost_areas

N = 256


def _sky(noise_dn=2.0):
    return np.random.default_rng(7).normal(20.0, noise_dn, (N, N))


@pytest.mark.parametrize("value", [0.0, 20.0, 4095.0])
def test_blocks_and_lines_of_one_value(value):
    image, lost = _sky(), np.zeros((N, N), bool)
    lost[40:90, 100:180] = lost[200:212] = True
    image[lost] = value
    image[:, 150] = value  # a dead column is no area
    found = lost_areas(image)
    assert found[lost].all()
    assert found[~lost].sum() == 0


def test_a_dark_sky_beside_a_body_is_none():
    line, pixel = np.indices((N, N))
    for center, radius in (((128, 128), 90.0), ((0, 128), 180.0), ((128, 900), 800.0)):
        disk = np.hypot(pixel - center[0], line - center[1]) < radius
        assert not lost_areas(np.where(disk, _sky(), 0.0)).any()


def test_quiet_skies_are_none():
    assert not lost_areas(np.rint(_sky(0.2))).any()
    quiet = np.zeros((N, N))
    quiet[100, 120] = 50.0
    assert not lost_areas(quiet).any()
