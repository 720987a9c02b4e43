"""A bumpy ellipsoid as truth, drawn by marching along rays over an analytic surface: no plates, no maplets."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from opnav_workbench.render import ShapeModel


def noise_of_octaves(directions, octaves, falloff, seed):
    """Return smooth noise (n,) at unit vectors (n, 3): each octave half as wide and `falloff` times as high."""
    out, height = np.zeros(len(directions)), 1.0
    for octave in octaves:
        random = np.random.default_rng([seed, octave])
        grid = random.normal(size=(2**octave + 4,) * 3)
        at = (directions.T + 1.0) * 2.0 ** (octave - 1) + 1.5
        out += height * ndimage.map_coordinates(grid, at, order=3, mode="nearest", prefilter=False)
        height *= falloff
    return out


def grid_directions(rows):
    lat = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    lon = 2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows)
    c = np.cos(lat)[:, None]
    return np.stack(
        [c * np.cos(lon), c * np.sin(lon), np.broadcast_to(np.sin(lat)[:, None], (rows, 2 * rows))], -1
    )


@dataclass
class Bumpy:
    radii: np.ndarray
    heights: np.ndarray  # (rows, 2 rows), parts of the radius
    albedo: np.ndarray  # the like

    @classmethod
    def of(cls, radii, rows, *, octaves=range(2, 8), falloff=0.55, roughness=0.03, contrast=0.1, seed=1):
        directions = grid_directions(rows).reshape(-1, 3)
        bumps = noise_of_octaves(directions, octaves, falloff, seed).reshape(rows, 2 * rows)
        spots = noise_of_octaves(directions, octaves, 0.8, seed + 100).reshape(rows, 2 * rows)
        spots *= contrast / spots.std()
        return cls(np.asarray(radii, float), roughness * bumps / bumps.std(), 1.0 + np.clip(spots, -0.8, 2.0))

    def _sampled(self, plane, points):
        rows = plane.shape[0]
        r = np.sqrt((points**2).sum(0))
        y = (0.5 - np.arcsin(np.clip(points[2] / r, -1, 1)) / np.pi) * rows - 0.5
        x = np.arctan2(points[1], points[0]) % (2 * np.pi) / (2 * np.pi) * 2 * rows - 0.5
        if not hasattr(self, "_splines"):
            self._splines = {}
        if id(plane) not in self._splines:
            padded = np.pad(np.pad(plane, ((0, 0), (8, 8)), mode="wrap"), ((8, 8), (0, 0)), mode="edge")
            self._splines[id(plane)] = ndimage.spline_filter(padded, 3)
        return ndimage.map_coordinates(
            self._splines[id(plane)], [y + 8, x + 8], order=3, mode="nearest", prefilter=False
        )

    def radius(self, points):
        """Radius of the surface (n,) in the directions of points (3, n)."""
        u = points / np.sqrt((points**2).sum(0))
        round_ = 1.0 / np.sqrt(((u / self.radii[:, None]) ** 2).sum(0))
        return round_ * (1.0 + self._sampled(self.heights, points))

    def above(self, points):
        return np.sqrt((points**2).sum(0)) - self.radius(points)

    def normal(self, points):
        step = 2e-4 * self.radii.mean()
        gradient = np.stack(
            [
                self.above(points + step * e[:, None]) - self.above(points - step * e[:, None])
                for e in np.eye(3)
            ]
        )
        return gradient / np.sqrt((gradient**2).sum(0))

    def shape(self, rows, smooth=0.0):
        """The surface as plates, at the middles of `rows` rows of latitude, smoothed over `smooth` of the map's cells."""
        body = (
            self
            if smooth == 0.0
            else Bumpy(
                self.radii,
                ndimage.gaussian_filter(self.heights, smooth, mode=("nearest", "wrap")),
                self.albedo,
            )
        )
        ring = grid_directions(rows)
        vertices = ring * body.radius(ring.reshape(-1, 3).T).reshape(rows, -1, 1)
        poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        poles = poles * body.radius(poles.T + 1e-9)[:, None]
        n = 2 * rows
        i, j = (g.ravel() for g in np.meshgrid(np.arange(rows - 1), np.arange(n), indexing="ij"))
        a, b, c, d = i * n + j, i * n + (j + 1) % n, (i + 1) * n + (j + 1) % n, (i + 1) * n + j
        k = np.arange(n)
        plates = [
            np.stack([a, d, c], 1),
            np.stack([a, c, b], 1),
            np.stack([np.full(n, rows * n), k, (k + 1) % n], 1),
            np.stack([np.full(n, rows * n + 1), (rows - 1) * n + (k + 1) % n, (rows - 1) * n + k], 1),
        ]
        return ShapeModel(np.concatenate([vertices.reshape(-1, 3), poles]), np.concatenate(plates))

    def hits(self, origin, rays, step):
        """Where rays (3, n) of unit length from `origin` (3,) or (3, n) first meet the surface: distance, nan for none."""
        origin = np.broadcast_to(origin[:, None] if origin.ndim == 1 else origin, rays.shape)
        reach = self.radii.max() * (1.0 + 1.05 * self.heights.max())
        along = -(origin * rays).sum(0)
        inside = reach**2 - (origin**2).sum(0) + along**2
        half = np.sqrt(np.maximum(inside, 0.0))
        t, end = np.maximum(along - half, 0.0), along + half
        out = np.full(rays.shape[1], np.nan)
        open_ = np.flatnonzero((inside > 0.0) & (end > 0.0))
        while len(open_):
            height = self.above(origin[:, open_] + t[open_] * rays[:, open_])
            met = height < 0.0
            out[open_[met]] = t[open_[met]]
            # slopes up to 60 deg: a ray cannot meet the surface sooner
            t[open_] += np.maximum(0.45 * np.abs(height), step)
            open_ = open_[~met]
            open_ = open_[t[open_] < end[open_]]
        good = np.flatnonzero(np.isfinite(out))
        low, high = out[good] - 1.5 * step, out[good]
        low = np.maximum(low, 0.0)
        for _ in range(14):
            middle = 0.5 * (low + high)
            under = self.above(origin[:, good] + middle * rays[:, good]) < 0.0
            high, low = np.where(under, middle, high), np.where(under, low, middle)
        out[good] = high
        return out

    def draw(self, camera, camera_from_body, camera_km, sun, law, *, cells=3, psf_sigma=0.6, step=None):
        """I/F (n_line, n_pixel): `cells` rays a pixel each way, shadows, a Gaussian PSF. No aberration."""
        step = step or 1e-3 * self.radii.mean()
        line = (np.arange(camera.n_line * cells) + 0.5) / cells - 0.5
        pixel = (np.arange(camera.n_pixel * cells) + 0.5) / cells - 0.5
        x, y = np.meshgrid(pixel, line)
        rays = (camera.unproject(np.stack([x.ravel(), y.ravel()], -1)) @ camera_from_body).T
        far = self.hits(camera_km, rays, step)
        seen = np.flatnonzero(np.isfinite(far))
        points = camera_km[:, None] + far[seen] * rays[:, seen]
        normal = self.normal(points)
        cos_i, cos_e = (normal * sun[:, None]).sum(0), -(normal * rays[:, seen]).sum(0)
        phase = np.arccos(np.clip(-(sun[:, None] * rays[:, seen]).sum(0), -1, 1))
        light = law.reflectance(cos_i, cos_e, phase) * self._sampled(self.albedo, points)
        lit = np.flatnonzero(light > 0.0)
        # Bisection found the places to 1e-4 of a step: lifted any higher, shadows would end too near to what throws them.
        start = points[:, lit] + 0.02 * step * normal[:, lit]
        dark = np.isfinite(self.hits(start, np.broadcast_to(sun[:, None], start.shape), step))
        light[lit[dark]] = 0.0
        picture = np.zeros(x.size)
        picture[seen] = light
        picture = ndimage.gaussian_filter(picture.reshape(x.shape), psf_sigma * cells, truncate=5.0)
        return picture.reshape(camera.n_line, cells, camera.n_pixel, cells).mean(axis=(1, 3))
