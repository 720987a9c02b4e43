"""Centers of target bodies in a picture.

results, flags         what a centerfinder says of a body
circle, picture        where a body is expected; the picture, its noise, its camera and the models of its bodies
subarray, cutout       the part of a picture in which a body is looked for
model_picture          bodies moved to where the picture may show them, and rendered there
detection, expectation, place_search, company
                       whether and roughly where bodies are, one or several
scene_light, scene_fit, hit_pixels
                       rendered bodies fitted to pixels, cosmic rays left out
pattern, size_check, judging, model_fit
                       what residuals say of a center; flags, status and messages
correlation, least_squares, joint
                       the full-disk methods
method                 which method "auto" means
unresolved, unresolved_judging, unresolved_body
                       bodies (and stars taken as targets) smaller than the PSF: the star centerfinders
"""

from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.correlation import find_cross_correlation
from opnav_workbench.bodycenters.flags import BodyFlag, describe_body_flags
from opnav_workbench.bodycenters.joint import find_jointly
from opnav_workbench.bodycenters.least_squares import find_least_squares
from opnav_workbench.bodycenters.method import choose_method
from opnav_workbench.bodycenters.model_fit import ModelFit
from opnav_workbench.bodycenters.model_picture import displaced_model, model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BODY_STATUSES, BodyCenter, BodyPictures, JointCenters
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
    "JointCenters",
    "ModelFit",
    "SubArray",
    "choose_method",
    "choose_subarray",
    "describe_body_flags",
    "displaced_model",
    "find_cross_correlation",
    "find_jointly",
    "find_least_squares",
    "find_unresolved",
    "find_unresolved_body",
    "model_picture",
]
