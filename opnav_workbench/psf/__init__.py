"""Point spread functions: how the light of a point spreads over the pixels, in flux-conserving shares.

integrals   the elliptical Gaussian integrated over pixels, with the derivatives that a star fit needs
protocol    what every PSF can do, and the boxes that hold all of its light
gaussian    two widths and an angle            moffat   a core with wings
table       any PSF from a finely sampled one  empirical, extraction   a template taken from bright stars
field       widths that vary over the detector trailed  smeared by motion during the exposure
sources     many points added to a picture     schema   PSFs in YAML files
"""

from opnav_workbench.psf.empirical import EmpiricalPsf
from opnav_workbench.psf.field import FieldPsf, GridShape, PolynomialShape
from opnav_workbench.psf.gaussian import GaussianPsf
from opnav_workbench.psf.integrals import (
    PixelIntegrals,
    box_integrals,
    box_values,
    covariance_from_shape,
    ellipse_from_shape,
    pixel_gaussian,
    shape_from_ellipse,
)
from opnav_workbench.psf.moffat import MoffatPsf
from opnav_workbench.psf.protocol import Psf, PsfGradient, covering_boxes
from opnav_workbench.psf.schema import psf_from_mapping
from opnav_workbench.psf.sources import add_boxes, add_sources
from opnav_workbench.psf.trailed import TrailedPsf

__all__ = [
    "EmpiricalPsf",
    "FieldPsf",
    "GaussianPsf",
    "GridShape",
    "MoffatPsf",
    "PixelIntegrals",
    "PolynomialShape",
    "Psf",
    "PsfGradient",
    "TrailedPsf",
    "add_boxes",
    "add_sources",
    "box_integrals",
    "box_values",
    "covariance_from_shape",
    "covering_boxes",
    "ellipse_from_shape",
    "pixel_gaussian",
    "psf_from_mapping",
    "shape_from_ellipse",
]
