"""A run as the report shows it, read from a run folder, from files or from a `Transfer` in memory.

Each part is optional: a run may be that of the demo or of one stage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Float

from maidenflight import budget, inputs, manifest, results, run_folder
from maidenflight.errors import InputError, printable
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import flight_csv
from maidenflight.flights.log import Flight
from maidenflight.flights.reading import read_flights, whole_flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Estimate
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters, component
from maidenflight.reporting import identified, trained
from maidenflight.reporting.identified import SIMULATED, UNKNOWN, Kinds
from maidenflight.reporting.run_files import FileOptions, RunFiles, find_files, nothing_here
from maidenflight.run_folder import Table

MAX_FLIGHTS = 300
"""Flights that the viewer holds, and logs of recorded flights that are read; more would make the
page heavy."""

BRIEF_S = 2.0
"""A log shorter than this counts although the drone hardly flies in it [s]."""


@dataclass(frozen=True)
class Run:
    """What is known of a run; a part that is missing is `None` or empty."""

    reality: Parameters | None = None
    """The truth about a virtual drone."""
    recorded: tuple[Flight, ...] = ()
    """The first `MAX_FLIGHTS` flights that were recorded."""
    logs: int = 0
    """How many there are."""
    refused: tuple[str, ...] = ()
    """Why other logs cannot be used, a line each."""
    drone: DroneFile | None = None
    """The identified drone."""
    kinds: Kinds = UNKNOWN
    """Whether the flights that it was identified from were of a simulated drone."""
    validation: polars.DataFrame | None = None
    """Errors of open-loop predictions; see `prediction_error`."""
    windows: polars.DataFrame | None = None
    """Some windows, logged and predicted; see `predicted_windows`."""
    calibration: polars.DataFrame | None = None
    """Truths and intervals of drones of the posterior; see `calibration.draw_calibrations`."""
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
    """Results of the tasks of a study, a row of each after the other."""
    records: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """How each file was made, by the file's name."""
    missing_files: Sequence[str] = ()
    """Names of files that the run's manifest lists and that are no longer there."""
    other_files: Mapping[str, list[str]] = field(default_factory=dict)
    """Names of what else the manifest lists, by kind."""

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The identified parameters, by name."""
        return {} if self.drone is None else self.drone.estimates

    @property
    def unidentified(self) -> Mapping[str, tuple[float, float]]:
        """Plausible range of each parameter that the flights do not identify, by name."""
        return {} if self.drone is None else self.drone.unidentified

    @property
    def posterior(self) -> Mapping[str, Float[np.ndarray, "N"]]:
        """Posterior samples of the identified parameters."""
        return {} if self.drone is None else self.drone.posterior

    @property
    def objective(self) -> str:
        """What the identification optimised; `replay` where that is not known."""
        search = None if self.drone is None else self.drone.search
        return "replay" if search is None else search.objective

    @property
    def known(self) -> bool:
        """Whether there is anything to show."""
        tables = self.validation, self.windows, self.training, self.table, self.prediction
        parts = self.reality, self.drone, self.study, self.calibration, *tables
        return any(part is not None for part in parts) or bool(self.recorded or self.policies)


def of_transfer(result: Transfer) -> Run:
    """Returns the run of test flights in memory."""
    table = run_folder.FLIGHTS.checked(result.table, "transfer")
    return Run(table=table, flights=tuple(result.flights))


_TABLES: Mapping[manifest.Kind, Table] = {
    "validation": run_folder.VALIDATION,
    "windows": run_folder.WINDOWS,
    "calibration": run_folder.CALIBRATION,
    "training": run_folder.TRAINING,
    "prediction": run_folder.PREDICTION,
    "study": run_folder.STUDY,
}
"""Tables of a run but that of test flights, by kind, which are fields of `Run`."""


def read_run(source: StrPath | None = None, options: FileOptions | None = None) -> Run:
    """Reads a run from its folder, from what its manifest lists, and from files of a user.

    Raises:
        InputError: see `find_files`; nothing is there, or a file is not what it should be.
    """
    files = find_files(source, options or {})
    first = {kind: path for kind in files.files if (path := files.first(kind)) is not None}
    tables = {kind: table.read(first[kind]) for kind, table in _TABLES.items() if kind in first}
    rows: dict[str, Any] = {kind: rows for kind, (rows, _) in tables.items()}
    drones = {kind: drone_file.read(first[kind]) for kind in ("truth", "drone") if kind in first}
    records = {first[kind].name: drone.record for kind, drone in drones.items()}
    records |= {first[kind].name: record for kind, (_, record) in tables.items()}
    policies = trained.read_policies(files.files.get("policies", ()))
    records |= {_name(path): file.record for path, file in policies.items()}
    table, flights = _test_flights(files, records)
    recorded, refused = _recorded(files, records)
    logs = {results.digest(path): bool(flight.simulated) for path, flight in recorded}
    drone, truth = drones.get("drone"), drones.get("truth")
    used = _digests({} if drone is None else drone.record, first.get("drone"))
    judging = "validation" if "validation" in tables else "windows"
    judged = _digests(tables[judging][1], first[judging]) if judging in tables else frozenset()
    kinds, predicted = _kinds(logs, drone, used, judged, truth is not None)
    run = Run(
        reality=None if truth is None else truth.parameters,
        recorded=tuple(flight for _, flight in recorded),
        logs=len(files.files.get("logs", ())) - len(refused),
        drone=drone,
        kinds=kinds,
        predicted=predicted,
        used=used,
        judged=judged,
        policies=len(files.files.get("policies", ())),
        controls={} if table is None else trained.controls(policies, table["policy"]),
        table=table,
        flights=flights,
        records={
            name: entry for name, entry in records.items() if isinstance(entry, dict) and entry
        },
        refused=tuple(refused),
        missing_files=files.missing,
        other_files=files.others,
        **rows,
    )
    if not run.known:
        raise nothing_here(Path(source or ""), files.missing)
    return run


def _kinds(
    logs: Mapping[str, bool],
    drone: DroneFile | None,
    used: frozenset[str],
    judged: frozenset[str],
    virtual: bool,
) -> tuple[Kinds, Kinds]:
    """Kinds of the flights of the identification, and of those predicted, by their logs."""
    known: dict[str, bool | None] = dict(logs)
    otherwise = SIMULATED if virtual or (known and all(known.values())) else UNKNOWN
    own = identified.kinds_identified(drone, identified.kinds_of(used, known, otherwise))
    if len(own) == 1:
        known |= dict.fromkeys(used, *own)
    return own, identified.kinds_of(judged, known, otherwise if own <= otherwise else UNKNOWN)


def _digests(record: Mapping[str, Any], path: Path | None) -> frozenset[str]:
    """Digests of the flight logs that the record of a file names."""
    digests = results.recorded_inputs(record, str(path)) if record else {}
    return frozenset(digest for digest, file in digests.items() if not file.endswith(".toml"))


def _name(path: Path) -> str:
    """A file of a folder, as records name it."""
    return printable("/".join(filter(None, (path.parent.name, path.name))))


def _recorded(
    files: RunFiles, records: dict[str, Mapping[str, Any]]
) -> tuple[list[tuple[Path, Flight]], list[str]]:
    """Returns the flights in logs of any format, and why others cannot be used.

    Our own logs count whole, of others the gapless pieces in which the drone flies, if any.
    """
    flights: list[tuple[Path, Flight]] = []
    refused = []
    for path in files.files.get("logs", ())[:MAX_FLIGHTS]:
        own = _is_own(path)
        try:
            flights += [
                (path, flight) for flight in ([_own(path, records)] if own else _pieces(path))
            ]
        except InputError as error:
            if path in files.required_logs or own:
                raise
            refused.append(str(error))
    return flights, refused


def _pieces(path: Path) -> Sequence[Flight]:
    """The pieces of a log in which the drone flies; the whole of one that is brief."""
    try:
        return read_flights(path, faulty="use").flights
    except InputError:
        whole = whole_flights(path)
        pieces = [piece for piece in whole if piece.duration < BRIEF_S and usable(piece).stop > 1]
        if not pieces:
            raise
        return pieces


def _is_own(path: Path) -> bool:
    """Whether a file is a log of ours, by its first line."""
    try:
        first = next(iter(inputs.comments(path)), "") if path.suffix == ".csv" else ""
    except (OSError, ValueError):
        return False
    return first.startswith(flight_csv.FAMILY)


def _own(path: Path, records: dict[str, Mapping[str, Any]]) -> Flight:
    text = inputs.readable(path, budget.WHOLE_LOG)
    if not text.startswith(flight_csv.MARK):
        raise InputError(
            f"{path}: not a flight log of maidenflight; its first line should begin with "
            f"'{flight_csv.MARK}'."
        )
    flight = flight_csv.from_csv(text, _name(path))
    if not 0 < flight.period < 1:
        raise InputError(
            f"{path}: rows are {flight.period:g} s apart; expected a time that increases, in "
            "seconds. Log it again."
        )
    records[_name(path)] = results.parse_record(inputs.comments(path), path)
    return flight


def _test_flights(
    files: RunFiles, records: dict[str, Mapping[str, Any]]
) -> tuple[polars.DataFrame | None, tuple[Flight, ...]]:
    path = files.first("flights")
    if path is None:
        return None, ()
    rows, records[path.name] = run_folder.FLIGHTS.read(path)
    flights = tuple(_own(each, records) for each in files.files.get("flight_logs", ()))
    if flights and len(flights) != rows.height:
        raise InputError(
            f"{path}: {len(flights)} flight logs, but {rows.height} rows. Run the transfer again."
        )
    return rows, flights


def truth(run: Run) -> tuple[tuple[float, float], ...]:
    """Returns corners of the true delays of a virtual drone, (T_m, latency) [s].

    T_m from speeding up to slowing down, latency from that of commands to that with the sensors'.
    """
    if run.reality is None:
        return ()
    lag, delay = float(run.reality.motor_time_constant), float(run.reality.latency)
    (_, slow), (_, late) = true_ends(run, "motor_time_constant"), true_ends(run, "latency")
    return ((lag, delay), (slow, delay), (slow, late), (lag, late))


def true_ends(run: Run, name: str) -> tuple[float, float]:
    """Returns the true value of a parameter of a virtual drone, from and to [SI].

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
    """Returns the rows before the first one that is not finite; a flight may end in such."""
    rows = np.concatenate([flight.position, flight.attitude, flight.command], axis=1)
    bad = ~np.isfinite(rows).all(axis=1)
    return slice(0, int(np.argmax(bad)) if bad.any() else len(flight))


def viewable(run: Run) -> list[int]:
    """Returns which of `flights_to_show` the viewer holds: the first with two rows and more."""
    flights = enumerate(flights_to_show(run))
    return [number for number, flight in flights if usable(flight).stop > 1][:MAX_FLIGHTS]


def flights_to_show(run: Run) -> tuple[Flight, ...]:
    """Returns test flights where there are any, else those that were recorded."""
    return run.flights if run.table is not None else run.recorded
