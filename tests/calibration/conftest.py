"""Star pictures of known cameras, made with the camera alone: no code of the calibration is used."""

from collections.abc import Callable

import numpy as np
import pytest

from opnav_workbench.calibration import StarPictures
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector
from opnav_workbench.resources import kernels_meta_dir


def make_frames(
    camera: Camera,
    rng: np.random.Generator,
    pictures: int = 8,
    stars: int = 40,
    sigma_px: float = 0.1,
    mounting_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> StarPictures:
    """Return pictures whose a priori attitudes are off by the camera's own sigmas and a common mounting error."""
    picture = np.repeat(np.arange(pictures), stars)
    places = rng.uniform(0.0, 1.0, (len(picture), 2)) * [camera.n_pixel - 1, camera.n_line - 1]
    axes, sigma = camera.focal_from_camera, camera.attitude_sigma
    angles = (
        rng.uniform(0.0, 6.0, pictures),
        rng.uniform(-1.0, 1.0, pictures),
        rng.uniform(0.0, 6.0, pictures),
    )
    true = np.stack([camera_from_j2000(*a, axes) for a in zip(*angles, strict=True)])
    cross = sigma.cross_px * camera.pixel_scale_rad
    errors = rng.normal(size=(pictures, 3)) * [cross, cross, np.radians(sigma.twist_deg)] + mounting_rad
    a_priori = np.stack([rotation_from_vector(e @ axes).T @ a for e, a in zip(errors, true, strict=True)])
    return StarPictures(
        names=tuple(f"frame {i}" for i in range(pictures)),
        picture_index=picture,
        observed_px=places + rng.normal(0.0, sigma_px, places.shape),
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (len(picture), 1, 1)),
        directions=np.einsum("nj,nji->ni", camera.unproject(places), true[picture]),
        attitudes=a_priori,
        a_priori=a_priori,
    )


@pytest.fixture(scope="session")
def star_pictures() -> Callable[..., StarPictures]:
    return make_frames


@pytest.fixture(scope="session")
def cameras() -> dict[str, Camera]:
    files = {
        "lorri": "new_horizons/cameras/lorri_1x1.yaml",
        "mapcam": "osiris_rex/cameras/mapcam.yaml",
        "pinhole": "generic/cameras/pinhole.yaml",
    }
    return {name: Camera.from_yaml(kernels_meta_dir() / path) for name, path in files.items()}
