"""The exam of landmark centers: truth drawn by another route than the templates. Run by hand; it takes some minutes.

    python tests/landmarks/landmark_exam.py --pictures 10 --cache FOLDER
    python tests/landmarks/landmark_exam.py --pictures 1 --size 1024 --ratios 1.0
    python tests/landmarks/landmark_exam.py --poses 100

At 1024 px ask for the time alone: the shape that the maplets are cut from is as coarse as for 512.

Truth      a bumpy ellipsoid, marched along 3 x 3 rays a pixel, Hapke's law with rough facets, albedo that no maplet knows in
           part, a PSF 8 % wider than is believed, shot and read noise
Believed   maplets of a coarser, smoothed shape, half of the albedo's variance, McEwen's or Lambert's law, a wrong place
           and attitude of the camera
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np
from bumpy import Bumpy
from scipy import ndimage
from sun_table import SunTable

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.landmarks import find_landmarks, make_maplets
from opnav_workbench.landmarks.prediction import landmark_places
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, Hapke, LunarLambert
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

RADII = (0.283, 0.271, 0.249)
PSF_PX, PSF_ERROR = 0.65, 1.08
GAIN, READ_E = 1.0, 8.0
FULL_E = 4000.0
RATIOS = (0.5, 0.7, 1.0, 1.4, 2.0)
FALSE_PX, FALSE_SIGMAS = 1.0, 6.0


def exam_camera(size=512):
    camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    middle = np.full(2, 0.5 * (size - 1))
    return dataclasses.replace(camera, n_pixel=size, n_line=size, center_pixel_line=middle)


def looking(direction, camera):
    """camera_from_body of a camera in a direction, that looks at the center."""
    third = -direction
    first = np.cross([0.0, 0.0, 1.0], third)
    first /= np.linalg.norm(first)
    return camera.focal_from_camera.T @ np.stack([first, np.cross(third, first), third])


WIDTH = 430.0 / 512.0  # of the body, of a picture's


def geometry(number, camera):
    diameter_px = WIDTH * camera.n_pixel
    random = np.random.default_rng([77, number])
    direction = random.normal(size=3)
    direction /= np.linalg.norm(direction)
    away = np.cross(direction, random.normal(size=3))
    away /= np.linalg.norm(away)
    phase = np.radians(random.uniform(15.0, 70.0))
    sun = np.cos(phase) * direction + np.sin(phase) * away
    range_km = 2.0 * RADII[1] / (camera.pixel_scale_rad * diameter_px)
    return direction * range_km, sun, looking(direction, camera)


def truth_body():
    return Bumpy.of(RADII, 1280, octaves=range(2, 10), falloff=0.6, roughness=0.02, contrast=0.12, seed=5)


def truth_picture(number, camera, body, cache):
    file = None if cache is None else Path(cache) / f"truth{number}_{camera.n_pixel}.npy"
    place, sun, turn = geometry(number, camera)
    if file is not None and file.exists():
        return np.load(file), place, sun, turn
    law = Hapke(w=0.3, b0=0.6, h=0.05, asymmetry=-0.3, roughness_deg=18.0)
    picture = body.draw(camera, turn, place, sun, law, psf_sigma=PSF_PX * PSF_ERROR)
    if file is not None:
        np.save(file, picture)
    return picture, place, sun, turn


def believed_picture(light, place, sun, turn, camera, shape, law, number, body_name="BENNU"):
    random = np.random.default_rng([99, number])
    electrons = light / np.quantile(light[light > 0], 0.98) * FULL_E
    signal = random.poisson(np.maximum(electrons, 0.0)) + random.normal(scale=READ_E, size=light.shape)
    range_km = np.linalg.norm(place)
    error_km = random.normal(size=3) * np.array([3.0, 3.0, 3.0]) * camera.pixel_scale_rad * range_km
    error_km += place / range_km * random.normal() * 0.004 * range_km
    turned = rotation_from_vector(
        random.normal(size=3) * np.array([2.0, 2.0, 2.0]) * camera.pixel_scale_rad
        + camera.boresight * random.normal() * 1e-3
    )
    target = TargetState(
        body_name, -(place + error_km), radii_km=RADII, body_from_j2000=np.eye(3), sun_position_km=sun * 1.7e8
    )
    return BodyPicture(
        signal,
        np.full(light.shape, READ_E),
        np.zeros(light.shape, bool),
        np.zeros(light.shape, bool),
        camera,
        turned @ turn,
        np.zeros(3),
        (BodyModel(target, law, 1.0, shape),),
        GaussianPsf(PSF_PX, PSF_PX),
        noise_model=NoiseModel(READ_E, GAIN),
    )


def known_albedo(body):
    """An albedo map with the wide part of the truth's pattern: what the maplets know of it."""
    smooth = ndimage.gaussian_filter(body.albedo, 10.0, mode=("nearest", "wrap"))
    return AlbedoMap(smooth)


def score(picture, truth_place, truth_turn, maplets, camera):
    start = time.process_time()
    found = find_landmarks(picture, maplets)
    seconds = time.process_time() - start
    target = dataclasses.replace(picture.models[0].target, position_km=-truth_place)
    truth = landmark_places(found.centers.place_km, target, camera, truth_turn, np.zeros(3))
    return found, found.centers.observed_px - truth, seconds


def say(text):
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--pictures", type=int, default=10)
    parser.add_argument("--cache", default=None)
    parser.add_argument("--law", default="mcewen")
    parser.add_argument("--poses", type=int, default=0, help="camera positions at 5 km instead of centers")
    parser.add_argument("--first", type=int, default=0, help="number of the first picture or camera position")
    parser.add_argument("--size", type=int, default=512, help="px, of a picture")
    parser.add_argument(
        "--ratios", type=float, nargs="+", default=RATIOS, help="sample of a maplet over pixel"
    )
    arguments = parser.parse_args()
    if arguments.poses:
        poses(arguments.first, arguments.poses)
        return
    centers_exam(arguments)


def centers_exam(arguments):
    """Centers of landmarks, picture by picture, and what they come to by resolution ratio and in all."""
    camera, body = exam_camera(arguments.size), truth_body()
    shape = body.shape(480, smooth=1.0)
    albedo = known_albedo(body)
    pixel_km = 2.0 * RADII[1] / (WIDTH * arguments.size)
    law = (
        LunarLambert()
        if arguments.law == "mcewen"
        else __import__("opnav_workbench.render", fromlist=["Lambert"]).Lambert()
    )
    sets = {}
    rows, table = [], SunTable()
    for number in range(arguments.first, arguments.first + arguments.pictures):
        light, place, sun, turn = truth_picture(number, camera, body, arguments.cache)
        ratio = arguments.ratios[number % len(arguments.ratios)]
        if ratio not in sets:
            sets[ratio] = make_maplets(
                "BENNU",
                shape,
                18.0 * pixel_km,
                scale_km=ratio * pixel_km,
                samples=int(36 / ratio) // 2 * 2 + 1,
                albedo=albedo,
            )
        picture = believed_picture(light, place, sun, turn, camera, shape, law, number)
        found, error, seconds = score(picture, place, turn, sets[ratio], camera)
        ok = found.accepted
        row_of = {name: i for i, name in enumerate(sets[ratio].id.tolist())}
        up = sets[ratio].axes[[row_of[name] for name in found.centers.id.tolist()], 2]
        table.add(found.centers, up, sun, error, ok & (found.centers.emission_deg <= 60.0))
        sigma = np.sqrt(np.diagonal(found.covariance_px2, axis1=1, axis2=2))
        ratios = error[ok] / sigma[ok]
        sampled = np.full(ok.sum(), ratio)
        rows.append(
            (error[ok], ratios, found.centers.emission_deg[ok], found.centers.incidence_deg[ok], sampled)
        )
        lost = (
            "no pose"
            if found.pose is None
            else (
                f"position off {np.linalg.norm(found.pose.position_km - place) * 1e3:.2f} m, "
                f"{np.sqrt(pose_square(found.pose, place, turn) / 6):.2f} sigma; excess {found.pose.excess_sigma_px:.3f}"
            )
        )
        say(
            f"{number}: ratio {ratio}, {ok.sum()} of {len(ok)} accepted, rms {np.sqrt((error[ok] ** 2).mean()):.3f} px, "
            f"mean {error[ok].mean(axis=0).round(3)}, error/sigma {np.sqrt((ratios**2).mean()):.2f}, law share "
            f"{found.centers.law_share:.2f}, worst {np.abs(error[ok]).max(initial=0):.2f} px, {seconds:.1f} s, {lost}",
        )
    error, ratios, emission, incidence, sampled = (np.concatenate(part) for part in zip(*rows, strict=True))
    inside = (emission <= 60.0) & (incidence >= 10.0) & (incidence <= 70.0)
    for ratio in np.unique(sampled):
        say(f"ratio {ratio}: {summary(error, ratios, inside & (sampled == ratio))}")
    say(f"emission 0..60, incidence 10..70 deg: {summary(error, ratios, inside)}")
    for line in table.lines():
        say(line)


def summary(error, ratios, rows):
    """Return what some centers come to, in words."""
    e, q = error[rows], ratios[rows]
    false = (np.hypot(*e.T) > FALSE_PX) | (np.abs(q).max(axis=1) > FALSE_SIGMAS)
    return (
        f"{len(e)} centers, rms {np.sqrt((e**2).mean()):.3f} px (sigmas {np.sqrt(np.mean((e / q) ** 2)):.3f}), median "
        f"{np.median(np.hypot(*e.T)):.3f} px, error/sigma {np.sqrt((q**2).mean()):.2f}, "
        f"false (above {FALSE_PX:g} px or {FALSE_SIGMAS:g} sigma) {100 * np.mean(false):.2f} %"
    )


def near_camera():
    """A camera that sees 4 deg of the sky, as MapCam, with pixels of 1.4 m at 5 km: Bennu is wider than its field."""
    camera = exam_camera(256)
    return dataclasses.replace(
        camera, focal_length_mm=camera.focal_length_mm * camera.pixel_scale_rad / 272e-6
    )


def poses(first, count):
    """Camera positions from one picture each, 5 km from the center, landmarks alone."""
    camera, body = near_camera(), truth_body()
    shape = body.shape(480, smooth=1.0)
    pixel_km = 5.0 * camera.pixel_scale_rad
    maplets = make_maplets(
        "BENNU", shape, 18.0 * pixel_km, scale_km=pixel_km, samples=37, albedo=known_albedo(body)
    )
    law = Hapke(w=0.3, b0=0.6, h=0.05, asymmetry=-0.3, roughness_deg=18.0)
    within = solved = 0
    pixels = []
    for number in range(first, first + count):
        place, sun, turn = geometry(1000 + number, camera)
        place *= 5.0 / np.linalg.norm(place)
        light = body.draw(camera, turn, place, sun, law, cells=2, psf_sigma=PSF_PX * PSF_ERROR)
        picture = believed_picture(light, place, sun, turn, camera, shape, LunarLambert(), number)
        found, error, seconds = score(picture, place, turn, maplets, camera)
        if found.pose is None:
            say(f"{number}: no pose, {found.messages[0]}")
            continue
        off = place - found.pose.position_km
        square = float(off @ np.linalg.solve(found.pose.position_covariance_km2, off))
        toward = place / np.linalg.norm(place)
        solved += 1
        within += square < 14.16  # 99.73 % of 3 degrees of freedom: 3 sigma
        sigma = np.sqrt(toward @ found.pose.position_covariance_km2 @ toward)
        px_km = range_by_pixel_km(found.centers, found.accepted, toward)
        pixels.append(float(off @ toward) / px_km)
        say(
            f"{number}: {found.accepted.sum()} landmarks, rms {np.sqrt((error[found.accepted] ** 2).mean()):.3f} px; "
            f"position off {1e3 * np.linalg.norm(off):.2f} m (along {1e3 * off @ toward:.2f}, sigma {1e3 * sigma:.2f}; "
            f"{1e3 * px_km:.1f} m a pixel of all), chi-squared {square:.1f} of 3; within 3 sigma {within} of {solved}; "
            f"{seconds:.1f} s"
        )
    say(
        f"{solved} of {count} solved, {within} within 3 sigma; along the range, in what the geometry makes of a pixel: rms "
        f"{np.sqrt(np.mean(np.square(pixels))):.3f}, largest {np.abs(pixels).max():.3f}"
    )


def range_by_pixel_km(centers, rows, toward):
    """Return the geometry's factor: how well centers of 1 px each, alone, tell the place along the range, km."""
    at = centers.partials
    design = np.concatenate([at.spacecraft_px_per_km[rows], at.attitude_px_per_rad[rows]], axis=2).reshape(
        -1, 6
    )
    scale = np.linalg.norm(design, axis=0)
    covariance = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    return float(np.sqrt(toward @ covariance[:3, :3] @ toward))


def pose_square(pose, place, turn):
    """Chi-squared of a pose, 6 degrees of freedom."""
    from opnav_workbench.geometry import vector_from_rotation

    off = np.concatenate([place - pose.position_km, vector_from_rotation(turn @ pose.camera_from_j2000.T)])
    scale = np.sqrt(np.diag(pose.covariance))
    return float(off / scale @ np.linalg.solve(pose.covariance / np.outer(scale, scale), off / scale))


if __name__ == "__main__":
    main()
