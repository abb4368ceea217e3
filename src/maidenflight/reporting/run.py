"""What a run folder holds, each part of it optional: the one place that knows the names of its
files.

A folder of the demo, of one stage alone, of a matrix, and a `Transfer` in memory are fillings of
one `Run`.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars

from maidenflight import inputs, parameters, results
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import log
from maidenflight.flights.log import Flight
from maidenflight.identification import prediction
from maidenflight.parameters import COMPONENTS, Parameters
from maidenflight.reporting import identified, unshown
from maidenflight.reporting.identified import SIMULATED, UNKNOWN, Kinds, Origin
from maidenflight.reporting.identified import Estimate as Estimate

FLIGHT_COLUMNS: dict[str, Any] = {
    "flight": polars.Int64,
    "policy": polars.String,
    "reality": polars.String,
    "trial": polars.Int64,
    "duration": polars.Float64,
    "end_reason": polars.String,
    "position_error": polars.Float64,
}
"""Columns of `flights.csv` and their kinds."""
MATRIX_COLUMNS: dict[str, Any] = {
    **dict.fromkeys(("control", "reality", "end_reason"), polars.String),
    **dict.fromkeys(("number", "trial"), polars.Int64),
    **dict.fromkeys(
        ("motor_time_constant", "latency", "duration", "position_error"), polars.Float64
    ),
}
"""The same of a matrix: what each policy was trained for, and its number in its cell."""
PREDICTION_COLUMNS: dict[str, Any] = {
    **dict.fromkeys(("policy", "control", "end_reason"), polars.String),
    "trial": polars.Int64,
    "duration": polars.Float64,
}
"""Columns of `prediction.csv` and their kinds."""
TRAINING_COLUMNS: dict[str, Any] = dict.fromkeys(
    ("steps", "policy", "episode_return", "survival", "position_error"), polars.Float64
)
"""Columns of `training.csv` and their kinds."""
ERROR_COLUMNS: dict[str, Any] = {
    "model": polars.String,
    "horizon": polars.Float64,
    **dict.fromkeys(
        (f"{name}{end}" for name in prediction.QUANTITIES for end in ("", "_low", "_high")),
        polars.Float64,
    ),
}
"""Columns of `validation.csv` and their kinds."""
WINDOW_COLUMNS: dict[str, Any] = {
    "window": polars.Int64,
    "model": polars.String,
    **dict.fromkeys(
        ("time", "roll", "pitch", "body_rate_x", "body_rate_y", "position_z"), polars.Float64
    ),
}
"""Columns of `validation_windows.csv` that are drawn, and their kinds."""
_TIMES, _MOST_SECONDS = ("duration", "horizon", "time"), 1e6
"""Columns of times, which are numbers from 0 to some."""
_MOST_ANY = 1e15
"""What no number of a table comes near."""
_RECORDED = ("recorded", "flights")
"""Folders of recorded flights, as the demo and `maidenflight record` call theirs."""
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
    drone: Parameters | None = None
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    origin: Origin = field(default_factory=Origin)
    """The flights that they come from."""
    objective: str = "replay"
    """Which objective the identification searched, `replay` or `likelihood`."""
    search: polars.DataFrame | None = None
    """One row an evaluation of it."""
    posterior: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Draws of the identified parameters, SI units; an entry of each belongs together."""
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
    unshown: Mapping[str, list[str]] = field(default_factory=dict)
    """Names of what else the folder holds, by kind."""

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
        table=_columns(flown.table, FLIGHT_COLUMNS, "transfer"), flights=tuple(flown.flights)
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
    tested = folder / "transfer" if (folder / "transfer").is_dir() else folder
    table = _test_flights(tested / "flights.csv", records)
    home = next((folder / name for name in _RECORDED if (folder / name).is_dir()), folder)
    reality = _drone(
        (folder if os.path.lexists(folder / "reality.toml") else home) / "reality.toml", records
    )
    recorded = _numbered(home.glob("flight_*.csv")) if home != tested or table is None else []
    recorded_flights = _logs(recorded[:MOST], records)
    drone = _drone(folder / "drone.toml", records)
    found_by = inputs.from_toml(_text(folder / "drone.toml")) if drone is not None else {}
    trained = folder / "policies" if (folder / "policies").is_dir() else folder
    policies = {path.stem: _json(path) for path in _numbered(trained.glob("policy_*.json"))}
    for name, content in policies.items():
        _keep(records, trained / f"{name}.json", content.get("record"))
    flights = _logs(_numbered(tested.glob("flight_*.csv")), records) if table is not None else ()
    if table is not None and flights and len(flights) != table.height:
        raise InputError(
            f"{tested}: {len(flights)} flight logs, but flights.csv has {table.height} rows. Run "
            "the transfer again."
        )
    validation = _table(folder / "validation.csv", ERROR_COLUMNS, records)
    windows = _table(folder / "validation_windows.csv", WINDOW_COLUMNS, records)
    told = _kinds(recorded, recorded_flights, found_by, records, reality is not None)
    found = Run(
        reality=reality,
        recorded=recorded_flights,
        logs=len(recorded),
        drone=drone,
        estimates=identified.estimates(found_by, folder / "drone.toml"),
        origin=identified.origin(found_by, told[0]),
        objective=identified.objective(found_by, folder / "drone.toml"),
        search=_search(folder / "identification.csv"),
        posterior=identified.posterior(found_by, folder / "drone.toml"),
        validation=validation,
        windows=windows,
        predicted=told[1],
        policies=len(policies),
        controls={
            name: str(content["control"])
            for name, content in policies.items()
            if "control" in content
        },
        training=_table(trained / "training.csv", TRAINING_COLUMNS),
        table=table,
        flights=flights,
        prediction=_table(folder / "prediction.csv", PREDICTION_COLUMNS, records),
        records=records,
        seconds=_seconds(folder / "demo.json"),
        unshown=unshown.find(folder, {tested, trained, home}),
    )
    if not found.known:
        raise InputError(
            f"{folder}: nothing of a run in this folder; expected reality.toml, recorded/ or "
            "flights/, drone.toml, identification.csv,"
            " validation.csv, policies/, policy_*.json, transfer/, flights.csv, prediction.csv or "
            "flight logs."
        )
    return found


def _kinds(
    logs: Sequence[Path],
    flights: Sequence[Flight],
    drone: Mapping[str, Any],
    records: Mapping[str, Mapping[str, Any]],
    virtual: bool,
) -> tuple[Kinds, Kinds]:
    """Kinds of the flights that the drone was identified from, and of those that were predicted: by
    their logs, where these lie here.
    """
    known: dict[str, bool | None] = {
        results.digest(path): bool(flight.simulated)
        for path, flight in zip(logs, flights, strict=False)
    }
    otherwise = SIMULATED if virtual or (known and all(known.values())) else UNKNOWN
    used = identified.inputs(drone.get("record"))
    found = identified.kinds_of(used, known, otherwise)
    own = identified.origin(drone, found).kinds
    if len(own) == 1:
        known |= dict.fromkeys(used, *own)
    predicted = identified.inputs(
        records.get("validation.csv") or records.get("validation_windows.csv")
    )
    return found, identified.kinds_of(predicted, known, otherwise if own <= otherwise else UNKNOWN)


def holds_flights(folder: Path) -> bool:
    """Whether a folder is that of a run with test flights or recorded ones."""
    return any((folder / name).exists() for name in ("flights.csv", "transfer", *_RECORDED))


def _numbered(paths: Any) -> list[Path]:
    """Files in the order of the number in their names: flight_100 after flight_99."""
    return sorted(
        paths,
        key=lambda path: ([int(digits) for digits in re.findall(r"\d+", path.name)], path.name),
    )


def _text(path: Path) -> str:
    try:
        return inputs.text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}).") from error


def _json(path: Path) -> dict[str, Any]:
    if not os.path.lexists(path):
        return {}
    try:
        content = inputs.from_json(_text(path))
        if not isinstance(content, dict):
            raise ValueError("no object")
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"{path}: not valid JSON ({error}). Write it again or remove it."
        ) from error
    return content


def _seconds(path: Path) -> dict[str, float]:
    stages = _json(path).get("stages", {})
    if not isinstance(stages, dict) or not all(
        type(value) in (int, float) and 0 <= value < 1e9 for value in stages.values()
    ):
        raise InputError(
            f"{path}: stages = {stages!r}; expected seconds of each. Remove the file, or run the "
            "demo again."
        )
    return {stage: float(seconds) for stage, seconds in stages.items()}


def _keep(records: dict[str, Mapping[str, Any]], path: Path, record: Any) -> None:
    if isinstance(record, dict) and record:
        name = (
            path.name
            if path.suffix == ".toml"
            else "/".join(filter(None, (path.parent.name, path.name)))
        )
        records[name] = record


def _keep_line(records: dict[str, Mapping[str, Any]], path: Path, text: str) -> None:
    """Keeps the record in a line of its own at a file's start."""
    line = next(
        (line for line in text.split("\n", 4)[:4] if line.startswith("# record: ")), "# record: {}"
    )
    try:
        _keep(records, path, inputs.from_json(line.removeprefix("# record: ")))
    except ValueError:
        raise InputError(
            f"{path}: the line '# record:' holds no valid JSON. Write '# record: {{}}' there."
        ) from None


def _drone(path: Path, records: dict[str, Mapping[str, Any]]) -> Parameters | None:
    if not os.path.lexists(path):
        return None
    text = _text(path)
    try:
        record = inputs.from_toml(text).get("record")
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}.") from error
    _keep(records, path, record)
    return parameters.from_toml(text, str(path))


def _logs(paths: Sequence[Path], records: dict[str, Mapping[str, Any]]) -> tuple[Flight, ...]:
    flights = []
    for path in paths:
        text = _text(path)
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
        _keep_line(records, path, text)
    return tuple(flights)


def _search(path: Path) -> polars.DataFrame | None:
    """Evaluations of an objective; every parameter that was searched has a column of numbers."""
    search = _table(path, {"objective": polars.Float64})
    if search is None:
        return None
    return _columns(
        search,
        dict.fromkeys(
            [name for name in search.columns if name in COMPONENTS or name == "objective"],
            polars.Float64,
        ),
        str(path),
    )


def _test_flights(path: Path, records: dict[str, Mapping[str, Any]]) -> polars.DataFrame | None:
    """The rows of `flights.csv`.

    A matrix's say what each policy was trained for, of which its name is made.
    """
    table = _table(path, {}, records)
    if table is None or "policy" in table.columns or "number" not in table.columns:
        return None if table is None else _columns(table, FLIGHT_COLUMNS, str(path))
    rows = _columns(table, MATRIX_COLUMNS, str(path))
    names = [
        f"{row['control']}_{1e3 * row['motor_time_constant']:g}ms_{1e3 * row['latency']:g}ms/{row['number']}"
        for row in rows.iter_rows(named=True)
    ]
    return rows.with_columns(
        polars.Series("policy", names), polars.int_range(1, rows.height + 1).alias("flight")
    )


def _table(
    path: Path, columns: Mapping[str, Any], records: dict[str, Mapping[str, Any]] | None = None
) -> polars.DataFrame | None:
    """Reads a table, and the record in its second line into `records`, where it has one."""
    if not os.path.lexists(path):
        return None
    text = _text(path)
    header = next(
        (line for line in text.split("\n") if line.strip() and not line.startswith("#")), ""
    ).split(",")
    if len(set(header)) < len(header) or not text.endswith("\n"):
        what = (
            "its last line is cut off"
            if len(set(header)) == len(header)
            else "a column is there twice"
        )
        raise InputError(f"{path}: not a readable CSV table ({what}). Make it again.")
    try:
        frame = polars.read_csv(text.encode(), infer_schema_length=None, comment_prefix="#")
    except (polars.exceptions.PolarsError, OSError, ValueError) as error:
        raise InputError(
            f"{path}: not a readable CSV table ({str(error).splitlines()[0]})."
        ) from error
    if records is not None:
        _keep_line(records, Path(path.name), text)
    return _columns(frame, columns, str(path))


def _columns(frame: polars.DataFrame, columns: Mapping[str, Any], where: str) -> polars.DataFrame:
    missing = [name for name in columns if name not in frame.columns]
    if missing or frame.height == 0:
        problem = f"missing column {', '.join(missing)}" if missing else "no rows"
        raise InputError(
            f"{where}: {problem}; expected a table with {', '.join(columns) or 'a row a flight'}."
        )
    try:
        numbers = {name: polars.col(name).cast(kind) for name, kind in columns.items()}
        floats = {
            name: numbers[name].fill_null(float("nan"))
            for name, kind in columns.items()
            if kind == polars.Float64
        }
        words = {
            name: numbers[name].fill_null("")
            for name, kind in columns.items()
            if kind == polars.String
        }
        read = frame.with_columns(**(numbers | floats | words))
    except polars.exceptions.PolarsError as error:
        raise InputError(
            f"{where}: {str(error).splitlines()[0]}; expected numbers in the columns of numbers."
        ) from error
    for name in floats:
        odd = (read[name].abs() > _MOST_ANY) & read[name].is_finite()
        if odd.any():
            raise InputError(
                f"{where}: {name} is {read[name][odd.arg_max() or 0]} in a row; expected SI "
                "units. Make the table again."
            )
    for name in [name for name in _TIMES if name in columns]:
        odd = ~read[name].is_between(0, _MOST_SECONDS).fill_null(False)
        if odd.any():
            raise InputError(
                f"{where}: {name} is {read[name][odd.arg_max() or 0]} in a row; expected seconds. "
                "Make the table again."
            )
    return read


def truth(run: Run) -> tuple[tuple[float, float], ...]:
    """Corners of what is true of a virtual drone: T_m speeding up to slowing down, latency of
    commands to that with the sensors' [s].
    """
    if run.reality is None:
        return ()
    lag, delay = float(run.reality.motor_time_constant), float(run.reality.latency)
    (_, slow), (_, late) = true_ends(run, "motor_time_constant"), true_ends(run, "latency")
    return ((lag, delay), (slow, delay), (slow, late), (lag, late))


def true_ends(run: Run, name: str) -> tuple[float, float]:
    """What is true of a parameter of a virtual drone [SI]: from and to, where the drone has two
    values for what the model has one for.
    """
    assert run.reality is not None
    same = float(parameters.component(run.reality, name))
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
    """Places of the flights that the viewer holds: the first `MOST` of those `shown` that have
    anything in them.
    """
    return [number for number, flight in enumerate(shown(run)) if usable(flight).stop > 1][:MOST]


def shown(run: Run) -> tuple[Flight, ...]:
    """Flights to look at: test flights where there are any, else those that were recorded."""
    return run.flights if run.table is not None else run.recorded
