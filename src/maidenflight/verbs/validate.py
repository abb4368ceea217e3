"""`Validate`: a drone's prediction errors on flights."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import run_folder
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.manifest import Kind
from maidenflight.settings import PENDING, REQUIRED, flag, listed, number, setting, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Row, Verb
from maidenflight.verbs import shared
from maidenflight.verbs.parts.calibration import calibrate

if TYPE_CHECKING:
    from maidenflight.flights.log import Flight
    from maidenflight.identification.drone_file import DroneFile

_WORSE = 1.2
"""Ratio of errors beyond which a drone is worse."""
_WRITTEN: tuple[Kind, ...] = ("validation", "windows", "ahead", "disturbed")
"""Kinds of files that are written, in their order; the last two with disturbances alone."""
_AHEAD_S = (0.02, 0.05, 0.1, 0.25, 0.5)
"""Times ahead that the terminal shows of predictions with disturbances [s]."""
_JUDGED_S = 0.1
"""Horizon at which errors are compared [s]."""
_TRIMMED = "{}, each flight's trim"
"""Name of a drone with the constant torques of each flight."""
_UNTURNED = "{}, not turned by commands"
"""Name of a drone that its commands carry and do not turn. With two motors exchanged it foretells
the next rows of public logs better (paper/notes/identification.md#parameter-groups)."""


class Validate(Verb):
    """Validate a DRONE on LOGS that it was not identified from.

    DRONE is a TOML file or a name, LOGS a flight log or a folder of them. First stands the log
    likelihood of a row given the row before, the measure to compare drones by. Then, from every
    tenth row, the drone is simulated with the recorded commands alone; the table shows how far it
    is from the flight after some time. Beside it stand the same drone with each flight's own trim,
    as batteries are put in anew, or not turned by its commands, as by motors in a wrong order, the
    paper's Crazyflie and the persistence baseline: position, velocity, attitude and body rates stay
    as they are.

    With --disturbances torques and forces that DRONE lacks are estimated from the rows before each
    prediction, as a regulator would, and half a second is predicted with them.

    With --calibration it is the intervals that are tested, on the logs that the drone was
    identified from.
    """

    output = Output(
        run_folder.VALIDATION.name,
        f"CSV file for the errors and their intervals; {run_folder.CALIBRATION.name} with "
        "--calibration; beside DRONE.",
    )
    fused = True

    drone: str = shared.drone(REQUIRED, argument=True)
    logs: Path = shared.logs()
    horizons: tuple[float, ...] = setting(
        listed(number(0.001, 60.0), "seconds, such as 0.02,0.05,0.1", "SECONDS"),
        (0.02, 0.05, 0.1),
        "How far ahead to predict [s].",
    )
    disturbances: bool = setting(
        flag(),
        False,
        "Estimate torques and forces that DRONE lacks from past rows, and predict 0.5 s with them, "
        "by measured rotor speeds where all logs hold them; fitted to every other log, a minute. "
        "DRONE_disturbed.toml is DRONE with them, to train for and to fly.",
    )
    calibration: bool = setting(
        flag(),
        False,
        "Draw drones from the posterior, fly the paths of LOGS with them in simulation, identify "
        "each as DRONE was, and count intervals that hold the drawn truth; five minutes at most.",
        "Calibration",
    )
    draws: int | None = setting(
        whole(2, 1000), None, "Drones to draw, however long that takes.", rare=True
    )
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    faulty: str = shared.faulty()
    seed: int = shared.seed()

    def choose_output(self, output: StrPath | None) -> Any:
        """Returns the table of errors, or that of a calibration, by default beside DRONE."""
        default = Path((run_folder.CALIBRATION if self.calibration else run_folder.VALIDATION).name)
        if self.drone is not PENDING and Path(self.drone).is_file():
            default = Path(self.drone).with_name(default.name)
        return super().choose_output(default if output is None else output)

    def places(self, output: Path) -> list[Path]:
        """Returns the tables that it writes, or that of a calibration."""
        if self.calibration:
            return [output]
        more = (f"{output.stem}_ahead.csv", f"{Path(self.drone).stem}_disturbed.toml")
        further = map(output.with_name, more if self.disturbances else ())
        return [output, run_folder.windows_path(output), *further]

    def check_early(self) -> None:
        """Refuses logs in a drone's place, and a file that is not there."""
        drone = self.drone
        if drone is PENDING:
            return
        if Path(drone).is_dir() or drone.endswith((".csv", ".csv.gz", ".parquet")):
            raise InputError(
                f"{drone}: not a drone; DRONE comes before LOGS, as in: maidenflight validate "
                f"{self.logs} {drone}."
            )
        shared.must_exist(drone)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Predicts flights with the drone and with the paper's Crazyflie; writes two tables.

        Commands stand for what they did in the identification, unless logs or the setting say it.
        """
        from maidenflight.experiments import drones
        from maidenflight.flights.checkup.result import warning_lines
        from maidenflight.flights.reading import COMMANDS, read_flights
        from maidenflight.identification import drone_file
        from maidenflight.identification.held_out import note_not_held_out, note_other_law
        from maidenflight.identification.likelihood.one_step import log_likelihood
        from maidenflight.identification.outcome.bounds import at_bounds
        from maidenflight.identification.replay.prediction import (
            predicted_windows,
            prediction_error,
            with_own_trim,
            without_torque,
        )
        from maidenflight.parameters import crazyflie
        from maidenflight.verbs.parts import logs_output

        if self.calibration:
            return calibrate(self, self.drone, self.logs, self.draws, output, progress)
        file = drone_file.read(self.drone)
        name = Path(self.drone).name
        models = {name: file.parameters, "paper's crazyflie": crazyflie()}
        law, commands = self.battery_law, self.commands
        read = partial(read_flights, self.logs, battery_law=law, faulty=self.faulty)
        flights = read(logs_output.count_files(progress), commands=commands)
        known = None if file.source is None else file.source.commands
        if commands is None and known in COMMANDS and all(flight.assumed for flight in flights):
            commands = known
            flights = read(commands=commands)
        progress.move(0, None, "compiling and predicting")
        key, horizons = self.key, list(self.horizons)
        trimmed = _TRIMMED.format(name)
        own = {trimmed: partial(with_own_trim, file.parameters)}
        errors = prediction_error(flights, models | own, horizons, key=key)
        windows = predicted_windows(flights, models, max(horizons), key=key)
        drone, places = shared.own_files(self.drone), self.places(output)
        record = self.make_record([*drone, *flights.paths], commands=commands)
        run_folder.VALIDATION.write(places[0], errors, record)
        run_folder.WINDOWS.write(places[1], windows, record)
        ahead = self._predict_ahead(flights.flights, file, places, record, progress)
        rivals = models | {_UNTURNED.format(name): without_torque(file.parameters)}
        likelihoods = {
            rival: float(log_likelihood(flights.flights, model)) for rival, model in rivals.items()
        }
        notes = [
            *note_not_held_out(file, flights.paths),
            *note_other_law(file, law),
            *at_bounds(file.estimates).values(),
            *warning_lines(flights.warnings),
            *drones.repeat_doubts(file),
        ]
        simulated, rows = any(flight.simulated for flight in flights), errors.to_dicts()
        verdict, doubts, remark = _judge(name, likelihoods, rows)
        trained = places[3] if self.disturbances else self.drone
        return Result(
            content={
                "log_likelihoods": likelihoods,
                "doubts": doubts,
                "errors": rows,
                "ahead": ahead,
                "flights": logs_output.to_content(flights),
                "simulated": simulated,
                "notes": notes,
                "output": str(output),
            },
            summary=[
                f"verdict: {verdict}",
                *logs_output.describe_flights(flights, f"; {rows[0]['windows']} windows of rows"),
                *_tabulate(likelihoods, rows, simulated),
                *_tabulate_ahead(ahead),
                f"in {output}: SI units, and 95 % intervals over {rows[0]['segments']} segments of "
                "flight",
            ],
            written=dict(zip(_WRITTEN, ([path] for path in places), strict=False)),
            read={"drone": drone, "logs": flights.paths},
            record=record,
            rows=[{**row, "log_likelihood": likelihoods.get(row["model"])} for row in rows],
            notes=notes,
            next=("log", self.logs) if doubts else ("train", "--drone", trained),
            next_remark=remark,
            value=errors,
        )

    def _predict_ahead(
        self,
        flights: Sequence["Flight"],
        drone: "DroneFile",
        places: Sequence[Path],
        record: Mapping[str, Any],
        progress: Progress,
    ) -> list[Row]:
        """Predicts with disturbances, if asked; writes all times and the drone that has them.

        Returns:
            Rows of some times.
        """
        if not self.disturbances:
            return []
        from maidenflight.disturbances.horizons import SUMS, cross_validate
        from maidenflight.disturbances.kalman import with_disturbances

        stage = "fitting disturbances"
        progress.move(0, None, stage)
        parameters = drone.parameters
        table, filtered = cross_validate(
            flights, parameters, lambda done, of: progress.move(done, of, f"evaluations, {stage}")
        )
        run_folder.AHEAD.write(places[2], table, record)
        disturbed = dataclasses.replace(
            drone,
            parameters=with_disturbances(parameters, filtered),
            record={**drone.record, "disturbances": record},
        )
        disturbed.write(places[3])
        times = table["horizon"].unique()
        some = {SUMS, *(min(times, key=lambda ahead: abs(ahead - time)) for time in _AHEAD_S)}
        rows = table.filter(table["horizon"].is_in(list(some))).to_dicts()
        return [{name: value for name, value in row.items() if value == value} for row in rows]


def _judge(
    name: str, likelihoods: Mapping[str, float], rows: list[Row]
) -> tuple[str, list[str], str]:
    """Returns the verdict on a drone, what speaks against it, and what to look at next."""
    doubts, remark = _compare(name, likelihoods, rows), ""
    if not doubts:
        return f"good: no rival predicts these flights clearly better than {name}", [], remark
    if not _compare(name, likelihoods, rows, _TRIMMED.format(name)):
        verdict = (
            f"good but for the trim of the day: {'; '.join(doubts)}, but with each flight's "
            f"torque bias {name} predicts as well. The default --randomize of train covers that"
        )
        return verdict, [], remark
    remark = "look whether these logs and those it was identified from are sound"
    if any(_UNTURNED.format(name) in doubt for doubt in doubts):
        remark += ", and their motors in order; or log at 250 Hz or more, where rows sample "
        remark += "a controller that answers noise"
    return f"bad: {'; '.join(doubts)}. Do not train for {name}", doubts, remark


def _compare(
    name: str, likelihoods: Mapping[str, float], errors: list[Row], model: str = ""
) -> list[str]:
    """Lists in what a drone, or a model of it, is worse than the baseline or another drone.

    Judged after about `_JUDGED_S`, while a flight does not yet diverge, by attitude, or by body
    rates where there is none.
    """
    from maidenflight.identification.outcome.estimates import SURE_NATS
    from maidenflight.reporting.text import ERRORS

    nearest = min((row["horizon"] for row in errors), key=lambda horizon: abs(horizon - _JUDGED_S))
    rows = {row["model"]: row for row in errors if row["horizon"] == nearest}
    own, doubts = rows[model or name], []
    compared = "attitude" if own["attitude"] == own["attitude"] else "body_rates"
    unit = ERRORS[compared]
    for other, row in rows.items():
        if other not in (name, _TRIMMED.format(name)) and own[compared] > _WORSE * row[compared]:
            doubts.append(
                f"after {nearest:.2g} s its {unit.name} is off by {own[compared] * unit.scale:.3g} "
                f"{unit.unit}, {other} by {row[compared] * unit.scale:.3g}"
            )
    doubts += [
        f"{other} makes each row {math.exp(value - likelihoods[name]):.2f} times as probable"
        for other, value in likelihoods.items()
        if value > likelihoods[name] + SURE_NATS
    ]
    return doubts


def _tabulate(
    likelihoods: Mapping[str, float], errors: list[Row], simulated: bool
) -> list[Table | str]:
    """Returns likelihoods, and errors, a block of rows for each horizon.

    `*` marks what is worse than the persistence baseline.
    """
    from maidenflight.names import PERSISTENCE
    from maidenflight.reporting.text import ERRORS

    baseline = {row["horizon"]: row for row in errors if row["model"] == PERSISTENCE}
    rows: list[Row] = []
    for row in errors:
        first = row["model"] == errors[0]["model"]
        cells = {"model": row["model"], "ahead": f"{row['horizon']:.2g} s" if first else ""}
        for name, format in ERRORS.items():
            worse = not row[name] <= baseline[row["horizon"]][name]
            value = f"{row[name] * format.scale:#.3g}".removesuffix(".")
            cells[name] = f"{'* ' if worse else ''}{value}"
        rows.append(cells)
    columns = {"ahead": "{ahead}", "model": "{model}"}
    columns |= {f"{kind.name}\n{kind.unit}": f"{{{name}}}" for name, kind in ERRORS.items()}
    flight = "simulated" if simulated else "real"
    worse = any(row[name].startswith("*") for row in rows for name in ERRORS)
    return [
        Table(
            "Likelihood of each row given the rows before, more is better",
            {"drone": "{name}", "log likelihood\nnats a row": "{value:.2f}"},
            [{"name": name, "value": value} for name, value in likelihoods.items()],
        ),
        Table(f"Open-loop prediction errors on {flight} flight, root mean squares", columns, rows),
        f"{PERSISTENCE}: the prediction that nothing changes"
        + ("; * marks what is worse than it" if worse else ""),
        "predictions know commands alone: a trim that differs by flight turns the drone from the "
        "first row on, which shows most in body rates; persistence has none",
        "not turned by commands: as if motors were in a wrong order; a sound drone is better",
        "nats: one more a row makes the data 2.7 times as probable, row by row; other words: "
        "docs/glossary.md",
    ]


def _tabulate_ahead(ahead: list[Row]) -> list[Table | str]:
    """Returns errors with disturbances by time ahead, and what bands hold."""
    if not ahead:
        return []
    from maidenflight.disturbances.horizons import SHARES, SUMS, WITH_DISTURBANCES
    from maidenflight.reporting.text import ERRORS

    rows: list[Row] = []
    for row in ahead:
        first = row["model"] == WITH_DISTURBANCES
        is_sum = row["horizon"] == SUMS
        time = "sums, SI" if is_sum else f"{row['horizon']:.2g} s"
        cells = {"model": row["model"], "ahead": time if first else ""}
        for name, unit in ERRORS.items():
            value = row[name] * (1.0 if is_sum else unit.scale)
            cells[name] = f"{value:#.3g}".removesuffix(".")
            within = (f"{100 * row[f'{name}_within_{100 * share:.0f}']:.0f}" for share in SHARES)
            cells[name] += f" ({'/'.join(within)})" if first else ""
        rows.append(cells)
    columns = {"ahead": "{ahead}", "model": "{model}"}
    columns |= {f"{unit.name}\n{unit.unit}": f"{{{name}}}" for name, unit in ERRORS.items()}
    return [
        Table("Predictions by logged inputs, mean norms of errors", columns, rows),
        "(80/95): share of real values in the bands for 80 and 95 %; sums: over rows, in m and rad",
    ]
