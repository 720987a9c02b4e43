"""Plain tables of texts and numbers as ECSV 1.0, byte for byte as astropy writes them, without what astropy loads for it.

astropy's writer needs its tables, times and coordinates: a fifth of the processor time of a star frame. Only what a table
of observables has is written here: texts and double precision numbers, each column with its description, in one line a row.

Source: astropy APE 6 (doi:10.5281/zenodo.1047225); layout of the header and of the rows as of astropy 8.0.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import yaml

from opnav_workbench.observables.columns import ExportColumn

__all__ = ["ecsv_of"]

HEADER_WIDTH = 130
QUOTED = re.compile(r'[ "\r\n]|^$')  # a text that holds such, or nothing


class _Ordered(dict[str, Any]):
    """A mapping whose order is kept, as that of a column's attributes; others are sorted."""


class _OrderedPairs(dict[str, Any]):
    """A mapping that is written as YAML's ordered one, a list of pairs."""


def _header_dumper(base: Any) -> Any:
    """Return a dumper of headers; our own, so that no other YAML changes."""

    class HeaderDumper(base):  # type: ignore[misc]
        """As `base`, with mappings in order."""

    HeaderDumper.add_representer(
        _Ordered, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", list(data.items()))
    )
    HeaderDumper.add_representer(
        _OrderedPairs,
        lambda dumper, data: dumper.represent_sequence(
            "tag:yaml.org,2002:omap", [{key: value} for key, value in data.items()]
        ),
    )
    return HeaderDumper


PLAIN_DUMPER = _header_dumper(yaml.SafeDumper)
# By libyaml, five times as fast; it folds long texts with escapes at other places, so that it has plain ASCII only.
ASCII_DUMPER = _header_dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper))


def ecsv_of(
    columns: Sequence[ExportColumn], rows: Iterable[Mapping[str, Any]], meta: Mapping[str, Any]
) -> str:
    """Return a table as ECSV text.

    Parameters
    ----------
    columns
        Their names are words without blanks.
    rows
        By the name of a column: a text where it has no unit, which is not empty, else a number; nan is written as such.
    meta
        Plain values that the table says of itself; keys of this mapping keep their order.

    Examples
    --------
    >>> print(ecsv_of([ExportColumn("range", "km", "distance")], [{"range": 0.1}], {"by": "us"}), end="")
    # %ECSV 1.0
    # ---
    # datatype:
    # - {name: range, unit: km, datatype: float64, description: distance}
    # meta: !!omap
    # - {by: us}
    # schema: astropy-2.0
    range
    0.1
    """
    header = {
        "datatype": [_attributes(column) for column in columns],
        "meta": _OrderedPairs(meta),
        "schema": "astropy-2.0",
    }
    dumper = ASCII_DUMPER if json.dumps(header, ensure_ascii=False).isascii() else PLAIN_DUMPER
    lines = yaml.dump(header, Dumper=dumper, default_flow_style=None, width=HEADER_WIDTH).splitlines()
    head = [f"# {line}" for line in ("%ECSV 1.0", "---", *lines)]
    head.append(" ".join(column.name for column in columns))
    body = (" ".join(_cell(column, row[column.name]) for column in columns) for row in rows)
    return "\n".join([*head, *body, ""])


def _attributes(column: ExportColumn) -> _Ordered:
    kind = {"datatype": "string"} if column.unit is None else {"unit": column.unit, "datatype": "float64"}
    return _Ordered({"name": column.name, **kind, "description": column.description})


def _cell(column: ExportColumn, value: Any) -> str:
    if column.unit is not None:
        return repr(float(value))
    text = str(value).strip(" \t")
    return '"' + text.replace('"', '""') + '"' if QUOTED.search(text) else text
