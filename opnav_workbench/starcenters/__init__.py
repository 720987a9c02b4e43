"""Centers of stars: detection, identification, matched filter, cross-correlation and least squares.

Flow   image, noise, masks -> `detect` -> `identify` -> `correlate` -> `fit_gaussian`, `fit_stars` -> pointing
Frame  (pixel, line), 0-based, integer = pixel center; images are indexed [line, pixel]
Units  DN and px; fluxes are totals of a star, noise is 1 sigma
"""

from opnav_workbench.starcenters.consensus import estimate_psf_error, fit_stars, shape_from_stars
from opnav_workbench.starcenters.correlation import correlate
from opnav_workbench.starcenters.detection import Detections, detect
from opnav_workbench.starcenters.flags import StarFlag, describe_flags
from opnav_workbench.starcenters.identification import Identification, identify
from opnav_workbench.starcenters.least_squares import default_box_px, fit_gaussian
from opnav_workbench.starcenters.results import NoiseModel, PsfShape, ShapePrior, StarCenters
from opnav_workbench.starcenters.templates import Template, extract_template, gaussian_template

__all__ = [
    "Detections",
    "Identification",
    "NoiseModel",
    "PsfShape",
    "ShapePrior",
    "StarCenters",
    "StarFlag",
    "Template",
    "correlate",
    "default_box_px",
    "describe_flags",
    "detect",
    "estimate_psf_error",
    "extract_template",
    "fit_gaussian",
    "fit_stars",
    "gaussian_template",
    "identify",
    "shape_from_stars",
]
