"""What tests look at in a chart: the rows that a panel draws."""

from typing import Any

from maidenflight.reporting.figures.charts import Figure


def rows(figure: Figure, panel: int = 0) -> list[dict[str, Any]]:
    """Rows of a panel's data."""
    columns = figure.panels[panel]["data"]["columns"]
    return [dict(zip(columns, each, strict=True)) for each in zip(*columns.values(), strict=True)]


def of(figure: Figure, panel: int = 0, **wanted: Any) -> list[dict[str, Any]]:
    """Those with the entries wanted."""
    return [row for row in rows(figure, panel) if wanted.items() <= row.items()]


def titles(figure: Figure) -> list[str]:
    found = [panel.get("title", "") for panel in figure.panels]
    return [title["text"] if isinstance(title, dict) else title for title in found]
