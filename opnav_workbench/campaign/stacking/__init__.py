"""Stacks for faint targets: many repointed pictures on one grid, and the target's center in their mean.

Enter by `pictures_of_runs`, then `stack_pictures`, `find_in_stack` and `write_stack`.

``pictures``
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
from opnav_workbench.campaign.stacking.combining import Stacked, stack_pictures
from opnav_workbench.campaign.stacking.grid import Grid
from opnav_workbench.campaign.stacking.pictures import (
    RunPictures,
    StackPicture,
    picture_of_session,
    pictures_of_runs,
)
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
    "RunPictures",
    "StackPicture",
    "StackProducts",
    "Stacked",
    "find_in_stack",
    "fit_point",
    "picture_of_session",
    "pictures_of_runs",
    "snr_growth",
    "stack_attitude_covariance",
    "stack_observable",
    "stack_pictures",
    "write_stack",
]
