"""Star fields of known attitude, made with the camera alone: no code of the solver is used."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector
from opnav_workbench.resources import kernels_meta_dir

FILES = {
    "lorri": "new_horizons/cameras/lorri_1x1.yaml",  # boresight -Z, axes of determinant -1
    "mapcam": "osiris_rex/cameras/mapcam.yaml",  # boresight +Z, axes of determinant -1, strong distortion
    "mvic": "new_horizons/cameras/mvic_framing.yaml",  # boresight -X, 5024 x 128
    "pinhole": "generic/cameras/pinhole.yaml",  # boresight +Z, axes of determinant +1, no distortion
}


@dataclass(frozen=True, eq=False)
class Field:
    """n stars: where they truly are, where they were measured, and what the attitude truly is."""

    camera: Camera
    true_px: np.ndarray
    observed_px: np.ndarray
    covariance_px2: np.ndarray
    directions: np.ndarray
    attitude: np.ndarray
    a_priori: np.ndarray

    @property
    def arguments(self) -> tuple:
        return self.observed_px, self.covariance_px2, self.directions, self.camera, self.a_priori


def make_field(
    camera: Camera,
    rng: np.random.Generator,
    n: int = 10,
    *,
    true_px: np.ndarray | None = None,
    covariance_px2: np.ndarray | None = None,
    sigma_px: float = 0.1,
    extra_px: float = 0.0,
    attitude: np.ndarray | None = None,
    error_rotvec: np.ndarray | None = None,
) -> Field:
    """Return a field whose centers have noise of their covariance, and `extra_px` that the covariance hides."""
    if true_px is None:
        true_px = rng.uniform(0.0, 1.0, (n, 2)) * [camera.n_pixel - 1, camera.n_line - 1]
    n = len(true_px)
    covariance = np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)) if covariance_px2 is None else covariance_px2
    attitude = random_attitude(camera, rng) if attitude is None else attitude
    if error_rotvec is None:
        cross = rng.normal(0.0, 20.0 * camera.pixel_scale_rad, 2)
        twist = rng.normal(0.0, np.radians(camera.attitude_sigma.twist_deg))
        error_rotvec = np.append(cross, twist) @ camera.focal_from_camera
    noise = np.linalg.cholesky(covariance + extra_px**2 * np.eye(2)) @ rng.normal(size=(n, 2, 1))
    return Field(
        camera=camera,
        true_px=true_px,
        observed_px=true_px + noise[..., 0],
        covariance_px2=covariance,
        directions=camera.unproject(true_px) @ attitude,
        attitude=attitude,
        a_priori=rotation_from_vector(error_rotvec) @ attitude,
    )


def random_attitude(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Return an attitude anywhere on the sky, every second one within a degree of a celestial pole."""
    near_pole = np.radians(rng.uniform(89.0, 90.0)) * rng.choice([-1.0, 1.0])
    anywhere = np.arcsin(rng.uniform(-1.0, 1.0))
    dec = near_pole if rng.random() < 0.5 else anywhere
    ra, twist = rng.uniform(0.0, 2.0 * np.pi, 2)
    return camera_from_j2000(ra, dec, twist, camera.focal_from_camera)


@pytest.fixture(scope="session")
def cameras() -> dict[str, Camera]:
    return {name: Camera.from_yaml(kernels_meta_dir() / path) for name, path in FILES.items()}


@pytest.fixture(scope="session")
def star_field() -> Callable[..., Field]:
    return make_field


@pytest.fixture(scope="session")
def any_attitude() -> Callable[..., np.ndarray]:
    return random_attitude
