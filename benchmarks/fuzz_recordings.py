"""Readers of other drones' logs, for the fuzzer: ULog, blackbox, micro-SD, bags, mapped tables."""

import dataclasses
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import fuzz_damage as damage
import numpy as np
from fuzz_damage import ANY, Damaged, Kind
from fuzz_logs import flights_told, unsound_flights
from fuzz_reader import Good, Reader, made

from maidenflight.flights import formats
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.simulator.physics.battery import LARGEST_COMMAND

ROWS = 160
"""Of each good log."""


def recordings() -> dict[str, tuple[str, list[bytes]]]:
    """Good logs by their format, with the ending of their files."""
    flights, ulogs = made("made_flights"), made("made_ulogs")
    blackbox, bags, cards = made("made_blackbox"), made("made_bags"), made("test_usddeck")
    dataflash = made("made_dataflash")
    force = np.random.default_rng(1).normal([0.0, 0.0, 9.81], 0.3, (ROWS, 3)).astype(np.float32)
    flight = dataclasses.replace(flights.driven(ROWS), accelerometer=force)

    def bag(suffix: str) -> list[bytes]:
        with tempfile.TemporaryDirectory() as folder:
            return [
                bags.bag(Path(folder, name), messages, suffix).read_bytes()
                for name, messages in (
                    ("px4", bags.px4_messages(flight)),
                    ("mavros", bags.mavros_messages(flight)),
                )
            ]

    return {
        "ULog": (
            ".ulg",
            [
                ulogs.ulog(topics, ulogs.placed())
                for topics in (
                    ulogs.topics_of(flight),
                    ulogs.by_default_profile(ulogs.topics_of(flight, state=False)),
                )
            ],
        ),
        "DataFlash": (
            ".bin",
            [
                dataflash.dataflash(dataflash.messages_of(flight, rare=rare), dataflash.PARAMETERS)
                for rare in (1, 10)
            ],
        ),
        "blackbox": (
            ".bbl",
            [
                blackbox.blackbox(blackbox.fields_of(flight, battery=known))
                for known in (True, False)
            ],
        ),
        "micro-SD": (
            "",
            [
                cards.written(cards.EVENTS, cards.hovering(ROWS, step=10_000)),
                cards.flight_of_2019(flight),
            ],
        ),
        "MCAP": (".mcap", bag(".mcap")),
        "rosbag2": (".db3", bag(".db3")),
    }


def mapped() -> dict[str, bytes]:
    """A good table of columns that are not known, and the map beside it."""
    tables = made("test_column_map")
    with tempfile.TemporaryDirectory() as folder:
        path = tables.write(
            Path(folder, "log.csv"), tables.of_px4(made("made_flights").driven(ROWS))
        )
        told_ = formats.write_map(path)
        assert told_ is not None
        return {one.name: one.read_bytes() for one in (path, told_)}


def _bytes(generator: random.Random, good: bytes, other: bytes) -> Damaged:
    return damage.of_bytes(generator, good, other, Kind(ANY))


def unsound(read: Flights) -> str:
    """The promises of `read_flights` of flights that may have no state."""
    return unsound_flights(read, LARGEST_COMMAND)


def recording_readers() -> list[Reader]:
    """Of logs in each of the formats, alone."""
    read: Callable[[Path, Path], Flights] = lambda _, path: read_flights(path)  # noqa: E731
    notes: Callable[[Flights], tuple[str, ...]] = lambda one: (*one.notes, *one.refused)  # noqa: E731
    table, columns = mapped().items()
    return [
        *(
            Reader(
                f"flight log, {name}",
                2,
                tuple(Good(f"log{suffix}", content, _bytes) for content in contents),
                read,
                flights_told,
                unsound,
                notes,
            )
            for name, (suffix, contents) in recordings().items()
        ),
        *(
            Reader(
                f"flight log, {name}",
                2,
                (Good(*damaged_one, _bytes),),
                lambda folder, _: read_flights(folder / "log.csv"),
                flights_told,
                unsound,
                notes,
                around=dict([other]),
            )
            for name, damaged_one, other in (
                ("other columns", table, columns),
                ("map of columns", columns, table),
            )
        ),
    ]
