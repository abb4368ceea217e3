"""Readers of run folders, for the fuzzer: the report's, and the page that it makes."""

import json
import tempfile
from pathlib import Path

import numpy as np
from fuzz_damage import ANY, REFUSED, Kind
from fuzz_files import (
    IDENTIFIED,
    RECORD,
    drone,
    drone_needs,
    small_policy,
    unsound_drone,
)
from fuzz_reader import Good, Reader, made, table_damaged, toml, tree_damaged

from maidenflight import manifest, policy_file, run_folder
from maidenflight.flights import log
from maidenflight.identification.drone_file import OBJECTIVES
from maidenflight.reporting import page
from maidenflight.reporting import run as runs


def run_readers() -> list[Reader]:
    """The report, and what it reads."""
    around = whole_run()
    places = {
        run_folder.VALIDATION.name: run_folder.VALIDATION,
        run_folder.WINDOWS.name: run_folder.WINDOWS,
        f"{run_folder.POLICIES}/{run_folder.TRAINING.name}": run_folder.TRAINING,
        f"{run_folder.TRANSFER}/{run_folder.FLIGHTS.name}": run_folder.FLIGHTS,
    }
    tables = {place: tuple(table.columns) for place, table in places.items()}
    own = tuple(column for columns in log.GROUPS.values() for column in columns)
    good = []
    for place, content in around.items():
        if place == manifest.NAME:  # without a file that it lists a run is another and sound
            continue
        if place in tables:
            damaged = table_damaged(tables[place], ANY, tables[place])
        elif place.endswith(".csv"):
            damaged = table_damaged(own, ANY)
        elif place.endswith(".json"):
            damaged = tree_damaged(json.loads, lambda _: False, "json", Kind(REFUSED))
        else:
            damaged = tree_damaged(toml, drone_needs, "toml", Kind(ANY))
        good.append(Good(place, content, damaged))
    return [
        Reader(
            "run folder",
            10,
            tuple(good),
            lambda folder, _: runs.read_run(folder),
            lambda _: [],
            unsound_run,
            around=around,
        ),
        Reader(
            "run folder, to its page",
            3,
            tuple(good),
            _paged,
            lambda _: [],
            lambda _: "",
            around=around,
        ),
    ]


def _paged(folder: Path, _: Path) -> str:
    return page.to_html(runs.read_run(folder))


def whole_run() -> dict[str, bytes]:
    """The files of a whole run."""
    tests = made("test_page")
    around = {
        "reality.toml": drone(record=RECORD),
        "drone.toml": IDENTIFIED.to_toml("drone").encode(),
        "validation.csv": "# errors\n# record: "
        f"{json.dumps(RECORD)}\n{tests.errors().write_csv()}".encode(),
        "validation_windows.csv": "# windows\n# record: "
        f"{json.dumps(RECORD)}\n{tests.windows().write_csv()}".encode(),
        "policies/policy_1.json": policy_file.to_json(small_policy(), RECORD).encode(),
        "policies/training.csv": b"steps,policy,episode_return,survival,position_error\n"
        b"1000,1,-9.0,0.5,0.1\n2000,1,-5.0,1.0,0.02\n",
        "demo.json": b'{"seed": 7, "stages": {"record": 1.5, "train": 3.0}}',
        "recorded/flight_01.csv": log.to_csv(tests.circling(0.6), RECORD).encode(),
    }
    table = tests.flown().table.head(2)
    around["transfer/flights.csv"] = table.write_csv().encode()
    around |= {
        f"transfer/flight_{number:02d}.csv": log.to_csv(tests.circling(0.4), RECORD).encode()
        for number in (1, 2)
    }
    with tempfile.TemporaryDirectory() as folder:
        for place, content in around.items():
            path = Path(folder, place)
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        tests.list_files(Path(folder))
        return around | {manifest.NAME: Path(folder, manifest.NAME).read_bytes()}


def unsound_run(read: runs.Run) -> str:
    """What the page is drawn from must be numbers where numbers are promised."""
    drones = [
        found
        for found in (read.reality, None if read.drone is None else read.drone.parameters)
        if found is not None
    ]
    wrong = next(filter(None, map(unsound_drone, drones)), "")
    numbers = [
        entry
        for estimate in read.estimates.values()
        for entry in (estimate.value, *estimate.interval)
    ]
    faults = {
        "estimates": not np.isfinite(numbers).all()
        or any(one.interval[0] > one.interval[1] for one in read.estimates.values()),
        "posterior": not all(np.isfinite(draws).all() for draws in read.posterior.values()),
        "objective": read.objective not in OBJECTIVES,
        "a period": not all(0 < flight.period < 1 for flight in (*read.recorded, *read.flights)),
        "durations": read.table is not None
        and not (read.table["duration"].is_finite() & (read.table["duration"] >= 0)).all(),
        "nothing where something was": read.table is None
        or read.drone is None
        or not read.policies,
    }
    return wrong or next((fault for fault, there in faults.items() if there), "")
