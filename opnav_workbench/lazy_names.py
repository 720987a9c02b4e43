"""Names of a package whose modules are loaded when a name is first used, so that a start loads what it needs."""

import gc
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["names_on_demand"]


def names_on_demand(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package; a name that was used once is then found without it.

    Parameters
    ----------
    package
        Its ``__name__``.
    homes
        Module of each name, relative to the package.

    Examples
    --------
    >>> names_on_demand("email", {"Message": "message"})("Message")
    <class 'email.message.Message'>
    >>> names_on_demand("email", {})("letter")
    Traceback (most recent call last):
    AttributeError: module 'email' has no attribute 'letter'
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(_imported(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return load


def _imported(module: str) -> ModuleType:
    """Import while the garbage collector rests: what imports make stays, and looking through it takes a seventh."""
    collects = gc.isenabled()
    gc.disable()
    try:
        return import_module(module)
    finally:
        if collects:
            gc.enable()
