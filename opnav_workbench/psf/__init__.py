"""Point spread functions: how the light of a point spreads over the pixels, in flux-conserving shares.

Come in by a PSF class such as `GaussianPsf`, or by `psf_from_mapping` for one described in YAML; `Psf` is what all of
them can do.

``correction``
    What an elliptical Gaussian leaves of a real PSF, with its covariance.
``effective``
    The effective PSF of a camera as many pictures taught it, kept between pictures.
``empirical``
    A template taken from bright stars.
``gaussian``
    Two widths and an angle, the same everywhere or varying over the detector.
``integrals``
    The elliptical Gaussian integrated over pixels, with the derivatives that a star fit needs.
``protocol``
    What every PSF can do, the boxes that hold all of its light, and many points added to a picture.
``schema``
    PSFs in YAML files.
``tabulated``
    Any PSF from a finely sampled one; the Moffat profile, a core with wings.
``trailed``
    Smeared by motion during the exposure.
"""

from opnav_workbench.psf.correction import PsfCorrection, PsfEvidence
from opnav_workbench.psf.effective import EffectivePsf
from opnav_workbench.psf.empirical import EmpiricalPsf
from opnav_workbench.psf.gaussian import FieldPsf, GaussianPsf, GridShape, PolynomialShape
from opnav_workbench.psf.integrals import (
    PixelIntegrals,
    box_integrals,
    box_values,
    covariance_from_shape,
    ellipse_from_shape,
    pixel_gaussian,
    shape_from_ellipse,
)
from opnav_workbench.psf.protocol import Psf, PsfGradient, add_boxes, add_sources, covering_boxes
from opnav_workbench.psf.schema import psf_from_mapping
from opnav_workbench.psf.tabulated import MoffatPsf
from opnav_workbench.psf.trailed import TrailedPsf

__all__ = [
    "EffectivePsf",
    "EmpiricalPsf",
    "FieldPsf",
    "GaussianPsf",
    "GridShape",
    "MoffatPsf",
    "PixelIntegrals",
    "PolynomialShape",
    "Psf",
    "PsfCorrection",
    "PsfEvidence",
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
