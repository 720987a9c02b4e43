"""Bodies before a distorting, moving camera, and an independent brute-force rendering of them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import fftconvolve

from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import geometric_direction, rotation_from_vector, unit
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, Lambert, render_bodies
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

SUN_AU = 33.0
RADIUS_KM = 1188.3


@dataclass(frozen=True)
class Stage:
    """A LORRI that moves, turned somewhere, and a PSF."""

    camera: Camera
    camera_from_j2000: np.ndarray
    velocity_km_s: np.ndarray
    psf: GaussianPsf

    def direction(self, place_px):
        apparent = self.camera.unproject(np.array([place_px], float))[0] @ self.camera_from_j2000
        return geometric_direction(apparent, self.velocity_km_s)

    def target(self, diameter_px, phase_deg, place_px=(400.37, 600.71), axes=(1.0, 1.0, 1.0), name="BODY"):
        toward = self.direction(place_px)
        distance = 2.0 * RADIUS_KM / (diameter_px * self.camera.pixel_scale_rad)
        side = unit(np.cross(toward, [0.3, 0.5, 0.8]))
        phase = np.radians(phase_deg)
        return TargetState(
            name,
            toward * distance,
            radii_km=RADIUS_KM * np.array(axes),
            body_from_j2000=rotation_from_vector(np.array([1.0, 0.4, -0.9])),
            sun_position_km=(-toward * np.cos(phase) + side * np.sin(phase)) * SUN_AU * AU_KM,
        )

    def model(self, diameter_px, phase_deg, law=None, **target):
        return BodyModel(self.target(diameter_px, phase_deg, **target), law or Lambert(), 1.0)

    def render(self, *models, sunlight_e=1.0, psf=None, **options):
        return render_bodies(
            models,
            self.camera,
            self.camera_from_j2000,
            self.velocity_km_s,
            psf=psf or self.psf,
            sunlight_e=sunlight_e,
            **options,
        )

    def still(self):
        """The same without motion."""
        return replace(self, velocity_km_s=np.zeros(3))


@pytest.fixture(scope="session")
def stage():
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    attitude = rotation_from_vector(np.array([0.4, -1.1, 0.7]))
    return Stage(camera, attitude, np.array([3.0, -12.0, 6.0]), GaussianPsf(0.65, 0.65))


@pytest.fixture(scope="session")
def center_of():
    """Brightness-weighted center (pixel, line) of a picture whose first pixel is given."""

    def center(picture, first=(0, 0)):
        line, pixel = np.indices(picture.shape)
        return np.array([(pixel * picture).sum(), (line * picture).sum()]) / picture.sum() + np.array(first)

    return center


@pytest.fixture(scope="session")
def brute_force():
    """Return n by n exact rays in every pixel of a window, the textbook quadratic, and the PSF on that fine grid."""

    def picture(stage, model, window, n, reflectance):
        pixel0, line0, n_pixel, n_line = window
        x = pixel0 - 0.5 + (np.arange(n_pixel * n) + 0.5) / n
        y = line0 - 0.5 + (np.arange(n_line * n) + 0.5) / n
        places = np.stack(np.meshgrid(x, y), axis=-1)
        fine = _electrons(stage, model.target, places, reflectance) / n**2
        spread = fftconvolve(fine, stage.psf.kernel(n), mode="same")
        return spread.reshape(n_line, n, n_pixel, n).sum(axis=(1, 3))

    return picture


def _electrons(stage, target, places, reflectance):
    """Electrons per pixel at places (..., 2) for sunlight of 1 electron at 1 au."""
    turn = target.body_from_j2000
    apparent = stage.camera.unproject(places) @ stage.camera_from_j2000
    ray = geometric_direction(apparent, stage.velocity_km_s) @ turn.T
    camera, sun = -turn @ target.position_km, turn @ target.sun_position_km
    # Of the ray to the center: keeps the quadratic well scaled
    nearest = camera - (ray @ camera)[..., None] * ray
    weight = 1.0 / target.radii_km
    a, b, c = (
        np.sum((ray * weight) ** 2, axis=-1),
        np.sum(ray * nearest * weight**2, axis=-1),
        np.sum((nearest * weight) ** 2, axis=-1) - 1.0,
    )
    under = b * b - a * c
    along = (-b - np.sqrt(np.maximum(under, 0.0))) / a
    point = nearest + along[..., None] * ray
    normal = unit(point * weight**2)
    mu0, mu = np.sum(normal * unit(sun - point), axis=-1), -np.sum(normal * ray, axis=-1)
    seen = (under > 0.0) & (mu0 > 0.0)
    across = stage.camera.unproject_jacobian(places)
    solid_angle = np.linalg.norm(np.cross(across[..., 0], across[..., 1]), axis=-1)
    shine = reflectance(np.where(seen, mu0, 1.0), np.where(seen, mu, 1.0))
    return np.where(seen, shine * solid_angle, 0.0) / np.pi * (AU_KM / np.linalg.norm(sun)) ** 2
