"""Tables of a study: one for each of its entries, with what is swept and what was found."""

from typing import Any

import polars
from markupsafe import Markup

from maidenflight.reporting import tables, text
from maidenflight.reporting.run import Run
from maidenflight.reporting.tables import Cell


def entries(run: Run) -> list[Markup]:
    """A heading and a table for each entry of a study."""
    if run.study is None:
        return []
    return [
        Markup("<h3>{}</h3>\n{}").format(rows["task"][0], _table(rows))
        for rows in run.study.partition_by("task", maintain_order=True)
    ]


def _table(rows: polars.DataFrame) -> Markup:
    """The columns that the entry has."""
    own = [
        name
        for name in rows.columns
        if name not in ("task", "kind") and rows[name].null_count() < rows.height
    ]
    cells = [[_cell(value) for value in row] for row in rows.select(own).iter_rows()]
    heads = [(name, name.replace("_", " ")) for name in own]
    return tables.sortable(str(rows["task"][0]), heads, cells, rows.select("task", "kind", *own))


def _cell(value: Any) -> Cell:
    if value is None:
        return Cell(text.NOTHING, float("nan"))
    if isinstance(value, float):
        return Cell(text.number(value, 4), value)
    return tables.plain(value)
