"""Calibration of a camera from its own star frames: pure functions of arrays.

frames       the stars of many frames                  parameters   what is solved for, by name
design       the linearized problem, sparse            arrow        its solution, and what it leaves open
camera_fit   `calibrate_camera`: optics and mounting   results      what comes out
camera_file  a camera file with the new values         psf_stack    `stack_psf`: bright stars to an empirical PSF
psf_frames   the pictures for it
"""

from opnav_workbench.calibration.camera_file import Edit, camera_edits, write_camera_file
from opnav_workbench.calibration.camera_fit import calibrate_camera
from opnav_workbench.calibration.frames import MIN_STARS, StarFrames
from opnav_workbench.calibration.parameters import MOUNTING, CameraParameters, solvable, with_distortion
from opnav_workbench.calibration.psf_frames import PsfFrame
from opnav_workbench.calibration.psf_stack import stack_psf
from opnav_workbench.calibration.results import CameraCalibration, PsfCalibration

__all__ = [
    "MIN_STARS",
    "MOUNTING",
    "CameraCalibration",
    "CameraParameters",
    "Edit",
    "PsfCalibration",
    "PsfFrame",
    "StarFrames",
    "calibrate_camera",
    "camera_edits",
    "solvable",
    "stack_psf",
    "with_distortion",
    "write_camera_file",
]
