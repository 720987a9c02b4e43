"""The a priori attitude as a measurement in a session, and in its replay."""

import numpy as np
import pytest

from opnav_workbench.session import ImageSession


@pytest.mark.slow
def test_a_priori_attitude_steadies_a_frame_of_one_star(opened, tmp_path):
    opened.predict()
    opened.find_stars()
    used = np.flatnonzero(opened.state.mask("used"))
    ids = opened.state.a_priori.id
    opened.reject_stars([str(star) for star in ids[used[1:]]], "all but one")
    opened.repoint()
    alone = opened.state.pointing
    opened.repoint(a_priori=True)
    steadied = opened.state.pointing
    assert alone.n_stars == steadied.n_stars == 1
    assert np.linalg.eigvalsh(alone.covariance_rad2 - steadied.covariance_rad2)[-1] > 0.0
    assert opened.journal[-1].parameters == {"model": "euler", "a_priori": True}
    opened.save(tmp_path)
    again = ImageSession.resume(tmp_path)
    assert again.state.pointing.camera_from_j2000.tobytes() == steadied.camera_from_j2000.tobytes()
