"""A fitted disk: its outline and light, and what the solution makes of the pixels.

Units  px, DN; albedo and columns relative
"""

from dataclasses import dataclass, field, replace

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.columns import (
    ALBEDO,
    CENTER,
    FIGURE,
    SHADED,
    SHADING,
    SHARES,
    STRAY,
    DiskShape,
    TabulatedDisk,
    Unknown,
)
from opnav_workbench.bodies.disk.limb_cells import LimbPlaces, between_pieces
from opnav_workbench.bodies.disk.limb_field import FieldPrior
from opnav_workbench.bodies.disk.marginal import LimbSystem, MarginalSolution
from opnav_workbench.bodies.place import BodyPlace
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.render import FigureUncertainty

__all__ = ["DiskFit"]


@dataclass(frozen=True, slots=True, eq=False)
class DiskFit:
    """A fitted disk.

    Attributes
    ----------
    place
        From which it began.
    outline, smooth_outline
        At the solution, with the heights of its pieces and without.
    made
        Tables that the solution rests on, and what they were made with.
    prior
        Of the albedo and the limb, as the data speak for it.
    columns : (p + 1 + k + 3, n) array
        At the pixels, relative: derivatives with respect to what is shared, to the place of the limb, to the albedo, the
        shading that goes with the two strains of the outline, and the light of slopes that face the Sun.
    piece_albedo : (j,) array
        Of each piece of limb, relative.
    reach_px : (float, float)
        Inward and outward of the pixels that were used.
    chi2_reduced
        Chi-squared a degree of freedom, with the sky beside the body or without: what lies there is not the body's.
    lit_share
        Share of a turn of limb that is lit and in sight.
    lengths_px
        Of the center's steps.
    excess
        Variance of the cells over what was expected of them; the solution's covariance has to be as much larger.
    scatter
        Variance of the center over what excess makes of it, by how pieces of limb pull it
        (`opnav_workbench.bodies.disk.limb_scatter`).
    unrest_px2 : (2, 2) array
        Covariance beyond that of the linearized solution: how far it wandered, or the last place lies from the best one, and
        how far the solution there would still move; and `elsewhere_px2`.
    elsewhere_px2 : (2, 2) array
        How far fits from other places differ, as likely as those are.
    extrapolated
        Whether the light that the solution means is far from what was tabulated.
    """

    place: BodyPlace
    shape: DiskShape
    outline: Outline
    smooth_outline: Outline
    made: TabulatedDisk
    brightness_dn: float
    prior: FieldPrior
    system: LimbSystem
    solution: MarginalSolution
    pixels: LimbPlaces
    columns: FloatArray
    piece_albedo: FloatArray
    figure: FigureUncertainty
    reach_px: tuple[float, float]
    chi2_reduced: float
    lit_share: float
    lengths_px: tuple[float, ...]
    converged: bool
    excess: float = 1.0
    scatter: float = 1.0
    unrest_px2: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))
    elsewhere_px2: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))
    extrapolated: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def center_px(self) -> FloatArray:
        """Center of figure (2,)."""
        return self.shape.center_px

    @property
    def known_px2(self) -> FloatArray:
        """Covariance of the center (2, 2) by its linearized solution, however far the fit has yet to go."""
        own = self.solution.covariance[np.ix_(CENTER, CENTER)]
        return np.asarray(self.excess * self.scatter * own)

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the center (2, 2), marginal over all else."""
        return np.asarray(self.known_px2 + self.unrest_px2)

    def less_sure(self, covariance_px2: FloatArray) -> "DiskFit":
        """Return the fit with so much more (2, 2) in the center's covariance."""
        return replace(self, unrest_px2=self.unrest_px2 + covariance_px2)

    def light_dn(self) -> FloatArray:
        """Return the light (n,) of the disk at its pixels, DN, for a uniform albedo, as it was tabulated."""
        return np.asarray(self.brightness_dn * self.columns[Unknown.BRIGHTNESS])

    @property
    def lit_dn(self) -> FloatArray:
        """How bright the limb is at the angles of the pixels (n,), DN."""
        return self.brightness_dn * between_pieces(self.pixels.angle_rad, self.piece_albedo)

    def even_dn(self) -> FloatArray:
        """Return the light (n,) that the solution has at its pixels, DN, for a uniform albedo."""
        return np.asarray(self.light_dn() + self._beyond_tables_dn(self.brightness_dn))

    def _beyond_tables_dn(self, lit_dn: FloatArray | float) -> FloatArray:
        beyond = self.solution.theta - self.made.tabulated
        changing = [*SHARES, *SHADING, Unknown.BLUR]
        local = beyond[FIGURE[1:]] @ self.columns[SHADED] + beyond[changing] @ self.columns[changing]
        return np.asarray(lit_dn * local + self.brightness_dn * (beyond[STRAY] @ self.columns[STRAY]))

    def model_dn(self) -> FloatArray:
        """Return what the solution expects (n,) at its pixels, DN."""
        theta = self.solution.theta
        linear = [Unknown.BRIGHTNESS, Unknown.LEVEL, Unknown.SLOPE_PIXEL, Unknown.SLOPE_LINE]
        model = theta[linear] @ self.columns[linear] + self._beyond_tables_dn(self.lit_dn)
        albedo = between_pieces(self.pixels.angle_rad, self.solution.albedo)
        return np.asarray(model + np.einsum("nk,kn->n", albedo, self.columns[ALBEDO]))

    def sigma(self, unknown: Unknown) -> float:
        """Return the standard deviation of what is shared."""
        return float(np.sqrt(self.solution.covariance[unknown, unknown]))
