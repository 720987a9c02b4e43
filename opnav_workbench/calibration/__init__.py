"""Calibration of a camera from its own star pictures: pure functions of arrays.

Enter by `calibrate_camera` with `StarPictures` for optics and mounting, by `stack_psf` with `PsfPicture` for the PSF, and by
`write_camera_file` to put the result into a camera file.

``camera_fit``
    `calibrate_camera`: optics and mounting from many star pictures, and what comes out.
``bundle_adjustment``
    The stars of many pictures, the sparse rows they give, and their solution.
``parameters``
    What can be solved for, by name.
``psf_stack``
    `stack_psf`: bright stars of many pictures to an empirical PSF.
``camera_file``
    A camera file with some values replaced, its comments kept.
"""

from opnav_workbench.calibration.bundle_adjustment import MIN_STARS, StarPictures
from opnav_workbench.calibration.camera_file import Edit, camera_edits, write_camera_file
from opnav_workbench.calibration.camera_fit import CameraCalibration, calibrate_camera
from opnav_workbench.calibration.parameters import MOUNTING, CameraParameters, solvable, with_distortion
from opnav_workbench.calibration.psf_stack import PsfCalibration, PsfPicture, stack_psf

__all__ = [
    "MIN_STARS",
    "MOUNTING",
    "CameraCalibration",
    "CameraParameters",
    "Edit",
    "PsfCalibration",
    "PsfPicture",
    "StarPictures",
    "calibrate_camera",
    "camera_edits",
    "solvable",
    "stack_psf",
    "with_distortion",
    "write_camera_file",
]
