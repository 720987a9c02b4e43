"""A scenario's pictures, one after the other or on several processes; the bytes are the same either way.

What can be wrong with a scenario is checked for every picture before the first is made. Each picture is written
whole or not at all, so what is finished when a run is stopped stays, and is good. `in_processes` serves whatever
makes or analyses pictures in a batch: each process opens what it needs once, then makes picture after picture.
"""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from opnav_workbench.errors import MissionError, OpNavError, SessionError
from opnav_workbench.files import make_folder
from opnav_workbench.kernels import KernelSet
from opnav_workbench.simulation.opened_scenario import OpenedScenario, ScenarioPicture, naming_field
from opnav_workbench.simulation.output import PictureReport, write_picture
from opnav_workbench.simulation.picture import expose_picture
from opnav_workbench.simulation.scenario import PictureScenario

__all__ = ["in_processes", "simulate"]


# ---- Pictures on several processes: each opens what it needs once, then makes picture after picture.

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_processes(
    jobs: Sequence[Job],
    processes: int,
    start: Callable[..., None],
    arguments: tuple[Any, ...],
    work: Callable[[Job], Result],
    done: Callable[[Result], None],
) -> tuple[Result, ...]:
    """Do jobs on several processes.

    Parameters
    ----------
    jobs : sequence
        One a picture.
    processes : int
    start : callable
        Called once in each process with `arguments`; a function of a module, as `work` is.
    work : callable
        From a job to its result.
    done : callable
        Called here with each result as soon as it stands, in any order.

    Returns
    -------
    tuple
        The results, in the order of the jobs.

    Raises
    ------
    OpNavError
        Of a job; what had not begun is left.
    SessionError
        A process died.
    """
    # Spawned, not forked: SPICE's pool and numpy's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _start_process, (start, arguments)) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                done(future.result())
        except BrokenProcessPool as error:
            raise SessionError(_death_message(futures)) from error
        except (OpNavError, KeyboardInterrupt):
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return tuple(future.result() for future in futures)


def _start_process(start: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which lets this process finish
    start(*arguments)


def _death_message(futures: Sequence["Future[Any]"]) -> str:
    finished = sum(f.done() and not f.cancelled() and f.exception() is None for f in futures)
    return (
        f"a worker process died after {finished} of {len(futures)} pictures, perhaps for want of memory; "
        "the finished ones are kept. Use fewer --jobs."
    )


# ---- A scenario's pictures, one after the other or on several processes; the bytes are the same either way.


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
    tasks = chosen_pictures(scenario, only)
    with _scenario_opened(scenario) as workshop:
        workshop.check(tasks)
        make_folder(out)
        if min(jobs, len(tasks)) == 1:
            return tuple(_reported(_make_picture(workshop, task, out), done) for task in tasks)
    return in_processes(
        tasks,
        min(jobs, len(tasks)),
        _start_worker,
        (scenario, _active_kernels(), out),
        _work_on_picture,
        done,
    )


def chosen_pictures(scenario: PictureScenario, only: Sequence[str]) -> tuple[ScenarioPicture, ...]:
    """Return the pictures to make.

    Raises
    ------
    MissionError
        A name in `only` is that of no picture.
    """
    tasks = [
        (entry.name, ScenarioPicture(index, picture))
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
def _scenario_opened(scenario: PictureScenario, kernels: Sequence[Path] = ()) -> Iterator[OpenedScenario]:
    """Open kernels and catalog; kernels of the caller serve a scenario that names none."""
    with contextlib.ExitStack() as stack:
        source = scenario.kernel_source()
        if source is not None:
            with naming_field(scenario, ("kernels",)):
                stack.enter_context(KernelSet(source))
        elif kernels:
            stack.enter_context(KernelSet(kernels))
        elif KernelSet.active() is None:
            raise scenario.fault(
                ("kernels",), "the scenario names no kernels, and none are loaded; name a set"
            )
        yield OpenedScenario.open(scenario)


def _active_kernels() -> tuple[Path, ...]:
    """Return the caller's kernels, so that other processes can open them too; metakernels are followed by theirs."""
    active = KernelSet.active()
    return () if active is None else tuple(k.path for k in active.kernels() if k.kind != "META")


def _make_picture(workshop: OpenedScenario, task: ScenarioPicture, out: Path) -> PictureReport:
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
    workshop: OpenedScenario
    out: Path


_WORKERS: list[_Worker] = []  # of this process: one, once it has started


def _start_worker(scenario: PictureScenario, kernels: Sequence[Path], out: Path) -> None:
    stack = contextlib.ExitStack()
    _WORKERS.append(_Worker(stack, stack.enter_context(_scenario_opened(scenario, kernels)), out))


def _work_on_picture(task: ScenarioPicture) -> PictureReport:
    worker = _WORKERS[0]
    return _make_picture(worker.workshop, task, worker.out)
