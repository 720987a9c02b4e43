"""The scene of Table 3 of AAS 13-443, Pluto with an albedo that nobody knows: ``python tests/bodies/table_3.py``.

Draws Pluto as on 2015-07-12 with random maps (`--maps`), finds its center by each method and prints their errors on the
sky; size, figure and law are stated as known, as they are, or as uncertain as on a first approach (`--first-approach`).
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

import opnav_workbench.bodies as bodies
from opnav_workbench.bodies import BodyPicture
from opnav_workbench.geometry import radec_from_unit, tangent_basis
from opnav_workbench.kernels import KernelSet
from opnav_workbench.render import AlbedoMap, FigureUncertainty, render_bodies
from opnav_workbench.scene import predict_body
from opnav_workbench.simulation import OpenedScenario, chosen_pictures, load_picture_scenario
from opnav_workbench.simulation.surfaces import mottled_map
from opnav_workbench.stars import NoiseModel

METHODS = ("cross_correlation", "least_squares", "limb_scan", "ellipse", "disk")
ARCSEC = np.pi / 648_000.0
READ_NOISE_E, GAIN = 24.2, 22.0
HALF = 115  # px: Pluto is 189 px wide
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

    def picture(self, albedo, seed, figure=KNOWN):
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
            self.body, albedo=0.5, target=replace(self.body.target, position_km=shifted), figure=figure
        )
        return BodyPicture(
            counts / GAIN, READ_NOISE_E / GAIN, False, False, camera, self.attitude, inputs.observer.velocity_km_s,
            (model,), inputs.psf, camera.sunlight_e(inputs.exposure_s), NoiseModel(READ_NOISE_E / GAIN, GAIN),
        )  # fmt: skip

    def error_arcsec(self, center):
        return self._rad_per_px @ (center.pixel_line - self.center) / ARCSEC


def table(maps, figure=KNOWN, methods=METHODS):
    """Return the lines of the table: of each method, errors over maps, arcsec, and how they were judged."""
    scene = PlutoScene()
    pictures = [
        scene.picture(AlbedoMap(mottled_map(seed, 0.2, 0.8)), seed, figure) for seed in range(1, maps + 1)
    ]
    lines = [f"{'':18s}   RA rms  Dec rms  median      max  arcsec   error over sigma   ok of {maps}"]
    for method in methods:
        centers = [getattr(bodies, f"find_{method}")(picture, "PLUTO") for picture in pictures]
        found = [center for center in centers if center.pixel_line is not None]
        if not found:
            lines.append(f"{method:18s}   no center")
            continue
        error = np.array([scene.error_arcsec(center) for center in found])
        away = [center.pixel_line - scene.center for center in found]
        chi2 = [e @ np.linalg.solve(c.covariance_px2, e) for e, c in zip(away, found, strict=True)]
        length = np.hypot(*error.T)
        rms = np.sqrt(np.mean(error**2, axis=0))
        lines.append(
            f"{method:18s} {rms[0]:8.3f} {rms[1]:8.3f} {np.median(length):7.3f} {length.max():8.3f} "
            f"{np.sqrt(0.5 * np.mean(chi2)):18.2f} {sum(c.status == 'ok' for c in centers):16d}"
        )
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=10)
    parser.add_argument("--first-approach", action="store_true")
    a = parser.parse_args()
    figure = FigureUncertainty() if a.first_approach else KNOWN
    sys.stdout.write("\n".join(table(a.maps, figure)) + "\n")


if __name__ == "__main__":
    main()
