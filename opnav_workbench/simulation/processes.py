"""Pictures on several processes: each opens what it needs once, then makes picture after picture."""

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from opnav_workbench.errors import OpNavError, SessionError

__all__ = ["in_processes"]

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
    with ProcessPoolExecutor(processes, context, _start, (start, arguments)) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                done(future.result())
        except BrokenProcessPool as error:
            raise SessionError(_died(futures)) from error
        except (OpNavError, KeyboardInterrupt):
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return tuple(future.result() for future in futures)


def _start(start: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which lets this process finish
    start(*arguments)


def _died(futures: Sequence["Future[Any]"]) -> str:
    finished = sum(f.done() and not f.cancelled() and f.exception() is None for f in futures)
    return (
        f"a worker process died after {finished} of {len(futures)} pictures, perhaps for want of memory; "
        "the finished ones are kept. Use fewer --jobs."
    )
