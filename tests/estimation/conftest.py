"""A straight approach to Pluto and Charon, with observables made of truth and noise: no pictures, no kernels.

The geometry is New Horizons' (facts: 13.78 km/s, 13 695 km miss, 15 degrees off the line to the Sun); the numbers are set
here so that tests have closed forms.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.camera import Camera
from opnav_workbench.constants import DAY_S, SPEED_OF_LIGHT_KM_S
from opnav_workbench.geometry import apparent_direction, camera_from_j2000, radec_from_unit
from opnav_workbench.observables import Observable, joint_covariance_px2, observe
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

sys.path.insert(0, str(Path(__file__).parent))  # the exam of a body is a script beside the tests

ENCOUNTER_ET = 490146664.0
ALONG = np.array([-0.036, -0.962, -0.2706])  # nearly the direction that New Horizons flew in


@dataclass(frozen=True)
class Approach:
    """A flyby as the navigator believes it (spacecraft about the barycenter), and what is wrong with it."""

    camera: Camera
    speed_km_s: float = 13.78
    miss_km: float = 13695.0
    target_offset_km: tuple[float, float, float] = (0.0, 0.0, 0.0)
    center_sigma_px: float = 0.1
    pointing_sigma_px: float = 0.1
    twist_sigma_rad: float = 2e-4
    range_sigma: float = 0.0  # share of the range; 0: none is measured

    @property
    def s(self) -> np.ndarray:
        return ALONG / np.linalg.norm(ALONG)

    @property
    def t(self) -> np.ndarray:
        across = np.cross(self.s, [0.0, 0.0, 1.0])
        return across / np.linalg.norm(across)

    @property
    def toward_sun(self) -> np.ndarray:
        """Back along the approach, 15 degrees off."""
        return -np.cos(np.radians(15.0)) * self.s + np.sin(np.radians(15.0)) * self.t

    @property
    def spacecraft_km_s(self) -> np.ndarray:
        """With respect to the solar-system barycenter."""
        return self.target_km_s + self.speed_km_s * self.s

    @property
    def target_km_s(self) -> np.ndarray:
        return np.array([5.35, -0.35, -1.72])

    def relative_km(self, et: float) -> np.ndarray:
        """Spacecraft relative to the barycenter, geometric, as the navigator believes."""
        return (et - ENCOUNTER_ET) * self.speed_km_s * self.s + self.miss_km * self.t

    def body_km(self, name: str, et: float) -> np.ndarray:
        """Pluto and Charon about their barycenter."""
        angle = 2.0 * np.pi * et / (6.387 * DAY_S)
        share = {"PLUTO": -2126.0, "CHARON": 17470.0}[name]
        pole = np.array([-0.677, 0.725, -0.127])
        first = np.cross(pole, [0.0, 0.0, 1.0])
        return share * (np.cos(angle) * first + np.sin(angle) * np.cross(pole, first))

    def seen_km(self, name: str, et: float, offset_km) -> np.ndarray:
        """Spacecraft to body with light time: the system moves on a straight line."""
        now = self.body_km(name, et) + offset_km - self.relative_km(et)
        seen = now
        for _ in range(6):
            seen = now - np.linalg.norm(seen) / SPEED_OF_LIGHT_KM_S * self.target_km_s
        return seen

    def observables(self, days: Sequence[float], names=("PLUTO", "CHARON")) -> list[Observable]:
        """Noise-free observables, so many days before the encounter; noise comes from `noisy`."""
        made = []
        for k, day in enumerate(days):
            et = ENCOUNTER_ET - day * DAY_S
            attitude = self.attitude(et, k)
            made += [self._observable(name, et, f"lor_{k:03d}.fit", attitude) for name in names]
        return made

    def attitude(self, et: float, number: int) -> np.ndarray:
        """On the barycenter, a little beside it, with another twist in each picture."""
        apparent = apparent_direction(-self.relative_km(et), self.spacecraft_km_s)
        ra, dec = radec_from_unit(apparent)
        return camera_from_j2000(ra + 2e-4, dec - 1e-4, 0.7 * number, self.camera.focal_from_camera)

    def _observable(self, name: str, et: float, image: str, attitude: np.ndarray) -> Observable:
        believed, true = (self.seen_km(name, et, offset) for offset in (np.zeros(3), self.target_offset_km))
        target = TargetState(name, believed, radii_km=np.full(3, 1188.3), velocity_km_s=self.target_km_s)
        place = self.camera.project(attitude @ apparent_direction(true, self.spacecraft_km_s))
        ranged = {}
        if self.range_sigma > 0.0 and name == "PLUTO":
            distance = float(np.linalg.norm(true))
            ranged = {"range_km": distance, "range_sigma_km": self.range_sigma * distance}
        center = BodyCenter(name, "limb_scan", "ok", place, self.center_sigma_px**2 * np.eye(2), **ranged)
        focal = np.diag([self.pointing_sigma_px * self.camera.pixel_scale_rad] * 2 + [self.twist_sigma_rad])
        axes = self.camera.focal_from_camera
        return observe(
            target,
            center,
            self.camera,
            attitude,
            axes.T @ focal**2 @ axes,
            observer_velocity_km_s=self.spacecraft_km_s,
            a_priori_px=place,
            diameter_px=50.0,
            image=image,
            et=et,
            utc="2015-07-12T08:46:57",
            reference_body="PLUTO BARYCENTER",
            light_time="solved",
        )


def moved(o: Observable, offset_px: np.ndarray, range_offset_km: float = 0.0) -> Observable:
    """Return the observable as if the center had been measured elsewhere (by a pixel at most)."""
    sky = np.degrees(np.linalg.solve(o.sky_partials_px_per_rad, offset_px))
    return replace(
        o,
        observed_px=o.observed_px + offset_px,
        residual_px=o.residual_px + offset_px,
        ra_deg=o.ra_deg + sky[0] / np.cos(np.radians(o.dec_deg)),
        dec_deg=o.dec_deg + sky[1],
        measured_range_km=o.measured_range_km + range_offset_km,
    )


class Noise:
    """Draws what the observables' own covariance says: pointing errors are shared by the bodies of a picture."""

    def __init__(self, observables: Sequence[Observable]) -> None:
        self.observables = observables
        self.factor = np.linalg.cholesky(joint_covariance_px2(observables))

    def draw(self, rng: np.random.Generator) -> list[Observable]:
        offsets = (self.factor @ rng.normal(size=len(self.factor))).reshape(-1, 2)
        ranges = rng.normal(size=len(offsets)) * np.nan_to_num([o.range_sigma_km for o in self.observables])
        return [moved(o, d, r) for o, d, r in zip(self.observables, offsets, ranges, strict=True)]


@pytest.fixture(scope="session")
def lorri() -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


@pytest.fixture(scope="session")
def approach(lorri):
    return lambda **changes: Approach(lorri, **changes)


@pytest.fixture(scope="session")
def noise_of():
    return Noise


@pytest.fixture(scope="session")
def displaced():
    return moved
