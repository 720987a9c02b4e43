"""Cameras and bodies for the tests of observables."""

from collections.abc import Callable

import numpy as np
import pytest

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import camera_from_j2000, geometric_direction
from opnav_workbench.observables import Observable, observe
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

FILES = {
    "lorri": "new_horizons/cameras/lorri_1x1.yaml",
    "mapcam": "osiris_rex/cameras/mapcam.yaml",
    "mvic": "new_horizons/cameras/mvic_framing.yaml",
    "pinhole": "generic/cameras/pinhole.yaml",
}


def body_at(camera: Camera, attitude: np.ndarray, pixel_line, range_km: float, velocity_km_s) -> TargetState:
    """Return the body that is seen, through aberration, at `pixel_line`."""
    apparent = camera.unproject(np.array([pixel_line], float))[0] @ attitude
    return TargetState("PLUTO", geometric_direction(apparent, velocity_km_s) * range_km)


@pytest.fixture(scope="session")
def cameras() -> dict[str, Camera]:
    return {name: Camera.from_yaml(kernels_meta_dir() / path) for name, path in FILES.items()}


@pytest.fixture(scope="session")
def body_seen_at() -> Callable[..., TargetState]:
    return body_at


@pytest.fixture(scope="session")
def approach_observables(cameras) -> tuple[Observable, ...]:
    """Three pictures of Pluto and Charon: joint centers, a second method with range, one body not found, joint or not."""
    camera = cameras["lorri"]
    attitude = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    velocity, covariance = np.array([3.1, -12.4, -6.0]), np.array([[0.01, 0.002], [0.002, 0.02]])
    made = []
    for k in range(3):
        size = {"range_km": 6.01e6 - 1e6 * k, "range_sigma_km": 3e3}
        rows = [
            ("PLUTO", "limb_scan", "ok", (500.0 + k, 520.0), size),
            ("CHARON", "limb_scan", "ok" if k < 2 else "not_detected", (700.0, 300.0 - k), {}),
            ("PLUTO", "ellipse", "uncertain", (500.1 + k, 520.1), size),
        ]
        for name, method, status, place, size in rows:
            target = body_at(camera, attitude, place, 6e6 - 1e6 * k, velocity)
            body = TargetState(
                name, target.position_km, radii_km=np.full(3, 1188.3), velocity_km_s=[5.3, 1.0, 0.2]
            )
            found = np.array(place) + 0.05
            center = (
                BodyCenter(name, method, status, found, covariance, 1e4, 50.0, diameter_px=80.1, **size)
                if status != "not_detected"
                else BodyCenter.without_center(name, method, status, "nothing found; too faint", "look again")
            )
            other = {"PLUTO": "CHARON", "CHARON": "PLUTO"}[name]
            made.append(
                observe(
                    body,
                    center,
                    camera,
                    attitude,
                    np.array([[3.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 900.0]]) * 1e-14,
                    observer_velocity_km_s=velocity,
                    a_priori_px=np.array(place) + 30.0,
                    diameter_px=80.0,
                    image=f"lor_{k}.fit",
                    et=489998884.1234567 + 86400.0 * k,
                    utc=f"2015-07-{12 + k}T18:46:55.939",
                    reference_body="PLUTO BARYCENTER",
                    observer="NEW HORIZONS",
                    light_time="solved",
                    center_cross_px2={other: covariance / 3.0} if method == "limb_scan" and k == 0 else None,
                )
            )
    return tuple(made)
