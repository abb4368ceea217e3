"""Output in a terminal: progress bars and notes on standard error, tables on standard output."""

import sys
from collections.abc import Sequence
from typing import Any, Self

from maidenflight.verb import Progress

_WIDE = 110
"""Columns of a terminal from which a bar may be long."""


class Bar(Progress):
    """A progress bar on standard error, with the time since it began."""

    def __init__(self, title: str, remaining: bool = True) -> None:
        """Makes a bar, to be entered as a context.

        Args:
            title: what goes on.
            remaining: whether to show how long it will still take, as if all of it were alike.
        """
        self._title, self._remaining = title, remaining
        self._bar: Any = None
        self._noted: set[str] = set()

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            Progress,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.table import Column

        console = Console(stderr=True)
        width = 24 if console.width >= _WIDE else 5
        share = TaskProgressColumn("{task.percentage:>3.0f} %", text_format_no_percentage="     ")
        # A bar must not give way to the remark: it would jump with each.
        line = BarColumn(width, table_column=Column(min_width=width, no_wrap=True))
        remark = TextColumn(
            "{task.fields[remark]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)
        )
        columns = (
            "[bold]{task.description:<9}",
            line,
            share,
            TimeElapsedColumn(),
            *([TimeRemainingColumn()] if self._remaining else []),
            remark,
        )
        self._bar = Progress(
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
            print(line, file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        """Writes a note, once."""
        if text not in self._noted:
            self._noted.add(text)
            print(f"note: {text}", file=sys.stderr, flush=True)

    def print_notes(self, notes: Sequence[str]) -> None:
        """Writes the notes that were not written before."""
        for text in notes:
            self.note(text)


def print_file_notes(lines: Sequence[str], most: int = 6) -> None:
    """Prints notes on files; equal ones once, with the number of files instead of their names."""
    alike: dict[str, list[str]] = {}
    for note in lines:
        alike.setdefault(note.partition(": ")[2] or note, []).append(note)
    grouped = [
        f"{len(every)} files: {text}" if len(every) > 1 else every[0]
        for text, every in alike.items()
    ]
    for line in grouped[:most]:
        print(f"  {line}")
    if len(grouped) > most:
        print(f"  and {len(grouped) - most} more; --json lists them all")


def print_table(
    title: str, columns: list[str], rows: list[list[str]], numbers_from: int = 1
) -> None:
    """Prints a table; columns from `numbers_from` on are aligned right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    grid = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        # On a terminal that is too narrow cells are folded: no number is cut.
        grid.add_column(
            column,
            justify="right" if number >= numbers_from else "left",
            no_wrap=number == 0,
            overflow="fold",
        )
    for row in rows:
        grid.add_row(*row)
    console = Console()
    # Into a file or a pipe a table is as wide as it needs to be; on a terminal it must fit.
    (console if console.is_terminal else Console(width=200)).print(grid)
