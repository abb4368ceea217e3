"""Tables of the page: each can be sorted by its heads and taken away as CSV, in SI units and in
full.
"""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import polars

TALL = 40
"""Rows beyond which a table scrolls within the page, and is left out of print."""


class Cell(NamedTuple):
    """What a table shows in a place, and what it is sorted by."""

    markup: str
    value: Any = ""
    """A number or text; a number that is none is sorted to the end."""


def number(value: float, decimals: int, scale: float = 1.0, nothing: str = "\N{EN DASH}") -> Cell:
    """A cell of a number with so many decimals."""
    return Cell(f"{scale * value:.{decimals}f}" if np.isfinite(value) else nothing, float(value))


def words(text: str) -> Cell:
    """A cell of plain text."""
    return Cell(escape(text), text)


def sortable(
    name: str,
    heads: Sequence[tuple[str, str]],
    rows: Iterable[tuple[str, Sequence[Cell]]],
    content: polars.DataFrame,
) -> str:
    """A table with heads that sort it, and a link that saves it.

    Args:
        name: of the table; the file is called so.
        heads: a name and a label (HTML) for each column; the first column heads its rows.
        rows: attributes of a row (HTML, such as `data-flight="3"`), and its cells.
        content: what the file holds, in SI units.
    """
    lines = [_line(attributes, cells) for attributes, cells in rows]
    head = "".join(
        f'<th scope=col><button type=button data-column="{column}">{label}</button></th>'
        for column, label in heads
    )
    tall = " tall" if len(lines) > TALL else ""
    plural = "" if len(lines) == 1 else "s"
    body = f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return (
        f'<div class="scroll{tall}"><table class="sortable {name}">{body}</table></div>'
        f"<p class=below><span class=note>{len(lines)} row{plural}.</span> "
        f"{download(name, content)}</p>"
    )


def _line(attributes: str, cells: Sequence[Cell]) -> str:
    first, *rest = cells
    inner = f'<th scope=row data-value="{_value(first)}">{first.markup}</th>'
    inner += "".join(f'<td data-value="{_value(cell)}">{cell.markup}</td>' for cell in rest)
    return f"<tr{f' {attributes}' if attributes else ''}>{inner}</tr>"


def _value(cell: Cell) -> str:
    return (
        ""
        if isinstance(cell.value, float) and not np.isfinite(cell.value)
        else escape(str(cell.value))
    )


def download(name: str, content: polars.DataFrame) -> str:
    """A link that saves a table as `NAME.csv`; the table is in the link."""
    return (
        f'<a class=button download="{name}.csv" '
        f'href="data:text/csv;charset=utf-8,{quote(content.write_csv())}">Download as CSV</a>'
    )
