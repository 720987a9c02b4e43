"""Calibration of a camera from its own star pictures: pure functions of arrays.

Enter by `calibrate_camera` with `StarPictures` for optics and mounting, by `stack_psf` with `PsfPicture` for the PSF
(undersampled, `learn_effective_psf` with `TeachingPicture`), and by `write_camera_file` to put the result into a camera
file.

``camera_fit``
    `calibrate_camera`: optics and mounting from many star pictures, and what comes out.
``bundle_adjustment``
    The stars of many pictures, the sparse rows they give, and their solution.
``parameters``
    What can be solved for, by name.
``psf_stack``
    `stack_psf`: bright stars of many pictures to an empirical PSF.
``effective_psf``
    `learn_effective_psf`: what the stars of many undersampled pictures say of the PSF that they share.
``camera_file``
    A camera file with some values replaced, its comments kept.
"""

from opnav_workbench.calibration.bundle_adjustment import MIN_STARS, StarPictures
from opnav_workbench.calibration.camera_file import Edit, camera_edits, write_camera_file
from opnav_workbench.calibration.camera_fit import CameraCalibration, calibrate_camera
from opnav_workbench.calibration.effective_psf import (
    MAX_EFFECTIVE_SIGMA_PX,
    TeachingPicture,
    learn_effective_psf,
)
from opnav_workbench.calibration.parameters import MOUNTING, CameraParameters, solvable, with_distortion
from opnav_workbench.calibration.psf_stack import PsfCalibration, PsfPicture, stack_psf

__all__ = [
    "MAX_EFFECTIVE_SIGMA_PX",
    "MIN_STARS",
    "MOUNTING",
    "CameraCalibration",
    "CameraParameters",
    "Edit",
    "PsfCalibration",
    "PsfPicture",
    "StarPictures",
    "TeachingPicture",
    "calibrate_camera",
    "camera_edits",
    "learn_effective_psf",
    "solvable",
    "stack_psf",
    "with_distortion",
    "write_camera_file",
]
