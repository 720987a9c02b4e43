"""Raw pictures, with what the readout leaves in them: a tenth of the body's light along all of its columns."""

import numpy as np
import pytest
from exposed_pictures import APPROACH, exposed_pictures

from opnav_workbench.kernels import KernelSet
from opnav_workbench.session import ImageSession

# Pluto 47 px wide, of LORRI 4x4; shifted under it for 0.0125 s
TAKEN = {"near": ("2015-07-12T08:46:57", 0.02)}


@pytest.fixture(scope="module", params=["raw", "calibrated"])
def truth(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    made = exposed_pictures(
        folder, TAKEN, bodies=["PLUTO"], seed=5, shift_px=[7.6, -3.1], twist_deg=0.1, level=request.param
    )
    return made["near"]


@pytest.mark.slow
def test_stars_and_centers_of_a_raw_picture_are_those_of_a_calibrated_one(truth):
    """Before smear was sky, with a catalog of more stars: 6 of them instead of 9; and a center with a sigma of 0.16 px."""
    with KernelSet(APPROACH):
        session = ImageSession.open(truth.picture, mission="new_horizons")
        session.predict()
        session.add_target("PLUTO")
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO")
    assert session.state.pointing.n_stars >= 5
    (center,) = session.state.bodies
    assert center.status == "ok", center.messages
    off = center.pixel_line - truth.bodies["PLUTO"]
    assert off @ np.linalg.solve(center.covariance_px2, off) < 12.0
    assert np.sqrt(np.trace(center.covariance_px2)) < 0.03
