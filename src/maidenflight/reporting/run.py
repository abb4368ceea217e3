"""A run as the report shows it, read from a folder or from a `Transfer` in memory.

Each part is optional: a folder may be that of the demo or of one stage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import inputs, results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import log
from maidenflight.flights.formats import is_known
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights, whole_flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Estimate
from maidenflight.parameters import COMPONENTS, Parameters, component
from maidenflight.reporting import identified, sources, trained
from maidenflight.reporting.identified import SIMULATED, UNKNOWN, Kinds
from maidenflight.run_folder import Table

MOST = 300
"""Flights that the viewer holds, and logs of recorded flights that are read; more would make the
page heavy."""


BRIEF_S = 2.0
"""A log shorter than this is shown although the drone hardly flies in it [s]."""


@dataclass(frozen=True)
class Run:
    """What is known of a run; a part that is missing is `None` or empty."""

    reality: Parameters | None = None
    """The truth about a virtual drone."""
    recorded: tuple[Flight, ...] = ()
    """The first `MOST` flights that were recorded."""
    logs: int = 0
    """How many there are."""
    refused: tuple[str, ...] = ()
    """Why other logs cannot be used, a line each."""
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
    used: frozenset[str] = frozenset()
    """Digests of the logs that the drone was identified from, as its file says."""
    judged: frozenset[str] = frozenset()
    """Digests of the logs that were predicted, as the table of errors says."""
    policies: int = 0
    controls: Mapping[str, str] = field(default_factory=dict)
    """Control structure of each policy, by the policy's name, where it is known."""
    training: polars.DataFrame | None = None
    """One row an evaluation of a policy in training."""
    table: polars.DataFrame | None = None
    """One row a test flight; see `Transfer`."""
    flights: tuple[Flight, ...] = ()
    """Logs of the test flights, in the table's order."""
    prediction: polars.DataFrame | None = None
    """One row a predicted flight; see `predict_flight_times`."""
    study: polars.DataFrame | None = None
    """What the tasks of a study found, a row of each after the other."""
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
            self.study,
        )
        return any(part is not None for part in tables) or bool(self.recorded or self.policies)


def of_transfer(flown: Transfer) -> Run:
    """The run of test flights in memory."""
    return Run(
        table=run_folder.FLIGHTS.checked(flown.table, "transfer"), flights=tuple(flown.flights)
    )


def read(*given: Path) -> Run:
    """Reads what there is in files and folders, known by what they hold.

    Raises:
        InputError: see `sources.find`; nothing known is there, or a file is not what it seems to
            be.
    """
    found = sources.find(given)
    records: dict[str, Mapping[str, Any]] = {}
    table = _test_flights(found.table, records)
    truth = _drone(found.truth, records)
    reality = None if truth is None else truth.parameters
    recorded, refused = _recorded(found.logs[:MOST], given, records)
    drone = _drone(found.drone, records)
    policies = trained.read_policies(found.policies)
    for path, file in policies.items():
        _keep(records, path, file.record)
    flights = tuple(_own(path, records) for path in found.tested) if table is not None else ()
    if table is not None and flights and len(flights) != table.height:
        raise InputError(
            f"{found.table}: {len(flights)} flight logs, but {table.height} rows. Run the transfer "
            "again."
        )
    logs = {results.digest(path): bool(flight.simulated) for path, flight in recorded}
    validation, said = _table(found.validation, run_folder.VALIDATION, records)
    windows, said_too = _table(found.windows, run_folder.WINDOWS, records)
    used = _digests({} if drone is None else drone.record, found.drone)
    judged = _digests(said or said_too, found.validation or found.windows)
    kinds, predicted = _kinds(logs, drone, used, judged, reality is not None)
    run = Run(
        reality=reality,
        recorded=tuple(flight for _, flight in recorded),
        logs=len(found.logs) - len(refused),
        drone=drone,
        kinds=kinds,
        search=_search(found.evaluations),
        validation=validation,
        windows=windows,
        predicted=predicted,
        used=used,
        judged=judged,
        policies=len(found.policies),
        controls={} if table is None else trained.controls(policies, table["policy"]),
        training=_table(found.training, run_folder.TRAINING)[0],
        table=table,
        flights=flights,
        prediction=_table(found.prediction, run_folder.PREDICTION, records)[0],
        study=_table(found.study, run_folder.STUDY, records)[0],
        records=records,
        seconds={} if found.stages is None else run_folder.read_stages(found.stages),
        refused=tuple(refused),
        other_files=found.others,
    )
    if not run.known:
        raise InputError(sources.nothing(given))
    return run


def _kinds(
    logs: Mapping[str, bool],
    drone: DroneFile | None,
    used: frozenset[str],
    judged: frozenset[str],
    virtual: bool,
) -> tuple[Kinds, Kinds]:
    """Kinds of the flights that the drone was identified from, and of those that were predicted.

    By their logs, where these are known.
    """
    known: dict[str, bool | None] = dict(logs)
    otherwise = SIMULATED if virtual or (known and all(known.values())) else UNKNOWN
    own = identified.kinds_identified(drone, identified.kinds_of(used, known, otherwise))
    if len(own) == 1:
        known |= dict.fromkeys(used, *own)
    return own, identified.kinds_of(judged, known, otherwise if own <= otherwise else UNKNOWN)


def _digests(record: Mapping[str, Any], path: Path | None) -> frozenset[str]:
    """Digests of the flight logs that the record of a file names.

    Raises:
        InputError: it names its inputs in another way.
    """
    found = results.recorded_inputs(record, str(path)) if record else {}
    return frozenset(digest for digest, file in found.items() if not file.endswith(".toml"))


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


def _drone(path: Path | None, records: dict[str, Mapping[str, Any]]) -> DroneFile | None:
    if path is None:
        return None
    found = drone_file.read(path)
    _keep(records, path, found.record)
    return found


def _recorded(
    paths: Sequence[Path], given: Sequence[Path], records: dict[str, Mapping[str, Any]]
) -> tuple[list[tuple[Path, Flight]], list[str]]:
    """The flights in logs of any format, and why others in folders cannot be used.

    Our own logs are shown whole, of others the gapless pieces in which the drone flies, if any.

    Raises:
        InputError: a log of ours, or one that was itself given, cannot be used.
    """
    flights: list[tuple[Path, Flight]] = []
    refused = []
    for path in paths:
        if _is_own(path):
            flights.append((path, _own(path, records)))
            continue
        try:
            flights += [(path, flight) for flight in _pieces(path)]
        except InputError as error:
            if path in given:
                raise
            if _numbered(path) and path.parent.name in run_folder.RECORDED and not is_known(path):
                _own(path, records)
            refused.append(str(error))
    return flights, refused


def _pieces(path: Path) -> Sequence[Flight]:
    """The pieces of a log in which the drone flies; the whole of one that is brief.

    Raises:
        InputError: there is not even that.
    """
    try:
        return read_flights(path).flights
    except InputError:
        whole = whole_flights(path)
        found = [one for one in whole if one.duration < BRIEF_S and usable(one).stop > 1]
        if not found:
            raise
        return found


def _is_own(path: Path) -> bool:
    """Whether a file is a log of ours, by its first line; where it has none, by its name."""
    try:
        first = next(iter(inputs.comments(path)), "") if path.suffix == ".csv" else ""
    except (OSError, UnicodeDecodeError):
        return _numbered(path)
    return first.startswith(log.FAMILY)


def _numbered(path: Path) -> bool:
    """Whether a log has a name that a command gives."""
    return path.match(f"{run_folder.LOG.stem}_*{run_folder.LOG.suffix}")


def _own(path: Path, records: dict[str, Mapping[str, Any]]) -> Flight:
    text = inputs.readable(path)
    if not text.startswith(log.MARK):
        raise InputError(
            f"{path}: not a flight log of maidenflight; its first line should begin with "
            f"'{log.MARK}'."
        )
    flight = log.from_csv(text, f"{path.parent.name}/{path.name}")
    if not 0 < flight.period < 1:
        raise InputError(
            f"{path}: rows are {flight.period:g} s apart; expected a time that increases, in "
            "seconds. Log it again."
        )
    _keep(records, path, run_folder.record_of(text, path))
    return flight


def _search(path: Path | None) -> polars.DataFrame | None:
    """Evaluations of an objective; every parameter that was searched has a column of numbers."""
    search, _ = _table(path, run_folder.EVALUATIONS)
    if path is None or search is None:
        return None
    searched = {name: float for name in search.columns if name in COMPONENTS}
    return Table(run_folder.EVALUATIONS.name, searched).checked(search, str(path))


def _test_flights(
    path: Path | None, records: dict[str, Mapping[str, Any]]
) -> polars.DataFrame | None:
    """The rows of test flights."""
    if path is None:
        return None
    rows, record = run_folder.FLIGHTS.read(path)
    _keep(records, Path(path.name), record)
    return rows


def _table(
    path: Path | None, table: Table, records: dict[str, Mapping[str, Any]] | None = None
) -> tuple[polars.DataFrame | None, dict[str, Any]]:
    """Reads a table and its record, which is kept in `records`."""
    if path is None:
        return None, {}
    rows, record = table.read(path)
    if records is not None:
        _keep(records, Path(path.name), record)
    return rows, record


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
