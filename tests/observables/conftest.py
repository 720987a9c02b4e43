"""Cameras and bodies for the tests of observables."""

from collections.abc import Callable

import numpy as np
import pytest

from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.resources import kernels_meta_dir

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
