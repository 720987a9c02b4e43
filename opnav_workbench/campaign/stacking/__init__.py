"""Stacks for faint targets: many repointed pictures on one grid, and the target's center in their mean.

Enter by `frames_of_runs`, then `stack_frames`, `find_in_stack` and `write_stack`.

``frames``
    Solved pictures, their weights, and how they come from run folders.
``grid``
    The grid that follows stars or target, and cubic convolution onto it, its noise known.
``subtraction``
    Star fields taken away.
``combining``
    The stack: hits masked, weighted mean, the target at the mean epoch.
``centers``
    The target's center and its sigma; signal-to-noise against pictures.
``products``
    The center as an observable; FITS, result and observables on disk.
"""

from opnav_workbench.campaign.stacking.centers import Growth, PointFit, find_in_stack, fit_point, snr_growth
from opnav_workbench.campaign.stacking.combining import Stacked, stack_frames
from opnav_workbench.campaign.stacking.frames import RunFrames, StackFrame, frame_of_session, frames_of_runs
from opnav_workbench.campaign.stacking.grid import Grid
from opnav_workbench.campaign.stacking.products import (
    StackProducts,
    stack_attitude_covariance,
    stack_observable,
    write_stack,
)

__all__ = [
    "Grid",
    "Growth",
    "PointFit",
    "RunFrames",
    "StackFrame",
    "StackProducts",
    "Stacked",
    "find_in_stack",
    "fit_point",
    "frame_of_session",
    "frames_of_runs",
    "snr_growth",
    "stack_attitude_covariance",
    "stack_frames",
    "stack_observable",
    "write_stack",
]
