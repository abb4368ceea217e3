"""Readers of single files, for the fuzzer.

Drones, policies, settings, way-points, rows of a real flight, checkpoints and records.
"""

import io
import json
import random
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import fuzz_damage as damage
import jax
import numpy as np
from fuzz_damage import ANY, REFUSED, SAME, Damaged, Kind
from fuzz_reader import Good, Reader, table_damaged, toml, tree_damaged
from fuzz_studies import study_reader

from maidenflight import parameters, policy_file, results
from maidenflight.experiments.drones import possible_drones
from maidenflight.flights import log
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.integrations.exporters.authors_json import to_authors_json
from maidenflight.integrations.radio import row_files
from maidenflight.integrations.radio.blocks import MOTORS, STATE
from maidenflight.names import POSTERIOR
from maidenflight.parameters import QUANTITIES, Parameters
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers.interface import INTERFACES, ControlInterface
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.waypoints import read_waypoints
from maidenflight.training import checkpoint

ROWS = 130
"""Packets of each block in a file of row_files."""


def drone(**extra: Any) -> bytes:
    """A drone's file; `extra` are further tables of it."""
    return parameters.to_toml(parameters.crazyflie(), "made", extra).encode()


RECORD = {"version": "0.1.0", "seed": 3, "settings": {"drone": "crazyflie"}}
IDENTIFIED = DroneFile(
    parameters.crazyflie(),
    {
        "latency": Estimate(0.018, (0.01, 0.02), (0.018,), 0.001),
        "mass": Estimate(0.028, (0.02, 0.03), (0.028,), 0.0),
    },
    {
        "latency": np.array([0.018, 0.019, 0.017]),
        "torque_bias_x": np.array([1e-5, 0.0, 2e-5]),
    },
    Source(4, 120.0, True, "subsampled", 60000.0),
    Search("replay", 5.0, 116, 60),
    record=RECORD,
)
_TABLES = {quantity.table for quantity in QUANTITIES.values()}


def drone_told(read: Parameters) -> list[np.ndarray]:
    return [np.asarray(getattr(read, name), np.float32) for name in QUANTITIES]


def unsound_drone(read: Parameters) -> str:
    """Bounds and shapes, without `parameters.check`."""
    for name, quantity in QUANTITIES.items():
        value = np.asarray(getattr(read, name))
        within = (
            np.isfinite(value)
            & (value >= np.float32(quantity.lower))
            & (value <= np.float32(quantity.upper))
        )
        if (
            value.shape[-1:] != ((3,) if quantity.size == 3 else value.shape[-1:])
            or not within.all()
        ):
            return f"{name} = {value}"
    return ""


def small_policy(control: str = "pwm", history: int = 1) -> Policy:
    """A policy with few numbers."""
    return untrained_policy(
        jax.random.key(0), INTERFACES[control](), PolicySpec(history=history, hidden=(3,))
    )


def policy_told(read: Policy) -> list[np.ndarray]:
    words = np.array([str(read.interface), str(read.spec)])
    return [
        words,
        *map(
            np.asarray,
            (*read.weights, *read.biases, read.observation_mean, read.observation_std),
        ),
    ]


def unsound_policy(read: Policy) -> str:
    arrays = policy_told(read)[1:]
    sizes = (read.spec.size, *(len(bias) for bias in read.biases))
    faults = {
        "a number that is none": not all(
            np.isfinite(array).all() and array.dtype == np.float32 for array in arrays
        ),
        "shapes": [weight.shape for weight in read.weights]
        != list(zip(sizes[1:], sizes[:-1], strict=True))
        or sizes[-1] != 4,
        "a deviation": not (np.asarray(read.observation_std) > 0).all(),
        "an interface": ControlInterface.from_dict(read.interface.to_dict()) != read.interface,
    }
    return next((fault for fault, there in faults.items() if there), "")


def file_readers() -> list[Reader]:
    """Of drones, policies, settings, way-points, the link's rows and checkpoints."""
    plain = drone(record=RECORD)
    needs = drone_needs
    whole = Kind(REFUSED)
    ours = policy_file.to_json(small_policy(), RECORD).encode()
    authors_file = to_authors_json(small_policy("attitude", 2)).encode()
    return [
        Reader(
            "drone, TOML",
            10,
            (Good("drone.toml", plain, tree_damaged(toml, needs, "toml", Kind(SAME))),),
            lambda _, path: parameters.read_drone(path),
            drone_told,
            unsound_drone,
        ),
        Reader(
            "drone, TOML with a posterior",
            1,
            (
                Good(
                    "drone.toml",
                    IDENTIFIED.to_toml("drone").encode(),
                    tree_damaged(toml, lambda _: True, "toml", Kind(ANY)),
                ),
            ),
            lambda _, path: possible_drones(path, POSTERIOR, 0),
            drone_told,
            unsound_drone,
        ),
        Reader(
            "policy, JSON",
            10,
            (
                Good(
                    "policy.json",
                    ours,
                    tree_damaged(json.loads, lambda path: path[0] != "record", "json", whole),
                ),
            ),
            lambda _, path: policy_file.read_policy(path).policy,
            policy_told,
            unsound_policy,
        ),
        Reader(
            "policy of the authors, JSON",
            8,
            (
                Good(
                    "attitude_1.json",
                    authors_file,
                    tree_damaged(json.loads, lambda _: True, "json", whole),
                ),
            ),
            lambda _, path: policy_file.read_policy(path).policy,
            policy_told,
            unsound_policy,
        ),
        study_reader(),
        Reader(
            "way-points, CSV",
            4,
            (_waypoints(),),
            lambda _, path: read_waypoints(path),
            lambda read: [np.array(read)],
            _unsound_points,
        ),
        Reader(
            "rows of a real flight",
            6,
            (_rows(),),
            lambda _, path: row_files.to_flight(path),
            _rows_told,
            _unsound_rows,
        ),
        Reader(
            "checkpoint",
            8,
            (_checkpoint(),),
            _restored,
            lambda read: [np.asarray(leaf) for leaf in read],
            lambda _: "",
        ),
        Reader(
            "record in a table",
            4,
            (_told(),),
            lambda _, path: results.read_record(path),
            lambda _: [],
            _unsound_record,
            lenient=True,
        ),
    ]


def drone_needs(path: tuple[Any, ...]) -> bool:
    return path == ("format",) or path[0] in _TABLES


def _waypoints() -> Good:
    text = "time,x,y,z\n" + "".join(
        f"{0.5 * number},{0.1 * number:.3f},{0.05 * number:.3f},1.0\n" for number in range(12)
    )
    return Good("points.csv", text.encode(), table_damaged(("time", "x", "y", "z"), ANY))


def _unsound_points(read: Any) -> str:
    table = np.array(read)
    sound = (
        table.ndim == 2
        and table.shape[1] == 4
        and np.isfinite(table).all()
        and (np.diff(table[:, 0]) > 0).all()
    )
    return "" if sound else "way-points"


def _rows() -> Good:
    names = (*STATE.variables, *MOTORS.variables)
    lines = []
    for number in range(ROWS):
        state = [str(number % 97 + place) for place in range(9)] + ["0.0", "0.0", "0.0", "1.0"]
        motors = ["30000", "30001", "30002", "30003", "0.0", "0.0", "1.0", "30000.0", "3900", "31"]
        lines.append(
            f"{5000 + 10 * number},{0.01 * number:.4f}," + ",".join([*state, *[""] * len(motors)])
        )
        lines.append(
            f"{5000 + 10 * number},{0.01 * number:.4f}," + ",".join([*[""] * len(state), *motors])
        )
    head = f'{row_files.MARK}: made\n# simulated: no\n# record: {{"seed": 1}}\n' + ",".join(
        ["timestamp", "received", *names]
    )
    return Good(
        "flight_01.rows",
        (head + "\n" + "\n".join(lines) + "\n").encode(),
        table_damaged(("timestamp", *names), ANY),
    )


def _rows_told(read: Any) -> list[np.ndarray]:
    return [getattr(read[0], group) for group in log.GROUPS if group != "time"]


def _unsound_rows(read: Any) -> str:
    flight, record, _ = read
    arrays = _rows_told(read)
    if not isinstance(record, dict):
        return "a record"
    if (
        any(len(array) != len(flight) or np.isinf(array).any() for array in arrays)
        or len(flight) > 100_000
    ):
        return "rows"
    command = flight.command[np.isfinite(flight.command)]
    return "a command" if ((command < 0) | (command > 1)).any() else ""


class State(NamedTuple):
    """Something to save."""

    weights: Any
    number: Any


def _fresh(_: tuple[int, ...]) -> State:
    return State(np.zeros((4, 5), np.float32), np.zeros((), np.int32))


def _checkpoint() -> Good:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "training.npz")
        checkpoint.save(
            path, State(np.arange(20, dtype=np.float32).reshape(4, 5), np.int32(7)), "mine", (9,)
        )
        content = path.read_bytes()
    return Good("training.npz", content, _npz)


def _npz(generator: random.Random, good: bytes, other: bytes) -> Damaged:
    if generator.random() < 0.7:
        return damage.of_bytes(generator, good, other, Kind(REFUSED, SAME))
    arrays = dict(np.load(io.BytesIO(good)))
    name = generator.choice(list(arrays))
    odd = (
        np.zeros(3),
        np.array("text"),
        np.array([None, {}], object),
        np.zeros((0, 5)),
        np.float64(1),
        np.array([b"\x00"]),
    )
    if generator.random() < 0.5:
        arrays[name] = generator.choice(odd)
    else:
        del arrays[name]
    file = io.BytesIO()
    np.savez(file, **arrays)
    return Damaged(file.getvalue(), f"another {name}", REFUSED)


def _restored(_: Path, path: Path) -> Any:
    return checkpoint.restored(path, _fresh, "mine")[0]


def _told() -> Good:
    text = f"# a table\n# record: {json.dumps(RECORD)}\npolicy,trial\n1,1\n1,2\n"
    return Good("flights.csv", text.encode(), table_damaged((), ANY))


def _unsound_record(read: Any) -> str:
    return "" if read is None or isinstance(read, dict) else "a record that is no table"
