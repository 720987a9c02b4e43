"""YAML files into validated models, with errors that name the file, the line, the field and what is allowed."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetJsonSchemaHandler,
    StringConstraints,
    ValidationError,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from opnav_workbench.errors import OpNavError
from opnav_workbench.format_versions import FORMAT_KEY, as_of_today, unstamped
from opnav_workbench.yaml_nodes import YamlError, compose, plain_value, yaml_text

__all__ = [
    "Also",
    "CalendarTime",
    "FileStem",
    "Location",
    "Pair",
    "StrictModel",
    "Utc",
    "Vector3",
    "check_model",
    "file_faults",
    "line_of",
    "read_content",
    "read_model",
]

MERGE = "<<"
ERRORS_SHOWN = 3  # a file of the wrong kind breaks every rule at once; the first few tell the story
FIELDS_SHOWN = 12  # a longer list of allowed fields is no help in one line

Model = TypeVar("Model", bound=BaseModel)
Location = tuple[int | str, ...]


class StrictModel(BaseModel):
    """What a file may say: unknown fields are errors, for they are misspelt ones; values are frozen and finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True, allow_inf_nan=False)


# ---- Types of fields that several kinds of file have.


@dataclass(frozen=True, slots=True)
class Also:
    """Beside a validator that lets something shorter stand for a value: the JSON types of that, for the schema."""

    types: tuple[str, ...]

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the value's own schema, or one of the types."""
        return {"anyOf": [handler(core), *({"type": name} for name in self.types)]}


def _calendar(moment: Any) -> Any:
    if isinstance(moment, int | float):  # pydantic would take it for seconds since 1970
        raise ValueError(f"{moment} is a number; write a calendar time such as 2015-07-01T00:00:00")  # noqa: TRY004
    return moment


def _naive_utc(moment: datetime) -> datetime:
    return moment if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)


Pair = tuple[float, float]
Vector3 = tuple[float, float, float]
FileStem = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)]
CalendarTime = Annotated[datetime, BeforeValidator(_calendar)]
Utc = Annotated[CalendarTime, AfterValidator(_naive_utc)]


# ---- Files read and checked.


def read_model(path: str | PathLike[str], model: type[Model], what: str, failure: type[OpNavError]) -> Model:
    """Read a YAML file into a pydantic model.

    Parameters
    ----------
    path : path-like
    model
        The schema.
    what
        What kind of file this is, for the message, such as "camera file".
    failure
        The error to raise.

    Raises
    ------
    OpNavError
        Of type `failure`: the file cannot be read, is not YAML, names a key twice or breaks the schema; the message
        has the line, the field and what may stand there.
    """
    label = f"{what} {path}"
    content, node = _read(path, label, failure)
    for fault in _twice(node):
        raise failure(f"{label}: {fault}.")
    return _validated(content, model, label, failure, node)


def read_content(path: str | PathLike[str], what: str, failure: type[OpNavError]) -> Any:
    """Return the plain content of a YAML file, whatever it is of; parameters and errors as of `read_model`."""
    return _read(path, f"{what} {path}", failure)[0]


def file_faults(
    path: str | PathLike[str], model: type[BaseModel], what: str, failure: type[OpNavError]
) -> list[str]:
    """Return every fault of a YAML file, one line each with line and field; none where `read_model` would read it.

    Parameters
    ----------
    path, model, what, failure
        As of `read_model`.

    Raises
    ------
    OpNavError
        Of type `failure`: the file cannot be read, is not YAML, or is of a version that is not known.
    """
    label = f"{what} {path}"
    content, node = _read(path, label, failure)
    faults = _twice(node)
    content = _without_version({} if content is None else content, label, failure, node)
    try:
        model.model_validate(content)
    except ValidationError as error:
        faults += [_text(problem, model, content, node) for problem in error.errors(include_url=False)]
    return faults


def _read(path: str | PathLike[str], label: str, failure: type[OpNavError]) -> tuple[Any, yaml.Node | None]:
    try:
        text = yaml_text(Path(path))
    except (OSError, UnicodeDecodeError) as error:
        raise failure(f"{label} cannot be read: {error}; give the path of a YAML file.") from error
    except YamlError as error:
        raise failure(f"{label}: {error}; give a file of its kind.") from error
    try:
        node = compose(text)
        # A node is changed where values are merged into it; the one that lines are looked up in stays as written.
        return plain_value(compose(text) if MERGE in text else node), node
    except YamlError as error:
        raise failure(f"{label} is not YAML: {error}; correct the file.") from error


def _twice(node: yaml.Node | None) -> list[str]:
    return [f"line {line}: {key} is given twice; keep one of them" for line, key in _keys_given_twice(node)]


def check_model(
    content: Mapping[str, Any], model: type[Model], what: str, failure: type[OpNavError]
) -> Model:
    """Check a mapping against a pydantic model; the message is that of `read_model`, without a line.

    Examples
    --------
    >>> from opnav_workbench.errors import MissionError
    >>> class Size(BaseModel, extra="forbid"):
    ...     width: int
    >>> check_model({"width": 2}, Size, "size", MissionError)
    Size(width=2)
    >>> check_model({"width": 2, "widht": 3}, Size, "size", MissionError)
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: size: widht: unknown field, did you mean width?
    """
    return _validated(content, model, what, failure, None)


def line_of(path: str | PathLike[str], location: Location) -> int:
    """Return the line (from 1) of a field in a YAML file that `read_model` has read.

    For errors that only show when the content is used; a field that is not in the file has the line of the innermost
    part that is.
    """
    try:
        node = compose(yaml_text(Path(path)))
    except (OSError, UnicodeDecodeError, YamlError):  # it has changed since
        return 1
    return 1 if node is None else _line(node, location)


def _validated(
    content: Any, model: type[Model], label: str, failure: type[OpNavError], node: yaml.Node | None
) -> Model:
    content = _without_version({} if content is None else content, label, failure, node)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        shown = [_text(problem, model, content, node) for problem in problems[:ERRORS_SHOWN]]
        more = [f"and {len(problems) - len(shown)} more"] if len(problems) > len(shown) else []
        raise failure(f"{label}: {'; '.join(shown + more)}") from error


def _without_version(content: Any, label: str, failure: type[OpNavError], node: yaml.Node | None) -> Any:
    """Return the content as the present version has it, without the version: that is of files, not of models."""
    if not isinstance(content, Mapping) or FORMAT_KEY not in content:
        return content
    line = "" if node is None else f": line {_line(node, (FORMAT_KEY,))}"
    return unstamped(as_of_today("yaml", content, f"{label}{line}", failure))


def _text(problem: Mapping[str, Any], model: type[BaseModel], content: Any, node: yaml.Node | None) -> str:
    place = _place(problem["loc"], content, missing=problem["type"] == "missing")
    field = ".".join(str(part) for part in place)
    message = str(problem["msg"]).removeprefix("Value error, ")
    if problem["type"] == "extra_forbidden":
        message = f"unknown field, {_remedy(str(place[-1]), _allowed(model, problem['loc'][:-1]))}"
    elif problem["type"] == "missing":
        message = "this field is required"
    elif problem["type"] == "model_type":
        message = "fields with values are expected here"
    line = "" if node is None else f"line {_line(node, place)}: "
    return f"{line}{field or 'the file'}: {message}"


def _place(location: Location, content: Any, *, missing: bool) -> Location:
    """Return a location without the names of union members that pydantic inserts: they are no fields of the file."""
    place: list[int | str] = []
    for i, part in enumerate(location):
        inside = (isinstance(content, Mapping) and part in content) or (
            isinstance(content, Sequence) and isinstance(part, int) and part < len(content)
        )
        if inside:
            content = content[part]
            place.append(part)
        elif missing and i == len(location) - 1:
            place.append(part)
    return tuple(place)


def _line(node: yaml.Node, place: Location) -> int:
    """Return the line (from 1) of a field, or of the innermost part of the file that there is of it."""
    line = node.start_mark.line
    for part in place:
        found = _child(node, part)
        if found is None:
            break
        line, node = found
    return line + 1


def _child(node: yaml.Node, part: int | str) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == str(part):
                return key.start_mark.line, value
    elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part].start_mark.line, node.value[part]
    return None


def _keys_given_twice(node: yaml.Node | None) -> Iterator[tuple[int, str]]:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            yield from _keys_given_twice(item)
    elif isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != MERGE:  # merges may repeat
                if key.value in seen:
                    yield key.start_mark.line + 1, key.value
                seen.add(key.value)
            yield from _keys_given_twice(value)


def _remedy(given: str, allowed: Sequence[str]) -> str:
    close = difflib.get_close_matches(given, allowed, n=1)
    if close:
        return f"did you mean {close[0]}?"
    if not allowed:
        return "remove it"
    more = ", ..." if len(allowed) > FIELDS_SHOWN else ""
    return f"allowed are {', '.join(allowed[:FIELDS_SHOWN])}{more}"


@dataclass(frozen=True, slots=True)
class _Types:
    """The models that may stand at one place of a file."""

    models: tuple[type[BaseModel], ...]
    annotations: tuple[Any, ...]

    @classmethod
    def of(cls, annotations: Iterable[Any]) -> "_Types":
        kept = tuple(annotations)
        return cls(tuple(m for a in kept for m in _models(a)), kept)

    def field(self, name: int | str) -> "_Types":
        if isinstance(name, int):  # an element of a list: the same models serve
            return self
        known = [m.model_fields[name].annotation for m in self.models if name in m.model_fields]
        if known:
            return _Types.of(known)
        tagged = [
            m for m in self.models if any(name in _literals(f.annotation) for f in m.model_fields.values())
        ]
        return _Types.of(tagged) if tagged else self  # a free key of a mapping: its values' models serve


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    else:
        for argument in get_args(annotation):
            yield from _models(argument)


def _literals(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _allowed(model: type[BaseModel], location: Location) -> list[str]:
    types = _Types.of((model,))
    for part in location:
        types = types.field(part)
    return list(dict.fromkeys(name for m in types.models for name in m.model_fields))
