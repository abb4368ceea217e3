"""Tables of the page: heads sort them, and a link saves them as CSV, in SI units and in full."""

from collections.abc import Iterable, Sequence
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

    shown: str | Markup
    value: Any

    @property
    def key(self) -> str:
        """The value as the page's script reads it; a number that is not finite is sorted last."""
        unknown = isinstance(self.value, float) and not np.isfinite(self.value)
        return "" if unknown else str(self.value)


def number(value: float, decimals: int, scale: float = 1.0) -> Cell:
    """A cell of a number with so many decimals."""
    shown = f"{scale * value:.{decimals}f}" if np.isfinite(value) else text.NOTHING
    return Cell(shown.replace("-", "\N{MINUS SIGN}"), float(value))


def plain(value: Any) -> Cell:
    """A cell of a text or whole number as it is."""
    return Cell(str(value), value)


def choice(value: Any, name: str) -> Cell:
    """A cell with a button that shows a flight in the viewer."""
    button = '<button type=button class=choose aria-label="Show {}">{}</button>'
    return Cell(Markup(button).format(name, value), value)


def sortable(
    name: str,
    heads: Sequence[tuple[str, str | Markup]],
    rows: Iterable[Sequence[Cell]],
    content: polars.DataFrame,
    of_flights: bool = False,
) -> Markup:
    """A table with heads that sort it, and a link that saves it.

    Args:
        name: of the table, and of the file.
        heads: a name and a label for each column; the first column heads its rows.
        rows: cells of each row.
        content: what the file holds, in SI units.
        of_flights: whether each row is a flight that the viewer may show, by its place.
    """
    return render(
        "table.html",
        name=name,
        heads=heads,
        rows=list(rows),
        tall=TALL,
        csv=quote(content.write_csv()),
        of_flights=of_flights,
    )
