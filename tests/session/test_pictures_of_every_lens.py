"""A camera file of every lens model: its pictures, drawn by the model's published formulas written anew, are solved.

Nothing of the package draws them: places of stars by OpenCV's fisheye and lens formulas, by JPL's CAHVORE (with its moving
pupil), by ISIS' radial model, by Owen's terms and by SIP polynomials; light as a Gaussian.
"""

import numpy as np
import pytest
import yaml
from astropy.io import fits
from scipy.spatial.transform import Rotation

from opnav_workbench.camera import Camera
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.geometry import quaternion_from_matrix, vector_from_rotation
from opnav_workbench.session import ImageSession

SIZE, FOCAL_PX, FOCAL_MM = 400, 420.0, 4.2
CENTER = np.array([197.3, 204.6])
SIGMA_PX, NOISE_DN = 1.2, 3.0
VELOCITY_KM_S = np.array([-5.9, 29.2, 0.1])


def by_focal_lengths(moved):
    return FOCAL_PX * moved + CENTER


def fisheye(directions, k):
    """OpenCV, module fisheye: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)."""
    a, b = directions[:, 0] / directions[:, 2], directions[:, 1] / directions[:, 2]
    r = np.hypot(a, b)
    theta = np.arctan(r)
    bent = theta * (1.0 + sum(c * theta ** (2 * n + 2) for n, c in enumerate(k)))
    return by_focal_lengths((bent / r)[:, None] * np.stack([a, b], axis=1))


def brown(directions, k1, k2, p1, p2):
    """OpenCV, calib3d."""
    x, y = directions[:, 0] / directions[:, 2], directions[:, 1] / directions[:, 2]
    r2 = x * x + y * y
    factor = 1.0 + k1 * r2 + k2 * r2 * r2
    u = x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return by_focal_lengths(np.stack([u, v], axis=1))


def isis(directions, k):
    """ISIS, CameraDistortionMap: the ideal radius is r (1 - k0 - k1 r^2 - k2 r^4), r mm as measured; r by bisection."""
    ideal = FOCAL_MM * directions[:, :2] / directions[:, 2:]
    wanted = np.hypot(*ideal.T)
    low, high = np.zeros_like(wanted), np.full_like(wanted, 10.0)
    for _ in range(60):
        r = 0.5 * (low + high)
        short = r * (1.0 - k[0] - k[1] * r**2 - k[2] * r**4) < wanted
        low, high = np.where(short, r, low), np.where(short, high, r)
    return by_focal_lengths(ideal * (r / wanted)[:, None] / FOCAL_MM)


def owen(directions, e):
    """Owen (2011): radial terms of r^2, r^4, y, x, tangential ones of r, r^3, of the gnomonic place in mm."""
    x, y = (FOCAL_MM * directions[:, :2] / directions[:, 2:]).T
    r = np.hypot(x, y)
    along = e[1] * r**2 + e[3] * r**4 + e[4] * y + e[5] * x
    across = e[0] * r + e[2] * r**3
    return by_focal_lengths(
        np.stack([x + x * along - y * across, y + y * along + x * across], axis=1) / FOCAL_MM
    )


def sip(directions, a, b):
    """Shupe et al. (2005), the way from the sky: u = U + sum AP U^p V^q."""
    across, down = (FOCAL_PX * directions[:, :2] / directions[:, 2:]).T
    moved = [sum(c * across**p * down**q for (p, q), c in terms.items()) for terms in (a, b)]
    return np.stack([across + moved[0], down + moved[1]], axis=1) + CENTER


TURN = np.deg2rad(8.0)
FOCAL_AXES = np.array(
    [[np.cos(TURN), 0.0, -np.sin(TURN)], [0.0, 1.0, 0.0], [np.sin(TURN), 0.0, np.cos(TURN)]]
)
A = FOCAL_AXES[2]
H, V = (
    FOCAL_PX * FOCAL_AXES[0] + CENTER[0] * A,
    1.004 * FOCAL_PX * FOCAL_AXES[1] + 2.0 * FOCAL_AXES[0] + CENTER[1] * A,
)
LENS_AXIS = A + np.array([0.004, -0.006, 0.0])
LENS_AXIS /= np.linalg.norm(LENS_AXIS)
R = (2e-4, -0.12, 0.03)


def cahvore(directions, linearity, e=(1e-3, 2e-3, 1e-4)):
    """JPL's cmod_cahvore_3d_to_2d of points 10^9 pupils away: theta by Newton's method, then O and R, then H and V."""
    places = []
    for point in 1e6 * directions:
        omega = point @ LENS_AXIS
        lambda3 = point - omega * LENS_AXIS
        far = np.linalg.norm(lambda3)
        theta = np.arctan2(far, omega)
        for _ in range(20):
            pupil = e[0] + e[1] * theta**2 + e[2] * theta**4
            slope = 2.0 * e[1] * theta + 4.0 * e[2] * theta**3
            cos, sin = np.cos(theta), np.sin(theta)
            upsilon = omega * cos + far * sin - (1.0 - cos) * pupil - (theta - sin) * slope
            theta -= (omega * sin - far * cos - (theta - sin) * pupil) / upsilon
        bent = linearity * theta
        chi = theta if linearity == 0.0 else (np.sin(bent) if linearity < 0.0 else np.tan(bent)) / linearity
        ray = far / chi * LENS_AXIS + (1.0 + R[0] + R[1] * chi**2 + R[2] * chi**4) * lambda3
        places.append([ray @ H / (ray @ A), ray @ V / (ray @ A)])
    return np.array(places)


K, E = (-0.03, 0.008, -0.002, 4e-4), (1e-3, -8e-3, 2e-4, 1e-4, 2e-3, -1e-3)
BROWN, ISIS = {"k1": -0.2, "k2": 0.06, "p1": 4e-4, "p2": -3e-4}, (1e-3, -8e-3, 1e-4)
AP, BP = {(2, 0): 3e-5, (1, 1): -2e-5, (3, 0): -8e-7}, {(0, 2): -3e-5, (2, 1): -8e-7}
LENSES = {
    "fisheye": ({f"k{n + 1}": k for n, k in enumerate(K)}, lambda d: fisheye(d, K)),
    "brown": (BROWN, lambda d: brown(d, **BROWN)),
    "radial": (dict(zip(("k0", "k1_per_mm2", "k2_per_mm4"), ISIS, strict=True)), lambda d: isis(d, ISIS)),
    "owen": (
        dict(zip((f"e{n}_per_mm{'' if n in (1, 5, 6) else n}" for n in range(1, 7)), E, strict=True)),
        lambda d: owen(d, E),
    ),
    "sip": ({k: {f"{p}_{q}": c for (p, q), c in t.items()} for k, t in (("ap", AP), ("bp", BP))}, lambda d: sip(d, AP, BP)),
    "cahvor": (1.0, lambda d: cahvore(d, 1.0)),
    "cahvore, fisheye": (0.0, lambda d: cahvore(d, 0.0)),
    "cahvore, general": (-0.6, lambda d: cahvore(d, -0.6)),
}  # fmt: skip


def written_camera(folder, name):
    """The camera file as a person writes it, or as a camera of the vectors saves itself."""
    terms, _ = LENSES[name]
    path = folder / "camera.yaml"
    names = {"name": "LENS", "frame": "GENERIC_CUBESAT_CAMERA", "instrument_id": -999200}
    if name.startswith("cahvor"):
        Camera.from_cahvor(
            A, H, V, LENS_AXIS, R, linearity=terms, n_pixel=SIZE, n_line=SIZE, **names
        ).to_yaml(path)
        whole = yaml.safe_load(path.read_text())
    else:
        per_mm = FOCAL_PX / FOCAL_MM
        optics = {"focal_length_mm": FOCAL_MM, "pixel_from_mm": [[per_mm, 0.0], [0.0, per_mm]]}
        optics |= {"focal_from_camera": np.eye(3).tolist(), "distortion": {"model": name, **terms}}
        detector = {"n_pixel": SIZE, "n_line": SIZE, "center_pixel_line": CENTER.tolist()}
        whole = {**names, "source": "this test", "optics": optics, "detector": detector}
    whole["detector"] |= {"read_noise_dn": NOISE_DN, "gain_e_per_dn": 1e3, "saturation_dn": 1e5}
    whole |= {
        "psf": {"sigma_px": SIGMA_PX, "sigma_sigma_px": 0.1},
        "attitude_sigma": {"cross_px": 8.0, "twist_deg": 0.2},
    }
    path.write_text(yaml.safe_dump(whole))
    words = {f"quat{n}": f"QUAT{n}" for n in range(4)}
    axes = "XYZ"
    mission = {
        "name": "lens", "spacecraft": {"name": "LENS", "id": -999}, "clock_id": -999, "bus_frame": "GENERIC_SPACECRAFT",
        "reference_body": "SUN", "cameras": [{"file": "camera.yaml"}],
        "keywords": {
            "exposure_s": "EXPTIME", "utc": "DATE-AVG", "quaternion": list(words.values()),
            "quaternion_sense": "j2000_to_camera", "sun_position": [f"SUNPOS{x}" for x in axes],
            "sun_velocity": [f"SUNVEL{x}" for x in axes],
        },
    }  # fmt: skip
    (folder / "mission.yaml").write_text(yaml.safe_dump(mission))
    return folder / "mission.yaml"


@pytest.mark.slow(keep=["fisheye", "cahvore, general"])
@pytest.mark.parametrize("name", LENSES)
def test_a_picture_by_the_published_formulas_is_solved(tmp_path, name):
    rng = np.random.default_rng(24)
    boresight = A if name.startswith("cahvor") else np.array([0.0, 0.0, 1.0])
    directions = boresight + rng.uniform(-0.55, 0.55, (90, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    places = LENSES[name][1](directions)
    seen = (np.abs(places - 0.5 * SIZE) < 0.5 * SIZE - 8).all(axis=1)
    directions, places = directions[seen], places[seen]
    assert len(places) > 25
    corner = np.argmax(np.hypot(*(places - CENTER).T))
    across = boresight @ directions[corner]
    assert (
        abs(np.hypot(*(places[corner] - CENTER)) - FOCAL_PX * np.sqrt(1.0 / across**2 - 1.0)) > 1.0
    )  # px: it is bent

    true = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    true *= np.linalg.det(true)
    sky = directions @ true - VELOCITY_KM_S / SPEED_OF_LIGHT_KM_S  # without aberration, to 1e-8 rad
    mag = rng.uniform(3.0, 5.5, len(sky))
    np.savez(
        tmp_path / "stars.npz", mag=mag, ra_deg=np.degrees(np.arctan2(sky[:, 1], sky[:, 0])) % 360.0,
        dec_deg=np.degrees(np.arctan2(sky[:, 2], np.hypot(sky[:, 0], sky[:, 1]))), epoch_jyear=2030.0,
    )  # fmt: skip
    line, pixel = np.mgrid[:SIZE, :SIZE]
    image = rng.normal(50.0, NOISE_DN, (SIZE, SIZE))
    for (x, y), m in zip(places, mag, strict=True):
        image += (
            2e4
            * 10.0 ** (-0.4 * (m - 3.0))
            / (2.0 * np.pi * SIGMA_PX**2)
            * np.exp(-0.5 * ((pixel - x) ** 2 + (line - y) ** 2) / SIGMA_PX**2)
        )
    a_priori = Rotation.from_rotvec([2.0 / FOCAL_PX, -3.0 / FOCAL_PX, 2e-3]).as_matrix() @ true
    hdu = fits.PrimaryHDU(image.astype(np.float32))
    hdu.header.update({"EXPTIME": 1.0, "DATE-AVG": "2030-01-01T00:00:00"})
    hdu.header.update({f"QUAT{n}": q for n, q in enumerate(quaternion_from_matrix(a_priori))})
    for x, place, velocity in zip("XYZ", (1.47e8, 2.6e7, 0.0), VELOCITY_KM_S, strict=True):
        hdu.header.update({f"SUNPOS{x}": -place, f"SUNVEL{x}": -velocity})
    hdu.writeto(tmp_path / "picture.fit")

    session = ImageSession.open(
        tmp_path / "picture.fit",
        written_camera(tmp_path, name),
        catalog=f"npz:{tmp_path / 'stars.npz'}",
    )
    session.predict()
    session.find_stars()
    session.repoint()
    pointing = session.state.pointing
    error = vector_from_rotation(pointing.camera_from_j2000 @ true.T)
    assert error @ np.linalg.solve(pointing.covariance_rad2, error) < 25.0
    assert np.abs(error).max() * FOCAL_PX < 0.02
    assert pointing.rms_px < 0.1
