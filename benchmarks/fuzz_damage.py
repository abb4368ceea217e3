"""Random, seeded damage to files: bytes; cells, columns and rows of tables.

Each piece of damage says what a reader may make of it: refuse it (`REFUSED`), take it for what was
there before (`SAME`), for a beginning of that (`PREFIX`), for no fewer rows than before unless a
note tells (`TOLD`), or for anything that is sound in itself (`ANY`). A reader may refuse whatever
is damaged.
"""

import random
from collections.abc import Callable, Sequence
from typing import NamedTuple

REFUSED, SAME, PREFIX, TOLD, ANY = "refused", "same", "prefix", "told", "any"


class Damaged(NamedTuple):
    """A file to be read."""

    content: bytes | None
    """`None`: `what` is no ordinary file."""
    what: str
    """In a word or two."""
    verdict: str
    """The most that a reader may make of it."""


class Kind(NamedTuple):
    """How files of a kind take damage to their bytes."""

    truncated: str
    """Verdict on a file that is cut."""
    flipped: str = ANY
    """Verdict on other bytes in places; `SAME` where a check sum guards all of it."""


SPECIAL = (
    "folder",
    "pipe",
    "link to itself",
    "link to nothing",
    "link to a device",
    "link to the file",
)
"""What may stand in a file's place."""


def special(generator: random.Random) -> Damaged:
    """Something that is no ordinary file."""
    what = generator.choice(SPECIAL)
    return Damaged(None, what, SAME if what == "link to the file" else REFUSED)


def of_bytes(generator: random.Random, good: bytes, other: bytes, kind: Kind) -> Damaged:
    """The bytes of a good file, damaged.

    `other` is another good file, of which parts may come in.
    """
    where, length = generator.randrange(len(good)), generator.choice((1, 2, 7, 64, 999))
    before, after = good[:where], good[where:]

    def flipped() -> bytes:
        changed = bytearray(good)
        for _ in range(generator.choice((1, 1, 1, 3, 30))):
            changed[generator.randrange(len(good))] ^= 1 << generator.randrange(8)
        return bytes(changed)

    def donor() -> bytes:
        start = generator.randrange(len(other))
        return other[start : start + length]

    makes: dict[str, tuple[str, Callable[[], bytes]]] = {
        "bits flipped": (kind.flipped, flipped),
        "bytes overwritten": (
            kind.flipped,
            lambda: before + generator.randbytes(min(length, len(after))) + after[length:],
        ),
        "bytes put in": (kind.flipped, lambda: before + generator.randbytes(length) + after),
        "bytes lost": (kind.flipped, lambda: before + after[length:]),
        "a part repeated": (kind.flipped, lambda: before + after[:length] + after),
        "a part of another file": (kind.flipped, lambda: before + donor() + after[length:]),
        "another file's end": (ANY, lambda: before + other[generator.randrange(len(other)) :]),
        "zeros": (kind.flipped, lambda: before + bytes(length) + after[length:]),
        "a tail of zeros": (kind.flipped, lambda: good + bytes(length)),
        "noise": (REFUSED, lambda: generator.randbytes(length)),
        "empty": (
            REFUSED,
            lambda: generator.choice((b"", b"\n", b"\n\n\n", b" ", b"\xef\xbb\xbf", b"\x00")),
        ),
        "cut": (kind.truncated, lambda: before),
        "the end cut": (
            kind.truncated,
            lambda: good[: -min(generator.randint(2, 80), len(good) - 1)],
        ),
    }
    what = generator.choice([*makes, "bits flipped", "cut", "the end cut"])
    verdict, make = makes[what]
    return Damaged(make(), what, verdict)


def of_encoding(generator: random.Random, good: bytes) -> Damaged:
    """The same text as other programs would save it."""
    text = good.decode()
    makes: dict[str, tuple[str, bytes]] = {
        "a mark of UTF-8": (SAME, b"\xef\xbb\xbf" + good),
        "lines as of Windows": (SAME, good.replace(b"\n", b"\r\n")),
        "lines as of old": (SAME, good.replace(b"\n", b"\r")),
        "UTF-16": (REFUSED, text.encode("utf-16")),
        "UTF-32": (REFUSED, text.encode("utf-32")),
        "letters of Latin-1": (REFUSED, good[: len(good) // 2] + b"\xe9" + good[len(good) // 2 :]),
        "NUL": (ANY, good[: len(good) // 3] + b"\x00" + good[len(good) // 3 :]),
    }
    what = generator.choice(list(makes))
    verdict, content = makes[what]
    return Damaged(content, what, verdict)


CELLS = (
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e400",
        "-1e400",
        "1e39",
        "-1",
        "0",
        "1e-320",
        "",
        " ",
        "abc",
        "true",
        "null",
        "None",
        "0x10",
        "1_0",
    ),
    *(
        "1" * 400,
        "9" * 5000,
        "a" * 20_000,
        "1,2",
        '"',
        '"1"',
        "'",
        "#",
        "\x00",
        "\uff11",
        "2024-05-01",
        "1.5.2",
        "--1",
        "\r",
        "\u2028",
    ),
)
"""What may stand in a cell instead of a number."""


Content = tuple[list[str], list[str], list[list[str]]]
"""Of a table: comments, names of columns, rows of cells."""


class _Place(NamedTuple):
    """What of a table is damaged, and by what."""

    column: int
    other: int
    row: int
    few: Sequence[int]
    odd: str
    factor: float


def _damage_cells(content: Content, at: _Place) -> dict[str, tuple[str, Callable[[], Content]]]:
    """Damages to cells and columns of numbers, each with its verdict."""
    comments, names, rows = content

    def put(cells: list[str]) -> list[str]:
        return [*cells[: at.column], at.odd, *cells[at.column + 1 :]]

    def scaled(cells: list[str]) -> list[str]:
        try:
            number = repr(float(cells[at.column]) * at.factor)
        except ValueError:
            return cells
        return [*cells[: at.column], number, *cells[at.column + 1 :]]

    def put_in(places: Sequence[int]) -> Content:
        return (
            comments,
            names,
            [put(cells) if number in places else cells for number, cells in enumerate(rows)],
        )

    return {
        "a cell": (TOLD, lambda: put_in([at.row])),
        "some cells": (TOLD, lambda: put_in(at.few)),
        "a column": (ANY, lambda: (comments, names, [put(cells) for cells in rows])),
        "a column scaled": (ANY, lambda: (comments, names, [scaled(cells) for cells in rows])),
        "spaces": (TOLD, lambda: (comments, names, [[f" {one} " for one in row] for row in rows])),
        "quotation marks": (
            TOLD,
            lambda: (comments, names, [[f'"{one}"' for one in row] for row in rows]),
        ),
        "semicolons": (
            REFUSED,
            lambda: (comments, [";".join(names)], [[";".join(row)] for row in rows]),
        ),
    }


def _damage_columns(
    content: Content, at: _Place, needed: Sequence[str], shown: Sequence[str]
) -> dict[str, tuple[str, Callable[[], Content]]]:
    """Damages to columns and their names, each with its verdict."""
    comments, names, rows = content
    name, column = names[at.column], at.column

    def without(cells: list[str]) -> list[str]:
        return cells[:column] + cells[column + 1 :]

    def swapped(cells: list[str]) -> list[str]:
        cells = list(cells)
        cells[column], cells[at.other] = cells[at.other], cells[column]
        return cells

    lost = REFUSED if name in needed else ANY
    return {
        "a column missing": (
            lost,
            lambda: (comments, without(names), [without(cells) for cells in rows]),
        ),
        "a column renamed": (
            lost,
            lambda: (comments, [*names[:column], name + "_", *names[column + 1 :]], rows),
        ),
        "a column twice": (
            REFUSED if name in (needed or shown) else ANY,
            lambda: (comments, [*names, name], [[*cells, "1"] for cells in rows]),
        ),
        "names of columns swapped": (ANY, lambda: (comments, swapped(names), rows)),
        "columns and their names swapped": (
            SAME,
            lambda: (comments, swapped(names), [swapped(cells) for cells in rows]),
        ),
        "no header": (REFUSED, lambda: (comments, rows[0], rows[1:] or rows)),
    }


def _damage_rows(
    content: Content, at: _Place, generator: random.Random
) -> dict[str, tuple[str, Callable[[], Content]]]:
    """Damages to rows and comments, each with its verdict."""
    comments, names, rows = content
    row = at.row

    def kept() -> list[list[str]]:
        return [cells for number, cells in enumerate(rows) if number not in at.few] or rows

    def repeated() -> list[list[str]]:
        return [cells for number, cells in enumerate(rows) for _ in range(1 + (number in at.few))]

    return {
        "rows lost": (ANY, lambda: (comments, names, kept())),
        "all rows lost": (REFUSED, lambda: (comments, names, [])),
        "rows repeated": (ANY, lambda: (comments, names, repeated())),
        "rows turned": (ANY, lambda: (comments, names, rows[:row] + rows[row:][::-1])),
        "a row cut": (
            ANY,
            lambda: (comments, names, [*rows[:row], rows[row][: at.column], *rows[row + 1 :]]),
        ),
        "a cell too many": (
            REFUSED,
            lambda: (comments, names, [*rows[:row], [*rows[row], "1"], *rows[row + 1 :]]),
        ),
        "the header again": (REFUSED, lambda: (comments, names, [*rows[:row], names, *rows[row:]])),
        "a comment lost": (ANY, lambda: (comments[1:], names, rows)),
        "a comment too many": (
            ANY,
            lambda: (["# " + at.odd.replace("\r", ""), *comments], names, rows),
        ),
        "another's comments": (
            ANY,
            lambda: ([comment[: generator.randint(1, 60)] for comment in comments], names, rows),
        ),
    }


_TABLE_DAMAGES = (
    *("a cell", "some cells", "a column", "a column scaled", "a column missing"),
    *("a column renamed", "a column twice", "names of columns swapped"),
    *("columns and their names swapped", "rows lost", "all rows lost", "rows repeated"),
    *("rows turned", "a row cut", "a cell too many", "the header again", "no header"),
    *("a comment lost", "a comment too many", "another's comments", "semicolons", "spaces"),
    "quotation marks",
)
"""In the order in which a seed draws them."""


def of_table(
    generator: random.Random, good: bytes, needed: Sequence[str], shown: Sequence[str] = ()
) -> Damaged:
    """A CSV with comment lines above its header, damaged in cells, columns or rows.

    Args:
        generator: of randomness.
        good: the file.
        needed: columns that a reader must miss.
        shown: columns that a reader must have once.
    """
    lines = good.decode().rstrip("\n").split("\n")
    first = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    names, rows = lines[first].split(","), [line.split(",") for line in lines[first + 1 :]]
    content = lines[:first], names, rows
    column = generator.choice(
        [number for number, name in enumerate(names) if not needed or name in needed]
    )
    other, row = generator.randrange(len(names)), generator.randrange(len(rows))
    odd, factor = (
        generator.choice(CELLS),
        generator.choice((-1.0, 0.0, 1e-3, 57.3, 1000.0, 65535.0, 1e30, 1e300)),
    )
    few = generator.sample(range(len(rows)), min(len(rows), generator.choice((1, 3, 20))))
    at = _Place(column, other, row, few, odd, factor)
    damages = {
        **_damage_cells(content, at),
        **_damage_columns(content, at, needed, shown),
        **_damage_rows(content, at, generator),
    }
    what = generator.choice([*_TABLE_DAMAGES, "a cell", "a cell", "some cells"])
    verdict, make = damages[what]
    head, header, body = make()
    text = "\n".join([*head, ",".join(header), *map(",".join, body)]) + "\n"
    return Damaged(text.encode(), f"{what}: {odd[:12]!r}" if "cell" in what else what, verdict)
