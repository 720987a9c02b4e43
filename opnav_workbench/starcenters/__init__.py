"""Centers of stars: detection, identification, matched filter, cross-correlation and least squares.

Flow   image, noise, masks -> `detect` -> `identify` -> `correlate` -> `fit_gaussian`, `fit_stars` -> pointing
Frame  (pixel, line), 0-based, integer = pixel center; images are indexed [line, pixel]
Units  DN and px; fluxes are totals of a star, noise is 1 sigma
"""

from opnav_workbench.starcenters.consensus import estimate_psf_error, fit_stars, shape_from_stars
from opnav_workbench.starcenters.correlation import correlate
from opnav_workbench.starcenters.cramer_rao import CenterBound, cramer_rao, flux_at_snr
from opnav_workbench.starcenters.detection import detect
from opnav_workbench.starcenters.detections import Detections
from opnav_workbench.starcenters.flags import StarFlag, describe_flags
from opnav_workbench.starcenters.identification import Identification, identify, identify_sky
from opnav_workbench.starcenters.images import StarImages
from opnav_workbench.starcenters.least_squares import default_box_px, fit_gaussian
from opnav_workbench.starcenters.marked import identify_marked
from opnav_workbench.starcenters.psf_fit import fit_psf
from opnav_workbench.starcenters.results import NoiseModel, PsfShape, ShapePrior, StarCenters
from opnav_workbench.starcenters.templates import Template, extract_template, gaussian_template

__all__ = [
    "CenterBound",
    "Detections",
    "Identification",
    "NoiseModel",
    "PsfShape",
    "ShapePrior",
    "StarCenters",
    "StarFlag",
    "StarImages",
    "Template",
    "correlate",
    "cramer_rao",
    "default_box_px",
    "describe_flags",
    "detect",
    "estimate_psf_error",
    "extract_template",
    "fit_gaussian",
    "fit_psf",
    "fit_stars",
    "flux_at_snr",
    "gaussian_template",
    "identify",
    "identify_marked",
    "identify_sky",
    "shape_from_stars",
]
