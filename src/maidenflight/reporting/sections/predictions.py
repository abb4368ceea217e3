"""How well models predict flights."""

from collections.abc import Mapping
from typing import Any

import polars
from markupsafe import Markup

from maidenflight.names import PERSISTENCE
from maidenflight.reporting import tables, text
from maidenflight.reporting.figures import predictions
from maidenflight.reporting.html import render
from maidenflight.reporting.run import Run
from maidenflight.reporting.tables import Cell, Column
from maidenflight.reporting.text import ERRORS, DisplayFormat


def section(run: Run) -> Markup:
    """Returns how well models predict flights."""
    errors, windows = run.validation, run.windows
    return render(
        "prediction.html",
        logs=text.plural(len(run.judged), "log"),
        held_out=len(run.judged & run.used) if run.judged and run.used else None,
        errors="" if errors is None else _errors(errors),
        horizons=None if errors is None else predictions.horizons(errors),
        windows=None if windows is None else predictions.windows(windows),
    )


def _errors(errors: polars.DataFrame) -> Markup:
    """A row a model and horizon; * marks what is worse than the persistence baseline."""
    still = errors.filter(model=PERSISTENCE)
    baseline = {row["horizon"]: row for row in still.iter_rows(named=True)}

    def column(name: str, format: DisplayFormat) -> Column:
        def show(error: float, row: Mapping[str, Any]) -> Cell:
            value, low, high = (
                f"{format.scale * row[f'{name}{end}']:#.3g}".removesuffix(".")
                for end in ("", "_low", "_high")
            )
            worse = error > baseline.get(row["horizon"], {}).get(name, float("inf"))
            cell = Markup("{}{} <small>{} .. {}</small>")
            return Cell(cell.format(value, " *" if worse else "", low, high), error)

        return Column(f"{format.name.capitalize()} [{format.unit}]", show)

    columns: dict[str, Column | str] = {
        "horizon": Column("Ahead [s]", lambda ahead, _: Cell(f"{ahead:g}", ahead)),
        "model": "Model",
        **{name: column(name, format) for name, format in ERRORS.items()},
    }
    return tables.sortable("errors", errors, columns)
