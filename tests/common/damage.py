"""Strategies of hypothesis for damaged files: bytes, text, tables, trees, Parquet and arrays.

Each example says the most that a reader may make of it; it may always refuse.
"""

import io
import json
import random
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars
import tomlkit
from hypothesis import strategies as st

REFUSED, SAME, PREFIX, TOLD, ANY = "refused", "same", "prefix", "told", "any"
"""Nothing; what was there before; a beginning of that; no fewer rows unless a note says so;
anything that is sound in itself."""


class Damaged(NamedTuple):
    """A damaged file."""

    content: bytes
    what: str
    verdict: str


Damage = Callable[[bytes, bytes], st.SearchStrategy[Damaged]]
"""(a good file, another one) to its damages."""


@st.composite
def damaged_bytes(draw: Any, good: bytes, other: bytes, cut: str = ANY, changed: str = ANY) -> Any:
    """Draws damage to bytes.

    Args:
        draw: of hypothesis.
        good: the file.
        other: another one, of which parts may come in.
        cut: verdict on a file that is cut.
        changed: verdict on other bytes in places; `SAME` where a check sum guards them.
    """
    noise = random.Random(draw(st.integers(0, 2**32)))
    where, length = draw(st.integers(0, len(good) - 1)), draw(st.sampled_from((1, 2, 7, 64, 999)))
    before, after = good[:where], good[where:]
    flipped = bytearray(good)
    for place in draw(st.lists(st.integers(0, len(good) - 1), min_size=1, max_size=30)):
        flipped[place] ^= 1 << (place % 8)
    start = draw(st.integers(0, len(other) - 1))
    few = min(draw(st.integers(2, 80)), len(good) - 1)
    examples = [
        Damaged(bytes(flipped), "bits flipped", changed),
        Damaged(before + noise.randbytes(length) + after[length:], "overwritten", changed),
        Damaged(before + noise.randbytes(length) + after, "bytes put in", changed),
        Damaged(before + after[length:], "bytes lost", changed),
        Damaged(before + after[:length] + after, "a part repeated", changed),
        Damaged(before + other[start : start + length] + after[length:], "another's part", changed),
        Damaged(before + other[start:], "another's end", ANY),
        Damaged(before + bytes(length) + after[length:], "zeros", changed),
        Damaged(good + bytes(length), "a tail of zeros", changed),
        Damaged(noise.randbytes(length), "noise", REFUSED),
        Damaged(draw(st.sampled_from((b"", b"\n", b" ", b"\xef\xbb\xbf", b"\0"))), "none", REFUSED),
        Damaged(before, "cut", cut),
        Damaged(good[:-few], "the end cut", cut),
    ]
    return draw(st.sampled_from(examples))


def damaged_encoding(good: bytes) -> st.SearchStrategy[Damaged]:
    """Draws the same text as other programs would save it."""
    text, half = good.decode(), len(good) // 2
    return st.sampled_from(
        [
            Damaged(b"\xef\xbb\xbf" + good, "a mark of UTF-8", SAME),
            Damaged(good.replace(b"\n", b"\r\n"), "lines as of Windows", SAME),
            Damaged(good.replace(b"\n", b"\r"), "lines as of old", SAME),
            Damaged(text.encode("utf-16"), "UTF-16", REFUSED),
            Damaged(text.encode("utf-32"), "UTF-32", REFUSED),
            Damaged(good[:half] + b"\xe9" + good[half:], "Latin-1", REFUSED),
            Damaged(good[:half] + b"\0" + good[half:], "NUL", ANY),
        ]
    )


CELLS = (
    *("nan", "inf", "-inf", "1e400", "-1e400", "1e39", "-1", "0", "1e-320", "", " ", "abc", "true"),
    *("null", "0x10", "1_0", "1" * 400, "9" * 5000, "a" * 20_000, "1,2", '"', '"1"', "'", "#"),
    *("\0", "\uff11", "2024-05-01", "1.5.2", "--1", "\r", "\u2028"),
)
"""What may stand in a cell instead of a number."""


@st.composite
def damaged_cells(draw: Any, good: bytes, needed: Sequence[str], unique: Sequence[str]) -> Any:
    """Draws damage to cells, columns and rows of a CSV with comments above its header.

    Args:
        draw: of hypothesis.
        good: the file.
        needed: columns that a reader must miss.
        unique: columns of which a reader must have one, where none is needed.
    """
    lines = good.decode().rstrip("\n").split("\n")
    first = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    head, names = lines[:first], lines[first].split(",")
    rows = [line.split(",") for line in lines[first + 1 :]]
    usable = [number for number, name in enumerate(names) if not needed or name in needed]
    column, other = draw(st.sampled_from(usable)), draw(st.integers(0, len(names) - 1))
    row, odd = draw(st.integers(0, len(rows) - 1)), draw(st.sampled_from(CELLS))
    factor = draw(st.sampled_from((-1.0, 0.0, 1e-3, 57.3, 1000.0, 65535.0, 1e30, 1e300)))
    few = draw(st.sets(st.integers(0, len(rows) - 1), min_size=1, max_size=20))
    name = names[column]

    def put(cells: list[str], text: str) -> list[str]:
        return [*cells[:column], text, *cells[column + 1 :]]

    def scale(text: str) -> str:
        try:
            return repr(float(text) * factor)
        except ValueError:
            return text

    def swap(cells: list[str]) -> list[str]:
        places = list(range(len(cells)))
        places[column], places[other] = other, column
        return [cells[place] for place in places]

    def without(cells: list[str]) -> list[str]:
        return cells[:column] + cells[column + 1 :]

    def with_odd(places: set[int]) -> list[list[str]]:
        return [put(cells, odd) if at in places else cells for at, cells in enumerate(rows)]

    def some(copies: Callable[[bool], int]) -> list[list[str]]:
        return [cells for at, cells in enumerate(rows) for _ in range(copies(at in few))]

    lost = REFUSED if name in needed else ANY
    twice = REFUSED if name in (needed or unique) else ANY
    examples: list[tuple[str, str, list[str], list[str], list[list[str]]]] = [
        ("a cell", TOLD, head, names, with_odd({row})),
        ("some cells", TOLD, head, names, with_odd(few)),
        ("a column", ANY, head, names, with_odd(set(range(len(rows))))),
        ("a scale", ANY, head, names, [put(cells, scale(cells[column])) for cells in rows]),
        ("spaces", TOLD, head, names, [[f" {cell} " for cell in cells] for cells in rows]),
        ("quotes", TOLD, head, names, [[f'"{cell}"' for cell in cells] for cells in rows]),
        ("semicolons", REFUSED, head, [";".join(names)], [[";".join(cells)] for cells in rows]),
        ("no column", lost, head, without(names), [without(cells) for cells in rows]),
        ("another name", lost, head, put(names, name + "_"), rows),
        ("a column twice", twice, head, [*names, name], [[*cells, "1"] for cells in rows]),
        ("names swapped", ANY, head, swap(names), rows),
        ("columns swapped", SAME, head, swap(names), [swap(cells) for cells in rows]),
        ("no header", REFUSED, head, rows[0], rows[1:] or rows),
        ("rows lost", ANY, head, names, some(lambda chosen: not chosen) or rows),
        ("all rows lost", REFUSED, head, names, []),
        ("rows repeated", ANY, head, names, some(lambda chosen: 1 + chosen)),
        ("rows turned", ANY, head, names, rows[:row] + rows[row:][::-1]),
        ("a row cut", ANY, head, names, [*rows[:row], rows[row][:column], *rows[row + 1 :]]),
        ("a cell more", REFUSED, head, names, [*rows[:row], [*rows[row], "1"], *rows[row + 1 :]]),
        ("headers", REFUSED, head, names, [*rows[:row], names, *rows[row:]]),
        ("a comment lost", ANY, head[1:], names, rows),
        ("a comment more", ANY, ["# " + odd.replace("\r", ""), *head], names, rows),
        ("comments cut", ANY, [comment[: 1 + row % 60] for comment in head], names, rows),
    ]
    what, verdict, *content = draw(st.sampled_from(examples))
    text = "\n".join([*content[0], ",".join(content[1]), *map(",".join, content[2])]) + "\n"
    return Damaged(text.encode(), what, verdict)


def damaged_table(needed: Sequence[str], cut: str, unique: Sequence[str] = ()) -> Damage:
    """Returns how a CSV is damaged; see `damaged_cells` and `damaged_bytes`."""

    def draws(good: bytes, other: bytes) -> st.SearchStrategy[Damaged]:
        cells = damaged_cells(good, needed, unique)
        return cells | cells | damaged_encoding(good) | damaged_bytes(good, other, cut)

    return draws


_RAW = "@raw@"
LEAVES: tuple[Any, ...] = (
    *(f"{_RAW}{one}" for one in ("NaN", "Infinity", "1e400", "1" * 5000, "[" * 3000 + "]" * 3000)),
    *(None, True, False, "", "text", "0.5", "a" * 100_000, "\0", "a\nb", [], {}, [[]], [1.0, [2]]),
    *({"a": 1}, 10**30),
)
"""What can never stand for a number that is needed."""
NUMBERS = (-1, 0, 1, -0.0, 2**31, 2**63, 1e-320, 1e-30, 1e38, 1e39, 1e300, 0.5, 2.5, 1000, 1001)
"""Numbers, which may or may not make sense."""


@st.composite
def damaged_values(
    draw: Any, good: dict[str, Any], needed: Callable[[tuple[Any, ...]], bool], language: str
) -> Any:
    """Draws damage to one place of a tree, written as `json` or `toml`.

    Args:
        draw: of hypothesis.
        good: the tree.
        needed: whether what stands at a path must be there and be of its type.
        language: in which it is written.
    """
    parent: Any = json.loads(json.dumps(good))
    tree, path = parent, [draw(st.sampled_from(sorted(parent)))]
    while isinstance(inner := parent[path[-1]], dict | list) and inner and draw(st.integers(0, 3)):
        parent = inner
        places = sorted(parent) if isinstance(parent, dict) else list(range(len(parent)))
        path.append(draw(st.sampled_from(places)))
    key, named = path[-1], isinstance(parent, dict)
    old, wanted = parent[key], REFUSED if needed(tuple(path)) else ANY
    is_number = isinstance(old, int | float) and not isinstance(old, bool)
    kinds = ["another type", "another number", "a list", "a key too many"]
    what = draw(
        st.sampled_from([*kinds, "no key", "another key", "a key twice"] if named else kinds)
    )
    verdict = ANY
    if what == "another type":
        parent[key], verdict = draw(st.sampled_from(LEAVES)), wanted if is_number else ANY
    elif what == "another number":
        parent[key] = draw(st.sampled_from(NUMBERS))
    elif what == "a list":
        parent[key], verdict = [old], wanted
    elif what == "a key too many":
        (parent if named else tree)["unknown_key"] = draw(st.sampled_from(LEAVES[5:]))
    elif what == "a key twice":
        parent[f"@twice@{key}"], verdict = old, REFUSED
    else:
        del parent[key]
        verdict = wanted
        if what == "another key":
            parent[f"{key}_"] = old
    text = json.dumps(tree) if language == "json" else tomlkit.dumps(_without_none(tree))
    first, *others = text.split(f'"{_RAW}')
    text = first + "".join(other.replace('"', "", 1) for other in others)
    if language == "toml":
        text = text.replace("= NaN", "= nan").replace("= Infinity", "= inf")
    content = text.replace("@twice@", "").encode("utf-8", "surrogatepass")
    return Damaged(content, f"{what} at {'.'.join(map(str, path))[:40]}", verdict)


def _without_none(tree: Any) -> Any:
    """TOML has no null; an empty table comes nearest."""
    if isinstance(tree, dict):
        return {name: _without_none(value) for name, value in tree.items()}
    if isinstance(tree, list):
        return [_without_none(value) for value in tree]
    return {} if tree is None else tree


def damaged_tree(
    parse: Callable[[str], dict[str, Any]],
    needed: Callable[[tuple[Any, ...]], bool],
    cut: str,
) -> Damage:
    """Returns how a file of JSON or TOML is damaged; see `damaged_values` and `damaged_bytes`."""
    language = "json" if parse is json.loads else "toml"

    def draws(good: bytes, other: bytes) -> st.SearchStrategy[Damaged]:
        values = damaged_values(parse(good.decode()), needed, language)
        return values | values | damaged_encoding(good) | damaged_bytes(good, other, cut)

    return draws


@st.composite
def damaged_parquet(draw: Any, good: bytes, other: bytes) -> Any:
    """Draws damage to a table in Parquet: its bytes, columns or metadata."""
    frame = polars.read_parquet(io.BytesIO(good))
    head = polars.read_parquet_metadata(io.BytesIO(good))
    head = {name: value for name, value in head.items() if not name.startswith("ARROW")}
    column = polars.col(name := draw(st.sampled_from(frame.columns)))
    odd: Any = draw(
        st.sampled_from((None, np.nan, np.inf, -1, 1e300, "text", True, [1.0], {"a": 1}, 2**62))
    )
    empty = polars.Series(draw(st.permutations([True] * 20 + [False] * (frame.height - 20))))
    what = draw(st.sampled_from(("bytes", "type", "missing", "rows", "head", "cells", "decimals")))
    if what == "bytes":
        return draw(damaged_bytes(good, other, REFUSED))
    if what == "type":
        frame = frame.with_columns(polars.Series(name, [odd] * frame.height))
    elif what == "missing":
        frame = frame.drop(name)
    elif what == "rows":
        frame = frame.clear()
    elif what == "head":
        head = draw(st.sampled_from(({}, {"commands": "some"}, {**head, "record": "{"})))
    elif what == "cells":
        frame = frame.with_columns(polars.when(~empty).then(column).alias(name))
    else:
        frame = frame.with_columns(column.cast(polars.Decimal(30, 8), strict=False))
    frame.write_parquet(file := io.BytesIO(), metadata=head)
    return Damaged(file.getvalue(), what, REFUSED if what == "rows" else ANY)


@st.composite
def damaged_arrays(draw: Any, good: bytes, other: bytes) -> Any:
    """Draws damage to an archive of arrays, whose bytes have check sums."""
    if draw(st.booleans()):
        return draw(damaged_bytes(good, other, REFUSED, SAME))
    arrays = dict(np.load(io.BytesIO(good)))
    name = draw(st.sampled_from(sorted(arrays)))
    odd = (np.zeros(3), np.array("text"), np.array([None, {}], object), np.zeros((0, 5)))
    arrays[name] = draw(st.sampled_from((*odd, np.float64(1), np.array([b"\0"]))))
    if draw(st.booleans()):
        del arrays[name]
    np.savez(file := io.BytesIO(), **arrays)
    return Damaged(file.getvalue(), f"another {name}", REFUSED)
