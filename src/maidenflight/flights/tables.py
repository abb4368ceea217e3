"""Tables of numbers as they lie in files: CSV, plain or compressed, and Parquet.

Damage is named by its line and column.
"""

import codecs
import io
import itertools
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import budget, inputs
from maidenflight.errors import InputError
from maidenflight.flights import not_logs, parquet

_LARGEST = float(np.finfo(np.float32).max)
_PARQUET, _UTF16 = b"PAR1", (b"\xff\xfe", b"\xfe\xff")
PART = 8_000_000
"""Bytes of text from which a CSV is read in parts, each a table, so that memory is bounded."""
PART_ROWS = 60_000
"""Rows from which a Parquet file is."""


@dataclass(frozen=True)
class Table:
    """A table as read: columns of any type, at least one row."""

    name: str
    """What errors name."""
    frame: polars.DataFrame
    mark: str = ""
    """First comment line of a CSV."""
    head: dict[str, str] = field(default_factory=dict)
    """What comment lines `# key: value`, or the metadata of a Parquet file, say."""
    first_line: int = 0
    """Line of the first row; 0 where there are no lines."""
    first_row: int = 0
    """Rows of the file above the first."""
    notes: tuple[str, ...] = ()
    """What was left out already."""

    def location(self, row: int) -> str:
        """Returns where a row lies, such as `line 17`; rows count from 0."""
        if self.first_line:
            return f"line {self.first_line + row}"
        return f"row {self.first_row + row + 1}"

    def has_most_of(self, columns: Sequence[str]) -> bool:
        """Returns whether most of the named columns are there."""
        return len(set(columns) & set(self.frame.columns)) >= 0.6 * len(columns)


def read(path: Path, name: str) -> Table:
    """Reads the table in a file of any known format.

    Raises:
        InputError: the file cannot be read, or holds no table.
    """
    return parsed(content(path), path, name)


@contextmanager
def _opened(path: Path) -> Iterator[None]:
    """Says of a file what keeps it from being read."""
    try:
        yield
    except InputError:
        raise
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(
            f"{path}: cannot be read as a flight log ({error}). Copy it again from where it was "
            "recorded."
        ) from error


def parts(path: Path, name: str) -> Iterator[Table]:
    """Reads a table in parts one after another, for files of any length.

    A part of a CSV has the comments and the header of the file above its rows.

    Raises:
        InputError: the file cannot be read, or holds no table.
    """
    with _opened(path):
        if inputs.beginning(path, len(_PARQUET)) == _PARQUET:
            yield from _parquet_parts(path, name)
            return
        head, rest, line = b"", b"", 0
        for block in itertools.chain(inputs.blocks(path, PART), [b""]):
            rest += block
            if block and len(rest) < 2 * PART:
                continue
            # The last part is as long as the others, so that its rows are no short piece.
            whole = rest[: rest.rfind(b"\n", 0, PART) + 1 if block else None]
            budget.LOG.check("bytes a line", 0 if whole else len(rest))
            rest = rest[len(whole) :]
            if not head:
                whole = whole.removeprefix(codecs.BOM_UTF8)
                head = _head(whole)
                whole = whole[len(head) :]
            if whole:
                yield from_text(decoded(head + whole, name, line), name, line)
                line += whole.count(b"\n")
                budget.LOG.check("rows", line)


def is_long(path: Path) -> bool:
    """Returns whether a table, decompressed, is one that is read in parts.

    Raises:
        InputError: the file cannot be read.
    """
    with _opened(path):
        return len(next(inputs.blocks(path, PART + 1), b"")) > PART


def _head(raw: bytes) -> bytes:
    """Returns the lines of a CSV above its first row: comments and the columns' names."""
    end = 0
    while raw.startswith((b"#", b"\n", b"\r"), end) and b"\n" in raw[end:]:
        end = raw.index(b"\n", end) + 1
    line = raw[end : raw.find(b"\n", end) + 1]
    # numpy.savetxt writes the header as a comment.
    numeric = all(_is_number(cell) for cell in line.decode(errors="replace").split(","))
    return raw[:end] if numeric else raw[: end + len(line)]


def parsed(raw: bytes, path: Path, name: str) -> Table:
    """Reads the table in a file's bytes; see `read`."""
    if raw[:4] == _PARQUET:
        return _from_parquet(raw, name)
    if path.name.endswith(".parquet"):
        raise InputError(
            f"{name}: not a Parquet file (it begins with {raw[:4]!r}). Write it again, or name it "
            ".csv if it is one."
        )
    return from_text(decoded(raw, name), name)


def content(path: Path) -> bytes:
    """Returns the bytes of a file that is read at once, decompressed.

    Raises:
        InputError: it cannot be read, or is longer than such files are.
    """
    with _opened(path):
        length, blocks = 0, []
        for block in inputs.blocks(path, PART):
            length += len(block)
            budget.WHOLE_LOG.check("bytes", length)
            blocks.append(block)
        raw = b"".join(blocks)
    if raw[:2] == inputs.GZIP:
        raise InputError(
            f"{path}: cannot be read as a flight log (compressed twice). Decompress it once."
        )
    return raw


def decoded(raw: bytes, name: str, skipped: int = 0) -> str:
    """Returns the text of a file, lines ended by a line feed; `skipped` as of `from_text`."""
    kind = not_logs.kind_of(raw, name)
    if kind is not None:
        raise InputError(f"{name}: this is {not_logs.describe(Counter([kind]))}")
    if raw[:2] in _UTF16:
        raise InputError(f"{name}: cannot be read as a flight log (UTF-16). Save it as UTF-8.")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = skipped + raw[: error.start].count(b"\n") + 1
        raise InputError(
            f"{name}: cannot be read as a flight log (line {line} is not UTF-8 text). Copy it "
            "again, or save it as UTF-8."
        ) from error
    return text.replace("\r\n", "\n")


def from_text(text: str, name: str, skipped: int = 0) -> Table:
    """Reads a CSV with comma, decimal point, a header line, and comment lines above it.

    A last line that is cut off is left out with a note; it is the mark of a recorder that was
    switched off. One without a line feed counts as such, because nobody can tell 0.1 from the
    beginning of 0.15.

    Args:
        text: of the table.
        name: what errors name.
        skipped: rows of the file between its header and those of the text.

    Raises:
        InputError: not such a table, or no rows.
    """
    comments, start = [], 0
    while text.startswith(("#", "\n"), start):
        stop = text.find("\n", start)
        stop = len(text) if stop < 0 else stop
        comments.append(text[start:stop])
        start = stop + 1
    first = text[start : text.find("\n", start)].split(",")
    above = comments[-1].lstrip("# ") if comments else ""
    if len(above.split(",")) == len(first) > 2 and all(map(_is_number, first)):
        # numpy.savetxt writes the header as a comment.
        start -= len(above) + 1
        comments.pop()
    # By places in the text: a long log is hundreds of megabytes, and each copy as much again.
    end = len(text)
    while end > start and text[end - 1] == "\n":
        end -= 1
    line = len(comments) + 1
    header_end = text.find("\n", start, end)
    header = text[start : end if header_end < 0 else header_end]
    if header_end < 0 and not header.strip():
        raise InputError(f"{name}: no rows, the file is empty. Leave it out.")
    names = _names(header, name, line)
    if header_end < 0:
        raise InputError(f"{name}: no rows below the header in line {line}. Leave it out.")
    last = text.rfind("\n", header_end + 1, end)
    notes: tuple[str, ...] = ()
    cut_off = text.count(",", last + 1, end) < len(names) - 1 or not text.endswith("\n")
    if last > 0 and cut_off:
        number = line + skipped + text.count("\n", start, end)
        notes = (f"{name}: 1 row dropped: the last line ({number}) is cut off",)
        end = last
    try:
        frame = _frame(text[start:end].encode())
    except (polars.exceptions.PolarsError, ValueError) as error:
        why = _why_unreadable(text[start:end], name, len(names), (line, skipped), str(error))
        raise InputError(why) from error
    if frame.width != len(names):
        raise InputError(
            f"{name}: line {line} is no header of {frame.width} columns. Write names separated by "
            "commas."
        )
    pairs = (comment[1:].strip().partition(": ") for comment in comments)
    frame.columns = names
    head = {key: value for key, colon, value in pairs if colon}
    return Table(
        name, frame, comments[0] if comments else "", head, line + 1 + skipped, notes=notes
    )


def _frame(body: bytes) -> polars.DataFrame:
    """Reads a CSV; types by its first rows, six times as fast as by all, or else by all."""
    try:
        return polars.read_csv(body, infer_schema_length=1000)
    except polars.exceptions.PolarsError:
        return polars.read_csv(body, infer_schema_length=None)


def _names(header: str, name: str, line: int) -> list[str]:
    try:
        budget.LOG.check("columns", header.count(",") + 1)
    except ValueError as error:
        raise InputError(f"{name}: line {line} has {error}. Give a flight log.") from error
    names = [cell.strip().strip('"').strip() for cell in header.split(",")]
    if "\x00" in header:
        raise InputError(
            f"{name}: cannot be read as a flight log (line {line} is binary). Give a CSV or "
            "Parquet file."
        )
    for sign, word in ((";", "semicolons"), ("\t", "tabs")):
        if sign in header and header.count(sign) > header.count(","):
            raise InputError(
                f"{name}: columns are separated by {word} in line {line}; expected commas, and "
                "points in decimals. Convert it."
            )
    if len(names) > 2 and all(_is_number(cell) for cell in names):
        raise InputError(
            f"{name}: line {line} holds numbers, expected the columns' names. Put back the header "
            "line."
        )
    twice = sorted({column for column in names if names.count(column) > 1})
    if twice:
        raise InputError(
            f"{name}: column {', '.join(map(repr, twice[:3]))} is there twice in line {line}. "
            "Give each its own name."
        )
    return names


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _why_unreadable(body: str, name: str, columns: int, lines: tuple[int, int], reason: str) -> str:
    for number, row in enumerate(body.split("\n"), sum(lines)):
        if row.count(",") >= columns and '"' not in row:
            return (
                f"{name}: not a readable CSV table: line {number} has {row.count(',') + 1} "
                f"cells, the header {columns}. Mend or drop it."
            )
    return f"{name}: not a readable CSV table ({reason.splitlines()[0] if reason else 'damaged'})."


def _parquet_parts(path: Path, name: str) -> Iterator[Table]:
    frame, rows, head = parquet.open_parquet(path, path.stat().st_size, name)
    starts = range(0, max(1, rows - PART_ROWS + 1), PART_ROWS)
    for start in starts:
        with parquet.explain_errors(name):
            part = frame.slice(start, None if start == starts[-1] else PART_ROWS).collect()
        yield Table(name, part, head=head, first_row=start)


def _from_parquet(raw: bytes, name: str) -> Table:
    frame, rows, head = parquet.open_parquet(io.BytesIO(raw), len(raw), name)
    if rows == 0:
        raise InputError(f"{name}: no rows. Leave the file out.")
    with parquet.explain_errors(name):
        return Table(name, frame.collect(), head=head)


def numbers(table: Table, columns: Iterable[str]) -> dict[str, Float[np.ndarray, "N"]]:
    """Returns named columns as float64 arrays.

    Empty cells are NaN, numbers beyond float32 infinite.

    Raises:
        InputError: a column is missing or holds something that is not a number.
    """
    columns = list(columns)
    missing = [column for column in columns if column not in table.frame.columns]
    if missing:
        raise InputError(
            f"{table.name}: missing column {', '.join(missing)}; expected {', '.join(columns)}."
        )
    return {column: _numeric(table, column) for column in columns}


def _numeric(table: Table, column: str) -> np.ndarray:
    series = table.frame[column]
    if series.dtype == polars.String:
        series = _parsed(table, column, series.str.strip_chars())
    elif not (series.dtype.is_numeric() or series.dtype == polars.Null):
        kind, cell = series.dtype, str(series[0])[:40]
        raise InputError(
            f"{table.name}: column {column} holds {kind} such as {cell!r}, which is not a number. "
            "Convert it."
        )
    values = series.cast(polars.Float64).to_numpy()
    return np.where(np.abs(values) > _LARGEST, np.inf, values)


def _parsed(table: Table, column: str, cells: polars.Series) -> polars.Series:
    numbers = cells.cast(polars.Float64, strict=False)
    odd = numbers.is_null() & cells.is_not_null() & (cells != "")
    if odd.any():
        row = int(odd.arg_max() or 0)
        cell = str(cells[row])[:40]
        again = (
            " The header stands there again: two logs in one file? Split them."
            if cell == column
            else " Mend or drop the line."
        )
        raise InputError(
            f"{table.name}: column {column} holds something that is not a number, {cell!r} in "
            f"{table.location(row)}.{again}"
        )
    return numbers
