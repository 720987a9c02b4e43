"""Camera models: what a frame camera does to a direction, and what is known about the camera beforehand.

Enter by `Camera`: `Camera.from_yaml` for a camera file, `Camera.from_ik` for a SPICE instrument kernel.

``model``
    `Camera`: direction to (pixel, line) and back, with Jacobians; place on the detector to the sky.
``distortion``
    The distortion models, one direction as published, the other by Newton's method, and how far each holds.
``lens_models``
    More of them: radial as in ISIS, polynomials, fisheye, CAHVOR.
``reseau``
    Marks on a vidicon's faceplate.
``reseau_fit``
    The distortion of a raw vidicon picture, from its marks.
``response``
    `CameraResponse`: what a camera makes of light; magnitudes to electrons.
``rows``
    Lines exposed at times of their own: rolling shutters and line scanners, and the camera's turn meanwhile.
``priors``
    What is believed of PSF, attitude and exposures before pictures are measured.
``camera_file``
    The schema of camera files, and reading one.
``readout``
    A camera in one readout: windows and binning.
``cahvor``
    Cameras from the vectors of CAHV, CAHVOR and CAHVORE models.
``support_data``
    Community Sensor Model image support data: camera, attitude and states of one picture, read and written.
``saving``
    Cameras into camera files.
``origins``
    Which values were known, derived or guessed.
``instrument_kernel``
    Cameras from the ``INS<id>_*`` variables of SPICE instrument kernels.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.camera.distortion import (
        BrownDistortion,
        Distortion,
        ForwardSipDistortion,
        LegendreDistortion,
        NoDistortion,
        OwenDistortion,
        SipDistortion,
    )
    from opnav_workbench.camera.lens_models import (
        CahvorDistortion,
        FisheyeDistortion,
        RadialDistortion,
        RationalDistortion,
        TaylorDistortion,
    )
    from opnav_workbench.camera.model import Camera
    from opnav_workbench.camera.origins import Origin
    from opnav_workbench.camera.priors import AttitudeSigma, ExposureLimits, PsfPrior
    from opnav_workbench.camera.readout import read_out
    from opnav_workbench.camera.reseau import Reseau
    from opnav_workbench.camera.reseau_fit import ReseauFit, fit_reseau
    from opnav_workbench.camera.response import UNKNOWN_COLOR, CameraResponse
    from opnav_workbench.camera.rows import RowSweep, RowTiming, row_sweep
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "BrownDistortion": "distortion",
            "Distortion": "distortion",
            "ForwardSipDistortion": "distortion",
            "LegendreDistortion": "distortion",
            "NoDistortion": "distortion",
            "OwenDistortion": "distortion",
            "SipDistortion": "distortion",
            "CahvorDistortion": "lens_models",
            "FisheyeDistortion": "lens_models",
            "RadialDistortion": "lens_models",
            "RationalDistortion": "lens_models",
            "TaylorDistortion": "lens_models",
            "Camera": "model",
            "Origin": "origins",
            "AttitudeSigma": "priors",
            "ExposureLimits": "priors",
            "PsfPrior": "priors",
            "read_out": "readout",
            "UNKNOWN_COLOR": "response",
            "CameraResponse": "response",
            "RowSweep": "rows",
            "RowTiming": "rows",
            "Reseau": "reseau",
            "ReseauFit": "reseau_fit",
            "fit_reseau": "reseau_fit",
            "row_sweep": "rows",
        },
    )

__all__ = [
    "UNKNOWN_COLOR",
    "AttitudeSigma",
    "BrownDistortion",
    "CahvorDistortion",
    "Camera",
    "CameraResponse",
    "Distortion",
    "ExposureLimits",
    "FisheyeDistortion",
    "ForwardSipDistortion",
    "LegendreDistortion",
    "NoDistortion",
    "Origin",
    "OwenDistortion",
    "PsfPrior",
    "RadialDistortion",
    "RationalDistortion",
    "Reseau",
    "ReseauFit",
    "RowSweep",
    "RowTiming",
    "SipDistortion",
    "TaylorDistortion",
    "fit_reseau",
    "read_out",
    "row_sweep",
]
