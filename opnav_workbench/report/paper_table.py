"""Published values beside ours, as a table for a notebook and a file for the tests."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from astropy.table import Column, Table

from opnav_workbench.files import atomic_path

__all__ = ["PaperComparison", "PaperRow", "ShownTable", "paper_comparison", "shown_table"]

UNKNOWN = float("nan")
TABLE_STYLE = "margin:0.4em auto;border-collapse:collapse;border-top:1.5px solid;border-bottom:1.5px solid"
HEAD_STYLE = "padding:0.25em 0.7em;border-bottom:1px solid"
CELL_STYLE = "padding:0.2em 0.7em"
CAPTION_STYLE = "caption-side:top;padding-bottom:0.4em"
DASH = "–"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """A quantity of the paper, and ours.

    Attributes
    ----------
    quantity : str
    paper : float or None
        None: the paper gives no number.
    here : float or None
    unit : str
    digits : int
        After the point.
    remark : str
        Why they differ, or where a number comes from.
    difference : bool
        Whether the difference means something.
    """

    quantity: str
    paper: float | None
    here: float | None
    unit: str = ""
    digits: int = 2
    remark: str = ""
    difference: bool = True

    @property
    def cells(self) -> tuple[str, str, str, str, str, str]:
        """What the table shows: quantity, unit, paper, here, difference, remark."""
        paper, here = (self._text(value) for value in (self.paper, self.here))
        both = self.paper is not None and self.here is not None and self.difference
        change = self._text(float(self.here) - float(self.paper), "+") if both else DASH  # type: ignore[arg-type]
        return self.quantity, self.unit, paper, here, change, self.remark

    def _text(self, value: float | None, sign: str = "") -> str:
        return DASH if value is None or not isfinite(value) else f"{value:{sign}.{self.digits}f}"


@dataclass(frozen=True, slots=True, eq=False)
class PaperComparison:
    """A table of published and own values; a notebook shows it, `write` keeps it."""

    rows: tuple[PaperRow, ...]
    title: str = ""
    source: str = "paper"  # heading of the published values

    def table(self) -> Table:
        """Return a row per quantity; nan where a number is not known."""
        rows = self.rows
        return Table(
            [
                Column([r.quantity for r in rows], "quantity", description="what is compared"),
                Column([r.unit for r in rows], "unit", description="of both values"),
                Column(
                    [_number(r.paper) for r in rows], "paper", description="AAS 13-443; nan: gives no number"
                ),
                Column([_number(r.here) for r in rows], "here", description="this run"),
                Column([r.remark for r in rows], "remark"),
            ]
        )

    def write(self, path: str | Path) -> Path:
        """Write `table` as ECSV, whole or not at all; return its path."""
        with atomic_path(path) as temporary:
            self.table().write(temporary, format="ascii.ecsv", overwrite=True)
        return Path(path)

    def _repr_html_(self) -> str:
        names = ["", "unit", self.source, "here", f"here − {self.source}", "remark"]
        columns = [list(column) for column in zip(*(row.cells for row in self.rows), strict=True)]
        kept = [i for i, column in enumerate(columns) if any(cell not in ("", DASH) for cell in column)]
        return _html(
            [names[i] for i in kept], [columns[i] for i in kept], [i in (2, 3, 4) for i in kept], self.title
        )


@dataclass(frozen=True, slots=True, eq=False)
class ShownTable:
    """A table as a paper prints it: units under the names, no types, no row numbers."""

    content: Table
    title: str = ""

    def _repr_html_(self) -> str:
        columns = list(Table(self.content).itercols())  # quantities become columns
        units = ["" if column.unit is None else f" ({column.unit})" for column in columns]
        names = [f"{column.info.name}{unit}" for column, unit in zip(columns, units, strict=True)]
        cells = [column.pformat(show_name=False, show_unit=False, max_lines=-1) for column in columns]
        numeric = [column.dtype.kind in "if" for column in columns]
        return _html(names, [[_plain(cell) for cell in column] for column in cells], numeric, self.title)


def paper_comparison(rows: Sequence[PaperRow], title: str = "", source: str = "paper") -> PaperComparison:
    """Return a table of published values beside ours; `source` heads the column of published ones.

    Examples
    --------
    >>> rows = [PaperRow("pixel", 8.46, 8.50, "px"), PaperRow("line", 10.37, None, "px")]
    >>> print(paper_comparison(rows).table()["here"].tolist())
    [8.5, nan]
    >>> rows[0].cells[2:5]
    ('8.46', '8.50', '+0.04')
    """
    return PaperComparison(tuple(rows), title, source)


def shown_table(table: Table, title: str = "") -> ShownTable:
    """Return a table as a notebook shows it in print; the last expression of a cell.

    Examples
    --------
    >>> shown = shown_table(Table({"star": ["a"], "mag": [8.25]}), "Stars")
    >>> "Stars" in shown._repr_html_(), ">8.25<" in shown._repr_html_()
    (True, True)
    """
    return ShownTable(table, title)


def _number(value: float | None) -> float:
    return UNKNOWN if value is None else float(value)


def _plain(cell: str) -> str:
    """Return a number's text without the padding, and a dash where there is none."""
    return DASH if cell.strip() in ("nan", "+nan", "--") else cell.strip()


def _html(names: Sequence[str], columns: Sequence[Sequence[str]], numeric: Sequence[bool], title: str) -> str:
    head = "".join(_cell("th", name, number) for name, number in zip(names, numeric, strict=True))
    whole = [
        number or i == 0 for i, number in enumerate(numeric)
    ]  # only words after the first column may wrap
    body = "".join(
        "<tr>" + "".join(_cell("td", *cell) for cell in zip(row, numeric, whole, strict=True)) + "</tr>"
        for row in zip(*columns, strict=True)
    )
    caption = f'<caption style="{CAPTION_STYLE}">{html.escape(title)}</caption>' if title else ""
    return (
        f'<table style="{TABLE_STYLE}">{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
    )


def _cell(tag: str, text: str, numeric: bool, whole: bool = False) -> str:
    style = f"{HEAD_STYLE if tag == 'th' else CELL_STYLE};text-align:{'right' if numeric else 'left'}"
    style += ";white-space:nowrap" if whole else ""
    return f'<{tag} style="{style}">{html.escape(text)}</{tag}>'
