"""Centers of target bodies in a picture.

Enter by a `BodyPicture` (or `picture_from_circle`, without kernels) and one of the centerfinders, which return a
`BodyCenter`: `find_unresolved`, `find_unresolved_body`, `find_disk`, `find_least_squares`, `find_jointly` (several
bodies in one fit: `JointCenters`), `find_cross_correlation`, `find_ellipse`, `find_limb_scan`. `choose_method` says
which suits a body.

``results``
    Centers, status, flags, and the details of each method.
``picture``
    The picture, its noise, camera and scene; bodies moved and rendered in it; an analyst's circle.
``subarray``
    The window that a body is looked for in, and which of its pixels count.
``place_search``
    The rendered picture of a small or faint body, or of a star, correlated with the data over a search area.
``place``
    Where a body stands, before anything is fitted: its silhouette against the sky, and what else may be there.
``crossings``
    Where rays cross a limb, at half of the local brightness.
``flanks``
    Where a saturated limb lies, by the light that falls off beside it.
``spilled``
    Charge that saturated pixels have spilled, told from a body.
``lighting``
    Where the Sun stands over a body, told by its disk.
``detection``
    Which bodies the picture shows, where and of what figure, and which of them have to be fitted together.
``silhouette``
    Outlines of ellipsoids and plate models in the picture.
``scales``
    Priors of unknown scale: how far a figure may be off that nobody has stated.
``strained``
    A body whose figure is not quite its model's.
``scene_fit``
    Rendered bodies fitted to pixels.
``neighbours``
    Other bodies near one, and the pixels that they light.
``residuals``
    What residuals say of a center: albedo patterns.
``fit_report``
    From such a fit to centers with covariance, flags, status and messages.
``cross_correlation``
    Full-disk method: the peak of the correlation with the rendered body.
``least_squares``
    Full-disk method: one body or several, their covariance joint.
``unresolved``
    Bodies (and stars taken as targets) smaller than the PSF.
``method``
    Which method "auto" means.
``free_ellipse``
    An ellipse of any axes through limb points: the check of a body's radii.
``ellipse``
    Limb method: sub-pixel limb points, and the outline of the body through them.
``disk``
    One likelihood of the pixels about the limb: albedo as a random field, size, figure, law and PSF uncertain.
``judgement``
    Flags, status and messages of a center that was read off a disk, the same for all methods of that kind.
``limb_scan``
    Limb method: brightness along lines that radiate across the limb.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.bodies.cross_correlation import find_cross_correlation
    from opnav_workbench.bodies.disk.centerfinder import find_disk, judged_disk
    from opnav_workbench.bodies.disk.measurement import MeasuredDisk, measure_disk
    from opnav_workbench.bodies.ellipse import find_ellipse
    from opnav_workbench.bodies.least_squares import find_jointly, find_least_squares
    from opnav_workbench.bodies.lighting import Lighting, fit_lighting
    from opnav_workbench.bodies.limb_scan.centerfinder import find_limb_scan
    from opnav_workbench.bodies.method import choose_method
    from opnav_workbench.bodies.picture import (
        MEASURED_PSF_SIGMA,
        BodyPicture,
        Circle,
        displaced_model,
        model_picture,
        picture_from_circle,
        standing_at,
        stated_psf_sigma,
    )
    from opnav_workbench.bodies.results import (
        BODY_STATUSES,
        BodyCenter,
        BodyFlag,
        BodyResiduals,
        DiskReading,
        FreeEllipse,
        JointCenters,
        LimbEllipse,
        LimbScans,
        ModelFit,
        SecondReading,
        describe_body_flags,
    )
    from opnav_workbench.bodies.silhouette import Outline, body_outline
    from opnav_workbench.bodies.subarray import SubArray, choose_subarray
    from opnav_workbench.bodies.unresolved import find_unresolved, find_unresolved_body
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "find_cross_correlation": "cross_correlation",
            "find_disk": "disk.centerfinder",
            "judged_disk": "disk.centerfinder",
            "MeasuredDisk": "disk.measurement",
            "measure_disk": "disk.measurement",
            "find_ellipse": "ellipse",
            "find_jointly": "least_squares",
            "find_least_squares": "least_squares",
            "find_limb_scan": "limb_scan.centerfinder",
            "choose_method": "method",
            "MEASURED_PSF_SIGMA": "picture",
            "BodyPicture": "picture",
            "Circle": "picture",
            "displaced_model": "picture",
            "model_picture": "picture",
            "picture_from_circle": "picture",
            "standing_at": "picture",
            "Lighting": "lighting",
            "fit_lighting": "lighting",
            "stated_psf_sigma": "picture",
            "BODY_STATUSES": "results",
            "BodyCenter": "results",
            "BodyFlag": "results",
            "BodyResiduals": "results",
            "DiskReading": "results",
            "FreeEllipse": "results",
            "JointCenters": "results",
            "LimbEllipse": "results",
            "LimbScans": "results",
            "ModelFit": "results",
            "SecondReading": "results",
            "describe_body_flags": "results",
            "Outline": "silhouette",
            "body_outline": "silhouette",
            "SubArray": "subarray",
            "choose_subarray": "subarray",
            "find_unresolved": "unresolved",
            "find_unresolved_body": "unresolved",
        },
    )

__all__ = [
    "BODY_STATUSES",
    "MEASURED_PSF_SIGMA",
    "BodyCenter",
    "BodyFlag",
    "BodyPicture",
    "BodyResiduals",
    "Circle",
    "DiskReading",
    "FreeEllipse",
    "JointCenters",
    "Lighting",
    "LimbEllipse",
    "LimbScans",
    "MeasuredDisk",
    "ModelFit",
    "Outline",
    "SecondReading",
    "SubArray",
    "body_outline",
    "choose_method",
    "choose_subarray",
    "describe_body_flags",
    "displaced_model",
    "find_cross_correlation",
    "find_disk",
    "find_ellipse",
    "find_jointly",
    "find_least_squares",
    "find_limb_scan",
    "find_unresolved",
    "find_unresolved_body",
    "fit_lighting",
    "judged_disk",
    "measure_disk",
    "model_picture",
    "picture_from_circle",
    "standing_at",
    "stated_psf_sigma",
]
