"""The light of a disk about its limb, in tables of angle about the center and depth from the limb.

Flow   body, outline, PSF -> radiance along rays from the center -> spread by the PSF, curved as the limb is -> tables ->
       light and its derivatives at any pixel, wherever the outline lies
Frame  depth positive outward, px; angles from +pixel toward +line
Units  relative brightness; derivatives per px of depth, per rad, per unit of each share

A limb is straight compared with the PSF, or nearly: across it the picture is that of one dimension, and tables of one
dimension for some directions replace the rendering of the whole disk. The curvature enters through the spread function:
a cell of the PSF at t along the limb sees the surface t^2 / 2R deeper than one that lies on the ray. Disks that are not
much wider than the PSF are spread in two dimensions instead, and tabulated then.

Law     A mixture of Lambert's law and Lommel-Seeliger's, which is Lambert's times 2 / (mu0 + mu), is what is fitted to the
        laws of surfaces (McEwen 1991, doi:10.1016/0019-1035(91)90053-V); Minnaert's has powers of mu0 and mu. Another
        share in the mixture, and a power of mu0 mu, make up for a law that the body does not have.
Albedo  Hat functions of the arc b from the limb, cos b = r / r_limb: what lies at the limb is foreshortened, and the
        albedo of a body varies over arcs of its surface, not over pixels. Of disks not much wider than the PSF, modes of
        all that is in sight.
Wings   What a PSF may have beside what is known of it: `opnav_workbench.bodies.disk.stray_light`.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies.disk.limb_cells import SquareCorners, between_pieces
from opnav_workbench.bodies.disk.stray_light import stray_light
from opnav_workbench.bodies.picture import BodyPicture, RayFan, displaced_model, pixel_rays
from opnav_workbench.bodies.silhouette import TURN, Outline
from opnav_workbench.bodies.strained import STRAINS, strain_axes, strain_matrix
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel, Lambert, LommelSeeliger, LunarLambert, Minnaert, ScatteringLaw
from opnav_workbench.render.body import PlacedBody

__all__ = [
    "PLANES",
    "LightParts",
    "LimbLight",
    "Patches",
    "cell_means",
    "limb_light",
    "own_law",
    "psf_variance",
]

PLANES = (
    "light", "blur", "wings", "halo",
    "law", "law_2", "strain_cos", "strain_sin", "strain_zz", "strain_xz", "strain_yz",
    "relief",
)  # fmt: skip
LINEAR = len(PLANES) - PLANES.index("law")  # planes that are light of their own
SLOPES = ("by_depth", "by_angle", "by_variance")

# Steps in depth, and directions: at least, at most, and how far apart on the limb. Near the cusps light changes fast with
# both: with the coarse tables a center is good to a few tenths of a pixel, with the fine ones to 0.03.
COARSE, FINE = (0.25, 96, 160, 2.0), (0.125, 160, 400, 1.0)
# Of phase: beyond, the terminator lies near the limb, and coarse depths draw a center along.
CRESCENT_RAD = 0.5 * np.pi
SPREADS = 24  # directions in which the spread function is taken
PLANE_RADIUS_PX = (15.0, 25.0)  # smaller disks are spread in two dimensions, coarse and fine
PLANE_STEPS = 2  # of depth: the grid's
GRAZE = 1e-6  # of the radius: no ray is taken nearer to the limb
RIM_NODES = 3  # depths in a cell whose mean light it has
# Between depths that light is asked for, in roots of steps, in which it is smooth: of plates and maps, and of others.
ROOT_STEP = (0.05, 0.15)
KEPT_SHARE = 1e-5  # of the PSF's peak: what lies farther out is cut off
DARKEST = 0.002  # of mu0 and mu: factors of the law are bounded there, where a limb is narrower than any step
OTHER_SHARE = 0.5  # of Lommel-Seeliger in a law of another kind
GRAZING = 0.1  # least cosine to the line of sight, for the point that a ray meets under a strain
COSINE_STEP = 1e-3
# In squares of a step: how much wider light becomes that fills a cell, is looked up linearly in depth, or is given to the
# cells as a cubic spline. The tables are made sharper by as much.
CELL_VARIANCE, LINEAR_VARIANCE, SPLINE_VARIANCE = 1.0 / 12.0, 1.0 / 6.0, 1.0 / 3.0
RELIEF = 0.2  # sine of the slopes that terrain has
MOST_SHARPENED = 4.0  # logarithm, of a spectrum


class LightParts(Protocol):
    """k functions on the surface in sight: the albedo is a sum of them."""

    @property
    def count(self) -> int:
        """Number of them, k."""

    def at(self, share: FloatArray, angle_rad: FloatArray) -> FloatArray:
        """Return them (k, n) at shares (n,) of the limb's radius in directions (n,)."""


class Patches(NamedTuple):
    """Brightness of a surface over that of tables: of all of it; by albedo (j, k) or (1, k) of parts, on slopes or not."""

    mean: float
    albedo: FloatArray
    on_slopes: bool


@dataclass(frozen=True, slots=True, eq=False)
class LimbLight:
    """Tables of a disk's light in t directions and at n depths.

    Attributes
    ----------
    first_px, step_px
        Depth of the first column, and from each to the next.
    tables : (t, n, 12 + k) or (t, n, 12 + 2 k) array
        First as `PLANES`: light, its change with the PSF's variance (px^2 along each axis), with the shares of light that
        go to wings and to a halo, with the two shares of the law, and with the shading of a strained body: x along pixel,
        y along line, z toward the camera; cos and sin are the strains in the plane, xx = -yy and xy; and the light of
        slopes that face the Sun, `RELIEF`. Then the light of each hat function of the albedo, whose sum is the light, and
        that of the same hats on slopes that face the Sun; or one of both.
    parts
        Number of parts, k.
    fine
        Whether the directions are close enough, and worth, cubic interpolation.
    law_means : (2,) array
        Of the changes with the shares of the law, relative to the light: taken out of them, as they are brightness.
    on_slopes
        Which hats there are; None: both.
    psf_variance_px2
        Of the PSF over a pixel, along each axis.
    limb_px : (t,) array
        Radius of the outline.
    slopes : (t, n, 3) array
        As `SLOPES`, of a light that the tables make up (`sloped`): its change with depth, with the angle, and with the PSF's
        variance, px^2 along each axis.
    """

    first_px: float
    step_px: float
    tables: NDArray[np.float32]
    parts: int
    fine: bool
    law_means: FloatArray
    on_slopes: bool | None
    psf_variance_px2: float
    limb_px: FloatArray
    slopes: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def sloped(self, shares: FloatArray) -> "LimbLight":
        """Return the same light, with the slopes of what `shares` (p,) of its first tables make up."""
        light = self.tables[..., : len(shares)] @ shares
        return replace(self, slopes=_steepness(light, self.limb_px, self.first_px, self.step_px))

    def hats_of(self, rows: FloatArray, *, on_slopes: bool) -> FloatArray:
        """Return the light of the hats (k, m), on slopes that face the Sun or not, of what `at` returns (p, m)."""
        if self.on_slopes not in (None, on_slopes):
            raise ValueError("these tables hold the hats of the other light")
        first, k = len(PLANES), self.parts
        return rows[first + k :] if on_slopes and self.on_slopes is None else rows[first : first + k]

    def at(self, angle_rad: FloatArray, depth_px: FloatArray, first: int | None = None) -> FloatArray:
        """Return the tables, or as many of them as `first` says, at m places as (p, m)."""
        return self._looked_up(angle_rad, depth_px, self.tables[..., :first], cubic=self.fine)

    def over(
        self, angle_rad: FloatArray, depth_px: FloatArray, corners: SquareCorners
    ) -> tuple[FloatArray, FloatArray]:
        """Return slopes (3, m) and tables (p, m) at places, or as means over their corners where they have some."""
        both = self.slopes, self.tables
        out = np.empty((len(SLOPES) + self.tables.shape[-1], len(depth_px)))
        single = np.ones(len(depth_px), dtype=bool)
        single[corners.of] = False
        out[:, single] = self._looked_up(angle_rad[single], depth_px[single], *both, cubic=self.fine)
        if len(corners.of):  # where light is smooth
            out[:, corners.of] = self._looked_up(corners.angle_rad, corners.depth_px, *both, cubic=False)
        return out[: len(SLOPES)], out[len(SLOPES) :]

    def _looked_up(
        self, angle_rad: FloatArray, depth_px: FloatArray, *planes: NDArray[np.floating], cubic: bool
    ) -> FloatArray:
        """Return planes (t, n, p), one below the other, at m places (m,), or as means over k (m, k): (p, m)."""
        t, n, _ = self.tables.shape
        m = len(angle_rad)
        row = np.mod(angle_rad.reshape(-1), TURN) * (t / TURN)
        column = np.clip((depth_px.reshape(-1) - self.first_px) / self.step_px, 0.0, n - 1.000001)
        i, j = row.astype(np.int64), column.astype(np.int64)
        along, part = column - j, row - i
        rows = [(0, 1.0 - part), (1, part)]
        if cubic:
            rows = list(zip((-1, 0, 1, 2), cubic_weights(part), strict=True))
        index = np.empty((len(row), len(rows), 2), dtype=np.int64)
        weight = np.empty(index.shape, dtype=np.float32)  # as the tables: nothing is copied
        for k, (jump, share) in enumerate(rows):
            index[:, k, 0] = (i + jump) % t * n + j
            weight[:, k, 0], weight[:, k, 1] = share * (1.0 - along), share * along
        np.add(index[..., 0], 1, out=index[..., 1])
        each = len(row) // max(m, 1)
        ends = np.arange(m + 1) * (2 * len(rows) * each)
        lookup = sparse.csr_array((weight.ravel() / each, index.ravel(), ends), shape=(m, t * n))
        found = [(lookup @ plane.reshape(t * n, -1)).T for plane in planes]
        return np.concatenate(found, out=np.empty((sum(map(len, found)), m)))


def cubic_weights(part: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the weights of the samples at -1, 0, 1, 2 for an interpolation between 0 and 1 (Keys 1981)."""
    t = part
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


def spline_weights(part: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what a point between 0 and 1 gives to -1, 0, 1, 2 as a cubic spline: no comb where points lie in rows."""
    t, u = part, 1.0 - part
    sides = [(4.0 - 6.0 * v**2 + 3.0 * v**3) / 6.0 for v in (t, u)]
    return u**3 / 6.0, sides[0], sides[1], t**3 / 6.0


def limb_light(
    picture: BodyPicture,
    name: str,
    outline: Outline,
    range_scale: float,
    reach_px: tuple[float, float],
    parts: LightParts,
    law: FloatArray,
    strain: FloatArray,
    blur_px2: float = 0.0,
    *,
    fine: bool = False,
    on_slopes: bool | None = None,
    patches: Patches | None = None,
) -> LimbLight:
    """Tabulate the light of a body about its outline.

    Parameters
    ----------
    range_scale
        Range over the a priori one, which the outline was made with.
    reach_px : (float, float)
        Depths inward and outward that are needed.
    parts
        Of which the albedo is made up.
    law : (2,) array
        Lommel-Seeliger's share and the power of mu0 mu, beyond those of the body's own law, `own_law`.
    strain : (5,) array
        That the body in the picture has already, shares of `opnav_workbench.bodies.strained.STRAINS`.
    blur_px2
        Variance of the PSF along each axis, beyond its own.
    fine
        As the last solution needs it.
    on_slopes
        Which light the albedo is relative to; None: hats of both are tabulated.
    patches
        Of the surface, as far as it is known, for the stray light beside it.
    """
    step, fewest, most, apart = FINE if fine else COARSE
    if picture.phase_rad(name) > CRESCENT_RAD:
        step = FINE[0]
    model = displaced_model(picture, name, outline.center_px, range_scale)
    radius = 0.5 * outline.diameter_px
    directions = int(np.clip(TURN * radius / apart, fewest, most))
    angle = np.asarray(np.arange(directions) * (TURN / directions))
    first = -step * np.ceil(reach_px[0] / step)
    depth = np.arange(first, reach_px[1] + step, step)
    small = radius < PLANE_RADIUS_PX[int(fine)]
    build = _spread_in_plane if small else _spread_along_rays
    hatted = _Hats(parts, (0, -1) if on_slopes is None else (-int(on_slopes),))
    surface = _Surface(law, np.asarray(np.linalg.inv(strain_matrix(strain)), dtype=np.float64))
    tables = build(picture, model, outline, angle, depth, hatted, surface, blur_px2)
    tables = tables / max(float(tables[0].max(initial=0.0)), np.finfo(float).tiny)
    total = tables[0]
    law_means = tables[1:3].sum(axis=(1, 2)) / max(float(total.sum()), np.finfo(float).tiny)
    tables[1:3] -= law_means[:, None, None] * total
    limb = outline.radius(angle)
    slopes = _steepness(total, limb, float(first), step)
    variance = psf_variance(picture.psf, blur_px2)
    patched = None
    if patches is not None:
        patched = _patched(total, tables[1 + LINEAR :], angle, patches, both=on_slopes is None)
    stray = stray_light(total, patched, limb, angle, depth, float(np.sqrt(variance)))
    every = np.concatenate([np.stack([total, slopes[..., 2], *stray]), tables[1:]])
    kept = np.ascontiguousarray(every.transpose(1, 2, 0), dtype=np.float32)  # places are looked up row by row
    return LimbLight(
        float(first), float(step), kept, parts.count, fine, law_means, on_slopes, variance, limb, slopes
    )


def _patched(
    even: NDArray[np.floating],
    hats: NDArray[np.floating],
    angle: FloatArray,
    patches: Patches,
    *,
    both: bool,
) -> NDArray[np.floating]:
    """Return the light (t, n) of a surface with patches, whose hats are (k, t, n) or (2 k, t, n)."""
    k = patches.albedo.shape[1]
    first = k * (both and patches.on_slopes)
    albedo = between_pieces(angle, patches.albedo)
    light = patches.mean * even + np.einsum("tk,ktn->tn", albedo, hats[first : first + k])
    return np.asarray(np.maximum(light, 0.0))


def _steepness(light: FloatArray, limb_px: FloatArray, first_px: float, step_px: float) -> FloatArray:
    """Return `LimbLight.slopes` of light (t, n)."""
    t, n = light.shape
    before, after = np.roll(light, 1, axis=0), np.roll(light, -1, axis=0)
    by_depth = np.gradient(light, step_px, axis=1)
    by_angle = (after - before) * (0.5 * t / TURN)
    reach = np.maximum(limb_px[:, None] + first_px + step_px * np.arange(n), 1.0)
    bend = (before + after - 2.0 * light) * (t / TURN) ** 2
    by_variance = 0.5 * (np.gradient(by_depth, step_px, axis=1) + by_depth / reach + bend / reach**2)
    return np.stack([by_depth, by_angle, by_variance], axis=2)


def psf_variance(psf: Psf, blur_px2: float = 0.0) -> float:
    """Return the variance along each axis, px^2, of a PSF over a pixel with more blur, or less."""
    return max(float(np.max(psf.sigma_px)) ** 2 + PIXEL_VARIANCE_PX2 + blur_px2, 0.0)


class _Surface(NamedTuple):
    """Law (2,) of a body's surface, and what takes back its strain (3, 3)."""

    law: FloatArray
    unstrained: FloatArray


class _Hats(NamedTuple):
    """Parts of the light, and which that is: the first row of `_light_changes`, the last, or both."""

    parts: LightParts
    rows: tuple[int, ...]


def _light_rows(
    picture: BodyPicture,
    model: BodyModel,
    center_px: FloatArray,
    within: FloatArray,
    angle: FloatArray,
    rays: FloatArray,
    hatted: _Hats,
    surface: _Surface,
) -> FloatArray:
    """Return the light (1 + `LINEAR` + k or 2 k, n) along rays (3, n) at shares `within` (n,) of the limb's distance.

    All of it, its change with the law, and that of each hat, on each light that is asked for.
    """
    body = PlacedBody(replace(model, flux_e=None), picture.camera.pixel_scale_rad)
    changes = _light_changes(picture, body, center_px, rays, surface)
    parts = hatted.parts.at(within, angle)
    return np.concatenate([changes, *(changes[row] * parts for row in hatted.rows)])


def cell_means(depth_px: FloatArray, step_px: float, node: FloatArray) -> NDArray[np.float32]:
    """Return what light at `node` (m,), roots of depths, gives to cells of `step_px` at depths (n,): weights (m, n).

    A cell that the limb cuts has the light of the part inside.
    """
    out = np.zeros((len(node), len(depth_px)))
    inside, covered, places, weights = _covered_cells(depth_px, step_px)
    at = np.clip(np.sqrt(-places) / node[1], 0.0, len(node) - 1.0001)
    below = at.astype(np.int64)
    cells = np.broadcast_to(inside[:, None], at.shape)
    share = weights * covered[:, None]
    np.add.at(out, (below, cells), share * (1.0 + below - at))
    np.add.at(out, (below + 1, cells), share * (at - below))
    return out.astype(np.float32)


class _CoveredCells(NamedTuple):
    """Cells that a limb leaves any of: which (n,), the share that is left, and depths (n, k) in it with their weights."""

    inside: IntArray
    covered: FloatArray
    places: FloatArray
    weights: FloatArray


def _covered_cells(depth_px: FloatArray, step_px: float) -> _CoveredCells:
    covered = np.clip(0.5 - depth_px / step_px, 0.0, 1.0)
    inside = np.flatnonzero(covered > 0.0)
    return _CoveredCells(inside, covered[inside], *_rim_nodes(depth_px[inside], step_px))


def _rim_nodes(depth_px: FloatArray, step_px: float) -> tuple[FloatArray, FloatArray]:
    """Return depths (n, m) in the covered parts of cells (n,) whose weighted sum is the mean there, and the weights.

    The cosine to the line of sight grows as the root of the depth: light is smooth in that root, and by no means in the
    depth. A cell's middle would make the limb brighter, or darker, by what moves a disk of 100 px by 0.02 px.
    """
    inner, outer = np.sqrt(0.5 * step_px - depth_px), np.sqrt(np.maximum(-0.5 * step_px - depth_px, 0.0))
    at, share = np.polynomial.legendre.leggauss(RIM_NODES)
    root = 0.5 * (inner + outer)[:, None] + 0.5 * (inner - outer)[:, None] * at
    weight = share * root
    return -(root**2), weight / weight.sum(axis=1, keepdims=True)


def _light_changes(
    picture: BodyPicture, body: PlacedBody, center_px: FloatArray, rays: FloatArray, surface: _Surface
) -> FloatArray:
    """Return along rays (3, n) the light, and its changes with the shares of the law and the strains (1 + `LINEAR`, n)."""
    law = surface.law
    met = body.surface.first_hits(body.to_body(rays))
    shine = body.radiance(rays)[met.ray]
    normal = met.normal
    camera, sun = (_toward(place, met.point) for place in (body.camera_km, body.sun_km))
    mu0, mu = (np.einsum("in,in->n", normal, side) for side in (sun, camera))
    lit = (shine > 0.0) & (mu0 > 0.0) & (mu > 0.0)
    share = float(own_law(body.model.law, body.phase_rad)[0])
    plain = np.where(lit, _with_law(shine, mu0, mu, law, share), 0.0)
    total = max(float(plain.sum()), np.finfo(float).tiny)
    light = plain * (float(np.sum(shine, where=lit)) / total)  # the brightness is another unknown
    mixed = _of_mixture(mu0, mu, share + law[0])
    changes = [(_seeliger(mu0, mu) - 1.0) / mixed, np.log(np.maximum(mu0, DARKEST) * np.maximum(mu, DARKEST))]
    rows = [light, *(light * change for change in changes)]
    value = _law_value(body, mu0, mu, law)
    by_mu0, by_mu = _slopes(body, mu0, mu, law, value)
    scale = np.where(lit, light / np.maximum(value, 1e-9), 0.0)
    for lean in _leans(picture, body, center_px, met.point, normal, surface.unstrained):
        change = by_mu0 * np.einsum("in,in->n", sun, lean) + by_mu * np.einsum("in,in->n", camera, lean)
        rows += [scale * change]
    even = float(np.sum(value, where=lit))
    rows.append(_of_relief(body, mu0, mu, law) * (float(light.sum()) / even) if even > 0.0 else light)
    out = np.zeros((len(rows), rays.shape[1]))
    out[:, met.ray] = np.stack(rows)
    return out


def _of_relief(body: PlacedBody, mu0: FloatArray, mu: FloatArray, law: FloatArray) -> FloatArray:
    """Return a law (n,) on slopes that face the Sun: what a surface may differ by from its model.

    Near the terminator that is not in proportion to the model's own light: rims shine where it has none.
    """
    facing = np.where(mu > 0.0, _law_value(body, np.hypot(np.maximum(mu0, 0.0), RELIEF), mu, law), 0.0)
    return np.asarray(facing * np.clip(1.0 + mu0 / RELIEF, 0.0, 1.0))


def _toward(place: FloatArray, point: FloatArray) -> FloatArray:
    away = place[:, None] - point
    return np.asarray(away / np.sqrt(np.einsum("in,in->n", away, away)))


def _leans(
    picture: BodyPicture,
    body: PlacedBody,
    center_px: FloatArray,
    point: FloatArray,
    normal: FloatArray,
    unstrained: FloatArray,
) -> list[FloatArray]:
    """Return how the normals (3, n) that a ray meets change with each of `STRAINS`, body-fixed; none of plates.

    Of the ellipsoid x^T Q x = 1, whose points go to x + G x: a ray that keeps its share of the outline's radius moves by d
    across, and its point by dz along the line of sight, so that n (d + dz z) = n G x; and
    n' ~ Q (x + d + dz z - G x) - G^T n. A body that F has strained is strained farther by G = E F^-1. The outline is
    p^T M p = 1, with M^-1 the part of Q^-1 that lies across: its radius grows by p^T M G p of itself.
    """
    axes = strain_axes(picture, center_px) @ body.body_from_j2000.T
    if body.model.shape is not None:
        return [np.zeros_like(normal)] * len(STRAINS)
    square = axes / np.asarray(body.model.target.radii_km) ** 2 @ axes.T
    x, n = axes @ point, axes @ normal
    n = n / np.einsum("in,in->n", n, x)  # Q x
    depth = np.maximum(n[2], GRAZING * np.sqrt(np.einsum("in,in->n", n, n)))
    rim = np.linalg.solve(np.linalg.inv(square)[:2, :2], x[:2])
    rim /= np.einsum("in,in->n", rim, x[:2])
    leans = []
    for strain in STRAINS @ unstrained:
        moved = strain @ x
        away = np.einsum("in,in->n", rim, moved[:2]) * x - moved
        away[2] = -np.einsum("in,in->n", n[:2], away[:2]) / depth
        lean = square @ away - strain.T @ n
        leans.append(axes.T @ lean / np.sqrt(np.einsum("in,in->n", n, n)))
    return [lean - normal * np.einsum("in,in->n", normal, lean) for lean in leans]


def own_law(law: ScatteringLaw, phase_rad: float) -> FloatArray:
    """Return Lommel-Seeliger's share and the power of mu0 mu (2,) in a law; half and none of laws of another kind."""
    if isinstance(law, LunarLambert):
        return np.array([law.share(phase_rad), 0.0])
    if isinstance(law, Minnaert):
        return np.array([0.0, law.k - 1.0])
    return np.array([{Lambert: 0.0, LommelSeeliger: 1.0}.get(type(law), OTHER_SHARE), 0.0])


def _seeliger(mu0: FloatArray, mu: FloatArray) -> FloatArray:
    """Return Lommel-Seeliger's law over Lambert's."""
    return np.asarray(2.0 / np.maximum(mu0 + mu, 2.0 * DARKEST))


def _of_mixture(mu0: FloatArray, mu: FloatArray, share: float) -> FloatArray:
    """Return a mixture of both laws over Lambert's."""
    return np.maximum(1.0 + share * (_seeliger(mu0, mu) - 1.0), DARKEST)


def _with_law(
    light: FloatArray, mu0: FloatArray, mu: FloatArray, law: FloatArray, share: float
) -> FloatArray:
    """Return light (n,) by a law that has `share` of Lommel-Seeliger's as another makes it: `limb_light`."""
    power = (np.maximum(mu0, DARKEST) * np.maximum(mu, DARKEST)) ** law[1]
    return np.asarray(light * (_of_mixture(mu0, mu, share + law[0]) * power) / _of_mixture(mu0, mu, share))


def _law_value(body: PlacedBody, mu0: FloatArray, mu: FloatArray, law: FloatArray) -> FloatArray:
    phase, share = np.full_like(mu0, body.phase_rad), float(own_law(body.model.law, body.phase_rad)[0])
    value = body.model.law.reflectance(np.maximum(mu0, 0.0), np.maximum(mu, 1e-6), phase)
    return _with_law(value, mu0, mu, law, share)


def _slopes(
    body: PlacedBody, mu0: FloatArray, mu: FloatArray, law: FloatArray, here: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the changes (n,) with both cosines of a law that has the values `here`."""
    by_mu0 = (_law_value(body, mu0 + COSINE_STEP, mu, law) - here) / COSINE_STEP
    by_mu = (_law_value(body, mu0, mu + COSINE_STEP, law) - here) / COSINE_STEP
    return by_mu0, by_mu


# ---- A limb that is nearly straight: spread along rays.


def _spread_along_rays(
    picture: BodyPicture,
    model: BodyModel,
    outline: Outline,
    angle: FloatArray,
    depth: FloatArray,
    hatted: _Hats,
    surface: _Surface,
    blur_px2: float,
) -> NDArray[np.floating]:
    limb = outline.radius(angle)
    slope = np.interp(angle, outline.angle_rad, outline.slope_px, period=TURN) / limb
    step = float(depth[1] - depth[0])
    spreads, half = _spreads(picture.psf.at(outline.center_px), angle, slope, float(np.mean(limb)), step)
    fine = depth[0] + step * np.arange(-half, len(depth) + half)
    deepest = min(0.5 * step - float(fine[0]), float(limb.min()))
    smooth = model.shape is None and isinstance(model.albedo, float | int)
    apart = ROOT_STEP[smooth] * float(np.sqrt(step))
    node: FloatArray = apart * np.arange(int(np.sqrt(deepest) / apart) + 2.0)
    within = np.clip(1.0 - node**2 / limb[:, None], 0.0, 1.0 - GRAZE)
    fan = RayFan(picture, outline.center_px, angle, limb, float(within.min()))
    rays = fan.at(np.repeat(np.arange(len(angle)), len(node)), within.ravel())
    turned = np.repeat(angle, len(node))
    rows = _light_rows(picture, model, outline.center_px, within.ravel(), turned, rays, hatted, surface)
    # Across the limb out[d] = sum over s of spread[s] source[d + s]; along it a Gaussian: `_one_spread` holds its depth.
    n, t = len(fine), len(angle)
    good = fft.next_fast_len(n, real=True)  # what goes around the end is cut off
    variance = psf_variance(picture.psf, blur_px2)
    wave = np.exp(-0.5 * variance / float(np.mean(limb)) ** 2 * np.arange(t // 2 + 1) ** 2).astype(np.float32)
    single = rows.reshape(len(rows), t, len(node)).astype(np.float32)  # 1e-7: models hold light to 1e-3
    around = fft.irfft(fft.rfft(single, axis=1) * wave[:, None], t, axis=1)
    inside = fine < step
    sources = np.matmul(around, cell_means(fine[inside], step, node))
    gridded = step**2 * (CELL_VARIANCE + SPLINE_VARIANCE + LINEAR_VARIANCE)
    blurred = _blurred(TURN * fft.rfftfreq(good, step), blur_px2 - gridded)
    spread = (fft.rfft(spreads[:, ::-1], good) * blurred).astype(np.complex64)
    spectrum = fft.rfft(sources, good)
    spectrum *= spread
    return np.asarray(fft.irfft(spectrum, good, overwrite_x=True)[..., 2 * half : n])


def _blurred(wave_per_px: FloatArray, blur_px2: float) -> FloatArray:
    """Return the factors of a spectrum for a variance more, or less: that where the PSF has left anything."""
    power = -0.5 * blur_px2 * wave_per_px**2
    return np.asarray(np.exp(np.where(power > 0.0, power * np.exp(-((power / MOST_SHARPENED) ** 2)), power)))


def _spreads(
    psf: Psf, angle: FloatArray, slope: FloatArray, radius: float, step: float
) -> tuple[FloatArray, int]:
    """Return spread functions (t, 2 half + 1) along rays; entry half + s is the light from s steps farther out."""
    cells, per_px = _pixel_spread(psf)
    line, pixel = np.nonzero(cells > KEPT_SHARE * cells.max())
    middle = len(cells) // 2
    x, y = (pixel - middle) / per_px, (line - middle) / per_px
    reach = float(np.hypot(x, y).max())
    half = int(np.ceil((reach + 0.5 * reach**2 / radius) * 1.2 / step)) + 2
    share = cells[line, pixel]
    normals = np.arange(SPREADS) * (TURN / SPREADS)
    each = np.stack([_one_spread(x, y, share, a, radius, half, step) for a in normals])
    along = np.mod(angle - np.arctan(slope), TURN) * (SPREADS / TURN)
    before = along.astype(np.int64) % SPREADS
    part = (along - np.floor(along))[:, None]
    mixed = (1.0 - part) * each[before] + part * each[(before + 1) % SPREADS]
    stretch = np.sqrt(1.0 + slope**2)  # a ray crosses a slanted limb over a longer way
    steps = np.arange(-half, half + 1.0)
    spread = np.stack([np.interp(steps / s, steps, row) for row, s in zip(mixed, stretch, strict=True)])
    return spread / spread.sum(axis=1, keepdims=True), half


def _pixel_spread(psf: Psf) -> tuple[FloatArray, int]:
    """Return the PSF integrated over a pixel in cells (k, k), and the cells in a pixel."""
    per_px = 8 if psf.half_size_px < 12.0 else 4
    cells = np.pad(psf.kernel(per_px), per_px)
    size = len(cells)
    return np.asarray(fft.irfft2(_over_pixel(cells, per_px, size), (size, size))), per_px


def _over_pixel(cells: FloatArray, per_px: int, size: int) -> NDArray[np.complex128]:
    """Return the spectrum, padded to `size`, of a PSF's cells (k, k) integrated over a pixel of `per_px` cells.

    The cells hold the PSF's integral over themselves, which is taken back.
    """
    line, pixel = fft.fftfreq(size, 1.0 / per_px), fft.rfftfreq(size, 1.0 / per_px)
    over = [np.sinc(f) / np.sinc(f / per_px) for f in (line, pixel)]
    return np.asarray(fft.rfft2(cells, (size, size)) * over[0][:, None] * over[1])


def _one_spread(
    x: FloatArray, y: FloatArray, share: FloatArray, angle: float, radius: float, half: int, step: float
) -> FloatArray:
    across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    seen = (np.hypot(radius - across, along) - radius) / step + half
    below = np.clip(seen.astype(np.int64), 1, 2 * half - 2)
    part = np.clip(seen - below, 0.0, 1.0)
    n = 2 * half + 1
    taps = zip((-1, 0, 1, 2), spline_weights(part), strict=True)
    out = np.sum([np.bincount(below + jump, share * weight, n) for jump, weight in taps], axis=0)
    return np.asarray(out / share.sum())


# ---- A disk that is not much wider than the PSF: spread in two dimensions.


def _spread_in_plane(
    picture: BodyPicture,
    model: BodyModel,
    outline: Outline,
    angle: FloatArray,
    depth: FloatArray,
    hatted: _Hats,
    surface: _Surface,
    blur_px2: float,
) -> NDArray[np.floating]:
    psf, step = picture.psf.at(outline.center_px), PLANE_STEPS * float(depth[1] - depth[0])
    per_px = round(1.0 / step)
    half = int(np.ceil((float(outline.radius_px.max()) + 2.0) / step))
    offset = step * np.arange(-half, half + 1)
    x, y = np.meshgrid(offset, offset)
    around, reach = np.arctan2(y, x), np.hypot(x, y)
    limb = outline.radius(around)
    flat_x, flat_y, share = x.ravel(), y.ravel(), np.maximum(reach / limb, 1e-9).ravel()

    depth_px = (reach - limb).ravel()
    inside, covered, places, weights = _covered_cells(depth_px, step)
    within = np.clip(1.0 + places / limb.ravel()[inside, None], 0.0, 1.0 - GRAZE)
    length = within / share[inside, None]
    away = np.stack([flat_x[inside, None] * length, flat_y[inside, None] * length], axis=-1)
    rays = pixel_rays(picture, outline.center_px + away.reshape(-1, 2))
    turned = np.repeat(around.ravel()[inside], within.shape[1])
    rows = _light_rows(picture, model, outline.center_px, within.ravel(), turned, rays, hatted, surface)
    sources = np.zeros((len(rows), depth_px.size), dtype=np.float32)
    sources[:, inside] = (rows * weights.ravel()).reshape(-1, *weights.shape).sum(axis=2) * covered
    sources = sources.reshape(-1, *x.shape)
    cells = psf.kernel(per_px)
    farthest = float(outline.radius_px.max() + depth[-1]) / step
    # Nothing that the PSF carries around the plane comes so far as where it is looked up.
    size = fft.next_fast_len(half + int(farthest) + len(cells) // 2 + 2 * per_px, real=True)
    wave = np.hypot(fft.fftfreq(size, step)[:, None], fft.rfftfreq(size, step)) * TURN
    gridded = step**2 * CELL_VARIANCE + (depth[1] - depth[0]) ** 2 * LINEAR_VARIANCE
    spread = _over_pixel(cells, per_px, size) * _blurred(wave, blur_px2 - gridded) / _spline_spectrum(size)
    planes = fft.irfft2(fft.rfft2(sources, (size, size)) * spread.astype(np.complex64), (size, size))
    middle = half + len(cells) // 2  # of the body in the spread plane
    away = np.maximum(outline.radius(angle)[:, None] + depth, 0.0) / step
    line, pixel = middle + away * np.sin(angle)[:, None], middle + away * np.cos(angle)[:, None]
    looked_up = _spline_lookup(line.ravel(), pixel.ravel(), size) @ planes.reshape(len(planes), -1).T
    return np.asarray(looked_up.T.reshape(len(planes), *away.shape))


def _spline_spectrum(size: int) -> FloatArray:
    """Return the spectrum (size, size // 2 + 1) of what a cubic spline makes of its coefficients at their places.

    Divided by it, a periodic plane's spectrum is that of its coefficients (Unser 1999, doi:10.1109/79.799930).
    """
    line, pixel = ((2.0 + np.cos(TURN * f)) / 3.0 for f in (fft.fftfreq(size), fft.rfftfreq(size)))
    return np.asarray(line[:, None] * pixel)


def _spline_lookup(line: FloatArray, pixel: FloatArray, size: int) -> sparse.csr_array:
    """Return what places (m,) take from the coefficients (size size) of periodic planes: one look-up for all of them."""
    i, j = np.floor(line).astype(np.int64), np.floor(pixel).astype(np.int64)
    down, along = np.stack(spline_weights(line - i)), np.stack(spline_weights(pixel - j))
    taps = np.arange(-1, 3)[:, None]
    index = ((i + taps) % size * size)[:, None] + ((j + taps) % size)[None]
    ends = np.arange(len(i) + 1) * index[:, :, 0].size
    weight = (down[:, None] * along[None]).astype(np.float32)
    places = (weight.transpose(2, 0, 1).ravel(), index.transpose(2, 0, 1).ravel(), ends)
    return sparse.csr_array(places, shape=(len(i), size * size))
