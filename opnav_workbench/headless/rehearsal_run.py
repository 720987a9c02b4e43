"""The blind run of a rehearsal: every picture of a package processed with the package's own kernels, nobody looking.

A picture that is lost, damaged or cannot be solved is an outcome with its reason, never a stop.
"""

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_value, make_folder, sha256_of, text_of
from opnav_workbench.processes import in_processes
from opnav_workbench.processing import OpenedProcessing, Outcome, Processing, process_image
from opnav_workbench.processing.carrying import may_take_pointing
from opnav_workbench.processing.pictures import with_carried
from opnav_workbench.rehearsal.package import OrtPackage
from opnav_workbench.session import RESULT_FILE, Settings

__all__ = ["package_processing", "process_package"]

CARRY_WITHIN_S = 60.0  # pairs in orbit: a long exposure for its stars, and a short one for the surface

CARRY_WITHIN_S = 60.0  # pairs in orbit: a long exposure for its stars, and a short one for the surface
# A surface that fills a picture has thousands of detections and no star: the attitude is known, the sky is not searched.
NO_WIDE_SEARCH: dict[str, float | int] = {"wider_shift_px": 0.0, "widest_shift_px": 0.0, "lost_detections": 0}

OutcomeCallback = Callable[[Outcome], None]


def process_package(
    package: OrtPackage,
    out: str | Path,
    *,
    how: Processing | None = None,
    jobs: int = 1,
    again: bool = False,
    done: OutcomeCallback = lambda _outcome: None,
) -> tuple[Outcome, ...]:
    """Process the pictures of a rehearsal and write ``OUT/<picture>/`` for each.

    What has a result already, an analyst's above all, is left as it is.

    Parameters
    ----------
    how
        Default `package_processing`.
    jobs
        Processes. A script that asks for more than one must guard its main part (``if __name__ == "__main__"``).
    again
        Process all of them anew.
    done : callable
        Called with each outcome as soon as it stands, in any order.

    Returns
    -------
    tuple of Outcome
        In the package's order.

    Raises
    ------
    KernelError, CatalogError, SessionError
        Kernels or catalog cannot be opened, or `out` cannot be written.
    """
    if jobs < 1:
        raise SessionError(f"{jobs} jobs; give 1 or more.")
    folder = make_folder(out)
    options = how or package_processing(package)
    paths = [picture.path for picture in package.pictures]
    kept = (
        {}
        if again
        else {path: outcome for path in paths if (outcome := _earlier_outcome(path, folder)) is not None}
    )
    settings = Settings.from_dict(dict(options.settings))

    def told(outcome: Outcome) -> None:
        if not may_take_pointing(outcome.result, settings):  # else when its neighbors are done too
            done(outcome)

    for outcome in kept.values():
        told(outcome)
    left = [path for path in paths if path not in kept]
    opening = partial(_opened, options)
    work = partial(_process_picture, out=folder)
    made = in_processes(left, jobs, opening, work, told)
    found = kept | dict(zip(left, made, strict=True))
    outcomes = tuple(found[path] for path in paths)
    waiting = [outcome for outcome in outcomes if may_take_pointing(outcome.result, settings)]
    if not waiting:
        return outcomes
    with _opened(options) as opened:
        outcomes = with_carried(outcomes, opened)
    for path, outcome in zip(paths, outcomes, strict=True):
        if may_take_pointing(found[path].result, settings):
            done(outcome)
    return outcomes


def _earlier_outcome(path: Path, out: Path) -> Outcome | None:
    """Return what was made of a picture before; None where nothing, or of another picture of that name."""
    folder = out / path.stem
    try:
        result = json_value(text_of(folder / RESULT_FILE))
        same = result["sha256"] == sha256_of(path)
        reason = "; ".join(result["messages"]) if result["status"] == "failed" else ""
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Outcome(path, folder, result, reason) if same else None


@contextlib.contextmanager
def _opened(how: Processing) -> Iterator[OpenedProcessing]:
    with how.kernel_set():
        yield how.opened()


def _process_picture(opened: OpenedProcessing, path: Path, out: Path) -> Outcome:
    return process_image(path, opened, out)


def package_processing(package: OrtPackage) -> Processing:
    """Return how the pictures of a package are processed, if nobody says otherwise."""
    how = Processing(
        mission=package.mission,
        kernels=str(package.metakernel),
        catalog=package.catalog,
        targets=package.targets,
    )
    if package.orbit is None:
        return how
    body = package.orbit.body
    return how.changed(
        shapes={body: str(package.maps["shape"])},
        landmarks={body: str(package.maps["maplets"])},
        settings={"carry_within_s": CARRY_WITHIN_S, **NO_WIDE_SEARCH},
    )
