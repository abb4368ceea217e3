"""What a run folder holds, each part of it optional: the one place that knows the names of its files.

A folder of the demo, a folder with only some stages in it and a `Transfer` in memory are three fillings of one `Run`.
"""

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import log
from maidenflight.flights.log import Flight
from maidenflight.identification import prediction
from maidenflight.parameters import COMPONENTS, Parameters

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
TRAINING_COLUMNS: dict[str, Any] = dict.fromkeys(("steps", "policy", "episode_return", "survival", "position_error"), polars.Float64)
"""Columns of `training.csv` and their kinds."""
ERROR_COLUMNS: dict[str, Any] = {
    "model": polars.String,
    "horizon": polars.Float64,
    **dict.fromkeys((f"{name}{end}" for name in prediction.QUANTITIES for end in ("", "_low", "_high")), polars.Float64),
}
"""Columns of `validation.csv` and their kinds."""
WINDOW_COLUMNS: dict[str, Any] = {
    "window": polars.Int64,
    "model": polars.String,
    **dict.fromkeys(("time", "roll", "pitch", "body_rate_x", "body_rate_y", "position_z"), polars.Float64),
}
"""Columns of `validation_windows.csv` that are drawn, and their kinds."""
MOST = 30
"""Flights that the viewer holds; more would make the page heavy."""


@dataclass(frozen=True)
class Estimate:
    """An identified parameter, SI units."""

    value: float
    interval: tuple[float, float]
    """95 %."""


@dataclass(frozen=True)
class Run:
    """What is known of a run; a part that is missing is `None` or empty."""

    reality: Parameters | None = None
    """The truth about a virtual drone."""
    recorded: tuple[Flight, ...] = ()
    drone: Parameters | None = None
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
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
    policies: int = 0
    training: polars.DataFrame | None = None
    """One row an evaluation of a policy in training."""
    table: polars.DataFrame | None = None
    """One row a test flight; see `Transfer`."""
    flights: tuple[Flight, ...] = ()
    """Logs of the test flights, in the table's order."""
    records: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """How each file was made, by the file's name."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall time of each stage."""

    @property
    def known(self) -> bool:
        """Whether there is anything to show."""
        tables = (self.reality, self.drone, self.search, self.validation, self.windows, self.training, self.table)
        return any(part is not None for part in tables) or bool(self.recorded or self.policies)


def of_transfer(flown: Transfer) -> Run:
    """The run of test flights in memory."""
    return Run(table=_columns(flown.table, FLIGHT_COLUMNS, "transfer"), flights=tuple(flown.flights))


def read(folder: Path) -> Run:
    """Reads whatever a run folder holds.

    Raises:
        InputError: not a folder, nothing known in it, or a file in it is not what its name says.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder. Give the folder of a run, such as maidenflight demo writes.")
    records: dict[str, Mapping[str, Any]] = {}
    reality = _drone(folder / "reality.toml", records)
    recorded = _logs(folder / "recorded", records)
    drone = _drone(folder / "drone.toml", records)
    policies = _numbered((folder / "policies").glob("policy_*.json"))
    for path in policies:
        _keep(records, path, _json(path).get("record"))
    tested = folder / "transfer" if (folder / "transfer").is_dir() else folder
    table = _table(tested / "flights.csv", FLIGHT_COLUMNS)
    flights = _logs(tested, records) if table is not None else ()
    if table is not None and flights and len(flights) != table.height:
        raise InputError(f"{tested}: {len(flights)} flight logs, but flights.csv has {table.height} rows. Run the transfer again.")
    stages = _json(folder / "demo.json").get("stages", {})
    found = Run(
        reality=reality,
        recorded=recorded,
        drone=drone,
        estimates=_estimates(folder / "drone.toml") if drone is not None else {},
        objective=_objective(folder / "drone.toml") if drone is not None else "replay",
        search=_table(folder / "identification.csv", {"objective": polars.Float64}),
        posterior=_posterior(folder / "drone.toml") if drone is not None else {},
        validation=_table(folder / "validation.csv", ERROR_COLUMNS, records),
        windows=_table(folder / "validation_windows.csv", WINDOW_COLUMNS, records),
        policies=len(policies),
        training=_table(folder / "policies" / "training.csv", TRAINING_COLUMNS),
        table=table,
        flights=flights,
        records=records,
        seconds={str(stage): float(seconds) for stage, seconds in stages.items()} if isinstance(stages, dict) else {},
    )
    if not found.known:
        raise InputError(
            f"{folder}: nothing of a run in this folder; expected reality.toml, recorded/, drone.toml, identification.csv, validation.csv,"
            " policies/, transfer/ or flights.csv."
        )
    return found


def _numbered(paths: Any) -> list[Path]:
    """Files in the order of the number in their names: flight_100 after flight_99."""
    return sorted(paths, key=lambda path: ([int(digits) for digits in re.findall(r"\d+", path.name)], path.name))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}).") from error


def _json(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        content = json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not valid JSON ({error}). Write it again or remove it.") from error
    return content if isinstance(content, dict) else {}


def _keep(records: dict[str, Mapping[str, Any]], path: Path, record: Any) -> None:
    if isinstance(record, dict) and record:
        name = path.name if path.suffix == ".toml" else "/".join(filter(None, (path.parent.name, path.name)))
        records[name] = record


def _keep_line(records: dict[str, Mapping[str, Any]], path: Path, text: str) -> None:
    """Keeps the record in a line of its own at a file's start."""
    line = next((line for line in text.split("\n", 4)[:4] if line.startswith("# record: ")), "# record: {}")
    try:
        _keep(records, path, json.loads(line.removeprefix("# record: ")))
    except json.JSONDecodeError:
        raise InputError(f"{path}: the line '# record:' holds no valid JSON. Write '# record: {{}}' there.") from None


def _drone(path: Path, records: dict[str, Mapping[str, Any]]) -> Parameters | None:
    if not path.exists():
        return None
    text = _text(path)
    drone = parameters.from_toml(text, str(path))
    _keep(records, path, tomllib.loads(text).get("record"))
    return drone


def _estimates(path: Path) -> dict[str, Estimate]:
    content = tomllib.loads(_text(path)).get("identification", {})
    found = {}
    for name, entry in content.items():
        if name in COMPONENTS and isinstance(entry, dict):
            numbers = [entry.get("value"), *entry.get("interval", [])]
            if len(numbers) != 3 or not all(isinstance(number, float | int) and math.isfinite(number) for number in numbers):
                raise InputError(f"{path}: [identification.{name}] needs value = a number and interval = [lower, upper]. Identify again.")
            found[name] = Estimate(float(numbers[0]), (float(numbers[1]), float(numbers[2])))
    return found


def _objective(path: Path) -> str:
    return str(tomllib.loads(_text(path)).get("identification", {}).get("kind", "replay"))


def _posterior(path: Path) -> dict[str, np.ndarray]:
    content = tomllib.loads(_text(path)).get("posterior")
    if content is None:
        return {}
    try:
        names = [name for name in content["names"] if name in COMPONENTS]
        draws = np.array(content["draws"], np.float64)
        sound = len(names) == len(content["names"]) > 0 and draws.shape == (max(len(draws), 1), len(names)) and np.isfinite(draws).all()
    except (KeyError, TypeError, ValueError):
        names, draws, sound = [], np.empty(0), False
    if not sound:
        raise InputError(f"{path}: [posterior] needs names = parameters and draws = [[a number for each of them], ...]. Identify again.")
    return {name: draws[:, place] for place, name in enumerate(names)}


def _logs(folder: Path, records: dict[str, Mapping[str, Any]]) -> tuple[Flight, ...]:
    flights = []
    for path in _numbered(folder.glob("flight_*.csv")):
        text = _text(path)
        if not text.startswith(log.MARK):
            raise InputError(f"{path}: not a flight log of maidenflight; its first line should begin with '{log.MARK}'.")
        flights.append(log.from_csv(text, f"{folder.name}/{path.name}"))
        _keep_line(records, path, text)
    return tuple(flights)


def _table(path: Path, columns: Mapping[str, Any], records: dict[str, Mapping[str, Any]] | None = None) -> polars.DataFrame | None:
    """Reads a table, and the record in its second line into `records`, where it has one."""
    if not path.exists():
        return None
    try:
        frame = polars.read_csv(path, infer_schema_length=None, comment_prefix="#")
    except (polars.exceptions.PolarsError, OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable CSV table ({str(error).splitlines()[0]}).") from error
    if records is not None:
        _keep_line(records, Path(path.name), _text(path))
    return _columns(frame, columns, str(path))


def _columns(frame: polars.DataFrame, columns: Mapping[str, Any], where: str) -> polars.DataFrame:
    missing = [name for name in columns if name not in frame.columns]
    if missing or frame.height == 0:
        problem = f"missing column {', '.join(missing)}" if missing else "no rows"
        raise InputError(f"{where}: {problem}; expected a table with {', '.join(columns)}.")
    try:
        numbers = {name: polars.col(name).cast(kind) for name, kind in columns.items()}
        floats = {name: numbers[name].fill_null(float("nan")) for name, kind in columns.items() if kind == polars.Float64}
        return frame.with_columns(**(numbers | floats))
    except polars.exceptions.PolarsError as error:
        raise InputError(f"{where}: {str(error).splitlines()[0]}; expected numbers in the columns of numbers.") from error


def truth(run: Run) -> tuple[tuple[float, float], ...]:
    """Corners of what is true of a virtual drone: T_m speeding up to slowing down, latency of commands to that with the sensors' [s]."""
    if run.reality is None:
        return ()
    lag, delay = float(run.reality.motor_time_constant), float(run.reality.latency)
    slow, late = lag * float(run.reality.motor_slowdown), delay + float(run.reality.estimator_delay + run.reality.gyro_lag)
    return ((lag, delay), (slow, delay), (slow, late), (lag, late))


def usable(flight: Flight) -> slice:
    """The rows before the first one that is not finite; a flight may end in such."""
    rows = np.concatenate([flight.position, flight.attitude, flight.command], axis=1)
    bad = ~np.isfinite(rows).all(axis=1)
    return slice(0, int(np.argmax(bad)) if bad.any() else len(flight))


def viewable(run: Run) -> list[int]:
    """Rows of the table whose flights the viewer holds: the first `MOST` of those that have a log with anything in it."""
    return [number for number, flight in enumerate(run.flights) if usable(flight).stop > 1][:MOST]
