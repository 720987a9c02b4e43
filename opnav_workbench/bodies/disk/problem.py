"""What stays while a disk is fitted: its pixels, and what is believed of it beforehand.

Of what all pieces of limb share:

brightness, background and its slopes   nothing
center                                  `PLACE_PX`, `PLACE_SIGMAS` about its place
size                                    `BodyModel.figure` of the body, and the crossings of the limb: `SEEN_PX`
axes                                    `BodyModel.figure`: two in the plane, three that change the shading alone
law                                     Lommel-Seeliger share, power of mu0 mu: `FigureUncertainty`, `UNKNOWN_LAW` or given
PSF                                     variance and wings: `BodyPicture.psf_width_sigma`, `WING_SIGMA`

and of its own each piece has an albedo and a place of its limb: `opnav_workbench.bodies.disk.marginal`.
"""

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.disk.blocks import LimbSamples, PixelSquares, limb_samples
from opnav_workbench.bodies.disk.columns import (
    CENTER,
    FIGURE,
    SHADING,
    SHARED,
    SHARES,
    STRAY,
    DiskShape,
    TabulatedDisk,
    Unknown,
)
from opnav_workbench.bodies.disk.limb_cells import depth_edges, piece_angles
from opnav_workbench.bodies.disk.limb_field import DiskField, limb_field
from opnav_workbench.bodies.disk.limb_light import LimbLight, Patches, limb_light, own_law, psf_variance
from opnav_workbench.bodies.disk.marginal import LimbSystem
from opnav_workbench.bodies.disk.surface_modes import surface_field
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.bodies.place import BodyPlace
from opnav_workbench.bodies.scales import scale_precisions
from opnav_workbench.bodies.silhouette import TURN, Outline, Silhouette
from opnav_workbench.bodies.strained import can_be_strained, strained_picture
from opnav_workbench.bodies.subarray import Cutout
from opnav_workbench.constants import PIXEL_VARIANCE_PX2
from opnav_workbench.render import BodyModel, FigureUncertainty, Lambert

__all__ = ["DiskProblem"]

# Pieces of limb: as many as are so long at least, and more than the middle one of these numbers where they are longer still:
# a patch on a large disk is seen to have edges. Blocks of as many pieces halve well.
PIECES, MIDDLE, PIECE_PX = (24, 32, 40, 48, 64, 80, 96), 48, (1.5, 4.0)
# Of the albedo, from the limb inward, no nearer than two widths of the PSF. Five left so much of sharp patches on a dim limb
# that a larger disk with a darker rim explained the pixels better, by 2 px and 6 sigma; eleven do no better than eight.
FEWEST_NODES, MOST_NODES, NODE_WIDTHS = 5, 8, 2.0
BLURRED_WIDTHS = 7.0  # of the PSF, radius: light of one side of a smaller disk shines on the other
# What tells of the limb, and of the albedo beside it.
DEEPEST_RAD, DEEPEST_PX, LEAST_DEPTH_PX = 0.6, 40.0, 12.0
SHARP_SIGMAS = 4.0  # about the limb: nothing is gathered in squares there
ROOM_PX = 16.0  # for a limb to move in before squares are made anew
SKY_PX, PSF_REACH = 6.0, 4.0  # beyond the limb: background, after so many sigmas of the PSF
# Nothing is known of the law of a body that has none in the mission file: its model is Lambert's, and it lies anywhere
# between that and Lommel-Seeliger's. A law that was given is one of a kind of bodies.
# Mean and sigma of Lommel-Seeliger's share beyond the law's own, sigma of the power of mu0 mu.
UNKNOWN_LAW, GIVEN_LAW = (0.5, 0.5, 0.2), (0.0, 0.3, 0.2)
MINNAERT_SHARE = GIVEN_LAW[2] / GIVEN_LAW[1]  # where the first is stated
LAW_BOUNDS = np.array([[-0.1, -0.6], [1.5, 0.6]])  # of the whole share, and of the power
WING_SIGMA = 0.15
HELD = 1e-4  # sigma of a size that is held
# The crossings that made the place tell the size of a disk, whatever its albedo: a fit free to call a rim dark cannot.
SEEN_SHARE, SEEN_PX = 2.0, 0.4  # of their sigma; and what half of the brightness may be beside the limb
PLACE_PX, PLACE_SIGMAS = 1.5, 4.0  # how far a center may lie from its place
LIT_LIMB = 0.1  # of the brightest part: a piece of limb that shows
LEAST_STEP = 0.25  # of the step from body to sky: what a piece of limb shows of it, or it is not in sight
# Of three axes that are off independently, seen from anywhere: variances 3/5 and 1/5 of an axis' own.
SHADING_SHARE = np.sqrt([0.6, 0.2, 0.2])
SHADING_SCALES = (1.0, 0.2)  # surfaces lean by what their axes say, or by less: the rest is albedo
LEAN_SIGMAS = 2.0  # of that, as far as tables follow: a patchy surface is explained by far more, and led away


class DiskProblem:
    """What stays while a disk is fitted."""

    def __init__(
        self,
        picture: BodyPicture,
        name: str,
        pixels: Cutout,
        place: BodyPlace,
        held_log_size: float | None = None,
    ) -> None:
        self.picture, self.name, self.pixels, self.place = picture, name, pixels, place
        radius_px = 0.5 * picture.diameter_px(name) * place.size_ratio
        self.radius_px = radius_px
        crossed = (
            float(np.log(place.seen_ratio)),
            float(np.hypot(SEEN_SHARE * place.seen_sigma, SEEN_PX / radius_px)),
        )
        self.size_prior = crossed if held_log_size is None else (held_log_size, HELD)  # mean, sigma
        model = picture.model(name)
        self.can_be_strained = can_be_strained(model)
        self.figure: FigureUncertainty = model.seen_figure
        self.most_lean = LEAN_SIGMAS * self.figure.axes_sigma * SHADING_SHARE
        self.law_prior = _law_prior(model)
        self.own_law = own_law(model.law, float(picture.phase_rad(name)))
        self.law_bounds = LAW_BOUNDS - self.own_law
        self.psf_variance_px2 = psf_variance(picture.psf)
        # Pixels show nothing narrower than they are
        self.psf_px = max(float(np.max(picture.psf.sigma_px)), float(np.sqrt(PIXEL_VARIANCE_PX2)))
        inward = min(DEEPEST_PX, radius_px * (1.0 - np.cos(DEEPEST_RAD)))
        self.reach = min(radius_px, max(LEAST_DEPTH_PX, inward)), PSF_REACH * self.psf_px + SKY_PX
        self.edges = depth_edges(*self.reach, self.psf_px)
        self.sharp_px = SHARP_SIGMAS * self.psf_px
        self.in_sky = self.edges[:-1] > self.psf_px
        self.beside = self.edges[:-1] > PSF_REACH * self.psf_px
        self.at_limb = np.abs(self.edges[:-1] + self.edges[1:]) < 2.0 * PSF_REACH * self.psf_px
        self._squares: PixelSquares | None = None
        self.pieces = _pieces(TURN * radius_px)
        self.rough_px = self.figure.limb_roughness * radius_px
        self.field = self._disk_field()
        self.prior_precision = self._prior_sigma() ** -2.0
        self.scales = self._scales()
        self.hemispheres = np.array(self.figure.albedo_scales) / self.figure.albedo_sigma

    def _disk_field(self) -> DiskField:
        width, hemispheres = float(np.sqrt(self.psf_variance_px2)), self.figure.albedo_sigma
        if self.radius_px < BLURRED_WIDTHS * width:
            return surface_field(self.radius_px, width, self.pieces, hemispheres)
        deepest = float(np.arccos(max(1.0 - self.reach[0] / self.radius_px, 0.0)))
        seen = round(1.0 + deepest * self.radius_px / (NODE_WIDTHS * width))
        node_rad = np.linspace(0.0, deepest, int(np.clip(seen, FEWEST_NODES, MOST_NODES)))
        return limb_field(self.radius_px, width, node_rad, self.pieces, hemispheres)

    def samples(self, outline: Outline) -> LimbSamples:
        """Return the pixels about an outline, gathered in squares where its light is smooth."""
        outward = self.reach[1]
        if self._squares is None or not self._squares.hold(outline, outward):
            self._squares = PixelSquares(self.pixels, outline, outward + ROOM_PX)
        return limb_samples(self._squares, outline, *self.reach, self.sharp_px)

    def seen_limb(self, made: TabulatedDisk, system: LimbSystem) -> BoolArray:
        """Tell which pieces of limb (j,) are lit and show enough of the step from body to sky, be all else saturated."""
        share = np.isfinite(system.variance[:, self.at_limb]).mean(axis=1)
        return np.asarray(made.lit & (share > LEAST_STEP))

    def _lit(self, light: LimbLight) -> BoolArray:
        """Tell which pieces of limb (j,) light shows at any depth of the cells."""
        angle, depth = np.meshgrid(
            piece_angles(self.pieces), 0.5 * (self.edges[:-1] + self.edges[1:]), indexing="ij"
        )
        brightest = light.at(angle.ravel(), depth.ravel(), 1)[0].reshape(angle.shape).max(axis=1)
        return np.asarray(brightest > LIT_LIMB)

    def tabulated(
        self,
        shape: DiskShape,
        *,
        fine: bool = False,
        on_slopes: bool | None = None,
        patches: Patches | None = None,
    ) -> TabulatedDisk:
        """Return the light of a shape; of a body that cannot be strained, without its strain."""
        strain = shape.strain if self.can_be_strained else np.zeros(5)
        picture = strained_picture(self.picture, self.name, strain)
        silhouette, scale = Silhouette(picture, self.name), float(np.exp(-shape.log_size))
        outline = silhouette.at(shape.center_px, scale)
        inward, outward = self.reach
        reach = (inward + 4.0, outward + 4.0)
        light = limb_light(
            picture, self.name, outline, scale, reach, self.field.parts, shape.law, strain, shape.blur_px2,
            fine=fine, on_slopes=on_slopes, patches=patches,
        )  # fmt: skip
        return TabulatedDisk(shape, strain, silhouette, outline.slant, light, self._lit(light))

    def _prior_sigma(self) -> FloatArray:
        """Return the uncertainty (p,) of what is shared, but for the scales of the figure."""
        out = np.full(SHARED, np.inf)
        out[Unknown.SIZE] = self.size_prior[1]
        out[CENTER] = max(PLACE_PX, PLACE_SIGMAS * self.place.center_sigma_px)
        out[SHARES] = self.law_prior[1:]
        out[Unknown.BLUR] = 2.0 * self.picture.psf_width_sigma * self.psf_variance_px2
        out[STRAY] = WING_SIGMA
        return out

    def _scales(self) -> FloatArray:
        """Return the precisions (k, p) of the scales that size, axes and shading may have."""
        figure = self.figure
        shading = figure.axes_sigma * np.multiply.outer(SHADING_SCALES, SHADING_SHARE)
        return scale_precisions(
            SHARED, ([Unknown.SIZE], figure.size_scales), (FIGURE[1:], figure.axes_scales), (SHADING, shading)
        )

    def prior_mean(self, center_px: FloatArray) -> FloatArray:
        """Return what is expected (p,) of what is shared; of the center, as a step from where it is."""
        mean = np.zeros(SHARED)
        mean[Unknown.SIZE] = self.size_prior[0]
        mean[CENTER] = self.place.center_px - center_px
        mean[Unknown.LAW] = self.law_prior[0]
        return mean


def _pieces(limb_px: float) -> int:
    """Return the number of pieces of a limb of this length."""
    short, long = (limb_px / px for px in PIECE_PX)
    wanted = min(short, max(float(MIDDLE), long))
    return max((n for n in PIECES if n <= wanted), default=PIECES[0])


def _law_prior(model: BodyModel) -> tuple[float, float, float]:
    """Return mean and sigma of what a body's law has more of Lommel-Seeliger's, and the sigma of its power."""
    stated = model.figure.law_sigma
    if stated is not None:
        return 0.0, stated, MINNAERT_SHARE * stated
    return UNKNOWN_LAW if isinstance(model.law, Lambert) else GIVEN_LAW
