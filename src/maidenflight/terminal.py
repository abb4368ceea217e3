"""Output in a terminal: progress bars and notes on standard error, tables on standard output."""

import math
import os
import re
import string
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TextIO

from maidenflight import events
from maidenflight.errors import printable

_PER_SI = {"cm": 100.0, "g": 1e3, "deg": math.degrees(1.0), "deg/s": math.degrees(1.0)}
"""Displayed value per value in SI units, of the units that are none."""
_NUMBER = re.compile(r"[-+*]? ?\d|$|none$|unknown$")
"""How cells begin that are aligned right."""
_GAP, _PROSE = 2, 12
"""Columns of the gap behind a cell, and least columns that texts are folded to."""


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
        width = max(6, min(24, console.width // 5))
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
            *columns,
            console=console,
            disable=not (console.is_terminal or console.is_jupyter),
            expand=True,
        )
        self._bar.add_task(self._title, total=None, remark="")
        self._bar.start()
        events.tell(done=0, total=None, remark="loading")
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def move(self, done: int, total: int | None, remark: str = "") -> None:
        """Moves the bar."""
        events.tell(done=done, total=total, remark=remark)
        # To `update` no total means that it stays; `reset` would set the clock back.
        self._bar.tasks[0].total = total
        self._bar.update(self._bar.tasks[0].id, completed=done, remark=remark)

    def log(self, line: str, always: bool = False) -> None:
        """Writes a line where standard error is a file or pipe and so shows no bar, or always."""
        if events.tell(line=line):
            return
        if always or not sys.stderr.isatty():
            print(printable(line), file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        """Writes a note, once."""
        if text not in self._noted:
            self._noted.add(text)
            if events.tell(note=text):
                return
            print(lay_out(f"note: {printable(text)}", sys.stderr), file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Table:
    """A table for people, of values in SI units."""

    title: str
    columns: Mapping[str, str]
    """The cells of each column by its title, as a template of a row: `{duration:.2f s}`, or
    `{error:.1f cm}` of metres. What is None stays empty, what is not a number is `none`."""
    rows: Sequence[Mapping[str, Any]]
    rare: Sequence[str] = ()
    """Columns that a narrow terminal leaves out, in this order."""

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


def columns_of(stream: TextIO) -> int | None:
    """Returns the columns to lay text out for; None for a file or pipe without `COLUMNS`."""
    if os.environ.get("COLUMNS", "").isdecimal() and int(os.environ["COLUMNS"]) > 0:
        return int(os.environ["COLUMNS"])
    try:
        return os.get_terminal_size(stream.fileno()).columns if stream.isatty() else None
    except (OSError, ValueError):  # none that the system knows
        return None


def lay_out(text: str, stream: TextIO) -> str:
    """Breaks lines between words, where a stream has columns; paths and words stay whole."""
    columns = columns_of(stream)
    if columns is None:
        return text
    return "\n".join(
        textwrap.fill(
            line,
            max(columns, 20),
            subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
            break_long_words=False,
            break_on_hyphens=False,
        )
        if len(line) > columns
        else line
        for line in text.split("\n")
    )


def show(*parts: Table | str) -> None:
    """Prints tables and lines."""
    for part in parts:
        if isinstance(part, str):
            print(lay_out(printable(part), sys.stdout))
        else:
            print_table(part.title, list(part.columns), part.cells, part.rare)


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    rare: Sequence[str] = (),
) -> None:
    """Prints a table of texts; columns of numbers behind the first are aligned right.

    Where it is wider than the terminal, heads are folded between words, then columns are left out
    and named below, then cells are folded. Into a file or a pipe it is as wide as it needs to be.
    Words and paths stay whole, though they be wider than the terminal.

    Args:
        title: above it.
        columns: their heads.
        rows: a text for each column.
        rare: columns to leave out, in this order.
    """
    texts = {head: [printable(row[index]) for row in rows] for index, head in enumerate(columns)}
    width, left_out = columns_of(sys.stdout), list[str]()
    widths = _widths(texts, fold=False)
    if width is not None and _total(widths) > width:
        widths = _widths(texts, fold=True)
        for head in rare:
            if _total(widths) > width and head in texts:
                left_out.append(" ".join(head.split()))
                del texts[head], widths[head]
        _shrink(widths, texts, width)
    print(lay_out(f"\n{title}", sys.stdout))
    _print_grid(texts, widths)
    if left_out:
        show(f"This terminal is too narrow for: {', '.join(left_out)}.")


def _total(widths: Mapping[str, int]) -> int:
    return sum(widths.values()) + _GAP * len(widths)


def _longest(texts: Iterable[str], words: bool = False) -> int:
    """The longest line, or word, of some texts."""
    return max(
        (len(part) for text in texts for part in (text.split() if words else text.split("\n"))),
        default=0,
    )


def _widths(texts: Mapping[str, Sequence[str]], fold: bool) -> dict[str, int]:
    """Columns that cells need, and heads as they are or folded between words."""
    return {
        head: max(_longest([head], words=fold), _longest(cells)) for head, cells in texts.items()
    }


def _shrink(widths: dict[str, int], texts: Mapping[str, Sequence[str]], width: int) -> None:
    """Makes the widest columns behind the first narrower, as far as words and paths stay whole."""
    others = list(texts.items())[1:]
    least = {head: max(_longest([head, *cells], words=True), _PROSE) for head, cells in others}
    while _total(widths) > width:
        able = {head: widths[head] for head in least if widths[head] > least[head]}
        if not able:
            return
        widths[max(able, key=able.__getitem__)] -= 1


def _print_grid(texts: Mapping[str, Sequence[str]], widths: Mapping[str, int]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for number, (head, cells) in enumerate(texts.items()):
        numeric = number > 0 and all(map(_NUMBER.match, cells))
        justify = "right" if numeric else "left"
        grid.add_column(head, justify=justify, overflow="fold", width=widths[head])
    for row in zip(*texts.values(), strict=True):
        grid.add_row(*map(Text, row))
    Console(width=max(_total(widths), 1)).print(grid)
