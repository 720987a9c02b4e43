"""Table 3 of AAS 13-443: Pluto on 2015-07-12, its albedo unknown; limb scans against correlation of the full disk."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from opnav_workbench.bodies import BodyPicture, find_cross_correlation
from opnav_workbench.bodies.limb_scan.centerfinder import find_limb_scan
from opnav_workbench.geometry import radec_from_unit, tangent_basis
from opnav_workbench.kernels import KernelSet
from opnav_workbench.render import AlbedoMap, FigureUncertainty, render_bodies
from opnav_workbench.scene import predict_body
from opnav_workbench.simulation import OpenedScenario, chosen_pictures, load_picture_scenario
from opnav_workbench.simulation.surfaces import mottled_map
from opnav_workbench.stars import NoiseModel

RA_ARCSEC, DEC_ARCSEC = 0.12, 0.03  # of the paper's hand-picked scans
BETTER = 8.0  # the median's ratio that is asked for
ARCSEC = np.pi / 648_000.0
READ_NOISE_E, GAIN = 24.2, 22.0
HALF = 115  # px: Pluto is 189 px wide
DISKS = 4  # of the pictures have their whole disk measured too
# The paper's scans took size, figure and law for known. In these pictures they are: a sphere, and the law of the model.
KNOWN = FigureUncertainty(2e-4, 2e-4, 2e-4, law_sigma=0.02)


class PlutoScene:
    """The picture `pluto_limb` with any albedo, and its errors on the sky."""

    def __init__(self):
        scenario = load_picture_scenario("new_horizons/pluto_limb")
        with KernelSet(scenario.kernels):
            self.inputs = OpenedScenario.open(scenario).inputs(chosen_pictures(scenario, ())[0])
        inputs = self.inputs
        self.body = next(b for b in inputs.bodies if b.target.name == "PLUTO")
        self.attitude = inputs.path.middle
        prediction = predict_body(self.body.target, inputs.observer, inputs.camera, self.attitude)
        self.center = prediction.pixel_line
        east, north = tangent_basis(*radec_from_unit(prediction.direction))
        in_camera = self.attitude @ prediction.direction
        px_per_rad = (
            inputs.camera.project_jacobian(in_camera[None])[0] @ self.attitude @ np.stack([east, north], -1)
        )
        self._rad_per_px = np.linalg.inv(px_per_rad)

    def picture(self, albedo, seed):
        """What LORRI sees with an albedo map, to be processed with a uniform one and an a priori center 3 px off."""
        inputs, camera = self.inputs, self.inputs.camera
        first = np.rint(self.center).astype(int) - HALF
        window = (int(first[0]), int(first[1]), 2 * HALF, 2 * HALF)
        electrons = np.zeros((camera.n_line, camera.n_pixel))
        electrons[first[1] : first[1] + 2 * HALF, first[0] : first[0] + 2 * HALF] = render_bodies(
            [replace(self.body, albedo=albedo)], camera, self.attitude, inputs.observer.velocity_km_s,
            psf=inputs.psf, sunlight_e=camera.sunlight_e(inputs.exposure_s), window=window,
        ).electrons  # fmt: skip
        rng = np.random.default_rng(seed)
        counts = rng.poisson(electrons) + rng.normal(0.0, READ_NOISE_E, electrons.shape)
        shifted = self.body.target.position_km + 20.0 * camera.pixel_scale_rad * np.array([3e4, -2e4, 4e4])
        model = replace(
            self.body, albedo=0.5, target=replace(self.body.target, position_km=shifted), figure=KNOWN
        )
        return BodyPicture(
            counts / GAIN, READ_NOISE_E / GAIN, False, False, camera, self.attitude, inputs.observer.velocity_km_s,
            (model,), inputs.psf, camera.sunlight_e(inputs.exposure_s), NoiseModel(READ_NOISE_E / GAIN, GAIN),
        )  # fmt: skip

    def error_arcsec(self, center):
        return self._rad_per_px @ (center.pixel_line - self.center) / ARCSEC


@pytest.fixture(scope="module")
def pluto():
    return PlutoScene()


def _table(pluto, maps):
    scans, disks = [], []
    for seed, albedo in enumerate(maps):
        picture = pluto.picture(albedo, seed)
        scan = find_limb_scan(picture, "PLUTO")
        assert scan.status == "ok", scan.messages
        scans.append(pluto.error_arcsec(scan))
        # A whole disk of another pattern than the model's may be doubted, and is an arcsecond off: four tell its order.
        if seed < DISKS:
            disks.append(pluto.error_arcsec(find_cross_correlation(picture, "PLUTO")))
    return np.array(scans), np.array(disks)


def _check(scans, disks):
    assert np.abs(scans[:, 0]).max() < RA_ARCSEC
    assert np.sqrt(np.mean(scans[:, 1] ** 2)) < DEC_ARCSEC
    disk = np.median(np.hypot(*disks.T))
    assert 0.3 < disk < 3.0  # the order of an arcsecond
    assert np.median(np.hypot(*scans.T)) * BETTER < disk


@pytest.mark.slow
def test_ten_mottled_maps(pluto):
    """The paper's errors are those of one picture; of ten surfaces, the rms is held beside that of declination.

    The law, the PSF and the albedo's strength are unknowns of the scans: each of ten within 0.03 arcsec would ask for a
    sigma of 0.012; theirs is 0.04.
    """
    _check(*_table(pluto, [AlbedoMap(mottled_map(seed, 0.2, 0.8)) for seed in range(1, 11)]))


@pytest.mark.slow
@pytest.mark.realdata
def test_the_published_map_of_hubble(pluto, data_dir):
    """The pattern of Buie et al. (2010), stretched to albedos 0.1 to 0.8, at four longitudes."""
    with Image.open(data_dir / "maps" / "hs-2010-06-g-full_jpg.jpg") as published:
        gray = np.asarray(published.convert("L").resize((768, 384))) / 255.0
    maps = [AlbedoMap(0.1 + 0.7 * gray, first_longitude_deg=east) for east in (0.0, 90.0, 180.0, 270.0)]
    _check(*_table(pluto, maps))
