"""Output in a terminal: progress bars and notes on standard error, tables on standard output."""

import math
import re
import string
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from maidenflight.errors import printable

_WIDE = 110
"""Columns of a terminal from which a bar may be long."""
_PER_SI = {"cm": 100.0, "g": 1e3, "deg": math.degrees(1.0), "deg/s": math.degrees(1.0)}
"""Displayed value per value in SI units, of the units that are none."""
_NUMBER = re.compile(r"[-+*]? ?\d|$|none$|unknown$")
"""How cells begin that are aligned right."""


class Progress:
    """Receives how far a verb is; this one stays silent."""

    def move(self, done: int, total: int | None, remark: str = "") -> None:
        """Moves the bar; no total means that none is known."""

    def log(self, line: str, always: bool = False) -> None:
        """Writes a line where there is no bar to move, or always."""

    def note(self, text: str) -> None:
        """Tells the user something before the result is there."""


class Bar(Progress):
    """A progress bar on standard error, with the time since it began."""

    def __init__(self, title: str, remaining: bool = True) -> None:
        """Makes a bar with a title, to be entered as a context.

        `remaining`: it shows how long it will still take, as if all of it were alike.
        """
        self._title, self._remaining = title, remaining
        self._bar: Any = None
        self._noted: set[str] = set()

    def __enter__(self) -> Self:
        from rich import progress
        from rich.console import Console
        from rich.table import Column

        console = Console(stderr=True)
        width = 24 if console.width >= _WIDE else 5
        columns = (
            "[bold]{task.description:<9}",
            # A bar must not give way to the remark: it would jump with each.
            progress.BarColumn(width, table_column=Column(min_width=width, no_wrap=True)),
            progress.TaskProgressColumn(
                "{task.percentage:>3.0f} %", text_format_no_percentage="     "
            ),
            progress.TimeElapsedColumn(),
            *([progress.TimeRemainingColumn()] if self._remaining else []),
            progress.TextColumn(
                "{task.fields[remark]}",
                table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
            ),
        )
        self._bar = progress.Progress(
            *columns, console=console, disable=not console.is_terminal, expand=True
        )
        self._bar.add_task(self._title, total=None, remark="")
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def move(self, done: int, total: int | None, remark: str = "") -> None:
        """Moves the bar."""
        # To `update` no total means that it stays; `reset` would set the clock back.
        self._bar.tasks[0].total = total
        self._bar.update(self._bar.tasks[0].id, completed=done, remark=remark)

    def log(self, line: str, always: bool = False) -> None:
        """Writes a line where standard error is a file or pipe and so shows no bar, or always."""
        if always or not sys.stderr.isatty():
            print(printable(line), file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        """Writes a note, once."""
        if text not in self._noted:
            self._noted.add(text)
            print(f"note: {printable(text)}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Table:
    """A table for people, of values in SI units."""

    title: str
    columns: Mapping[str, str]
    """The cells of each column by its title, as a template of a row: `{duration:.2f s}`, or
    `{error:.1f cm}` of metres. What is None stays empty, what is not a number is `none`."""
    rows: Sequence[Mapping[str, Any]]

    @property
    def cells(self) -> list[list[str]]:
        """Returns the texts of each row."""
        fill = _Cells().vformat
        return [[fill(cell, (), row) for cell in self.columns.values()] for row in self.rows]


class _Cells(string.Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None or value != value:
            return "" if value is None else "none"
        form, _, unit = format_spec.partition(" ")
        return f"{value * _PER_SI.get(unit, 1.0):{form}} {unit}" if unit else format(value, form)


def show(*parts: Table | str) -> None:
    """Prints tables and lines."""
    for part in parts:
        if isinstance(part, str):
            print(printable(part))
        else:
            print_table(part.title, list(part.columns), part.cells)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a table of texts; columns of numbers behind the first are aligned right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid(box=SIMPLE_HEAD)
    for number, column in enumerate(columns):
        numeric = number > 0 and all(_NUMBER.match(row[number]) for row in rows)
        # On a terminal that is too narrow cells are folded: no number is cut.
        grid.add_column(
            column,
            justify="right" if numeric else "left",
            no_wrap=number == 0,
            overflow="fold",
        )
    for row in rows:
        grid.add_row(*(Text(printable(cell)) for cell in row))
    console = Console()
    # Into a file or a pipe a table is as wide as it needs to be; on a terminal it must fit.
    console = console if console.is_terminal else Console(width=200)
    # Not the grid's own title, which would fold at the grid's width.
    console.print(Text(f"\n{title}", style="bold"), grid, sep="\n", end="")
