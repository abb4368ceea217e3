"""Parquet files of flights: opened by what their footers say, before any row is read."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import polars

from maidenflight import budget
from maidenflight.errors import InputError


def open_parquet(
    source: Path | io.BytesIO, size: int, name: str
) -> tuple[polars.LazyFrame, int, dict[str, str]]:
    """Returns the rows of a Parquet file, not yet read, their number and what its metadata say.

    Columns of texts and lists are left out: nobody says how long these are while they are packed.

    Raises:
        InputError: it is damaged, or exceeds `budget.LOG`.
    """
    with explain_errors(name):
        frame = polars.scan_parquet(source)
        schema = frame.collect_schema()
        columns = [column for column, kind in schema.items() if not _is_endless(kind)]
        budget.LOG.check("columns", len(schema))
        rows = frame.select(polars.len()).collect().item()
        budget.LOG.check("rows", rows)
        budget.LOG.check_growth(size, 8 * rows * len(schema))
        if isinstance(source, io.BytesIO):
            source.seek(0)
        return frame.select(columns), rows, polars.read_parquet_metadata(source)


def _is_endless(kind: polars.DataType) -> bool:
    return kind.is_nested() or kind in (polars.String, polars.Binary, polars.Categorical)


@contextmanager
def explain_errors(name: str) -> Iterator[None]:
    """Says of a Parquet file what keeps it from being read.

    Raises:
        InputError: as above.
    """
    try:
        yield
    except (
        polars.exceptions.PolarsError,
        polars.exceptions.PanicException,
        ValueError,
        OSError,
        OverflowError,
    ) as error:
        raise InputError(
            f"{name}: not a readable Parquet file ({str(error).splitlines()[0]}). Copy it again."
        ) from error
