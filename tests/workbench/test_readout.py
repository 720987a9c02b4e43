"""What the page tells under the cursor, against the camera itself."""

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import camera_from_j2000
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.workbench.readout import sky_readout

CAMERAS = sorted(kernels_meta_dir().glob("*/cameras/*.yaml"))
ARCSEC = np.pi / 180.0 / 3600.0


@pytest.mark.parametrize("path", CAMERAS, ids=lambda p: p.stem)
def test_readout_agrees_with_the_camera(path):
    camera = Camera.from_yaml(path)
    attitude = camera_from_j2000(1.2, -0.7, 0.4, camera.focal_from_camera)
    readout = sky_readout(camera, attitude)
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, [camera.n_pixel - 0.5, camera.n_line - 0.5], (4000, 2))
    truth = camera.unproject(points) @ attitude
    angle = np.linalg.norm(readout.directions(points) - truth, axis=1)  # small angles: chord is arc
    assert angle.max() < 0.1 * ARCSEC
    back = camera.project(readout.directions(points) @ attitude.T)
    assert np.abs(back - points).max() < 0.01  # px
    assert readout.error_px < 1e-3
    most = 200 if camera.scans else 40  # a strip of MVIC is 100 times as wide as it is high
    assert len(readout.tiles) < most
    assert np.isnan(readout.directions([[-1.0, 5.0]])).all()  # off the detector


def test_values_for_the_page_are_plain():
    import json

    camera = Camera.from_yaml(CAMERAS[0])
    values = json.loads(json.dumps(sky_readout(camera, np.eye(3)).as_page_values(), allow_nan=False))
    assert values["tiles"][-1]["corners"][1] == [camera.n_pixel - 0.5, camera.n_line - 0.5]
