"""Centers of target bodies in a picture.

results     what a centerfinder says of a body
unresolved  bodies (and stars taken as targets) smaller than the PSF: the star centerfinders
"""

from opnav_workbench.bodycenters.results import BODY_STATUSES, BodyCenter
from opnav_workbench.bodycenters.unresolved import find_unresolved

__all__ = ["BODY_STATUSES", "BodyCenter", "find_unresolved"]
