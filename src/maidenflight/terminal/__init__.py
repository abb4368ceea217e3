"""Output in a terminal: progress bars on standard error, tables and notes on standard output."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

_STEPS = 1000
"""Steps of a bar over stages."""
_WIDE = 110
"""Columns of a terminal from which a bar may be long."""


@contextmanager
def progress(
    title: str, total: int | None, remaining: bool = True
) -> Iterator[Callable[[int, int | None, str], None]]:
    """A progress bar on standard error, with the time since it began.

    Call it with (done, total, remark), where no total means that none is known.

    Args:
        title: what goes on.
        total: what there is to do; `None` where that is not known.
        remaining: show how long it will still take, as if all of it were alike.
    """
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
        *([TimeRemainingColumn()] if remaining else []),
        remark,
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, expand=True) as bar:
        task = bar.add_task(title, total=total, remark="")

        def move(done: int, of: int | None, remark: str) -> None:
            # To `update` no total means that it stays; `reset` would set the clock back.
            bar.tasks[0].total = of
            bar.update(task, completed=done, remark=remark)

        yield move


@contextmanager
def staged(
    title: str, shares: Mapping[str, float]
) -> Iterator[Callable[[str, int, int, str], None]]:
    """A progress bar over stages that never moves back.

    Call it with (stage, done, total, remark), where a total of 0 means that none is known.

    Args:
        title: what goes on.
        shares: the stages in order, and how long each takes beside the others.
    """
    names, reached = list(shares), 0.0
    whole = sum(shares.values())
    with progress(title, _STEPS, remaining=False) as move:

        def to(stage: str, done: int, of: int, remark: str) -> None:
            nonlocal reached
            before = sum(shares[name] for name in names[: names.index(stage)])
            within = shares[stage] * min(done / of, 1.0) if of else 0.0
            reached = max(reached, (before + within) / whole)
            move(int(_STEPS * reached), _STEPS, remark)

        yield to


def without_bar(line: str) -> None:
    """Prints a line on standard error where that is a file or pipe, and so shows no bar."""
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


def notes(lines: Sequence[str], most: int = 6) -> None:
    """Prints notes on files; equal ones once, with the number of files instead of their names."""
    same: dict[str, list[str]] = {}
    for note in lines:
        same.setdefault(note.partition(": ")[2] or note, []).append(note)
    grouped = [
        f"{len(every)} files: {text}" if len(every) > 1 else every[0]
        for text, every in same.items()
    ]
    for line in grouped[:most]:
        print(f"  {line}")
    if len(grouped) > most:
        print(f"  and {len(grouped) - most} more; --json lists them all")


def table(title: str, columns: list[str], rows: list[list[str]], numbers_from: int = 1) -> None:
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
