"""Readers of other drones' logs, for the fuzzer: ULog, blackbox, MCAP, rosbag2, mapped tables."""

import dataclasses
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import fuzz_damage as damage
import numpy as np
from fuzz_damage import ANY, Damaged, Kind
from fuzz_reader import Good, Reader, made

from maidenflight.flights import formats
from maidenflight.flights.log import GROUPS, OPTIONAL
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.simulator.physics.battery import LARGEST_COMMAND

ROWS = 160
"""Of each good log."""


def recordings() -> dict[str, tuple[str, list[bytes]]]:
    """Good logs by their format, with the ending of their files."""
    flights, ulogs = made("made_flights"), made("made_ulogs")
    blackbox, bags = made("made_blackbox"), made("made_bags")
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
        "blackbox": (
            ".bbl",
            [
                blackbox.blackbox(blackbox.fields_of(flight, battery=known))
                for known in (True, False)
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


def told(read: Flights) -> list[np.ndarray]:
    """All numbers of all pieces."""
    groups = [group for group in GROUPS if group != "time"]
    return [
        np.concatenate([getattr(flight, group).reshape(len(flight), -1) for flight in read])
        for group in groups
    ]


def unsound(read: Flights) -> str:
    """The promises of `read_flights` of flights that may have no state."""
    for flight in read:
        needed = ["body_rates", "command", *(group for group in OPTIONAL if group in flight.arrays)]
        needed += ["position", "velocity", "attitude"] if flight.has_state else []
        faults: dict[str, bool] = {
            "a period that is none": not 0 < flight.period < 1,
            "too few rows": len(flight) < 50,
            "not float32": any(array.dtype != np.float32 for array in flight.arrays.values()),
            "of different lengths": len({len(array) for array in flight.arrays.values()}) > 1,
            "not finite": not all(np.isfinite(flight.arrays[group]).all() for group in needed),
            "body rates": bool((np.abs(flight.body_rates) > 25.01).any()),
            "a command": bool(
                ((flight.command < -0.0011) | (flight.command > LARGEST_COMMAND)).any()
            ),
            "a battery": bool(((flight.battery < 0) | (flight.battery > 100)).any()),
        }
        found = [fault for fault, there in faults.items() if there]
        if found:
            return found[0]
    return ""


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
                told,
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
                told,
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
