"""SciPy's parts that every picture needs, loaded without what no command has a use for.

As it is loaded, SciPy copies all names of NumPy into a namespace of its own, and so loads all that NumPy has, down to its
compiler of Fortran and its test tools; and it parses some 300 docstrings of `scipy.special` and `scipy.ndimage` to add to
each which array libraries serve the function. Together that is a fifth of a star frame's processor time, and 60 MB that are
not given back. The modules are hidden meanwhile, and the decorator that writes the tables, which does nothing else that
counts outside SciPy's own tests (its words), leaves the documentation as it is. Everything is as it was afterwards. A SciPy
or a NumPy that is made otherwise is loaded as it is.

A command imports this before what navigates.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import ModuleType
from typing import Any

import numpy as np

__all__: list[str] = []

DECORATOR = "xp_capabilities"
UNUSED = (
    "ctypeslib",
    "f2py",
    "ma",
    "polynomial",
    "random",
    "testing",
    "typing",
)  # by SciPy in that namespace


@contextmanager
def _replaced(module: ModuleType, name: str, value: Any) -> Iterator[None]:
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


@contextmanager
def _modules_hidden() -> Iterator[None]:
    public = [name for name in np.__all__ if name not in UNUSED]
    known = [name for name in dir(np) if name not in UNUSED]
    with _replaced(np, "__all__", public), _replaced(np, "__dir__", lambda: known):
        yield


def _as_it_is(**_: Any) -> Callable[[Any], Any]:
    return lambda function: function


def _load() -> None:
    with suppress(ImportError, AttributeError, TypeError), ExitStack() as meanwhile:
        meanwhile.enter_context(_modules_hidden())
        from scipy._lib import _array_api  # noqa: PLC0415

        meanwhile.enter_context(_replaced(_array_api, DECORATOR, _as_it_is))
        import scipy.fft  # noqa: PLC0415
        import scipy.ndimage  # noqa: PLC0415
        import scipy.special  # noqa: F401, PLC0415


if "scipy.special" not in sys.modules:
    _load()
