"""HTML templates (jinja2): one environment for each folder of templates; every value is escaped.

`workbench` and `report` keep theirs in a folder ``templates`` beside their modules. A name that a template uses and
nobody gave is an error, no empty place on the page.
"""

import base64
from functools import cache
from math import isfinite
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

__all__ = ["environment", "png_url", "words"]


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
        auto_reload=False,  # to look at each file's date at each use gives a thread that works the turn, some ms each time
    )
    made.filters |= {"words": words, "number": _number}
    return made


def words(name: str) -> str:
    """Return a name of the program as a person reads it.

    Examples
    --------
    >>> words("limb_scan")
    'limb scan'
    """
    return name.replace("_", " ")


def png_url(png: bytes) -> str:
    """Return a PNG as a URL that holds its data, for pages that open anywhere."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def _number(value: float | None, spec: str) -> str:
    """A number in a format of Python's; a dash where there is none, or none that is finite."""
    return "–" if value is None or not isfinite(value) else format(value, spec)
