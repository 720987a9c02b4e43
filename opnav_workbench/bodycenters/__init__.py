"""Centers of target bodies in a picture.

results, flags         what a centerfinder says of a body
circle, picture        where a body is expected; the picture, its noise, its camera and the models of its bodies
subarray, cutout       the part of a picture in which a body is looked for
model_picture          bodies moved to where the picture may show them, and rendered there
detection, expectation, place_search, company
                       whether and roughly where bodies are, one or several
scene_light, scene_fit, normal_equations, hit_pixels
                       rendered bodies fitted to pixels, cosmic rays left out
pattern, size_check, judging, model_fit
                       what residuals say of a center; flags, status and messages
correlation, least_squares, joint
                       the full-disk methods
limb_points, limb_points_pieces, silhouette, horizon, horizon_search, horizon_fit
                       the limb: its points, its outline, what both say of the body's place
ellipse, ellipse_start, ellipse_judge, ellipse_report, ellipse_results, ellipse_free, ellipse_scene
                       the limb method; pictures without kernels
limb_scan, scan_*      brightness along vectors that radiate across the limb
ellipse, ellipse_*, horizon*, limb_points*, silhouette
                       points of the limb, and the conic or outline through them
method                 which method "auto" means
unresolved, unresolved_judging, unresolved_body
                       bodies (and stars taken as targets) smaller than the PSF: the star centerfinders
"""

from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.correlation import find_cross_correlation
from opnav_workbench.bodycenters.ellipse import find_ellipse
from opnav_workbench.bodycenters.ellipse_results import FreeEllipse, LimbEllipse
from opnav_workbench.bodycenters.ellipse_scene import picture_from_circle
from opnav_workbench.bodycenters.flags import BodyFlag, describe_body_flags
from opnav_workbench.bodycenters.horizon import horizon_position
from opnav_workbench.bodycenters.joint import find_jointly
from opnav_workbench.bodycenters.least_squares import find_least_squares
from opnav_workbench.bodycenters.limb_scan import find_limb_scan
from opnav_workbench.bodycenters.limb_scan_results import LimbScans
from opnav_workbench.bodycenters.method import choose_method
from opnav_workbench.bodycenters.model_fit import ModelFit
from opnav_workbench.bodycenters.model_picture import displaced_model, model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BODY_STATUSES, BodyCenter, BodyPictures, JointCenters
from opnav_workbench.bodycenters.silhouette import Outline, body_outline
from opnav_workbench.bodycenters.subarray import SubArray, choose_subarray
from opnav_workbench.bodycenters.unresolved import find_unresolved
from opnav_workbench.bodycenters.unresolved_body import find_unresolved_body

__all__ = [
    "BODY_STATUSES",
    "BodyCenter",
    "BodyFlag",
    "BodyPicture",
    "BodyPictures",
    "Circle",
    "FreeEllipse",
    "JointCenters",
    "LimbEllipse",
    "LimbScans",
    "ModelFit",
    "Outline",
    "SubArray",
    "body_outline",
    "choose_method",
    "choose_subarray",
    "describe_body_flags",
    "displaced_model",
    "find_cross_correlation",
    "find_ellipse",
    "find_jointly",
    "find_least_squares",
    "find_limb_scan",
    "find_unresolved",
    "find_unresolved_body",
    "horizon_position",
    "model_picture",
    "picture_from_circle",
]
