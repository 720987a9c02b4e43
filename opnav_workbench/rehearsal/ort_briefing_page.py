"""Sections of a briefing as Markdown and as one HTML file that opens anywhere, offline."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["Section", "as_page", "as_text"]

STYLE = """\
:root { color-scheme: light dark; --ink: #1b2330; --soft: #5a6577; --line: #d5dbe4; --paper: #ffffff; --box: #f3f5f8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #9aa7ba; --line: #39434f; --paper: #14191f; --box: #1e252d; }
}
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid var(--line); padding-bottom: .25rem; }
p.lead { color: var(--soft); margin: 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .35rem .9rem .35rem 0; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; }
pre { background: var(--box); padding: .7rem .9rem; overflow-x: auto; border-radius: .35rem; }
@media print { main { padding: 0; max-width: none; } pre { white-space: pre-wrap; } }
"""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the briefing: a heading with paragraphs, items, a table or commands.

    Attributes
    ----------
    heading : str
    paragraphs, items : tuple of str
    head : tuple of str
        Of the table's columns.
    rows : tuple of tuples of str
    commands : tuple of str
    """

    heading: str
    paragraphs: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    commands: tuple[str, ...] = ()


def as_text(title: str, lead: str, parts: Sequence[Section]) -> str:
    """Return the briefing as Markdown.

    Examples
    --------
    >>> print(as_text("Night 1", "a test", [Section("Deliver", items=("centers",))]))
    # Night 1
    <BLANKLINE>
    a test
    <BLANKLINE>
    ## Deliver
    <BLANKLINE>
    - centers
    <BLANKLINE>
    """
    blocks = [f"# {title}", lead, *(block for part in parts for block in _text_blocks(part))]
    return "\n\n".join(blocks) + "\n"


def _text_blocks(part: Section) -> Iterator[str]:
    yield f"## {part.heading}"
    yield from part.paragraphs
    if part.items:
        yield "\n".join(f"- {item}" for item in part.items)
    if part.rows:
        yield "\n".join(_text_row(row) for row in (part.head, ("---",) * len(part.head), *part.rows))
    if part.commands:
        yield "\n".join(f"    {command}" for command in part.commands)


def _text_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def as_page(title: str, lead: str, parts: Sequence[Section]) -> str:
    """Return the briefing as HTML without a reference to the network."""
    body = "\n".join(block for part in parts for block in _page_blocks(part))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>\n{body}\n</main>\n</body>\n</html>\n'
    )


def _page_blocks(part: Section) -> Iterator[str]:
    yield f"<h2>{escape(part.heading)}</h2>"
    yield from (f"<p>{escape(paragraph)}</p>" for paragraph in part.paragraphs)
    if part.items:
        yield "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in part.items) + "</ul>"
    if part.rows:
        rows = "\n".join(_page_row(row, "td") for row in part.rows)
        yield f'<div class="wide"><table>\n{_page_row(part.head, "th")}\n{rows}\n</table></div>'
    yield from (f"<pre>{escape(command)}</pre>" for command in part.commands)


def _page_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"
