"""One thread for matrices: those of a picture are small, and threads that wait for each other cost more than they save.

On two cores that others use as well, a fit of a disk with two threads took twenty times the processor time of one. The
number that the user's own code sees is as before afterwards.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from opnav_workbench.constants import ONE_THREAD

__all__ = ["begin_with_one", "one_thread"]

_BEGUN_WITH_ONE = False


def begin_with_one() -> None:
    """Have the linear algebra libraries of this process start with one thread each, so that nobody need limit them.

    For a program of its own that has loaded none of them yet; variables that its user has set are let be.
    """
    global _BEGUN_WITH_ONE  # noqa: PLW0603
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    _BEGUN_WITH_ONE = "numpy" not in sys.modules and ONE_THREAD.items() <= os.environ.items()


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute with one thread of the linear algebra library meanwhile; also a decorator, ``@one_thread()``.

    The library has one number for the whole process: where several threads ask, it is the first one's until that ends.

    Examples
    --------
    >>> import numpy as np
    >>> with one_thread():
    ...     np.linalg.inv(2.0 * np.eye(2))
    array([[0.5, 0. ],
           [0. , 0.5]])
    """
    if _BEGUN_WITH_ONE:
        yield
        return
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415

    # Libraries are loaded on demand: looked for anew, in half a millisecond.
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        yield
