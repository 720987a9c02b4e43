"""Many items on several processes: each process opens what it needs once, then works on item after item."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from typing import Any, TypeVar

from opnav_workbench.errors import OpNavError, SessionError

__all__ = ["in_processes"]

Opened = TypeVar("Opened")
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_processes(
    items: Sequence[Item],
    processes: int,
    opening: Callable[[], AbstractContextManager[Opened]],
    work: Callable[[Opened, Item], Result],
    done: Callable[[Result], None],
    *,
    here: Opened | None = None,
) -> tuple[Result, ...]:
    """Work on items, such as pictures, on several processes; with one process, or one item, in this one.

    Parameters
    ----------
    processes
        At most so many.
    opening
        Gives the context manager that every process enters once, for all its items. As `work`, it must be a function
        of a module, or a `functools.partial` of one, for the other processes to know it.
    work
        From what the process has opened and an item to the item's result.
    done
        Called in this process with each result as soon as it stands, in any order.
    here
        What this process has opened already, in place of `opening` where it does the work itself.

    Returns
    -------
    tuple
        The results, in the order of the items.

    Raises
    ------
    OpNavError
        Of an item; what had not begun is left.
    SessionError
        A process died.
    """
    if not items:
        return ()
    if min(processes, len(items)) == 1:
        with opening() if here is None else contextlib.nullcontext(here) as opened:
            return tuple(_reported(work(opened, item), done) for item in items)
    # Spawned, not forked: SPICE's pool and numpy's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(items)), context, _start_process, (opening,)) as pool:
        futures = [pool.submit(_work_in_process, work, item) for item in items]
        try:
            for future in as_completed(futures):
                done(future.result())
        except BrokenProcessPool as error:
            raise SessionError(_death_message(futures)) from error
        except (OpNavError, KeyboardInterrupt):
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return tuple(future.result() for future in futures)


def _reported(result: Result, done: Callable[[Result], None]) -> Result:
    done(result)
    return result


_OPENED: list[Any] = []  # of a started process: what it has opened, for as long as it lives
_OPEN = contextlib.ExitStack()


def _start_process(opening: Callable[[], AbstractContextManager[Any]]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which lets this process finish
    _OPENED.append(_OPEN.enter_context(opening()))


def _work_in_process(work: Callable[[Any, Item], Result], item: Item) -> Result:
    return work(_OPENED[0], item)


def _death_message(futures: Sequence["Future[Any]"]) -> str:
    finished = sum(f.done() and not f.cancelled() and f.exception() is None for f in futures)
    return (
        f"a worker process died after {finished} of {len(futures)} pictures, perhaps for want of memory; "
        "the finished ones are kept. Use fewer --jobs."
    )
