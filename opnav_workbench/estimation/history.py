"""The B-plane against the time of data cutoff: what was known of the flyby after each picture.

Every point is a solution of its own, from the pictures so far: linearized about its own states, with its own outliers, as
the team would have had it that day. It shows whether solutions walk within their ellipses, and when pictures cease to help.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.bplane import BPlaneSolution, map_to_b_plane
from opnav_workbench.estimation.sequential import Edit, filter_estimate
from opnav_workbench.observables import Observable

__all__ = ["BPlaneCutoff", "b_plane_history"]


@dataclass(frozen=True, slots=True, eq=False)
class BPlaneCutoff:
    """The flyby as known from the pictures up to one.

    Attributes
    ----------
    image, cutoff_et
        Last picture counted, and its time.
    pictures
        How many are counted.
    solution
        None where they do not determine it, or contradict each other.
    edits
        Measurements left out, and taken in again.
    reason
        Why there is no solution.
    """

    image: str
    cutoff_et: float
    pictures: int
    solution: BPlaneSolution | None
    edits: tuple[Edit, ...] = ()
    reason: str = ""


def b_plane_history(
    observables: Sequence[Observable],
    parameters: Sequence[str],
    position_km: ArrayLike,
    velocity_km_s: ArrayLike,
    gm_km3_s2: float = 0.0,
    *,
    epoch_et: float,
    pole: str | ArrayLike = "ecliptic",
    body: str = "",
    **options: Any,
) -> tuple[BPlaneCutoff, ...]:
    """Solve again after every picture and map each solution to the B-plane.

    Parameters
    ----------
    observables, parameters
        As in `filter_estimate`.
    position_km, velocity_km_s : (3,) array_like
        A priori spacecraft relative to the body at the epoch, J2000, geometric.
    gm_km3_s2, pole, body
        As in `map_to_b_plane`.
    epoch_et
        Of that state and of the corrections.
    **options
        Of `filter_estimate`: ``a_priori``, ``accelerations``, ``consider``, ``until_et`` and so on.

    Returns
    -------
    tuple of BPlaneCutoff
        One for each picture with a usable center, in order of time; all in the axes of the a priori flyby.

    Raises
    ------
    EstimationError
        No picture gives a solution; the last one's reason.
    """
    usable = [o for o in observables if o.has_residual and o.status in options.get("statuses", ("ok",))]
    times = sorted({(o.et, o.image) for o in usable})
    found = []
    for count, (et, image) in enumerate(times, start=1):
        so_far = [o for o in usable if (o.et, o.image) <= (et, image)]
        try:
            result = filter_estimate(so_far, parameters, epoch_et=epoch_et, **options)
            mapped = map_to_b_plane(result, position_km, velocity_km_s, gm_km3_s2, pole=pole, body=body)
            found.append(BPlaneCutoff(image, et, count, mapped, result.edits))
        except EstimationError as error:
            found.append(BPlaneCutoff(image, et, count, None, reason=str(error)))
    if not any(cutoff.solution for cutoff in found):
        reason = found[-1].reason if found else f"none of {len(observables)} observables is usable."
        raise EstimationError(f"no data cutoff gives a flyby; the last: {reason}")
    return tuple(found)
