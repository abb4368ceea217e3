"""The files of a run folder: name, columns and heading of each table, names of the other files.

Writers and the report's reader both take them from here; which files a run has, `manifest` says.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import budget, inputs, manifest, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath

if TYPE_CHECKING:
    from polars import DataFrame

DRONE = "drone.toml"
"""The identified drone."""
REALITY = "reality.toml"
"""The hidden parameters of the virtual drone that was recorded."""
RECORDED = ("recorded", "flights")
"""Folders of recorded flights, as the demo and `maidenflight record` call them."""
POLICIES = "policies"
"""Folder of trained policies."""
TRANSFER = "transfer"
"""Folder of zero-shot flights."""
FIRMWARE = "firmware"
"""Folder of exported C."""
REPORT = "report.html"
CHECKPOINT = "training.npz"
"""In the folder of policies: training that is under way; removed once they are written."""
STAGES = "demo.json"
"""Seed of a demo, and the seconds that each of its stages took."""

ERROR_UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "body_rates": "rad/s"}
"""Units of the prediction errors, by quantity."""

_MAX_SECONDS, _MAX_NUMBER = 1e6, 1e15
"""Limits of what a time and any other number of a table may be."""


@dataclass(frozen=True)
class Table:
    """A CSV file: its name, what it has in common with others of its kind, reader and writer."""

    name: str
    columns: Mapping[str, type]
    """Columns that readers rely on, each `int`, `float` or `str`; a file may have more."""
    heading: str = ""
    """What the file is, on its first line as a comment, above its record; a file without it begins
    with the column names."""
    digits: int | None = None
    """Decimals of numbers; as many as they have by default."""
    times: tuple[str, ...] = field(default=("duration", "horizon", "time"), kw_only=True)
    """Columns that are times from 0 on [s]."""

    def write(
        self, path: StrPath, rows: "DataFrame", record: Mapping[str, Any] | None = None
    ) -> Path:
        """Writes the table; the record only where it has a heading.

        Raises:
            ValueError: a column is missing.
            WriteError: the file cannot be written.
        """
        return results.write(path, self.to_text(rows, record))

    def to_text(self, rows: "DataFrame", record: Mapping[str, Any] | None = None) -> str:
        """Returns what `write` writes.

        Raises:
            ValueError: a column is missing.
        """
        missing = self.columns.keys() - set(rows.columns)
        if missing:
            raise ValueError(f"{self.name}: missing column {', '.join(sorted(missing))}")
        csv = rows.write_csv(float_precision=self.digits)
        return results.table_text(f"# {self.heading}", record or {}, csv) if self.heading else csv

    def read(self, path: Path) -> tuple["DataFrame", dict[str, Any]]:
        """Returns the rows, and the record in the comments above them; empty where there is none.

        Raises:
            InputError: the file is no such table, or is cut off.
        """
        import polars

        content = inputs.readable(path, budget.TABLE)
        lines = (line for line in content.split("\n") if line.strip() and line[0] != "#")
        names = next(lines, "").split(",")
        problem = "a column is there twice" if len(set(names)) < len(names) else ""
        problem = problem or ("" if content.endswith("\n") else "its last line is cut off")
        if problem:
            raise InputError(f"{path}: not a readable CSV table ({problem}). Make it again.")
        record = results.parse_record(inputs.comments(path), path)
        try:
            rows = polars.read_csv(content.encode(), infer_schema_length=None, comment_prefix="#")
        except (polars.exceptions.PolarsError, OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"{path}: not a readable CSV table ({reason}).") from error
        return self.checked(rows, str(path)), record

    def checked(self, rows: "DataFrame", source: str) -> "DataFrame":
        """Returns the rows with each column in its type.

        An empty cell becomes NaN or an empty text.

        Raises:
            InputError: a column is missing or not of its type, there are no rows, or a number is
                not possible.
        """
        import polars

        missing = [name for name in self.columns if name not in rows.columns]
        if missing or rows.height == 0:
            problem = f"missing column {', '.join(missing)}" if missing else "no rows"
            expected = ", ".join(self.columns) or "a row a flight"
            raise InputError(f"{source}: {problem}; expected a table with {expected}.")
        filled = {float: float("nan"), str: "", int: None}
        try:
            typed = rows.with_columns(
                polars.col(name).cast(kind).fill_null(filled[kind])
                if filled[kind] is not None
                else polars.col(name).cast(kind)
                for name, kind in self.columns.items()
            )
        except polars.exceptions.PolarsError as error:
            reason = str(error).splitlines()[0]
            raise InputError(
                f"{source}: {reason}; expected numbers in the columns of numbers."
            ) from error
        for name in (name for name, kind in self.columns.items() if kind is float):
            number = typed[name]
            wrong = (number.abs() > _MAX_NUMBER) & number.is_finite()
            expected = "SI units"
            if name in self.times:
                wrong = ~number.is_between(0, _MAX_SECONDS).fill_null(False)
                expected = "seconds"
            if wrong.any():
                raise InputError(
                    f"{source}: {name} is {number[wrong.arg_max() or 0]} in a row; expected "
                    f"{expected}. Make the table again."
                )
        return typed


FLIGHTS = Table(
    "flights.csv",
    {
        **{"flight": int, "policy": str, "reality": str, "trial": int},
        **{"duration": float, "end_reason": str, "position_error": float},
        **{"command_change": float, "at_limits": float},
    },
)
"""Zero-shot flights, a row a flight."""
ENVELOPE = Table(
    "envelope.csv",
    {
        **{"policy": str, "reality": str, "axis": str, "flight": int},
        **{"reached": float, "unit": str, "hardest": float, "limit": float},
    },
    "maidenflight envelope 1: simulated, a row a flight of a policy along an axis; reached is the "
    "hardest that it flew and limit what physics allows, in the unit of the row",
)
"""How far each flight went along each axis of difficulty."""
PREDICTION = Table(
    "prediction.csv",
    {"policy": str, "control": str, "trial": int, "duration": float, "end_reason": str},
    "maidenflight prediction 1: simulated flights of policies, a row a flight; duration s",
)
"""Flight times predicted on the identified drone, a row a flight."""
TRAINING = Table(
    "training.csv",
    {
        "steps": float,
        "policy": float,
        **dict.fromkeys(("episode_return", "survival", "position_error"), float),
    },
    digits=5,
)
"""Scores of policies in training, a row a policy and evaluation."""
EVALUATIONS = Table("identification.csv", {"objective": float}, digits=9)
"""Evaluations of an identification's objective, a row each, with a column a parameter."""
VALIDATION = Table(
    "validation.csv",
    {"model": str, "horizon": float}
    | {f"{name}{end}": float for name in ERROR_UNITS for end in ("", "_low", "_high")},
    "maidenflight validation 1: open-loop prediction errors, root mean squares over windows; "
    "horizon s, position m, velocity m/s, attitude rad, body_rates rad/s; _low and _high end the "
    "95 % interval over segments of flight",
    digits=9,
)
"""Errors of open-loop predictions, a row a model and horizon."""
AHEAD = Table(
    "validation_ahead.csv",
    {"model": str, "horizon": float} | dict.fromkeys(ERROR_UNITS, float),
    "maidenflight ahead 1: predictions by logged inputs, mean norms of errors by time ahead, and "
    "their sums in the rows of horizon 0; horizon s, position m, velocity m/s, attitude rad, "
    "body_rates rad/s; _within_80 and _within_95 the shares within predicted bands",
    digits=9,
)
"""Errors by time ahead, with disturbances estimated, a row a time and model."""
CALIBRATION = Table(
    "calibration.csv",
    {"draw": int, "parameter": str, **dict.fromkeys(("truth", "low", "high"), float)}
    | dict.fromkeys(("rank", "width_ratio"), float),
    "maidenflight calibration 1: simulated drones of a posterior, identified again, a row a "
    "parameter; SI units; rank of the truth among the posterior samples, width over the file's",
    digits=9,
)
"""Truths and intervals of drones identified again, a row a drone and parameter."""
WINDOWS = Table(
    "validation_windows.csv",
    {
        **{"window": int, "model": str, "time": float, "roll": float, "pitch": float},
        **dict.fromkeys(("body_rate_x", "body_rate_y", "position_z"), float),
    },
    "maidenflight windows 1: a few windows, as logged and as each model predicts them open loop "
    "from their first row; start s in the flight, time s, position m, velocity m/s, roll pitch yaw "
    "rad, body_rate rad/s",
    digits=6,
)
"""Some windows of flight, logged and predicted, a row a model and time."""

STUDY = Table(
    "study.csv",
    {"task": str, "kind": str},
    "maidenflight study 1: results of each task of a study, a row of each after the other; what is "
    "swept as ENTRY.SETTING, SI units",
    times=(),
)
"""Results of the tasks of a study."""


@dataclass(frozen=True)
class Numbered:
    """Files that are numbered from 1 on."""

    stem: str
    suffix: str

    def path(self, folder: StrPath, number: int) -> Path:
        """Returns the file of a number."""
        return Path(folder, f"{self.stem}_{number}{self.suffix}")

    def find(self, folder: Path) -> list[Path]:
        """Returns the files in a folder by their number."""
        return sorted(folder.glob(f"{self.stem}_*{self.suffix}"), key=by_number)


def find_policies(folder: Path) -> list[Path]:
    """Lists the files in a folder that may be policies."""
    others = (STAGES, manifest.NAME)
    return sorted(path for path in folder.glob("*.json") if path.name not in others)


def by_number(path: Path) -> tuple[str, list[int], str]:
    """Returns what sorts files by their numbers: flight_100 after flight_99."""
    numbers = [int(part) for part in re.findall(r"\d+", str(path))]
    return re.sub(r"\d+", "", str(path)), numbers, str(path)


POLICY = Numbered("policy", ".json")
LOG = Numbered("flight", ".csv")


def evaluations_path(drone: StrPath) -> Path:
    """Returns where evaluations go: `NAME_identification.csv`, for drone.toml without NAME."""
    path = Path(drone)
    named = EVALUATIONS.name if path.stem == Path(DRONE).stem else f"{path.stem}_{EVALUATIONS.name}"
    return path.with_name(named)


def windows_path(validation: StrPath) -> Path:
    """Returns where the windows of a validation go: `NAME_windows.csv` for `NAME.csv`."""
    path = Path(validation)
    return path.with_name(f"{path.stem}_windows.csv")


def write_stages(folder: StrPath, seed: int, seconds: Mapping[str, float]) -> Path:
    """Writes how long each stage of a demo took [s]."""
    content = json.dumps({"seed": seed, "stages": dict(seconds)}, indent=1)
    return results.write(Path(folder, STAGES), f"{content}\n")
