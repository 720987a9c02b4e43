"""The target at a stack's epoch: its state interpolated between the pictures that were stacked."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from opnav_workbench.bodies import TargetState
from opnav_workbench.campaign.stacking.frames import StackFrame

__all__ = ["mean_state"]

MAX_DEGREE = 3  # of the polynomial in time: orbits bend slowly over a stack


def mean_state(frames: Sequence[StackFrame], et: float) -> TargetState:
    """Return the target at `et`; its other properties are those of the nearest picture."""
    times = np.array([frame.et for frame in frames])
    states = [frame.target for frame in frames]
    known = [state for state in states if state is not None]
    nearest = known[int(np.argmin(np.abs(times - et)))]
    span = float(np.ptp(times))
    if span == 0.0:
        return nearest
    x = (times - et) / span
    degree = min(MAX_DEGREE, len(np.unique(times)) - 1)
    powers = np.vander(x, degree + 1, increasing=True)
    position = np.linalg.lstsq(powers, np.array([s.position_km for s in known]), rcond=None)[0][0]
    return replace(nearest, position_km=position)
