"""A run as the report shows it, read from a folder or from a `Transfer` in memory.

Each part is optional: a folder may be that of the demo, of one stage or of a matrix.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import log
from maidenflight.flights.log import Flight
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Estimate
from maidenflight.parameters import COMPONENTS, Parameters, component
from maidenflight.reporting import identified, other_files
from maidenflight.reporting.identified import SIMULATED, UNKNOWN, Kinds
from maidenflight.run_folder import Table

MOST = 300
"""Flights that the viewer holds, and logs of recorded flights that are read; more would make the
page heavy."""


@dataclass(frozen=True)
class Run:
    """What is known of a run; a part that is missing is `None` or empty."""

    reality: Parameters | None = None
    """The truth about a virtual drone."""
    recorded: tuple[Flight, ...] = ()
    """The first `MOST` flights that were recorded."""
    logs: int = 0
    """How many there are."""
    drone: DroneFile | None = None
    """The identified drone."""
    kinds: Kinds = UNKNOWN
    """Whether the flights that it was identified from were of a simulated drone."""
    search: polars.DataFrame | None = None
    """One row an evaluation of the identification's objective."""
    validation: polars.DataFrame | None = None
    """Errors of open-loop predictions; see `prediction_error`."""
    windows: polars.DataFrame | None = None
    """Some windows, logged and predicted; see `predicted_windows`."""
    predicted: Kinds = UNKNOWN
    """Whether the flights of both were of a simulated drone."""
    policies: int = 0
    controls: Mapping[str, str] = field(default_factory=dict)
    """Control structure of each policy, by the policy's name, where it is known."""
    training: polars.DataFrame | None = None
    """One row an evaluation of a policy in training."""
    table: polars.DataFrame | None = None
    """One row a test flight; see `Transfer`. Those of a matrix have `control`,
    `motor_time_constant` and `latency` too."""
    flights: tuple[Flight, ...] = ()
    """Logs of the test flights, in the table's order."""
    prediction: polars.DataFrame | None = None
    """One row a predicted flight; see `predict_flight_times`."""
    records: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """How each file was made, by the file's name."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall time of each stage."""
    other_files: Mapping[str, list[str]] = field(default_factory=dict)
    """Names of what else the folder holds, by kind."""

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The identified parameters, by name."""
        return {} if self.drone is None else self.drone.estimates

    @property
    def posterior(self) -> Mapping[str, Float[np.ndarray, "N"]]:
        """Posterior samples of the identified parameters."""
        return {} if self.drone is None else self.drone.posterior

    @property
    def objective(self) -> str:
        """What the identification optimised; `replay` where that is not known."""
        found = None if self.drone is None else self.drone.search
        return "replay" if found is None else found.objective

    @property
    def known(self) -> bool:
        """Whether there is anything to show."""
        tables = (
            self.reality,
            self.drone,
            self.search,
            self.validation,
            self.windows,
            self.training,
            self.table,
            self.prediction,
        )
        return any(part is not None for part in tables) or bool(self.recorded or self.policies)


def of_transfer(flown: Transfer) -> Run:
    """The run of test flights in memory."""
    return Run(
        table=run_folder.FLIGHTS.checked(flown.table, "transfer"), flights=tuple(flown.flights)
    )


def read(folder: Path) -> Run:
    """Reads whatever a run folder holds.

    Raises:
        InputError: not a folder, nothing known in it, or a file in it is not what its name says.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder. Give the folder of a run, such as maidenflight demo writes."
        )
    records: dict[str, Mapping[str, Any]] = {}
    tested = _folder(folder, run_folder.TRANSFER)
    table = _test_flights(tested / run_folder.FLIGHTS.name, records)
    home = _folder(folder, *run_folder.RECORDED)
    hidden = next(
        (place for place in (folder, home) if os.path.lexists(place / run_folder.REALITY)), folder
    )
    truth = _drone(hidden / run_folder.REALITY, records)
    reality = None if truth is None else truth.parameters
    recorded = run_folder.LOG.find(home) if home != tested or table is None else []
    recorded_flights = _logs(recorded[:MOST], records)
    drone = _drone(folder / run_folder.DRONE, records)
    trained = _folder(folder, run_folder.POLICIES)
    policies = {path.stem: run_folder.json_object(path) for path in run_folder.POLICY.find(trained)}
    for name, content in policies.items():
        _keep(records, trained / f"{name}.json", content.get("record"))
    flights = _logs(run_folder.LOG.find(tested), records) if table is not None else ()
    if table is not None and flights and len(flights) != table.height:
        raise InputError(
            f"{tested}: {len(flights)} flight logs, but flights.csv has {table.height} rows. Run "
            "the transfer again."
        )
    validation = _table(folder / run_folder.VALIDATION.name, run_folder.VALIDATION, records)
    windows = _table(folder / run_folder.WINDOWS.name, run_folder.WINDOWS, records)
    logs = {
        results.digest(path): bool(flight.simulated)
        for path, flight in zip(recorded, recorded_flights, strict=False)
    }
    kinds, predicted = _kinds(logs, drone, records, reality is not None)
    found = Run(
        reality=reality,
        recorded=recorded_flights,
        logs=len(recorded),
        drone=drone,
        kinds=kinds,
        search=_search(folder / run_folder.EVALUATIONS.name),
        validation=validation,
        windows=windows,
        predicted=predicted,
        policies=len(policies),
        controls={
            name: str(content["control"])
            for name, content in policies.items()
            if "control" in content
        },
        training=_table(trained / run_folder.TRAINING.name, run_folder.TRAINING),
        table=table,
        flights=flights,
        prediction=_table(folder / run_folder.PREDICTION.name, run_folder.PREDICTION, records),
        records=records,
        seconds=run_folder.read_stages(folder),
        other_files=other_files.find(folder, {tested, trained, home}),
    )
    if not found.known:
        raise InputError(
            f"{folder}: nothing of a run in this folder; expected reality.toml, recorded/ or "
            "flights/, drone.toml, identification.csv,"
            " validation.csv, policies/, policy_*.json, transfer/, flights.csv, prediction.csv or "
            "flight logs."
        )
    return found


def _folder(folder: Path, *names: str) -> Path:
    """The first folder of these names in a run's, or else that itself: it is one of a stage."""
    return next((folder / name for name in names if (folder / name).is_dir()), folder)


def _kinds(
    logs: Mapping[str, bool],
    drone: DroneFile | None,
    records: Mapping[str, Mapping[str, Any]],
    virtual: bool,
) -> tuple[Kinds, Kinds]:
    """Kinds of the flights that the drone was identified from, and of those that were predicted.

    By their logs, where these are in the folder.
    """
    known: dict[str, bool | None] = dict(logs)
    otherwise = SIMULATED if virtual or (known and all(known.values())) else UNKNOWN
    used = log_digests(records, run_folder.DRONE)
    own = identified.kinds_identified(drone, identified.kinds_of(used, known, otherwise))
    if len(own) == 1:
        known |= dict.fromkeys(used, *own)
    predicted = log_digests(records, run_folder.VALIDATION.name, run_folder.WINDOWS.name)
    return own, identified.kinds_of(predicted, known, otherwise if own <= otherwise else UNKNOWN)


def log_digests(records: Mapping[str, Mapping[str, Any]], *names: str) -> set[str]:
    """Digests of the flight logs that the record of a file names.

    Args:
        records: see `Run.records`.
        names: of files; the first that has a record counts.

    Raises:
        InputError: the record names its inputs in another way.
    """
    name = next((name for name in names if name in records), None)
    found = {} if name is None else results.recorded_inputs(records[name], name)
    return {digest for digest, file in found.items() if not file.endswith(".toml")}


def holds_flights(folder: Path) -> bool:
    """Whether a folder is that of a run with test flights or recorded ones."""
    names = (run_folder.FLIGHTS.name, run_folder.TRANSFER, *run_folder.RECORDED)
    return any((folder / name).exists() for name in names)


def _keep(records: dict[str, Mapping[str, Any]], path: Path, record: Any) -> None:
    if isinstance(record, dict) and record:
        name = (
            path.name
            if path.suffix == ".toml"
            else "/".join(filter(None, (path.parent.name, path.name)))
        )
        records[name] = record


def _drone(path: Path, records: dict[str, Mapping[str, Any]]) -> DroneFile | None:
    if not os.path.lexists(path):
        return None
    found = drone_file.read(path)
    _keep(records, path, found.record)
    return found


def _logs(paths: Sequence[Path], records: dict[str, Mapping[str, Any]]) -> tuple[Flight, ...]:
    flights = []
    for path in paths:
        text = run_folder.text(path)
        if not text.startswith(log.MARK):
            raise InputError(
                f"{path}: not a flight log of maidenflight; its first line should begin with "
                f"'{log.MARK}'."
            )
        flights.append(log.from_csv(text, f"{path.parent.name}/{path.name}"))
        if not 0 < flights[-1].period < 1:
            raise InputError(
                f"{path}: rows are {flights[-1].period:g} s apart; expected a time that "
                "increases, in seconds. Log it again."
            )
        _keep(records, path, run_folder.record_of(text, path))
    return tuple(flights)


def _search(path: Path) -> polars.DataFrame | None:
    """Evaluations of an objective; every parameter that was searched has a column of numbers."""
    search = _table(path, run_folder.EVALUATIONS)
    if search is None:
        return None
    searched = {name: float for name in search.columns if name in COMPONENTS}
    return Table(run_folder.EVALUATIONS.name, searched).checked(search, str(path))


def _test_flights(path: Path, records: dict[str, Mapping[str, Any]]) -> polars.DataFrame | None:
    """The rows of `flights.csv`.

    Those of a matrix say what each policy was trained for, and its name is made of that.
    """
    if not os.path.lexists(path):
        return None
    rows, record = run_folder.read_flights(path)
    _keep(records, Path(path.name), record)
    if "policy" in rows.columns:
        return rows
    names = [
        f"{row['control']}_{1e3 * row['motor_time_constant']:g}ms_"
        f"{1e3 * row['latency']:g}ms/{row['number']}"
        for row in rows.iter_rows(named=True)
    ]
    return rows.with_columns(
        polars.Series("policy", names), polars.int_range(1, rows.height + 1).alias("flight")
    )


def _table(
    path: Path, table: Table, records: dict[str, Mapping[str, Any]] | None = None
) -> polars.DataFrame | None:
    """Reads a table, and its record into `records`."""
    if not os.path.lexists(path):
        return None
    rows, record = table.read(path)
    if records is not None:
        _keep(records, Path(path.name), record)
    return rows


def truth(run: Run) -> tuple[tuple[float, float], ...]:
    """Corners of the true delays of a virtual drone, (T_m, latency) [s].

    T_m from speeding up to slowing down, latency from that of commands to that with the sensors'.
    """
    if run.reality is None:
        return ()
    lag, delay = float(run.reality.motor_time_constant), float(run.reality.latency)
    (_, slow), (_, late) = true_ends(run, "motor_time_constant"), true_ends(run, "latency")
    return ((lag, delay), (slow, delay), (slow, late), (lag, late))


def true_ends(run: Run, name: str) -> tuple[float, float]:
    """The true value of a parameter of a virtual drone, from and to [SI].

    They differ where the drone has two values for what the model has one for.
    """
    assert run.reality is not None
    same = float(component(run.reality, name))
    if name == "motor_time_constant" and "spin_down_ratio" not in run.estimates:
        return same, same * float(run.reality.spin_down_ratio)
    if name == "latency":
        return same, same + float(run.reality.estimator_delay + run.reality.gyro_time_constant)
    return same, same


def usable(flight: Flight) -> slice:
    """The rows before the first one that is not finite; a flight may end in such."""
    rows = np.concatenate([flight.position, flight.attitude, flight.command], axis=1)
    bad = ~np.isfinite(rows).all(axis=1)
    return slice(0, int(np.argmax(bad)) if bad.any() else len(flight))


def viewable(run: Run) -> list[int]:
    """Places among those `shown` of the flights that the viewer holds: the first with two rows."""
    return [number for number, flight in enumerate(shown(run)) if usable(flight).stop > 1][:MOST]


def shown(run: Run) -> tuple[Flight, ...]:
    """Flights to look at: test flights where there are any, else those that were recorded."""
    return run.flights if run.table is not None else run.recorded
