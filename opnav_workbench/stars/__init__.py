"""Stars in pictures: detected, identified, their centers measured; the camera's attitude from them in `stars.pointing`.

Flow   image, noise, masks -> `detect` -> `identify_sky` -> `correlate` -> `fit_gaussian`, `fit_psf`, `fit_stars`
       -> `pointing.solve_pointing`
Frame  (pixel, line), 0-based, integer = pixel center; images are indexed [line, pixel]
Units  DN and px; fluxes are totals of a star, noise is 1 sigma

``boxes``
    Images with their noise and masks, checked, and square boxes cut out of them.
``center_bounds``
    The Cramer-Rao bound of a star's center: `cramer_rao`, `flux_at_snr`.
``companions``
    One image or two: stars beside unlisted ones, `with_companions`.
``correlation``
    First centers by matched filter or cross-correlation with a template: `correlate`.
``detection``
    Blind detection: `detect` and its `Detections`; `in_defect_rows` and `on_tracks` tell what is none of a star's.
``effective_psf``
    The correction to a Gaussian that all stars of a picture agree on.
``evidence``
    How sure an identification is: evidence of a rotation, confidence, `Identification`.
``flags``
    One table of flags for everything that can befall a star's center.
``group_fit``
    One batch of groups of stars fitted: starts, solution, hits.
``hypotheses``
    Rotations proposed by votes of pairs of stars, and refined by matching.
``identification``
    Which detection is which star: `identify_sky`, `identify`, `identify_marked`.
``least_squares``
    The doors to the fit: `fit_gaussian` and `fit_psf`.
``levenberg_marquardt``
    Levenberg-Marquardt for many small problems at once.
``lost_in_space``
    The attitude from the stars alone, with none to begin with: `lost_in_space.solve_lost`.
``peaks``
    The sub-pixel peak of a sampled surface.
``picture_fit``
    All stars of a picture fitted, neighbors together, hits masked.
``pointing``
    The camera's attitude from identified stars: `solve_pointing`.
``psf_consensus``
    The PSF that a picture's well-exposed stars agree on, and the fit with it: `fit_stars`.
``results``
    What the centerfinders take and return: `StarCenters`, `ShapePrior`, `NoiseModel`.
``saturated``
    Stars with saturated cores, measured by what is not saturated: `fit_wings`.
``second_images``
    Pictures in which all stars are seen twice: `second_images`.
``star_field``
    Catalog stars and detections as directions, ready to be identified.
``star_model``
    The model that is fitted to the pixels.
"""

from opnav_workbench.stars.center_bounds import CenterBound, cramer_rao, flux_at_snr
from opnav_workbench.stars.companions import with_companions
from opnav_workbench.stars.correlation import StarTemplate, correlate, extract_template, gaussian_template
from opnav_workbench.stars.detection import Detections, detect, in_defect_rows, on_tracks
from opnav_workbench.stars.effective_psf import ExpectedPlaces
from opnav_workbench.stars.evidence import Identification
from opnav_workbench.stars.flags import StarFlag, describe_flags
from opnav_workbench.stars.identification import identify, identify_marked, identify_sky
from opnav_workbench.stars.least_squares import default_box_px, fit_gaussian, fit_psf
from opnav_workbench.stars.psf_consensus import (
    estimate_psf_error,
    evidence_of_stars,
    fit_stars,
    shape_from_stars,
    strange_images,
)
from opnav_workbench.stars.results import NoiseModel, PsfShape, ShapePrior, StarCenters, StarImages
from opnav_workbench.stars.saturated import WingCenters, fit_wings
from opnav_workbench.stars.second_images import SecondImages, second_images

__all__ = [
    "CenterBound",
    "Detections",
    "ExpectedPlaces",
    "Identification",
    "NoiseModel",
    "PsfShape",
    "SecondImages",
    "ShapePrior",
    "StarCenters",
    "StarFlag",
    "StarImages",
    "StarTemplate",
    "WingCenters",
    "correlate",
    "cramer_rao",
    "default_box_px",
    "describe_flags",
    "detect",
    "estimate_psf_error",
    "evidence_of_stars",
    "extract_template",
    "fit_gaussian",
    "fit_psf",
    "fit_stars",
    "fit_wings",
    "flux_at_snr",
    "gaussian_template",
    "identify",
    "identify_marked",
    "identify_sky",
    "in_defect_rows",
    "on_tracks",
    "second_images",
    "shape_from_stars",
    "strange_images",
    "with_companions",
]
