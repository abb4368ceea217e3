"""Tables of a study: one for each of its entries, with what is swept and the results."""

from collections.abc import Mapping
from typing import Any

import polars
from markupsafe import Markup

from maidenflight.reporting import tables, text
from maidenflight.reporting.run import Run
from maidenflight.reporting.tables import Cell, Column


def section(run: Run) -> Markup:
    """Returns a heading and a table for each entry of a study."""
    parts = [] if run.study is None else run.study.partition_by("task", maintain_order=True)
    return Markup("\n").join(
        Markup("<h3>{}</h3>\n{}").format(rows["task"][0], _table(rows)) for rows in parts
    )


def _table(rows: polars.DataFrame) -> Markup:
    own = [
        name
        for name in rows.columns
        if name not in ("task", "kind") and rows[name].null_count() < rows.height
    ]
    columns = {name: Column(name.replace("_", " "), _cell) for name in own}
    return tables.sortable(str(rows["task"][0]), rows.select("task", "kind", *own), columns)


def _cell(value: Any, _: Mapping[str, Any]) -> Cell:
    if value is None:
        return Cell(text.NOTHING, float("nan"))
    if isinstance(value, float):
        return Cell(text.number(value, 4), value)
    return tables.plain(value)
