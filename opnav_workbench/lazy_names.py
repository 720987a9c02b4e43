"""Modules, and names of packages, that are loaded when they are first used, so that a start loads what it needs."""

import gc
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["module_on_demand", "names_on_demand"]


def names_on_demand(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package; a name that was used once is then found without it.

    Parameters
    ----------
    package
        Its ``__name__``.
    homes
        Module of each name, relative to the package; no name may be that of a module, which would take its place.

    Examples
    --------
    >>> names_on_demand("email", {"Message": "message"})("Message")
    <class 'email.message.Message'>
    >>> names_on_demand("email", {})("letter")
    Traceback (most recent call last):
    AttributeError: module 'email' has no attribute 'letter'
    """
    assert not homes.keys() & set(homes.values())

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(_imported(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return load


def module_on_demand(module: str) -> Any:
    """Return what stands for a module, and loads it when something of it is first used.

    For what few pictures need of a library or of this package; types know the module by an import under `TYPE_CHECKING`.

    Examples
    --------
    >>> module_on_demand("email.message").Message
    <class 'email.message.Message'>
    """
    return _ModuleOnDemand(module)


class _ModuleOnDemand:
    __slots__ = ("_module",)

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.modules.get(self._module) or _imported(self._module), name)


def _imported(module: str) -> ModuleType:
    """Import while the garbage collector rests: what imports make stays, and looking through it takes a seventh."""
    collects = gc.isenabled()
    gc.disable()
    try:
        return import_module(module)
    finally:
        if collects:
            gc.enable()
