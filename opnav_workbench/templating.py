"""HTML templates (jinja2): one environment for each folder of templates; every value is escaped.

`workbench` and `report` keep theirs in a folder ``templates`` beside their modules. A name that a template uses and
nobody gave is an error, no empty place on the page.
"""

from functools import cache
from math import isfinite
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

__all__ = ["environment"]


@cache
def environment(folder: Path) -> Environment:
    """Return the environment of a folder's templates, with the filters `words` and `number`.

    Examples
    --------
    >>> templates = environment(Path("templates"))
    >>> templates.from_string("{{ name }}: {{ method | words }}").render(name="A & B", method="limb_scan")
    'A &amp; B: limb scan'
    >>> templates.from_string("{{ x | number('+.2f') }} {{ none | number('.1f') }}").render(x=0.5)
    '+0.50 –'
    """
    made = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    made.filters |= {"words": _words, "number": _number}
    return made


def _words(name: str) -> str:
    """A name of the program as a person reads it."""
    return name.replace("_", " ")


def _number(value: float | None, spec: str) -> str:
    """A number in a format of Python's; a dash where there is none, or none that is finite."""
    return "–" if value is None or not isfinite(value) else format(value, spec)
