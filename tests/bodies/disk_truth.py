"""Pictures of disks whose truth is known, drawn without the package's renderer: `make_trial` of a `TrialSetup`.

An ellipsoid is sampled in cells of 1/2 to 1/8 px, those on its limb in 36 finer ones; every ray comes from the camera's
own `unproject` with aberration removed, so that distortion and perspective are exact. A Gaussian core is applied to the
cells and wings (a Moffat profile) to pixels. The picture tells the navigator what it would believe in flight: Lambert, a
figure, a PSF and a predicted center, each of which may be wrong.

Frame  J2000; (pixel, line) on the detector
Units  DN, px, km
"""

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from disk_surfaces import LAWS, make_surface
from scipy.ndimage import gaussian_filter1d
from scipy.signal import fftconvolve

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import geometric_direction, rotation_from_vector, unit
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf
from opnav_workbench.render import BodyModel
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

SUN_AU, RADIUS_KM = 33.0, 1188.3
READ_NOISE_DN, GAIN_E_PER_DN = 3.0, 22.0
ATTITUDE = rotation_from_vector(np.array([0.4, -1.1, 0.7]))
VELOCITY_KM_S = np.array([3.0, -12.0, 6.0])
WING_FWHM_PX, WING_BETA, WING_REACH_PX = 4.0, 2.0, 15
SUBCELLS = 6  # across a cell on the limb
BLOCK_CELLS = 60_000
GRAZING = 1e-3  # least cosine of emission
NAME = "BODY"


@dataclass(frozen=True)
class TrialSetup:
    """What a trial shows, and in what the navigator is wrong.

    `axes` are the believed semi-axes over their mean size; the true ones are larger by `figure_error` times
    `figure_pattern`, one number an axis. `psf` is one of ``known``, ``known_wings``, ``width`` (the picture's PSF is 10 to
    20 % off) and ``wings`` (3 to 10 % of the light in wings of which the picture does not know). `place_px` is the center's,
    None: anywhere with most of the disk in the frame. `peak_dn` is the brightness of the brightest twentieth.
    """

    seed: int
    diameter_px: float
    phase_deg: float
    family: str = "uniform"
    contrast: float = 1.0
    law: str = "lambert"
    axes: tuple[float, float, float] = (1.0, 1.0, 1.0)
    figure_error: float = 0.0
    figure_pattern: tuple[float, float, float] = (1.0, 1.0, 1.0)
    displacement_px: float = 0.0
    psf: str = "known"
    peak_dn: float = 1000.0
    place_px: tuple[float, float] | None = None
    topography: float = 0.0
    cosmic_rays: int = 0
    saturation_dn: float = np.inf


@dataclass(frozen=True)
class Trial:
    """A picture and what it really shows.

    `limb_snr` is the median signal over noise of pixels 1 to 2.5 px inside the lit limb (nan: none in the frame),
    `limb_share` the share of the lit limb that the frame shows. `body`, `core_px` and `wing_share` are what the light
    was drawn with, `scale_dn` what it was multiplied by.
    """

    setup: TrialSetup
    picture: BodyPicture
    name: str
    truth_px: np.ndarray
    limb_snr: float
    limb_share: float
    light_dn: np.ndarray
    body: "TrueBody"
    core_px: float
    wing_share: float
    scale_dn: float


@cache
def lorri():
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def data_folder():
    """Return the folder of flight data, or None."""
    named = os.environ.get("OPNAV_DATA")
    folder = Path(named) if named else Path(__file__).parents[3] / "shared" / "data"
    return folder if (folder / "maps").is_dir() else None


def make_trial(setup):
    """Return the trial of a setup; the same setup gives the same picture, bit by bit."""
    placing, surfaces, noises, optics = (np.random.default_rng([setup.seed, i]) for i in range(4))
    camera = lorri()
    truth = np.array(setup.place_px or _place(setup.diameter_px, placing), dtype=float)
    believed = _place_near(truth, setup.displacement_px, camera, placing)
    body_from_j2000 = rotation_from_vector(placing.normal(size=3))
    sun = _sun(camera, truth, setup.phase_deg, placing)
    distance = 2.0 * RADIUS_KM / (setup.diameter_px * camera.pixel_scale_rad)
    axes_km = RADIUS_KM * np.array(setup.axes)
    true_axes = axes_km * (1.0 + setup.figure_error * np.array(setup.figure_pattern))
    core, share, psf = _optics(setup.psf, optics)
    body = TrueBody(
        toward_place(camera, truth) * distance,
        true_axes,
        body_from_j2000,
        sun,
        LAWS[setup.law],
        make_surface(setup.family, setup.contrast, setup.diameter_px, surfaces, data_folder()),
        _topography(setup.topography, surfaces),
        np.radians(setup.phase_deg),
    )
    light, ring, lit = draw_light(body, camera, truth, setup.diameter_px, core, share)
    scale = setup.peak_dn / _bright(light, lit)
    light *= scale
    data, saturated = exposed(light, setup, noises)
    target = TargetState(
        NAME,
        toward_place(camera, believed) * distance,
        radii_km=axes_km,
        body_from_j2000=body_from_j2000,
        sun_position_km=sun * SUN_AU * AU_KM,
    )
    picture = BodyPicture(
        data, READ_NOISE_DN, False, saturated, camera, ATTITUDE, VELOCITY_KM_S, (BodyModel(target),), psf, None,
        NoiseModel(READ_NOISE_DN, GAIN_E_PER_DN), stars_px=np.empty((0, 2)),
    )  # fmt: skip
    in_ring = light[ring]
    snr = float(np.median(in_ring / noise_dn(in_ring))) if in_ring.size else np.nan
    return Trial(
        setup, picture, NAME, truth, snr, body.lit_limb_share(camera), light, body, core, share, scale
    )


# ---- Where it stands, and its optics.


def _place(diameter_px, rng):
    margin = min(0.5 * diameter_px + 8.0, 400.0)
    return rng.uniform(margin, 1023.0 - margin, 2)


def _place_near(truth, distance_px, camera, rng):
    """A place at a distance, inside the frame where some direction allows it."""
    for _ in range(40):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        place = truth + distance_px * np.array([np.cos(angle), np.sin(angle)])
        if camera.on_detector(place):
            return place
    return place


def toward_place(camera, place):
    return geometric_direction(camera.unproject(np.array([place]))[0] @ ATTITUDE, VELOCITY_KM_S)


def _sun(camera, truth, phase_deg, rng):
    """Unit vector from the body to the Sun, at a random position angle."""
    toward, phase = toward_place(camera, truth), np.radians(phase_deg)
    side = unit(np.cross(toward, rng.normal(size=3)))
    return -toward * np.cos(phase) + side * np.sin(phase)


def _optics(case, rng):
    """True sigma of the core, true share of the wings, and the PSF that the picture believes in."""
    core, width, share = rng.uniform(0.7, 1.0), rng.uniform(0.1, 0.2), rng.uniform(0.03, 0.10)
    wider = rng.random() < 0.5
    if case == "known":
        return core, 0.0, GaussianPsf(core, core)
    if case == "width":
        believed = core * (1.0 + width if wider else 1.0 - width)
        return core, 0.0, GaussianPsf(believed, believed)
    if case == "wings":
        return core, share, GaussianPsf(core, core)
    return core, share, EmpiricalPsf(_template(core, share), 4)


def _wings(step_px):
    """Shares of the Moffat wings in cells, sampled at their centers."""
    n = round(WING_REACH_PX / step_px)
    at = np.arange(-n, n + 1) * step_px
    scale = WING_FWHM_PX / (2.0 * np.sqrt(2.0 ** (1.0 / WING_BETA) - 1.0))
    wings = (1.0 + (at[:, None] ** 2 + at**2) / scale**2) ** -WING_BETA
    return wings / wings.sum()


def _template(core, share):
    wings = _wings(0.25)
    n = len(wings) // 2
    gauss = np.exp(-0.5 * (np.arange(-n, n + 1) * 0.25 / core) ** 2)
    core_cells = np.outer(gauss, gauss)
    return (1.0 - share) * core_cells / core_cells.sum() + share * wings


# ---- The body's light.


def _topography(rms, rng):
    """The limb's height over the radius at even steps of its angle, a Fourier series from m = 2 on; None for none."""
    if rms == 0.0:
        return None
    m = np.arange(2, 41)
    amplitudes = rng.normal(size=(2, len(m))) * m**-1.2
    waves = np.linspace(-np.pi, np.pi, 2048)[:, None] * m
    height = np.cos(waves) @ amplitudes[0] + np.sin(waves) @ amplitudes[1]
    return rms * height / np.sqrt(0.5 * np.sum(amplitudes**2))


@dataclass(frozen=True)
class TrueBody:
    """A lit ellipsoid; `position_km` from the spacecraft, `sun` a unit vector, both J2000."""

    position_km: np.ndarray
    axes_km: np.ndarray
    body_from_j2000: np.ndarray
    sun: np.ndarray
    law: object
    surface: object
    topography: np.ndarray | None
    phase_rad: float

    def rays(self, camera, points):
        """Rays (..., 3) of points in the body's frame, and where each passes nearest to the center, its axes taken for 1.

        The point of nearest approach keeps its digits at any distance, as the quadratic's own terms do not.
        """
        apparent = camera.unproject(points) @ ATTITUDE
        ray = geometric_direction(apparent, VELOCITY_KM_S) @ self.body_from_j2000.T
        u, origin = ray / self.axes_km, -(self.body_from_j2000 @ self.position_km) / self.axes_km
        along = (u @ origin) / np.sum(u * u, axis=-1)
        return ray, origin - along[..., None] * u

    def shine(self, ray, nearest):
        """Brightness (n,) along rays that meet the body, and the cosine of incidence on the smooth ellipsoid."""
        u = ray / self.axes_km
        depth = np.sqrt(np.maximum(1.0 - np.sum(nearest**2, axis=-1), 0.0) / np.sum(u * u, axis=-1))
        q = nearest - depth[:, None] * u
        normal = unit(q / self.axes_km)
        sun = self.body_from_j2000 @ self.sun
        smooth = normal @ sun
        light = np.zeros(len(q))
        near = smooth > -0.7  # a slope may turn toward the Sun a little beyond the terminator
        q, normal, ray = q[near], normal[near], ray[near]
        slope = self.surface.slope(q)
        if slope is not None:
            slope = slope - np.sum(slope * normal, axis=-1)[:, None] * normal
            normal = unit(normal - slope)
            shadow = smooth[near] > 0.0  # what lies behind the ball's own terminator is in its shadow
        else:
            shadow = True
        # What a slope hides is hidden by ground that is lit as well: such places are seen at a grazing angle.
        mu0, mu = normal @ sun, np.maximum(-np.sum(normal * ray, axis=-1), GRAZING)
        lit = (mu0 > 0.0) & shadow
        values = np.zeros(len(q))
        values[lit] = self.surface.albedo(q[lit]) * self.law(mu0[lit], mu[lit], self.phase_rad)
        light[near] = values
        return light, smooth

    def raised(self, nearest):
        """Points of nearest approach with the limb's relief taken out: a radius 1 + h is as one of 1."""
        if self.topography is None:
            return nearest
        across = np.linalg.svd((self.body_from_j2000 @ self.position_km / self.axes_km)[:, None])[0]
        angle = np.arctan2(nearest @ across[:, 2], nearest @ across[:, 1])
        height = np.interp(angle, np.linspace(-np.pi, np.pi, len(self.topography)), self.topography)
        return nearest / (1.0 + height)[..., None]

    def lit_limb_share(self, camera):
        """Share of the lit limb's length that falls on the detector, by the camera's own projection."""
        center = -(self.body_from_j2000 @ self.position_km) / self.axes_km
        distance = np.linalg.norm(center)
        side = np.linalg.svd(center[:, None])[0][:, 1:]
        angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
        ring = np.cos(angle)[:, None] * side[:, 0] + np.sin(angle)[:, None] * side[:, 1]
        q = ring * np.sqrt(1.0 - distance**-2) + center / distance**2
        lit = (unit(q / self.axes_km) @ (self.body_from_j2000 @ self.sun)) > 0.0
        # Aberration moves the whole limb as one, far less than a share of it.
        apparent = (q * self.axes_km) @ self.body_from_j2000 + self.position_km
        apparent = unit(apparent) + VELOCITY_KM_S / 299792.458
        seen = camera.on_detector(camera.project(apparent @ ATTITUDE.T))
        return float(np.mean(seen[lit])) if lit.any() else 0.0


class Ground:
    """Rays over a window, as polynomials in (pixel, line) fitted to the camera's: exact to 1e-8 px, and fast on grids."""

    DEGREE, NODES = 5, 12

    def __init__(self, body, camera, first, size):
        self.middle, self.half = first + 0.5 * size, 0.5 * size
        nodes = np.cos(np.pi * (np.arange(self.NODES) + 0.5) / self.NODES)
        x, y = (self.middle[i] + self.half[i] * nodes for i in (0, 1))
        ray, nearest = body.rays(camera, np.stack(np.meshgrid(x, y), axis=-1))
        values = np.concatenate([ray, nearest], axis=-1)
        inverse = np.linalg.pinv(np.polynomial.chebyshev.chebvander(nodes, self.DEGREE))
        self.coefficients = np.einsum("li,ijc,pj->lpc", inverse, values, inverse)

    def __call__(self, x, y):
        """Rays and points of nearest approach, (len(y), len(x), 3) each."""
        along_x, along_y = (
            np.polynomial.chebyshev.chebvander((at - self.middle[i]) / self.half[i], self.DEGREE)
            for i, at in enumerate((x, y))
        )
        values = np.tensordot(along_y, np.tensordot(along_x, self.coefficients, (1, 1)), (1, 1))
        return values[..., :3], values[..., 3:]


def _cells_per_px(diameter_px):
    return 8 if diameter_px < 25.0 else 4 if diameter_px < 100.0 else 3 if diameter_px < 250.0 else 2


def draw_light(body, camera, truth, diameter_px, core, share):
    """Light of the frame, any unit; the pixels just inside the lit limb; and the lit ones (on the smooth ellipsoid)."""
    radius = 0.5 * diameter_px * body.axes_km.max() / RADIUS_KM * (1.0 if body.topography is None else 1.1)
    reach = radius + WING_REACH_PX + 3.0
    edge = WING_REACH_PX + 3  # light from beyond the frame's edge comes in
    first = np.floor(np.maximum(truth - reach, -edge)).astype(int)
    last = np.ceil(np.minimum(truth + reach, np.array([camera.n_pixel, camera.n_line]) - 1 + edge)).astype(
        int
    )
    size = np.maximum(last - first + 1, 1)
    ground, m = Ground(body, camera, first - 0.5, size), _cells_per_px(diameter_px)
    cells = _cell_light(body, ground, first, size, m, 0.5 * diameter_px * body.axes_km.min() / RADIUS_KM)
    for axis in (0, 1):
        cells = gaussian_filter1d(cells, core * m, axis=axis, mode="constant", truncate=6.0)
    pixels = cells.reshape(size[1], m, size[0], m).mean(axis=(1, 3))
    if share:
        pixels = (1.0 - share) * pixels + share * fftconvolve(pixels, _wings(1.0), mode="same")
    frame = np.zeros((camera.n_line, camera.n_pixel))
    ring, lit = np.zeros_like(frame, dtype=bool), np.zeros_like(frame, dtype=bool)
    low, high = np.maximum(first, 0), np.minimum(last + 1, [camera.n_pixel, camera.n_line])
    if (low < high).all():
        inside = (slice(low[1], high[1]), slice(low[0], high[0]))
        cut = (slice(low[1] - first[1], high[1] - first[1]), slice(low[0] - first[0], high[0] - first[0]))
        frame[inside] = pixels[cut]
        ring[inside], lit[inside] = _lit_limb(
            body, ground, np.arange(low[0], high[0]), np.arange(low[1], high[1]), 0.5 * diameter_px
        )
    return frame, ring, lit


def _cell_light(body, ground, first, size, m, least_radius_px):
    """Mean brightness of cells of 1/m px over the window; cells on the limb from their subcells."""
    x, y = (first[i] - 0.5 + (np.arange(size[i] * m) + 0.5) / m for i in (0, 1))
    light = np.zeros((len(y), len(x)))
    rows = max(BLOCK_CELLS // len(x), 1)
    offset = ((np.arange(SUBCELLS) + 0.5) / SUBCELLS - 0.5) / m
    dx, dy = (grid.ravel()[:, None] for grid in np.meshgrid(offset, offset))
    band = 1.2 / m / least_radius_px
    for start in range(0, len(y), rows):
        part = y[start : start + rows]
        ray, nearest = ground(x, part)
        raised = body.raised(nearest)
        r = np.sqrt(np.sum(raised**2, axis=-1))
        on_limb = np.abs(r - 1.0) < band
        whole = (r < 1.0) & ~on_limb
        block = light[start : start + rows]
        block[whole] = body.shine(ray[whole], raised[whole])[0]
        if on_limb.any():
            along_x = (ground(x + 0.5, part)[1] - ground(x - 0.5, part)[1])[on_limb]
            along_y = (ground(x, part + 0.5)[1] - ground(x, part - 0.5)[1])[on_limb]
            fine = nearest[on_limb][:, None] + dx * along_x[:, None] + dy * along_y[:, None]
            fine = body.raised(fine)
            hit = np.sum(fine**2, axis=-1) < 1.0
            rays = np.broadcast_to(ray[on_limb][:, None], fine.shape)
            values = np.zeros(hit.shape)
            values[hit] = body.shine(rays[hit], fine[hit])[0]
            block[on_limb] = values.mean(axis=1)
    return light


def _lit_limb(body, ground, x, y, radius_px):
    """Pixels 1 to 2.5 px (0.5 to 2 px of the smallest) inside the lit limb, and all that are lit."""
    ray, nearest = ground(x, y)
    r = np.sqrt(np.sum(body.raised(nearest) ** 2, axis=-1))
    lit = r < 1.0
    lit[lit] = body.shine(ray[lit], nearest[lit])[1] > 0.0
    depth = (1.0 - r) * radius_px
    low, high = (1.0, 2.5) if radius_px > 4.0 else (0.5, 2.0)
    return lit & (depth > low) & (depth < high), lit


def _bright(light, lit):
    values = light[lit] if lit.any() else light[light > 0.1 * light.max()]
    return max(float(np.percentile(values, 95.0)) if values.size else 1.0, 1e-30)


# ---- What the detector makes of it.


def noise_dn(signal_dn):
    return np.sqrt(READ_NOISE_DN**2 + np.maximum(signal_dn, 0.0) / GAIN_E_PER_DN)


def exposed(light_dn, setup, rng):
    """The picture with shot noise, read noise, what is left of the background and cosmic rays; and its saturated pixels."""
    data = light_dn.copy()
    lit = data > 0.0
    data[lit] = rng.poisson(data[lit] * GAIN_E_PER_DN) / GAIN_E_PER_DN
    data += READ_NOISE_DN * rng.standard_normal(data.shape) + 0.1 * READ_NOISE_DN * rng.standard_normal()
    for _ in range(setup.cosmic_rays):
        start, angle = rng.uniform(0.0, 1023.0, 2), rng.uniform(0.0, 2.0 * np.pi)
        steps = np.arange(0.0, rng.exponential(4.0), 0.7)
        at = np.rint(start + steps[:, None] * [np.cos(angle), np.sin(angle)]).astype(int).clip(0, 1023)
        data[at[:, 1], at[:, 0]] += rng.exponential(800.0)
    saturated = data >= setup.saturation_dn
    return np.minimum(data, setup.saturation_dn), saturated
