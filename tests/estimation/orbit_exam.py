"""The exam of a body's rotation and the trajectory from landmarks, in orbit. Run by hand; a picture takes some seconds.

    python tests/estimation/orbit_exam.py --seeds 1 2 --pictures 8

Truth      a bumpy body drawn ray by ray with Hapke's law (tests/landmarks/bumpy.py), spinning under a spacecraft that
           passes by on a straight line some kilometers away
Believed   a trajectory some tens of meters off, attitudes some pixels off, the pole 0.3 deg, the prime meridian 0.5 deg, the
           spin 2e-5; a map that is a percent too large or small along each axis, cut from a smoothed shape with half of the
           albedo's pattern
Asked      pole, meridian, spin, map and trajectory within 3 sigma
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "landmarks"))

from landmark_exam import (
    FULL_E,
    GAIN,
    PSF_ERROR,
    PSF_PX,
    RADII,
    READ_E,
    known_albedo,
    looking,
    near_camera,
    truth_body,
)

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.estimation.body import (
    BodyKnowledge,
    BodyRotation,
    BodySighting,
    landmark_reading,
    solve_body,
)
from opnav_workbench.geometry import rotation_from_vector, unit, unit_from_radec, vector_from_rotation
from opnav_workbench.landmarks import find_landmarks, make_maplets
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, Hapke, LunarLambert, ShapeModel
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

EPOCH = 6.0e8
LIGHT_KM_S = 299792.458
RATE = 4.0626e-4
ATTITUDE_SIGMA_PX, TWIST_SIGMA = 3.0, 1e-3
KNOWN = BodyKnowledge(
    position_sigma_km=0.03, velocity_sigma_km_s=3e-7, pole_sigma_deg=0.3, meridian_sigma_deg=0.5, spin_sigma=2e-5,
    map_sigma=0.01,
)  # fmt: skip
ARC_S = 5.0 * 3600.0


def scaled_shape(shape, factors):
    return ShapeModel(shape.vertices_km * factors, shape.plates)


def truth_law():
    return Hapke(w=0.3, b0=0.6, h=0.05, asymmetry=-0.3, roughness_deg=18.0)


def geometry(rotation, et, toward, sun):
    """Where the camera stands (J2000 from the body), and the body's attitude when the light left."""
    along = unit(np.cross(toward, [0.0, 0.1, 1.0]))
    place = 5.0 * toward + 6e-5 * (et - EPOCH) * along  # 6 cm/s
    turn = rotation.body_from_j2000(et - np.linalg.norm(place) / LIGHT_KM_S)
    return place, turn, sun


def sightings(seed, count, say=lambda _words: None):
    """What a team has, and what is true."""
    random = np.random.default_rng([41, seed])
    camera, body = near_camera(), truth_body()
    true = BodyRotation(1.5, -1.05, 0.7, RATE, EPOCH)
    toward = unit_from_radec(random.uniform(0.0, 6.28), random.uniform(-0.5, 0.5))
    side = unit(np.cross(toward, random.normal(size=3)))
    sun = np.cos(0.6) * toward + np.sin(0.6) * side
    state = np.concatenate(
        [random.normal(size=3) * KNOWN.position_sigma_km, random.normal(size=3) * KNOWN.velocity_sigma_km_s]
    )
    step = random.normal(size=4) * [*np.radians([0.3, 0.3, 0.5]), 2e-5 * RATE]
    believed = true.turned(step)
    factors = np.exp(0.01 * random.normal(size=3))
    shape = scaled_shape(body.shape(480, smooth=1.0), factors)
    pixel_km = 5.0 * camera.pixel_scale_rad
    maplets = make_maplets(
        "BENNU", shape, 18.0 * pixel_km, scale_km=pixel_km, samples=37, albedo=known_albedo(body)
    )
    out = []
    for k, et in enumerate(np.linspace(EPOCH - 0.5 * ARC_S, EPOCH + 0.5 * ARC_S, count)):
        place, turn, to_sun = geometry(true, et, toward, sun)
        camera_from_body = looking(unit(turn @ place), camera)
        light = body.draw(
            camera,
            camera_from_body,
            turn @ place,
            turn @ to_sun,
            truth_law(),
            cells=2,
            psf_sigma=PSF_PX * PSF_ERROR,
        )
        electrons = light / np.quantile(light[light > 0], 0.98) * FULL_E
        signal = random.poisson(np.maximum(electrons, 0.0)) + random.normal(scale=READ_E, size=light.shape)
        sigma = np.array([ATTITUDE_SIGMA_PX * camera.pixel_scale_rad] * 2 + [TWIST_SIGMA])
        attitude = rotation_from_vector(-random.normal(size=3) * sigma) @ camera_from_body @ turn
        position = -place - state[:3] - (et - EPOCH) * state[3:]
        target = TargetState(
            "BENNU", position, radii_km=np.array(RADII), sun_position_km=1.7e8 * to_sun,
            body_from_j2000=believed.body_from_j2000(et - np.linalg.norm(place) / LIGHT_KM_S),
        )  # fmt: skip
        picture = BodyPicture(
            signal, READ_E, False, False, camera, attitude, np.zeros(3), (BodyModel(target, LunarLambert(), 1.0, shape),),
            GaussianPsf(PSF_PX, PSF_PX), noise_model=NoiseModel(READ_E, GAIN),
        )  # fmt: skip
        found = find_landmarks(picture, maplets, attitude_covariance_rad2=np.diag(sigma**2),
                               position_covariance_km2=np.eye(3) * KNOWN.position_sigma_km**2)  # fmt: skip
        say(f"  picture {k}: {found.accepted.sum()} of {len(found.accepted)} landmarks")
        out.append(BodySighting(f"{k:02d}", et, target, camera, attitude, np.diag(sigma**2), np.zeros(3),
                                landmarks=landmark_reading(found)))  # fmt: skip
    return out, believed, true, state, factors


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--pictures", type=int, default=8)
    given = parser.parse_args()
    np.set_printoptions(precision=2, suppress=True, linewidth=160)

    def say(words):
        sys.stdout.write(words + "\n")
        sys.stdout.flush()

    for seed in given.seeds:
        seen, believed, true, state, factors = sightings(seed, given.pictures, say)
        solution = solve_body(seen, believed, KNOWN, radii_km=np.array(RADII))
        turned = vector_from_rotation(
            solution.rotation.body_from_j2000(EPOCH) @ true.body_from_j2000(EPOCH).T
        )
        sigma = np.sqrt(np.diag(solution.covariance))
        spin = (solution.rotation.rate_rad_s - true.rate_rad_s) / solution.spin_sigma_rad_s
        tilt = np.degrees(np.arccos(np.clip(solution.rotation.pole @ true.pole, -1.0, 1.0)))
        # A map that is too large by f is made right by 1 / f.
        scale = (solution.state.map_log + np.log(factors)) / sigma[17:20]
        say(
            f"seed {seed}: pole {tilt:.3f} deg off (sigma {np.degrees(solution.pole_sigma_rad)}), "
            f"phase {-turned[2] / solution.phase_sigma_rad:.2f} sigma ({np.degrees(solution.phase_sigma_rad):.3f} deg), "
            f"spin {spin:.2f} sigma, map {scale} sigma ({1e2 * sigma[17:20]} %), "
            f"state {(solution.state.state - state) / sigma[:6]} sigma; "
            f"chi2 {solution.chi2:.0f} of {solution.degrees_of_freedom}, {sum(not r.used for r in solution.residuals)} out"
        )
        for words in (*solution.words, *solution.messages):
            say(f"  {words}")


if __name__ == "__main__":
    main()
