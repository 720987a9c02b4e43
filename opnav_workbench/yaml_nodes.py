"""YAML text into nodes and plain values, bounded: no depth, alias, number or tag that a file of ours would need not.

Flow    text -> events (depth, count, tags, lengths) -> nodes (what aliases repeat, counted) -> plain values

A few lines of YAML can stand for more values than memory holds, or for themselves; a day that no calendar has is an
error of the reader below. So events are counted before anything is built of them, nodes before anything is made of
what aliases repeat, and times stay texts: what may be a time says the model that takes it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from opnav_workbench.paths import regular_size

__all__ = ["LARGEST_BYTES", "LONGEST_NUMBER", "YamlError", "compose", "plain_value", "yaml_text"]

LARGEST_BYTES = 4 << 20  # a table of states with a hundred thousand numbers
DEEPEST = 40  # levels within levels; files of ours have eight
OWN_LIMIT = "maximum nesting depth"  # in words of libyaml since PyYAML 6.0.4
MOST_VALUES = 400_000  # with all that aliases repeat
LONGEST_NUMBER = 40  # characters: twice the digits of a double, with sign and exponent
CLEARER_CHARS = 50_000  # parsed a second time for the sake of the message; half a second
SHOWN = 40  # characters of a value in a message
TAG = "tag:yaml.org,2002:"
KINDS = tuple(TAG + kind for kind in ("null", "bool", "int", "float", "str", "seq", "map", "merge"))
BASE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same by libyaml, ten times as fast


class YamlError(ValueError):
    """Text that is no YAML, or more than a file of ours would need; one line."""


class _Loader(BASE):  # type: ignore[misc]  # chosen at run time
    """Of YAML's types those that JSON has; a number in a sensible length."""

    yaml_implicit_resolvers = {  # noqa: RUF012  # as its base has it
        first: [(tag, pattern) for tag, pattern in known if tag in KINDS]
        for first, known in BASE.yaml_implicit_resolvers.items()
    }

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        # No name of a file, no text of a table has one.
        if isinstance(node, yaml.ScalarNode) and "\0" in node.value:
            raise _at(node, "a text with a NUL character")
        number = node.tag in (f"{TAG}int", f"{TAG}float")
        if number and len(node.value) > LONGEST_NUMBER:
            raise _at(node, f"a number of {len(node.value)} characters")
        try:
            return super().construct_object(node, deep)
        except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise _at(node, f"{str(node.value)[:SHOWN]!r} is no {node.tag.removeprefix(TAG)}") from error


def _at(node: yaml.Node, words: str) -> YamlError:
    return YamlError(f"line {_line(node)}: {words}")


def _line(item: Any) -> int:
    return int(item.start_mark.line) + 1  # of a node or an event


def yaml_text(path: Path) -> str:
    """Return the text of a YAML file.

    Raises
    ------
    OSError, UnicodeDecodeError
        It cannot be read, is no regular file, or no UTF-8.
    YamlError
        It is larger than `LARGEST_BYTES`.
    """
    size = regular_size(path)
    if size > LARGEST_BYTES:
        raise YamlError(f"{size} bytes, more than {LARGEST_BYTES}")
    return path.read_text(encoding="utf-8")


def compose(text: str) -> yaml.Node | None:
    """Return the root node of YAML text; None of an empty one.

    Raises
    ------
    YamlError
        It is no YAML, nested deeper than `DEEPEST`, stands for more than `MOST_VALUES` values, repeats itself within
        itself, or has a tag that is not read.
    """
    try:
        _check_events(text)
        node: yaml.Node | None = yaml.compose(text, Loader=_Loader)
    except yaml.YAMLError as error:
        if OWN_LIMIT in str(error):  # libyaml reads ahead of what is counted here
            raise YamlError(f"nested deeper than {DEEPEST}") from error
        raise YamlError(" ".join(str(_clearer(text, error)).split())) from error
    if node is not None:
        _check_repeats(node)
    return node


def _clearer(text: str, error: yaml.YAMLError) -> yaml.YAMLError:
    """Return what PyYAML's own parser says of a fault, which is better than libyaml's words."""
    if len(text) <= CLEARER_CHARS:
        try:
            yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as clearer:
            return clearer
    return error


def plain_value(node: yaml.Node | None) -> Any:
    """Return what a node stands for: mappings, lists, texts, numbers, flags and None.

    Raises
    ------
    YamlError
        A value is not what its tag says, or cannot be a key.

    Examples
    --------
    >>> plain_value(compose("{time: 2015-02-30, size: [1, 2.5, ~]}"))
    {'time': '2015-02-30', 'size': [1, 2.5, None]}
    """
    if node is None:
        return None
    loader = _Loader("")
    try:
        return loader.construct_document(node)
    except yaml.YAMLError as error:
        raise YamlError(" ".join(str(error).split())) from error
    finally:
        loader.dispose()


def _check_events(text: str) -> None:
    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=_Loader)):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST or count > 2 * MOST_VALUES:
            what = f"nested deeper than {DEEPEST}" if depth > DEEPEST else f"more than {MOST_VALUES} values"
            raise YamlError(f"line {_line(event)}: {what}")
        tag = getattr(event, "tag", None)
        if tag not in (None, "!", *KINDS):
            raise YamlError(f"line {_line(event)}: the tag {str(tag)[:SHOWN]!r} is not read here")


def _check_repeats(root: yaml.Node) -> None:
    """Count a node as often as aliases repeat it, and refuse one that holds itself."""
    sizes: dict[int, int | None] = {}

    def size(node: yaml.Node) -> int:
        if id(node) in sizes:
            known = sizes[id(node)]
            if known is None:  # being counted further up
                raise _at(node, "a value that holds itself")
            return known
        sizes[id(node)] = None
        sizes[id(node)] = total = 1 + sum(size(child) for child in _children(node))
        if total > MOST_VALUES:
            raise _at(node, f"aliases make more than {MOST_VALUES} values")
        return total

    size(root)


def _children(node: yaml.Node) -> Iterator[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield key
            yield value
    elif isinstance(node, yaml.SequenceNode):
        yield from node.value
