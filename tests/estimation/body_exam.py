"""The exam of a body's size, pole and spin from an approach. Run by hand; a sequence of 30 pictures takes some minutes.

    python tests/estimation/body_exam.py --seeds 1 2 3 --body bennu --pictures 30

Truth      an ellipsoid drawn cell by cell without the package's renderer (tests/bodies/disk_truth.py), a scattering law that
           the reader does not know, an albedo pattern, a PSF that may be wider than is believed, shot and read noise
Believed   axes 5 % off, the pole 3 deg, the spin rate 1e-3, the prime meridian some degrees, trajectory and attitudes off by
           their sigmas
Asked      axes to 0.5 %, pole to 1 deg, spin to 1e-4, each within 3 sigma
"""

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "bodies"))

from disk_surfaces import LAWS, make_surface
from disk_truth import (
    ATTITUDE,
    GAIN_E_PER_DN,
    NAME,
    RADIUS_KM,
    READ_NOISE_DN,
    VELOCITY_KM_S,
    TrialSetup,
    TrueBody,
    _bright,
    data_folder,
    draw_light,
    exposed,
    lorri,
    toward_place,
)  # fmt: skip

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.constants import AU_KM
from opnav_workbench.estimation.body import (
    BodyKnowledge,
    BodyRotation,
    SequencePicture,
    albedo_from_pictures,
    solve_body_from_pictures,
)  # fmt: skip
from opnav_workbench.geometry import rotation_from_vector, unit, unit_from_radec, vector_from_rotation
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, FigureUncertainty
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

# Radii (km), spin period (h), pole RA and Dec (deg): about those of the two asteroids.
BODIES = {
    "bennu": ((0.2825, 0.2675, 0.2540), 4.296, (85.65, -60.17)),
    "eros": ((17.0, 5.6, 5.4), 5.270, (11.35, 17.22)),
}
EPOCH = 6.0e8
ARC_S = 4.0 * 86400.0
POSITION_SIGMA, VELOCITY_SIGMA = 3e-3, 1e-3  # of the last range, and of the speed
ATTITUDE_SIGMA_PX = 0.1


@dataclass(frozen=True)
class Sequence:
    """Pictures of an approach, what is believed and what is true."""

    pictures: tuple
    believed: BodyRotation
    radii_km: np.ndarray
    knowledge: BodyKnowledge
    rotation: BodyRotation
    true_radii_km: np.ndarray
    offset_km: np.ndarray
    state: np.ndarray
    surface: object


def make_sequence(seed, body="bennu", count=30, sizes=(20.0, 400.0), phase_deg=40.0, law="lunar_0.6", family="field_mid",
                  contrast=1.5, psf_error=1.0, arc_s=ARC_S, window=None, position_sigma=POSITION_SIGMA):  # fmt: skip
    random = np.random.default_rng([23, seed])
    radii, period_h, (ra, dec) = BODIES[body]
    radii = np.array(radii)
    camera = lorri() if window is None else replace(lorri(), n_pixel=window, n_line=window)
    rotation = BodyRotation(
        np.radians(ra), np.radians(dec), random.uniform(0.0, 6.28), 2.0 * np.pi / (period_h * 3600.0), EPOCH
    )
    diameters = np.geomspace(*sizes, count)
    ranges = 2.0 * np.cbrt(np.prod(radii)) / (diameters * camera.pixel_scale_rad)
    speed = (ranges[0] - ranges[-1]) / arc_s
    # A straight approach: the range falls evenly, so that pictures of even steps in size crowd at its end.
    times = EPOCH - 0.5 * arc_s + (ranges[0] - ranges) / speed
    toward = unit_from_radec(*np.radians(random.uniform([0.0, -60.0], [360.0, 60.0])))
    drift = unit(np.cross(toward, random.normal(size=3)))
    side = unit(np.cross(toward, random.normal(size=3)))
    phase = np.radians(phase_deg)
    sun = -toward * np.cos(phase) + side * np.sin(phase)
    offset = random.normal(size=3) * 0.005 * radii
    believed_radii = radii * (1.0 + 0.05 * random.choice([-1.0, 1.0], 3) * random.uniform(0.6, 1.0, 3))
    tilt = random.uniform(0.0, 2.0 * np.pi)
    step = np.array([np.radians(3.0) * np.cos(tilt), np.radians(3.0) * np.sin(tilt), np.radians(random.normal() * 5.0),
                     1e-3 * random.choice([-1.0, 1.0]) * rotation.rate_rad_s])  # fmt: skip
    knowledge = BodyKnowledge(
        position_sigma_km=position_sigma * ranges[-1], velocity_sigma_km_s=VELOCITY_SIGMA * speed
    )
    state = np.concatenate([random.normal(size=3) * knowledge.position_sigma_km,
                            random.normal(size=3) * knowledge.velocity_sigma_km_s])  # fmt: skip
    surface = make_surface(family, contrast, 100.0, random, data_folder())
    pictures = []
    for k, (et, distance, diameter) in enumerate(zip(times, ranges, diameters, strict=True)):
        # A straight line: a path that bends would tell its scale
        position = distance * toward + 0.1 * ranges[-1] * drift
        pictures.append(_picture(k, et, position, diameter, camera, radii, rotation, sun, LAWS[law], phase, surface, offset,
                                 state, psf_error, random, seed))  # fmt: skip
    return Sequence(
        tuple(pictures), rotation.turned(step), believed_radii, knowledge, rotation, radii, offset, state,
        surface,
    )  # fmt: skip


def _picture(k, et, position, diameter, camera, radii, rotation, sun, law, phase, surface, offset, state, psf_error, random,
             seed):  # fmt: skip
    """A picture of a body whose center of mass is at `position`; believed is a place off by the state's correction."""
    turn = rotation.body_from_j2000(et - np.linalg.norm(position) / 299792.458)
    center = position + offset @ turn
    # The truth's camera has one attitude; here it looks where the body is: everything is turned into that frame and back.
    aim = toward_place(camera, np.array([0.5 * camera.n_pixel, 0.5 * camera.n_line]) + random.uniform(-40.0, 40.0, 2)
                       * min(1.0, camera.n_pixel / 1024.0))  # fmt: skip
    there = _turn_onto(unit(center), aim)
    setup = TrialSetup(seed=1000 * seed + k, diameter_px=diameter, phase_deg=0.0, peak_dn=2000.0)
    true = TrueBody(there @ center, radii, turn @ there.T, there @ sun, law, surface, None, phase)
    place = _project(camera, there @ center)
    scaled = diameter * RADIUS_KM / np.cbrt(np.prod(radii))  # the truth draws in units of its own body
    light, _, lit = draw_light(true, camera, place, scaled, 0.8 * psf_error, 0.0)
    light *= setup.peak_dn / _bright(light, lit)
    data, saturated = exposed(light, setup, random)
    eps = random.normal(size=3) * ATTITUDE_SIGMA_PX * camera.pixel_scale_rad * np.array([1.0, 1.0, 30.0])
    covariance = np.diag((ATTITUDE_SIGMA_PX * camera.pixel_scale_rad * np.array([1.0, 1.0, 30.0])) ** 2)
    attitude = rotation_from_vector(-eps) @ ATTITUDE @ there
    moved = position - state[:3] - (et - EPOCH) * state[3:]
    target = TargetState(NAME, moved, radii_km=radii, body_from_j2000=turn, sun_position_km=1.2 * AU_KM * sun)
    picture = BodyPicture(
        data, READ_NOISE_DN, False, saturated, camera, attitude, there.T @ VELOCITY_KM_S,
        (BodyModel(target, figure=FigureUncertainty()),), GaussianPsf(0.8, 0.8), None,
        NoiseModel(READ_NOISE_DN, GAIN_E_PER_DN),
    )  # fmt: skip
    return SequencePicture(f"picture {k:02d}", et, picture, covariance)


def _project(camera, vector):
    from opnav_workbench.geometry import apparent_direction

    return camera.project(apparent_direction(unit(vector)[None], VELOCITY_KM_S) @ ATTITUDE.T)[0]


def _turn_onto(first, second):
    axis = np.cross(first, second)
    return rotation_from_vector(unit(axis) * np.arctan2(np.linalg.norm(axis), first @ second))


def scores(sequence, solution):
    """Errors of axes, pole (deg) and spin (relative), and each over its sigma."""
    axes = solution.radii_km / sequence.true_radii_km - 1.0
    pole = np.degrees(np.arccos(np.clip(solution.rotation.pole @ sequence.rotation.pole, -1.0, 1.0)))
    spin = solution.rotation.rate_rad_s / sequence.rotation.rate_rad_s - 1.0
    miss = sequence.rotation.pole - solution.rotation.pole
    from opnav_workbench.geometry import tangent_basis

    east, north = tangent_basis(solution.rotation.pole_ra_rad, solution.rotation.pole_dec_rad)
    across = np.array([miss @ east, miss @ north])
    columns = slice(9, 11)
    pole_sigmas = np.sqrt(across @ np.linalg.solve(solution.covariance[columns, columns], across))
    turned = vector_from_rotation(
        solution.rotation.body_from_j2000(EPOCH) @ sequence.rotation.body_from_j2000(EPOCH).T
    )
    return {
        "axes": axes, "axes_sigmas": axes / (solution.radii_sigma_km / solution.radii_km),
        "pole_deg": pole, "pole_sigmas": float(pole_sigmas),
        "phase_deg": float(np.degrees(-turned[2])), "phase_sigmas": float(-turned[2] / solution.phase_sigma_rad),
        "spin": spin, "spin_sigmas": spin * sequence.rotation.rate_rad_s / solution.spin_sigma_rad_s,
        "offset": (solution.offset_km - sequence.offset_km) / sequence.true_radii_km.mean(),
        "offset_sigmas": (solution.offset_km - sequence.offset_km) / solution.offset_sigma_km,
        "state_sigmas": (solution.state.state - sequence.state) / np.sqrt(np.diag(solution.covariance)[:6]),
    }  # fmt: skip


def map_scores(sequence, surface):
    """Correlation of a map with the truth where a picture shows it, its relative error, and over sigma."""
    rows = len(surface.sigma)
    latitude = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    longitude = np.pi * (np.arange(2 * rows) + 0.5) / rows
    up = np.stack(np.broadcast_arrays(
        np.cos(latitude)[:, None] * np.cos(longitude), np.cos(latitude)[:, None] * np.sin(longitude),
        np.sin(latitude)[:, None]), axis=-1)  # fmt: skip
    true = sequence.surface.albedo(unit(up / sequence.true_radii_km).reshape(-1, 3)).reshape(rows, 2 * rows)
    seen = (surface.pictures >= 1) & (np.abs(latitude) < 1.2)[:, None]
    found, true = surface.albedo.values[seen], true[seen]
    error = found / found.mean() - true / true.mean()
    rms = float(np.sqrt(np.mean(error**2)))
    return {
        "correlation": float(np.corrcoef(found, true)[0, 1]), "rms": rms, "contrast": float(np.std(true / true.mean())),
        "sigmas": float(np.sqrt(np.mean((error / surface.sigma[seen]) ** 2))), "seen": float(np.mean(seen)),
    }  # fmt: skip


def passed(score):
    return bool(
        np.abs(score["axes"]).max() < 5e-3 and score["pole_deg"] < 1.0 and abs(score["spin"]) < 1e-4
        and np.abs(score["axes_sigmas"]).max() < 3.0 and score["pole_sigmas"] < 3.4 and abs(score["spin_sigmas"]) < 3.0
    )  # fmt: skip


def say(text):
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--body", choices=sorted(BODIES), default="bennu")
    parser.add_argument("--pictures", type=int, default=30)
    parser.add_argument("--passes", type=int, default=3)
    parser.add_argument("--law", default="lunar_0.6", choices=sorted(LAWS))
    parser.add_argument("--family", default="field_mid")
    parser.add_argument("--psf-error", type=float, default=1.0)
    parser.add_argument("--phase", type=float, default=40.0)
    parser.add_argument("--contrast", type=float, default=1.5)
    parser.add_argument("--map", action="store_true", help="make the albedo map, too")
    given = parser.parse_args()
    np.set_printoptions(precision=2, suppress=True, linewidth=160)
    good = 0
    for seed in given.seeds:
        sequence = make_sequence(seed, given.body, given.pictures, law=given.law, family=given.family,
                                 psf_error=given.psf_error, phase_deg=given.phase, contrast=given.contrast)  # fmt: skip
        begin = time.process_time()
        solution = solve_body_from_pictures(
            sequence.pictures,
            NAME,
            sequence.believed,
            sequence.knowledge,
            radii_km=sequence.radii_km,
            passes=given.passes,
        )
        score = scores(sequence, solution)
        good += passed(score)
        say(f"seed {seed}: {'passed' if passed(score) else 'FAILED'}, {time.process_time() - begin:.0f} s")
        say(f"  axes {1e2 * score['axes']} %, {score['axes_sigmas']} sigma; pole {score['pole_deg']:.3f} deg, "
            f"{score['pole_sigmas']:.2f} sigma; phase {score['phase_deg']:.3f} deg, {score['phase_sigmas']:.2f} sigma; "
            f"spin {score['spin']:.2e}, {score['spin_sigmas']:.2f} sigma")  # fmt: skip
        say(f"  center of figure {1e2 * score['offset']} %, {score['offset_sigmas']} sigma; state {score['state_sigmas']}; "
            f"excess {solution.excess_px:.3f} px; chi2 {solution.chi2:.0f} of {solution.degrees_of_freedom}; "
            f"limb {solution.state.limb_px:.3f} px")  # fmt: skip
        for words in (*solution.words, *solution.messages):
            say(f"  {words}")
        if given.map:
            surface = albedo_from_pictures(sequence.pictures, NAME, solution)
            say(
                f"  map of {len(surface.sigma)} rows: "
                + ", ".join(f"{k} {v:.3f}" for k, v in map_scores(sequence, surface).items())
            )
    say(f"{good} of {len(given.seeds)} passed")


if __name__ == "__main__":
    main()
