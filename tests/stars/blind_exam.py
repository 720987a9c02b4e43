"""Exam of whole star pictures under varied conditions: run by hand, not by pytest.

    python tests/stars/blind_exam.py STARS.npz [pictures of a kind] [seed] [condition ...]

Pictures of four cameras are drawn by this file's own optics, aberration, PSF and detector from a list of stars of the
whole sky (arrays ra_deg, dec_deg, mag), written as FITS files with their headers, and processed as a user would. The PSF is
no Gaussian (core, wings, coma), the catalog errs by its sigmas, brightness by 0.3 mag, and every picture has faint stars
that no catalog knows. Told are, by condition: how many are solved, wrong though called sure, and refused; errors over
sigmas of attitude and centers; stars in use that are none.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits

EPOCH_JYEAR = 2020.3
ET_S = 640821600.0
UTC = "2020-04-22T09:58:50.816"  # TDB - UTC was 69.184 s
SIGMA_MAS = 25.0
SUN_POSITION_KM = np.array([1.5e9, 4.0e9, 1.6e9])
SUN_VELOCITY_KM_S = np.array([-4.0, 12.5, 5.0])
C_KM_S = 299792.458
PAIRS = 0.4  # of the stars of a picture of pairs, that have a companion in no catalog
COLOR_MAG = 0.3  # scatter of a camera's magnitudes about those of the catalog
FAINT_FROM = 12.2  # stars fainter than that are in no catalog
OVER = 9  # samples of the PSF across a pixel
FALSE_SIGMAS, FALSE_PX = 5.0, 0.5


@dataclass(frozen=True)
class Kind:
    """A camera: facts as its maker states them."""

    mission: str
    size: int
    focal_px: float
    sigma_px: tuple[float, float]  # PSF, and how well it is known
    zero_point: float
    saturation_dn: float
    read_noise_dn: float
    gain: float
    bias_dn: float
    header: dict
    error_px: float
    look: int = 1  # along which sense of the third axis it looks
    exposures: tuple[float, float] = (0.2, 5.0)
    lens: str = "none"


def owen(x, y):
    """LORRI's published terms; mm."""
    r2 = x * x + y * y
    k = 2.71725397251e-05 * r2 - 1.9034392552e-05 * y - 2.8806647688e-05 * x
    return x * (1 + k), y * (1 + k)


NH = {"MISSION": "New Horizons", "INSTRU": "lor"}
KINDS = {
    "lorri_4x4": Kind(
        "new_horizons", 256, 2618.47759646 * 19.2352138955, (0.4, 0.15), 18.97, 3500.0, 1.1, 22.0, 0.0,
        {**NH, "SFORMAT": "4X4"}, 10.0, -1, (0.1, 2.0), "owen",
    ),
    "lorri_1x1": Kind(
        "new_horizons", 1024, 2618.47759646 * 76.940855582, (0.85, 0.2), 18.94, 3500.0, 1.1, 22.0, 0.0,
        {**NH, "SFORMAT": "1X1"}, 40.0, -1, (0.5, 8.0), "owen",
    ),
    "pinhole": Kind("generic", 1024, 1e5, (0.8, 0.2), 18.0, 15000.0, 2.0, 10.0, 500.0, {}, 20.0),
    "cubesat": Kind(
        "generic", 2048, 25.0 * 181.818181818, (0.9, 0.25), 15.27485, 4013.0, 4.437, 2.93, 81.0,
        {"INSTRUME": "CUBESAT"}, 4.5, 1, (0.1, 0.5), "brown",
    ),
}  # fmt: skip


def vectors_of(ra_deg, dec_deg):
    """Return unit vectors (n, 3)."""
    a, d = np.radians(ra_deg), np.radians(dec_deg)
    return np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])


def aberrated(directions):
    """Return apparent directions: the exact formula of special relativity."""
    beta = -SUN_VELOCITY_KM_S / C_KM_S
    gamma = 1.0 / np.sqrt(1.0 - beta @ beta)
    along = directions @ beta
    seen = directions / gamma + (1.0 + along * gamma / (1.0 + gamma))[:, None] * beta
    return seen / np.linalg.norm(seen, axis=1)[:, None]


def places_of(kind, apparent, camera_from_j2000):
    """Return (pixel, line) of apparent directions; nan behind the camera."""
    v = apparent @ camera_from_j2000.T
    depth = kind.look * v[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = np.where(depth > 0.1, v[:, 0] / depth, np.nan), np.where(depth > 0.1, v[:, 1] / depth, np.nan)
    if kind.lens == "owen":
        mm = 2618.47759646
        x, y = (value / mm for value in owen(x * mm, y * mm))
    if kind.lens == "brown":
        k = 1.0 - 0.08 * (x * x + y * y)
        x, y = x * k, y * k
    return kind.focal_px * np.column_stack([x, y]) + 0.5 * (kind.size - 1)


def turn(vector):
    """Rotation matrix by Rodrigues' formula."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def quaternion(m):
    """Scalar first, SPICE's m2q."""
    w, v = np.linalg.eigh(
        np.array([
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [0, m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [0, 0, m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [0, 0, 0, m[2, 2] - m[0, 0] - m[1, 1]],
        ]), "U",
    )  # fmt: skip
    return v[:, np.argmax(w)]


def matrix(q):
    """Return the matrix of a scalar-first quaternion."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


# ---- The light of a star: core, wings and coma, integrated over pixels by counting samples.


@dataclass(frozen=True)
class Psf:
    """A core with wings and coma; offsets and widths in px, all over the core's sigma."""

    sigma: float
    wing: float  # part of the light
    coma: float

    def image(self, x, y, box):
        """Return the light (box, box) of a star (x, y) px off the middle of the box."""
        edge = (np.arange(box * OVER) + 0.5) / OVER - 0.5 * box
        dx, dy = edge[None, :] - x, edge[:, None] - y
        s = self.sigma

        def blob(width, ox=0.0, oy=0.0):
            return np.exp(-0.5 * ((dx - ox) ** 2 + (dy - oy) ** 2) / width**2) / (2 * np.pi * width**2)

        # The middle of light stays where it is.
        c = self.coma
        light = (1 - self.wing - 0.2) * blob(s, -0.2 * c * s / (0.8 - self.wing) * 1.0) + 0.2 * blob(
            1.2 * s, c * s
        )
        light = light + self.wing * blob(2.5 * s)
        return light.reshape(box, OVER, box, OVER).sum(axis=(1, 3)) / OVER**2


def stars_on(image, psf, places, flux):
    """Add stars to an image of electrons or DN."""
    n = image.shape[0]
    for (x, y), light in zip(places, flux, strict=True):
        box = 2 * int(np.ceil(9 * psf.sigma + 2)) + 1
        if light < 50.0:
            box = 2 * int(np.ceil(4 * psf.sigma + 1)) + 1
        i, j = round(y), round(x)
        stamp = light * psf.image(x - j, y - i, box)
        h = box // 2
        a, b, c, d = max(i - h, 0), min(i + h + 1, n), max(j - h, 0), min(j + h + 1, n)
        if a < b and c < d:
            image[a:b, c:d] += stamp[a - i + h : b - i + h, c - j + h : d - j + h]


# ---- What can be wrong with a picture.

CONDITIONS = (
    "plain", "few", "none", "wrong", "saturated", "cosmic", "gaps", "broken", "turned", "mirrored", "empty", "sky",
    "crowded", "fast", "lone", "pairs",
)  # fmt: skip
WHOLE_SKY = ("none", "wrong", "turned", "mirrored")  # whose catalog is that of the whole sky
WIDE = ("plain", "none", "wrong", "mirrored", "turned")  # of which the widest camera has pictures, too
N_STARS = {
    "few": (1, 4),
    "lone": (2, 30),
    "pairs": (2, 60),
    "crowded": (20, 400),
    "none": (8, 400),
    "turned": (8, 400),
    "mirrored": (8, 400),
}


@dataclass
class Picture:
    """A picture's file, and the truth of it."""

    path: Path
    kind: Kind
    camera_from_j2000: np.ndarray
    places: dict  # of catalog stars that are in the picture, by id
    n_bright: int


class Sky:
    """The stars of the whole sky, and which are near a direction."""

    def __init__(self, path):
        data = np.load(path)
        self.ra, self.dec, self.mag = (np.asarray(data[k], float) for k in ("ra_deg", "dec_deg", "mag"))
        self.vectors = vectors_of(self.ra, self.dec)
        self.order = np.argsort(self.dec)
        self.sorted_dec = self.dec[self.order]

    def near(self, v, radius_rad):
        """Return the rows of the stars within a radius."""
        dec, r = np.degrees(np.arcsin(v[2])), np.degrees(radius_rad)
        a, b = np.searchsorted(self.sorted_dec, [dec - r, dec + r])
        rows = self.order[a:b]
        return rows[self.vectors[rows] @ v > np.cos(radius_rad)]


def snr_of(kind, flux, sigma):
    """About what a star's signal-to-noise ratio is."""
    sigma = np.hypot(sigma, 0.29)
    return flux / np.sqrt(4 * np.pi * sigma**2 * kind.read_noise_dn**2 + flux / kind.gain)


@dataclass
class Field:
    """The stars around a random direction, as a camera sees them."""

    rows: np.ndarray
    directions: np.ndarray  # true, apparent
    attitude: np.ndarray
    places: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    exposure: float

    def within(self, kind, margin_px):
        """Tell which stars are on the detector, that much widened."""
        return (np.abs(self.places - 0.5 * (kind.size - 1)) < 0.5 * kind.size + margin_px).all(axis=1)


def random_field(rng, sky, kind, condition, sigma):
    """Look into a random direction."""
    v = rng.normal(size=3)
    v /= np.linalg.norm(v)
    rows = sky.near(v, 1.02 * np.arctan(0.72 * kind.size / kind.focal_px))
    x = np.cross(v, rng.normal(size=3))
    x /= np.linalg.norm(x)
    attitude = np.array([x, np.cross(kind.look * v, x), kind.look * v])
    exposure = kind.exposures[0] if condition == "fast" else np.exp(rng.uniform(*np.log(kind.exposures)))
    true = sky.vectors[rows] + np.radians(SIGMA_MAS / 3.6e6) * rng.normal(size=(len(rows), 3))
    apparent = aberrated(true / np.linalg.norm(true, axis=1)[:, None])
    looks = sky.mag[rows] + COLOR_MAG * rng.normal(size=len(rows))
    flux = exposure * 10.0 ** (-0.4 * (looks - kind.zero_point))
    places = places_of(kind, apparent, attitude)
    return Field(rows, apparent, attitude, places, flux, snr_of(kind, flux, sigma), exposure)


def wanted_field(rng, sky, kind, condition, sigma):
    """Look around until there is a field of the kind that is wanted; None where the sky has none."""
    low, high = N_STARS.get(condition, (3, 400))
    for _ in range(4000):
        field = random_field(rng, sky, kind, condition, sigma)
        on = field.within(kind, -3)
        bright = int((on & (field.snr > 12)).sum())
        if condition == "empty":
            good = bright == 0
        elif condition == "saturated":
            good = low <= bright <= high and (field.flux[on] * 0.25 > kind.saturation_dn).any()
        else:
            good = low <= bright <= high
        if good:
            return field, bright
    return None


def light_of(rng, kind, condition, field, sigma):
    """Return the light in DN of stars known and unknown, and of the sky."""
    picture = np.zeros((kind.size, kind.size))
    seen = field.within(kind, 12) & (field.snr > 0.3)
    psf = Psf(sigma * 0.93, rng.uniform(0.0, 0.06), rng.uniform(-0.15, 0.15))
    stars_on(picture, psf, field.places[seen], field.flux[seen])
    if condition == "pairs":
        paired = seen & (field.snr > 8) & (rng.random(len(seen)) < PAIRS)
        count, angle = int(paired.sum()), rng.uniform(0.0, 2.0 * np.pi, int(paired.sum()))
        apart = rng.uniform(0.5, 5.0, count) * np.hypot(sigma, 0.29)
        offset = apart[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        stars_on(
            picture, psf, field.places[paired] + offset, field.flux[paired] * rng.uniform(0.2, 1.0, count)
        )
    # Faint stars that no catalog knows: as many as a sky has that doubles with each magnitude.
    faint = rng.poisson(135.0 * np.degrees(kind.size / kind.focal_px) ** 2)
    faint_mag = FAINT_FROM + np.log2(1.0 + rng.uniform(0, 7, faint))
    light = field.exposure * 10.0 ** (-0.4 * (faint_mag - kind.zero_point))
    bright = snr_of(kind, light, sigma) > (2.0 if kind.size > 1024 else 0.3)
    stars_on(picture, psf, rng.uniform(-0.5, kind.size - 0.5, (faint, 2))[bright], light[bright])
    if condition != "sky":
        return picture + rng.uniform(0.0, 20.0)
    line, pixel = np.mgrid[: kind.size, : kind.size] / kind.size - 0.5
    slopes = rng.uniform(-50, 50, 2)
    stray = rng.uniform(0, 200) * np.exp(-20 * ((line - 0.4) ** 2 + pixel**2))
    return picture + 60.0 + slopes[0] * line + slopes[1] * pixel + stray


def exposed(rng, kind, condition, light):
    """Return what the detector makes of light."""
    electrons = light * kind.gain
    if condition == "cosmic":
        hits(rng, electrons, int(rng.uniform(30, 200)))
    data = rng.poisson(np.maximum(electrons, 0.0)) / kind.gain + rng.normal(
        0.0, kind.read_noise_dn, light.shape
    )
    data = np.minimum(data, kind.saturation_dn * 1.05 - kind.bias_dn)
    return (break_pixels(rng, data, kind) if condition == "broken" else data) + kind.bias_dn


def draw(rng, sky, kind, condition, folder, number):
    """Draw one picture and write its file; return it, the catalog's rows around it, and which of them are known."""
    sigma = max(0.26, kind.sigma_px[0] + kind.sigma_px[1] * np.clip(rng.normal(), -1.5, 1.5) * 0.7)
    found = wanted_field(rng, sky, kind, condition, sigma)
    if found is None:
        return None
    field, bright = found
    data = exposed(rng, kind, condition, light_of(rng, kind, condition, field, sigma))
    told = None if condition == "none" else a_priori(rng, kind, condition, field.attitude)
    attitude, places = field.attitude, field.places
    if condition == "turned":
        data, attitude = turned_picture(data, attitude, int(rng.integers(1, 4)))
        places = places_of(kind, field.directions, attitude)
    if condition == "mirrored":
        data = data[::-1]
    known = rng.random(len(field.rows)) >= (0.35 if condition == "gaps" else 0.02)
    if condition == "lone":  # all but one to three of the bright ones
        bright_ones = np.flatnonzero(field.within(kind, -3) & (field.snr > 12))
        known = np.isin(np.arange(len(known)), rng.permutation(bright_ones)[: rng.integers(1, 4)])
    path = folder / f"{number:04d}.fits"
    write(path, kind, data, field.exposure, told)
    real = field.within(kind, 12) & (field.snr > 1.0)
    truth = {f"S{row}": place for row, place in zip(field.rows[real], places[real], strict=True)}
    return Picture(path, kind, attitude, truth, bright), field.rows, known


def turned_picture(data, attitude, quarter):
    """The whole camera turned: the picture of a camera that is mounted otherwise; the lens is taken as ideal."""
    angle = quarter * 0.5 * np.pi
    c, s = round(np.cos(angle)), round(np.sin(angle))
    # np.rot90 by k turns (pixel, line) -> (line, n - 1 - pixel) each time.
    r = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.rot90(data, quarter).copy(), r @ attitude


def a_priori(rng, kind, condition, attitude):
    """Return the attitude that the header tells."""
    shift, twist = rng.normal(size=2) * kind.error_px, np.radians(0.2) * np.clip(rng.normal(), -2, 2)
    if condition == "wrong":
        away, direction = rng.choice([150.0, 500.0, 3e4]), rng.uniform(0, 2 * np.pi)
        shift = away * np.array([np.cos(direction), np.sin(direction)])
        twist = rng.uniform(-3.1, 3.1) if rng.random() < 0.5 else 0.01
    return turn(np.array([shift[1] / kind.focal_px, -shift[0] / kind.focal_px, twist])) @ attitude


def hits(rng, electrons, count):
    """Cosmic rays: points and tracks."""
    n = electrons.shape[0]
    for _ in range(count):
        x, y, a = rng.uniform(2, n - 3), rng.uniform(2, n - 3), rng.uniform(0, 2 * np.pi)
        charge = np.exp(rng.normal(np.log(3000.0), 1.0))
        for step in np.arange(0.0, rng.exponential(2.0) + 0.2, 0.5):
            i, j = round(y + step * np.sin(a)), round(x + step * np.cos(a))
            if 0 <= i < n and 0 <= j < n:
                electrons[i, j] += charge


def break_pixels(rng, data, kind):
    """NaN, hot and dead pixels, a dead column, a block that was not sent."""
    data = data.copy()
    n = data.shape[0]
    spots = rng.integers(0, n, (2, n * n // 2000))
    data[tuple(spots)] += rng.exponential(400.0, spots.shape[1])
    spots = rng.integers(0, n, (2, n * n // 3000))
    data[tuple(spots)] = 0.0
    spots = rng.integers(0, n, (2, n * n // 500))
    data[tuple(spots)] = np.nan
    data[:, rng.integers(0, n)] = np.nan
    data[:, rng.integers(0, n)] = 0.0
    i, j = rng.integers(0, n * 3 // 4, 2)
    data[i : i + n // 6, j : j + n // 4] = rng.choice([0.0, np.nan])
    return np.minimum(data, kind.saturation_dn * 1.05 - kind.bias_dn)


def write(path, kind, data, exposure, told):
    """Write the FITS file with the header of its mission."""
    hdu = fits.PrimaryHDU(data.astype(np.float32))
    header = hdu.header
    header.update(kind.header)
    header["EXPTIME"] = exposure
    if kind.mission == "new_horizons":
        header["SPCSCET"], header["SPCUTCAL"] = ET_S, UTC
        names, q = ("SPCQA", "SPCQX", "SPCQY", "SPCQZ"), None if told is None else quaternion(told.T)
        sun = "SPCSSCX", "SPCSSCY", "SPCSSCZ", "SPCSSCVX", "SPCSSCVY", "SPCSSCVZ"
    else:
        header["DATE-AVG"] = UTC
        names, q = ("QUAT0", "QUAT1", "QUAT2", "QUAT3"), None if told is None else quaternion(told)
        sun = "SUNPOSX", "SUNPOSY", "SUNPOSZ", "SUNVELX", "SUNVELY", "SUNVELZ"
    for key, value in zip(sun, [*SUN_POSITION_KM, *SUN_VELOCITY_KM_S], strict=True):
        header[key] = float(value)
    if q is not None:
        for key, value in zip(names, q, strict=True):
            header[key] = float(value)
    hdu.writeto(path, overwrite=True)


# ---- What came out.


def judge(picture, result, pointing_solved):
    """Return what is wrong with an answer, and its errors over sigmas."""
    out = {"stars": [], "false": []}
    if not pointing_solved:
        return out
    pointing = result["pointing"]
    solved = matrix(np.array(pointing["quaternion_camera_from_j2000"]))
    off = solved @ picture.camera_from_j2000.T
    vector = 0.5 * np.array([off[1, 2] - off[2, 1], off[2, 0] - off[0, 2], off[0, 1] - off[1, 0]])
    covariance = np.array(pointing["covariance_rad2"])
    out["chi2"] = float(vector @ np.linalg.solve(covariance, vector)) / 3.0
    out["cross"] = float(np.hypot(*vector[:2]) * picture.kind.focal_px)
    out["sigma"] = float(np.sqrt(covariance[0, 0] + covariance[1, 1]) * picture.kind.focal_px)
    for star in result["stars"]:
        if star["status"] != "used":
            continue
        true = picture.places.get(star["id"])
        if true is None:
            out["false"].append((star["id"], "not there"))
            continue
        error, sigma = np.array(star["observed"]) - true, np.array(star["sigma_px"])
        out["stars"].append(error / sigma)
        if (np.abs(error) > np.maximum(FALSE_SIGMAS * sigma, FALSE_PX)).any():
            out["false"].append(
                (star["id"], np.round(error, 2).tolist(), np.round(sigma, 2).tolist(), round(star["snr"]))
            )
    return out


def say(*words):
    sys.stdout.write(" ".join(str(word) for word in words) + "\n")
    sys.stdout.flush()


def ratio(values):
    """Root mean square, and its robust peer."""
    values = np.ravel(values)
    if len(values) == 0:
        return "-"
    return f"{np.sqrt(np.mean(values**2)):.2f} ({np.median(np.abs(values)) / 0.6745:.2f})"


def exam_of(condition, number, each, seed, sky, folder):
    """Draw, process and judge the pictures of one condition; yield each with its verdict and what was found."""
    from opnav_workbench.processing import process

    for index, (name, kind) in enumerate(KINDS.items()):
        count = each if name != "cubesat" else int(condition in WIDE)
        if condition == "turned" and kind.lens == "owen":
            continue  # its lens does not turn with it here
        for trial in range(count):
            rng = np.random.default_rng([seed, number, index, trial])
            drawn = draw(rng, sky, kind, condition, folder, trial)
            if drawn is None:
                continue
            picture, rows, known = drawn
            spec = catalog_for(condition, sky, folder, picture, rows[~known])
            began = time.process_time()
            (outcome,) = process(picture.path, mission=kind.mission, catalog=spec, targets="none")
            seconds = time.process_time() - began
            result = outcome.result or {}
            pointing = result.get("pointing") or {}
            solved = pointing.get("covariance_rad2") is not None and pointing["n_stars"] > 0
            found = judge(picture, result, solved)
            verdict = "refused"
            if solved:
                right = found["cross"] < max(5.0 * found["sigma"], 1.0)
                verdict = "solved" if right else f"WRONG {result['status']}"
            expected = condition not in ("empty", "mirrored")
            if (
                found["false"]
                or verdict.startswith("WRONG")
                or solved != expected
                or found.get("chi2", 0) > 5
            ):
                why = "; ".join(map(str, result.get("messages", [outcome.error])))
                numbers = {k: round(v, 2) for k, v in found.items() if isinstance(v, float)}
                say(
                    "   ",
                    condition,
                    name,
                    trial,
                    f"{picture.n_bright} stars",
                    verdict,
                    numbers,
                    found["false"][:4],
                    why[:420],
                )
            yield name, verdict, found, seconds


def main(path, each=3, seed=1, *conditions):
    sky = Sky(path)
    centers = {name: [] for name in KINDS}
    with tempfile.TemporaryDirectory() as scratch:
        for number, condition in enumerate(CONDITIONS):
            if conditions and condition not in conditions:
                continue
            tally, chi, stars, times = {}, [], [], []
            for name, verdict, found, seconds in exam_of(condition, number, each, seed, sky, Path(scratch)):
                tally[verdict] = tally.get(verdict, 0) + 1
                times.append(seconds)
                if verdict == "solved":
                    chi.append(found["chi2"])
                    stars += found["stars"]
                    centers[name] += found["stars"]
            say(
                f"{condition:10s}", tally, f"attitude error/sigma {np.sqrt(np.mean(chi or [np.nan])):.2f};",
                f"centers {ratio(stars)} of {len(stars)}; time median {np.median(times):.1f}, most {max(times):.1f} s",
            )  # fmt: skip
    for name, values in centers.items():
        say(f"{name:10s} centers' error/sigma {ratio(values)} of {len(values)}")


def catalog_for(condition, sky, folder, picture, unknown):
    """Return the catalog that a picture is processed with: the whole sky, or what is known around it."""
    if condition not in WHOLE_SKY:
        away = np.arctan(3.0 * picture.kind.size / picture.kind.focal_px)
        around = sky.near(picture.camera_from_j2000[2] * picture.kind.look, away)
        return write_catalog(folder / "part.npz", sky, np.setdiff1d(around, unknown))
    whole = folder / "whole.npz"
    return f"npz:{whole}" if whole.exists() else write_catalog(whole, sky, slice(None))


def write_catalog(path, sky, rows):
    """Write stars as a catalog of our own, with their motion known to be nothing."""
    numbers = np.arange(len(sky.mag))[rows]
    np.savez(
        path, id=np.char.add("S", numbers.astype(str)), ra_deg=sky.ra[rows], dec_deg=sky.dec[rows], mag=sky.mag[rows],
        pmra_mas_yr=0.0, pmdec_mas_yr=0.0, parallax_mas=0.0, sigma_mas=SIGMA_MAS, epoch_jyear=EPOCH_JYEAR, band="VT",
    )  # fmt: skip
    return f"npz:{path}"


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(sys.argv[1], *(int(v) if v.isdigit() else v for v in sys.argv[2:]))
