"""Exam of the star fields that are solved without an attitude: run by hand, not by pytest.

    python tests/stars/lost_exam.py STARS.npz [fields] [dots] [seed]

Fields of 0.3 to 20 deg are drawn by this file's own projection from a list of stars (arrays ra_deg, dec_deg, mag): any
place, any twist, the focal length off by up to 5 %, `MIN_STARS` stars or more, their centers and magnitudes noisy, a third
of the detections false, and a fifth of the stars kept from the index. Then pictures of nothing but random dots. Told are
how many fields are solved, wrong or open, processor times, and how many answers the dots got; of the open ones, how many
of the picture's stars the index has: with three nobody can tell where it looks.
"""

import sys
import time
from dataclasses import dataclass

import numpy as np

SIZE_PX = 1024
MIN_STARS, MAX_STARS = 8, 60
FALSE_SHARE, MISSING_SHARE, FOCAL_ERROR = 1.0 / 3.0, 0.2, 0.05
MAG_SIGMA = 0.3
MAX_ERROR_PX = 3.0


@dataclass(frozen=True)
class Field:
    """A picture's detections, brightest first, and the truth of it."""

    places_px: np.ndarray
    flux: np.ndarray
    focal_px: float  # true
    told_focal_px: float
    camera_from_j2000: np.ndarray
    width_deg: float
    stars: np.ndarray  # rows of those that are in the picture

    @property
    def n_stars(self):
        return len(self.stars)


def sky(stars):
    """Return unit vectors (n, 3) of the stars."""
    ra, dec = np.radians(stars["ra_deg"]), np.radians(stars["dec_deg"])
    return np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def random_attitude(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def draw_field(rng, vectors, mag, width_deg=None, n_stars=None, noise_px=None):
    """Draw fields until one has stars enough."""
    while True:
        width = width_deg or float(np.exp(rng.uniform(np.log(0.3), np.log(20.0))))
        focal = 0.5 * SIZE_PX / np.tan(0.5 * np.radians(width))
        attitude = random_attitude(rng)
        near = vectors @ attitude[2] > np.cos(np.radians(0.75 * width))
        seen = vectors[near] @ attitude.T
        places = focal * seen[:, :2] / seen[:, 2:]
        on = np.abs(places).max(axis=1) < 0.5 * SIZE_PX - 2
        if on.sum() < MIN_STARS:
            continue
        rows = np.flatnonzero(near)[on]
        looks = mag[rows] + MAG_SIGMA * rng.normal(size=len(rows))
        wanted = n_stars or round(float(np.exp(rng.uniform(np.log(MIN_STARS), np.log(MAX_STARS)))))
        kept = np.argsort(looks)[:wanted]
        noise = noise_px or rng.uniform(0.1, 0.5)
        places = places[on][kept] + noise * rng.normal(size=(len(kept), 2))
        false = round(len(kept) * FALSE_SHARE / (1.0 - FALSE_SHARE))
        places = np.vstack([places, rng.uniform(-0.5, 0.5, (false, 2)) * SIZE_PX])
        brightness = np.r_[looks[kept], rng.choice(looks[kept], false)]
        order = np.argsort(brightness, kind="stable")
        told = focal * (1.0 + rng.uniform(-FOCAL_ERROR, FOCAL_ERROR))
        return Field(
            places[order] + 0.5 * (SIZE_PX - 1), 10.0 ** (-0.4 * brightness[order]), focal, told, attitude, width,
            rows[kept],
        )  # fmt: skip


def random_dots(rng):
    """Return places and fluxes of a picture that shows nothing."""
    n = rng.integers(10, 100)
    return rng.uniform(-0.5, SIZE_PX - 0.5, (n, 2)), np.sort(10.0 ** rng.normal(0.0, 0.5, n))[::-1]


def error_px(field, answer):
    """Return how far corners and center of the picture are off on the sky, px."""
    half = 0.5 * SIZE_PX
    corners = np.array([[0.0, 0.0], [half, half], [-half, half], [half, -half], [-half, -half]])
    true = np.column_stack([corners, np.full(5, field.focal_px)])
    told = np.column_stack([corners, np.full(5, field.told_focal_px * answer.focal_scale)])
    true /= np.linalg.norm(true, axis=1)[:, None]
    told /= np.linalg.norm(told, axis=1)[:, None]
    apart = np.linalg.norm(true @ field.camera_from_j2000 - told @ answer.camera_from_j2000, axis=1)
    return float(apart.max() * field.focal_px)


def camera(focal_px):
    from dataclasses import replace

    from opnav_workbench.camera import Camera
    from opnav_workbench.resources import kernels_meta_dir

    pinhole = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    per_mm = pinhole.pixel_from_mm[0, 0]
    return replace(
        pinhole, n_pixel=SIZE_PX, n_line=SIZE_PX, focal_length_mm=focal_px / per_mm,
        center_pixel_line=np.full(2, 0.5 * (SIZE_PX - 1)),
    )  # fmt: skip


def detections(places, flux):
    from opnav_workbench.stars import Detections

    one = np.ones(len(flux))
    return Detections(places, flux, 20.0 * one, 0.5 * one, np.zeros(len(flux), np.int64))


def say(*words):
    sys.stdout.write(" ".join(str(word) for word in words) + "\n")
    sys.stdout.flush()


def main(path, fields=200, dots=1000, seed=18):
    from opnav_workbench.stars.lost_in_space import index_of_stars, solve_lost

    stars = {name: np.asarray(values) for name, values in np.load(path).items()}
    vectors, mag = sky(stars), np.asarray(stars["mag"], float)
    known = np.random.default_rng(18).random(len(mag)) >= MISSING_SHARE  # one index for all seeds
    rng = np.random.default_rng(seed)
    began = time.process_time()
    index = index_of_stars(vectors[known], mag[known])
    index.open_all()
    say(f"{known.sum()} stars; index opened in {time.process_time() - began:.1f} s of processor time")
    counts, times, unsolved = {"solved": 0, "wrong": 0, "open": 0}, [], []
    for number in range(fields):
        field = draw_field(rng, vectors, mag)
        began = time.process_time()
        answer = solve_lost(index, detections(field.places_px, field.flux), camera(field.told_focal_px))
        times.append(time.process_time() - began)
        if answer.camera_from_j2000 is None:
            outcome = "open"
        else:
            outcome = "solved" if error_px(field, answer) < MAX_ERROR_PX else "wrong"
        counts[outcome] += 1
        if outcome != "solved":
            held = f"{field.n_stars} stars, {known[field.stars].sum()} of them in the index"
            unsolved.append((number, outcome, f"{field.width_deg:.2f} deg, {held}:", answer.message))
    if fields:
        say(
            counts,
            f"median {np.median(times):.3f} s, 95 % {np.quantile(times, 0.95):.3f}, most {max(times):.3f}",
        )
    for row in unsolved:
        say("   ", *row)
    false, times = 0, []
    for number in range(dots):
        if number and number % 20 == 0:
            say(f"{false} answers to {number} pictures of random dots; median {np.median(times):.3f} s")
        width = float(np.exp(rng.uniform(np.log(0.3), np.log(20.0))))
        began = time.process_time()
        answer = solve_lost(
            index, detections(*random_dots(rng)), camera(0.5 * SIZE_PX / np.tan(0.5 * np.radians(width)))
        )
        times.append(time.process_time() - began)
        false += answer.camera_from_j2000 is not None
    if dots:
        say(
            f"{false} answers to {dots} pictures of random dots; median {np.median(times):.3f} s, most {max(times):.3f}"
        )


if __name__ == "__main__":
    main(sys.argv[1], *(int(number) for number in sys.argv[2:]))
