"""Readers of flight logs, for the fuzzer.

All formats: alone, compressed, in Parquet, and in a folder with others.
"""

import gzip
import io
import random
from collections.abc import Callable
from functools import cache
from typing import Any

import fuzz_damage as damage
import numpy as np
import polars
from fuzz_damage import ANY, PREFIX, REFUSED, SAME, Damaged, Kind
from fuzz_reader import Good, Reader, made, table_damaged

from maidenflight.flights import log
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.integrations.logs import authors, nanobench

ROWS = 130
"""Of each good log."""


@cache
def logs() -> dict[str, tuple[bytes, tuple[str, ...]]]:
    """A good log in each format, and the columns that it must have."""
    flights, cflib, nano = made("made_flights"), made("test_cflib"), made("test_nanobench")
    table = cflib.columns(rows=ROWS)
    names = (
        "timestamp",
        *(f"stateEstimate.{n}" for n in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")),
    )
    names = (
        *names,
        *(f"gyro.{axis}" for axis in "xyz"),
        *(f"motor.m{motor}" for motor in (1, 2, 3, 4)),
        "pm.vbat",
    )
    own = tuple(column for columns in log.GROUPS.values() for column in columns)
    return {
        "ours": (log.to_csv(flights.driven(ROWS), {"seed": 1}).encode(), own),
        "authors": (flights.authors_text(flights.authors_columns(ROWS)).encode(), authors.COLUMNS),
        "nanobench": (nano.text(rows=ROWS).encode(), nanobench.COLUMNS),
        "cflib": (
            polars.DataFrame({name: table[name] for name in names}).write_csv().encode(),
            names,
        ),
    }


def _gz(generator: random.Random, good: bytes, other: bytes) -> Damaged:
    if generator.random() < 0.5:
        return damage.of_bytes(generator, good, other, Kind(REFUSED, SAME))
    needed = next(
        columns for content, columns in logs().values() if gzip.decompress(good) == content
    )
    inner = table_damaged(needed, PREFIX)(generator, gzip.decompress(good), gzip.decompress(other))
    return inner._replace(
        content=None if inner.content is None else gzip.compress(inner.content, 1)
    )


def _parquet(generator: random.Random, good: bytes, other: bytes) -> Damaged:
    if generator.random() < 0.5:
        return damage.of_bytes(generator, good, other, Kind(REFUSED))
    frame, head = (
        polars.read_parquet(io.BytesIO(good)),
        polars.read_parquet_metadata(io.BytesIO(good)),
    )
    head = {name: value for name, value in head.items() if not name.startswith("ARROW")}
    column = generator.choice(frame.columns)
    value: Any = generator.choice(
        (
            None,
            float("nan"),
            float("inf"),
            -1,
            1e300,
            "text",
            "0.5",
            True,
            [1.0],
            {"a": 1},
            b"\x00",
            2**62,
        )
    )
    places = polars.Series([generator.random() < 0.2 for _ in range(frame.height)])
    makes: dict[str, Callable[[], polars.DataFrame]] = {
        "a column of another type": lambda: frame.with_columns(
            polars.Series(column, [value] * frame.height)
        ),
        "a column missing": lambda: frame.drop(column),
        "no rows": lambda: frame.clear(),
        "other words in its metadata": lambda: frame,
        "some cells empty": lambda: frame.with_columns(
            polars.when(~places).then(polars.col(column)).alias(column)
        ),
        "columns as float32": lambda: frame.cast(polars.Float32),
        "a column of decimals": lambda: frame.with_columns(
            polars.col(column).cast(polars.Decimal(30, 8), strict=False)
        ),
        "a column of text": lambda: frame.with_columns(polars.col(column).cast(polars.String)),
    }
    what = generator.choice(list(makes))
    if what == "other words in its metadata":
        head = generator.choice(({}, {"commands": "some"}, {**head, "record": "{"}))
    file = io.BytesIO()
    try:
        makes[what]().write_parquet(file, metadata=head)
    except polars.exceptions.PolarsError:
        return damage.of_bytes(generator, good, other, Kind(REFUSED))
    return Damaged(file.getvalue(), what, REFUSED if what == "no rows" else ANY)


def parquet_of(content: bytes) -> bytes:
    """The same log in Parquet."""
    lines = [line for line in content.decode().split("\n") if not line.startswith("#")]
    file = io.BytesIO()
    head = {"commands": "subsampled"} if content.startswith(b"#") else {}
    polars.read_csv("\n".join(lines).encode()).write_parquet(file, metadata=head)
    return file.getvalue()


def flights_told(read: Flights) -> list[np.ndarray]:
    """All numbers of all pieces."""
    groups = [group for group in log.GROUPS if group != "time"]
    return [
        np.concatenate([getattr(flight, group).reshape(len(flight), -1) for flight in read])
        for group in groups
    ]


def unsound_flights(read: Flights, most: float = 1.0) -> str:
    """The promises of `read_flights`, looked at one by one; `most` is the largest command."""
    for flight in read:
        state = ("position", "velocity", "attitude") if flight.has_state else ()
        sensed = [group for group in log.OPTIONAL if group in flight.arrays]
        needed = ("body_rates", "command", *state, *sensed)
        wide = {"command": (4,), "battery": (), "rotor_speed": (4,)}
        with np.errstate(all="ignore"):
            faults = {
                "a period that is none": not 0 < flight.period < 1,
                "too few rows": len(flight) < 50,
                "shapes": any(
                    array.shape != (len(flight), *wide.get(group, (3,)))
                    for group, array in flight.arrays.items()
                ),
                "not float32": any(array.dtype != np.float32 for array in flight.arrays.values()),
                "not finite": not all(np.isfinite(flight.arrays[group]).all() for group in needed),
                "infinite": any(np.isinf(array).any() for array in flight.arrays.values()),
                "tilt": flight.has_state
                and bool((np.abs(flight.attitude[:, :2]) > np.radians(60.01)).any()),
                "body rates": (np.abs(flight.body_rates) > 25.01).any(),
                "a height": flight.has_state and bool((flight.position[:, 2] < 0.0999).any()),
                "a command": (flight.command < -0.0011).any()
                or (flight.command > most + 0.0011).any(),
                "a battery": (flight.battery < 0).any() or (flight.battery > 100).any(),
            }
        found = [fault for fault, there in faults.items() if there]
        if found:
            return found[0]
    return ""


def flight_readers() -> list[Reader]:
    """Of logs in all formats, alone, compressed, in Parquet, and in a folder with others."""
    shared: dict[str, Any] = {
        "read": lambda _, path: read_flights(path),
        "told": flights_told,
        "unsound": unsound_flights,
        "notes": lambda read: (*read.notes, *read.refused),
    }
    alone = [
        Reader(
            f"flight log, {name}",
            12,
            (Good("log.csv", content, table_damaged(needed, PREFIX)),),
            **shared,
        )
        for name, (content, needed) in logs().items()
    ]
    packed = tuple(
        Good("log.csv.gz", gzip.compress(content, mtime=0), _gz) for content, _ in logs().values()
    )
    columns = tuple(
        Good("log.parquet", parquet_of(content), _parquet) for content, _ in logs().values()
    )
    content, needed = logs()["ours"]

    def beside_a_good_one(generator: random.Random, good: bytes, other: bytes) -> Damaged:
        return table_damaged(needed, PREFIX)(generator, good, other)._replace(verdict=ANY)

    beside = shared | {
        "read": lambda folder, _: read_flights(folder),
        "told": lambda _: [],
        "unsound": _lost,
    }
    together = Reader(
        "a folder of flight logs", 4, (Good("bad.csv", content, beside_a_good_one),), **beside
    )
    return [
        *alone,
        Reader("flight log, .csv.gz", 8, packed, **shared),
        Reader("flight log, .parquet", 10, columns, **shared),
        together._replace(
            lenient=True,
            around={
                "good.csv": log.to_csv(made("made_flights").driven(ROWS, 1)).encode(),
                "prediction.csv": b"policy,trial,duration,end_reason\n1,1,1,tilt\n",
            },
        ),
    ]


def _lost(read: Flights) -> str:
    """A folder's sound log is read whatever stands beside it."""
    sound = [flight for flight in read if flight.name.endswith("good.csv")]
    return unsound_flights(read) or (
        "" if sum(map(len, sound)) == ROWS else "the sound log beside was lost"
    )
