"""Tables of the page: heads sort them, and a link saves them as CSV, in SI units and in full."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import polars
from markupsafe import Markup

from maidenflight.reporting import text
from maidenflight.reporting.html import render

TALL = 40
"""Rows beyond which a table scrolls within the page, and is left out of print."""


class Cell(NamedTuple):
    """What a table shows in a place, and what it is sorted by."""

    content: str | Markup
    value: Any

    @property
    def key(self) -> str:
        """The value as the page's script reads it; a number that is not finite is sorted last."""
        unknown = isinstance(self.value, float) and not np.isfinite(self.value)
        return "" if unknown else str(self.value)


def plain(value: Any, _: Mapping[str, Any] | None = None) -> Cell:
    """Returns a cell of a text or whole number as it is."""
    return Cell(str(value), value)


class Column(NamedTuple):
    """How a table shows a column of its rows."""

    label: str | Markup
    show: Callable[[Any, Mapping[str, Any]], Cell] = plain
    """Makes the cell of a value and its row."""


def number(label: str | Markup, decimals: int, scale: float = 1.0) -> Column:
    """Returns a column of numbers with so many decimals, in units of 1 / `scale`."""

    def show(value: Any, _: Mapping[str, Any]) -> Cell:
        real = float("nan") if value is None else float(value)
        digits_text = f"{scale * real:z.{decimals}f}" if np.isfinite(real) else text.NOTHING
        return Cell(text.signed(digits_text), real)

    return Column(label, show)


def _button(cell: Cell) -> Cell:
    """The cell with a button that shows its flight in the viewer."""
    name = cell.content if isinstance(cell.value, str) else f"flight {cell.content}"
    button = '<button type=button class=choose aria-label="Show {}">{}</button>'
    return Cell(Markup(button).format(name, cell.content), cell.value)


def sortable(
    name: str,
    rows: polars.DataFrame,
    columns: Mapping[str, Column | str],
    viewed: Collection[int] | None = None,
) -> Markup:
    """Returns a table with heads that sort it, and a link that saves its rows whole.

    Args:
        name: of the table, and of the file.
        rows: what the file holds, in SI units.
        columns: their display, in this order; the first heads the rows. A label alone shows
            values as they are.
        viewed: places of rows that are flights in the viewer; `None` where rows are no flights.
    """
    formats = {
        key: column if isinstance(column, Column) else Column(column)
        for key, column in columns.items()
    }
    cells = []
    for index, row in enumerate(rows.iter_rows(named=True)):
        first, *others = (column.show(row.get(key), row) for key, column in formats.items())
        cells.append([_button(first) if viewed and index in viewed else first, *others])
    return render(
        "table.html",
        name=name,
        heads=[(key, column.label) for key, column in formats.items()],
        rows=cells,
        tall=TALL,
        csv=quote(rows.write_csv()),
        of_flights=viewed is not None,
    )
