"""One thread for matrices: those of a picture are small, and threads that wait for each other cost more than they save.

On a machine whose cores are taken, a fit of a disk with two threads took twenty times the processor time of one; on a quiet
one they save nothing. The number that the user's own code sees is as before afterwards.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


class _Limit:
    """The limit that stands while at least one fit runs, in whatever thread: the last one to end lifts it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._running = 0
        self._held: Any = None

    def enter(self) -> None:
        with self._lock:
            if self._running == 0:  # libraries are loaded on demand: looked for anew
                self._held = ThreadpoolController().limit(limits=1, user_api="blas")
            self._running += 1

    def leave(self) -> None:
        with self._lock:
            self._running -= 1
            if self._running == 0:
                self._held.restore_original_limits()
                self._held = None


_LIMIT = _Limit()


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute with one thread of the linear algebra library meanwhile; also a decorator, ``@one_thread()``.

    Examples
    --------
    >>> import numpy as np
    >>> with one_thread():
    ...     np.linalg.inv(2.0 * np.eye(2))
    array([[0.5, 0. ],
           [0. , 0.5]])
    """
    _LIMIT.enter()
    try:
        yield
    finally:
        _LIMIT.leave()
