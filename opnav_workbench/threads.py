"""One thread for matrices: those of a picture are small, and threads that wait for each other cost more than they save.

On two cores that others use as well, a fit of a disk with two threads took twenty times the processor time of one. The
number that the user's own code sees is as before afterwards.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


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
    # Libraries are loaded on demand: looked for anew, in half a millisecond.
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        yield
