"""A scenario's pictures, one after the other or on several processes; the bytes are the same either way.

What can be wrong with a scenario is checked for every picture before the first is made. Each picture is written whole
or not at all, so what is finished when a run is stopped stays, and is good.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from opnav_workbench.errors import MissionError
from opnav_workbench.files import make_folder
from opnav_workbench.simulation.output import PictureReport, write_picture
from opnav_workbench.simulation.picture import expose_picture
from opnav_workbench.simulation.processes import in_processes
from opnav_workbench.simulation.scenario import PictureScenario
from opnav_workbench.simulation.workshop import Task, Workshop, at
from opnav_workbench.spice import KernelSet

__all__ = ["simulate"]


def simulate(
    scenario: PictureScenario,
    out: Path,
    *,
    jobs: int = 1,
    only: Sequence[str] = (),
    done: Callable[[PictureReport], None] = lambda _: None,
) -> tuple[PictureReport, ...]:
    """Simulate the pictures of a scenario and write them.

    Parameters
    ----------
    scenario : PictureScenario
    out : Path
        Folder; gets for every picture ``NAME.fit``, its truth and its preview.
    jobs : int
        Processes. A script that asks for more than one must guard its main part (``if __name__ == "__main__"``).
    only : sequence of str
        Names of pictures (of a series: its name, or that of one of its pictures); none: all.
    done : callable
        Called with each picture's report as soon as it stands, in any order.

    Returns
    -------
    tuple of PictureReport
        In the scenario's order.

    Raises
    ------
    MissionError, KernelError, CameraError, CatalogError
        The scenario asks for something that there is not; nothing has been written.
    SessionError
        The folder cannot be written any more; finished pictures stay.
    """
    if jobs < 1:
        raise MissionError(f"{jobs} jobs; give 1 or more.")
    tasks = chosen_tasks(scenario, only)
    with _opened(scenario) as workshop:
        workshop.check(tasks)
        make_folder(out)
        if min(jobs, len(tasks)) == 1:
            return tuple(_reported(_make(workshop, task, out), done) for task in tasks)
    return in_processes(tasks, min(jobs, len(tasks)), _start, (scenario, _active_kernels(), out), _work, done)


def chosen_tasks(scenario: PictureScenario, only: Sequence[str]) -> tuple[Task, ...]:
    """Return the pictures to make.

    Raises
    ------
    MissionError
        A name in `only` is that of no picture.
    """
    tasks = [
        (entry.name, Task(index, picture))
        for index, entry in enumerate(scenario.pictures)
        for picture in entry.expanded()
    ]
    names = {name for series, task in tasks for name in (series, task.picture.name)}
    unknown = [name for name in only if name not in names]
    if unknown:
        offered = ", ".join(dict.fromkeys(series for series, _ in tasks))
        raise MissionError(f"no picture named {', '.join(unknown)} in this scenario; it has {offered}.")
    return tuple(task for series, task in tasks if not only or {series, task.picture.name} & set(only))


@contextlib.contextmanager
def _opened(scenario: PictureScenario, kernels: Sequence[Path] = ()) -> Iterator[Workshop]:
    """Open kernels and catalog; kernels of the caller serve a scenario that names none."""
    with contextlib.ExitStack() as stack:
        source = scenario.kernel_source()
        if source is not None:
            with at(scenario, ("kernels",)):
                stack.enter_context(KernelSet(source))
        elif kernels:
            stack.enter_context(KernelSet(kernels))
        elif KernelSet.active() is None:
            raise scenario.fault(
                ("kernels",), "the scenario names no kernels, and none are loaded; name a set"
            )
        yield Workshop.open(scenario)


def _active_kernels() -> tuple[Path, ...]:
    """Return the caller's kernels, so that other processes can open them too; metakernels are followed by theirs."""
    active = KernelSet.active()
    return () if active is None else tuple(k.path for k in active.kernels() if k.kind != "META")


def _make(workshop: Workshop, task: Task, out: Path) -> PictureReport:
    picture = expose_picture(workshop.inputs(task))
    return write_picture(picture, workshop.mission, out, task.picture.stretch, workshop.settings(task))


def _reported(report: PictureReport, done: Callable[[PictureReport], None]) -> PictureReport:
    done(report)
    return report


# -- several processes ---------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Worker:
    """What one process keeps from picture to picture."""

    stack: contextlib.ExitStack
    workshop: Workshop
    out: Path


_WORKERS: list[_Worker] = []  # of this process: one, once it has started


def _start(scenario: PictureScenario, kernels: Sequence[Path], out: Path) -> None:
    stack = contextlib.ExitStack()
    _WORKERS.append(_Worker(stack, stack.enter_context(_opened(scenario, kernels)), out))


def _work(task: Task) -> PictureReport:
    worker = _WORKERS[0]
    return _make(worker.workshop, task, worker.out)
