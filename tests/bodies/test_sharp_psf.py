"""Optics sharper than the detector's pixels: a limb is then as wide as a pixel, and is found all the same."""

import numpy as np
import pytest

from opnav_workbench.bodies import (
    find_cross_correlation,
    find_disk,
    find_ellipse,
    find_least_squares,
    find_limb_scan,
)
from opnav_workbench.render import FigureUncertainty

PLACE = np.array([500.3, 480.7])
FINDERS = (find_disk, find_ellipse, find_limb_scan, find_least_squares, find_cross_correlation)


@pytest.fixture(scope="module", params=[0.05, 0.2])
def seen(request, body_stage):
    """A disk of 38 px by exact rays; the PSF's sigma, px, is the parameter."""
    stage = body_stage.with_psf(request.param)
    body = stage.body(38.0, 40.0, PLACE, figure=FigureUncertainty(0.02, 0.005))
    light = stage.brute_force(body, (470, 450, 60, 60), 12)
    return stage.picture(light, [body], np.random.default_rng(8), offset_px=(4.0, -3.0))


@pytest.mark.slow(keep=["0.05-find_limb_scan"])
@pytest.mark.parametrize("find", FINDERS, ids=lambda find: find.__name__)
def test_every_method_finds_a_disk_of_sharp_optics(seen, find):
    center = find(seen, "BODY")
    assert center.status == "ok", center.messages
    off = center.pixel_line - PLACE
    assert np.hypot(*off) < 0.1
    assert off @ np.linalg.solve(center.covariance_px2, off) < 16.0
