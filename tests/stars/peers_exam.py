"""The stars' figures beside those of other programs, in one run: by hand, not by pytest.

    python tests/stars/peers_exam.py STARS.npz [part ...]

STARS.npz is a list of stars of the whole sky (arrays ra_deg, dec_deg, mag), such as Tycho-2. Parts are ``lost``, ``dots``,
``pointing``, ``identification``, ``fit``, ``detection``, ``cones`` and ``undersampled``; without, all. Peers: solve-field of
astrometry.net with its Tycho-2 indexes (Debian's packages astrometry.net, astrometry-data-tycho2; where the indexes stand
elsewhere, SOLVE_FIELD_CONFIG names the configuration that adds their folder), cedar-solve, photutils, scipy. Whoever is not
installed is left out, with the reason. Times are of the processor, in seconds; of solve-field that of its own process and
children.
"""

import importlib
import logging
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import lost_exam
import numpy as np
from astropy.table import Table

SEED = 18
LOST_FIELDS, PEER_FIELDS, DOTS = 200, 12, 1000
PEER_WIDTH_DEG, PEER_STARS, PEER_RAYS, PEER_NOISE_PX = 11.0, 40, 10, 0.2
SOLVE_FIELD_LIMIT_S = 20


def say(*words):
    sys.stdout.write(" ".join(str(word) for word in words) + "\n")
    sys.stdout.flush()


def row(what, ours, peers):
    """Print our figure, then those of peers; what is callable is only asked for then."""
    say(f"{what:46s} ours {ours}")
    for name, found in peers.items():
        say(f"{'':46s} {name} {found() if callable(found) else found}")


def timed(call):
    """Return what a call gives and its processor time, its children's included."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    before = [resource.getrusage(kind) for kind in kinds]
    found = call()
    after = [resource.getrusage(kind) for kind in kinds]
    used = sum(b.ru_utime + b.ru_stime - a.ru_utime - a.ru_stime for a, b in zip(before, after, strict=True))
    return found, used


def best_of(call, times=5):
    """Return the shortest processor time of some calls, and what the last gave."""
    spent = []
    for _ in range(times):
        began = time.process_time()
        found = call()
        spent.append(time.process_time() - began)
    return min(spent), found


def module(name, package=None):
    """Return a module, or the reason why it is not here."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        return f"left out: {package or name} is not installed ({error})"


# ---- Lost in space.


def our_index(stars, rng):
    from opnav_workbench.stars.lost_in_space import index_of_stars

    vectors, mag = lost_exam.sky(stars), np.asarray(stars["mag"], float)
    known = rng.random(len(mag)) >= lost_exam.MISSING_SHARE
    index, seconds = timed(lambda: index_of_stars(vectors[known], mag[known]))
    say(
        f"index of {known.sum()} of {len(mag)} stars opened in {seconds:.1f} s (made once, kept in the cache)"
    )
    return vectors, mag, index


def solve_ours(index, field):
    from opnav_workbench.stars.lost_in_space import solve_lost

    seen = lost_exam.detections(field.places_px, field.flux)
    return solve_lost(index, seen, lost_exam.camera(field.told_focal_px))


def verdict(field, answer):
    if answer.camera_from_j2000 is None:
        return "open"
    return "solved" if lost_exam.error_px(field, answer) < lost_exam.MAX_ERROR_PX else "wrong"


def tally(verdicts, seconds):
    counts = {word: verdicts.count(word) for word in ("solved", "wrong", "open")}
    told = ", ".join(f"{count} {word}" for word, count in counts.items())
    return f"{told} of {len(verdicts)}; median {np.median(seconds):.3f} s, most {max(seconds):.3f} s"


def lost(stars):
    rng = np.random.default_rng(SEED)
    vectors, mag, index = our_index(stars, rng)
    fields = [lost_exam.draw_field(rng, vectors, mag) for _ in range(LOST_FIELDS)]
    solved = [timed(lambda field=field: solve_ours(index, field)) for field in fields]
    verdicts = [verdict(field, answer) for field, (answer, _) in zip(fields, solved, strict=True)]
    row("lost in space, 0.3 to 20 deg, 8 stars or more", tally(verdicts, [s for _, s in solved]), {})
    for field, word in zip(fields, verdicts, strict=True):
        if word != "solved":
            say(f"    {word}: {field.width_deg:.2f} deg, {field.n_stars} stars")
    beside_peers(rng, vectors, mag, index)


def beside_peers(rng, vectors, mag, index):
    lost_exam.FALSE_SHARE = PEER_RAYS / (PEER_RAYS + PEER_STARS)
    fields = [
        lost_exam.draw_field(rng, vectors, mag, PEER_WIDTH_DEG, PEER_STARS, PEER_NOISE_PX)
        for _ in range(PEER_FIELDS)
    ]
    solved = [timed(lambda field=field: solve_ours(index, field)) for field in fields]
    verdicts = [verdict(field, answer) for field, (answer, _) in zip(fields, solved, strict=True)]
    peers = {"solve-field": lambda: solve_field(fields), "cedar-solve": lambda: cedar_solve(fields)}
    what = f"lost in space, {PEER_WIDTH_DEG:g} deg, {PEER_STARS} stars, {PEER_RAYS} rays"
    row(what, tally(verdicts, [seconds for _, seconds in solved]), peers)


def off_deg(field, ra_deg, dec_deg):
    """Return how far from the field's true center a peer's answer is, deg."""
    ra, dec = np.radians([ra_deg, dec_deg])
    told = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return float(np.degrees(np.arccos(np.clip(told @ field.camera_from_j2000[2], -1.0, 1.0))))


def judged(field, place):
    if place is None:
        return "open"
    return "solved" if off_deg(field, *place) < 0.02 * field.width_deg else "wrong"


def solve_field(fields):
    """astrometry.net, told the scale to 10 % as we are told the focal length to 5 %."""
    program = shutil.which("solve-field")
    if program is None:
        return "left out: no solve-field (apt install astrometry.net astrometry-data-tycho2)"
    verdicts, seconds = [], []
    for field in fields:
        with tempfile.TemporaryDirectory() as folder:
            place, spent = timed(
                lambda field=field, folder=folder: _solve_field(program, field, Path(folder))
            )
        verdicts.append(judged(field, place))
        seconds.append(spent)
    return tally(verdicts, seconds)


def _solve_field(program, field, folder):
    places = Table({"X": field.places_px[:, 0] + 1.0, "Y": field.places_px[:, 1] + 1.0, "FLUX": field.flux})
    places.write(folder / "stars.xyls", format="fits")
    size, config = str(lost_exam.SIZE_PX), os.environ.get("SOLVE_FIELD_CONFIG")
    subprocess.run(
        [
            program, "stars.xyls", "--width", size, "--height", size, "--x-column", "X", "--y-column", "Y",
            "--sort-column", "FLUX", "--scale-units", "degwidth", "--scale-low", str(0.9 * field.width_deg),
            "--scale-high", str(1.1 * field.width_deg), "--no-plots", "--cpulimit", str(SOLVE_FIELD_LIMIT_S), "--no-verify",
            "--wcs", "found.wcs", "--crpix-center", *(("--config", config) if config else ()),
        ],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False,
    )  # fmt: skip
    if not (folder / "found.wcs").exists():
        return None
    from astropy.io import fits

    header = fits.getheader(folder / "found.wcs")
    return header["CRVAL1"], header["CRVAL2"]


def cedar_solve(fields):
    """The field of view within 10 %, and its own catalog."""
    tetra3 = module("tetra3", "cedar-solve")
    if isinstance(tetra3, str):
        return tetra3
    if not hasattr(np, "math"):
        np.math = math  # cedar-solve 0.5 asks numpy for it, as numpy 1 had it
    logging.getLogger("tetra3").setLevel(logging.ERROR)
    solver = tetra3.Tetra3("default_database")
    verdicts, seconds = [], []
    for field in fields:
        places, size = field.places_px[:, ::-1], lost_exam.SIZE_PX
        told, spent = timed(
            lambda places=places, size=size, field=field: solver.solve_from_centroids(
                places, (size, size), fov_estimate=field.width_deg, fov_max_error=0.1 * field.width_deg
            )
        )
        place = None if told.get("RA") is None else (told["RA"], told["Dec"])
        verdicts.append(judged(field, place))
        seconds.append(spent)
    return tally(verdicts, seconds)


def dots(stars):
    from opnav_workbench.stars.lost_in_space import solve_lost

    rng = np.random.default_rng(SEED + 1)
    *_, index = our_index(stars, rng)
    answers, seconds = 0, []
    for _ in range(DOTS):
        focal = (
            0.5 * lost_exam.SIZE_PX / np.tan(0.5 * np.radians(np.exp(rng.uniform(np.log(0.3), np.log(20.0)))))
        )
        seen = lost_exam.detections(*lost_exam.random_dots(rng))
        answer, spent = timed(lambda seen=seen, focal=focal: solve_lost(index, seen, lost_exam.camera(focal)))
        answers += answer.camera_from_j2000 is not None
        seconds.append(spent)
    row(
        f"{DOTS} pictures of random dots",
        f"{answers} answers; median {np.median(seconds):.3f} s, most {max(seconds):.3f} s", {},
    )  # fmt: skip


# ---- Attitudes and identification of few stars.


def lorri():
    from opnav_workbench.camera import Camera
    from opnav_workbench.resources import kernels_meta_dir

    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def pointing(_stars):
    from scipy.spatial.transform import Rotation

    from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector, vector_from_rotation
    from opnav_workbench.stars.pointing import solve_pointing

    camera, rng = lorri(), np.random.default_rng(SEED)
    a_priori = camera_from_j2000(1.0, 0.3, 2.0, camera.focal_from_camera)
    for n, fields in ((4, 200), (50, 60)):
        errors, spent = {"ours": [], "scipy": []}, {"ours": [], "scipy": []}
        for _ in range(fields):
            truth = rotation_from_vector(rng.normal(0.0, 1e-4, 3)) @ a_priori
            places, sigma = rng.uniform(10.0, 1010.0, (n, 2)), 10.0 ** rng.uniform(-1.7, -0.5, (n, 1))
            seen, sky = places + sigma * rng.normal(size=(n, 2)), camera.unproject(places) @ truth
            covariance = sigma[:, :, None] ** 2 * np.eye(2)
            ways = {
                "ours": lambda a=seen, c=covariance, s=sky: (
                    solve_pointing(a, c, s, camera, a_priori, twist_sigma_rad=1.0).camera_from_j2000
                ),
                "scipy": lambda a=seen, s=sky, w=sigma[:, 0] ** -2.0: Rotation.align_vectors(
                    camera.unproject(a), s, weights=w
                )[0].as_matrix(),
            }
            for name, way in ways.items():
                seconds, found = best_of(way, 3)
                spent[name].append(seconds)
                errors[name].append(vector_from_rotation(found @ truth.T)[:2])
        told = {
            name: f"{1e6 * np.sqrt(np.mean(np.square(errors[name]))):.3f} microrad, {1e3 * np.median(spent[name]):.2f} ms"
            for name in errors
        }
        row(f"attitude of {n} stars", told["ours"], {"scipy align_vectors": told["scipy"]})


def identification(_stars):
    from opnav_workbench.stars import Detections, identify_sky

    camera, rng = lorri(), np.random.default_rng(SEED)
    for n in (4, 6):
        sure = wrong = 0
        for _ in range(60):
            shift = rng.normal(0.0, 20.0, 2)
            places = rng.uniform(60.0, 960.0, (n, 2))
            mag = rng.uniform(9.0, 12.0, n)
            seen = np.vstack(
                [places + shift + rng.normal(0.0, 0.1, (n, 2)), rng.uniform(0.0, 1023.0, (10, 2))]
            )
            looks = np.r_[mag + rng.normal(0.0, 0.3, n), rng.uniform(9.0, 12.0, 10)]
            order, one = np.argsort(looks), np.ones(n + 10)
            found = identify_sky(
                camera.unproject(places), mag,
                Detections(seen, 10.0 ** (-0.4 * (looks - 20.0)), 30.0 * one, one, np.zeros(n + 10, int)).take(order),
                camera, max_shift_px=60.0, max_twist_rad=np.radians(0.5),
            )  # fmt: skip
            sure += bool(found.sure)
            pairs = np.asarray(found.pairs)
            wrong += bool(found.sure) and bool((order[pairs[:, 1]] != pairs[:, 0]).any())
        row(f"{n} stars among 10 rays, 60 fields", f"{sure} sure, {wrong} of these with a wrong pair", {})


# ---- Pixels.


def fit(_stars):
    sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
    import test_starcenters_speed as speed

    from opnav_workbench.psf import GaussianPsf
    from opnav_workbench.stars import ShapePrior, fit_gaussian, fit_psf

    image, centers = speed.field.__wrapped__() if hasattr(speed.field, "__wrapped__") else star_field(speed)
    start, psf = centers + 0.3, GaussianPsf(speed.SIGMA_PX, speed.SIGMA_PX)
    shape_s, shape = best_of(
        lambda: fit_gaussian(image, speed.NOISE_DN, None, start, ShapePrior.round_psf(speed.SIGMA_PX))
    )
    given_s, given = best_of(lambda: fit_psf(image, speed.NOISE_DN, None, start, psf))
    few = start[: speed.PEER_STARS]
    loop_s, peers = best_of(lambda: speed.naive_loop(image, few), 3)
    told = {"scipy least_squares": said(loop_s / len(few) * len(start), peers, centers)}
    photutils = module("photutils.psf", "photutils")
    if isinstance(photutils, str):
        told["photutils"] = photutils
    else:
        some = start[: speed.PHOTUTILS_STARS]
        speed.photutils_fits(image, some[:2])
        photutils_s, peers = best_of(lambda: speed.photutils_fits(image, some), 2)
        told["photutils"] = said(photutils_s / len(some) * len(start), peers, centers)
    ours = (
        f"{said(given_s, given.pixel_line, centers)}; with shapes {said(shape_s, shape.pixel_line, centers)}"
    )
    row(f"{len(start)} stars fitted, a given PSF", ours, told)


def star_field(speed):
    return speed.field.__pytest_wrapped__.obj()


def said(seconds, found, centers):
    error = np.sqrt(np.nanmean(np.square(found - centers[: len(found)])))
    return f"{seconds:.2f} s, error {error:.4f} px"


def detection(_stars):
    from scipy.ndimage import gaussian_filter

    from opnav_workbench.stars import detect

    rng = np.random.default_rng(SEED)
    image = rng.normal(0.0, 3.0, (4096, 4096))
    for line, pixel in rng.integers(10, 4086, (2000, 2)):
        image[line - 1 : line + 2, pixel - 1 : pixel + 2] += 60.0
    ours_s, found = best_of(lambda: detect(image, 3.0, None, 1.0), 3)
    blur_s, _ = best_of(lambda: gaussian_filter(image, 1.0), 3)
    told = {"scipy gaussian_filter alone": f"{blur_s:.2f} s"}
    photutils = module("photutils.detection", "photutils")
    if isinstance(photutils, str):
        told["photutils"] = photutils
    else:
        finder = photutils.DAOStarFinder(threshold=15.0, fwhm=2.3548)
        peer_s, peers = best_of(lambda: finder(image), 1)
        told["photutils DAOStarFinder"] = f"{peer_s:.2f} s, {len(peers)} found"
    ours = f"{ours_s:.2f} s ({ours_s / blur_s:.2f} of the filter), {len(found)} found"
    row("detection, 4096 x 4096, 2000 stars", ours, told)


def cones(stars):
    from scipy.spatial import cKDTree

    from opnav_workbench.catalog import open_catalog
    from opnav_workbench.geometry import unit_from_radec

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sky.npz"
        np.savez(path, **{name: stars[name] for name in ("ra_deg", "dec_deg", "mag")})
        catalog = open_catalog(f"npz:{path}")
    vectors, rng = lost_exam.sky(stars), np.random.default_rng(SEED)
    tree = cKDTree(vectors)
    catalog.cone(0.0, 0.0, 0.5 * np.pi)  # the first large cone finds what the next ones need
    for radius_deg in (0.3, 1.0, 5.0, 20.0, 60.0):
        radius, n = np.radians(radius_deg), 200 if radius_deg < 5.0 else 5
        centers = [(rng.uniform(0.0, 2.0 * np.pi), np.arcsin(rng.uniform(-1.0, 1.0))) for _ in range(n)]
        chord = 2.0 * np.sin(0.5 * radius)

        def of_tree(centers=centers, chord=chord):
            return [np.array(tree.query_ball_point(unit_from_radec(*c), chord), int) for c in centers]

        def ours(centers=centers, radius=radius):
            found = [catalog.cone(*c, radius) for c in centers]
            return [(s.ra_rad, s.dec_rad, s.mag) for s in found]

        times = []
        for _ in range(9):  # in turn, so that both find the machine alike
            (tree_s, rows), (ours_s, columns) = best_of(of_tree, 1), best_of(ours, 1)
            times.append((tree_s, ours_s))
        tree_s, ours_s = np.min(times, axis=0)
        assert [len(found) for found in rows] == [len(found[0]) for found in columns]
        row(
            f"cone of {radius_deg:g} deg, {np.mean([len(found) for found in rows]):.0f} stars",
            f"{1e3 * ours_s / n:.3f} ms as sorted columns ({ours_s / tree_s:.2f} of the tree)",
            {"scipy cKDTree, bare rows": f"{1e3 * tree_s / n:.3f} ms"},
        )


def undersampled(_stars):
    import psf_exam

    say("undersampled stars: error over bound | over sigma, for SNR 8-20, 20-60, 60-400")
    for frames in (0, 24):
        say(f"  with what {frames} pictures of the camera taught" if frames else "  each picture for itself")
        for name in ("gaussian", "coma", "wings"):
            say("   ", psf_exam.row(name, 0.35, 40, 0.02 if frames else None, frames))


PARTS = {
    part.__name__: part
    for part in (lost, dots, pointing, identification, fit, detection, cones, undersampled)
}


def main(path, *chosen):
    with np.load(path) as file:
        stars = {name: np.asarray(values) for name, values in file.items()}
    for name, part in PARTS.items():
        if not chosen or name in chosen:
            part(stars)


if __name__ == "__main__":
    if len(sys.argv) < 2 or set(sys.argv[2:]) - set(PARTS):
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
