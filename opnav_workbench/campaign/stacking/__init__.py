"""Stacks for faint targets: many repointed pictures on one grid, and the target's center in their mean.

frames       solved pictures and their weights           epoch         the target at the stack's mean epoch
grid         pixels that follow the stars or the target  resampling    cubic convolution, its noise known
hits         cosmic rays masked                          subtraction   star fields taken away
combining    the stack                                   centers       the target's center and its sigma
growth       signal-to-noise against pictures            observables   the center at the mean epoch
runs         pictures from run folders                   products      FITS, result and observables on disk
"""

from opnav_workbench.campaign.stacking.centers import PointFit, find_in_stack, fit_point
from opnav_workbench.campaign.stacking.combining import Stacked, stack_frames
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.campaign.stacking.grid import Grid
from opnav_workbench.campaign.stacking.growth import Growth, snr_growth
from opnav_workbench.campaign.stacking.observables import stack_attitude_covariance, stack_observable
from opnav_workbench.campaign.stacking.products import StackProducts, write_stack
from opnav_workbench.campaign.stacking.runs import RunFrames, frame_of_session, frames_of_runs

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
