"""Pictures of bodies before a LORRI that moves and distorts, and an independent, brute-force rendering of them."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import fftconvolve

from opnav_workbench.bodies import BodyPicture, displaced_model
from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import geometric_direction, rotation_from_vector, unit
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, FigureUncertainty, Lambert, render_bodies
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

sys.path.insert(
    0, str(Path(__file__).parent)
)  # the modules of the truth, disk_truth and its like, import each other

SUN_AU = 33.0
RADIUS_KM = 1188.3
NOISE_DN, GAIN = 3.0, 22.0
SUNLIGHT_E = 1e17
KNOWN_LIGHT: dict[tuple, np.ndarray] = {}  # the last picture of `brute_force`


@dataclass(frozen=True)
class BodyStage:
    """A camera that moves, turned somewhere, and a PSF."""

    camera: Camera
    camera_from_j2000: np.ndarray
    velocity_km_s: np.ndarray
    psf: GaussianPsf

    def with_psf(self, sigma_px):
        return replace(self, psf=GaussianPsf(sigma_px, sigma_px))

    def body(
        self,
        diameter_px,
        phase_deg,
        place_px,
        axes=(1.0, 1.0, 1.0),
        name="BODY",
        law=None,
        albedo=1.0,
        range_share=1.0,
        figure=FigureUncertainty(),  # noqa: B008 (immutable)
    ):
        """A body of a size, its Sun somewhere across; `range_share` brings it nearer without changing its size in px."""
        apparent = self.camera.unproject(np.array([place_px], float))[0] @ self.camera_from_j2000
        toward = geometric_direction(apparent, self.velocity_km_s)
        distance = range_share * 2.0 * RADIUS_KM / (diameter_px * self.camera.pixel_scale_rad)
        side, phase = unit(np.cross(toward, [0.3, 0.5, 0.8])), np.radians(phase_deg)
        target = TargetState(
            name,
            toward * distance,
            radii_km=range_share * RADIUS_KM * np.array(axes),
            body_from_j2000=rotation_from_vector(np.array([1.0, 0.4, -0.9])),
            sun_position_km=(-toward * np.cos(phase) + side * np.sin(phase)) * SUN_AU * AU_KM,
        )
        return BodyModel(target, law or Lambert(), albedo, figure=figure)

    def light(self, *models, window=None):
        """Light in DN, the brightest pixel 1."""
        electrons = render_bodies(
            models, self.camera, self.camera_from_j2000, self.velocity_km_s,
            psf=self.psf, sunlight_e=SUNLIGHT_E, window=window,
        ).electrons  # fmt: skip
        return electrons / electrons.max()

    def picture(
        self,
        light,
        models,
        rng=None,
        *,
        peak_dn=1200.0,
        offset_px=(0.0, 0.0),
        bad=False,
        saturated=False,
        data=None,
    ):
        """The picture of `light` (as of `light`), its bodies expected `offset_px` beside their places."""
        if data is None:
            signal = peak_dn * light
            data = signal if rng is None else noisy(signal, rng)
        picture = BodyPicture(
            data, NOISE_DN, bad, saturated, self.camera, self.camera_from_j2000, self.velocity_km_s, tuple(models),
            self.psf, None, NoiseModel(NOISE_DN, GAIN),
        )  # fmt: skip
        moved = [
            displaced_model(picture, m.target.name, picture.center_px(m.target.name) + offset_px)
            for m in models
        ]
        return replace(picture, models=tuple(moved))

    def brute_force(self, model, window, n):
        """Light of a Lambert ellipsoid, n by n exact rays in every pixel and the PSF on that grid; the brightest pixel 1."""
        shown, shape = model.target, (self.camera.n_line, self.camera.n_pixel)
        places = (self.camera_from_j2000, self.velocity_km_s, shown.position_km, shown.radii_km)
        places = (*places, shown.body_from_j2000, shown.sun_position_km)
        key = (shape, repr(self.psf), window, n, *(place.tobytes() for place in places))
        if key not in KNOWN_LIGHT:  # the next case of a test is often the same picture for another method
            KNOWN_LIGHT.clear()
            KNOWN_LIGHT[key] = self._traced(shown, window, n)
        return KNOWN_LIGHT[key].copy()

    def _traced(self, target, window, n):
        pixel, line, n_pixel, n_line = window
        x = pixel - 0.5 + (np.arange(n_pixel * n) + 0.5) / n
        y = line - 0.5 + (np.arange(n_line * n) + 0.5) / n
        fine = np.concatenate([self._shine(target, x, part) for part in np.array_split(y, n_line)])
        spread = fftconvolve(fine, self.psf.kernel(n), mode="same")
        out = np.zeros((self.camera.n_line, self.camera.n_pixel))
        out[line : line + n_line, pixel : pixel + n_pixel] = spread.reshape(n_line, n, n_pixel, n).sum(
            axis=(1, 3)
        )
        return out / out.max()

    def _shine(self, target, x, y):
        """Brightness of a Lambert ellipsoid along rays, by the textbook quadratic about the point nearest to its center."""
        turn = target.body_from_j2000
        apparent = self.camera.unproject(np.stack(np.meshgrid(x, y), axis=-1)) @ self.camera_from_j2000
        ray = geometric_direction(apparent, self.velocity_km_s) @ turn.T
        camera, sun = -turn @ target.position_km, turn @ target.sun_position_km
        nearest = camera - (ray @ camera)[..., None] * ray
        weight = 1.0 / target.radii_km
        a = np.sum((ray * weight) ** 2, axis=-1)
        b = np.sum(ray * nearest * weight**2, axis=-1)
        under = b * b - a * (np.sum((nearest * weight) ** 2, axis=-1) - 1.0)
        point = nearest + ((-b - np.sqrt(np.maximum(under, 0.0))) / a)[..., None] * ray
        cosine = np.sum(unit(point * weight**2) * unit(sun - point), axis=-1)
        return np.where((under > 0.0) & (cosine > 0.0), cosine, 0.0)


def noisy(signal_dn, rng):
    return signal_dn + rng.normal(size=signal_dn.shape) * np.sqrt(
        NOISE_DN**2 + np.maximum(signal_dn, 0.0) / GAIN
    )


@pytest.fixture(scope="session")
def body_stage():
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    attitude = rotation_from_vector(np.array([0.4, -1.1, 0.7]))
    return BodyStage(camera, attitude, np.array([3.0, -12.0, 6.0]), GaussianPsf(0.8, 0.8))


@pytest.fixture(scope="session")
def binned_stage(body_stage):
    """The 4 x 4 mode: a small detector, where noise for a whole picture is cheap."""
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_4x4.yaml")
    return replace(body_stage, camera=camera, psf=GaussianPsf(0.65, 0.65))


@pytest.fixture(scope="session")
def add_noise():
    """Read noise and shot noise on a signal in DN."""
    return noisy
