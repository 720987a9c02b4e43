"""SciPy's parts that every picture needs, loaded without the tables that it would write into its documentation.

As they are imported, `scipy.special` and `scipy.ndimage` parse some 300 docstrings and add to each which array libraries
serve the function. It takes a tenth of a star frame's processor time and 60 MB that are not given back, and nobody reads it
in a command. The decorator that writes them does nothing else that counts outside SciPy's own tests (its words). A SciPy
that has no such decorator is loaded as it is.

A command imports this before what navigates.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

__all__: list[str] = []

DECORATOR = "xp_capabilities"


def _as_it_is(**_: Any) -> Callable[[Any], Any]:
    return lambda function: function


@contextmanager
def _documentation_as_written() -> Iterator[None]:
    from scipy._lib import _array_api  # noqa: PLC0415

    written = getattr(_array_api, DECORATOR)
    setattr(_array_api, DECORATOR, _as_it_is)
    try:
        yield
    finally:
        setattr(_array_api, DECORATOR, written)


with suppress(ImportError, AttributeError, TypeError), _documentation_as_written():
    import scipy.fft
    import scipy.ndimage
    import scipy.special  # noqa: F401
