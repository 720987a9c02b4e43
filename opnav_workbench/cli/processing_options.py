"""The options that say how pictures are processed: the fields of `Processing`, the same for every command.

A command that is decorated with `processing_options` has a parameter ``given``: what was typed of them, by the field's
name.  `processing_of` makes a `Processing` of it, `with_options` lets it outrank what a file says.
"""

import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from pydantic.fields import FieldInfo

from opnav_workbench.errors import SessionError
from opnav_workbench.processing.model import Processing, allowed_values

__all__ = ["processing_of", "processing_options", "with_options"]

GIVEN = "given"
NO_OPTIONS = ("methods",)  # a target's own method stands with it: --targets PLUTO:limb_scan
SHORT_NAMES = {"mission": "-m"}

Command = Callable[..., None]
How = TypeVar("How", bound=Processing)


def processing_options(*, without: Collection[str] = ()) -> Callable[[Command], Command]:
    """Return a decorator that puts the options in place of a command's parameter ``given``.

    Parameters
    ----------
    without : collection of str
        Fields that the command settles itself.
    """
    fields = {
        name: field
        for name, field in Processing.model_fields.items()
        if name not in without and name not in NO_OPTIONS
    }

    def decorated(command: Command) -> Command:
        @functools.wraps(command)
        def with_options(*arguments: Any, **values: Any) -> None:
            typed = {name: values.pop(name, None) for name in fields}
            command(*arguments, **values, **{GIVEN: {n: v for n, v in typed.items() if v is not None}})

        own = inspect.signature(command, eval_str=True)
        parameters: list[inspect.Parameter] = []
        for parameter in own.parameters.values():
            parameters += _options(fields) if parameter.name == GIVEN else [parameter]
        with_options.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": None}
        return with_options

    return decorated


def _options(fields: Mapping[str, FieldInfo]) -> list[inspect.Parameter]:
    return [
        inspect.Parameter(
            name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=_option(name, field)
        )
        for name, field in fields.items()
    ]


def _option(name: str, field: FieldInfo) -> Any:
    flag = "--" + name.replace("_", "-")
    allowed = allowed_values(name)
    words = f"{field.description}: {' | '.join(allowed)}" if allowed else str(field.description)
    default = field.default if isinstance(field.default, str) else False
    kind = Path if name in Processing.path_fields else str
    short = [SHORT_NAMES[name]] if name in SHORT_NAMES else []
    return Annotated[kind | None, typer.Option(flag, *short, help=words, show_default=default)]


def processing_of(given: Mapping[str, Any]) -> Processing:
    """Return how pictures are processed, from what was typed.

    Raises
    ------
    SessionError
        The mission is missing, or a value is not allowed: one line with the option and what may stand there.
    """
    if not given.get("mission"):
        raise SessionError(
            "--mission is missing; give --mission with the mission's name (new_horizons) or its YAML file. "
            "opnav doctor lists the missions found."
        )
    return Processing.checked(given, "options")


def with_options(how: How, given: Mapping[str, Any]) -> How:
    """Return how pictures are processed with what was typed in place of what a file says; typed paths count from here.

    Raises
    ------
    SessionError
        As `processing_of`.
    """
    typed = Processing.checked({"mission": how.mission, **given}, "options").with_full_paths()
    paths = {
        name: getattr(typed, name)
        for name in ("mission", "kernels", "shapes", *typed.path_fields)
        if name in given
    }
    return how.changed("options", **{**given, **paths})
