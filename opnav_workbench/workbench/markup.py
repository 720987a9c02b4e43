"""What goes into the page: templates filled in, scripts and styles, and what is shown without a live kernel.

The templates (templates/*.html, jinja2) escape every value, so that no name and no message can break a page. Scripts and
styles stand in static/.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from markupsafe import Markup

from opnav_workbench.templating import environment, png_url

__all__ = ["PagePicture", "in_parts", "page_files", "prepare_templates", "render", "with_still_picture"]

TEMPLATES, STATIC = Path(__file__).parent / "templates", Path(__file__).parent / "static"
_LINE_BREAKS = re.compile(r">\s*\n\s*<")
# Around an element of a template that is sent alone where nothing but such elements has changed; they do not nest.
PART, PART_END = "<!--part-->", "<!--/part-->"
_TAG = re.compile(r"\s*<([\w-]+)")
NO_KERNEL_MESSAGE = (
    "opnav_workbench: this view needs a running kernel. Open the notebook in JupyterLab and run its cells; "
    "every decision is kept in the session's folder."
)


def render(template: str, **content: object) -> Markup:
    """Return a template of the workbench filled in; line breaks between its tags are not part of the page.

    Examples
    --------
    >>> render("message.html", message="a < b & c")
    Markup('<div class="page"><p class="hint">a &lt; b &amp; c</p></div>')
    """
    page = environment(TEMPLATES).get_template(template).render(**content)
    return Markup(_LINE_BREAKS.sub("><", page).strip())  # noqa: S704 - the environment has escaped it


def prepare_templates() -> None:
    """Make all templates ready: the first key that asks for one does not wait until it is read and compiled."""
    templates = environment(TEMPLATES)
    for name in templates.list_templates():
        templates.get_template(name)


def in_parts(html: str) -> tuple[list[str], list[str]]:
    """Return the elements that are marked as parts, each with its number as ``data-part``; and what stands around them.

    Examples
    --------
    >>> in_parts("<ol><!--part--><li>a</li><!--/part--><!--part--><li>b</li><!--/part--></ol>")
    (['<li data-part="0">a</li>', '<li data-part="1">b</li>'], ['<ol>', '', '</ol>'])
    """
    first, *others = str(html).split(PART)  # plain text: `Markup` would escape what is put together of it
    pairs = [one.split(PART_END) for one in others]
    parts = [_TAG.sub(rf'<\1 data-part="{n}"', part, count=1) for n, (part, _) in enumerate(pairs)]
    return parts, [first, *(after for _, after in pairs)]


@cache
def page_files(*names: str) -> str:
    """Return scripts or styles of static/, one after the other: together one JavaScript module, or one style sheet."""
    return "\n".join((STATIC / name).read_text(encoding="utf-8") for name in names)


@dataclass(frozen=True, slots=True)
class PagePicture:
    """A picture on the page: a URL that holds its data, and the size that it is shown in, px."""

    url: str
    width_px: int
    height_px: int


def with_still_picture(bundle: Any, picture: Callable[[], bytes] | None) -> Any:
    """Return a widget's MIME bundle with the message as its text, and message and picture as HTML."""
    data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
    data = dict(data) | {"text/plain": NO_KERNEL_MESSAGE}
    if picture is not None:
        data["text/html"] = str(
            render("no_kernel.html", message=NO_KERNEL_MESSAGE, picture=png_url(picture()))
        )
    return data, metadata
