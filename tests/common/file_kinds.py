"""Kinds of files that something reads: good ones, their damages, and what readers promise."""

import dataclasses
import gzip
import importlib
import io
import json
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars
from hypothesis import strategies as st

from damage import (
    ANY,
    PREFIX,
    REFUSED,
    SAME,
    Damage,
    Damaged,
    damaged_arrays,
    damaged_bytes,
    damaged_parquet,
    damaged_table,
    damaged_tree,
)
from maidenflight import manifest, parameters, policy_file, results, run_folder
from maidenflight.experiments.drones import possible_drones
from maidenflight.flights import flight_csv, formats, log
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.identification.drone_file import (
    OBJECTIVES,
    DroneFile,
    Estimate,
    Search,
    Source,
)
from maidenflight.identification.posterior import Posterior
from maidenflight.integrations.exporters.authors_json import to_authors_json
from maidenflight.integrations.logs import authors, nanobench
from maidenflight.integrations.radio import row_files
from maidenflight.integrations.radio.blocks import MOTORS, STATE
from maidenflight.names import POSTERIOR
from maidenflight.parameters import QUANTITIES, Parameters
from maidenflight.policy import Policy, untrained_policy
from maidenflight.reporting import page
from maidenflight.reporting import run as runs
from maidenflight.simulator.controllers.interface import INTERFACES, ControlInterface
from maidenflight.simulator.physics.battery import LARGEST_COMMAND
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.waypoints import read_waypoints
from maidenflight.studies import study
from maidenflight.training import checkpoint

ROWS = 130
"""Of each good log."""
RECORD = {"version": "0.1.0", "seed": 3, "settings": {"drone": "crazyflie"}}


class Good(NamedTuple):
    """A good file."""

    place: str
    content: bytes
    damage: Damage


class Kind(NamedTuple):
    """One kind of files."""

    good: Sequence[Good]
    read: Callable[[Path, Path], Any]
    """(folder, file) to what was understood."""
    arrays: Callable[[Any], list[np.ndarray]] = lambda _: []
    """What was understood, to be compared; rows first."""
    fault: Callable[[Any], str] = lambda _: ""
    """What is wrong with something that was accepted."""
    notes: Callable[[Any], Sequence[str]] = lambda _: ()
    around: Mapping[str, bytes] = {}
    """Further files of the folder."""
    lenient: bool = False
    """Whether a file that cannot be read is passed over, by design."""


def load(name: str) -> Any:
    """Imports a module of the tests, which know how to make good files."""
    for folder in ("flights/maps", "integrations/logs", "reporting"):
        if (place := str(Path(__file__).parents[1] / folder)) not in sys.path:
            sys.path.append(place)
    return importlib.import_module(name)


def first_fault(faults: Mapping[str, Any]) -> str:
    """Returns the name of the first fault that is there."""
    return next((fault for fault, is_there in faults.items() if is_there), "")


# Logs.


def flight_arrays(read: Flights) -> list[np.ndarray]:
    """Returns the needed groups of columns, of all pieces."""
    groups = [group for group in log.GROUPS if group != "time"]
    return [
        np.concatenate([getattr(flight, group).reshape(len(flight), -1) for flight in read])
        for group in groups
    ]


def flight_fault(read: Flights, most: float = LARGEST_COMMAND) -> str:
    """Looks at the promises of `read_flights`, one by one; `most` is the largest command."""
    for flight in read:
        state = ("position", "velocity", "attitude") if flight.has_state else ()
        sensed = [group for group in log.OPTIONAL if group in flight.arrays]
        wide = {"command": (4,), "battery": (), "rotor_speed": (4,)}
        arrays = flight.arrays
        with np.errstate(all="ignore"):
            fault = first_fault(
                {
                    "a period": not 0 < flight.period < 1,
                    "too few rows": len(flight) < 50,
                    "shapes": any(
                        array.shape != (len(flight), *wide.get(group, (3,)))
                        for group, array in arrays.items()
                    ),
                    "not float32": any(array.dtype != np.float32 for array in arrays.values()),
                    "not finite": not all(
                        np.isfinite(arrays[group]).all()
                        for group in ("body_rates", "command", *state, *sensed)
                    ),
                    "infinite": any(np.isinf(array).any() for array in arrays.values()),
                    "tilt": flight.has_state
                    and (np.abs(flight.attitude[:, :2]) > np.radians(60.01)).any(),
                    "body rates": (np.abs(flight.body_rates) > 25.01).any(),
                    "a height": flight.has_state and (flight.position[:, 2] < 0.0999).any(),
                    "a command": (flight.command < -0.0011).any()
                    or (flight.command > most + 0.0011).any(),
                    "a battery": (flight.battery < 0).any() or (flight.battery > 100).any(),
                }
            )
        if fault:
            return fault
    return ""


LOGS = Kind(
    (),
    lambda _, path: read_flights(path),
    flight_arrays,
    flight_fault,
    lambda read: (*read.notes, *read.refused),
)


@cache
def table_logs() -> dict[str, tuple[bytes, tuple[str, ...]]]:
    """Makes a good table in each format, and names the columns that it must have."""
    flights, cflib, nano = load("made_flights"), load("test_cflib"), load("test_nanobench")
    estimate = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")
    needed = ("timestamp", *(f"stateEstimate.{name}" for name in estimate))
    needed += tuple(f"gyro.{axis}" for axis in "xyz")
    needed += (*(f"motor.m{motor}" for motor in (1, 2, 3, 4)), "pm.vbat")
    table = cflib.columns(rows=ROWS)
    frame = polars.DataFrame({name: table[name] for name in needed})
    own = tuple(column for columns in log.GROUPS.values() for column in columns)
    return {
        "ours": (flight_csv.to_csv(flights.driven(ROWS), {"seed": 1}).encode(), own),
        "authors": (flights.authors_text(flights.authors_columns(ROWS)).encode(), authors.COLUMNS),
        "nanobench": (nano.text(rows=ROWS).encode(), nanobench.COLUMNS),
        "cflib": (frame.write_csv().encode(), needed),
    }


def damaged_gzip(good: bytes, other: bytes) -> st.SearchStrategy[Damaged]:
    """Draws damage to a compressed table, or to the table in it."""
    inner, another = gzip.decompress(good), gzip.decompress(other)
    (needed,) = [columns for content, columns in table_logs().values() if content == inner]
    damage = damaged_table(needed, PREFIX)(inner, another)
    packed = damage.map(lambda one: one._replace(content=gzip.compress(one.content, 1)))
    return packed | damaged_bytes(good, other, REFUSED, SAME)


def to_parquet(content: bytes) -> bytes:
    """Returns the same log in Parquet."""
    head = {"commands": "subsampled"} if content.startswith(b"#") else {}
    file = io.BytesIO()
    polars.read_csv(content, comment_prefix="#").write_parquet(file, metadata=head)
    return file.getvalue()


def recordings() -> dict[str, list[Good]]:
    """Makes good logs of other drones, by their format."""
    flights, ulogs = load("made_flights"), load("made_ulogs")
    blackbox, bags, cards = load("made_blackbox"), load("made_bags"), load("test_usddeck")
    dataflash = load("made_dataflash")
    force = np.random.default_rng(1).normal([0.0, 0.0, 9.81], 0.3, (160, 3)).astype(np.float32)
    flight = dataclasses.replace(flights.driven(160), accelerometer=force)
    with tempfile.TemporaryDirectory() as folder:
        bagged = {
            suffix: [
                bags.bag(Path(folder, name + suffix), messages, suffix).read_bytes()
                for name, messages in (
                    ("px4", bags.px4_messages(flight)),
                    ("mavros", bags.mavros_messages(flight)),
                )
            ]
            for suffix in (".mcap", ".db3")
        }
    stateless = ulogs.by_default_profile(ulogs.topics_of(flight, state=False))
    contents = {
        ".ulg": [
            ulogs.ulog(topics, ulogs.placed()) for topics in (ulogs.topics_of(flight), stateless)
        ],
        ".bin": [
            dataflash.dataflash(dataflash.messages_of(flight, rare=rare), dataflash.PARAMETERS)
            for rare in (1, 10)
        ],
        ".bbl": [
            blackbox.blackbox(blackbox.fields_of(flight, battery=known)) for known in (True, False)
        ],
        "": [
            cards.written(cards.EVENTS, cards.hovering(160, step=10_000)),
            cards.flight_of_2019(flight),
        ],
        **bagged,
    }
    return {
        f"log{suffix or ' of a card'}": [Good(f"log{suffix}", one, damaged_bytes) for one in own]
        for suffix, own in contents.items()
    }


def mapped_log() -> dict[str, bytes]:
    """Makes a good table of columns that are not known, and the map beside it."""
    tables = load("test_column_map")
    with tempfile.TemporaryDirectory() as folder:
        table = tables.of_px4(load("made_flights").driven(160))
        path = tables.write(Path(folder, "log.csv"), table)
        columns = formats.write_map(path)
        assert columns is not None
        return {one.name: one.read_bytes() for one in (path, columns)}


def fault_beside(read: Flights) -> str:
    """Tells whether a folder's sound log was read, whatever stands beside it."""
    sound = sum(len(flight) for flight in read if flight.name.endswith("good.csv"))
    return flight_fault(read) or ("" if sound == ROWS else "the sound log beside was lost")


def log_kinds() -> dict[str, Kind]:
    """Returns logs in all formats: alone, compressed, in Parquet, and in a folder with others."""
    tables = table_logs()
    alone = {
        f"log of {name}": LOGS._replace(
            good=[Good("log.csv", content, damaged_table(needed, PREFIX))]
        )
        for name, (content, needed) in tables.items()
    }
    packed = [
        Good("a.csv.gz", gzip.compress(one, mtime=0), damaged_gzip) for one, _ in tables.values()
    ]
    columns = [Good("a.parquet", to_parquet(one), damaged_parquet) for one, _ in tables.values()]
    others = {
        name: LOGS._replace(good=good, fault=flight_fault) for name, good in recordings().items()
    }
    (table, table_bytes), (columns_of, columns_bytes) = mapped_log().items()
    by_map = LOGS._replace(read=lambda folder, _: read_flights(folder / table), fault=flight_fault)
    beside = Kind(
        [Good("bad.csv", tables["ours"][0], damaged_table(tables["ours"][1], ANY))],
        lambda folder, _: read_flights(folder),
        fault=fault_beside,
        around={
            "good.csv": flight_csv.to_csv(load("made_flights").driven(ROWS, 1)).encode(),
            "prediction.csv": b"policy,trial,duration,end_reason\n1,1,1,tilt\n",
        },
        lenient=True,
    )
    return {
        **alone,
        "log.csv.gz": LOGS._replace(good=packed),
        "log.parquet": LOGS._replace(good=columns),
        **others,
        "log of other columns": by_map._replace(
            good=[Good(table, table_bytes, damaged_bytes)], around={columns_of: columns_bytes}
        ),
        "map of columns": by_map._replace(
            good=[Good(columns_of, columns_bytes, damaged_bytes)], around={table: table_bytes}
        ),
        "folder of logs": beside,
    }


# Drones and policies.


def to_drone(**extra: Any) -> bytes:
    """Returns a drone's file; `extra` are further tables of it."""
    return parameters.to_toml(parameters.crazyflie(), "made", extra).encode()


IDENTIFIED = DroneFile(
    parameters.crazyflie(),
    {
        "latency": Estimate(0.018, (0.01, 0.02), (0.018,), 0.001),
        "mass": Estimate(0.028, (0.02, 0.03), (0.028,), 0.0),
    },
    Posterior(
        {
            "latency": np.array([0.018, 0.019, 0.017]),
            "torque_bias_x": np.array([1e-5, 0.0, 2e-5]),
        }
    ),
    Source(4, 120.0, True, "subsampled", 60000.0),
    Search("replay", 5.0, 116, 60),
    record=RECORD,
)


def is_needed_of_a_drone(path: tuple[Any, ...]) -> bool:
    return path == ("format",) or path[0] in {quantity.table for quantity in QUANTITIES.values()}


def drone_arrays(read: Parameters) -> list[np.ndarray]:
    return [np.asarray(getattr(read, name), np.float32) for name in QUANTITIES]


def drone_fault(read: Parameters) -> str:
    """Looks at bounds and shapes, without `parameters.check`."""
    for (name, quantity), value in zip(QUANTITIES.items(), drone_arrays(read), strict=True):
        low, high = np.float32(quantity.lower), np.float32(quantity.upper)
        is_within = (np.isfinite(value) & (value >= low) & (value <= high)).all()
        if not is_within or (quantity.size == 3 and value.shape[-1:] != (3,)):
            return f"{name} = {value}"
    return ""


def small_policy(control: str = "pwm", history: int = 1) -> Policy:
    """Makes a policy with few numbers."""
    spec = PolicySpec(history=history, hidden=(3,))
    return untrained_policy(jax.random.key(0), INTERFACES[control](), spec)


def policy_arrays(read: Policy) -> list[np.ndarray]:
    numbers = (*read.weights, *read.biases, read.observation_mean, read.observation_std)
    return [np.array([str(read.interface), str(read.spec)]), *map(np.asarray, numbers)]


def policy_fault(read: Policy) -> str:
    arrays = policy_arrays(read)[1:]
    sizes = (read.spec.size, *(len(bias) for bias in read.biases))
    shapes = list(zip(sizes[1:], sizes[:-1], strict=True))
    return first_fault(
        {
            "no number": not all(np.isfinite(one).all() for one in arrays),
            "not float32": any(one.dtype != np.float32 for one in arrays),
            "shapes": [weight.shape for weight in read.weights] != shapes or sizes[-1] != 4,
            "a deviation": not (np.asarray(read.observation_std) > 0).all(),
            "an interface": ControlInterface.from_dict(read.interface.to_dict()) != read.interface,
        }
    )


POLICY = Kind((), lambda _, path: policy_file.read_policy(path).policy, policy_arrays, policy_fault)

# Studies, way-points, rows of a real flight, checkpoints, records.

STUDY = b"""# A study.
[[task]]
name = "policy"
kind = "train"
[task.settings]
control = "attitude"
drone = "crazyflie"
randomize = 0.1
policies = 3
updates = 600
rate = 100
hidden = [50, 50]
paper_scales = true
learner = { horizon = 32, learning_rate = 0.003 }
[task.grid]
"set.motor_time_constant" = [0.04, 0.08]
seed = [0, 1]

[[task]]
name = "flown"
kind = "transfer"
inputs = { policies = "policy" }
[task.settings]
reality = ["near:7", "virtual:7"]
trials = 3
duration = 20.0
"""
RANGES = {
    "policies": (1, 4096),
    "updates": (1, 10**6),
    "rate": (1, 1000),
    "trials": (1, 1000),
    "duration": (0.1, 600.0),
    "seed": (0, 2**31 - 1),
}
"""Of numbers among the settings of a study."""


def is_needed_of_a_study(path: tuple[Any, ...]) -> bool:
    entry = path[:1] == ("task",) and path[2:] in (("name",), ("kind",), ("inputs", "policies"))
    return entry or path == ("task",)


def study_fault(read: study.Study) -> str:
    """Checks that tasks follow those that they take, and numbers of settings are in range."""
    made: set[str] = set()
    for task in read.tasks:
        if not made >= set(task.inputs.values()):
            return f"{task.label} takes what no earlier task makes"
        made.add(task.key)
        for name, (low, high) in RANGES.items():
            value = task.settings.get(name)
            fits = isinstance(value, int | float) and low <= value <= high
            if value is not None and (isinstance(value, bool) or not fits):
                return f"{name} = {value}"
        for name in ("set", "learner"):
            if not np.isfinite(list(task.settings.get(name, {}).values())).all():
                return f"{name} = {task.settings[name]}"
    return ""


def to_waypoints() -> bytes:
    rows = (f"{0.5 * n},{0.1 * n:.3f},{0.05 * n:.3f},1.0\n" for n in range(12))
    return ("time,x,y,z\n" + "".join(rows)).encode()


def waypoints_fault(read: Any) -> str:
    table = np.array(read)
    is_table = table.ndim == 2 and table.shape[1] == 4 and np.isfinite(table).all()
    return "" if is_table and (np.diff(table[:, 0]) > 0).all() else "way-points"


def to_rows() -> bytes:
    """Makes packets of a real flight, as they are appended."""
    names = (*STATE.variables, *MOTORS.variables)
    motors = ["30000", "30001", "30002", "30003", "0.0", "0.0", "1.0", "30000.0", "3900", "31"]
    lines = []
    for number in range(ROWS):
        state = [str(number % 97 + place) for place in range(9)] + ["0.0", "0.0", "0.0", "1.0"]
        for cells in ([*state, *[""] * len(motors)], [*[""] * len(state), *motors]):
            lines.append(f"{5000 + 10 * number},{0.01 * number:.4f}," + ",".join(cells))
    head = f'{row_files.MARK}: made\n# simulated: no\n# record: {{"seed": 1}}'
    header = ",".join(["timestamp", "received", *names])
    return "\n".join([head, header, *lines, ""]).encode()


def rows_arrays(read: Any) -> list[np.ndarray]:
    return [getattr(read[0], group) for group in log.GROUPS if group != "time"]


def rows_fault(read: Any) -> str:
    flight, record, _ = read
    command = flight.command[np.isfinite(flight.command)]
    arrays = rows_arrays(read)
    return first_fault(
        {
            "a record": not isinstance(record, dict),
            "rows": any(len(one) != len(flight) or np.isinf(one).any() for one in arrays),
            "too many rows": len(flight) > 100_000,
            "a command": ((command < 0) | (command > 1)).any(),
        }
    )


class State(NamedTuple):
    """Something to save."""

    weights: Any
    number: Any


def to_checkpoint() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        weights = np.arange(20, dtype=np.float32).reshape(4, 5)
        checkpoint.save(Path(folder, "a.npz"), State(weights, np.int32(7)), "mine", (9,))
        return Path(folder, "a.npz").read_bytes()


def restore(_: Path, path: Path) -> Any:
    fresh = State(np.zeros((4, 5), np.float32), np.zeros((), np.int32))
    return checkpoint.restored(path, lambda _: fresh, "mine")[0]


def single_kinds() -> dict[str, Kind]:
    """Returns drones, policies, studies, way-points, rows of flights, checkpoints, records."""
    drones = Kind((), lambda _, path: parameters.read_drone(path), drone_arrays, drone_fault)
    always = lambda _: True  # noqa: E731
    # A file without the rest of its identification is a drone with a posterior, too.
    of_posterior = lambda path: path[0] != "record" and path != ("identification",)  # noqa: E731
    rows = ("timestamp", *STATE.variables, *MOTORS.variables)
    table = f"# a table\n# record: {json.dumps(RECORD)}\npolicy,trial\n1,1\n1,2\n".encode()
    toml, unrecorded = tomllib.loads, lambda path: path[0] != "record"
    authors_file = to_authors_json(small_policy("attitude", 2)).encode()
    ours = policy_file.to_json(small_policy(), RECORD).encode()
    identified = IDENTIFIED.to_toml("drone").encode()
    drone = damaged_tree(toml, is_needed_of_a_drone, SAME)
    return {
        "drone": drones._replace(good=[Good("a.toml", to_drone(record=RECORD), drone)]),
        "drone with a posterior": drones._replace(
            good=[Good("a.toml", identified, damaged_tree(toml, of_posterior, ANY))],
            read=lambda _, path: possible_drones(path, POSTERIOR, 0),
        ),
        "policy": POLICY._replace(
            good=[Good("a.json", ours, damaged_tree(json.loads, unrecorded, REFUSED))]
        ),
        "policy of the authors": POLICY._replace(
            good=[Good("attitude_1.json", authors_file, damaged_tree(json.loads, always, REFUSED))]
        ),
        "study": Kind(
            [Good("study.toml", STUDY, damaged_tree(toml, is_needed_of_a_study, ANY))],
            lambda _, path: study.read_study(path),
            lambda read: [np.array([repr(task) for task in read.tasks])],
            study_fault,
        ),
        "way-points": Kind(
            [Good("a.csv", to_waypoints(), damaged_table(("time", "x", "y", "z"), ANY))],
            lambda _, path: read_waypoints(path),
            lambda read: [np.array(read)],
            waypoints_fault,
        ),
        "rows of a real flight": Kind(
            [Good("flight_01.rows", to_rows(), damaged_table(rows, ANY))],
            lambda _, path: row_files.to_flight(path),
            rows_arrays,
            rows_fault,
        ),
        "checkpoint": Kind(
            [Good("training.npz", to_checkpoint(), damaged_arrays)],
            restore,
            lambda read: [np.asarray(leaf) for leaf in read],
        ),
        "record in a table": Kind(
            [Good("flights.csv", table, damaged_table((), ANY))],
            lambda _, path: results.read_record(path),
            fault=lambda read: "" if read is None or isinstance(read, dict) else "a record",
            lenient=True,
        ),
    }


# Run folders.


def whole_run() -> dict[str, bytes]:
    """Makes the files of a whole run."""
    tests = load("test_page")
    record = f"# record: {json.dumps(RECORD)}\n"
    around = {
        "reality.toml": to_drone(record=RECORD),
        "drone.toml": IDENTIFIED.to_toml("drone").encode(),
        "validation.csv": f"# errors\n{record}{tests.errors().write_csv()}".encode(),
        "validation_windows.csv": f"# windows\n{record}{tests.windows().write_csv()}".encode(),
        "policies/policy_1.json": policy_file.to_json(small_policy(), RECORD).encode(),
        "policies/training.csv": b"steps,policy,episode_return,survival,position_error\n"
        b"1000,1,-9.0,0.5,0.1\n2000,1,-5.0,1.0,0.02\n",
        "recorded/flight_01.csv": flight_csv.to_csv(tests.circling(0.6), RECORD).encode(),
        "transfer/flights.csv": tests.flown().table.head(2).write_csv().encode(),
        **{
            f"transfer/flight_0{n}.csv": flight_csv.to_csv(tests.circling(0.4), RECORD).encode()
            for n in (1, 2)
        },
    }
    with tempfile.TemporaryDirectory() as folder:
        lay(Path(folder), around)
        tests.list_files(Path(folder))
        return around | {manifest.NAME: Path(folder, manifest.NAME).read_bytes()}


def lay(folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes files into a folder."""
    for place, content in files.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_bytes(content)


def run_fault(read: runs.Run) -> str:
    """Looks at what the page is drawn from: numbers where numbers are promised."""
    drones = [read.reality, None if read.drone is None else read.drone.parameters]
    wrong = next(filter(None, (drone_fault(one) for one in drones if one is not None)), "")
    estimates = read.estimates.values()
    numbers = [number for one in estimates for number in (one.value, *one.interval)]
    durations = None if read.table is None else read.table["duration"]
    return wrong or first_fault(
        {
            "estimates": not np.isfinite(numbers).all()
            or any(one.interval[0] > one.interval[1] for one in estimates),
            "posterior": not all(np.isfinite(draws).all() for draws in read.posterior.values()),
            "objective": read.objective not in OBJECTIVES,
            "a period": not all(0 < one.period < 1 for one in (*read.recorded, *read.flights)),
            "durations": durations is not None
            and not (durations.is_finite() & (durations >= 0)).all(),
            "nothing left": read.table is None or read.drone is None or not read.policies,
        }
    )


def run_kinds() -> dict[str, Kind]:
    """Returns the report, and what it reads."""
    around = whole_run()
    tables = {
        table.name: tuple(table.columns)
        for table in (
            *(run_folder.VALIDATION, run_folder.WINDOWS),
            *(run_folder.TRAINING, run_folder.FLIGHTS),
        )
    }
    own = tuple(column for columns in log.GROUPS.values() for column in columns)

    def damage_of(place: str) -> Damage:
        name = Path(place).name
        if name in tables:
            return damaged_table(tables[name], ANY, tables[name])
        if name.endswith(".csv"):
            return damaged_table(own, ANY)
        if name.endswith(".json"):
            return damaged_tree(json.loads, lambda _: False, REFUSED)
        return damaged_tree(tomllib.loads, is_needed_of_a_drone, ANY)

    # Without a file that its manifest lists a run is another one, and sound.
    good = [Good(*one, damage_of(one[0])) for one in around.items() if one[0] != manifest.NAME]
    read = Kind(good, lambda folder, _: runs.read_run(folder), fault=run_fault, around=around)
    return {
        "run folder": read,
        "page of a run folder": read._replace(
            read=lambda folder, _: page.to_html(runs.read_run(folder)), fault=lambda _: ""
        ),
    }


@cache
def known_kinds() -> dict[str, Kind]:
    """Returns all kinds by name."""
    return {**log_kinds(), **single_kinds(), **run_kinds()}
